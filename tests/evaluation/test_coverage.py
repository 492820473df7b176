from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.errors import EvaluationError
from wheelsight.core.stamps import associate
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import frame_coverage, pairing_warning, time_coverage


def standing(*stamps_s: float) -> Trajectory:
    return Trajectory(np.array(stamps_s, float), np.tile(np.eye(4), (len(stamps_s), 1, 1)))


def test_frames_count_where_their_stamp_has_a_pose() -> None:
    frames_s = np.arange(10) / 30
    assert frame_coverage(standing(*frames_s[[0, 1, 2, 7]].round(4)), frames_s) == 0.4
    assert frame_coverage(standing(*(frames_s + 0.005)), frames_s) == 0
    assert frame_coverage(standing(), frames_s) == 0
    with pytest.raises(EvaluationError, match="no frames"):
        frame_coverage(standing(0.0), [])


def test_time_counts_without_the_gaps_of_either() -> None:
    truth = standing(*np.arange(0, 4.05, 0.1), *np.arange(6, 10.05, 0.1))
    assert time_coverage(truth, truth) == pytest.approx(1.0)
    assert time_coverage(standing(*np.arange(-3, 13.05, 0.1)), truth) == pytest.approx(1.0)
    assert time_coverage(standing(*np.arange(2, 8.05, 0.1)), truth) == pytest.approx(0.5)
    assert time_coverage(standing(*np.arange(0, 2.05, 0.1), *np.arange(9, 10.05, 0.1)), truth) == pytest.approx(3 / 8)
    for nothing in (standing(), standing(3.0), standing(20.0, 20.1), standing(0.0, 9.0)):
        assert time_coverage(nothing, truth) == 0


def test_sparse_truth_covers_its_usual_steps() -> None:
    truth = standing(0, 1, 2, 3, 10, 11, 12)
    assert time_coverage(truth, truth) == pytest.approx(1.0)
    assert time_coverage(standing(*np.arange(0, 2.05, 0.1)), truth) == pytest.approx(2 / 5)


def test_truth_that_covers_nothing_is_refused() -> None:
    for truth in (standing(), standing(3.0)):
        with pytest.raises(EvaluationError, match="covers no time"):
            time_coverage(standing(0.0, 0.1), truth)


def test_few_pairs_are_reported_with_the_setting_that_pairs_the_rest() -> None:
    estimate, truth = standing(*np.arange(0, 60, 0.1)), standing(*np.arange(10.04, 50, 0.2))
    warning = pairing_warning(estimate, truth, 3, 0.02)
    assert warning is not None
    assert warning.startswith("Only 3 of 200 poses have one of the ground truth within 0.02 s")
    assert "evaluation.max_gap_s to 0.06" in warning
    assert len(associate(estimate.stamps_s, truth.stamps_s, 0.06)) == 200
    assert pairing_warning(estimate, truth, 100, 0.02) is None
    assert pairing_warning(standing(), truth, 0, 0.02) is None
