"""Two beliefs, of which one is right, as one: what lies between both, or the one that covers the other."""

from __future__ import annotations

import numpy as np

from wheelsight.fusion.error_state._changed import changed
from wheelsight.fusion.error_state._pose_belief import LAG, PoseBelief
from wheelsight.fusion.error_state.estimate import STEP_BEGIN
from wheelsight.geometry import FloatArray, IntArray
from wheelsight.geometry import motion_kernels as motions


def mixed(one: PoseBelief, other: PoseBelief, share: float) -> PoseBelief:
    """One belief with the moments of both, where `other` is right with probability `share`: it covers both."""
    way = [motions.log(motions.times(T, motions.inverse(S))) for T, S in zip(other.T, one.T, strict=True)]
    between = one.moved(share * np.concatenate([*way, other.rest - one.rest]), one.covariance)
    P = np.zeros_like(one.covariance)
    for belief, weight in ((one, 1 - share), (other, share)):
        apart = _shift(between, belief)
        P += weight * (belief.covariance + np.outer(apart, apart))
    return changed(between, covariance=P).vision_accepted()


def covering(one: PoseBelief, other: PoseBelief, since_s: float, sigmas: float) -> PoseBelief:
    """The one, so much less certain that `other` lies at so many standard deviations.

    They have gone apart since a stamp; of poses remembered later, all err as the one now does.
    """
    apart = _shift(one, other)
    apart[one.rest_at :] = 0.0  # twist and wheels are soon known again; they must not pull the pose along then
    later = [0, *(place + 1 for place, pose in enumerate(one.remembered) if pose.stamp_s > since_s)]
    apart[: one.rest_at].reshape(-1, 6)[later] = apart[:6]
    P = one.covariance + np.outer(apart, apart) / sigmas**2
    P[: one.rest_at, : one.rest_at] += _less_known(one, other)
    return changed(one, covariance=P)


def _less_known(one: PoseBelief, other: PoseBelief) -> FloatArray:
    """Covariance (6 + 6K, 6 + 6K) that the one's poses lack to be as uncertain as those of `other`.

    What both were uncertain of before they went apart counts once; where one is in the map is of no account, so they
    are compared from where the base is. The begin of a step lacks what the base does: the step is as certain as it was.
    """
    kept = [0, *(place for place, name in enumerate(one.names, 1) if name != STEP_BEGIN)]
    at, same = _rows(kept), np.eye(len(kept))
    to_base, to_world = np.kron(same, motions.inverse_adjoint(one.T[0])), np.kron(same, motions.adjoint(one.T[0]))
    lacks = to_base @ (_of_poses_alone(other) - _of_poses_alone(one))[np.ix_(at, at)] @ to_base.T
    strength, axes = np.linalg.eigh((lacks + lacks.T) / 2)
    axes = to_world @ axes
    of = _rows([kept.index(place) if place in kept else 0 for place in range(len(one.T))])
    return np.asarray((axes * np.maximum(strength, 0.0)) @ axes.T)[np.ix_(of, of)]


def _rows(places: list[int]) -> IntArray:
    """Where poses stand in a covariance."""
    return np.asarray((6 * np.array(places)[:, None] + np.arange(6)).ravel())


def _of_poses_alone(belief: PoseBelief) -> FloatArray:
    """Covariance (6 + 6K, 6 + 6K) of the poses if twist and lag were known, by which the camera has them apart."""
    poses, given = slice(belief.rest_at), belief.rest_at + np.array([0, 1, 2, LAG])
    C, V = belief.covariance[poses, given], belief.covariance[np.ix_(given, given)]
    return np.asarray(belief.covariance[poses, poses] - C @ np.linalg.pinv(V, hermitian=True) @ C.T)


def _shift(one: PoseBelief, other: PoseBelief) -> FloatArray:
    """The perturbation (n,) that, to first order, puts every pose where `other` has it, however they are turned."""
    shifts = np.zeros((len(one.T), 6))
    for shift, T, S in zip(shifts, other.T, one.T, strict=True):
        shift[:] = _shift_of(S, T)
    return np.concatenate([shifts.ravel(), other.rest - one.rest])


def covering_pose(
    T_one: FloatArray, one: FloatArray, T_other: FloatArray, other: FloatArray, sigmas: float
) -> tuple[FloatArray, FloatArray]:
    """The one pose (4, 4), and a covariance (6, 6) by which the other's lies at so many standard deviations."""
    apart = _shift_of(T_one, T_other)
    return T_one, one + other + np.outer(apart, apart) / sigmas**2


def _shift_of(T_from: FloatArray, T_to: FloatArray) -> FloatArray:
    """The perturbation (6,) that, to first order, puts one pose (4, 4) where the other is."""
    turn = motions.log(motions.times(T_to, motions.inverse(T_from)))[3:]
    return np.concatenate([T_to[:3, 3] - T_from[:3, 3] - np.cross(turn, T_from[:3, 3]), turn])
