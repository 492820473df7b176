from __future__ import annotations

import json

import numpy as np
import pytest

from wheelsight.core.errors import EvaluationError
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import ate, evaluate, rpe


def path(n: int = 90, start_s: float = 100.0, body: str = "camera") -> Trajectory:
    s = np.arange(n) / 30
    xi = np.stack([0.6 * s, np.sin(s), 0.2 * np.cos(2 * s), 0.1 * np.sin(s), 0.2 * s, 0.3 * np.cos(s)], axis=1)
    return Trajectory(start_s + s, se3.exp(xi), body=body)


def drifting(truth: Trajectory) -> Trajectory:
    wander = np.cumsum(np.random.default_rng(3).normal(0, 0.002, (len(truth), 6)), axis=0)
    return Trajectory(truth.stamps_s, truth.T_frame_body @ se3.exp(wander), body=truth.body)


def test_joins_what_each_measure_says_alone() -> None:
    truth = path()
    estimate = drifting(truth).select(np.arange(90) % 10 != 0)
    found = evaluate(estimate, truth, frame_stamps_s=truth.stamps_s)
    assert found.pairs == 81
    assert found.frames_with_pose == 0.9
    assert found.truth_time_covered == pytest.approx(88 / 89)
    assert found.scale is None
    assert found.ate.translation == ate(estimate, truth).translation
    for error, unit in (
        (found.rpe_per_frame, "frames"),
        (found.rpe_per_second, "seconds"),
        (found.rpe_per_metre, "metres"),
    ):
        assert error is not None
        alone = rpe(estimate, truth, 1, unit)  # type: ignore[arg-type]
        np.testing.assert_allclose(error.errors_m, alone.errors_m, atol=1e-12)
        np.testing.assert_allclose(error.errors_rad, alone.errors_rad, atol=1e-9)


def test_with_scale_the_relative_errors_are_of_the_scaled_estimate() -> None:
    truth = path()
    T = truth.T_frame_body.copy()
    T[:, :3, 3] *= 2
    double = Trajectory(truth.stamps_s, T)
    found = evaluate(double, truth, with_scale=True)
    assert found.scale == pytest.approx(0.5)
    assert found.rpe_per_second is not None
    assert found.rpe_per_second.translation.max < 1e-9
    rigid = evaluate(double, truth)
    assert rigid.scale is None
    assert rigid.rpe_per_second is not None
    assert rigid.rpe_per_second.translation.max > 0.1


def test_short_trajectories_leave_long_steps_out() -> None:
    truth = path(n=5)
    found = evaluate(drifting(truth), truth)
    assert found.rpe_per_frame is not None
    assert (found.rpe_per_second, found.rpe_per_metre, found.frames_with_pose) == (None, None, None)
    assert found.to_dict()["rpe_per_second_m"] is None


def test_goes_into_json_with_units() -> None:
    truth = path()
    found = evaluate(drifting(truth), truth, frame_stamps_s=truth.stamps_s)
    figures = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert figures["ate_m"]["rmse"] == found.ate.translation.rmse
    assert figures["ate_deg"]["rmse"] == pytest.approx(np.degrees(found.ate.rotation.rmse))
    assert found.rpe_per_second is not None
    assert figures["rpe_per_second_deg"]["max"] == pytest.approx(np.degrees(found.rpe_per_second.rotation.max))
    assert np.shape(figures["T_truth_estimate"]) == (4, 4)
    assert (figures["pairs"], figures["scale"], figures["frames_with_pose"]) == (90, None, 1.0)


@pytest.mark.parametrize(
    ("estimate", "says"),
    [
        (path(start_s=500), "spans 500.000 to 502.967 s, the ground truth 100.000 to 102.967 s; they do not overlap"),
        (path(2), "^2 of the estimate's poses within 0.02 s of a true one, 3 needed"),
        (path(30, start_s=102.94), "^2 of .* they share 0.027 s"),
        (Trajectory(np.empty(0), np.empty((0, 4, 4))), r"the estimate spans nothing \(no poses\)"),
        (path(body="base"), "T_map_base but the ground truth T_map_camera.*T_base_camera"),
    ],
)
def test_says_why_trajectories_cannot_be_compared(estimate: Trajectory, says: str) -> None:
    with pytest.raises(EvaluationError, match=says) as caught:
        evaluate(estimate, path())
    assert "\n" not in str(caught.value)
