"""Sight: how much floor that nobody has seen a depth camera would see from places of a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry import BoolArray, ByteArray, FloatArray, IntArray

# Rays all around, from a place of which the gain is asked: at 3.5 m they are 0.3 m apart.
_RAYS = 72
# Places at a time, which bounds memory to some tens of megabytes.
_AT_ONCE = 256
_WANTED, _OPAQUE = 1, 2


@dataclass(frozen=True, slots=True)
class Sight:
    """Of a camera that looks ahead.

    Attributes:
        near_m, far_m: from the axle, the nearest floor that it sees, and the farthest that counts.
        half_rad: to either side of straight ahead.
    """

    near_m: float
    far_m: float
    half_rad: float

    def gains_m2(self, marked: ByteArray, resolution_m: float, cells: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What it would see of what is wanted, looking each way from some places.

        Args:
            marked: (H, W) of `marks`.
            resolution_m: side of a cell.
            cells: (P, 2) row and column, of which .5 is a cell's middle.

        Returns:
            gains (P, R) in m², and the headings (R,) to which they belong.
        """
        turn = 2 * np.pi / _RAYS
        headings: FloatArray = np.linspace(-np.pi, np.pi, _RAYS, endpoint=False)
        along_m = self._along_m(resolution_m)
        area = np.where(along_m >= self.near_m, along_m * resolution_m * turn, 0.0)
        by_ray = [
            _is_seen(marked, resolution_m, some, headings, along_m) @ area for some in _chunks(np.asarray(cells, float))
        ]
        gain = np.concatenate([np.zeros((0, _RAYS)), *by_ray])
        # A ray stands for half a turn to either side of it, hence the outermost count by a part.
        whole = int(self.half_rad / turn - 0.5)
        rest = min(self.half_rad / turn - 0.5 - whole, 1.0)
        shares = dict.fromkeys(range(-whole, whole + 1), 1.0) | {whole + 1: rest, -whole - 1: rest}
        return np.sum([share * np.roll(gain, k, axis=1) for k, share in shares.items()], axis=0), headings

    def seen(self, marked: ByteArray, resolution_m: float, cell: FloatArray, heading_rad: float) -> IntArray:
        """(N, 2) row and column of the cells that are wanted and would be seen from a place (2,), looking one way."""
        count = 2 + int(2 * self.half_rad * self.far_m / resolution_m)
        headings = heading_rad + np.linspace(-self.half_rad, self.half_rad, count)
        along_m = self._along_m(resolution_m)
        is_seen = _is_seen(marked, resolution_m, np.asarray(cell, float)[None], headings, along_m)[0]
        ray, step = np.nonzero(is_seen & (along_m >= self.near_m))
        return np.unique(_cells_along(cell, headings[ray], along_m[step] / resolution_m), axis=0)

    def _along_m(self, resolution_m: float) -> FloatArray:
        return np.arange(0.5 * resolution_m, self.far_m, resolution_m)


def marks(is_clear: BoolArray, is_wanted: BoolArray) -> ByteArray:
    """(H, W) what `Sight` goes by: which cells are wanted, and which can be seen past; others hide what is behind."""
    return np.where(is_clear, np.where(is_wanted, _WANTED, 0), _OPAQUE).astype(np.uint8)


def _is_seen(
    marked: ByteArray, resolution_m: float, cells: FloatArray, headings: FloatArray, along_m: FloatArray
) -> BoolArray:
    """(P, R, S) whether what is wanted lies there, and nothing before it; beyond the edges there is neither."""
    at = _cells_along(cells[:, None, None], headings[:, None], along_m / resolution_m)
    inside = ((at >= 0) & (at < marked.shape)).all(axis=-1)
    at[~inside] = 0
    met = np.where(inside, marked[at[..., 0], at[..., 1]], 0)
    is_hidden = np.maximum.accumulate(met == _OPAQUE, axis=-1)
    return np.asarray((met == _WANTED) & ~is_hidden)


def _cells_along(cells: ArrayLike, headings: FloatArray, steps: FloatArray) -> IntArray:
    """(..., 2) row and column so many cells from places, in directions."""
    ways = np.stack(np.broadcast_arrays(steps * np.sin(headings), steps * np.cos(headings)), axis=-1)
    return np.asarray(np.floor(np.asarray(cells, float) + ways), np.int64)


def _chunks(cells: FloatArray) -> list[FloatArray]:
    return [cells[k : k + _AT_ONCE] for k in range(0, len(cells), _AT_ONCE)]
