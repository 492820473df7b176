"""A plain base, walls or pillars, and a robot among them with a small depth camera, for tests and benchmarks.

Rays meet things exactly, so that a drive takes seconds. `DepthEye` adds the noise of a depth camera, and
`TrueLocalization` keeps keyframes for a map that grows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise, Wheels
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3
from wheelsight.core.keyframes import Keyframe, KeyframeStore
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


@dataclass(frozen=True, eq=False)
class DepthEye:
    """A depth camera on a robot.

    Attributes:
        camera: of depth.
        T_base_camera: (4, 4) its mount.
        senses_m: nearest and farthest depth.
        noise: of depth; None for exact depth.
        edge_px: standard deviation of the place of edges in the image, in pixels, alike in blocks of three.
    """

    camera: PinholeCamera
    T_base_camera: FloatArray
    senses_m: tuple[float, float] = SENSES_M
    noise: DepthNoise | None = None
    edge_px: float = 0.0

    @property
    def calibration(self) -> Calibration:
        """Of a robot with it and with `WHEELS`."""
        more = {} if self.noise is None else {"depth_noise": self.noise}
        return Calibration.registered_camera(self.camera, T_base_camera=self.T_base_camera, wheels=WHEELS, **more)

    def measured(self, depth_m: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Depth (h, w) as it measures true depth, 0 where unknown."""
        if self.edge_px:
            rows, columns = depth_m.shape
            blocks = rng.standard_normal((2, rows // 3 + 1, columns // 3 + 1)).repeat(3, axis=1).repeat(3, axis=2)
            i, j = np.indices(depth_m.shape) + np.rint(self.edge_px * blocks[:, :rows, :columns]).astype(int)
            depth_m = depth_m[np.clip(i, 0, rows - 1), np.clip(j, 0, columns - 1)]
        if self.noise is None:
            return depth_m
        noisy = depth_m + rng.standard_normal(depth_m.shape) * self.noise.sigma_m(depth_m)
        return np.where(depth_m > 0, noisy, 0.0)


EYE = DepthEye(CAMERA, MOUNT)


class Things(Protocol):
    """What stands about a robot."""

    def depth_m(self, T_map_camera: FloatArray, eye: DepthEye = EYE) -> FloatArray:
        """(h, w) of things and floor, 0 beyond what the camera senses."""

    def clearance_m(self, corners: FloatArray) -> float:
        """From an outline's sides to the nearest thing."""


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

    def depth_m(self, T_map_camera: FloatArray, eye: DepthEye = EYE) -> FloatArray:
        """See `Things`."""
        rays = eye.camera.rays() @ T_map_camera[:3, :3].T
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
        return np.where((depth >= eye.senses_m[0]) & (depth <= eye.senses_m[1]), depth, 0.0)


@dataclass
class Pillars:
    """Upright cylinders at (N, 2) of one radius and height."""

    centres: FloatArray
    radius_m: float
    height_m: float

    def clearance_m(self, corners: FloatArray) -> float:
        """See `Things`; negative within a pillar."""
        a, way = corners, np.roll(corners, -1, axis=0) - corners
        away = self.centres[:, None] - a
        share = np.clip((away * way).sum(-1) / (way**2).sum(-1), 0, 1)
        outside = float(np.linalg.norm(away - share[..., None] * way, axis=-1).min()) - self.radius_m
        is_inside = (way[:, 0] * away[..., 1] - way[:, 1] * away[..., 0] >= 0).all(axis=1).any()
        return -self.radius_m if is_inside else outside

    def depth_m(self, T_map_camera: FloatArray, eye: DepthEye = EYE) -> FloatArray:
        """See `Things`."""
        rays = (eye.camera.rays() @ T_map_camera[:3, :3].T).astype(np.float32)
        origin, ahead = T_map_camera[:3, 3], T_map_camera[:2, 2]
        away = self.centres - origin[:2]
        is_near = (np.hypot(*away.T) < 1.5 * eye.senses_m[1]) & (away @ ahead > -self.radius_m)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(rays[..., 2] < 0, -origin[2] / rays[..., 2], np.inf).astype(np.float32)
            square = (rays[..., :2] ** 2).sum(-1)
            for x, y in away[is_near].astype(np.float32):
                along = rays[..., 0] * x + rays[..., 1] * y
                left = along**2 - square * (x * x + y * y - np.float32(self.radius_m**2))
                z = (along - np.sqrt(np.maximum(left, 0))) / square
                is_hit = (left > 0) & (z > 0) & (origin[2] + z * rays[..., 2] < self.height_m)
                depth = np.where(is_hit, np.minimum(depth, z), depth)
        return np.where((depth >= eye.senses_m[0]) & (depth <= eye.senses_m[1]), depth, 0.0)


class RoomRobot:
    """A `Robot`; its depth camera sees `walls` every `frame_periods` control periods."""

    def __init__(
        self,
        walls: Things,
        pose: tuple[float, float, float],
        eye: DepthEye = EYE,
        limits: RobotLimits | None = None,
        seed: int = 0,
        frame_periods: int = 2,
    ) -> None:
        self.walls, self.base, self.eye = walls, Unicycle(pose, limits), eye
        self._rng, self._frame_periods = np.random.default_rng(seed), frame_periods
        self.now_s, self._period, self.stop_reason = 0.0, 0, ""
        self.calibration = CALIBRATION if eye is EYE else eye.calibration
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
        if self.has_camera and self._period % self._frame_periods == 0:
            true_m = self.walls.depth_m(self.T_map_base @ self.eye.T_base_camera, self.eye)
            depth = self.eye.measured(true_m, self._rng).astype(np.float32)
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


# Motion between two keyframes of a map that grows.
_KEYFRAME_M, _KEYFRAME_RAD = 0.25, 0.2


@dataclass
class TrueLocalization:
    """A `Localization` that knows where a robot truly is, or what `says` makes of that, and keeps keyframes."""

    robot: RoomRobot
    keyframes: KeyframeStore | None = field(default_factory=KeyframeStore)
    recognised: int | None = None
    says: Callable[[Estimate], Estimate] = lambda estimate: estimate
    _last: FloatArray | None = None

    def process(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        """See `Localization`."""
        T, C = self.robot.T_map_base, 1e-6 * np.eye(6)
        for event in events:
            if self.keyframes is not None and isinstance(event, RgbdFrame) and self._has_moved():
                self._last, camera = self.robot.base.pose.copy(), self.robot.eye.camera
                intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
                grey = np.zeros(event.depth_m.shape, np.float32)
                keyframe = Keyframe.of_images(event.stamp_s, intrinsics, event.depth_m, grey)
                self.keyframes.add(keyframe, T @ self.robot.eye.T_base_camera)
        return [(event, self.says(Estimate(event.stamp_s, Status.TRACKING, T, C, body="base"))) for event in events]

    def close(self) -> None:
        """See `Localization`."""
        if self.keyframes is not None:
            self.keyframes.close()

    def _has_moved(self) -> bool:
        if self._last is None:
            return True
        off = self.robot.base.pose - self._last
        return bool(np.hypot(*off[:2]) > _KEYFRAME_M or abs(np.sin(off[2] / 2)) > _KEYFRAME_RAD / 2)
