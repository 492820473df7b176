"""LiveLayer: obstacles that the newest depth images show about a robot, until they are seen through."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.calibration import Calibration
from wheelsight.errors import ArgumentError
from wheelsight.geometry import BoolArray, FloatArray, IntArray
from wheelsight.geometry.se2 import wrap_angle
from wheelsight.mapping.mount import camera_over_floor
from wheelsight.navigation import _live_kernels as kernels
from wheelsight.navigation.costmap_settings import LiveLayerSettings
from wheelsight.navigation.depth_images import checked_depth
from wheelsight.navigation.footprint import Footprint

# What no image of so many seconds shows, nor sees through, has nothing behind it: five images see through a thing that
# has gone. Columns of bearings are a degree or two wide, and the edge of the view is left out.
_LOOKED_S, _COLUMNS, _WITHIN = 1.0, 32, 0.9


@dataclass(frozen=True, slots=True, eq=False)
class LiveObstacles:
    """What stands about a robot.

    Attributes:
        is_occupied: (N, N) row 0 is the least y.
        resolution_m: side of a cell.
        origin: x and y in metres of the corner of cell (0, 0).
        frame: in which its axes lie: `odom`, or `map`.
        stamp_s: of the newest image; None before the first.
        is_standing: (N, N) those of them that were met some time ago, and not seen through since.
    """

    is_occupied: BoolArray
    resolution_m: float
    origin: tuple[float, float]
    frame: str
    stamp_s: float | None
    is_standing: BoolArray

    def standing(self) -> LiveObstacles:
        """Without what may be somebody who walks past."""
        return replace(self, is_occupied=self.is_standing)

    def with_points(self, points: FloatArray) -> LiveObstacles:
        """The same, and the cells of points (N, 2) in its frame, where something stands."""
        at = np.floor((points - self.origin) / self.resolution_m).astype(np.int64)[:, ::-1]
        at = at[((at >= 0) & (at < self.is_occupied.shape)).all(axis=1)]
        is_occupied, is_standing = self.is_occupied.copy(), self.is_standing.copy()
        is_occupied[at[:, 0], at[:, 1]] = is_standing[at[:, 0], at[:, 1]] = True
        return replace(self, is_occupied=is_occupied, is_standing=is_standing)


class LiveLayer:
    """Cells about a robot with what its camera met there, layer by layer of height.

    A cell is occupied from the image on that shows something there. It is free as soon as some images saw through
    each layer in which there was something; what no image looks at stays as it was, until the robot is half the
    layer's size away; but the shorter it was met the sooner it is gone: it may be somebody who walks. Where the robot
    itself stands there is nothing else.

    Args:
        calibration: of the robot: its depth camera, and where that sits over the floor.
        footprint: of the robot.
        settings: or the defaults.
        frame: in which poses are given.

    Raises:
        CalibrationError: there is no camera.
        MapError: nobody knows where the camera sits.
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
        self.settings, self.frame, self._footprint = settings or LiveLayerSettings(), frame, footprint
        self._heights = _heights_of(self.settings, self._camera.width)
        side = math.ceil(self.settings.size_m / self.settings.resolution_m)
        layers = max(1, math.ceil((self.settings.height_m - self.settings.floor_m) / self.settings.layer_m))
        self._low: IntArray = np.zeros(2, np.int64)  # row and column of cell (0, 0), from the frame's origin
        self._left = np.zeros((side, side, layers + 1), np.uint8)
        self._seen = np.zeros_like(self._left)
        self._met_s = np.full((side, side, 2), (np.inf, -np.inf))  # first and last
        self._newest_s = -math.inf
        self._known: LiveObstacles | None = None  # as it was asked last

    def is_due(self, stamp_s: float) -> bool:
        """Whether an image of then is to be seen, as `period_s` has it; a clock that was set back makes none wait."""
        return not 0 <= stamp_s - self._newest_s < self.settings.period_s

    def update(self, depth_m: ArrayLike, pose: ArrayLike, stamp_s: float) -> None:
        """See a depth image.

        Args:
            depth_m: (H, W) metres; what is not finite and over 0 was not measured.
            pose: (3,) x, y, yaw of `base` in the layer's frame, when it was taken.
            stamp_s: when that was.

        Raises:
            ArgumentError: an image of another size, or a pose or stamp that is not finite; nothing changes then.
        """
        depth, at = checked_depth(depth_m, self._camera), np.asarray(pose, float)
        if at.shape != (3,) or not np.isfinite(at).all() or not math.isfinite(stamp_s):
            raise ArgumentError(f"pose {at} at {stamp_s} s", fix="give x, y and yaw of the base, and when, finite")
        self._move_to(at)
        is_own = self._is_own(at)
        view = kernels.View(depth, self._slopes, self._matrix(at))
        noise = kernels.Noise(self._noise.constant_m, self._noise.quadratic_per_m, self.settings.margin_sigmas)
        kernels.mark_met(view, self._heights, is_own, self._seen)
        kernels.mark_passed(view, self._heights, noise, self._seen)
        # A camera that shows nothing is no reason to forget.
        forget_s = self.settings.forget_s if self._seen.any() else math.inf
        rules = kernels.Rules(self.settings.passes, forget_s, self.settings.stays)
        kernels.remember(self._seen, is_own, self._left, self._met_s, stamp_s, rules)
        self._newest_s, self._known = stamp_s, None

    def obstacles(self) -> LiveObstacles:
        """What is there by now."""
        if self._known is None:
            size_m = self.settings.resolution_m
            y, x = (size_m * self._low).tolist()
            is_left = kernels.any_left(self._left)
            is_standing = is_left & (self._newest_s - self._met_s[..., 0] >= self.settings.standing_s)
            stamp_s = self._newest_s if math.isfinite(self._newest_s) else None
            self._known = LiveObstacles(is_left, size_m, (x, y), self.frame, stamp_s, is_standing)
        return self._known

    def clear(self, stood_s: float = math.inf) -> None:
        """Forget what has stood for less time; all, as a person may ask for."""
        self._left[~self._has_stood(stood_s)] = 0
        self._known = None

    def clear_ahead(self, stood_s: float, eye: ArrayLike, half_view_rad: float) -> None:
        """Forget of that only what lies within a camera's view; the next image shows anew what is there.

        Args:
            stood_s: as in `clear`.
            eye: (3,) x, y and heading of the camera in the layer's frame.
            half_view_rad: to either side.
        """
        x, y, yaw = map(float, np.asarray(eye, float))
        rows, columns = np.indices(self._left.shape[:2])
        size_m, (row, column) = self.settings.resolution_m, self._low.tolist()
        to_x, to_y = (columns + column + 0.5) * size_m - x, (rows + row + 0.5) * size_m - y
        is_ahead = np.abs(wrap_angle(np.arctan2(to_y, to_x) - yaw)) < half_view_rad
        self._left[is_ahead & ~self._has_stood(stood_s)] = 0
        self._known = None

    def _has_stood(self, stood_s: float) -> BoolArray:
        """(N, N) cells in which something was met for so long."""
        return np.asarray(self._met_s[..., 1] - self._met_s[..., 0] >= stood_s)

    def not_seen_through(self, eye: ArrayLike, half_view_rad: float, near_m: float) -> FloatArray:
        """(N, 2) places in the layer's frame that hold a thing which a camera looks at and no longer shows.

        No image of the last second shows the thing, nothing hides it, and no depth behind it says that it is gone: a
        hall, a window or black behind it gives none. Glass and black things themselves give none either, so it stays.

        Args:
            eye: (3,) x, y and heading of the camera in the layer's frame.
            half_view_rad: to either side.
            near_m: from the camera, the nearest floor that it sees: what is nearer may be below its view.
        """
        x, y, yaw = map(float, np.asarray(eye, float))
        cells = np.argwhere(kernels.any_left(self._left))
        places = ((cells + self._low)[:, ::-1] + 0.5) * self.settings.resolution_m
        away_m = np.hypot(*(places - (x, y)).T)
        bearing = wrap_angle(np.arctan2(places[:, 1] - y, places[:, 0] - x) - yaw)
        is_met = self._newest_s - self._met_s[cells[:, 0], cells[:, 1], 1] <= _LOOKED_S
        column = np.clip((bearing / half_view_rad + 1) / 2 * _COLUMNS, 0, _COLUMNS - 1).astype(np.int64)
        hides_m = np.full(_COLUMNS, np.inf)
        np.minimum.at(hides_m, column[is_met], away_m[is_met])
        # A cell is wider than a column where it is near.
        hides_m = np.minimum(hides_m, np.minimum(np.r_[hides_m[1:], np.inf], np.r_[np.inf, hides_m[:-1]]))
        is_looked_at = (np.abs(bearing) < _WITHIN * half_view_rad) & (away_m > near_m) & (away_m < self.settings.far_m)
        return np.asarray(places[~is_met & is_looked_at & (away_m < hides_m[column])])

    def wipe(self, ends: ArrayLike, radius_m: float) -> None:
        """Forget what is so near to a line from one place to another, (2, 2); what is there is seen again."""
        a, b = np.asarray(ends, float)
        cells = np.argwhere(kernels.any_left(self._left))
        places = ((cells + self._low)[:, ::-1] + 0.5) * self.settings.resolution_m
        share = np.clip((places - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-9), 0, 1)
        near = cells[np.hypot(*(places - a - share[:, None] * (b - a)).T) <= radius_m]
        self._left[near[:, 0], near[:, 1]] = 0
        self._known = None

    def _move_to(self, pose: FloatArray) -> None:
        """Keep what is near a pose, by whole cells."""
        side = len(self._left)
        low = np.floor(pose[1::-1] / self.settings.resolution_m).astype(np.int64) - side // 2
        if (low == self._low).all():
            return
        moved, met_s = np.zeros_like(self._left), np.full_like(self._met_s, (np.inf, -np.inf))
        first, last = np.maximum(low, self._low), np.minimum(low, self._low) + side
        if (first < last).all():
            to, of = (tuple(slice(a, b) for a, b in zip(first - at, last - at, strict=True)) for at in (low, self._low))
            moved[to], met_s[to] = self._left[of], self._met_s[of]
        self._low, self._left, self._met_s = low, moved, met_s

    def _is_own(self, pose: FloatArray) -> BoolArray:
        """(N, N) cells that lie wholly under the robot."""
        side, size_m = len(self._left), self.settings.resolution_m
        is_own = np.zeros((side, side), bool)
        outline = self._footprint.at(pose) / size_m - self._low[::-1]
        left, bottom = np.floor(outline.min(axis=0)).astype(int)
        right, top = np.ceil(outline.max(axis=0)).astype(int)
        corners = np.stack(np.meshgrid(np.arange(left, right + 1), np.arange(bottom, top + 1)), axis=-1)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        places = (corners + self._low[::-1]) * size_m - pose[:2]
        inside = self._footprint.contains(places @ np.array([[c, -s], [s, c]]))
        # The robot stands in the middle of the layer, which is wider than it.
        is_own[bottom:top, left:right] = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]
        return is_own

    def _matrix(self, pose: FloatArray) -> FloatArray:
        """(3, 4) from the camera to column and row in cells, and height."""
        c, s = np.cos(pose[2]), np.sin(pose[2])
        T_frame_base = np.array([[c, -s, 0, pose[0]], [s, c, 0, pose[1]], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        M = np.asarray((T_frame_base @ self._T_base_camera)[:3])
        M[:2] /= self.settings.resolution_m
        M[:2, 3] -= self._low[::-1]
        return np.ascontiguousarray(M)


def _heights_of(settings: LiveLayerSettings, width: int) -> kernels.Heights:
    """With blocks of pixels for an image so wide."""
    pixels = max(1, round(width / settings.columns))
    named = [name for name in kernels.Heights._fields if name != "pixels"]
    return kernels.Heights(**{name: getattr(settings, name) for name in named}, pixels=pixels)
