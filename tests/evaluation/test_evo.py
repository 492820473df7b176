"""Agreement with evo, to 1e-9, on real pairs of trajectories.

evo associates by nearest neighbour and may use a true pose twice, so the figures are compared on the pairs that
wheelsight associates, and the two associations are compared on their own.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from grids import mostly_slow

from wheelsight.core.stamps import associate
from wheelsight.core.trajectory import Trajectory, read_kitti, read_tum
from wheelsight.evaluation import Statistics, ate, rpe

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # of what evo itself imports
    from evo.core import metrics, sync
    from evo.core.metrics import PoseRelation
    from evo.core.trajectory import PoseTrajectory3D
    from evo.core.units import Unit

pytestmark = pytest.mark.data

MAX_GAP_S = 0.02
PAIRS = {
    "fr2_desk": ("fr2_desk_ORB.txt", "fr2_desk_groundtruth.txt"),
    "fr1_xyz": ("freiburg1_xyz-rgbdslam_drift.txt", "freiburg1_xyz-groundtruth.txt"),
    "kitti_00": ("KITTI_00_ORB.txt", "KITTI_00_gt.txt"),
}
UNITS = {"frames": Unit.frames, "metres": Unit.meters}


@pytest.fixture(scope="module", params=mostly_slow(PAIRS, quick=["fr1_xyz", "kitti_00"]))
def pair(request: pytest.FixtureRequest, data_folder: Path) -> tuple[Trajectory, Trajectory]:
    estimate, truth = (data_folder / "trajectories" / name for name in PAIRS[request.param])
    if request.param.startswith("kitti"):
        return read_kitti(estimate), read_kitti(truth)
    return read_tum(estimate), read_tum(truth, warn=lambda _: None)


def in_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    return PoseTrajectory3D(timestamps=trajectory.stamps_s, poses_se3=list(trajectory.T_frame_body))


def associated(pair: tuple[Trajectory, Trajectory]) -> tuple[PoseTrajectory3D, PoseTrajectory3D]:
    estimate, truth = pair
    pairs = associate(estimate.stamps_s, truth.stamps_s, MAX_GAP_S)
    return in_evo(estimate.select(pairs[:, 0])), in_evo(truth.select(pairs[:, 1]))


def assert_agree(errors: np.ndarray, statistics: Statistics, metric: metrics.PE) -> None:
    np.testing.assert_allclose(errors, metric.error, rtol=0, atol=1e-9)
    theirs = metric.get_all_statistics()
    for name in ("rmse", "mean", "median", "max", "min", "std"):
        assert getattr(statistics, name) == pytest.approx(theirs[name], rel=0, abs=1e-9), name


@pytest.mark.parametrize("with_scale", [False, True])
def test_ate_agrees(pair: tuple[Trajectory, Trajectory], with_scale: bool) -> None:
    error = ate(*pair, max_gap_s=MAX_GAP_S, with_scale=with_scale)
    estimate, truth = associated(pair)
    _, _, scale = estimate.align(truth, correct_scale=with_scale)
    assert error.scale == pytest.approx(scale, abs=1e-12)
    for relation, errors, statistics in (
        (PoseRelation.translation_part, error.errors_m, error.translation),
        (PoseRelation.rotation_angle_rad, error.errors_rad, error.rotation),
    ):
        metric = metrics.APE(relation)
        metric.process_data((truth, estimate))
        assert_agree(errors, statistics, metric)


@pytest.mark.parametrize(("delta", "unit"), [(1, "frames"), (10, "frames"), (1, "metres"), (5, "metres")])
def test_rpe_agrees(pair: tuple[Trajectory, Trajectory], delta: int, unit: str) -> None:
    error = rpe(*pair, delta, unit, max_gap_s=MAX_GAP_S)  # type: ignore[arg-type]
    estimate, truth = associated(pair)
    for relation, errors, statistics in (
        (PoseRelation.translation_part, error.errors_m, error.translation),
        (PoseRelation.rotation_angle_rad, error.errors_rad, error.rotation),
    ):
        metric = metrics.RPE(relation, delta, UNITS[unit], all_pairs=True, pairs_from_reference=True)
        metric.process_data((truth, estimate))
        assert_agree(errors, statistics, metric)


def test_consecutive_frames_are_the_same_pairs_either_way(pair: tuple[Trajectory, Trajectory]) -> None:
    error = rpe(*pair, 1, "frames", max_gap_s=MAX_GAP_S)
    estimate, truth = associated(pair)
    metric = metrics.RPE(PoseRelation.translation_part, 1, Unit.frames, all_pairs=False)
    metric.process_data((truth, estimate))
    assert_agree(error.errors_m, error.translation, metric)


def test_association_differs_only_where_evo_uses_a_true_pose_twice(pair: tuple[Trajectory, Trajectory]) -> None:
    estimate, truth = pair
    pairs = associate(estimate.stamps_s, truth.stamps_s, MAX_GAP_S)
    theirs, their_truth = sync.associate_trajectories(in_evo(estimate), in_evo(truth), max_diff=MAX_GAP_S)
    twice = theirs.num_poses - len(np.unique(their_truth.timestamps))
    assert twice <= 2
    assert len(pairs) == theirs.num_poses - twice
    if not twice:
        np.testing.assert_array_equal(theirs.timestamps, estimate.stamps_s[pairs[:, 0]])
        np.testing.assert_array_equal(their_truth.timestamps, truth.stamps_s[pairs[:, 1]])
