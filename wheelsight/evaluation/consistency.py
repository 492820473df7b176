"""Consistency: whether an estimate is as good as it says, judged by the truth and nothing fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wheelsight.core.errors import EvaluationError
from wheelsight.core.geometry import BoolArray, FloatArray, se3
from wheelsight.core.trajectory import Trajectory

# As probable in two dimensions as 3σ in one: χ² of two degrees of freedom at 0.9973.
THREE_SIGMA_RADIUS = math.sqrt(11.83)
_FEWEST_POSES = 3
_MOST_WEIGHT_S = 0.5  # of a pose: the time until the next one, at most this


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """An estimate's errors in its own x–y plane with its stated covariances, from a common start with the truth.

    Attributes:
        T_truth_estimate: (4, 4) that aligns the estimate's first pose with the true one.
        stamps_s: (M,) of the poses that have a truth, seconds.
        errors_m: (M, 2) estimated minus true position, along the body's x axis and to its left.
        covariances_m2: (M, 2, 2) of these, as stated.
        is_within: (M,) whether the true position is within the stated 3σ, of two dimensions: as probable as 3σ of one.
        weights_s: (M,) time until the next pose, half a second at most.
        way_m: length of the true way, metres.
    """

    T_truth_estimate: FloatArray
    stamps_s: FloatArray
    errors_m: FloatArray
    covariances_m2: FloatArray
    is_within: BoolArray
    weights_s: FloatArray
    way_m: float

    @property
    def share(self) -> float:
        """Share of the time, 0 to 1, in which the true position is within the stated 3σ."""
        return float(self.weights_s[self.is_within].sum() / self.weights_s.sum())

    @property
    def drift_m(self) -> float:
        """Error of the last pose."""
        return float(np.linalg.norm(self.errors_m[-1]))

    @property
    def drift_share(self) -> float:
        """Error of the last pose relative to the true way; NaN without motion."""
        return self.drift_m / self.way_m if self.way_m > 0 else math.nan


def consistency(
    estimate: Trajectory, truth: Trajectory, *, max_gap_s: float = 0.5, truth_sigma_m: float = 1e-3
) -> Consistency:
    """Compare the covariances of `estimate` with its errors by `truth`.

    The first pose with a true one aligns both, because covariances grow from there; the best fit of whole paths (ATE)
    would hide errors. An error of that true pose counts as the estimate's.

    Args:
        estimate: with covariances, in a frame whose z axis is up.
        truth: of the same body.
        max_gap_s: largest distance of neighbouring true poses for interpolation.
        truth_sigma_m: σ of the truth itself, added to the stated covariances.

    Raises:
        EvaluationError: different bodies, no covariances, or fewer than three poses with a truth.
    """
    if estimate.body != truth.body:
        raise EvaluationError(f"the estimate is of the {estimate.body}, the ground truth of the {truth.body}")
    if estimate.covariances is None:
        raise EvaluationError("the estimate states no covariances")
    T_truth_body = truth.at(estimate.stamps_s, max_gap_s)
    known = np.isfinite(T_truth_body[:, 0, 0])
    if np.count_nonzero(known) < _FEWEST_POSES:
        raise EvaluationError(f"{np.count_nonzero(known)} of the estimate's poses have a truth, {_FEWEST_POSES} needed")
    near = estimate.select(known)
    T_truth_estimate = start_alignment(near, truth, max_gap_s)
    true = Trajectory(near.stamps_s, T_truth_body[known], body=truth.body).moved(se3.invert(T_truth_estimate))
    R_body_frame = _turned_back(near)
    errors_m = np.einsum("nij,nj->ni", R_body_frame, (near.positions_m - true.positions_m)[:, :2])
    C = covariances_ahead_m2(near)
    stated = C + truth_sigma_m**2 * np.eye(2)
    squared = np.einsum("ni,ni->n", errors_m, np.linalg.solve(stated, errors_m[..., None])[..., 0])
    weights_s = np.append(np.diff(near.stamps_s), 0.0).clip(max=_MOST_WEIGHT_S)
    return Consistency(
        T_truth_estimate, near.stamps_s, errors_m, C, squared <= THREE_SIGMA_RADIUS**2, weights_s, true.length_m
    )


def start_alignment(estimate: Trajectory, truth: Trajectory, max_gap_s: float = 0.5) -> FloatArray:
    """Return T_truth_estimate (4, 4) that aligns the first pose with a true one; arguments as of `consistency`.

    Raises EvaluationError if no pose has a true one.
    """
    T_truth_body = truth.at(estimate.stamps_s, max_gap_s)
    known = np.flatnonzero(np.isfinite(T_truth_body[:, 0, 0]))
    if not len(known):
        raise EvaluationError("none of the estimate's poses has a truth")
    return np.asarray(T_truth_body[known[0]] @ se3.invert(estimate.T_frame_body[known[0]]))


def position_covariances_m2(trajectory: Trajectory) -> FloatArray:
    """Covariances (N, 3, 3) of the positions in the map, m², of a trajectory that has covariances."""
    assert trajectory.covariances is not None
    return se3.position_covariance(trajectory.T_frame_body, trajectory.covariances)


def covariances_ahead_m2(trajectory: Trajectory) -> FloatArray:
    """Covariances (N, 2, 2) of the positions in x and y along the body's x axis and to its left, m²."""
    R_body_frame = _turned_back(trajectory)
    C = position_covariances_m2(trajectory)[:, :2, :2]
    return np.asarray(R_body_frame @ C @ R_body_frame.transpose(0, 2, 1))


def _turned_back(trajectory: Trajectory) -> FloatArray:
    """Rotations (N, 2, 2) from the map's x and y to the body's x axis, seen from above, and its left."""
    x, y = trajectory.T_frame_body[:, 0, 0], trajectory.T_frame_body[:, 1, 0]
    yaw = np.arctan2(y, x)
    return np.stack([np.stack([np.cos(yaw), np.sin(yaw)], -1), np.stack([-np.sin(yaw), np.cos(yaw)], -1)], -2)
