"""ATE: how far the whole estimate lies from the truth, once laid upon it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wheelsight.errors import DegenerateGeometryError, EvaluationError
from wheelsight.evaluation._pairing import matched
from wheelsight.evaluation.statistics import Statistics
from wheelsight.geometry import FloatArray, align_points, align_points_with_scale, se3, so3
from wheelsight.trajectory import Trajectory

# How far the points stand from a pose that settle the roll about a straight path, as a share of its extent:
# long enough to be seen by the alignment, too short to pull positions off (their share of the cost is its square).
_ARM_SHARE = 1e-3
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class AbsoluteError:
    """The absolute trajectory error of M pairs of poses.

    Attributes:
        stamps_s: (M,) of the estimate, seconds.
        errors_m: (M,) distances between estimated and true position, after alignment.
        errors_rad: (M,) angles between estimated and true orientation, after alignment.
        T_truth_estimate: (4, 4) that lays the estimate's world upon the truth's (after scaling).
        scale: by which positions of the estimate were multiplied; 1 unless asked for.
        aligned: the whole estimate, scaled and moved into the truth's world.
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
    line or in one place, orientations settle the rotation that positions leave free; an estimate in a plane is never
    turned over to fit better as its mirror image.

    Raises:
        EvaluationError: different bodies, fewer than three pairs, or positions that determine no scale when asked.
    """
    near, true = matched(estimate, truth, max_gap_s)
    T_truth_estimate, scale = _alignment(near, true, with_scale)
    moved = _scaled(near, scale).moved(T_truth_estimate)
    R_error = np.swapaxes(true.T_world_body[:, :3, :3], 1, 2) @ moved.T_world_body[:, :3, :3]
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
    try:
        T, scale = align_points_with_scale(truth.positions_m, estimate.positions_m, with_scale=with_scale)
        is_mirrored = _keeps_to_a_plane(estimate) and (T[:3, :3] @ _up(estimate)) @ _up(truth) < 0
        return _aligned_upright(estimate, truth, with_scale) if is_mirrored else (T, scale)
    except DegenerateGeometryError as error:
        if with_scale:
            raise EvaluationError(f"no scale can be found: {error}") from error
    extent_m = np.linalg.norm(np.ptp(truth.positions_m, axis=0))
    arms = (_ARM_SHARE * extent_m if extent_m > 0 else 1.0) * np.vstack([np.eye(3), -np.eye(3)])
    p_truth, p_estimate = (se3.apply(t.T_world_body, arms).reshape(-1, 3) for t in (truth, estimate))
    return align_points(p_truth, p_estimate), 1.0


def _up(trajectory: Trajectory) -> FloatArray:
    """The mean direction (3,) of the body's z axis."""
    return np.asarray(trajectory.T_world_body[:, :3, 2].mean(axis=0))


def _keeps_to_a_plane(trajectory: Trajectory) -> bool:
    """Whether the body never leaves the plane that its z axis stands on, as dead reckoning of wheels does not."""
    tilt = np.ptp(trajectory.T_world_body[:, :3, 2], axis=0).max()
    heights_m = trajectory.positions_m @ _up(trajectory)
    return bool(tilt < _ROUNDING and np.ptp(heights_m) <= _ROUNDING * np.abs(trajectory.positions_m).max())


def _aligned_upright(estimate: Trajectory, truth: Trajectory, with_scale: bool) -> tuple[FloatArray, float]:
    """As `_alignment`, for an estimate in a plane that would fit best turned over.

    In space, a path in a plane can be laid on its mirror image, and a path that bends the wrong way fits better so.
    What stands high above and deep below each pose keeps it upright.
    """
    extent_m = np.linalg.norm(np.ptp(truth.positions_m, axis=0)) + np.linalg.norm(np.ptp(estimate.positions_m, axis=0))
    arms = np.array([[0, 0, extent_m], [0, 0, -extent_m]])
    p_truth, p_estimate = (se3.apply(t.T_world_body, arms).reshape(-1, 3) for t in (truth, estimate))
    R = align_points(p_truth, p_estimate)[:3, :3]
    means_m = truth.positions_m.mean(axis=0), estimate.positions_m.mean(axis=0)
    off_truth, off = truth.positions_m - means_m[0], (estimate.positions_m - means_m[1]) @ R.T
    scale = float((off_truth * off).sum() / (off**2).sum()) if with_scale else 1.0
    return se3.from_parts(R, means_m[0] - scale * R @ means_m[1]), scale


def _scaled(trajectory: Trajectory, scale: float) -> Trajectory:
    if scale == 1.0:
        return trajectory
    T = trajectory.T_world_body.copy()
    T[:, :3, 3] *= scale
    S = np.diag([scale] * 3 + [1.0] * 3)
    covariances = None if trajectory.covariances is None else S @ trajectory.covariances @ S
    return Trajectory(trajectory.stamps_s, T, covariances, trajectory.body, trajectory.world)
