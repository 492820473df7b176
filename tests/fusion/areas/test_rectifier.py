"""AreaRectifier: wheels as they are without a forest, better with a good one, hardly worse with any other."""

from __future__ import annotations

import numpy as np
import pytest
from fusion.areas.loops import PERIOD_S, PLANE, answers, drive_round, error_m, looks, loop, rectify
from narrowing import not_none
from pydantic import ValidationError

from wheelsight.core.areas import AreaMap
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import Status, WheelEstimate
from wheelsight.core.geometry import se2, se3
from wheelsight.core.messages import WheelTicks
from wheelsight.estimation import AreaRectifier, AreaRectifierSettings, area_rectifier
from wheelsight.wheels import WheelOdometry

START = se3.from_plane(3.0, 1.0, 0.0)


def forest_on(drive, rng, accuracy=0.85):
    return answers(looks(rng, loop(), drive.truth, accuracy, 1.0), 8)


@pytest.mark.parametrize("says", ["unknown", "nothing"])
def test_without_information_the_wheels_are_left_alone(rng, says):
    drive = drive_round(rng, laps=2)
    reported = None if says == "unknown" else np.full((len(drive.truth), 8), 1 / 8)
    found = rectify(drive, reported).poses
    np.testing.assert_allclose(found[:, :2], drive.wheels[:, :2], atol=1e-9)
    np.testing.assert_allclose(se2.wrap_angle(found[:, 2] - drive.wheels[:, 2]), 0, atol=1e-9)


@pytest.mark.parametrize("accuracy", [0.7, 0.85, 0.95])
def test_a_forest_leaves_little_of_the_wheels_error(rng, accuracy):
    drive = drive_round(rng)
    found = rectify(drive, forest_on(drive, rng, accuracy))
    assert drive.wheels_error_m > 5
    assert error_m(found.poses, drive.truth) < 0.12 * drive.wheels_error_m
    assert found.trust[-1] > 0.9


def test_heading_is_corrected_through_the_position(rng):
    drive = drive_round(rng)
    found = rectify(drive, forest_on(drive, rng))
    off = [np.abs(se2.wrap_angle(poses[:, 2] - drive.truth[:, 2])).mean() for poses in (found.poses, drive.wheels)]
    assert off[0] < 0.1 * off[1]


def test_covariance_is_honest():
    seen = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        drive = drive_round(rng, laps=2, drift=rng.normal(0, 0.015))
        found = rectify(drive, forest_on(drive, rng))
        error = found.poses - drive.truth
        error[:, 2] = se2.wrap_angle(error[:, 2])
        seen.append(np.einsum("ti,tij,tj->t", error, np.linalg.inv(found.covariances), error)[50:].mean())
    # Three degrees of freedom; frames of one drive are far from independent, so the bounds are wide.
    assert 1 < np.mean(seen) < 6


def without_sense(kind, reported, truth, rng):
    """Answers (N, A) of a forest that is wrong in one of several ways."""
    named = loop().index_at(truth[:, :2])
    if kind == "shuffled":
        return reported[rng.permutation(len(reported))]
    if kind == "opposite":
        return np.roll(reported, 4, axis=1)
    if kind == "always one":
        return answers(np.full(len(reported), 6), 8, 0.97)
    assert kind == "mixed up"
    return answers(np.array([3, 6, 0, 7, 2, 1, 4, 5])[named], 8)


@pytest.mark.parametrize("kind", ["shuffled", "opposite", "always one", "mixed up"])
@pytest.mark.parametrize("drift", [0.03, -0.02])
def test_a_forest_without_sense_does_not_ruin_the_wheels(rng, kind, drift):
    drive = drive_round(rng, drift=drift)
    found = rectify(drive, without_sense(kind, forest_on(drive, rng), drive.truth, rng))
    assert error_m(found.poses, drive.truth) < 1.05 * drive.wheels_error_m


@pytest.mark.parametrize("seed", range(1, 4))
def test_runs_of_answers_out_of_order_do_not_ruin_the_wheels(seed):
    rng = np.random.default_rng(seed)
    drive = drive_round(rng, drift=(0.03, -0.02)[seed % 2])
    reported = forest_on(drive, rng)
    runs = np.array_split(np.arange(len(reported)), len(reported) // 15)  # 2.4 m each, as long as a corner
    mixed = reported[np.concatenate([runs[i] for i in rng.permutation(len(runs))])]
    assert error_m(rectify(drive, mixed).poses, drive.truth) < 1.05 * drive.wheels_error_m


@pytest.mark.parametrize("run", [1, 10])
def test_a_forest_that_is_wrong_and_sure_of_it_in_three_frames_of_ten_still_helps(rng, run):
    drive = drive_round(rng)
    reported = answers(looks(rng, loop(), drive.truth, 0.95, 1.0), 8, 0.95)
    for start in range(0, len(reported), run):
        if rng.random() < 0.3:
            reported[start : start + run] = answers(np.array([rng.integers(8)]), 8, 0.99)
    assert error_m(rectify(drive, reported).poses, drive.truth) < 0.3 * drive.wheels_error_m


def test_the_wheels_go_on_from_the_rectified_place_once_the_forest_fails(rng):
    drive = drive_round(rng)
    reported = forest_on(drive, rng, 0.95)
    half = len(reported) // 2
    reported[half:] = reported[half + rng.permutation(len(reported) - half)]
    found = rectify(drive, reported)
    assert found.trust[half - 1] > 0.9
    assert error_m(found.poses, drive.truth) < 0.5 * drive.wheels_error_m


def test_the_same_input_gives_the_same_answer_to_the_last_bit(rng):
    drive = drive_round(rng, laps=1)
    reported = forest_on(drive, rng)
    one, other = (rectify(drive, reported) for _ in range(2))
    assert one.poses.tobytes() == other.poses.tobytes()
    assert one.covariances.tobytes() == other.covariances.tobytes()


def test_shares_of_training_are_taken_off_the_answers():
    shares = np.array([0.3, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    skewed, even = AreaRectifier(loop(), START, area_shares=shares), AreaRectifier(loop(), START)
    step, covariance = se3.from_plane(0.5, 0.0, 0.05), np.diag([1e-3, 1e-3, 0, 0, 0, 1e-3])
    for stamp_s in range(30):
        for rectifier in (skewed, even):
            rectifier.predict(step, covariance)
        seen = answers(np.array([stamp_s // 20]), 8)[0]
        one = skewed.update(float(stamp_s), shares * seen / (shares @ seen))
        other = even.update(float(stamp_s), seen)
    np.testing.assert_allclose(not_none(one.T_odom_body), not_none(other.T_odom_body), atol=1e-9)


def test_estimates_of_wheel_odometry_are_taken_as_they_come():
    odometry = WheelOdometry(Wheels(0.17, 0.17, 0.52, 3200))
    by_estimate, by_step = AreaRectifier(loop(), START), AreaRectifier(loop(), START)
    before = None
    for t in range(40):
        wheels = odometry.process(WheelTicks(0.1 * t, 60 * t, 70 * t))
        by_estimate.predict_to(wheels)
        if before is not None:
            Ad = se3.adjoint(se3.invert(not_none(before.T_odom_body)))
            Q = Ad @ (not_none(wheels.covariance) - not_none(before.covariance)) @ Ad.T
            by_step.predict(se3.invert(not_none(before.T_odom_body)) @ not_none(wheels.T_odom_body), Q)
        before = wheels
    one, other = (rectifier.update(4.0, None) for rectifier in (by_estimate, by_step))
    np.testing.assert_allclose(not_none(one.T_odom_body), START @ not_none(wheels.T_odom_body), atol=1e-9)
    np.testing.assert_allclose(not_none(one.covariance), not_none(other.covariance), atol=1e-12)
    assert (one.status, one.body, one.stamp_s) == (Status.TRACKING, "base", 4.0)


def test_covariance_of_the_wheels_is_that_of_drives_with_such_wheels(rng, monkeypatch):
    monkeypatch.setattr(area_rectifier, "_WHEEL_WALKS", (0.0, 0.0, 0.0))
    rectifier = AreaRectifier(loop(), START)
    step = se3.from_plane(0.1, 0.0, 0.02)
    Q = np.zeros((6, 6))
    Q[PLANE] = np.diag([1e-5, 1e-6, 1e-5])
    for _ in range(40):
        rectifier.predict(step, Q)
    estimate = rectifier.update(0.0, None)
    n = 5_000
    starts = rng.normal(size=(n, 3)) * (0.05, 0.05, 0.01)
    scale, drift, turn = rng.normal(size=(3, n)) * np.array([[0.01], [0.015], [0.03]])
    T = se2.from_parts(3 + starts[:, 0], 1 + starts[:, 1], starts[:, 2])
    for _ in range(40):
        extra = drift * 0.1 + turn * 0.02
        c, s = np.cos(extra / 2), np.sin(extra / 2)
        true_step = se2.from_parts((1 + scale) * 0.1 * c, (1 + scale) * 0.1 * s, 0.02 + extra)
        T = T @ se2.exp(rng.normal(size=(n, 3)) * np.sqrt([1e-5, 1e-6, 1e-5])) @ true_step
    delta = se2.log(T @ se2.invert(se2.from_parts(*_plane(estimate.T_odom_body))))
    sigmas = np.sqrt(np.diag(not_none(estimate.covariance)[PLANE]))
    np.testing.assert_allclose(
        np.cov(delta.T) / np.outer(sigmas, sigmas),
        not_none(estimate.covariance)[PLANE] / np.outer(sigmas, sigmas),
        atol=0.06,
    )


def _plane(T):
    return T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])


BAD_FRAMES = (np.full(7, 1 / 7), np.zeros(8), np.full(8, np.nan), np.array([-0.1, *[1.1 / 7] * 7]))


@pytest.mark.parametrize("probabilities", BAD_FRAMES, ids=["seven", "zero", "nan", "negative"])
def test_answers_that_are_none_are_refused(probabilities):
    rectifier = AreaRectifier(loop(), START)
    with pytest.raises(ConfigError, match="probabilities"):
        rectifier.update(0.0, probabilities)
    np.testing.assert_allclose(not_none(rectifier.update(0.0, None).T_odom_body), START)


def test_what_cannot_be_rectified_is_refused():
    with pytest.raises(ConfigError, match="no area"):
        AreaRectifier(AreaMap(), START)
    with pytest.raises(ConfigError, match="start pose"):
        AreaRectifier(loop(), np.full((4, 4), np.nan))
    with pytest.raises(ConfigError, match="area_shares"):
        AreaRectifier(loop(), START, area_shares=np.zeros(8))
    with pytest.raises(ConfigError, match="not finite"):
        AreaRectifier(loop(), START).predict(np.full((4, 4), np.nan), np.eye(6))
    with pytest.raises(ConfigError, match="no pose"):
        AreaRectifier(loop(), START).predict_to(WheelEstimate(0.0, Status.FAILING))
    with pytest.raises(ValidationError, match="yaw_sigma_rad"):
        AreaRectifierSettings(yaw_sigma_rad=np.nan)


def test_stamps_and_probabilities_are_answered(rng):
    drive = drive_round(rng, laps=1)
    rectifier = AreaRectifier(loop(), se3.from_plane(*drive.truth[0]))
    estimate = rectifier.update(7 * PERIOD_S, answers(np.array([0]), 8)[0])
    assert estimate.stamp_s == 7 * PERIOD_S
    assert not_none(estimate.area_probabilities).shape == (8,)
    assert not_none(estimate.area_probabilities).argmax() == 0
    assert 0 < estimate.trust < 1
    assert 0 < estimate.support <= 1
