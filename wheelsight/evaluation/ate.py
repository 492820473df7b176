"""ATE: how far the whole estimate lies from the truth, once laid upon it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wheelsight.core.errors import DegenerateGeometryError, EvaluationError
from wheelsight.core.geometry import FloatArray, align_points, align_points_with_scale, se3, so3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation.statistics import Statistics, matched

# How far the points stand from a pose that settle the roll about a straight path, as a share of its extent:
# long enough to be seen by the alignment, too short to pull positions off (their share of the cost is its square).
_ARM_SHARE = 1e-3


@dataclass(frozen=True, eq=False)
class AbsoluteError:
    """The absolute trajectory error of M pairs of poses.

    Attributes:
        stamps_s: (M,) of the estimate, seconds.
        errors_m: (M,) distances between estimated and true position, after alignment.
        errors_rad: (M,) angles between estimated and true orientation, after alignment.
        T_truth_estimate: (4, 4) that lays the estimate's frame upon the truth's (after scaling).
        scale: by which positions of the estimate were multiplied; 1 unless asked for.
        aligned: the whole estimate, scaled and moved into the truth's frame.
        truth: the true poses of the pairs.
        translation: statistics of `errors_m`.
        rotation: statistics of `errors_rad`.
    """

    stamps_s: FloatArray
    errors_m: FloatArray
    errors_rad: FloatArray
    T_truth_estimate: FloatArray
    scale: float
    aligned: Trajectory
    truth: Trajectory
    translation: Statistics = field(init=False)
    rotation: Statistics = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "translation", Statistics.of(self.errors_m))
        object.__setattr__(self, "rotation", Statistics.of(self.errors_rad))


def ate(estimate: Trajectory, truth: Trajectory, *, max_gap_s: float = 0.02, with_scale: bool = False) -> AbsoluteError:
    """The absolute trajectory error (Sturm et al., IROS 2012, section V-B; alignment in closed form, Umeyama 1991).

    Poses are paired one to one within `max_gap_s` seconds, the estimate's positions are laid on the true ones by a
    rigid motion (with `with_scale`, also a scale), and the distances left are the error. Where positions lie on one
    line or in one place, orientations settle the rotation that positions leave free; a path near one plane is never
    turned over to fit better as its mirror image: orientations tell which side is up.

    Raises:
        EvaluationError: different bodies, fewer than three pairs, positions that determine no scale when asked, or none
            that compare with the truth's in size.
    """
    near, true = matched(estimate, truth, max_gap_s)
    T_truth_estimate, scale = _alignment(near, true, with_scale)
    moved = _scaled(near, scale).moved(T_truth_estimate)
    R_error = np.swapaxes(true.T_frame_body[:, :3, :3], 1, 2) @ moved.T_frame_body[:, :3, :3]
    return AbsoluteError(
        stamps_s=near.stamps_s,
        errors_m=np.linalg.norm(moved.positions_m - true.positions_m, axis=1),
        errors_rad=so3.angle(R_error),
        T_truth_estimate=T_truth_estimate,
        scale=scale,
        aligned=_scaled(estimate, scale).moved(T_truth_estimate),
        truth=true,
    )


def _alignment(estimate: Trajectory, truth: Trajectory, with_scale: bool) -> tuple[FloatArray, float]:
    """T_truth_estimate (4, 4) and scale that lay M estimated positions on M true ones."""
    R_truth, R_estimate = (t.T_frame_body[:, :3, :3] for t in (truth, estimate))
    like = np.mean(R_truth @ np.swapaxes(R_estimate, 1, 2), axis=0)
    try:
        given = (truth.positions_m, estimate.positions_m)
        return align_points_with_scale(*given, with_scale=with_scale, like=like)
    except DegenerateGeometryError as error:
        if with_scale:
            raise EvaluationError(f"no scale can be found: {error}") from error
    extent_m = np.linalg.norm(np.ptp(truth.positions_m, axis=0))
    arms = (_ARM_SHARE * extent_m if extent_m > 0 else 1.0) * np.vstack([np.eye(3), -np.eye(3)])
    p_truth, p_estimate = (se3.apply(t.T_frame_body, arms).reshape(-1, 3) for t in (truth, estimate))
    try:
        return align_points(p_truth, p_estimate), 1.0
    except DegenerateGeometryError as error:
        reach_m = np.linalg.norm(np.ptp(estimate.positions_m, axis=0))
        raise EvaluationError(
            f"the estimate cannot be laid upon the truth: its {len(estimate)} poses reach over {reach_m:.3g} m, the "
            f"true ones of the same time over {extent_m:.3g} m"
        ) from error


def _scaled(trajectory: Trajectory, scale: float) -> Trajectory:
    if scale == 1.0:
        return trajectory
    T = trajectory.T_frame_body.copy()
    T[:, :3, 3] *= scale
    S = np.diag([scale] * 3 + [1.0] * 3)
    covariances = None if trajectory.covariances is None else S @ trajectory.covariances @ S
    return Trajectory(trajectory.stamps_s, T, covariances, trajectory.body, trajectory.frame)
