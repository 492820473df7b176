"""Nearness: pieces of a map that lie far away rest on the disk (RestingSurfels) until the camera comes back.

A piece is all that hangs on a keyframe. So memory is bounded, and nothing that was seen is given up.
"""

from __future__ import annotations

import shutil
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from wheelsight.files import StrPath
from wheelsight.geometry import FloatArray, IntArray, se3
from wheelsight.mapping._block_kernels import SurfelArrays
from wheelsight.mapping.blocks import Blocks
from wheelsight.mapping.settings import SurfelSettings

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
