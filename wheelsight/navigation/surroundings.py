"""Surroundings: what a collision monitor remembers of the floor about a robot, carried along by the wheels alone."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry import ByteArray, Float32Array, FloatArray
from wheelsight.navigation._field_kernels import moved
from wheelsight.navigation._surroundings_kernels import Memory, Sight, keep, look, mark_under, remembered, unseen
from wheelsight.navigation._sweep_kernels import all_outside_m
from wheelsight.navigation.fields import Outline, sides_of
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.monitor_settings import MonitorSettings

Pose = tuple[float, float, float, float]
_MOST_POINTS = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class DepthView:
    """A depth frame, as a collision monitor takes it.

    Attributes:
        stamp_s: of the frame.
        points: (N, 2) in `base` of things between floor and the robot's height, and of edges where the floor ends.
        camera: x and y of the camera in `base`.
        first_rad: bearing in `base` of the right end of the view.
        step_rad: from one column to the next, counter-clockwise.
        seen_m: (B,) how far from the camera each column sees the floor, or through the air; 0 where it has no depth.
        near_m: nearer to the camera nothing of the floor is seen.
        shows_m: (N,) how near to the camera each of the points would show; None: as near as it is.
    """

    stamp_s: float
    points: FloatArray
    camera: tuple[float, float]
    first_rad: float
    step_rad: float
    seen_m: FloatArray
    near_m: float
    shows_m: FloatArray | None = None

    @classmethod
    def of_points(
        cls,
        stamp_s: float,
        points: ArrayLike,
        camera: tuple[float, float],
        half_angle_rad: float,
        reach_m: tuple[float, float],
        columns: int = 64,
    ) -> DepthView:
        """Of a camera that looks ahead and has depth all over its view: each column sees to its nearest point.

        Args:
            stamp_s: of the frame.
            points: (N, 2) in `base`.
            camera: x and y in `base`.
            half_angle_rad: to either side of ahead.
            reach_m: nearest and farthest floor that it sees.
            columns: of the answer.
        """
        points = np.asarray(points, float).reshape(-1, 2)
        step_rad = 2 * half_angle_rad / columns
        apart = points - np.array(camera)
        column = np.floor((np.arctan2(apart[:, 1], apart[:, 0]) + half_angle_rad) / step_rad)
        seen_m = np.full(columns, float(reach_m[1]))
        inside = (column >= 0) & (column < columns)
        np.minimum.at(seen_m, column[inside].astype(int), np.hypot(*apart[inside].T))
        return cls(stamp_s, points, camera, -half_angle_rad, step_rad, seen_m, reach_m[0])

    @property
    def is_sound(self) -> bool:
        """Whether all its numbers can be reckoned with."""
        numbers = np.array([self.stamp_s, *self.camera, self.first_rad, self.step_rad, self.near_m], float)
        points, seen = np.asarray(self.points), np.asarray(self.seen_m)
        shapes = points.ndim == 2 and points.shape[1:] == (2,) and seen.ndim == 1 and len(seen) > 0
        shows = np.zeros(len(points)) if self.shows_m is None else np.asarray(self.shows_m)
        shapes &= shows.shape == points.shape[:1]
        finite = all(np.isfinite(values).all() for values in (numbers, points, seen, shows))
        return bool(shapes and finite and self.step_rad > 0)

    @property
    def share(self) -> float:
        """Of the columns that have depth."""
        return float((np.asarray(self.seen_m) > 0).mean())


@dataclass(frozen=True, slots=True, eq=False)
class Unseen:
    """Cells about a robot; rows along x, columns along y.

    Attributes:
        never_m: (m, m) metres into floor that was never seen, nor led over.
        is_old: (m, m) 1 where it was not lately.
        hidden_m: (m, m) metres into floor that no camera has looked at, not even over it.
        first: i and j of the first cell.
    """

    never_m: Float32Array
    is_old: ByteArray
    hidden_m: Float32Array
    first: tuple[int, int]


@dataclass(frozen=True, slots=True)
class _Reading:
    stamp_s: float
    pose: Pose
    forward_m_s: float
    turn_rad_s: float


class Surroundings:
    """Things and seen floor in a plane in which the wheels say where the robot is.

    The plane is its own, and drifts: what is in it is never older than it takes the robot to leave it.
    """

    def __init__(self, outline: Outline, settings: MonitorSettings) -> None:
        self._outline, self._settings = outline, settings
        self._readings: deque[_Reading] = deque()
        self._newest = np.empty((0, 2))
        self._newest_s, self._trusted_m, self._way_m = -np.inf, 0.0, 0.0
        # How deep cells are in floor never looked at, by the last reading; None where that has changed since.
        self._hidden: tuple[Float32Array, tuple[int, int]] | None = None
        self._reach_m = float(np.linalg.norm(outline.sides[:, :2], axis=1).max())
        self.forget()

    def forget(self) -> None:
        """Begin anew: nothing is known but that the robot stands where it stands."""
        self._hidden = None
        s = self._settings
        n = int(np.ceil(s.window_m / s.cell_m))
        never = np.full((n, n), -np.inf)
        nowhere = np.full((n, n, 2), np.iinfo(np.int64).min)
        hits = np.zeros((n, n, 4))
        self._memory = Memory(nowhere, never, never.copy(), never.copy(), hits, s.cell_m)
        self._readings.clear()
        self._newest, self._newest_s = np.empty((0, 2)), -np.inf

    def hear(
        self, stamp_s: float, forward_m_s: float, turn_rad_s: float, rolled: tuple[float, float] | None = None
    ) -> None:
        """Go on by what the wheels measured since the last reading; stamps in order. `rolled` as `CollisionMonitor`."""
        self._hidden = None
        if not self._readings:
            pose = (0.0, 0.0, 1.0, 0.0)
            mark_under(self._memory, self._outline.sides, pose, stamp_s, -np.inf)
            if self._trusted_m > 0:
                mark_under(self._memory, _around(self._trusted_m), pose, stamp_s, -np.inf)
        else:
            last = self._readings[-1]
            step_s = stamp_s - last.stamp_s
            if rolled is None:
                rolled = (
                    step_s * (last.forward_m_s + forward_m_s) / 2,
                    step_s * (last.turn_rad_s + turn_rad_s) / 2,
                )
            pose = moved(last.pose, *rolled)
            self._way_m += abs(rolled[0]) + self._reach_m * abs(rolled[1])
        self._readings.append(_Reading(stamp_s, pose, forward_m_s, turn_rad_s))
        while len(self._readings) > 1 and self._readings[1].stamp_s < stamp_s - self._settings.history_s:
            self._readings.popleft()

    def trust(self, radius_m: float) -> None:
        """Count the floor so far about the axle as seen, where the robot is now; before any reading, at the first."""
        self._hidden = None
        self._trusted_m = 0.0 if self._readings else radius_m
        if self._readings and radius_m > 0:
            last = self._readings[-1]
            mark_under(self._memory, _around(radius_m), last.pose, last.stamp_s, -np.inf)

    def forget_near(self, xy_base: ArrayLike, radius_m: float) -> None:
        """Forget remembered things about a place (2,) in the base as it is now; what a frame shows is seen again."""
        if self._readings:
            at = _placed(np.asarray(xy_base, float).reshape(1, 2), self._readings[-1].pose)[0]
            is_near = np.hypot(*np.moveaxis(self._memory.hits[..., :2] - at, -1, 0)) <= radius_m
            self._memory.hit_s[is_near] = -np.inf

    def pose_at(self, stamp_s: float) -> Pose | None:
        """Where the base was, or will be soon; None where that is not known any more, or not yet."""
        before = [reading for reading in self._readings if reading.stamp_s <= stamp_s]
        if not before:
            return None
        last, step_s = before[-1], stamp_s - before[-1].stamp_s
        x, y, c, s = moved(last.pose, last.forward_m_s * step_s, last.turn_rad_s * step_s)
        return float(x), float(y), float(c), float(s)

    def cover(self, pose: Pose, stamp_s: float) -> None:
        """Count the floor under the robot ahead of its axle as seen: its front went over that before its sides do."""
        self._hidden = None
        mark_under(self._memory, self._outline.sides, pose, stamp_s, 0.0)

    def see(self, view: DepthView) -> bool:
        """Add what a frame shows; False where nobody knows where the robot was then."""
        self._hidden = None
        pose = self.pose_at(view.stamp_s)
        if pose is None:
            return False
        points = _placed(np.asarray(view.points, float), pose)
        camera = _placed(np.array([view.camera], float), pose)[0]
        first_rad = view.first_rad + float(np.arctan2(pose[3], pose[2]))
        seen_m = np.ascontiguousarray(view.seen_m, float)
        near_far = (min(self._settings.air_m, view.near_m), view.near_m, float(seen_m.max()))
        sight = Sight(float(camera[0]), float(camera[1]), first_rad, view.step_rad, *near_far, seen_m, view.stamp_s)
        look(self._memory, sight, pose[0], pose[1])
        keep(self._memory, points, self._shows_m(view), view.stamp_s, (pose[0], pose[1]), self._way_m)
        self._newest, self._newest_s = points, view.stamp_s
        return True

    def _shows_m(self, view: DepthView) -> FloatArray:
        """(N,) how near to the camera its things would show again: where they did, and where they are high enough."""
        away_m = np.hypot(*(np.asarray(view.points, float) - view.camera).T) - self._settings.cell_m
        if view.shows_m is None:
            return np.asarray(away_m)
        return np.asarray(np.minimum(away_m, np.maximum(view.shows_m, self._settings.air_m)))

    def points_at(self, pose: Pose, now_s: float, reach_m: float) -> FloatArray:
        """(N, 2) things within reach in the frame of a pose: all of the newest frame, and what is remembered.

        That is by the way driven since, which wheels err by, and hardly by time: beside a robot that stays where it is
        a thing stays, too. Where the robot has come to stand since there is none.
        """
        old = self._remembered(pose, now_s, reach_m)
        apart = self._newest - np.array(pose[:2])
        apart = apart[np.hypot(*apart.T) < reach_m]
        R = np.array([[pose[2], -pose[3]], [pose[3], pose[2]]])
        return np.ascontiguousarray(np.concatenate([apart @ R, old[:, :2]]))

    def out_of_sight(self, reach_m: float) -> FloatArray:
        """(N, 2) in the base as it is now: things within reach that are remembered, and that the newest frame lacks."""
        if not self._readings:
            return np.empty((0, 2))
        last = self._readings[-1]
        old = self._remembered(last.pose, last.stamp_s, reach_m)
        return np.asarray(old[old[:, 2] < self._newest_s, :2])

    def _remembered(self, pose: Pose, now_s: float, reach_m: float) -> FloatArray:
        """(N, 3) x and y in the frame of a pose, and when it was seen."""
        s, out = self._settings, np.empty((_MOST_POINTS, 3))
        since = (now_s - s.remember_s, self._way_m - s.remember_m)
        old = out[: remembered(self._memory, pose, since, reach_m, out)]
        within = all_outside_m(self._outline.sides, np.ascontiguousarray(old[:, :2])) < -s.inside_m
        return np.asarray(old[~(within & (old[:, 2] < now_s - s.fresh_s))])

    def hidden_about(self, reach_m: float, deep_m: float) -> FloatArray:
        """(N, 2) in the base as it is now: middles of cells within reach that are so deep in floor never looked at.

        Where the robot was led over it there is floor, but nothing was looked at from there: what is beside that is as
        deep as it was.
        """
        if not self._readings:
            return np.empty((0, 2))
        last, cell_m = self._readings[-1], self._settings.cell_m
        if np.isfinite(reach_m):  # all that is as near as that to floor within reach decides how deep it is
            deep, first = self._hidden_within(reach_m + deep_m)
        else:
            self._hidden = deep, first = self._hidden or self._hidden_within(self._settings.window_m / 2)
        x, y, c, s = last.pose
        away = (np.argwhere(deep > deep_m) + first + 0.5) * cell_m - (x, y)
        away = away[np.hypot(*away.T) < reach_m]
        return np.asarray(away @ np.array([[c, -s], [s, c]]))

    def _hidden_within(self, reach_m: float) -> tuple[Float32Array, tuple[int, int]]:
        """(m, m) metres into floor that no camera has looked at, 0 where it was seen; i and j of the first cell."""
        last = self._readings[-1]
        out, first = self._unseen(last.pose, last.stamp_s, reach_m)
        return np.where(out[..., 0] > 0, _deep_m(out[..., 2], self._settings.cell_m), 0), first

    def unseen_about(self, pose: Pose, now_s: float, reach_m: float) -> Unseen:
        """What was not seen of the floor within reach of a pose."""
        out, first = self._unseen(pose, now_s, reach_m)
        cell_m = self._settings.cell_m
        return Unseen(
            _deep_m(out[..., 0], cell_m), np.ascontiguousarray(out[..., 1]), _deep_m(out[..., 2], cell_m), first
        )

    def _unseen(self, pose: Pose, now_s: float, reach_m: float) -> tuple[ByteArray, tuple[int, int]]:
        """(m, m, 3) 1 where floor was never seen, not lately, and never looked at; i and j of the first cell."""
        s = self._settings
        half = min(int(np.ceil(reach_m / s.cell_m)) + 1, len(self._memory.seen_s) // 2)
        first = (int(np.floor(pose[0] / s.cell_m)) - half, int(np.floor(pose[1] / s.cell_m)) - half)
        out = np.empty((2 * half, 2 * half, 3), np.uint8)
        unseen(self._memory, first, now_s - s.fresh_s, out)
        return out, first


def _deep_m(is_none: ByteArray, cell_m: float) -> Float32Array:
    """(m, m) metres into cells that are 1, to the nearest that is 0."""
    deep = cv2.distanceTransform(np.ascontiguousarray(is_none), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(deep * cell_m, np.float32)


def _around(radius_m: float) -> FloatArray:
    """Sides of a round patch about the axle."""
    return sides_of(Footprint.circle(radius_m))


def _placed(points: FloatArray, pose: Pose) -> FloatArray:
    x, y, c, s = pose
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + np.array([x, y]))
