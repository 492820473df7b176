"""A base that obeys, for tests of what commands it; fields of small rooms, and a camera that sees points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from benchmarks.plain_rooms import Unicycle
from benchmarks.plain_views import view_of_points
from wheelsight.core.geometry import BoolArray, FloatArray
from wheelsight.core.messages import VelocityCommand
from wheelsight.navigation import Footprint
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.controllers import Controller, ControlReason, DrivenPath
from wheelsight.navigation.perception import DepthView

CHAIR = Footprint.rectangle(0.8, 0.3, 0.6)
NOBODY = np.empty((0, 5))
RESOLUTION_M = 0.05


@dataclass(frozen=True)
class Path:
    """A plan, as far as controllers ask it."""

    poses: FloatArray

    @classmethod
    def of(cls, *poses: tuple[float, float, float]) -> Path:
        return cls(np.array(poses, float))


@dataclass(frozen=True)
class Drive:
    """What became of a closed loop."""

    poses: FloatArray
    reason: ControlReason | None
    commands: list[VelocityCommand]

    def off_goal(self, path: Path) -> tuple[float, float]:
        """Metres and degrees."""
        off = self.poses[-1] - path.poses[-1]
        return float(np.hypot(*off[:2])), float(np.degrees(abs((off[2] + np.pi) % (2 * np.pi) - np.pi)))


def closed_loop(
    controller: Controller,
    path: DrivenPath,
    field: CostField,
    base: Unicycle,
    people: FloatArray = NOBODY,
    longest_s: float = 60.0,
) -> Drive:
    """Drive until the controller has a reason to stand and the base stands; people walk on as time goes."""
    poses, commands, reason = [base.pose.copy()], [], None
    for n in range(int(longest_s / 0.05)):
        now = people + 0.05 * n * np.pad(people[:, 2:4], ((0, 0), (0, 3))) if len(people) else people
        result = controller.command(base.state, path, field, now)
        reason = result.reason
        if reason is not None and base.stands:
            break
        base.step(result.command)
        poses.append(base.pose.copy())
        commands.append(result.command)
    return Drive(np.array(poses), reason, commands)


def room(width_m: float = 10.0, height_m: float = 10.0) -> BoolArray:
    """Walls around a floor; rows along y."""
    cells = np.zeros((round(height_m / RESOLUTION_M), round(width_m / RESOLUTION_M)), bool)
    cells[[0, -1]] = True
    cells[:, [0, -1]] = True
    return cells


def with_door(middle_m: float, width_m: float) -> BoolArray:
    """A room with a wall across at x = 5 m, and a door in it."""
    cells = room()
    ys = (np.arange(len(cells)) + 0.5) * RESOLUTION_M
    cells[np.abs(ys - middle_m) > width_m / 2, 100] = True
    return cells


def field_of(is_obstacle: BoolArray) -> CostField:
    """Of cells from the origin on."""
    distance = ndimage.distance_transform_edt(~is_obstacle) * RESOLUTION_M
    return CostField(distance.astype(np.float32), np.zeros(is_obstacle.shape, np.float32), RESOLUTION_M, (0.0, 0.0))


def centres_of(is_obstacle: BoolArray) -> FloatArray:
    """(N, 2) of obstacle cells."""
    return np.asarray((np.argwhere(is_obstacle)[:, ::-1] + 0.5) * RESOLUTION_M, float)


def clearance_m(footprint: Footprint, poses: FloatArray, points: FloatArray) -> float:
    """The least distance of points (N, 2) from a footprint at poses (M, 3); 0 within. Plain: by sides' segments."""
    least = np.inf
    for pose in np.atleast_2d(poses):
        near = points[np.hypot(*(points - pose[:2]).T) < least + footprint.circumscribed_m]
        if not len(near):
            continue
        c, s = np.cos(pose[2]), np.sin(pose[2])
        inside = footprint.contains((near - pose[:2]) @ np.array([[c, -s], [s, c]]))
        corners = footprint.at(pose)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            share = np.clip((near - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            away = np.hypot(*(near - a - share[:, None] * (b - a)).T)
            least = min(least, float(np.where(inside, 0.0, away).min()))
    return float(least)


@dataclass(frozen=True)
class Camera:
    """Ahead of the axle, as on the chair; it sees points within its view that no nearer one hides."""

    x_m: float = 0.35
    half_angle_rad: float = np.pi / 6
    near_m: float = 0.5
    far_m: float = 4.0

    def view(self, points: FloatArray, pose: FloatArray, stamp_s: float) -> DepthView:
        """Of points (N, 2) in the plane."""
        c, s = np.cos(pose[2]), np.sin(pose[2])
        base = (points - pose[:2]) @ np.array([[c, -s], [s, c]])
        apart = base - (self.x_m, 0.0)
        away, bearing = np.hypot(*apart.T), np.arctan2(apart[:, 1], apart[:, 0])
        seen = (np.abs(bearing) < self.half_angle_rad) & (away < self.far_m)
        view = view_of_points(stamp_s, base[seen], (self.x_m, 0.0), self.half_angle_rad, (self.near_m, self.far_m))
        columns = ((bearing[seen] + self.half_angle_rad) / view.step_rad).astype(int)
        shown = away[seen] <= view.seen_m[columns] + 0.1
        return DepthView(
            stamp_s, base[seen][shown], view.camera, view.first_rad, view.step_rad, view.seen_m, self.near_m
        )
