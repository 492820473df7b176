"""Lines over time as a browser can draw them: broken where nothing is known, thinned where they are long."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import BoolArray, FloatArray, IntArray
from wheelsight.pipeline.run_record import RunRecord

DRAWN_POINTS = 4000
_SAME_STAMP_S = 1e-3  # stamps of one frame in two files differ by no more than their last decimal


def poseless_stamps_s(record: RunRecord) -> FloatArray:
    """Stamps (K,) of the frames that leave a gap in the trajectory, growing: it has no pose where theirs would be.

    Repeated images are no frames.
    """
    frames = [frame for frame in record.frames if not frame.is_repeat]
    stamps_s = np.array([frame.stamp_s for frame in frames], float)
    pose_s = np.array([frame.pose_s for frame in frames], float)
    known_s = record.estimate.stamps_s
    if len(known_s) == 0:
        return np.sort(stamps_s)
    after = np.searchsorted(known_s, pose_s).clip(0, len(known_s) - 1)
    nearest_s = np.minimum(abs(known_s[after] - pose_s), abs(known_s[(after - 1).clip(0)] - pose_s))
    return np.sort(stamps_s[nearest_s > _SAME_STAMP_S])


def with_gaps(stamps_s: FloatArray, values: FloatArray, breaks_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stamps (N,) and values (N, ...) with a row of NaN wherever one of `breaks_s` (K,) lies between two stamps."""
    stamps_s, values = np.asarray(stamps_s, float), np.asarray(values, float)
    if len(stamps_s) < 2:
        return stamps_s, values
    broken = np.flatnonzero(np.diff(np.searchsorted(breaks_s, stamps_s)) > 0)
    middle_s = (stamps_s[broken] + stamps_s[broken + 1]) / 2
    return np.insert(stamps_s, broken + 1, middle_s), np.insert(values, broken + 1, np.nan, axis=0)


def keep_peaks(values: FloatArray, limit: int = DRAWN_POINTS) -> IntArray:
    """Indices of at most about `limit` of (N,) values: the least, the greatest and a gap of each bucket in time."""
    n = len(values)
    if n <= limit:
        return np.arange(n)
    bucket = np.arange(n) * (limit // 3) // n
    order = np.lexsort((values, bucket))  # NaN sorts last
    first = np.flatnonzero(np.diff(bucket, prepend=-1))
    known = np.bincount(bucket, weights=~np.isnan(values)).astype(int)
    lowest = order[first]
    highest = order[first + np.maximum(known, 1) - 1]
    last = order[np.append(first[1:], n) - 1]
    return np.unique(np.concatenate([[0, n - 1], lowest, highest, last]))


def keep_shape(path: FloatArray, limit: int = DRAWN_POINTS) -> IntArray:
    """Indices of at most about `limit` points of a path (N, D): the extremes of each stretch, and the ends of gaps."""
    n, coordinates = path.shape
    if n <= limit:
        return np.arange(n)
    gap = np.flatnonzero(np.isnan(path).any(axis=1))
    if len(gap) > limit:
        gap = gap[:: len(gap) // limit + 1]
    extremes = [keep_peaks(column, limit // coordinates) for column in path.T]
    return np.unique(np.concatenate([*extremes, gap, (gap - 1).clip(0), (gap + 1).clip(0, n - 1)]))


def alone(values: FloatArray) -> BoolArray:
    """Which of (N,) values have no known neighbour, so that a line would not show them."""
    known = ~np.isnan(values)
    before, after = np.roll(known, 1), np.roll(known, -1)
    before[:1], after[-1:] = False, False
    return known & ~before & ~after
