"""Occupancy of the floor.

`OccupancyGrid` has free and occupied cells, and drop-offs. `OccupancyMapper` builds it from the depth of keyframes and
updates it when keyframes move. `picture_of` draws it.
"""

from __future__ import annotations

import math
import os
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from math import ceil, floor
from typing import Any, BinaryIO, Literal, NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import model_validator

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.files import StrPath, write_bytes
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, IntArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.settings import CHOSEN, Settings, conflict, setting
from wheelsight.io.ros_map import FREE, OCCUPIED, UNKNOWN, RosMap
from wheelsight.mapping import occupancy_kernels as kernels


class CellKind(IntEnum):
    """Kinds of floor cells."""

    UNKNOWN = 0
    FREE = 1
    OVERHANG = 2
    """An object above the robot's height. `OccupancyGrid.occupancy` has the state of the floor below it."""
    OBSTACLE = 3
    DROP_OFF = 4
    KEEP_OUT = 5
    """A keep-out zone; see `MapEdits`."""


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """Grid of the floor, with square cells along the axes of the frame `map`.

    Attributes:
        kind: (H, W) uint8 of `CellKind`; row 0 has the least y.
        occupancy: (H, W) int8 as in nav_msgs/OccupancyGrid: 0 free, 100 occupied, -1 unknown.
        origin: x and y in metres of the corner of cell (0, 0).
    """

    kind: ByteArray
    occupancy: NDArray[np.int8]
    resolution_m: float
    origin: tuple[float, float]

    @classmethod
    def of_kinds(
        cls, kind: ByteArray, is_free: BoolArray, resolution_m: float, origin: tuple[float, float]
    ) -> OccupancyGrid:
        """Return a grid of kinds (H, W); `is_free` (H, W) marks free floor below an overhang."""
        return cls(kind, _occupancy(kind, is_free), resolution_m, origin)

    def to_ros(self) -> RosMap:
        """Return the map for `write_ros_map`, which has only free, occupied and unknown cells."""
        return RosMap(self.occupancy, self.resolution_m, (*self.origin, 0.0))

    def cells_at(self, xy_map: ArrayLike) -> IntArray:
        """Return row and column (..., 2) of points (..., 2) in `map`; they may be outside the grid."""
        cells = (np.asarray(xy_map, float) - self.origin) / self.resolution_m
        return np.floor(cells[..., ::-1]).astype(np.int64)

    def middle_of(self, cells: ArrayLike) -> FloatArray:
        """Return the centres (..., 2) in `map` of cells (..., 2), row and column."""
        return np.asarray((np.asarray(cells, float)[..., ::-1] + 0.5) * self.resolution_m + self.origin)

    def kind_at(self, xy_map: ArrayLike) -> ByteArray:
        """Return the `CellKind` (...) at points (..., 2) in `map`; unknown outside the grid."""
        cells = self.cells_at(xy_map)
        inside = np.asarray(((cells >= 0) & (cells < self.kind.shape)).all(axis=-1))
        row, column = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
        return np.asarray(np.where(inside, self.kind[row, column], CellKind.UNKNOWN), np.uint8)

    def changed(self, where: BoolArray, kind: CellKind) -> OccupancyGrid:
        """Return a grid with another kind in some cells (H, W)."""
        kinds = np.where(where, np.uint8(kind), self.kind).astype(np.uint8)
        changed = _occupancy(kinds, np.zeros_like(where))
        return replace(self, kind=kinds, occupancy=np.where(where, changed, self.occupancy).astype(np.int8))

    def free_m2(self) -> float:
        """Return the area of free floor."""
        return float(np.count_nonzero(self.occupancy == FREE) * self.resolution_m**2)


def _occupancy(kind: ByteArray, is_free: BoolArray) -> NDArray[np.int8]:
    values = np.where(kind >= CellKind.OBSTACLE, OCCUPIED, np.where(kind == CellKind.FREE, FREE, UNKNOWN))
    return np.where((kind == CellKind.OVERHANG) & is_free, FREE, values).astype(np.int8)


class OccupancySettings(Settings):
    """Occupancy map of a map folder; see docs/occupancy.md."""

    resolution_m: float = setting(0.05, "side of a cell, metres", "what Nav2's maps have", ge=0.01, le=1)
    floor_m: float = setting(
        0.05,
        "points higher than this are obstacles, and points this far below are not the floor, metres: casters "
        "climb less",
        CHOSEN,
        gt=0,
        le=1,
    )
    drop_m: float = setting(
        0.1,
        "a ray that ends this far below the floor, metres, shows a drop-off: half of a stair's step, and more"
        " than the roughness of a floor seen by a Kinect",
        CHOSEN,
        gt=0,
        le=1,
    )
    height_m: float = setting(
        1.4, "height up to which objects obstruct the robot, metres", "a person who sits in a wheelchair", gt=0, le=5
    )
    overhang_m: float = setting(
        2.0,
        "height up to which objects above the robot are overhangs, metres; higher ones are the ceiling",
        CHOSEN,
        gt=0,
        le=10,
    )
    far_m: float = setting(
        5.0,
        "largest distance used, metres along the floor: a Kinect's depth error there is 3.6 cm, nearly a cell",
        "estimated",
        gt=0,
        le=30,
    )
    most_cells: int = setting(
        6_000_000,
        "limit of memory, 16 bytes per cell: 150 × 100 m in cells of 0.05 m",
        "estimated",
        ge=10_000,
        le=100_000_000,
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.floor_m < self.height_m < self.overhang_m:
            raise conflict("height_m", "is not between floor_m and overhang_m", "floor_m < height_m < overhang_m")
        return self

    @property
    def layers(self) -> int:
        """Number of layers between the floor and the robot's height; the last may be lower."""
        return max(1, -int(-(self.height_m - self.floor_m) // _LAYER_M))


# Height of a layer: free space at one height does not free the others, as the floor below a table does not free its
# top. From a simulated room: docs/decisions/occupancy.md.
_LAYER_M = 0.1
# Added to floor_m and drop_m for each metre of distance: mount and base are level to about a degree. Chosen.
_TILT_RAD = 0.015
_COLUMNS = 80  # number of a keyframe's depth columns that are used, with rows as dense; estimated: a cell at 4 m
# Neighbouring rays that hit at one height within this distance hit one object: no robot fits between. Chosen.
_BRIDGED_M = 0.15
# Depth of the unknown space behind a surface: of a shelf at the camera's height, only the front and the floor below are
# visible; as deep as tables are. From a simulated room: docs/decisions/occupancy.md.
_HIDDEN_M = 0.8
_MARGIN_SIGMAS = 3.0  # a ray frees nothing within this many standard deviations of depth, and a cell, of its end
_STOOD_M = 0.25  # radius around the base within which the floor is free, since the base stands there; chosen
# Probabilities: a layer in which a keyframe sees something is occupied; likewise one that it sees through; the limits,
# so that free space may become occupied. OctoMap's defaults (Hornung et al. 2013).
_HIT, _PASSED, _LEAST, _MOST = 0.7, 0.4, 0.12, 0.97
_OCCUPIED = 0.65  # least probability of an occupied cell or of a drop-off, as in Nav2's map_saver
# Log-odds are stored in even steps: 3.5, the log-odds of 0.97, is 112, and int8 has 127.
_PAIRS_PER_UNIT = 16.0
_MOST_PAIRS = 63
_GROWTH_CELLS = 128
# Width of the unknown border around the known cells.
_BORDER_CELLS = 2


class OccupancyMapper:
    """Log-odds of occupancy in height layers above the floor, from all added keyframes.

    The floor is z = 0 of the base at each keyframe, so that a map may drift in height. About 10 kB of depth is kept per
    keyframe, mostly in a temporary file. When keyframes move, the map is rebuilt from it without decoding images.

    Raises MapError if the calibration has no camera mount.
    """

    def __init__(self, calibration: Calibration, settings: OccupancySettings | None = None) -> None:
        T_base_camera = camera_over_floor(calibration)
        self.settings = settings or OccupancySettings()
        self._T_base_camera, self._noise = T_base_camera, calibration.depth_noise
        self._T_camera_base = se3.invert(T_base_camera)
        self._seen = SeenDepths()
        self._T_map_keyframe: dict[KeyframeId, FloatArray] = {}
        s, n = self.settings, self._noise
        self._steps = kernels.Steps(*map(_log_odds, (_HIT, _PASSED, _LEAST, _MOST)))
        bands = s.resolution_m, s.floor_m, s.drop_m, _TILT_RAD, _LAYER_M, s.height_m, s.overhang_m, s.far_m
        self._bands = kernels.Bands(*map(float, (*bands, _BRIDGED_M, _HIDDEN_M)))
        self._errs = kernels.OccupancyNoise(n.constant_m, n.quadratic_per_m, _MARGIN_SIGMAS)
        self._reach = math.ceil(s.far_m / s.resolution_m) + 1
        side, self._channels = 2 * self._reach + 1, s.layers + 2
        seen, is_touched = np.zeros((side, side, self._channels), np.uint8), np.zeros((side, side), np.uint8)
        self._window = kernels.Window(seen, is_touched, np.zeros((side * side, 2), np.int32), np.zeros(1, np.int64))
        self._low: IntArray  # row and column of cell (0, 0), relative to the map's origin
        self._log_odds: NDArray[np.int8]
        self._clear()

    def __contains__(self, number: object) -> bool:
        return number in self._seen

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return len(self._seen)

    def add(self, number: KeyframeId, keyframe: Keyframe, T_map_keyframe: ArrayLike) -> None:
        """Add the depth of a keyframe at its pose (4, 4), once for each keyframe.

        Raises ArgumentError for an invalid pose or a known keyframe, and MapError if the map would have more than
        `most_cells` cells.
        """
        if number in self._seen:
            raise ArgumentError(f"keyframe {number} is there already", fix="add each once, and move it")
        T = _checked(T_map_keyframe, number)
        self._make_room(T[None])
        self.keep(number, keyframe)
        self._T_map_keyframe[number] = T
        self._put(self._seen[number], T)

    def keep(self, number: KeyframeId, keyframe: Keyframe) -> None:
        """Store the depth of a keyframe whose pose is not known yet; `move` adds it."""
        self._seen[number] = SeenDepth.of(keyframe, _COLUMNS, self._noise)

    def move(self, T_map_keyframe: ArrayLike, shown: ArrayLike | None = None) -> bool:
        """Rebuild the map at new keyframe poses; return whether any pose changed.

        Args:
            T_map_keyframe: poses (N, 4, 4) by number.
            shown: (N,) which keyframes the map has; None: all.

        Raises as `add` does; then the map is unchanged.
        """
        table = np.asarray(T_map_keyframe, float)
        if any(number >= len(table) for number in self._seen):
            raise ArgumentError(f"poses of {len(table)} keyframes", fix="give those of all that were added, by number")
        which = np.ones(len(table), bool) if shown is None else np.asarray(shown, bool)
        numbers = [number for number in self._seen if which[number]]
        T = table[numbers]
        if T.shape[1:] == (4, 4) and np.all(se3.is_valid(T)):
            now = dict(zip(numbers, T, strict=True))
        else:  # to name the first invalid one
            now = {number: _checked(one, number) for number, one in zip(numbers, T, strict=True)}
        was = self._T_map_keyframe
        if now.keys() == was.keys() and all((now[number] == was[number]).all() for number in now):
            return False
        before = self._low, self._log_odds
        self._clear()
        try:
            self._make_room(np.array([*now.values()]).reshape(-1, 4, 4))
            for number, one in now.items():
                self._put(self._seen[number], one)
        except MapError:
            self._low, self._log_odds = before
            raise
        self._T_map_keyframe = now
        return True

    def update(self, store: KeyframeStore, least_shift_m: float = 0.0) -> bool:
        """Add new keyframes of a store, and rebuild the map if others have moved; return whether it was rebuilt.

        If none moved by more than `least_shift_m`, they stay where they are. A turn by a radian counts as 1.5 m. Raises
        as `add` does, and any error of reading a keyframe.
        """
        # A copy: keyframes that other threads add or move meanwhile are left for the next call.
        T = np.array(store.T_map_keyframe)
        has_moved = False
        if placed := list(self._T_map_keyframe):
            before = np.array([self._T_map_keyframe[number] for number in placed])
            shift_m = float(se3.view_shift_m(se3.invert(before) @ T[placed]).max())
            has_moved = shift_m > least_shift_m and self.move(T)
        for number in map(KeyframeId, range(len(T))):
            if number not in self:
                self.add(number, store[number], T[number])
        return has_moved

    def grid(self) -> OccupancyGrid:
        """Return the grid, cropped to the known cells; a single unknown cell if there are none."""
        size_m = self.settings.resolution_m
        occupied = _log_odds(_OCCUPIED)
        ground, layers, above = self._log_odds[..., 0], self._log_odds[..., 1:-1].max(axis=2), self._log_odds[..., -1]
        # A cell that was hit and not yet passed often enough, or only hidden, stays unknown.
        is_free = np.asarray((ground >= occupied) & (layers <= 0), bool)
        kind = np.where(is_free, CellKind.FREE, CellKind.UNKNOWN)
        kind = np.where(above >= occupied, CellKind.OVERHANG, kind)
        kind = np.where(ground <= -occupied, CellKind.DROP_OFF, kind)
        kind = np.where(layers >= occupied, CellKind.OBSTACLE, kind).astype(np.uint8)
        rows, columns = (np.flatnonzero((kind != CellKind.UNKNOWN).any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return OccupancyGrid.of_kinds(np.zeros((1, 1), np.uint8), np.zeros((1, 1), bool), size_m, (0.0, 0.0))
        low = np.maximum([rows[0] - _BORDER_CELLS, columns[0] - _BORDER_CELLS], 0)
        cut = slice(low[0], rows[-1] + 1 + _BORDER_CELLS), slice(low[1], columns[-1] + 1 + _BORDER_CELLS)
        y_m, x_m = (size_m * (self._low + low)).tolist()
        return OccupancyGrid.of_kinds(kind[cut], is_free[cut], size_m, (x_m, y_m))

    def _clear(self) -> None:
        self._low = np.zeros(2, np.int64)
        self._log_odds = np.zeros((0, 0, self._channels), np.int8)

    def _put(self, seen: SeenDepth, T_map_keyframe: FloatArray) -> None:
        """Add the depth of a keyframe, within the allocated cells."""
        size_m = self.settings.resolution_m
        first = self._cell_at(T_map_keyframe) - self._reach
        M = np.empty((3, 4))
        M[:2] = T_map_keyframe[:2] / size_m
        M[:2, 3] -= first[::-1]
        M[2] = self._T_base_camera[2]
        kernels.trace(seen.rays(), M, self._bands, self._errs, self._window)
        y, x = ((T_map_keyframe @ self._T_camera_base)[1::-1, 3] / size_m - first).tolist()
        kernels.stand(self._window, x, y, _STOOD_M / size_m)
        row, column = (first - self._low).tolist()
        kernels.add(self._window, self._log_odds, row, column, self._steps)

    def _cell_at(self, T_map_keyframe: FloatArray) -> IntArray:
        """Return row and column (..., 2), relative to the map's origin, of cameras at (..., 4, 4)."""
        return np.floor(T_map_keyframe[..., 1::-1, 3] / self.settings.resolution_m).astype(np.int64)

    def _make_room(self, T_map_keyframe: FloatArray) -> None:
        """Allocate cells for the views of cameras (K, 4, 4)."""
        if not len(T_map_keyframe):
            return
        cells = self._cell_at(T_map_keyframe)
        low, high = cells.min(axis=0) - self._reach, cells.max(axis=0) + self._reach + 1
        old_low, old_high = self._low, self._low + self._log_odds.shape[:2]
        if self._log_odds.size:
            if (low >= old_low).all() and (high <= old_high).all():
                return
            low, high = (
                np.where(low < old_low, low - _GROWTH_CELLS, old_low),
                np.where(high > old_high, high + _GROWTH_CELLS, old_high),
            )
        if np.prod((high - low).astype(float)) > self.settings.most_cells:
            size_m = (high - low) * self.settings.resolution_m
            problem = f"the occupancy map would be {size_m[1]:.0f} × {size_m[0]:.0f} m large"
            fix = f"larger cells than {self.settings.resolution_m:g} m, or a larger most_cells"
            raise MapError(problem, fix=fix)
        larger = np.zeros((*(high - low).tolist(), self._channels), np.int8)
        if self._log_odds.size:
            (row, column), (rows, columns) = (old_low - low).tolist(), self._log_odds.shape[:2]
            larger[row : row + rows, column : column + columns] = self._log_odds
        self._low, self._log_odds = low, larger


def _log_odds(probability: float) -> int:
    """Return the log-odds of a probability, in steps."""
    pairs = round(_PAIRS_PER_UNIT * math.log(probability / (1 - probability)))
    return 2 * min(max(pairs, -_MOST_PAIRS), _MOST_PAIRS)


def _checked(T_map_keyframe: ArrayLike, number: int) -> FloatArray:
    T = np.asarray(T_map_keyframe, float)
    if T.shape != (4, 4) or not se3.is_valid(T):
        raise ArgumentError(f"the pose of keyframe {number} is no rigid motion", fix="give SE(3), (4, 4)")
    return T.copy()


_UNITS_PER_M = 5000.0
# 10 kB each: an hour of driving has about 4500, and a room needs no file.
_IN_MEMORY = 256
_LOST = "make room on the disk, and rebuild the map"


@dataclass(frozen=True, slots=True, eq=False)
class SeenDepth:
    """Subsampled depth (h, w) of a keyframe, in 0.2 mm, with the slopes (w,) and (h,) of its rays."""

    depth: NDArray[np.uint16]
    slope_x: Float32Array
    slope_y: Float32Array

    @classmethod
    def of(cls, keyframe: Keyframe, columns: int, noise: DepthNoise) -> SeenDepth:
        """Return the trusted depth of a keyframe, in about `columns` columns."""
        depth_m = keyframe.depth_m
        step = max(1, round(depth_m.shape[1] / columns))
        v, u = (np.arange(step // 2, size, step) for size in depth_m.shape)
        fx, fy, cx, cy = keyframe.intrinsics
        some = depth_m[np.ix_(v, u)]
        trusted = np.where((some >= noise.near_m) & (some <= noise.far_m), some, 0)
        depth = np.clip(np.rint(trusted * _UNITS_PER_M), 0, np.iinfo(np.uint16).max).astype(np.uint16)
        return cls(depth, ((u - cx) / fx).astype(np.float32), ((v - cy) / fy).astype(np.float32))

    def rays(self) -> kernels.DepthRays:
        """Return the form that kernels take."""
        return kernels.DepthRays(self.depth.astype(np.float32) / np.float32(_UNITS_PER_M), self.slope_x, self.slope_y)


class _OnDisk(NamedTuple):
    offset: int
    shape: tuple[int, int]


class SeenDepths:
    """Depth by keyframe, in order of insertion. If the file cannot be written, all of it stays in memory.

    Args:
        in_memory: number of first keyframes that always stay in memory.
    """

    def __init__(self, in_memory: int = _IN_MEMORY) -> None:
        self._all: dict[KeyframeId, SeenDepth | _OnDisk] = {}
        self._most, self._end, self._has_disk = in_memory, 0, True
        self._file: BinaryIO | None = None

    def __contains__(self, number: object) -> bool:
        return number in self._all

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[KeyframeId]:
        return iter(self._all)

    def __setitem__(self, number: KeyframeId, seen: SeenDepth) -> None:
        self._all[number] = seen
        if len(self._all) <= self._most or not self._has_disk:
            return
        data = memoryview(b"".join(array.tobytes() for array in (seen.depth, seen.slope_x, seen.slope_y)))
        begin = self._end
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - open as long as the mapper exists
                weakref.finalize(self, self._file.close)
            self._file.seek(begin)
            while data:  # a nearly full disk accepts only a part
                data = data[self._file.write(data) :]
            self._end = self._file.tell()
        except OSError:
            self._has_disk = False
            return
        height, width = seen.depth.shape
        self._all[number] = _OnDisk(begin, (height, width))

    def __getitem__(self, number: KeyframeId) -> SeenDepth:
        """Return the depth of a keyframe. Raises MapError if the file has lost it."""
        found = self._all[number]
        if isinstance(found, SeenDepth):
            return found
        assert self._file is not None
        (height, width), begin = found.shape, found.offset
        sizes = (2 * height * width, 4 * width, 4 * height)
        try:
            data = os.pread(self._file.fileno(), sum(sizes), begin)
        except OSError as error:
            raise MapError(f"the depth of a keyframe cannot be read again: {error}", fix=_LOST) from error
        if len(data) != sum(sizes):
            raise MapError("the depth of a keyframe on disk is cut off", fix=_LOST)
        slopes = np.frombuffer(data, np.float32, width + height, sizes[0])
        depth = np.frombuffer(data, np.uint16, height * width).reshape(height, width)
        return SeenDepth(depth, slopes[:width], slopes[width:])


def camera_over_floor(calibration: Calibration) -> FloatArray:
    """Return T_base_camera (4, 4). Raises MapError if the calibration does not have it."""
    if calibration.T_base_camera is None:
        problem = "the camera's pose above the floor is unknown: the calibration has no T_base_camera"
        raise MapError(problem, fix="run wheelsight calibrate base, or set T_base_camera in the calibration")
    return calibration.T_base_camera


_LONGER_SIDE_PX = 1100
_LEAST_WIDTH_PX, _MOST_PX_A_CELL = 640, 16
# Colours, red, green and blue, that are distinct with red-green blindness (Okabe & Ito 2008).
COLOURS = {
    CellKind.UNKNOWN: (222, 222, 222),
    CellKind.FREE: (255, 255, 255),
    CellKind.OVERHANG: (190, 225, 245),
    CellKind.OBSTACLE: (40, 40, 40),
    CellKind.DROP_OFF: (213, 94, 0),
    CellKind.KEEP_OUT: (204, 121, 167),
}
_WAY, _INK, _PAPER = (0, 114, 178), (40, 40, 40), (255, 255, 255)
_CROSS, _LEAST_STEP_PX = (170, 170, 170), 70
_SCALES_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_STRIP_PX, _GAP_PX = 34, 10


@dataclass(frozen=True, slots=True, eq=False)
class PlanLine:
    """A line on the map.

    Attributes:
        points: (N, 2) in `map`; closed outlines repeat the first point at the end.
        name: name in the legend, or empty.
        text: label at the mean of its points.
    """

    points: ArrayLike
    colour: tuple[int, int, int]
    name: str = ""
    width_px: int = 2
    text: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class PlanMark:
    """A marked place on the map.

    Attributes:
        xy: (2,) in `map`.
        name: name in the legend, or empty.
        text: label beside it.
    """

    xy: ArrayLike
    sign: Literal["circle", "square", "cross"]
    colour: tuple[int, int, int]
    name: str = ""
    text: str = ""


def picture_of(
    grid: OccupancyGrid,
    stretches: Sequence[ArrayLike] = (),
    lines: Sequence[PlanLine] = (),
    marks: Sequence[PlanMark] = (),
    *,
    has_axes: bool = False,
) -> ByteArray:
    """Return a picture (h, w, 3) uint8 of the map, red, green, blue, y upwards, with a legend below.

    Args:
        stretches: paths driven, each with places (K, 2) in `map`. Dots are joined by a line within a path. A circle is
            the first place of all, a square the last.
        lines, marks: further drawings, in this order.
        has_axes: whether to label x and y at the edges.
    """
    rows, columns = grid.kind.shape
    px = min(max(_LONGER_SIDE_PX // max(rows, columns), 1), _MOST_PX_A_CELL)
    colours = np.array([COLOURS[kind] for kind in CellKind], np.uint8)
    image = colours[grid.kind[::-1]].repeat(px, axis=0).repeat(px, axis=1)
    image = np.ascontiguousarray(image)
    if has_axes:
        _draw_axes(image, grid, px)
    _draw_way(image, grid, [np.asarray(stretch, float).reshape(-1, 2) for stretch in stretches], px)
    for line in lines:
        at = _pixels(grid, line.points, px)
        if len(at):
            cv2.polylines(image, [at], False, line.colour, line.width_px, cv2.LINE_AA)
            if line.text:
                x, y = np.rint(np.unique(at, axis=0).mean(axis=0)).astype(int).tolist()
                _write_beside(image, line.text, x - 4 * len(line.text), y)
    for mark in marks:
        x, y = _pixels(grid, mark.xy, px)[0].tolist()
        _sign(image, mark, x, y)
        if mark.text:
            _write_beside(image, mark.text, x + 11, y + 5)
    wide = np.full((image.shape[0], max(image.shape[1], _LEAST_WIDTH_PX), 3), COLOURS[CellKind.UNKNOWN], np.uint8)
    left = (wide.shape[1] - image.shape[1]) // 2
    wide[:, left : left + image.shape[1]] = image
    drawn: list[PlanLine | PlanMark] = [*lines, *marks]
    named = [one for one in drawn if one.name]
    below = [_name_legend(named, wide.shape[1])] if named else []
    return np.concatenate([wide, *below, _legend(grid, px, wide.shape[1])])


def save_picture(image: ByteArray, path: StrPath) -> None:
    """Write an image (h, w, 3), red, green, blue, as PNG, atomically. Raises OutputError."""
    written, code = cv2.imencode(".png", image[..., ::-1])
    assert written
    write_bytes(path, code.tobytes())


def _draw_way(image: ByteArray, grid: OccupancyGrid, stretches: list[FloatArray], px: int) -> None:
    if not sum(map(len, stretches)):
        return
    for stretch in stretches:
        at = _pixels(grid, stretch, px)
        cv2.polylines(image, [at], isClosed=False, color=_WAY, thickness=2, lineType=cv2.LINE_AA)
        for dot in at.tolist():
            cv2.circle(image, dot, 3, _WAY, -1, cv2.LINE_AA)
    ends = _pixels(grid, np.concatenate(stretches)[[0, -1]], px)
    cv2.circle(image, ends[0].tolist(), 6, _WAY, -1, cv2.LINE_AA)
    cv2.rectangle(image, (ends[1] - 5).tolist(), (ends[1] + 5).tolist(), _WAY, -1)


def _draw_axes(image: ByteArray, grid: OccupancyGrid, px: int) -> None:
    """Draw crosses at round values of x and y, with labels along the left and lower edges."""
    a_metre, (height, width) = px / grid.resolution_m, image.shape[:2]
    step_m = next((step for step in _SCALES_M if step * a_metre >= _LEAST_STEP_PX), _SCALES_M[-1])
    x_m, y_m = (
        step_m * np.arange(ceil(low / step_m), floor((low + size / a_metre) / step_m) + 1)
        for low, size in zip(grid.origin, (width, height), strict=True)
    )
    for at in _pixels(grid, [(x, y) for x in x_m for y in y_m], px).tolist():
        cv2.drawMarker(image, at, _CROSS, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)
    for x in x_m.tolist():
        left = int(_pixels(grid, (x, 0.0), px)[0, 0])
        cv2.line(image, (left, height - 6), (left, height), _INK, 1)
        _write_beside(image, f"{x:g}", max(left - 4, 0), height - 10)
    for y in y_m.tolist():
        bottom = int(_pixels(grid, (0.0, y), px)[0, 1])
        cv2.line(image, (0, bottom), (6, bottom), _INK, 1)
        _write_beside(image, f"{y:g}", 10, bottom + 5)


def _pixels(grid: OccupancyGrid, xy: ArrayLike, px: int) -> Any:
    """Return pixels (N, 2) int32 of places (N, 2) in `map`."""
    cells = (np.asarray(xy, float).reshape(-1, 2) - grid.origin) / grid.resolution_m
    return np.rint(px * np.stack([cells[:, 0], len(grid.kind) - cells[:, 1]], axis=-1)).astype(np.int32)


def _sign(image: ByteArray, mark: PlanMark, x: int, y: int) -> None:
    """Draw a mark with a white rim, so that it is visible on lines of its own colour."""
    if mark.sign == "circle":
        cv2.circle(image, (x, y), 8, _PAPER, -1, cv2.LINE_AA)
        cv2.circle(image, (x, y), 6, mark.colour, -1, cv2.LINE_AA)
    elif mark.sign == "square":
        cv2.rectangle(image, (x - 7, y - 7), (x + 7, y + 7), _PAPER, -1)
        cv2.rectangle(image, (x - 5, y - 5), (x + 5, y + 5), mark.colour, -1)
    else:
        for colour, width in ((_PAPER, 6), (mark.colour, 3)):
            cv2.drawMarker(image, (x, y), colour, cv2.MARKER_TILTED_CROSS, 13, width, cv2.LINE_AA)


def _write_beside(image: ByteArray, text: str, left: int, bottom: int) -> None:
    for colour, width in ((_PAPER, 4), (_INK, 1)):
        cv2.putText(image, _plain(text), (left, bottom), cv2.FONT_HERSHEY_SIMPLEX, 0.43, colour, width, cv2.LINE_AA)


def _plain(text: str) -> str:
    """Return text in ASCII, which is all that OpenCV's font has."""
    return text.replace("°", " deg").encode("ascii", "replace").decode()


def _name_legend(drawn: Iterable[PlanLine | PlanMark], width: int) -> ByteArray:
    """Return (h, width, 3) with the names of lines and marks, each once, in as many rows as needed."""
    strips, left = [np.full((_STRIP_PX, width, 3), 255, np.uint8)], _GAP_PX
    for one in {one.name: one for one in drawn}.values():
        span = 34 + 8 * len(one.name) + _GAP_PX
        if left > _GAP_PX and left + span > width:
            strips.append(np.full((_STRIP_PX, width, 3), 255, np.uint8))
            left = _GAP_PX
        if isinstance(one, PlanLine):
            cv2.line(strips[-1], (left, 17), (left + 22, 17), one.colour, one.width_px + 1)
        else:
            _sign(strips[-1], one, left + 11, 17)
        _write(strips[-1], one.name, left + 28)
        left += span
    return np.concatenate(strips)


def _legend(grid: OccupancyGrid, px: int, width: int) -> ByteArray:
    """Return (h, width, 3) with the colours of the kinds that occur, and a scale."""
    shown = [kind for kind in CellKind if (grid.kind == kind).any()]
    names = [kind.name.lower().replace("_", "-") for kind in shown]
    spans = [28 + 8 * len(name) + _GAP_PX for name in names]
    at = [_GAP_PX + sum(spans[:k]) for k in range(len(spans))]
    a_metre = px / grid.resolution_m
    scale_m = max([length for length in _SCALES_M if length * a_metre <= width / 5] or [_SCALES_M[0]])
    length = ceil(scale_m * a_metre)
    strip = np.full((_STRIP_PX, width, 3), 255, np.uint8)
    for kind, name, left in zip(shown, names, at, strict=True):
        cv2.rectangle(strip, (left, 9), (left + 16, 25), COLOURS[kind], -1)
        cv2.rectangle(strip, (left, 9), (left + 16, 25), _INK, 1)
        _write(strip, name, left + 22)
    right = width - _GAP_PX
    text = f"{scale_m:g} m"
    cv2.line(strip, (right - length, 17), (right, 17), _INK, 3)
    _write(strip, text, right - length - 9 * len(text) - 4)
    return strip


def _write(strip: ByteArray, text: str, left: int) -> None:
    cv2.putText(strip, _plain(text), (left, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.43, _INK, 1, cv2.LINE_AA)
