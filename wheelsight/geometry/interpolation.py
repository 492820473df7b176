"""Poses between the stamps at which they are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry import se3
from wheelsight.geometry.arrays import FloatArray


def interpolate_at(stamps_s: ArrayLike, T: ArrayLike, wanted_s: ArrayLike, max_gap_s: float = np.inf) -> FloatArray:
    """Motions (M, 4, 4) at stamps (M,), along the geodesic between neighbours of (N,) stamps, (N, 4, 4) motions.

    Stamps outside the range, or between neighbours more than `max_gap_s` apart, give NaN: never a guess.
    """
    stamps_s, T = np.asarray(stamps_s, float), np.asarray(T, float)
    wanted_s = np.atleast_1d(np.asarray(wanted_s, float))
    result = np.full((len(wanted_s), 4, 4), np.nan)
    if len(stamps_s) == 0:
        return result
    after = np.searchsorted(stamps_s, wanted_s, side="left").clip(0, len(stamps_s) - 1)
    exact = stamps_s[after] == wanted_s
    result[exact] = T[after[exact]]
    before = (after - 1).clip(0)
    gap_s = stamps_s[after] - stamps_s[before]
    between = ~exact & (stamps_s[before] < wanted_s) & (wanted_s < stamps_s[after]) & (gap_s <= max_gap_s)
    i, j = before[between], after[between]
    if len(i) == 1:
        # Single motions are reckoned in plain numbers: as a batch of one they take four times as long.
        i, j = i[0], j[0]
    if np.size(i):
        result[between] = se3.interpolate(T[i], T[j], np.squeeze((wanted_s[between] - stamps_s[i]) / gap_s[between]))
    return result
