"""Surroundings: the collision monitor's memory of the floor around the robot.

`DepthViewer` fills it from depth images. `PlanView` tests whether the camera observes the floor along a plan in time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import MapError
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from wheelsight.mapping.occupancy import camera_over_floor
from wheelsight.navigation.clearance_kernels import (
    Memory,
    Outline,
    Sight,
    all_outside_m,
    mark_seen,
    mark_under,
    moved,
    remembered,
    store_hits,
    unseen,
)
from wheelsight.navigation.costmap import CellState, Costmap, checked_depth
from wheelsight.navigation.footprint import Footprint, sides_of
from wheelsight.navigation.settings import LiveLayerSettings, MonitorSettings, ViewSettings
from wheelsight.navigation.view_kernels import (
    Eye,
    Heights,
    Rays,
    Shown,
    Walls,
    first_blind,
    first_over,
    reach,
    sort_pixels,
)

# Pose in the plane of `Surroundings`: x, y, cosine and sine of the yaw.
Pose = tuple[float, float, float, float]
_MOST_POINTS = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class DepthView:
    """A depth frame in the form that the collision monitor uses.

    Attributes:
        stamp_s: time of the frame.
        points: (N, 2) in `base` of obstacles between floor and the robot's height, and of edges where the floor ends.
        camera: x and y of the camera in `base`.
        first_rad: bearing in `base` of the right end of the view.
        step_rad: angle from one column to the next, counter-clockwise.
        seen_m: (B,) distance from the camera to which each column observes the floor or free air; 0 without depth.
        near_m: distance from the camera to the nearest visible floor.
        shows_m: (N,) distance from the camera at which each point would still be visible; None for its own distance.
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
        """Return the view of a camera that looks ahead and has depth everywhere. A column ends at its nearest point.

        Args:
            stamp_s: time of the frame.
            points: (N, 2) in `base`.
            camera: x and y in `base`.
            half_angle_rad: half of the field of view.
            reach_m: distances of the nearest and farthest visible floor.
            columns: number of columns.
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
        """Whether all its numbers are finite, and all shapes are right."""
        numbers = np.array([self.stamp_s, *self.camera, self.first_rad, self.step_rad, self.near_m], float)
        points, seen = np.asarray(self.points), np.asarray(self.seen_m)
        shapes = points.ndim == 2 and points.shape[1:] == (2,) and seen.ndim == 1 and len(seen) > 0
        shows = np.zeros(len(points)) if self.shows_m is None else np.asarray(self.shows_m)
        shapes &= shows.shape == points.shape[:1]
        finite = all(np.isfinite(values).all() for values in (numbers, points, seen, shows))
        return bool(shapes and finite and self.step_rad > 0)

    @property
    def share(self) -> float:
        """Share of the columns that have depth."""
        return float((np.asarray(self.seen_m) > 0).mean())


@dataclass(frozen=True, slots=True, eq=False)
class Unseen:
    """Unseen floor around a robot, in cells; rows along x, columns along y.

    Attributes:
        never_m: (m, m) depth in metres into floor that was never seen nor driven over.
        is_old: (m, m) 1 where it was not seen lately.
        hidden_m: (m, m) depth in metres into floor that no camera has seen, not even the air over it.
        first: i and j of the first cell.
    """

    never_m: Float32Array
    is_old: ByteArray
    hidden_m: Float32Array
    first: tuple[int, int]


@dataclass(frozen=True, slots=True)
class _Reading:
    """A wheel reading, with the pose of the base in the plane."""

    stamp_s: float
    pose: Pose
    forward_m_s: float
    turn_rad_s: float


class Surroundings:
    """Obstacles and seen floor in a plane where wheel odometry gives the robot's pose.

    The plane has a frame of its own, which drifts. Its content is never older than the robot needs to leave it.
    """

    def __init__(self, outline: Outline, settings: MonitorSettings) -> None:
        self._outline, self._settings = outline, settings
        self._readings: deque[_Reading] = deque()
        self._newest = np.empty((0, 2))
        self._newest_s, self._trusted_m, self._way_m = -np.inf, 0.0, 0.0
        # Depth of cells in floor that no camera has seen, for the last reading; None after a change.
        self._hidden: tuple[Float32Array, tuple[int, int]] | None = None
        self._reach_m = float(np.linalg.norm(outline.sides[:, :2], axis=1).max())
        self.forget()

    def forget(self) -> None:
        """Clear everything but the robot's own place."""
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
        """Process a wheel reading; stamps must be in order. `rolled` as in `CollisionMonitor.hear`."""
        self._hidden = None
        if not self._readings:
            pose = (0.0, 0.0, 1.0, 0.0)
            mark_under(self._memory, self._outline.sides, pose, stamp_s, -np.inf)
            if self._trusted_m > 0:
                mark_under(self._memory, sides_of(Footprint.circle(self._trusted_m)), pose, stamp_s, -np.inf)
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
        """Mark the floor within a radius of the axle as seen, now or at the first reading."""
        self._hidden = None
        self._trusted_m = 0.0 if self._readings else radius_m
        if self._readings and radius_m > 0:
            last = self._readings[-1]
            mark_under(self._memory, sides_of(Footprint.circle(radius_m)), last.pose, last.stamp_s, -np.inf)

    def forget_near(self, xy_base: ArrayLike, radius_m: float) -> None:
        """Remove remembered obstacles near a place (2,) in the current base. The next frames show real ones again."""
        if self._readings:
            at = _placed(np.asarray(xy_base, float).reshape(1, 2), self._readings[-1].pose)[0]
            is_near = np.hypot(*np.moveaxis(self._memory.hits[..., :2] - at, -1, 0)) <= radius_m
            self._memory.hit_s[is_near] = -np.inf

    def pose_at(self, stamp_s: float) -> Pose | None:
        """Return the pose of the base at a time, extrapolated if it is later than the readings; None if too early."""
        before = [reading for reading in self._readings if reading.stamp_s <= stamp_s]
        if not before:
            return None
        last, step_s = before[-1], stamp_s - before[-1].stamp_s
        x, y, c, s = moved(last.pose, last.forward_m_s * step_s, last.turn_rad_s * step_s)
        return float(x), float(y), float(c), float(s)

    def cover(self, pose: Pose, stamp_s: float) -> None:
        """Mark the floor under the robot ahead of its axle as seen, as its front covers that before its sides do."""
        self._hidden = None
        mark_under(self._memory, self._outline.sides, pose, stamp_s, 0.0)

    def see(self, view: DepthView) -> bool:
        """Add a frame; return False if the pose at its time is unknown."""
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
        mark_seen(self._memory, sight, pose[0], pose[1])
        # Points become visible again where they were visible, and nearer if they are high enough.
        shows_m = np.asarray(np.hypot(*(np.asarray(view.points, float) - view.camera).T) - self._settings.cell_m)
        if view.shows_m is not None:
            shows_m = np.asarray(np.minimum(shows_m, np.maximum(view.shows_m, self._settings.air_m)))
        store_hits(self._memory, points, shows_m, view.stamp_s, (pose[0], pose[1]), self._way_m)
        self._newest, self._newest_s = points, view.stamp_s
        return True

    def points_at(self, pose: Pose, now_s: float, reach_m: float) -> FloatArray:
        """Return obstacles (N, 2) within reach, in the frame of a pose: all of the newest frame, and remembered ones.

        Memory ends after a distance driven, as wheels drift with it, rather than after a time: beside a robot that
        stands, an obstacle stays. Remembered obstacles under the robot are removed.
        """
        old = self._remembered(pose, now_s, reach_m)
        apart = self._newest - np.array(pose[:2])
        apart = apart[np.hypot(*apart.T) < reach_m]
        R = np.array([[pose[2], -pose[3]], [pose[3], pose[2]]])
        return np.ascontiguousarray(np.concatenate([apart @ R, old[:, :2]]))

    def out_of_sight(self, reach_m: float) -> FloatArray:
        """Return remembered obstacles (N, 2) within reach in the current base that the newest frame lacks."""
        if not self._readings:
            return np.empty((0, 2))
        last = self._readings[-1]
        old = self._remembered(last.pose, last.stamp_s, reach_m)
        return np.asarray(old[old[:, 2] < self._newest_s, :2])

    def _remembered(self, pose: Pose, now_s: float, reach_m: float) -> FloatArray:
        """Return (N, 3), x and y in the frame of a pose, and the time of the observation."""
        s, out = self._settings, np.empty((_MOST_POINTS, 3))
        since = (now_s - s.remember_s, self._way_m - s.remember_m)
        old = out[: remembered(self._memory, pose, since, reach_m, out)]
        within = all_outside_m(self._outline.sides, np.ascontiguousarray(old[:, :2])) < -s.inside_m
        return np.asarray(old[~(within & (old[:, 2] < now_s - s.fresh_s))])

    def hidden_about(self, reach_m: float, deep_m: float) -> FloatArray:
        """Return the centres (N, 2), in the current base, of cells within reach that lie deep in unseen floor.

        Driving over unseen floor shows that there is floor, but not what is beside it: that keeps its depth.

        Args:
            reach_m: distance from the axle.
            deep_m: depth in metres beyond which cells count.
        """
        if not self._readings:
            return np.empty((0, 2))
        last, cell_m = self._readings[-1], self._settings.cell_m
        if np.isfinite(reach_m):  # cells up to `deep_m` beyond the reach affect the depth within it
            deep, first = self._hidden_within(reach_m + deep_m)
        else:
            self._hidden = deep, first = self._hidden or self._hidden_within(self._settings.window_m / 2)
        x, y, c, s = last.pose
        away = (np.argwhere(deep > deep_m) + first + 0.5) * cell_m - (x, y)
        away = away[np.hypot(*away.T) < reach_m]
        return np.asarray(away @ np.array([[c, -s], [s, c]]))

    def _hidden_within(self, reach_m: float) -> tuple[Float32Array, tuple[int, int]]:
        """Return (m, m), the depth in metres into unseen floor, 0 where it was seen, and i and j of the first cell."""
        last = self._readings[-1]
        out, first = self._unseen(last.pose, last.stamp_s, reach_m)
        return np.where(out[..., 0] > 0, _deep_m(out[..., 2], self._settings.cell_m), 0), first

    def unseen_about(self, pose: Pose, now_s: float, reach_m: float) -> Unseen:
        """Return the unseen floor within reach of a pose."""
        out, first = self._unseen(pose, now_s, reach_m)
        cell_m = self._settings.cell_m
        return Unseen(
            _deep_m(out[..., 0], cell_m), np.ascontiguousarray(out[..., 1]), _deep_m(out[..., 2], cell_m), first
        )

    def _unseen(self, pose: Pose, now_s: float, reach_m: float) -> tuple[ByteArray, tuple[int, int]]:
        """Return (m, m, 3), 1 for floor never driven or seen, not seen lately, and never seen; and the first cell."""
        s = self._settings
        half = min(int(np.ceil(reach_m / s.cell_m)) + 1, len(self._memory.seen_s) // 2)
        first = (int(np.floor(pose[0] / s.cell_m)) - half, int(np.floor(pose[1] / s.cell_m)) - half)
        out = np.empty((2 * half, 2 * half, 3), np.uint8)
        unseen(self._memory, first, now_s - s.fresh_s, out)
        return out, first


def _deep_m(is_none: ByteArray, cell_m: float) -> Float32Array:
    """Return (m, m), the distance in metres from cells that are 1 to the nearest that is 0."""
    deep = cv2.distanceTransform(np.ascontiguousarray(is_none), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(deep * cell_m, np.float32)


def _placed(points: FloatArray, pose: Pose) -> FloatArray:
    """Return points (N, 2) of the frame of a pose, in the plane."""
    x, y, c, s = pose
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + np.array([x, y]))


# Fewest columns of an image: pixels of a row must be closer than the bearings.
_LEAST_COLUMNS = 8
# Least width of a bearing in pixels: one between two pixels would see nothing.
_LEAST_PIXELS = 2


class DepthViewer:
    """Extracts from depth images the obstacles, the ends of the floor, and how far the floor is visible.

    Args:
        calibration: of the robot: its depth camera, and the mount of it over the floor.
        footprint: of the robot; points within it are the robot itself.
        settings: None for the defaults.
        heights: limits between floor and obstacles; None for the defaults.

    Attributes:
        near_m: distance from the axle to the nearest floor that is visible at all bearings.
        half_rad: half of the field of view that all rows share.
        camera: x and y of the camera in `base`.

    Raises:
        CalibrationError: there is no camera.
        MapError: the mount of the camera is unknown, or the camera sees no floor.
    """

    def __init__(
        self,
        calibration: Calibration,
        footprint: Footprint,
        settings: ViewSettings | None = None,
        heights: LiveLayerSettings | None = None,
    ) -> None:
        T_base_camera = camera_over_floor(calibration)
        _, self._camera = calibration.cameras
        self._settings, self._footprint = settings or ViewSettings(), footprint
        limits = heights or LiveLayerSettings()
        self._heights = Heights(**{name: getattr(limits, name) for name in Heights._fields})
        ways = self._camera.rays() @ T_base_camera[:3, :3].T
        self._count = min(self._settings.columns, ways.shape[1] // _LEAST_PIXELS)
        self._first_rad, self._step_rad, columns = _bearings(ways, self._count)
        self.half_rad: float = self._step_rad * self._count / 2
        where = np.ascontiguousarray(T_base_camera[:3, 3])
        self.camera: tuple[float, float] = (float(where[0]), float(where[1]))
        self._rays = Rays(np.ascontiguousarray(ways, np.float32), columns, where)
        self._near_m = _near_floor_m(ways, columns, float(where[2]))
        self.near_m = self._near_m + float(np.hypot(*where[:2]))

    def view(self, depth_m: ArrayLike, stamp_s: float) -> DepthView:
        """Return the view of a depth image (H, W) in metres; pixels that are 0 or not finite have no depth.

        Raises:
            ArgumentError: the image has another size.
        """
        depth = checked_depth(depth_m, self._camera)
        s, far_m = self._settings, self._heights.far_m
        side = 2 * int(np.ceil((far_m + np.hypot(*self._rays.camera[:2])) / s.cell_m) + 1)
        floor = np.zeros((self._count, int(np.ceil(far_m / s.bin_m))), np.uint8)
        shown = Shown(
            floor,
            np.zeros((side, side, 3), np.float32),
            np.zeros((side, side, s.pixels), np.float32),
            np.zeros(self._count, np.int64),
            s.bin_m,
            s.cell_m,
        )
        sort_pixels(depth, self._rays, self._heights, shown)
        is_thing, points, tops_m = self._things(shown)
        thing_m = np.full(self._count, np.inf)
        reach(depth, self._rays, self._heights, shown, is_thing, thing_m)
        floor_m = _floor_until_m(shown.floor, s.gap_m, s.bin_m, self._near_m)
        # Each bearing sees along floor without long gaps, or to an obstacle on the last visible floor, or nearer.
        reached = thing_m <= np.maximum(floor_m, self._near_m) + s.gap_m
        seen_m = np.where(shown.measured >= s.pixels, np.where(reached, thing_m, np.minimum(floor_m, far_m)), 0.0)
        # Nearer than this, an obstacle is below the lowest ray.
        shows_m = np.asarray(self._near_m * np.maximum(1 - tops_m / float(self._rays.camera[2]), 0.0))
        return DepthView(stamp_s, points, self.camera, self._first_rad, self._step_rad, seen_m, self._near_m, shows_m)

    def _things(self, shown: Shown) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Return the obstacles besides the robot itself.

        The height of a cell is the one that enough pixels of it, or of a neighbour, exceed: few pixels show a surface
        that grazes the cell.

        Returns:
            (n, n) bool of cells with an obstacle, (N, 2) places in the base, and (N,) heights in metres.
        """
        is_thing = shown.cells[..., 0] >= self._settings.pixels
        some = shown.cells[is_thing].astype(float)
        points = some[:, 1:] / some[:, :1]
        is_thing[is_thing] = is_other = ~self._footprint.contains(points)
        tops_m = cv2.dilate(np.ascontiguousarray(shown.tops[..., -1]), np.ones((3, 3), np.uint8))
        return is_thing, np.asarray(points[is_other]), np.asarray(tops_m[is_thing], float)


def _bearings(ways: FloatArray, count: int) -> tuple[float, float, IntArray]:
    """Return first bearing and step of the view that all rows share, and the index (h, w) of each pixel's bearing."""
    middle = float(np.arctan2(*ways.mean(axis=(0, 1))[1::-1]))
    turned = np.arctan2(ways[..., 1], ways[..., 0]) - middle
    bearing = (turned + np.pi) % (2 * np.pi) - np.pi
    first, last = float(bearing.min(axis=1).max()), float(bearing.max(axis=1).min())
    if last <= first or ways.shape[1] < _LEAST_COLUMNS:
        raise MapError("the camera sees no floor ahead", fix="check T_base_camera in the calibration")
    step = (last - first) / count
    number = np.floor((bearing - first) / step)
    number[(number < 0) | (number >= count)] = -1
    return first + middle, step, number.astype(np.int16)


def _near_floor_m(ways: FloatArray, columns: IntArray, height_m: float) -> float:
    """Return the distance from the camera to the nearest floor that is visible at all bearings."""
    down = np.where(columns >= 0, -ways[..., 2], 0)
    along = np.hypot(ways[..., 0], ways[..., 1])
    with np.errstate(divide="ignore"):
        way_m = np.where(down > 0, along * height_m / np.maximum(down, 1e-9), np.inf)
    near_m = np.array([way_m[columns == number].min(initial=np.inf) for number in range(int(columns.max()) + 1)])
    if not np.isfinite(near_m).all():
        raise MapError("the camera sees no floor", fix="check T_base_camera in the calibration, or tilt the camera")
    return float(near_m.max())


def _floor_until_m(floor: IntArray, gap_m: float, bin_m: float, near_m: float) -> FloatArray:
    """Return (columns,) where floor that begins at the nearest visible distance ends; 0 if it begins farther away."""
    begin = near_m / bin_m
    last, is_on = np.full(len(floor), begin), np.ones(len(floor), bool)
    for at, is_seen in enumerate(floor.T.astype(bool)):
        is_on &= ~is_seen | (at - last <= max(round(gap_m / bin_m), 1))
        last = np.where(is_seen & is_on, np.maximum(last, at + 1.0), last)
    return np.where(last > begin, last * bin_m, 0.0)


# Poses of a plan between a frame and its use, about 0.1 m.
_LAG = 2


class PlanView:
    """Tests whether the camera sees the floor along a plan before the robot drives over it.

    Unseen floor beside a robot blocks a turn into it, but not a path that comes round and faces it.

    Args:
        footprint: of the robot.
        eye: its camera.
    """

    def __init__(self, footprint: Footprint, eye: Eye) -> None:
        self._sides, self._eye = sides_of(footprint), eye

    def first_blind(self, poses: FloatArray, hidden: FloatArray, costmap: Costmap) -> int | None:
        """Return the index of the first pose over hidden floor that no earlier pose observes; None without any.

        Args:
            poses: (N, 3) x, y, yaw of `base`, dense, in the frame of the costmap; the robot is at the first.
            hidden: (M, 3) x and y of unseen floor, and how near the camera must look to observe it, metres.
            costmap: its obstacles hide what is behind them.
        """
        points, slack_m = np.ascontiguousarray(hidden[:, :2]), np.ascontiguousarray(hidden[:, 2])
        ways, over = np.ascontiguousarray(poses, float), np.empty(len(points), np.int64)
        first_over(ways, points, self._sides, over)
        is_met = over < len(ways)
        is_there = np.ascontiguousarray(costmap.state == CellState.OCCUPIED)
        walls = Walls(is_there, costmap.resolution_m, costmap.origin)
        found = int(first_blind(ways, points[is_met], slack_m[is_met], over[is_met], self._eye, walls, _LAG))
        return found if found < len(ways) else None
