"""SeenDepths: what an occupancy map keeps of each keyframe, of which most rests in a temporary file."""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wheelsight.calibration import DepthNoise
from wheelsight.errors import MapError
from wheelsight.geometry import Float32Array
from wheelsight.keyframes import Keyframe, KeyframeId
from wheelsight.mapping import _occupancy_kernels as kernels

_UNITS_PER_M = 5000.0
# 10 kB each: an hour of driving has some 4500, and those of a room need no file.
_IN_MEMORY = 256
_LOST = "make room on the disk, and make the map anew"


@dataclass(frozen=True, slots=True, eq=False)
class SeenDepth:
    """Some of a keyframe's depth (h, w), in fifths of a millimetre, and the slopes (w,) and (h,) of its rays."""

    depth: NDArray[np.uint16]
    slope_x: Float32Array
    slope_y: Float32Array

    @classmethod
    def of(cls, keyframe: Keyframe, columns: int, noise: DepthNoise) -> SeenDepth:
        """What `noise` trusts of a keyframe, in about so many columns."""
        depth_m = keyframe.depth_m
        step = max(1, round(depth_m.shape[1] / columns))
        v, u = (np.arange(step // 2, size, step) for size in depth_m.shape)
        fx, fy, cx, cy = keyframe.intrinsics
        some = depth_m[np.ix_(v, u)]
        trusted = np.where((some >= noise.near_m) & (some <= noise.far_m), some, 0)
        depth = np.clip(np.rint(trusted * _UNITS_PER_M), 0, np.iinfo(np.uint16).max).astype(np.uint16)
        return cls(depth, ((u - cx) / fx).astype(np.float32), ((v - cy) / fy).astype(np.float32))

    def rays(self) -> kernels.DepthRays:
        """As kernels take them."""
        return kernels.DepthRays(self.depth.astype(np.float32) / np.float32(_UNITS_PER_M), self.slope_x, self.slope_y)


class _Rests(NamedTuple):
    offset: int
    shape: tuple[int, int]


class SeenDepths:
    """By keyframe, in the order in which they were put in. Where the file cannot be written, all stay in memory.

    Args:
        in_memory: how many stay there in any case, the first ones.
    """

    def __init__(self, in_memory: int = _IN_MEMORY) -> None:
        self._all: dict[KeyframeId, SeenDepth | _Rests] = {}
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
        if len(self._all) > self._most and self._has_disk:
            try:
                self._all[number] = self._written(seen)
            except OSError:
                self._has_disk = False

    def __getitem__(self, number: KeyframeId) -> SeenDepth:
        """Raises MapError where the file has lost it."""
        found = self._all[number]
        return self._read(found) if isinstance(found, _Rests) else found

    def _written(self, seen: SeenDepth) -> _Rests:
        if self._file is None:
            self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - as long as the map is made
            weakref.finalize(self, self._file.close)
        data = memoryview(b"".join(array.tobytes() for array in (seen.depth, seen.slope_x, seen.slope_y)))
        begin = self._end
        self._file.seek(begin)
        while data:  # a disk that is nearly full takes a part
            data = data[self._file.write(data) :]
        self._end = self._file.tell()
        height, width = seen.depth.shape
        return _Rests(begin, (height, width))

    def _read(self, rests: _Rests) -> SeenDepth:
        assert self._file is not None
        (height, width), begin = rests.shape, rests.offset
        sizes = (2 * height * width, 4 * width, 4 * height)
        try:
            data = os.pread(self._file.fileno(), sum(sizes), begin)
        except OSError as error:
            raise MapError(f"the depth of a keyframe cannot be read again: {error}", fix=_LOST) from error
        if len(data) != sum(sizes):
            raise MapError("the depth of a keyframe that rests on disk is cut off", fix=_LOST)
        slopes = np.frombuffer(data, np.float32, width + height, sizes[0])
        depth = np.frombuffer(data, np.uint16, height * width).reshape(height, width)
        return SeenDepth(depth, slopes[:width], slopes[width:])
