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
from wheelsight.slam.drive_graph import CameraMotion, LivedKeyframe
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.steps import ANCHOR_SIGMA, along_floor

# By the frames at which they were kept.
Kept = list[list[LivedKeyframe]]


def laid_anew(store: KeyframeStore, waiting: Kept, probability: float) -> tuple[Kept, FloatArray] | None:
    """Those that wait, and all their poses (K, 4, 4) in the store; None where they may stay where they are.

    They move where one lies farther from the one before, along the floor, than the motion between them and its
    covariance allow: but for so small a probability that all is well. Height and tilt stay as the camera has them. What
    it alone has aligned meanwhile is forgotten.
    """
    first = waiting[0][0].number if waiting else 0
    if not first or not _is_one_way(waiting):
        return None
    T_old = T_before = T_last = store.pose(KeyframeId(first - 1))
    T_new: list[FloatArray] = []
    laid: Kept = []
    is_astray = False
    for kept in waiting:
        T_now = store.pose(kept[0].number)
        assert kept[0].motion is not None
        step = se3.invert(T_old) @ T_now
        is_astray |= _misfit(step, kept[0].motion, T_old[2, :3]) > quantile(probability, 3)
        T_here, T_old = se3.nearest(T_before @ _along_floor(step, kept[0].motion, T_old[2, :3])), T_now
        T_new_old = T_here @ se3.invert(T_now)
        of_frame = []
        for lived in kept:
            T_new.append(se3.nearest(T_new_old @ store.pose(lived.number)))
            of_frame.append(replace(lived, T_before_now=se3.invert(T_last) @ T_new[-1], seen_from=None))
            T_last = T_new[-1]
        laid.append(of_frame)
        T_before = T_here
    return (laid, np.array(T_new)) if is_astray else None


def _is_one_way(waiting: Sequence[Sequence[LivedKeyframe]]) -> bool:
    """Whether it is known how one went to the other: none begins a piece, and each motion is told."""
    return all(kept[0].motion is not None and not any(lived.begins for lived in kept) for kept in waiting)


def _misfit(step: FloatArray, motion: CameraMotion, up: FloatArray) -> float:
    """χ² of three degrees of freedom: how far a step (4, 4) is from a motion along a floor with a normal (3,)."""
    T, C = motion
    along = np.zeros((6, 3))
    along[:3, :2], along[3:, 2] = np.linalg.svd(up[None])[2][1:].T, up
    off = along.T @ motions.log(motions.times(step, motions.inverse(T)))
    return float(off @ np.linalg.solve(along.T @ C @ along + ANCHOR_SIGMA**2 * np.eye(3), off))


def _along_floor(step: FloatArray, motion: CameraMotion, up: FloatArray) -> FloatArray:
    """A step (4, 4) that goes along the floor as a motion says."""
    ends = KeyframeId(0), KeyframeId(1)
    return along_floor(RelativePose(*ends, step, np.eye(6)), motion, up).T_first_second
