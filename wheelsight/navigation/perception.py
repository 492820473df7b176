"""Perception: obstacles, visible floor and people in depth images.

`DepthViewer` extracts what the collision monitor needs. `LiveLayer` keeps obstacles as cells, cleared by ray casting.
`PeopleTracker` detects walking people, and tracks them with constant-velocity Kalman filters.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, IntArray, PinholeCamera, chi_square, se2
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.mapping.occupancy import camera_over_floor
from wheelsight.navigation.costmap import LiveObstacles
from wheelsight.navigation.costmap_kernels import (
    ClearingRules,
    DepthPixels,
    LayerHeights,
    RayNoise,
    Rays,
    ViewContent,
    ViewHeights,
    any_left,
    mark_met,
    mark_passed,
    reach,
    remember,
    sort_pixels,
)
from wheelsight.navigation.settings import Footprint, LiveLayerSettings

# Depth below the floor at which a ray shows missing floor, and the addition to it, and to the height of obstacles, per
# metre of distance, as the mount is known to a degree: as the occupancy map's, docs/occupancy.md.
_DROP_M, _TILT_RAD = 0.1, 0.015


@dataclass(frozen=True, slots=True, eq=False)
class DepthView:
    """A depth frame in the form that the collision monitor uses.

    Attributes:
        points: (N, 2) in `base` of obstacles between floor and the robot's height, and of edges where the floor ends.
        camera: x and y of the camera in `base`.
        first_rad: bearing in `base` of the right end of the view.
        step_rad: angle from one column to the next, counter-clockwise.
        seen_m: (B,) distance from the camera to which each column observes the floor or free air; 0 without depth.
        near_m: distance from the camera to the nearest visible floor.
        shows_m: (N,) distance from the camera at which each point would still be visible; None for its own distance.
        voids: (M, 2) in `base` where floor is expected, and no depth comes back.
    """

    stamp_s: float
    points: FloatArray
    camera: tuple[float, float]
    first_rad: float
    step_rad: float
    seen_m: FloatArray
    near_m: float
    shows_m: FloatArray | None = None
    voids: FloatArray = field(default_factory=lambda: np.empty((0, 2)))

    @property
    def is_sound(self) -> bool:
        """Whether all its numbers are finite, and all shapes are right."""
        numbers = np.array([self.stamp_s, *self.camera, self.first_rad, self.step_rad, self.near_m], float)
        points, seen = np.asarray(self.points), np.asarray(self.seen_m)
        shapes = points.ndim == 2 and points.shape[1:] == (2,) and seen.ndim == 1 and len(seen) > 0
        shows = np.zeros(len(points)) if self.shows_m is None else np.asarray(self.shows_m)
        shapes &= shows.shape == points.shape[:1]
        finite = all(np.isfinite(values).all() for values in (numbers, points, seen, shows, self.voids))
        return bool(shapes and finite and self.step_rad > 0)

    @property
    def share(self) -> float:
        """Share of the columns that have depth."""
        return float((np.asarray(self.seen_m) > 0).mean())


# Bearings of the view, at most one per two pixels of a row: 0.9° each with a Kinect.
_VIEW_COLUMNS = 64
# Side of the cells that collect pixels of an obstacle, and the least pixels of one: at edges single pixels are wrong.
_VIEW_CELL_M, _VIEW_PIXELS = 0.05, 3
# Bins of distance for visible floor, and the longest gap in it, beyond which floor does not count: an obstacle above a
# chair's step hides more.
_VIEW_BIN_M, _VIEW_GAP_M = 0.1, 0.3
# Fewest columns of an image: pixels of a row must be closer than the bearings.
_LEAST_COLUMNS = 8
# Least width of a bearing in pixels: one between two pixels would see nothing.
_LEAST_PIXELS = 2
# Floor without depth: the part of a place's pixels that have none, as black mats return a few; its least extent, beyond
# the shadow of a Kinect's projector beside an edge (0.08 m); and how far beyond the nearest visible floor it counts:
# dark floor is seen from near, and a stop takes 1.3 m.
_VOID_SHARE, _VOID_M, _VOID_REACH_M = 0.8, 0.25, 1.5


class DepthViewer:
    """Extracts from depth images the obstacles, the ends of the floor, and how far the floor is visible.

    Args:
        footprint: of the robot; points within it are the robot itself.

    Attributes:
        near_m: distance from the axle to the nearest floor that is visible at all bearings.
        half_rad: half of the field of view that all rows share.
        camera: x and y of the camera in `base`.

    Raises CalibrationError if there is no camera, and MapError if the mount of the camera is unknown, or the camera
    sees no floor.
    """

    def __init__(
        self, calibration: Calibration, footprint: Footprint, settings: LiveLayerSettings | None = None
    ) -> None:
        T_base_camera = camera_over_floor(calibration)
        _, self._camera = calibration.cameras
        self._footprint, s = footprint, settings or LiveLayerSettings()
        self._heights = ViewHeights(s.floor_m, _DROP_M, _TILT_RAD, s.height_m, s.far_m)
        ways = self._camera.rays() @ T_base_camera[:3, :3].T
        self._count = min(_VIEW_COLUMNS, ways.shape[1] // _LEAST_PIXELS)
        # First bearing and step of the view that all rows share, and the index (h, w) of each pixel's bearing.
        middle = float(np.arctan2(*ways.mean(axis=(0, 1))[1::-1]))
        turned = np.arctan2(ways[..., 1], ways[..., 0]) - middle
        bearing = (turned + np.pi) % (2 * np.pi) - np.pi
        first, last = float(bearing.min(axis=1).max()), float(bearing.max(axis=1).min())
        if last <= first or ways.shape[1] < _LEAST_COLUMNS:
            raise MapError("the camera sees no floor ahead", fix="check T_base_camera in the calibration")
        self._first_rad, self._step_rad = first + middle, (last - first) / self._count
        numbers = np.floor((bearing - first) / self._step_rad)
        numbers[(numbers < 0) | (numbers >= self._count)] = -1
        columns = numbers.astype(np.int16)
        self.half_rad: float = self._step_rad * self._count / 2
        where = np.ascontiguousarray(T_base_camera[:3, 3])
        self.camera: tuple[float, float] = (float(where[0]), float(where[1]))
        # The distance from the camera to the nearest floor that is visible at all bearings.
        down, along = np.where(columns >= 0, -ways[..., 2], 0), np.hypot(ways[..., 0], ways[..., 1])
        with np.errstate(divide="ignore"):
            way_m = np.where(down > 0, along * float(where[2]) / np.maximum(down, 1e-9), np.inf)
        near_m = np.array([way_m[columns == number].min(initial=np.inf) for number in range(int(columns.max()) + 1)])
        if not np.isfinite(near_m).all():
            raise MapError("the camera sees no floor", fix="check T_base_camera in the calibration, or tilt the camera")
        self._near_m = float(near_m.max())
        self.near_m = self._near_m + float(np.hypot(*where[:2]))
        # Distance of the floor that each ray should measure, within the depths that the camera is trusted with.
        noise, far_m = calibration.depth_noise, min(s.far_m, self._near_m + _VOID_REACH_M)
        z_m = way_m / np.maximum(along, 1e-9)
        is_expected = (columns >= 0) & (z_m >= noise.near_m) & (z_m <= noise.far_m) & (way_m < far_m)
        floor_m = np.where(is_expected, way_m, 0).astype(np.float32)
        self._rays = Rays(np.ascontiguousarray(ways, np.float32), columns, where, floor_m)
        # Bearing and bin of the cells of a square before the camera, and which of them have floor that it should see.
        ahead = (np.arange(int(far_m / _VIEW_CELL_M)) + 0.5) * _VIEW_CELL_M
        x, y = np.meshgrid(ahead, np.r_[-ahead[::-1], ahead], indexing="ij")
        number = (np.arctan2(y, x) + middle - self._first_rad) / self._step_rad
        self._void_at = np.floor(number).astype(int), (np.hypot(x, y) / _VIEW_BIN_M).astype(int)
        self._is_void_at = (self._void_at[0] >= 0) & (self._void_at[0] < self._count) & (np.hypot(x, y) < far_m)

    def view(
        self, depth_m: ArrayLike, stamp_s: float, carries: Callable[[FloatArray], BoolArray] | None = None
    ) -> DepthView:
        """Return the view of a depth image (H, W) in metres; pixels that are 0 or not finite have no depth.

        Args:
            carries: which points (N, 2) in `base` are floor, though no depth comes back from there.

        Raises ArgumentError if the image has another size.
        """
        depth = checked_depth(depth_m, self._camera)
        far_m = self._heights.far_m
        side = 2 * int(np.ceil((far_m + np.hypot(*self._rays.camera[:2])) / _VIEW_CELL_M) + 1)
        floor = np.zeros((self._count, int(np.ceil(far_m / _VIEW_BIN_M))), np.uint8)
        shown = ViewContent(
            floor,
            np.zeros((side, side, 3), np.float32),
            np.zeros((side, side, _VIEW_PIXELS), np.float32),
            np.zeros(self._count, np.int64),
            np.zeros((*floor.shape, 2), np.int64),
            np.full(floor.shape, np.inf),
            _VIEW_BIN_M,
            _VIEW_CELL_M,
        )
        sort_pixels(depth, self._rays, self._heights, shown)
        # Obstacles besides the robot itself. The height of a cell is the one that enough pixels of it, or of a
        # neighbour, exceed: few pixels show a surface that grazes the cell.
        is_thing = shown.cells[..., 0] >= _VIEW_PIXELS
        some = shown.cells[is_thing].astype(float)
        points = some[:, 1:] / some[:, :1]
        is_thing[is_thing] = is_other = ~self._footprint.contains(points)
        dilated_m = cv2.dilate(np.ascontiguousarray(shown.tops[..., -1]), np.ones((3, 3), np.uint8))
        points, tops_m = np.asarray(points[is_other]), np.asarray(dilated_m[is_thing], float)
        thing_m = np.full(self._count, np.inf)
        reach(depth, self._rays, self._heights, shown, is_thing, thing_m)
        voids, void_m = self._voids(shown, carries)
        # Where floor that begins at the nearest visible distance ends; 0 if it begins farther away.
        begin = self._near_m / _VIEW_BIN_M
        last, is_on = np.full(len(floor), begin), np.ones(len(floor), bool)
        for at, is_seen in enumerate(floor.T.astype(bool)):
            is_on &= ~is_seen | (at - last <= max(round(_VIEW_GAP_M / _VIEW_BIN_M), 1))
            last = np.where(is_seen & is_on, np.maximum(last, at + 1.0), last)
        floor_m = np.where(last > begin, last * _VIEW_BIN_M, 0.0)
        # A bearing that sees nothing but a hole sees, though no floor.
        floor_m = np.where(np.isfinite(void_m), np.maximum(np.minimum(floor_m, void_m), _VIEW_BIN_M), floor_m)
        # Each bearing sees along floor without long gaps, or to an obstacle on the last visible floor, or nearer.
        reached = thing_m <= np.maximum(floor_m, self._near_m) + _VIEW_GAP_M
        seen_m = np.where(shown.measured >= _VIEW_PIXELS, np.where(reached, thing_m, np.minimum(floor_m, far_m)), 0.0)
        # Nearer than this, an obstacle is below the lowest ray.
        shows_m = np.asarray(self._near_m * np.maximum(1 - tops_m / float(self._rays.camera[2]), 0.0))
        place = self.camera, self._first_rad, self._step_rad
        return DepthView(stamp_s, points, *place, seen_m, self._near_m, shows_m, voids)

    def _voids(
        self, shown: ViewContent, carries: Callable[[FloatArray], BoolArray] | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return (M, 2) places in `base` where floor is expected and none returns a depth, and (B,) where they begin.

        Places that carry the robot become floor of `shown`. Edges are the nearest pixels without depth.
        """
        lacking, having = np.moveaxis(shown.lacks, -1, 0)
        # A bin that no pixel meets is as the one before it.
        for n in range(1, lacking.shape[1]):
            is_between = lacking[:, n] + having[:, n] == 0
            lacking[is_between, n], having[is_between, n] = lacking[is_between, n - 1], having[is_between, n - 1]
        is_void = (lacking > 0) & (lacking >= _VOID_SHARE * (lacking + having))
        column, at = (np.where(self._is_void_at, numbers, 0) for numbers in self._void_at)
        wide = np.ones((round(_VOID_M / _VIEW_CELL_M),) * 2, np.uint8)
        cells = (is_void[column, at] & self._is_void_at).astype(np.uint8)
        cells = cv2.morphologyEx(cells, cv2.MORPH_OPEN, wide, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        is_wide = np.zeros(is_void.shape, np.uint8)
        is_wide[column[cells > 0], at[cells > 0]] = 1
        # The bins at its edges show floor in part.
        is_void = (cv2.dilate(is_wide, np.ones((3, 3), np.uint8)) > 0) & (lacking > 0)
        columns, bins = np.nonzero(is_void)
        begin_m = shown.lacks_m[columns, bins]
        away_m = np.where(np.isfinite(begin_m), begin_m, (bins + 0.5) * _VIEW_BIN_M)
        bearing = self._first_rad + (columns + 0.5) * self._step_rad
        points = away_m[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1) + self.camera
        if carries is not None and len(points):
            is_floor = carries(points)
            shown.floor[columns[is_floor], bins[is_floor]] = 1
            columns, away_m, points = columns[~is_floor], away_m[~is_floor], points[~is_floor]
        void_m = np.full(len(is_void), np.inf)
        np.minimum.at(void_m, columns, away_m)
        return points, void_m


# Side of the square around the robot, farther than the camera sees, and of a cell, as Nav2's maps have it; metres.
LIVE_SIZE_M, _RESOLUTION_M = 14.0, 0.05
# Height of a layer, metres, as the occupancy map's: a ray below a table does not clear its top.
_LAYER_M = 0.1
# Least time between images that are used; the collision monitor uses all of them, and two cores have no time for more.
_PERIOD_S = 0.09
# Columns of square blocks of pixels, the same number in large images, so that they take no longer. Each block clears as
# one ray, up to its nearest pixel, if this share of its pixels has a depth: black surfaces and glass have none.
_COLUMNS, _MEASURED = 80, 0.5
# Images that must see through a layer of a cell before its obstacle is removed: one may look past a leg of a chair; at
# 5 images per second that takes less than half a second.
_PASSES = 2
# An obstacle younger than this may be a person who passes by: plans cross it, and controllers avoid it or wait, which
# takes less than a detour; a person crosses a path in 1.5 s.
_STANDING_S = 2.0
# Time after which an obstacle out of view is removed that was seen only for a moment, and the factor of the time that
# it was seen, which is added: after 3 s it stays for half a minute.
_FORGET_S, _STAYS = 3.0, 10.0
# An obstacle that has stood for this time is not a person who walks: a recovery removes all others, so that people who
# have left do not remain.
SETTLED_S = 10.0
# Part of a ray before its end that clears nothing: these standard deviations of depth, and a cell.
_MARGIN_SIGMAS = 3.0
# An obstacle in view, but not in the images of `_LOOKED_S`, has no depth behind it: five images would clear it.
# Bearings have columns of a degree or two, and the edge of the view does not count.
_LOOKED_S, _LOOK_COLUMNS, _WITHIN = 1.0, 32, 0.9


class LiveLayer:
    """Cells around a robot with the obstacles of its camera, in layers of height.

    A cell is occupied from the first image that shows an obstacle in it. It is free once some images have seen through
    all its occupied layers. Outside the view it stays until the robot is half the layer's size away. An obstacle that
    was seen only briefly is removed sooner, as it may be a person. The robot's own place is free.

    Raises CalibrationError if there is no camera, and MapError if the mount of the camera is unknown.
    """

    def __init__(
        self,
        calibration: Calibration,
        footprint: Footprint,
        settings: LiveLayerSettings | None = None,
        frame: str = "odom",
    ) -> None:
        self._T_base_camera, self._noise = camera_over_floor(calibration), calibration.depth_noise
        _, self._camera = calibration.cameras
        self._slopes = np.ascontiguousarray(self._camera.rays()[..., :2], np.float32)
        self.frame, self._footprint, s = frame, footprint, settings or LiveLayerSettings()
        pixels = max(1, round(self._camera.width / _COLUMNS))
        self._heights = LayerHeights(
            _RESOLUTION_M, s.floor_m, _DROP_M, _TILT_RAD, _LAYER_M, s.height_m, s.far_m, _MEASURED, pixels
        )
        side = math.ceil(LIVE_SIZE_M / _RESOLUTION_M)
        layers = max(1, math.ceil((s.height_m - s.floor_m) / _LAYER_M))
        self._low: IntArray = np.zeros(2, np.int64)  # row and column of cell (0, 0), from the frame's origin
        self._left = np.zeros((side, side, layers + 1), np.uint8)
        self._seen = np.zeros_like(self._left)
        self._met_s = np.full((side, side, 2), (np.inf, -np.inf))  # first and last
        self._newest_s = -math.inf
        self._known: LiveObstacles | None = None  # cached; None after a change

    def is_due(self, stamp_s: float) -> bool:
        """Return whether `_PERIOD_S` has passed since the last image, or the clock was set back."""
        return not 0 <= stamp_s - self._newest_s < _PERIOD_S

    def update(self, depth_m: ArrayLike, pose: ArrayLike, stamp_s: float) -> None:
        """Process a depth image.

        Args:
            depth_m: (H, W) metres; values that are not finite and over 0 have no depth.
            pose: (3,) x, y, yaw of `base` in the layer's frame at that time.

        Raises ArgumentError if the image has another size, or pose or stamp is not finite. The layer stays as it is.
        """
        depth, at = checked_depth(depth_m, self._camera), np.asarray(pose, float)
        if at.shape != (3,) or not np.isfinite(at).all() or not math.isfinite(stamp_s):
            raise ArgumentError(f"pose {at} at {stamp_s} s", fix="give x, y and yaw of the base, and when, finite")
        # Move the window to the pose, by whole cells.
        side, size_m = len(self._left), _RESOLUTION_M
        low = np.floor(at[1::-1] / size_m).astype(np.int64) - side // 2
        if (low != self._low).any():
            moved, met_s = np.zeros_like(self._left), np.full_like(self._met_s, (np.inf, -np.inf))
            ends = np.maximum(low, self._low), np.minimum(low, self._low) + side
            if (ends[0] < ends[1]).all():
                to, of = (tuple(map(slice, ends[0] - begin, ends[1] - begin)) for begin in (low, self._low))
                moved[to], met_s[to] = self._left[of], self._met_s[of]
            self._low, self._left, self._met_s = low, moved, met_s
        # Cells that lie completely under the robot, which is in the middle of the layer.
        is_own = np.zeros((side, side), bool)
        outline = self._footprint.at(at) / size_m - self._low[::-1]
        left, bottom = np.floor(outline.min(axis=0)).astype(int)
        right, top = np.ceil(outline.max(axis=0)).astype(int)
        corners = np.stack(np.meshgrid(np.arange(left, right + 1), np.arange(bottom, top + 1)), axis=-1)
        c, s = np.cos(at[2]), np.sin(at[2])
        inside = self._footprint.contains(((corners + self._low[::-1]) * size_m - at[:2]) @ np.array([[c, -s], [s, c]]))
        is_own[bottom:top, left:right] = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]
        # From the camera to column and row in cells, and height.
        T_frame_base = np.array([[c, -s, 0, at[0]], [s, c, 0, at[1]], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        M = np.asarray((T_frame_base @ self._T_base_camera)[:3])
        M[:2] /= _RESOLUTION_M
        M[:2, 3] -= self._low[::-1]
        view = DepthPixels(depth, self._slopes, np.ascontiguousarray(M))
        noise = RayNoise(self._noise.constant_m, self._noise.quadratic_per_m, _MARGIN_SIGMAS)
        mark_met(view, self._heights, is_own, self._seen)
        mark_passed(view, self._heights, noise, self._seen)
        # An image without depth removes nothing.
        forget_s = _FORGET_S if self._seen.any() else math.inf
        rules = ClearingRules(_PASSES, forget_s, _STAYS)
        remember(self._seen, is_own, self._left, self._met_s, stamp_s, rules)
        self._newest_s, self._known = stamp_s, None

    def obstacles(self) -> LiveObstacles:
        """Return the current obstacles."""
        if self._known is None:
            y, x = (_RESOLUTION_M * self._low).tolist()
            is_left = any_left(self._left)
            is_standing = is_left & (self._newest_s - self._met_s[..., 0] >= _STANDING_S)
            stamp_s = self._newest_s if math.isfinite(self._newest_s) else None
            self._known = LiveObstacles(is_left, _RESOLUTION_M, (x, y), self.frame, stamp_s, is_standing)
        return self._known

    def clear(self, stood_s: float = math.inf) -> None:
        """Remove the obstacles that were seen for less time than `stood_s`; by default all."""
        self._left[~self._has_stood(stood_s)] = 0
        self._known = None

    def clear_ahead(self, stood_s: float, eye: ArrayLike, half_view_rad: float) -> None:
        """Remove such obstacles within a camera's view only. Real ones return with the next image.

        Args:
            eye: (3,) x, y and heading of the camera in the layer's frame.
        """
        x, y, yaw = map(float, np.asarray(eye, float))
        rows, columns = np.indices(self._left.shape[:2])
        size_m, (row, column) = _RESOLUTION_M, self._low.tolist()
        to_x, to_y = (columns + column + 0.5) * size_m - x, (rows + row + 0.5) * size_m - y
        is_ahead = np.abs(wrap_angle(np.arctan2(to_y, to_x) - yaw)) < half_view_rad
        self._left[is_ahead & ~self._has_stood(stood_s)] = 0
        self._known = None

    def _has_stood(self, stood_s: float) -> BoolArray:
        """Return (N, N) whether the obstacle of each cell was seen for at least `stood_s`."""
        return np.asarray(self._met_s[..., 1] - self._met_s[..., 0] >= stood_s)

    def not_seen_through(self, eye: ArrayLike, half_view_rad: float, near_m: float) -> FloatArray:
        """Return (N, 2) places of obstacles in view that no recent image shows, and that cannot be cleared.

        Nothing hides such an obstacle, but there is no depth behind it, as in front of a hall, a window or black
        surfaces. It stays, since glass and black objects give no depth themselves.

        Args:
            eye: (3,) x, y and heading of the camera in the layer's frame.
            near_m: distance of the nearest visible floor; nearer obstacles may be below the view.
        """
        x, y, yaw = map(float, np.asarray(eye, float))
        cells = np.argwhere(any_left(self._left))
        places = ((cells + self._low)[:, ::-1] + 0.5) * _RESOLUTION_M
        away_m = np.hypot(*(places - (x, y)).T)
        bearing = wrap_angle(np.arctan2(places[:, 1] - y, places[:, 0] - x) - yaw)
        is_met = self._newest_s - self._met_s[cells[:, 0], cells[:, 1], 1] <= _LOOKED_S
        column = np.clip((bearing / half_view_rad + 1) / 2 * _LOOK_COLUMNS, 0, _LOOK_COLUMNS - 1).astype(np.int64)
        hides_m = np.full(_LOOK_COLUMNS, np.inf)
        np.minimum.at(hides_m, column[is_met], away_m[is_met])
        # Near the camera a cell is wider than a column.
        hides_m = np.minimum(hides_m, np.minimum(np.r_[hides_m[1:], np.inf], np.r_[np.inf, hides_m[:-1]]))
        is_looked_at = (np.abs(bearing) < _WITHIN * half_view_rad) & (away_m > near_m) & (away_m < self._heights.far_m)
        return np.asarray(places[~is_met & is_looked_at & (away_m < hides_m[column])])

    def wipe(self, ends: ArrayLike, radius_m: float) -> None:
        """Remove obstacles within a radius of a line between places (2, 2). Real ones return with the next image."""
        a, b = np.asarray(ends, float)
        cells = np.argwhere(any_left(self._left))
        places = ((cells + self._low)[:, ::-1] + 0.5) * _RESOLUTION_M
        share = np.clip((places - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-9), 0, 1)
        near = cells[np.hypot(*(places - a - share[:, None] * (b - a)).T) <= radius_m]
        self._left[near[:, 0], near[:, 1]] = 0
        self._known = None


def checked_depth(depth_m: ArrayLike, camera: PinholeCamera) -> Float32Array:
    """Return (H, W) metres, contiguous. Raises ArgumentError if the image has another size than the camera's."""
    depth = np.ascontiguousarray(depth_m, np.float32)
    if depth.shape != (camera.height, camera.width):
        fix = f"give {camera.height} rows of {camera.width}, as the calibration says"
        raise ArgumentError(f"a depth image of shape {depth.shape}", fix=fix)
    return depth


# Longest gap between points of one object: stepping legs, and points of a wall at a grazing angle, whose gaps move with
# the camera.
_GAP_M = 0.4
# Least cells of an object, and the largest width of a person.
_LEAST_POINTS, _WIDEST_M = 3, 1.0
# Radius of a person; only the near side is visible. Neufert: 0.5 m from elbow to elbow.
_BODY_M = 0.25
# Standard deviation of an object's centre, half the swing of arms; and across, per metre of distance, the heading of a
# frame's pose.
SIGMA_M, _SIGMA_RAD = 0.05, 0.01
# Prior standard deviation of a speed, a walk; and the growth of its variance per second: people keep their speed for
# some seconds.
WALK_M_S, CHANGE_M2_S3 = 1.0, 0.1
# Quantiles of χ²: of the gate between an observation and a track, and beyond which a speed is significant.
_GATE, _SURE = 0.99, 0.99
# Frames with an object before it may count as a person, half a second of a Kinect; the least motion in them, as shapes
# shift by less with the point of view; and the least speed of a walk.
_FRAMES, _WAY_M, _LEAST_M_S = 5, 0.2, 0.3
# Time out of sight after which a track ends (issue 32).
_UNSEEN_S = 1.0
# Columns beside an object in which a nearer one would hide a part of it.
_BESIDE = 2


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """A walking person.

    Attributes:
        position: (2,) metres.
        velocity: (2,) metres per second.
        covariance: (4, 4) of both.
    """

    position: FloatArray
    velocity: FloatArray
    covariance: FloatArray
    radius_m: float

    def carried(self, T: FloatArray) -> Person:
        """Return the person in another frame; T (3,) x, y, yaw maps points there."""
        M = se2.from_parts(*T)
        R = M[:2, :2]
        both = np.kron(np.eye(2), R)
        return Person(R @ self.position + M[:2, 2], R @ self.velocity, both @ self.covariance @ both.T, self.radius_m)


class PeopleTracker:
    """Tracks people in `odom` by nearest neighbours and a Kalman filter each.

    `odom` never jumps. Objects that stand are no people; they stay in the live layer.
    """

    def __init__(self, far_m: float = 4.5) -> None:
        self._far_m = far_m
        self._gate, self._sure = (chi_square.quantile(share, 2) for share in (_GATE, _SURE))
        self._tracked: list[_Tracked] = []

    def forget(self) -> None:
        """Drop all tracks."""
        self._tracked.clear()

    def update(self, view: DepthView, pose: FloatArray, is_on_floor: BoolArray) -> None:
        """Update the tracks with a frame.

        Args:
            pose: (3,) x, y, yaw of the base in `odom` at its time.
            is_on_floor: (N,) whether each point lies on free floor of the map, away from obstacles.
        """
        T = se2.from_parts(*pose)
        R = T[:2, :2]
        seen = [
            Detection(R @ detection.middle + T[:2, 2], R @ detection.covariance @ R.T, detection.radius_m)
            for detection in detections_in(view, is_on_floor, self._far_m)
        ]
        for one in self._tracked:
            one.track.predict(view.stamp_s)
        # The track of each object by its number: nearest pairs first, each track once.
        ways = sorted(
            (one.track.distance(detection.middle, detection.covariance), number, k)
            for number, detection in enumerate(seen)
            for k, one in enumerate(self._tracked)
        )
        pairs: dict[int, _Tracked] = {}
        for distance, number, k in ways:
            one = self._tracked[k]
            if distance <= self._gate and number not in pairs and one not in pairs.values():
                pairs[number] = one
        for number, one in pairs.items():
            one.update(seen[number], view.stamp_s, self._sure)
        self._tracked = [one for one in self._tracked if view.stamp_s - one.seen_s <= _UNSEEN_S]
        self._tracked += [_Tracked(detection, view.stamp_s) for k, detection in enumerate(seen) if k not in pairs]

    def people(self, now_s: float) -> tuple[Person, ...]:
        """Return the walking people, in `odom`, predicted to a time."""
        return tuple(one.person(now_s) for one in self._tracked if one.walks)


class _Tracked:
    """An object that is tracked from frame to frame."""

    def __init__(self, detection: Detection, stamp_s: float) -> None:
        self.track = PersonTrack(stamp_s, detection.middle, detection.covariance)
        self.seen_s, self.walks, self._radius_m = stamp_s, False, detection.radius_m
        self._middles = deque([detection.middle], _FRAMES)

    def update(self, detection: Detection, stamp_s: float, sure: float) -> None:
        """Update it by an observation. It walks if it is significantly fast, and has left its place."""
        self.track.correct(detection.middle, detection.covariance)
        self.seen_s, self._radius_m = stamp_s, detection.radius_m
        self._middles.append(detection.middle)
        way_m = float(np.hypot(*(self._middles[-1] - self._middles[0])))
        speed = self.track.state[2:]
        # Squared Mahalanobis distance of the velocity from zero: χ² of two degrees of freedom if it stands.
        distance = float(speed @ np.linalg.solve(self.track.covariance[2:, 2:], speed))
        is_quick = float(np.hypot(*speed)) >= _LEAST_M_S and distance > sure
        self.walks = len(self._middles) == _FRAMES and is_quick and way_m >= _WAY_M

    def person(self, now_s: float) -> Person:
        """Return it as a person, predicted to a time."""
        state, covariance = self.track.at(now_s)
        return Person(state[:2], state[2:], covariance, self._radius_m)


def discs_of(people: Sequence[Person]) -> FloatArray:
    """Return (P, 5) x, y, vx, vy, radius, as controllers use them."""
    return np.array([[*one.position, *one.velocity, one.radius_m] for one in people]).reshape(-1, 5)


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """An object of a person's width that a depth image shows completely, on free floor of the map.

    Attributes:
        middle: (2,) its centre in `base`, metres: as far behind its surface as that of a person.
        covariance: (2, 2) of the centre.
        radius_m: half of its width, at least that of a person.
    """

    middle: FloatArray
    covariance: FloatArray
    radius_m: float


def detections_in(view: DepthView, is_on_floor: BoolArray, far_m: float) -> list[Detection]:
    """Return the objects in a view that may be people.

    Args:
        is_on_floor: (N,) whether each point lies on free floor of the map.
    """
    if not is_on_floor.any():
        return []
    apart, number = view.points - view.camera, np.full(len(view.points), -1)
    turned = (np.arctan2(apart[:, 1], apart[:, 0]) - view.first_rad) % (2 * np.pi)
    column, ranges_m = np.floor(turned / view.step_rad).astype(int), np.hypot(*apart.T)

    def is_whole(which: BoolArray) -> bool:
        """Return whether neither the view's edge nor a nearer object cuts it: a cut would move with the camera."""
        low, high = int(column[which].min()), int(column[which].max())
        if low < _BESIDE or high >= len(view.seen_m) - _BESIDE or ranges_m[which].max() > far_m - _GAP_M:
            return False
        near = ~which & (ranges_m < ranges_m[which].min())
        return not (near & (column >= low - _BESIDE) & (column <= high + _BESIDE)).any()

    # Points with gaps of at most `_GAP_M` between them are one object.
    points = view.points[is_on_floor]
    pairs = cKDTree(points).query_pairs(_GAP_M, output_type="ndarray")
    near = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), (len(points), len(points)))
    number[is_on_floor] = np.asarray(connected_components(near, directed=False)[1])
    camera, detections = np.array(view.camera), []
    for which in (number == at for at in range(int(number.max()) + 1)):
        if which.sum() < _LEAST_POINTS or not is_whole(which):
            continue
        points = view.points[which] - camera
        at = points.mean(axis=0)
        range_m = float(np.hypot(*at))
        along = at / max(range_m, 1e-6)
        across = np.array([-along[1], along[0]])
        # The centroid of a half circle's line is 2 / π of the radius in front of the circle's centre.
        middle = camera + at + 2 / np.pi * _BODY_M * along
        off = SIGMA_M**2 * np.eye(2) + (_SIGMA_RAD * range_m) ** 2 * np.outer(across, across)
        detections.append(Detection(middle, off, max(_BODY_M, float(np.ptp(points @ across)) / 2)))
    return [detection for detection in detections if 2 * detection.radius_m <= _WIDEST_M]


# Observation matrix: positions.
_SEEN = np.eye(2, 4)


class PersonTrack:
    """Kalman filter of an object with constant velocity and white noise in its acceleration.

    From Bar-Shalom, Li, Kirubarajan: Estimation, 6.2.2.

    Attributes:
        state: (4,) x, y, vx, vy.
    """

    def __init__(self, stamp_s: float, position: FloatArray, covariance: FloatArray) -> None:
        self.stamp_s = stamp_s
        self.state: FloatArray = np.array([*position, 0.0, 0.0], float)
        self.covariance: FloatArray = np.zeros((4, 4))
        self.covariance[:2, :2], self.covariance[2:, 2:] = covariance, WALK_M_S**2 * np.eye(2)

    def at(self, stamp_s: float) -> tuple[FloatArray, FloatArray]:
        """Return state (4,) and covariance (4, 4) predicted to a time."""
        step_s = stamp_s - self.stamp_s
        F = np.kron(np.array([[1.0, step_s], [0.0, 1.0]]), np.eye(2))
        ahead_s = abs(step_s)
        noise = np.array([[ahead_s**3 / 3, step_s * ahead_s / 2], [step_s * ahead_s / 2, ahead_s]])
        return F @ self.state, F @ self.covariance @ F.T + CHANGE_M2_S3 * np.kron(noise, np.eye(2))

    def predict(self, stamp_s: float) -> None:
        """Predict to a later time."""
        self.state, self.covariance = self.at(stamp_s)
        self.stamp_s = stamp_s

    def distance(self, position: FloatArray, covariance: FloatArray) -> float:
        """Return the squared Mahalanobis distance of an observation, (2,) with (2, 2): χ² of two degrees of freedom."""
        off = position - self.state[:2]
        return float(off @ np.linalg.solve(self.covariance[:2, :2] + covariance, off))

    def correct(self, position: FloatArray, covariance: FloatArray) -> None:
        """Update by an observation, (2,) with (2, 2)."""
        S = self.covariance[:2, :2] + covariance
        K = np.linalg.solve(S, self.covariance[:2]).T
        self.state = self.state + K @ (position - self.state[:2])
        left = np.eye(4) - K @ _SEEN
        # Joseph's form stays symmetric and positive definite.
        self.covariance = left @ self.covariance @ left.T + K @ covariance @ K.T
