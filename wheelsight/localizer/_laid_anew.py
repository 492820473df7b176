"""Keyframes that a camera led astray has laid are put where the wheels know that it went.

Somebody who walks past close by leads a camera some decimetres off. Keyframes that it keeps meanwhile lie there in its
map, one after the other; once the wheels are believed it goes on by them, and would be as far off in the map until
loops have moved them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wheelsight.geometry import FloatArray, se3
from wheelsight.geometry import motion_kernels as motions
from wheelsight.geometry.chi_square import quantile
from wheelsight.keyframes import KeyframeId, KeyframeStore
from wheelsight.slam.drive_graph import LivedKeyframe

# By the frames at which they were kept.
Kept = list[list[LivedKeyframe]]


def laid_anew(store: KeyframeStore, waiting: Kept, probability: float) -> tuple[Kept, FloatArray] | None:
    """Those that wait, and all their poses (K, 4, 4) in the store; None where they may stay where they are.

    They move where one lies farther from the one before than the motion between them, and its covariance, allow: but
    for so small a probability that all is well. What the camera alone has aligned meanwhile is forgotten.
    """
    first = waiting[0][0].number if waiting else 0
    if not first or not any(_is_astray(kept, probability) for kept in waiting) or not _is_one_way(waiting):
        return None
    T_before, T_new, T_last = store.pose(KeyframeId(first - 1)), list[FloatArray](), store.pose(KeyframeId(first - 1))
    laid: Kept = []
    for kept in waiting:
        assert kept[0].motion is not None
        T_here = se3.nearest(T_before @ kept[0].motion[0])
        T_new_old = T_here @ se3.invert(store.pose(kept[0].number))
        of_frame = []
        for lived in kept:
            T_new.append(se3.nearest(T_new_old @ store.pose(lived.number)))
            of_frame.append(replace(lived, T_before_now=se3.invert(T_last) @ T_new[-1], seen_from=None))
            T_last = T_new[-1]
        laid.append(of_frame)
        T_before = T_here
    return laid, np.array(T_new)


def _is_one_way(waiting: Sequence[Sequence[LivedKeyframe]]) -> bool:
    """Whether it is known how one went to the other: none begins a piece, and each motion is told."""
    return all(kept[0].motion is not None and not any(lived.begins for lived in kept) for kept in waiting)


def _is_astray(kept: Sequence[LivedKeyframe], probability: float) -> bool:
    one = kept[0]
    if one.motion is None or one.T_before_now is None:
        return False
    T, C = one.motion
    off = motions.log(motions.times(one.T_before_now, motions.inverse(T)))
    return bool(off @ np.linalg.solve(C, off) > quantile(probability, len(off)))
