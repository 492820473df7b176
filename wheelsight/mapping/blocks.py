"""Surfels in blocks of space: flat arrays, of which those in view are found without touching the others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wheelsight.geometry import Float32Array, FloatArray, Int32Array, IntArray
from wheelsight.mapping import _block_kernels as kernels
from wheelsight.mapping import _move_kernels as move_kernels
from wheelsight.mapping._block_kernels import (
    ALIVE,
    CELLS,
    CONFIDENCE,
    FREE,
    PAGE,
    PAGES,
    Cells,
    Frustum,
    Going,
    Pages,
    SurfelArrays,
)

_BINS = 512
Share = Callable[[int, Callable[[int, int], None]], None]
# Dropping goes over the whole map; a tenth at once makes it rare.
_DROPPED_AT_ONCE = 0.1
_SWEPT_SURFELS = 1 << 15
# Where a larger share leaves in one move, as at a first lap's end, the map would soon take its memory several times.
_LEFT_AT_ONCE = 0.25
# Rules by which no surfel's time has come.
_NONE_GOES = np.array([0.0, np.inf, 1.0, np.inf])


class Blocks:
    """Surfels by the cell of space they lie in.

    Slots come in pages, and each cell owns a chain of them, so that a cell's surfels lie together in memory. Dead
    surfels stay until `sweep` comes by, which does a bounded number of cells a call. Arrays have room for all surfels
    that may ever be there: the system gives memory to what is written of it, and a frame never waits for a copy.

    Attributes:
        geometry: (slots, 8) float32: position (3), radius, normal (3), confidence; not positive where dead.
        look: (slots, 4) float32: red, green, blue, grey from 0 to 255, -1 where unknown.
        seen_s: (slots, 2) first and last time seen.
        variance: (slots,) float32 of the position along the normal, in m².
        keyframe: (slots,) int32 that which each hangs on, -1 for none.
        dropped: how many were given up for want of room.
    """

    def __init__(self, block_m: float, max_surfels: int) -> None:
        self.block_m, self.dropped = block_m, 0
        pages = -(-max_surfels // PAGE)
        slots = pages * PAGE
        self._counters = np.zeros(4, np.int64)
        self._cursor = 0
        self.geometry: Float32Array = np.zeros((slots, 8), np.float32)
        self.look: Float32Array = np.empty((slots, 4), np.float32)
        self.seen_s: FloatArray = np.empty((slots, 2))
        self.variance: Float32Array = np.empty(slots, np.float32)
        self.keyframe: Int32Array = np.empty(slots, np.int32)
        self.page_next, self.page_fill, self.page_cell, self._free = (np.empty(pages, np.int32) for _ in range(4))
        self.cell_xyz: Int32Array = np.zeros((0, 3), np.int32)
        self._cell_pages: Int32Array = np.zeros((0, 2), np.int32)
        self.cell_seen_s: FloatArray = np.zeros(0)
        self._table: Int32Array = np.full(0, -1, np.int32)
        self._grow_cells()

    @property
    def alive(self) -> int:
        """How many surfels there are."""
        return int(self._counters[ALIVE])

    @property
    def memory_bytes(self) -> int:
        """Of cells, and of the pages that were ever written to."""
        of_all = sum(int(array.nbytes) for array in (*self.surfels, *self.pages))
        of_cells = sum(array.nbytes for array in self.cells if isinstance(array, np.ndarray))
        return of_cells + of_all * int(self._counters[PAGES]) // len(self.page_next)

    @property
    def room(self) -> float:
        """The share of the bound on memory that is still free."""
        used = int(self._counters[PAGES]) - int(self._counters[FREE])
        return 1.0 - used / len(self.page_next)

    def count_deaths(self, count: int) -> None:
        """Note that so many surfels' confidence was set to 0."""
        self._counters[ALIVE] -= count

    def slots(self) -> np.ndarray:
        """(n,) slots of all surfels alive, cell by cell in the order in which cells were first seen."""
        chains = []
        for cell in range(self._counters[CELLS]):
            page = self._cell_pages[cell, 0]
            while page >= 0:
                chains.append(np.arange(page * PAGE, page * PAGE + self.page_fill[page]))
                page = self.page_next[page]
        slots = np.concatenate(chains) if chains else np.zeros(0, np.int64)
        alive: np.ndarray = slots[self.geometry[slots, CONFIDENCE] > 0]
        return alive

    def pages_in_view(
        self, T_map_camera: FloatArray, intrinsics: FloatArray, shape: tuple[int, int], far_m: float, since_s: float
    ) -> Int32Array:
        """Pages of surfels that a camera may see, leaving out cells of which nothing was seen since `since_s`."""
        out = np.empty(self._counters[PAGES], np.int32)
        view = Frustum(T_map_camera, intrinsics, shape[1], shape[0], far_m)
        count: int = kernels.pages_in_view(view, since_s, self.page_next, self.cells, out)
        return out[:count]

    def append(self, new: SurfelArrays, now_s: float, rules: FloatArray) -> int:
        """Add surfels, in order; how many found room.

        Where there is none left, the least useful tenth of the map goes first.
        """
        done, has_dropped = 0, False
        while True:
            done = int(kernels.append(new, done, self.surfels, self.pages, self.cells))
            if done == len(new.geometry):
                return done
            if self._grow():
                continue
            if has_dropped:
                self.dropped += len(new.geometry) - done
                return done
            self._drop_least_useful(now_s, rules)
            has_dropped = True

    def sweep(self, now_s: float, rules: FloatArray) -> int:
        """Compact the next cells, and let unstable surfels there go whose time has come; how many did.

        `rules`: confidence of the stable, seconds after which others go, active window in seconds, and seconds for
        which others may go unseen.
        """
        cells = int(self._counters[CELLS])
        if self._cursor >= cells:
            self._cursor = 0
        died, self._cursor = self._compact(self._cursor, cells, _SWEPT_SURFELS, now_s, rules, np.zeros(0, np.int64))
        return died

    def sweep_all(self, now_s: float, rules: FloatArray) -> int:
        """The same in all cells at once."""
        everything = int(self._counters[CELLS]), np.iinfo(np.int64).max
        return self._compact(0, *everything, now_s, rules, np.zeros(0, np.int64))[0]

    def move(self, T_new_old: FloatArray, now_s: float, rules: FloatArray, share: Share) -> None:
        """Move surfels with their keyframes: (K + 1, 4, 4) by keyframe, the last of those that name none of these.

        Those that leave their cell are laid into the one they come to; who finds no room there is counted as dropped.
        `share` is of `Rows`: a frame waits for this, and it goes over the whole map.
        """
        has_moved, pages = (T_new_old != np.eye(4)).any(axis=(1, 2)), int(self._counters[PAGES])
        has_left = np.zeros(pages * PAGE, np.bool_)
        given = (T_new_old, has_moved, self.surfels, self.pages, self.cells, has_left)
        share(pages, lambda a, b: move_kernels.move(a, b, *given))
        left = np.flatnonzero(has_left)
        if len(left):
            are_many = len(left) > _LEFT_AT_ONCE * self.alive  # to lay them anew takes longer than to make room
            taken = self._lifted(left)
            if are_many or self.room < _DROPPED_AT_ONCE + len(left) / len(self.geometry):
                self._close_gaps(now_s)  # else `sweep` does, a part at a time
            self.append(taken, now_s, rules)

    def take_out(self, slots: Int32Array | IntArray, now_s: float) -> SurfelArrays:
        """Copies of surfels at (n,) slots, which are free from then on."""
        taken = self._lifted(slots)
        self._close_gaps(now_s)
        return taken

    def _lifted(self, slots: Int32Array | IntArray) -> SurfelArrays:
        """Copies of surfels at (n,) slots, which are dead from then on."""
        taken = SurfelArrays(*(array[slots] for array in self.surfels))
        self.geometry[slots, CONFIDENCE] = 0.0
        self.count_deaths(len(slots))
        return taken

    def _close_gaps(self, now_s: float) -> None:
        """Free what the dead take, everywhere."""
        everything = int(self._counters[CELLS]), np.iinfo(np.int64).max
        self._compact(0, *everything, now_s, _NONE_GOES, np.zeros(0, np.int64))

    def _drop_least_useful(self, now_s: float, rules: FloatArray) -> None:
        """Let a tenth of all surfels go, those of least use first."""
        bins = np.zeros(_BINS, np.int64)
        kernels.count_usefulness(
            self.geometry, self.seen_s, self.page_fill, int(self._counters[PAGES]), now_s, rules[2], bins
        )
        before = np.concatenate([[0], np.cumsum(bins)[:-1]])
        quota = np.clip(np.ceil(_DROPPED_AT_ONCE * self.alive).astype(np.int64) - before, 0, bins)
        everything = int(self._counters[CELLS]), np.iinfo(np.int64).max
        self.dropped += self._compact(0, *everything, now_s, rules, quota)[0]

    def _compact(
        self, begin: int, end: int, budget: int, now_s: float, rules: FloatArray, quota: np.ndarray
    ) -> tuple[int, int]:
        going = Going(now_s, rules, quota)
        died, then = kernels.compact(begin, end, budget, going, self.surfels, self.pages, self.cells)
        return int(died), int(then)

    def _grow(self) -> bool:
        """Make room for more cells; False where it is pages that are wanting."""
        cells = int(self._counters[CELLS])
        if cells < len(self.cell_xyz) and 2 * cells < len(self._table):
            return False
        self._grow_cells()
        return True

    def _grow_cells(self) -> None:
        cells = max(2 * len(self.cell_xyz), 1024)
        for name in ("cell_xyz", "_cell_pages", "cell_seen_s"):
            setattr(self, name, _grown(getattr(self, name), cells))
        self._table = np.full(4 * cells, -1, np.int32)
        kernels.rebuild_table(self._table, self.cell_xyz, int(self._counters[CELLS]))

    @property
    def surfels(self) -> SurfelArrays:
        """All slots, for kernels."""
        return SurfelArrays(self.geometry, self.look, self.seen_s, self.variance, self.keyframe)

    @property
    def pages(self) -> Pages:
        """All pages, for kernels."""
        return Pages(self.page_next, self.page_fill, self.page_cell, self._free)

    @property
    def cells(self) -> Cells:
        """All cells, for kernels."""
        return Cells(self.block_m, self.cell_xyz, self._cell_pages, self.cell_seen_s, self._table, self._counters)


def _grown(array: np.ndarray, length: int) -> np.ndarray:
    grown = np.zeros((length, *array.shape[1:]), array.dtype)
    grown[: len(array)] = array
    return grown
