"""`Blocks` stores surfels by cells of space. `SurfelPaging` moves distant parts of a map to the disk and back."""

from __future__ import annotations

import shutil
import weakref
from collections.abc import Iterator
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
    Frustum,
    Going,
    Pages,
    SurfelArrays,
    SurfelCells,
)
from wheelsight.mapping.fusion_kernels import move

_BINS = 512
# Share of surfels dropped at once. Dropping visits the whole map, and a tenth at once makes it rare.
_DROPPED_AT_ONCE = 0.1
_SWEPT_SURFELS = 1 << 15
# If a larger share leaves its cells in one move, as after the first loop, the cells are compacted at once. Otherwise
# the map would soon take several times its memory.
_LEFT_AT_ONCE = 0.25
# Rules of surfels that never expire.
_NONE_GOES = np.array([0.0, np.inf, 1.0, np.inf])


class Blocks:
    """Surfels by the cell of space they lie in.

    Slots come in pages, and each cell owns a chain of pages, so that its surfels are adjacent in memory. Dead surfels
    remain until `sweep` reaches them, which processes a bounded number of surfels per call. Arrays have room for the
    largest number of surfels: the system allocates memory when it is written, and a frame never waits for a copy.

    Attributes:
        geometry: (slots, 8) float32: position (3), radius, normal (3), confidence; confidence is not positive if dead.
        look: (slots, 4) float32: red, green, blue, grey from 0 to 255, -1 if unknown.
        seen_s: (slots, 2) first and last time seen.
        variance: (slots,) float32 variance of the position along the normal, m².
        keyframe: (slots,) int32 keyframe of each, -1 for none.
        dropped: number dropped for lack of memory.
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
        """Number of surfels."""
        return int(self._counters[ALIVE])

    @property
    def memory_bytes(self) -> int:
        """Size of cells, and of the pages written so far."""
        of_all = sum(int(array.nbytes) for array in (*self.surfels, *self.pages))
        of_cells = sum(array.nbytes for array in self.cells if isinstance(array, np.ndarray))
        return of_cells + of_all * int(self._counters[PAGES]) // len(self.page_next)

    @property
    def room(self) -> float:
        """Share of the memory limit that is free."""
        used = int(self._counters[PAGES]) - int(self._counters[FREE])
        return 1.0 - used / len(self.page_next)

    def count_deaths(self, count: int) -> None:
        """Subtract surfels whose confidence was set to 0 from the count."""
        self._counters[ALIVE] -= count

    def slots(self) -> np.ndarray:
        """Return the slots (n,) of all live surfels, cell by cell in order of creation."""
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
        """Return the pages that a camera may see, without cells last seen before `since_s`."""
        out = np.empty(self._counters[PAGES], np.int32)
        view = Frustum(np.array(T_map_camera), intrinsics, shape[1], shape[0], far_m)
        count: int = kernels.pages_in_view(view, since_s, self.page_next, self.cells, out)
        return out[:count]

    def append(self, new: SurfelArrays, now_s: float, rules: FloatArray) -> int:
        """Add surfels in order, and return how many found room.

        Without room, the least useful tenth of the map is dropped first.
        """
        done, has_dropped = 0, False
        while True:
            done = int(kernels.append(new, done, self.surfels, self.pages, self.cells))
            if done == len(new.geometry):
                return done
            cells = int(self._counters[CELLS])
            if cells >= len(self.cell_xyz) or 2 * cells >= len(self._table):
                self._grow_cells()
                continue
            # The pages are full: drop the least useful tenth of all surfels, once.
            if has_dropped:
                self.dropped += len(new.geometry) - done
                return done
            bins = np.zeros(_BINS, np.int64)
            pages = int(self._counters[PAGES])
            kernels.count_usefulness(self.geometry, self.seen_s, self.page_fill, pages, now_s, rules[2], bins)
            before = np.concatenate([[0], np.cumsum(bins)[:-1]])
            quota = np.clip(np.ceil(_DROPPED_AT_ONCE * self.alive).astype(np.int64) - before, 0, bins)
            self.dropped += self._compact(0, cells, np.iinfo(np.int64).max, now_s, rules, quota)[0]
            has_dropped = True

    def sweep(self, now_s: float, rules: FloatArray) -> int:
        """Compact the next cells, remove expired unstable surfels there, and return their number.

        `rules`: confidence of stable surfels, lifetime of others in seconds, active window in seconds, and the time in
        seconds for which others may go unseen.
        """
        cells = int(self._counters[CELLS])
        if self._cursor >= cells:
            self._cursor = 0
        died, self._cursor = self._compact(self._cursor, cells, _SWEPT_SURFELS, now_s, rules, np.zeros(0, np.int64))
        return died

    def sweep_all(self, now_s: float, rules: FloatArray) -> int:
        """Sweep all cells at once."""
        everything = int(self._counters[CELLS]), np.iinfo(np.int64).max
        return self._compact(0, *everything, now_s, rules, np.zeros(0, np.int64))[0]

    def move(self, T_new_old: FloatArray, now_s: float, rules: FloatArray) -> None:
        """Move surfels with their keyframes: motions (K + 1, 4, 4) by keyframe, the last for surfels without one.

        Surfels that leave their cell are moved to the new one; those without room there count as dropped.
        """
        has_moved, pages = (T_new_old != np.eye(4)).any(axis=(1, 2)), int(self._counters[PAGES])
        has_left = np.zeros(pages * PAGE, np.bool_)
        move(0, pages, T_new_old, has_moved, self.surfels, self.pages, self.cells, has_left)
        left = np.flatnonzero(has_left)
        if len(left):
            are_many = len(left) > _LEFT_AT_ONCE * self.alive  # adding them again takes longer than compacting
            taken = self._removed(left)
            if are_many or self.room < _DROPPED_AT_ONCE + len(left) / len(self.geometry):
                self._compact_all(now_s)  # otherwise `sweep` does it gradually
            self.append(taken, now_s, rules)

    def take_out(self, slots: Int32Array | IntArray, now_s: float) -> SurfelArrays:
        """Remove surfels at slots (n,), free their memory, and return copies."""
        taken = self._removed(slots)
        self._compact_all(now_s)
        return taken

    def _removed(self, slots: Int32Array | IntArray) -> SurfelArrays:
        """Mark surfels at slots (n,) as dead, and return copies."""
        taken = SurfelArrays(*(array[slots] for array in self.surfels))
        self.geometry[slots, CONFIDENCE] = 0.0
        self.count_deaths(len(slots))
        return taken

    def _compact_all(self, now_s: float) -> None:
        """Free the slots of all dead surfels."""
        everything = int(self._counters[CELLS]), np.iinfo(np.int64).max
        self._compact(0, *everything, now_s, _NONE_GOES, np.zeros(0, np.int64))

    def _compact(
        self, begin: int, end: int, budget: int, now_s: float, rules: FloatArray, quota: np.ndarray
    ) -> tuple[int, int]:
        going = Going(now_s, rules, quota)
        died, then = kernels.compact(begin, end, budget, going, self.surfels, self.pages, self.cells)
        return int(died), int(then)

    def _grow_cells(self) -> None:
        cells = max(2 * len(self.cell_xyz), 1024)
        for name in ("cell_xyz", "_cell_pages", "cell_seen_s"):
            array = getattr(self, name)
            grown = np.zeros((cells, *array.shape[1:]), array.dtype)
            grown[: len(array)] = array
            setattr(self, name, grown)
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
    def cells(self) -> SurfelCells:
        """All cells, for kernels."""
        return SurfelCells(self.block_m, self.cell_xyz, self._cell_pages, self.cell_seen_s, self._table, self._counters)


# If a smaller share of the memory is free, distant surfels are moved to disk, until _ROOM_MADE is free. Chosen.
LEAST_ROOM, _ROOM_MADE = 0.1, 0.3
# Surfels of keyframes farther from the camera, in multiples of the largest distance of predicted surfels, may be on
# disk: from twice that distance on, neither view overlaps.
_RESTS_BEYOND = 2.5
_NORMAL = slice(4, 7)
# Surfels are loaded within this share of the distance beyond which they are stored, so that they do not alternate.
_BACK_WITHIN = 0.9

# Row of a surfel on disk.
_ROW = np.dtype([("geometry", "<f4", 8), ("look", "<f4", 4), ("seen_s", "<f8", 2), ("variance", "<f4")])


@dataclass(frozen=True, slots=True, eq=False)
class _DiskPart:
    """Surfels of a keyframe on disk: file, number, and the keyframe's pose (4, 4) when they were written."""

    path: Path
    count: int
    T_map_keyframe: FloatArray


class SurfelsOnDisk:
    """Surfels on disk, by keyframe: those of a keyframe are stored and loaded together.

    A keyframe may move in between, by a loop; its surfels are loaded at its new pose. Surfels that cannot be read are
    lost and counted.

    Args:
        folder: folder for a temporary folder, created on demand; None for the system's.

    Attributes:
        lost: number of surfels that could not be read.
    """

    def __init__(self, folder: StrPath | None = None) -> None:
        self.lost = 0
        self._folder, self._made = folder, 0
        self._temporary: Path | None = None
        self._pieces: dict[int, _DiskPart] = {}
        self._count = 0  # requested at each reading, and there may be thousands of pieces

    def __len__(self) -> int:
        return self._count

    @property
    def keyframes(self) -> IntArray:
        """(n,) keyframes with surfels on disk, in order."""
        return np.array(sorted(self._pieces), np.int64)

    def put(self, keyframe: int, surfels: SurfelArrays, T_map_keyframe: FloatArray) -> None:
        """Write surfels of a keyframe at (4, 4), together with those already on disk. Raises OSError."""
        before = self._read(keyframe) if keyframe in self._pieces else np.zeros(0, _ROW)
        rows = np.zeros(len(surfels.geometry), _ROW)
        for name in _ROW.names or ():
            rows[name] = getattr(surfels, name)
        if len(before):
            rows = np.concatenate([_moved(before, T_map_keyframe, self._pieces[keyframe]), rows])
        if self._temporary is None:
            self._temporary = Path(mkdtemp(prefix="wheelsight-surfels-", dir=self._folder))
            weakref.finalize(self, shutil.rmtree, self._temporary, ignore_errors=True)
        self._made += 1
        path = self._temporary / f"{self._made}.surfels"
        path.write_bytes(rows.tobytes())
        self._forget(keyframe)
        self._pieces[keyframe] = _DiskPart(path, len(rows), T_map_keyframe.copy())
        self._count += len(rows)

    def take(self, keyframe: int, T_map_keyframe: FloatArray) -> SurfelArrays:
        """Return the surfels of a keyframe at its current pose (4, 4), and remove them from disk."""
        found = self._at(keyframe, T_map_keyframe)
        self._forget(keyframe)
        return found

    def all(self, T_map_keyframe: FloatArray, within: tuple[int, int] | None = None) -> Iterator[SurfelArrays]:
        """Yield copies of all surfels on disk, a keyframe at a time, at keyframe poses (K, 4, 4).

        `within` limits them to an interval of keyframes, without its end.
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


class SurfelPaging:
    """Keeps the surroundings of the camera in memory, and stores distant surfels on disk when memory is short."""

    def __init__(self, max_surfels: int, far_m: float, folder: StrPath | None) -> None:
        self.resting = SurfelsOnDisk(folder)
        self._most, self._beyond_m, self._writes = max_surfels, _RESTS_BEYOND * far_m, True

    def load_near(self, blocks: Blocks, poses: tuple[FloatArray, FloatArray], now_s: float, rules: FloatArray) -> None:
        """Load the surfels that a camera may see, and store distant ones if memory is short.

        Args:
            poses: T_map_keyframe (K, 4, 4) of all keyframes, and T_map_camera (4, 4).
        """
        if not len(poses[0]) or (blocks.room >= LEAST_ROOM and not len(self.resting)):
            return
        T_map_keyframe, T_map_camera = poses
        rests = self.resting.keyframes
        apart_m = _apart_m(T_map_keyframe[rests], T_map_camera)
        for keyframe in rests[apart_m < _BACK_WITHIN * self._beyond_m].tolist():
            coming = self.resting.take(keyframe, T_map_keyframe[keyframe])
            share = len(coming.geometry) / self._most
            if blocks.room < LEAST_ROOM + share and self._writes:
                self._make_room(blocks, poses, now_s, share)
            blocks.append(coming, now_s, rules)
        if blocks.room < LEAST_ROOM and self._writes:
            self._make_room(blocks, poses, now_s)

    def _make_room(self, blocks: Blocks, poses: tuple[FloatArray, FloatArray], now_s: float, more: float = 0.0) -> None:
        """Store surfels of the farthest keyframes until there is enough room; none if all are near."""
        T_map_keyframe, T_map_camera = poses
        alive = blocks.slots()
        numbers = blocks.keyframe[alive]
        counts = np.bincount(numbers[numbers >= 0], minlength=len(T_map_keyframe))
        apart_m = np.where(counts > 0, _apart_m(T_map_keyframe, T_map_camera), 0.0)
        farthest = np.argsort(-apart_m, kind="stable")
        wanted = (_ROOM_MADE + more - blocks.room) * self._most
        before = np.cumsum(counts[farthest]) - counts[farthest]
        going = farthest[(apart_m[farthest] > self._beyond_m) & (before < wanted)]
        alive = alive[np.isin(numbers, going)]
        gone = self._write(blocks.surfels, alive, T_map_keyframe)
        if len(gone):
            blocks.take_out(gone, now_s)

    def store_surplus(self, new: SurfelArrays, T_map_keyframe: FloatArray, most: int) -> SurfelArrays:
        """Return new surfels without those that exceed the memory, which are stored on disk.

        Args:
            new: surfels of keyframes at (K, 4, 4), or of none.
            most: number with room in memory.
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
        """Write chosen surfels (n,) by keyframe, and return those now on disk."""
        chosen = chosen[np.argsort(surfels.keyframe[chosen], kind="stable")]
        numbers, begins = np.unique(surfels.keyframe[chosen], return_index=True)
        for keyframe, begin, end in zip(numbers.tolist(), begins, [*begins[1:], len(chosen)], strict=False):
            part = SurfelArrays(*(array[chosen[begin:end]] for array in surfels))
            try:
                self.resting.put(keyframe, part, T_map_keyframe[keyframe])
            except OSError:
                self._writes = False  # the disk is full: from now on the least useful surfels are dropped
                return chosen[:begin]
        return chosen


def _apart_m(T_map_keyframe: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    """Return distances (K,) of keyframes (K, 4, 4) from a camera (4, 4); 0 for unknown poses."""
    apart_m = np.linalg.norm(T_map_keyframe[:, :3, 3] - T_map_camera[:3, 3], axis=1)
    return np.asarray(np.nan_to_num(apart_m, nan=0.0))


def _moved(rows: np.ndarray, T_map_keyframe: FloatArray, piece: _DiskPart) -> np.ndarray:
    """Return rows with positions and normals at the current keyframe pose."""
    if np.array_equal(T_map_keyframe, piece.T_map_keyframe) or not np.isfinite(T_map_keyframe).all():
        return rows
    T_new_old = T_map_keyframe @ se3.invert(piece.T_map_keyframe)
    geometry = rows["geometry"]
    geometry[:, :3] = se3.apply(T_new_old, geometry[:, :3])
    geometry[:, _NORMAL] = geometry[:, _NORMAL] @ T_new_old[:3, :3].T
    return rows
