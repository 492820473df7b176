"""OccupancyMapper: an occupancy map made of the depth of keyframes, and made anew where they moved."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wheelsight.calibration import Calibration
from wheelsight.errors import ArgumentError, MapError
from wheelsight.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.mapping import _occupancy_kernels as kernels
from wheelsight.mapping.mount import camera_over_floor
from wheelsight.mapping.occupancy import CellKind, OccupancyGrid
from wheelsight.mapping.occupancy_settings import OccupancySettings
from wheelsight.mapping.seen_depths import SeenDepth, SeenDepths

# Log-odds are kept in even steps: 3.5, the log-odds of 0.97, is 112, and int8 holds 127.
_PAIRS_PER_UNIT = 16.0
_MOST_PAIRS = 63
_GROWTH_CELLS = 128
# Cells of unknown floor all round what is known.
_BORDER_CELLS = 2


class OccupancyMapper:
    """Log-odds that layers of height over the floor are occupied, by all keyframes that were added.

    The floor is z = 0 of the base at each keyframe, so that a map may drift in height. Of each keyframe
    some depth is kept, about 10 kB, mostly in a temporary file: where keyframes moved, all is made anew of that, and no
    image is decoded.

    Args:
        calibration: of the robot: where its camera sits over the floor, and how its depth errs.
        settings: or the defaults.

    Raises:
        MapError: the calibration does not say where the camera sits on the base.
    """

    def __init__(self, calibration: Calibration, settings: OccupancySettings | None = None) -> None:
        T_base_camera = camera_over_floor(calibration)
        self.settings = settings or OccupancySettings()
        self._T_base_camera, self._noise = T_base_camera, calibration.depth_noise
        self._T_camera_base = se3.invert(T_base_camera)
        self._seen = SeenDepths()
        self._T_map_keyframe: dict[KeyframeId, FloatArray] = {}
        self._steps = _steps_of(self.settings)
        self._bands = kernels.Bands(**{name: float(getattr(self.settings, name)) for name in kernels.Bands._fields})
        n = self._noise
        self._errs = kernels.Noise(n.constant_m, n.quadratic_per_m, self.settings.margin_sigmas)
        self._reach = math.ceil(self.settings.far_m / self.settings.resolution_m) + 1
        self._window = _window(2 * self._reach + 1, self._channels)
        self._clear()

    def __contains__(self, number: object) -> bool:
        return number in self._seen

    def __len__(self) -> int:
        """How many keyframes it keeps."""
        return len(self._seen)

    def add(self, number: KeyframeId, keyframe: Keyframe, T_map_keyframe: ArrayLike) -> None:
        """Add what a keyframe sees, at its pose (4, 4); once each.

        Raises ArgumentError for a pose that is no rigid motion or a keyframe that is there, and MapError where the map
        would have more cells than `most_cells`.
        """
        if number in self._seen:
            raise ArgumentError(f"keyframe {number} is there already", fix="add each once, and move it")
        T = _checked(T_map_keyframe, number)
        self._make_room(T[None])
        self.keep(number, keyframe)
        self._T_map_keyframe[number] = T
        self._put(self._seen[number], T)

    def keep(self, number: KeyframeId, keyframe: Keyframe) -> None:
        """Keep what a keyframe sees, of which nobody knows yet where it is; `move` adds it."""
        self._seen[number] = SeenDepth.of(keyframe, self.settings.columns, self._noise)

    def move(self, T_map_keyframe: ArrayLike, shown: ArrayLike | None = None) -> bool:
        """Make the map anew where its keyframes are by now; whether anything had changed.

        Args:
            T_map_keyframe: poses (N, 4, 4) by number.
            shown: (N,) whether each is to be in the map; None: all are.

        Raises as `add` does; then the map is as it was.
        """
        table = np.asarray(T_map_keyframe, float)
        if any(number >= len(table) for number in self._seen):
            raise ArgumentError(f"poses of {len(table)} keyframes", fix="give those of all that were added, by number")
        which = np.ones(len(table), bool) if shown is None else np.asarray(shown, bool)
        now = _all_checked(table, [number for number in self._seen if which[number]])
        was = self._T_map_keyframe
        if now.keys() == was.keys() and all((now[number] == was[number]).all() for number in now):
            return False
        self._make_anew(now)
        return True

    def update(self, store: KeyframeStore, least_shift_m: float = 0.0) -> bool:
        """Add a store's keyframes that are new, and make the map anew if others have moved; whether it did that.

        Where none has moved by more than `least_shift_m`, a turn by a radian as 1.5 m, they stay where they were put.

        Raises as `add` does, and what a store raises where a keyframe cannot be read.
        """
        # Others may come, and move, in the meantime: they are for the next time.
        T = np.array(store.T_map_keyframe)
        has_moved = bool(len(self)) and self._shift_m(T) > least_shift_m and self.move(T)
        for number in map(KeyframeId, range(len(T))):
            if number not in self:
                self.add(number, store[number], T[number])
        return has_moved

    def _shift_m(self, T_map_keyframe: FloatArray) -> float:
        """By how much the farthest keyframe has moved since it was put."""
        numbers = list(self._T_map_keyframe)
        before = np.array([self._T_map_keyframe[number] for number in numbers])
        return float(se3.view_shift_m(se3.invert(before) @ T_map_keyframe[numbers]).max()) if numbers else 0.0

    def grid(self) -> OccupancyGrid:
        """The map as it is by now, cut to what is known; one unknown cell where nothing is."""
        size_m = self.settings.resolution_m
        kind, is_free = _kinds(self._log_odds, _log_odds(self.settings.occupied))
        rows, columns = (np.flatnonzero((kind != CellKind.UNKNOWN).any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return OccupancyGrid.of_kinds(np.zeros((1, 1), np.uint8), np.zeros((1, 1), bool), size_m, (0.0, 0.0))
        low = np.maximum([rows[0] - _BORDER_CELLS, columns[0] - _BORDER_CELLS], 0)
        cut = slice(low[0], rows[-1] + 1 + _BORDER_CELLS), slice(low[1], columns[-1] + 1 + _BORDER_CELLS)
        y_m, x_m = (size_m * (self._low + low)).tolist()
        return OccupancyGrid.of_kinds(kind[cut], is_free[cut], size_m, (x_m, y_m))

    @property
    def _channels(self) -> int:
        return self.settings.layers + 2

    def _clear(self) -> None:
        self._low: IntArray = np.zeros(2, np.int64)  # row and column of cell (0, 0), in cells from the map's origin
        self._log_odds = np.zeros((0, 0, self._channels), np.int8)

    def _make_anew(self, T_map_keyframe: dict[KeyframeId, FloatArray]) -> None:
        before = self._low, self._log_odds
        self._clear()
        try:
            self._make_room(np.array([*T_map_keyframe.values()]).reshape(-1, 4, 4))
            for number, T in T_map_keyframe.items():
                self._put(self._seen[number], T)
        except MapError:
            self._low, self._log_odds = before
            raise
        self._T_map_keyframe = T_map_keyframe

    def _put(self, seen: SeenDepth, T_map_keyframe: FloatArray) -> None:
        """Add what a keyframe sees; there is room."""
        size_m = self.settings.resolution_m
        first = self._cell_at(T_map_keyframe) - self._reach
        M = np.empty((3, 4))
        M[:2] = T_map_keyframe[:2] / size_m
        M[:2, 3] -= first[::-1]
        M[2] = self._T_base_camera[2]
        kernels.trace(seen.rays(), M, self._bands, self._errs, self._window)
        y, x = ((T_map_keyframe @ self._T_camera_base)[1::-1, 3] / size_m - first).tolist()
        kernels.stand(self._window, x, y, self.settings.stood_m / size_m)
        row, column = (first - self._low).tolist()
        kernels.add(self._window, self._log_odds, row, column, self._steps)

    def _cell_at(self, T_map_keyframe: FloatArray) -> IntArray:
        """(..., 2) row and column, from the map's origin, of the cells in which cameras (..., 4, 4) are."""
        return np.floor(T_map_keyframe[..., 1::-1, 3] / self.settings.resolution_m).astype(np.int64)

    def _make_room(self, T_map_keyframe: FloatArray) -> None:
        """For what cameras (K, 4, 4) may see."""
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


def _window(side: int, channels: int) -> kernels.Window:
    """Of nothing."""
    seen, is_touched = np.zeros((side, side, channels), np.uint8), np.zeros((side, side), np.uint8)
    return kernels.Window(seen, is_touched, np.zeros((side * side, 2), np.int32), np.zeros(1, np.int64))


def _kinds(log_odds: NDArray[np.int8], occupied: int) -> tuple[NDArray[np.uint8], BoolArray]:
    """(H, W) kinds, and where there is floor with nothing in the robot's way, of steps (H, W, channels)."""
    ground, layers, above = log_odds[..., 0], log_odds[..., 1:-1].max(axis=2), log_odds[..., -1]
    # What was met, and not yet passed often enough to be none, or was hidden alone, leaves the cell unknown.
    is_free = (ground >= occupied) & (layers <= 0)
    kind = np.where(is_free, CellKind.FREE, CellKind.UNKNOWN)
    kind = np.where(above >= occupied, CellKind.OVERHANG, kind)
    kind = np.where(ground <= -occupied, CellKind.DROP_OFF, kind)
    kind = np.where(layers >= occupied, CellKind.OBSTACLE, kind)
    return kind.astype(np.uint8), np.asarray(is_free, bool)


def _log_odds(probability: float) -> int:
    """In steps."""
    pairs = round(_PAIRS_PER_UNIT * math.log(probability / (1 - probability)))
    return 2 * min(max(pairs, -_MOST_PAIRS), _MOST_PAIRS)


def _steps_of(settings: OccupancySettings) -> kernels.Steps:
    return kernels.Steps(*map(_log_odds, (settings.hit, settings.passed, settings.least, settings.most)))


def _all_checked(table: FloatArray, numbers: list[KeyframeId]) -> dict[KeyframeId, FloatArray]:
    """Copies of poses (N, 4, 4) of a table, checked together; the first that is no rigid motion is named."""
    T = table[numbers]
    if T.shape[1:] != (4, 4) or not np.all(se3.is_valid(T)):
        return {number: _checked(one, number) for number, one in zip(numbers, T, strict=True)}
    return dict(zip(numbers, T, strict=True))


def _checked(T_map_keyframe: ArrayLike, number: int) -> FloatArray:
    T = np.asarray(T_map_keyframe, float)
    if T.shape != (4, 4) or not se3.is_valid(T):
        raise ArgumentError(f"the pose of keyframe {number} is no rigid motion", fix="give SE(3), (4, 4)")
    return T.copy()
