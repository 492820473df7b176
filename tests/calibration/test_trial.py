from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drives import simulate, write_recording

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import Recording, open_recording
from wheelsight_calibration.wheels import try_calibration

NOMINAL = Wheels(left_radius_m=0.17, right_radius_m=0.17, track_width_m=0.58, ticks_per_turn=3200)
TRUE = replace(NOMINAL, left_radius_m=0.171, right_radius_m=0.1695, track_width_m=0.615, slip_m_per_sqrt_m=0.002)


@pytest.fixture
def recording(tmp_path: Path, rng: np.random.Generator) -> Recording:
    write_recording(tmp_path / "drive", NOMINAL, simulate(TRUE, rng=rng, reference_sigma_m=0.002))
    return open_recording(tmp_path / "drive")


def test_the_rest_shows_what_it_is_worth(recording: Recording) -> None:
    reported: list[str] = []
    trial = try_calibration(recording, on_step=reported.append)
    assert reported == ["reading", "searching the delay", "fitting", "trying on the rest"]
    assert trial.fit.segments.end_s.max() <= trial.split_s <= trial.held_out.stamps_s[0]
    assert trial.after.evaluation.ate.translation.rmse < 0.1 * trial.before.evaluation.ate.translation.rmse
    assert trial.after.end_error_m < 0.2 * trial.before.end_error_m
    np.testing.assert_allclose(trial.after.path.T_frame_body[0], trial.held_out.T_frame_body[0], atol=1e-12)


def test_the_share_decides_what_is_left(recording: Recording) -> None:
    small, large = (try_calibration(recording, train_share=share) for share in (0.4, 0.8))
    assert len(small.fit.segments) < len(large.fit.segments)
    assert small.held_out.duration_s == pytest.approx(3 * large.held_out.duration_s, rel=0.05)


def test_a_marker_that_sits_off_and_looks_aside_is_no_matter(recording: Recording) -> None:
    truth = recording.ground_truth
    assert truth is not None
    marker = Trajectory(truth.stamps_s, truth.T_frame_body @ se3.from_plane(0.22, -0.1, 0.08), body="base")
    trial = try_calibration(recording, marker)
    np.testing.assert_allclose(trial.fit.mount, [0.22, -0.1, 0.08], atol=4e-3)
    for name in ("left_radius_m", "right_radius_m", "track_width_m"):
        assert getattr(trial.fit.wheels, name) == pytest.approx(getattr(TRUE, name), rel=3e-3)
    assert trial.after.evaluation.rpe_per_metre is not None
    assert trial.after.evaluation.rpe_per_metre.translation.rmse < 0.01


def test_a_camera_whose_place_is_unknown_is_refused(recording: Recording) -> None:
    truth = recording.ground_truth
    assert truth is not None
    camera = Trajectory(truth.stamps_s, truth.T_frame_body, body="camera")
    with pytest.raises(CalibrationError, match="give T_base_camera"):
        try_calibration(recording, camera)


@pytest.mark.parametrize("share", [0.0, 1.0, float("nan")])
def test_a_share_that_leaves_nothing_is_refused(recording: Recording, share: float) -> None:
    with pytest.raises(CalibrationError, match="not between 0 and 1"):
        try_calibration(recording, train_share=share)


def test_a_rest_too_short_to_compare_is_refused(recording: Recording) -> None:
    with pytest.raises(CalibrationError, match="too little is left to try the wheels on"):
        try_calibration(recording, train_share=0.99999)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "track_m", "ate_gain", "heading_gain"),
    [("skid_steer_run20", (0.68, 0.74), 1.5, 1.3), ("mocap_floor", (0.51, 0.53), 3.0, 2.0)],
)
def test_real_drives_are_nearer_to_their_reference_where_they_were_not_fitted(
    data_folder: Path, name: str, track_m: tuple[float, float], ate_gain: float, heading_gain: float
) -> None:
    trial = try_calibration(open_recording(data_folder / "wheels" / name))
    before, after = trial.before.evaluation, trial.after.evaluation
    assert track_m[0] < trial.fit.wheels.track_width_m < track_m[1]
    assert ate_gain * after.ate.translation.rmse < before.ate.translation.rmse
    assert before.rpe_per_metre is not None
    assert after.rpe_per_metre is not None
    assert heading_gain * after.rpe_per_metre.rotation.rmse < before.rpe_per_metre.rotation.rmse
