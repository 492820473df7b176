"""A robot among walls that a navigator drives: kinematic, a small depth camera, a stand-in for the localization."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any

import numpy as np
from navigation.unicycle import Unicycle

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import BoolArray, FloatArray, PinholeCamera, se3
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import Event, RgbdFrame, VelocityCommand, WheelSpeeds
from wheelsight.core.robots import STOPPED
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import KnownFloor, NavigationSettings, Navigator, PlanningResult, Transition, Worker
from wheelsight_sim.robot import RobotModel

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
        self.calibration = CALIBRATION
        self.obeys: Callable[[VelocityCommand], VelocityCommand] = lambda command: command
        self.has_camera = self.has_wheels = True

    def step(self, command: VelocityCommand) -> list[Event]:
        if command.is_stop and self.stop_reason == STOPPED:
            self.stop_reason = ""
        self.base.step(self.obeys(command))
        self._period, self.now_s = self._period + 1, self.now_s + 0.05
        half = self.base.turn_rad_s * WHEELS.track_width_m / 2
        rims = (self.base.forward_m_s - half) / 0.17, (self.base.forward_m_s + half) / 0.17
        events: list[Event] = [WheelSpeeds(self.now_s, *rims)] if self.has_wheels else []
        if self.has_camera and self._period % 2 == 0:
            depth = self.walls.depth_m(self.T_map_base @ MOUNT).astype(np.float32)
            events.append(RgbdFrame(self.now_s, np.zeros((*depth.shape, 3), np.uint8), depth, self._period))
        return events

    @property
    def T_map_base(self) -> FloatArray:
        x, y, yaw = map(float, self.base.pose)
        return se3.from_plane(x, y, yaw)

    def stop(self) -> None:
        self.stop_reason = STOPPED

    def close(self) -> None:
        self.stop()

    def __enter__(self) -> RoomRobot:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@dataclass
class StandInLocalization:
    """A localization that says where the robot truly is, or what `says` makes of that."""

    robot: RoomRobot
    says: Callable[[Estimate], Estimate] = lambda estimate: estimate
    keyframes: KeyframeStore | None = None
    recognised: int | None = None
    warnings: tuple[str, ...] = ()
    closed: list[bool] = field(default_factory=list)

    def process(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        C = 1e-6 * np.eye(6)
        return [
            (event, self.says(Estimate(event.stamp_s, Status.TRACKING, self.robot.T_map_base, C, body="base")))
            for event in events
        ]

    def close(self) -> None:
        self.closed.append(True)


@dataclass
class Ride:
    """A robot, a navigator, and what was seen of them on the way."""

    robot: RoomRobot
    localization: StandInLocalization
    navigator: Navigator
    transitions: list[Transition]
    clearance_m: float = np.inf

    @classmethod
    def of(
        cls,
        walls: Walls,
        pose: tuple[float, float, float],
        size_m: tuple[float, float],
        mapped: Walls | None = None,
        settings: NavigationSettings | None = None,
        planning: Worker[PlanningResult] | None = None,
    ) -> Ride:
        """In a room of a size, whose map has other walls where `mapped` is given."""
        robot, transitions = RoomRobot(walls, pose), list[Transition]()
        localization = StandInLocalization(robot)
        floor = KnownFloor((mapped or walls).grid(*size_m))
        chosen = settings or NavigationSettings(controller="pure_pursuit")
        how: dict[str, Any] = {"trusts_floor": True, "on_transition": transitions.append}
        navigator = Navigator(robot, localization, floor, chosen, planning=planning, **how)
        return cls(robot, localization, navigator, transitions)

    def go(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Steps, until the task is complete and the robot stands, or something else is so."""
        for _ in range(round(seconds / 0.05)):
            self.navigator.step()
            corners = self.navigator.footprint.at(self.robot.base.pose)
            self.clearance_m = min(self.clearance_m, self.robot.walls.clearance_m(corners))
            if (self.navigator.is_task_complete() and self.robot.base.stands) or until():
                return

    @property
    def states(self) -> list[str]:
        """That were entered, in order."""
        return [str(transition.after) for transition in self.transitions]


def is_near(pose: FloatArray, goal: Sequence[float], off_m: float = 0.12, off_rad: float = 0.12) -> BoolArray:
    off = pose - np.asarray(goal)
    return np.hypot(*off[:2]) < off_m and abs(np.angle(np.exp(1j * off[2]))) < off_rad
