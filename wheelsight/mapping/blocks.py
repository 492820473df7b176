"""`Blocks` stores surfels by cells of space. `Nearness` moves parts of a map that are far from the camera to the
disk and back.
"""

from __future__ import annotations

import shutil
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from wheelsight.core.files import StrPath
from wheelsight.core.geometry import Float32Array, FloatArray, Int32Array, IntArray, se3
from wheelsight.mapping import block_kernels as kernels
from wheelsight.mapping.block_kernels import (
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
from wheelsight.mapping.fusion_kernels import move
from wheelsight.mapping.settings import SurfelSettings

# Surfels in blocks of space: flat arrays, of which those in view are found without touching the others.


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
        share(pages, lambda a, b: move(a, b, *given))
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


# Nearness: pieces of a map that lie far away rest on the disk (RestingSurfels) until the camera comes back.
#
# A piece is all that hangs on a keyframe. So memory is bounded, and nothing that was seen is given up.


_NORMAL = slice(4, 7)
# What comes back is nearer by so much than what may rest, so that nothing comes and goes with each step.
_BACK_WITHIN = 0.9

# Of a surfel on the disk: geometry, look, when it was seen, variance.
_ROW = np.dtype([("geometry", "<f4", 8), ("look", "<f4", 4), ("seen_s", "<f8", 2), ("variance", "<f4")])


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """All that hangs on a keyframe; its file, how many surfels, and where the keyframe (4, 4) was when it was put."""

    path: Path
    count: int
    T_map_keyframe: FloatArray


class RestingSurfels:
    """Surfels by the keyframe that they hang on: those of one come and go together.

    Between the two the keyframe may move, as loops do it; its surfels come back moved with it. What cannot be read back
    is gone and counted.

    Args:
        folder: in which a temporary folder is made once it is needed; None for the system's.

    Attributes:
        lost: surfels that could not be read back.
    """

    def __init__(self, folder: StrPath | None = None) -> None:
        self.lost = 0
        self._folder, self._made = folder, 0
        self._temporary: Path | None = None
        self._pieces: dict[int, _Piece] = {}
        self._count = 0  # a run asks at each reading, and there may be thousands of pieces

    def __len__(self) -> int:
        return self._count

    @property
    def keyframes(self) -> IntArray:
        """(n,) numbers of those whose surfels rest, in order."""
        return np.array(sorted(self._pieces), np.int64)

    def put(self, keyframe: int, surfels: SurfelArrays, T_map_keyframe: FloatArray) -> None:
        """Write what hangs on a keyframe at (4, 4), with what rests of it already. Raises OSError."""
        before = self._read(keyframe) if keyframe in self._pieces else np.zeros(0, _ROW)
        rows = np.zeros(len(surfels.geometry), _ROW)
        for name in _ROW.names or ():
            rows[name] = getattr(surfels, name)
        if len(before):
            rows = np.concatenate([_moved(before, T_map_keyframe, self._pieces[keyframe]), rows])
        path = self._new_path()
        path.write_bytes(rows.tobytes())
        self._forget(keyframe)
        self._pieces[keyframe] = _Piece(path, len(rows), T_map_keyframe.copy())
        self._count += len(rows)

    def take(self, keyframe: int, T_map_keyframe: FloatArray) -> SurfelArrays:
        """What hangs on a keyframe that is at (4, 4) by now; it rests no longer."""
        found = self._at(keyframe, T_map_keyframe)
        self._forget(keyframe)
        return found

    def all(self, T_map_keyframe: FloatArray, within: tuple[int, int] | None = None) -> Iterator[SurfelArrays]:
        """Copies of all that rests, a keyframe at a time, where keyframes are at (K, 4, 4); they rest on.

        Of keyframes `within` an interval alone, its end excluded.
        """
        first, end = within or (0, len(T_map_keyframe))
        for keyframe in (number for number in self.keyframes.tolist() if first <= number < end):
            yield self._at(keyframe, T_map_keyframe[keyframe])

    def _at(self, keyframe: int, T_map_keyframe: FloatArray) -> SurfelArrays:
        piece = self._pieces[keyframe]
        rows = _moved(self._read(keyframe), T_map_keyframe, piece)
        geometry, look, seen_s, variance = (np.ascontiguousarray(rows[name]) for name in _ROW.names or ())
        return SurfelArrays(geometry, look, seen_s, variance, np.full(len(rows), keyframe, np.int32))

    def _read(self, keyframe: int) -> np.ndarray:
        piece = self._pieces[keyframe]
        try:
            data = piece.path.read_bytes()
        except OSError:
            data = b""
        if len(data) != piece.count * _ROW.itemsize:
            self.lost += piece.count
            self._forget(keyframe)
            return np.zeros(0, _ROW)
        return np.frombuffer(data, _ROW).copy()

    def _forget(self, keyframe: int) -> None:
        piece = self._pieces.pop(keyframe, None)
        if piece is not None:
            self._count -= piece.count
            piece.path.unlink(missing_ok=True)

    def _new_path(self) -> Path:
        if self._temporary is None:
            self._temporary = Path(mkdtemp(prefix="wheelsight-surfels-", dir=self._folder))
            weakref.finalize(self, shutil.rmtree, self._temporary, ignore_errors=True)
        self._made += 1
        return self._temporary / f"{self._made}.surfels"


class Nearness:
    """Keeps in memory what a camera is near to, and lets the rest of a map rest where memory runs short.

    Args:
        settings: of the map.

    Attributes:
        resting: what is on the disk.
    """

    def __init__(self, settings: SurfelSettings) -> None:
        self.resting = RestingSurfels(settings.resting_folder)
        self._settings, self._writes = settings, True

    def come_near(self, blocks: Blocks, poses: tuple[FloatArray, FloatArray], now_s: float, rules: FloatArray) -> None:
        """Bring back what a camera may see, and make room if there is hardly any.

        Args:
            blocks: the map in memory.
            poses: T_map_keyframe (K, 4, 4) of all keyframes, and T_map_camera (4, 4).
            now_s, rules: as `Blocks` takes them.
        """
        if not len(poses[0]) or (blocks.room >= self._settings.least_room and not len(self.resting)):
            return
        self._bring_back(blocks, poses, now_s, rules)
        if blocks.room < self._settings.least_room and self._writes:
            self._make_room(blocks, poses, now_s)

    def _bring_back(
        self, blocks: Blocks, poses: tuple[FloatArray, FloatArray], now_s: float, rules: FloatArray
    ) -> None:
        T_map_keyframe, T_map_camera = poses
        rests = self.resting.keyframes
        apart_m = _apart_m(T_map_keyframe[rests], T_map_camera)
        for keyframe in rests[apart_m < _BACK_WITHIN * self._beyond_m].tolist():
            coming = self.resting.take(keyframe, T_map_keyframe[keyframe])
            share = len(coming.geometry) / self._settings.max_surfels
            if blocks.room < self._settings.least_room + share and self._writes:
                self._make_room(blocks, poses, now_s, share)
            blocks.append(coming, now_s, rules)

    def _make_room(self, blocks: Blocks, poses: tuple[FloatArray, FloatArray], now_s: float, more: float = 0.0) -> None:
        """Let what hangs on the farthest keyframes rest, as much as makes room enough; where none is far, none."""
        T_map_keyframe, T_map_camera = poses
        alive = blocks.slots()
        numbers = blocks.keyframe[alive]
        counts = np.bincount(numbers[numbers >= 0], minlength=len(T_map_keyframe))
        apart_m = np.where(counts > 0, _apart_m(T_map_keyframe, T_map_camera), 0.0)
        farthest = np.argsort(-apart_m, kind="stable")
        wanted = (self._settings.room_made + more - blocks.room) * self._settings.max_surfels
        before = np.cumsum(counts[farthest]) - counts[farthest]
        going = farthest[(apart_m[farthest] > self._beyond_m) & (before < wanted)]
        alive = alive[np.isin(numbers, going)]
        gone = self._write(blocks.surfels, alive, T_map_keyframe)
        if len(gone):
            blocks.take_out(gone, now_s)

    def lay_by(self, new: SurfelArrays, T_map_keyframe: FloatArray, most: int) -> SurfelArrays:
        """Surfels that are to come into memory, without those for which there is no room: these are on the disk.

        Args:
            new: that hang on keyframes at (K, 4, 4), or on none.
            most: that find room.
        """
        numbers = new.keyframe
        if len(numbers) <= most or not len(T_map_keyframe):
            return new
        counts = np.bincount(numbers[numbers >= 0], minlength=len(T_map_keyframe))
        staying = np.cumsum(counts) + np.count_nonzero(numbers < 0) <= most
        gone = self._write(new, np.flatnonzero((numbers >= 0) & ~staying[numbers]), T_map_keyframe)
        rest = np.delete(np.arange(len(numbers)), gone)
        return SurfelArrays(*(array[rest] for array in new))

    def _write(self, surfels: SurfelArrays, chosen: IntArray, T_map_keyframe: FloatArray) -> IntArray:
        """Write the chosen ones (n,) by their keyframes; which of them are on the disk now."""
        chosen = chosen[np.argsort(surfels.keyframe[chosen], kind="stable")]
        numbers, begins = np.unique(surfels.keyframe[chosen], return_index=True)
        for keyframe, begin, end in zip(numbers.tolist(), begins, [*begins[1:], len(chosen)], strict=False):
            part = SurfelArrays(*(array[chosen[begin:end]] for array in surfels))
            try:
                self.resting.put(keyframe, part, T_map_keyframe[keyframe])
            except OSError:
                self._writes = False  # a disk that is full stays so; from now on the bound drops what is least useful
                return chosen[:begin]
        return chosen

    @property
    def _beyond_m(self) -> float:
        return self._settings.rests_beyond * self._settings.far_m


def _apart_m(T_map_keyframe: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    """(K,) how far keyframes (K, 4, 4) are from a camera (4, 4); 0 where nobody knows."""
    apart_m = np.linalg.norm(T_map_keyframe[:, :3, 3] - T_map_camera[:3, 3], axis=1)
    return np.asarray(np.nan_to_num(apart_m, nan=0.0))


def _moved(rows: np.ndarray, T_map_keyframe: FloatArray, piece: _Piece) -> np.ndarray:
    """Rows with positions and normals where their keyframe is by now."""
    if np.array_equal(T_map_keyframe, piece.T_map_keyframe) or not np.isfinite(T_map_keyframe).all():
        return rows
    T_new_old = T_map_keyframe @ se3.invert(piece.T_map_keyframe)
    geometry = rows["geometry"]
    geometry[:, :3] = se3.apply(T_new_old, geometry[:, :3])
    geometry[:, _NORMAL] = geometry[:, _NORMAL] @ T_new_old[:3, :3].T
    return rows
