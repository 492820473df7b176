"""DepthViewer: makes of a depth image what a collision monitor goes by."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.calibration import Calibration
from wheelsight.errors import MapError
from wheelsight.geometry import BoolArray, FloatArray, IntArray
from wheelsight.mapping.mount import camera_over_floor
from wheelsight.navigation import _depth_view_kernels as kernels
from wheelsight.navigation.costmap_settings import LiveLayerSettings
from wheelsight.navigation.depth_images import checked_depth
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.monitor_settings import ViewSettings
from wheelsight.navigation.surroundings import DepthView

# From bearing to bearing of a row its pixels lie closer than this, whatever the camera.
_LEAST_COLUMNS = 8
# So wide is a bearing at least, since one between two pixels would see nothing.
_LEAST_PIXELS = 2


class DepthViewer:
    """Things between the floor and the robot's height, where the floor ends, and how far it is seen.

    Args:
        calibration: of the robot: its depth camera, and where that sits over the floor.
        footprint: of the robot: what lies within it is the robot itself.
        settings: or the defaults.
        heights: by which floor and things are told apart; or the defaults.

    Attributes:
        near_m: from the axle, the nearest floor that the camera sees at all its bearings.
        half_rad: to either side, how far all its rows see.
        camera: x and y of it in `base`.

    Raises:
        CalibrationError: there is no camera.
        MapError: nobody knows where the camera sits, or it sees no floor.
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
        self._heights = _heights_of(heights or LiveLayerSettings())
        ways = self._camera.rays() @ T_base_camera[:3, :3].T
        self._count = min(self._settings.columns, ways.shape[1] // _LEAST_PIXELS)
        self._first_rad, self._step_rad, columns = _bearings(ways, self._count)
        self.half_rad: float = self._step_rad * self._count / 2
        where = np.ascontiguousarray(T_base_camera[:3, 3])
        self.camera: tuple[float, float] = (float(where[0]), float(where[1]))
        self._rays = kernels.Rays(np.ascontiguousarray(ways, np.float32), columns, where)
        self._near_m = _near_floor_m(ways, columns, float(where[2]))
        self.near_m = self._near_m + float(np.hypot(*where[:2]))

    def view(self, depth_m: ArrayLike, stamp_s: float) -> DepthView:
        """What a depth image (H, W) in metres shows; 0 or what is not finite was not measured.

        Raises:
            ArgumentError: an image of another size.
        """
        depth = checked_depth(depth_m, self._camera)
        s, far_m = self._settings, self._heights.far_m
        side = 2 * int(np.ceil((far_m + np.hypot(*self._rays.camera[:2])) / s.cell_m) + 1)
        floor = np.zeros((self._count, int(np.ceil(far_m / s.bin_m))), np.uint8)
        shown = kernels.Shown(
            floor,
            np.zeros((side, side, 3), np.float32),
            np.zeros((side, side, s.pixels), np.float32),
            np.zeros(self._count, np.int64),
            s.bin_m,
            s.cell_m,
        )
        kernels.look(depth, self._rays, self._heights, shown)
        is_thing, points, tops_m = self._things(shown)
        thing_m = np.full(self._count, np.inf)
        kernels.reach(depth, self._rays, self._heights, shown, is_thing, thing_m)
        seen_m = self._seen_m(shown, thing_m)
        return DepthView(
            stamp_s, points, self.camera, self._first_rad, self._step_rad, seen_m, self._near_m, self._shows_m(tops_m)
        )

    def _things(self, shown: kernels.Shown) -> tuple[BoolArray, FloatArray, FloatArray]:
        """(n, n) which cells hold one, and where, (N, 2) in the base, and (N,) how high; not the robot itself.

        As high as so many pixels say as make a thing, of a cell or of one beside it: where a surface grazes a cell,
        hardly more show in it.
        """
        is_thing = shown.cells[..., 0] >= self._settings.pixels
        some = shown.cells[is_thing].astype(float)
        points = some[:, 1:] / some[:, :1]
        is_thing[is_thing] = is_other = ~self._footprint.contains(points)
        tops_m = cv2.dilate(np.ascontiguousarray(shown.tops[..., -1]), np.ones((3, 3), np.uint8))
        return is_thing, np.asarray(points[is_other]), np.asarray(tops_m[is_thing], float)

    def _shows_m(self, tops_m: FloatArray) -> FloatArray:
        """(N,) how near to the camera things so high show: nearer, they are below its lowest ray."""
        height_m = float(self._rays.camera[2])
        return np.asarray(self._near_m * np.maximum(1 - tops_m / height_m, 0.0))

    def _seen_m(self, shown: kernels.Shown, thing_m: FloatArray) -> FloatArray:
        """(columns,) how far each sees: along floor without a long gap, or up to the nearest thing; 0 of nothing."""
        s, far_m = self._settings, self._heights.far_m
        floor_m = _floor_until_m(shown.floor, s.gap_m, s.bin_m, self._near_m)
        # Up to a thing that stands on the last floor seen, or nearer than any floor is.
        reached = thing_m <= np.maximum(floor_m, self._near_m) + s.gap_m
        seen_m = np.where(reached, thing_m, np.minimum(floor_m, far_m))
        return np.where(shown.measured >= s.pixels, seen_m, 0.0)


def _heights_of(settings: LiveLayerSettings) -> kernels.Heights:
    return kernels.Heights(**{name: getattr(settings, name) for name in kernels.Heights._fields})


def _bearings(ways: FloatArray, count: int) -> tuple[float, float, IntArray]:
    """First bearing and step of the view that all rows share, and the number (h, w) of each pixel's bearing."""
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
    """From the camera, the nearest floor that it sees at all bearings."""
    down = np.where(columns >= 0, -ways[..., 2], 0)
    along = np.hypot(ways[..., 0], ways[..., 1])
    with np.errstate(divide="ignore"):
        way_m = np.where(down > 0, along * height_m / np.maximum(down, 1e-9), np.inf)
    near_m = np.array([way_m[columns == number].min(initial=np.inf) for number in range(int(columns.max()) + 1)])
    if not np.isfinite(near_m).all():
        raise MapError("the camera sees no floor", fix="check T_base_camera in the calibration, or tilt the camera")
    return float(near_m.max())


def _floor_until_m(floor: IntArray, gap_m: float, bin_m: float, near_m: float) -> FloatArray:
    """(columns,) where floor that begins at the nearest that can be seen ends; 0 where none begins there."""
    begin = near_m / bin_m
    last, is_on = np.full(len(floor), begin), np.ones(len(floor), bool)
    for at, is_seen in enumerate(floor.T.astype(bool)):
        is_on &= ~is_seen | (at - last <= max(round(gap_m / bin_m), 1))
        last = np.where(is_seen & is_on, np.maximum(last, at + 1.0), last)
    return np.where(last > begin, last * bin_m, 0.0)
