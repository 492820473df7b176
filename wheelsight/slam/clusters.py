"""Loops that speak of one stretch and agree with each other: they are right or wrong together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wheelsight.geometry import BoolArray, FloatArray, IntArray, chi_square, se3
from wheelsight.slam.graph import RelativePose


def clusters_of(loops: Sequence[RelativePose], T: FloatArray, nearby: int, probability: float) -> IntArray:
    """The number of the cluster (L,) of each loop, from 0.

    Args:
        loops: of keyframes.
        T: (N, 4, 4) their poses; only those of neighbours are compared, which odometry knows well.
        nearby: keyframes that lie between neighbours at either end, at most.
        probability: with which two loops that are true agree.
    """
    first, second = (np.array([getattr(loop, end) for loop in loops], np.int64) for end in ("first", "second"))
    order = np.argsort(first, kind="stable")
    ends = np.searchsorted(first[order], first[order] + nearby, side="right")
    pairs = [np.empty((0, 2), np.int64)]
    for here, end in enumerate(ends):
        later = order[here + 1 : end]
        later = later[np.abs(second[later] - second[order[here]]) <= nearby]
        pairs.append(np.column_stack([np.full(len(later), order[here]), later]))
    i, j = np.concatenate(pairs).T
    agree = _agree(loops, T, i, j, probability)
    joined = coo_array((np.ones(np.count_nonzero(agree)), (i[agree], j[agree])), shape=(len(loops), len(loops)))
    return np.asarray(connected_components(joined, directed=False)[1], np.int64)


def _agree(loops: Sequence[RelativePose], T: FloatArray, i: IntArray, j: IntArray, probability: float) -> BoolArray:
    """Whether loops i and j (P,) say the same of how two stretches lie."""
    if not len(i):
        return np.zeros(0, bool)
    first, second = (np.array([getattr(loop, end) for loop in loops], np.int64) for end in ("first", "second"))
    Z = np.array([loop.T_first_second for loop in loops])
    C = np.array([loop.covariance for loop in loops])
    # The stretches as j has them, expressed for the keyframes of i.
    before = se3.invert(T[first[i]]) @ T[first[j]]
    told = before @ Z[j] @ se3.invert(T[second[j]]) @ T[second[i]]
    Ad = se3.adjoint(before)
    r = se3.log(told @ se3.invert(Z[i]))
    S = C[i] + Ad @ C[j] @ np.swapaxes(Ad, 1, 2)
    squares = np.einsum("pi,pi->p", r, np.linalg.solve(S, r[..., None])[..., 0])
    freedom = np.minimum(*(np.array([loop.freedom for loop in loops])[of] for of in (i, j)))
    return np.asarray(squares <= [chi_square.quantile(probability, degrees) for degrees in freedom.tolist()])
