"""A plain base, walls and a robot among them with a small depth camera, for tests and benchmarks of navigation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3
from wheelsight.core.messages import Event, RgbdFrame, VelocityCommand, WheelSpeeds
from wheelsight.core.robots import STOPPED, RobotLimits
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation.controllers import MotionState
from wheelsight_sim.robot import RobotModel

_PARTS = 10


class Unicycle:
    """Speeds follow commands by a first-order lag, within limits of acceleration, braking and turns."""

    def __init__(
        self, pose: tuple[float, float, float], limits: RobotLimits | None = None, lag_s: float = 0.15
    ) -> None:
        self.pose = np.array(pose, float)
        self.forward_m_s, self.turn_rad_s = 0.0, 0.0
        self._limits, self._lag_s = limits or RobotLimits(), lag_s

    @property
    def state(self) -> MotionState:
        """Pose and speeds."""
        return MotionState(self.pose.copy(), self.forward_m_s, self.turn_rad_s)

    @property
    def stands(self) -> bool:
        """Whether it stands still."""
        return abs(self.forward_m_s) < 0.005 and abs(self.turn_rad_s) < 0.005

    def step(self, command: VelocityCommand, period_s: float = 0.05) -> None:
        """Go on by a period, in short pieces of arcs."""
        limits, step_s = self._limits, period_s / _PARTS
        share = 1 - np.exp(-step_s / self._lag_s) if self._lag_s else 1.0
        for _ in range(_PARTS):
            change = share * (command.forward_m_s - self.forward_m_s)
            grows = self.forward_m_s * change >= 0
            most = (limits.acceleration_m_s2 if grows else limits.braking_m_s2) * step_s
            self.forward_m_s += float(np.clip(change, -most, most))
            most = limits.turn_acceleration_rad_s2 * step_s
            self.turn_rad_s += float(np.clip(share * (command.turn_rad_s - self.turn_rad_s), -most, most))
            yaw = self.pose[2] + self.turn_rad_s * step_s / 2
            way = self.forward_m_s * step_s
            self.pose += [way * np.cos(yaw), way * np.sin(yaw), self.turn_rad_s * step_s]


CELL_M = 0.05
WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
CAMERA = PinholeCamera(64, 48, 52.0, 52.0, 31.5, 23.5)
# As on the chair, and looking down so that the floor is seen from half a metre ahead of it.
HEIGHT_M, AHEAD_M, PITCH_RAD, SENSES_M = 0.9, 0.35, 0.4, (0.4, 6.0)


MOUNT = RobotModel(camera_height_m=HEIGHT_M, camera_forward_m=AHEAD_M, camera_pitch_rad=PITCH_RAD).T_base_camera
CALIBRATION = Calibration.registered_camera(CAMERA, T_base_camera=MOUNT, wheels=WHEELS)


Wall = tuple[tuple[float, float], tuple[float, float]]


def walls_about(width_m: float, height_m: float) -> tuple[Wall, ...]:
    """Of an empty room from the origin on; the farther ones within the last cell of its grid."""
    right, top = width_m - 0.01, height_m - 0.01
    return (
        ((0.0, 0.0), (width_m, 0.0)),
        ((right, 0.0), (right, height_m)),
        ((width_m, top), (0.0, top)),
        ((0.01, height_m), (0.01, 0.0)),
    )


@dataclass
class Walls:
    """Walls from floor to ceiling, each from (x, y) to (x, y): (N, 2, 2)."""

    ends: FloatArray

    @classmethod
    def of(cls, *walls: Wall) -> Walls:
        """Walls by their ends."""
        return cls(np.array(walls, float))

    def grid(self, width_m: float, height_m: float) -> OccupancyGrid:
        """As a map has them, from the origin on."""
        shape = round(height_m / CELL_M), round(width_m / CELL_M)
        kind = np.full(shape, CellKind.FREE, np.uint8)
        for a, b in self.ends:
            points = a + np.linspace(0, 1, 2 + int(np.hypot(*(b - a)) / 0.01))[:, None] * (b - a)
            cells = np.clip(np.floor(points / CELL_M).astype(int), 0, (shape[1] - 1, shape[0] - 1))
            kind[cells[:, 1], cells[:, 0]] = CellKind.OBSTACLE
        return OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, CELL_M, (0.0, 0.0))

    def clearance_m(self, corners: FloatArray) -> float:
        """From an outline's sides to the nearest wall, by points of both."""
        sides = np.concatenate(
            [np.linspace(a, b, 25) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        )
        a, way = self.ends[:, 0], self.ends[:, 1] - self.ends[:, 0]
        share = np.clip(((sides[:, None] - a) * way).sum(-1) / (way**2).sum(-1), 0, 1)
        return float(np.linalg.norm(sides[:, None] - a - share[..., None] * way, axis=-1).min())

    def depth_m(self, T_map_camera: FloatArray) -> FloatArray:
        """(h, w) of walls and floor, 0 beyond what the camera senses."""
        rays = CAMERA.rays() @ T_map_camera[:3, :3].T
        origin = T_map_camera[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(rays[..., 2] < 0, -origin[2] / rays[..., 2], np.inf)
            for a, b in self.ends:
                way = b - a
                across = rays[..., 0] * way[1] - rays[..., 1] * way[0]
                z = ((a[0] - origin[0]) * way[1] - (a[1] - origin[1]) * way[0]) / across
                share = (
                    (origin[0] + z * rays[..., 0] - a[0]) * way[0] + (origin[1] + z * rays[..., 1] - a[1]) * way[1]
                ) / (way @ way)
                depth = np.where((z > 0) & (share >= 0) & (share <= 1), np.minimum(depth, z), depth)
        return np.where((depth >= SENSES_M[0]) & (depth <= SENSES_M[1]), depth, 0.0)


class RoomRobot:
    """A `Robot`."""

    def __init__(self, walls: Walls, pose: tuple[float, float, float]) -> None:
        self.walls, self.base = walls, Unicycle(pose)
        self.now_s, self._period, self.stop_reason = 0.0, 0, ""
        self.calibration, self.mount = CALIBRATION, MOUNT
        self.obeys: Callable[[VelocityCommand], VelocityCommand] = lambda command: command
        self.has_camera = self.has_wheels = True

    def step(self, command: VelocityCommand) -> list[Event]:
        """See `Robot`; a frame comes every second period."""
        if command.is_stop and self.stop_reason == STOPPED:
            self.stop_reason = ""
        self.base.step(self.obeys(command))
        self._period, self.now_s = self._period + 1, self.now_s + 0.05
        half = self.base.turn_rad_s * WHEELS.track_width_m / 2
        rims = (self.base.forward_m_s - half) / 0.17, (self.base.forward_m_s + half) / 0.17
        events: list[Event] = [WheelSpeeds(self.now_s, *rims)] if self.has_wheels else []
        if self.has_camera and self._period % 2 == 0:
            depth = self.walls.depth_m(self.T_map_base @ self.mount).astype(np.float32)
            events.append(RgbdFrame(self.now_s, np.zeros((*depth.shape, 3), np.uint8), depth, self._period))
        return events

    @property
    def T_map_base(self) -> FloatArray:
        """(4, 4) true pose of the base."""
        x, y, yaw = map(float, self.base.pose)
        return np.asarray(se3.from_plane(x, y, yaw))

    def stop(self) -> None:
        """See `Robot`."""
        self.stop_reason = STOPPED

    def close(self) -> None:
        """See `Robot`."""
        self.stop()

    def __enter__(self) -> RoomRobot:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
