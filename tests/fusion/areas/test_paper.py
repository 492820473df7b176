"""Eq. 5 of Trinh et al. by closed forms, its weights, and their search."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from fusion.areas.loops import answers, drive_round, error_m, looks, loop
from narrowing import not_none

from wheelsight.core.errors import AreaError, ConfigError
from wheelsight.core.geometry import se3
from wheelsight.estimation import AxisWeights, Weights
from wheelsight_papers import PaperRectifier, TrainingDrive, coordinates_of, fit_weights, rectify_drive

WEIGHTS = Weights(AxisWeights(0.5, 0.3, 0.2), AxisWeights(0.4, 0.6))
TERMS: list[Literal["absolute", "increment"]] = ["absolute", "increment"]
FORWARD = se3.from_plane(1.0, 0.0, 0.0)


@pytest.mark.parametrize("parts", [(0.5, 0.5, 0.1), (0.2, 0.2, 0.2), (1.2, -0.2, 0.0), (np.nan, 0.5, 0.5)])
def test_weights_are_shares_of_one(parts):
    with pytest.raises(ConfigError, match="weight"):
        AxisWeights(*parts)


def test_where_no_coordinate_is_reported_there_is_no_gamma():
    with pytest.raises(ConfigError, match=r"gamma is 0\.2"):
        Weights(AxisWeights(0.5, 0.5), AxisWeights(0.4, 0.4, 0.2))


def test_one_frame_is_eq_5_of_absolute_odometry():
    rectifier = PaperRectifier(loop(), se3.from_plane(3.0, 1.0, 0.0), WEIGHTS, "absolute")
    rectifier.update(0.0, None)
    rectifier.predict(FORWARD)
    first = not_none(rectifier.update(1.0, 1).T_odom_body)  # southeast: x is 13, y is 1
    assert first[0, 3] == pytest.approx(0.5 * 3 + 0.3 * 4 + 0.2 * 13)
    rectifier.predict(FORWARD)
    second = not_none(rectifier.update(2.0, None).T_odom_body)
    assert second[0, 3] == pytest.approx(0.4 * first[0, 3] + 0.6 * 5)


def test_one_frame_is_eq_5_of_the_last_place_and_the_way_since():
    rectifier = PaperRectifier(loop(), se3.from_plane(3.0, 1.0, 0.0), WEIGHTS, "increment")
    rectifier.update(0.0, None)
    rectifier.predict(FORWARD)
    first = not_none(rectifier.update(1.0, 1).T_odom_body)
    assert first[0, 3] == pytest.approx(0.5 * 3 + 0.3 * (3 + 1) + 0.2 * 13)
    rectifier.predict(FORWARD)
    second = not_none(rectifier.update(2.0, None).T_odom_body)
    assert second[0, 3] == pytest.approx(0.4 * first[0, 3] + 0.6 * (first[0, 3] + 1))


@pytest.mark.parametrize("term", TERMS)
def test_an_axis_of_which_the_area_shows_nothing_is_left_to_odometry(term):
    gammas = [Weights(AxisWeights(0.0, 1 - gamma, gamma), AxisWeights(0.0, 1.0)) for gamma in (0.0, 0.7)]
    found = []
    for weights in gammas:
        rectifier = PaperRectifier(loop(), se3.from_plane(3.0, 1.2, 0.3), weights, term)
        for stamp_s in range(4):
            rectifier.predict(FORWARD)
            estimate = rectifier.update(float(stamp_s), 0)  # south shows y only
        found.append(estimate.T_odom_body)
    assert not_none(found[0])[0, 3] == pytest.approx(not_none(found[1])[0, 3])
    assert not_none(found[0])[1, 3] != pytest.approx(not_none(found[1])[1, 3])
    np.testing.assert_array_equal(not_none(found[0])[:3, :3], not_none(found[1])[:3, :3])


def test_standing_in_an_area_the_distance_to_its_middle_shrinks_by_a_power():
    rectifier = PaperRectifier(loop(), se3.from_plane(0.0, 0.0, 0.0), WEIGHTS, "increment")
    rectifier.update(0.0, None)
    for stamp_s in range(1, 6):
        estimate = rectifier.update(float(stamp_s), 1)
    np.testing.assert_allclose(not_none(estimate.T_odom_body)[:2, 3] - (13, 1), np.array([-13, -1]) * 0.8**5)


def test_between_frames_the_wheels_go_on_from_the_rectified_place():
    rectifier = PaperRectifier(loop(), se3.from_plane(3.0, 1.0, 0.0), WEIGHTS, "absolute")
    rectifier.update(0.0, None)
    rectifier.predict(FORWARD)
    at_frame = not_none(rectifier.update(1.0, 1).T_odom_body)
    rectifier.predict(FORWARD)
    np.testing.assert_allclose(not_none(rectifier.estimate(1.1).T_odom_body), at_frame @ FORWARD)


def test_wheels_alone_are_kept_by_weights_of_odometry_alone(rng):
    drive = drive_round(rng, laps=1)
    reported = coordinates_of(loop())[looks(rng, loop(), drive.truth, 0.8, 1.0)]
    alone = Weights(AxisWeights(0, 1), AxisWeights(0, 1))
    for term in TERMS:
        np.testing.assert_allclose(rectify_drive(drive.wheels[:, :2], reported, alone, term), drive.wheels[:, :2])


@pytest.mark.parametrize("term", TERMS)
def test_a_whole_drive_is_what_its_frames_are(rng, term):
    drive = drive_round(rng, laps=1)
    named = looks(rng, loop(), drive.truth, 0.8, 1.0)
    named[::7] = -1
    rectifier = PaperRectifier(loop(), se3.from_plane(*drive.wheels[0]), WEIGHTS, term)
    found = []
    for t, index in enumerate(named):
        if t:
            rectifier.predict(drive.steps[t - 1])
        found.append(not_none(rectifier.update(float(t), None if index < 0 else int(index)).T_odom_body)[:2, 3])
    whole = rectify_drive(drive.wheels[:, :2], coordinates_of(loop())[named], WEIGHTS, term)
    np.testing.assert_allclose(found, whole, atol=1e-9)


def training_drive(rng, accuracy=0.9):
    drive = drive_round(rng)
    named = looks(rng, loop(), drive.truth, accuracy, 1.0)
    return TrainingDrive(drive.wheels[:, :2], named, drive.truth[:, :2])


@pytest.mark.parametrize("term", TERMS)
def test_weights_found_on_one_drive_help_on_another(rng, term):
    training, test = training_drive(rng), training_drive(rng)
    weights = fit_weights(loop(), [training], term)
    for drive in (training, test):
        xy = rectify_drive(drive.odometry, coordinates_of(loop())[drive.area_indices], weights, term)
        assert error_m(xy, drive.truth) < 0.75 * error_m(drive.odometry, drive.truth)


def test_no_single_weight_changed_is_better_than_the_weights_found(rng):
    drive = training_drive(rng)
    reported = coordinates_of(loop())[drive.area_indices]
    best = fit_weights(loop(), [drive])
    least = error_m(rectify_drive(drive.odometry, reported, best), drive.truth)
    for beta in np.linspace(0.05, 0.95, 7):
        other = Weights(best.with_area, AxisWeights(1 - beta, beta))
        assert error_m(rectify_drive(drive.odometry, reported, other), drive.truth) > 0.98 * least


def test_perfect_wheels_are_left_alone(rng):
    drive = training_drive(rng)
    perfect = TrainingDrive(drive.truth, drive.area_indices, drive.truth)
    weights = fit_weights(loop(), [perfect])
    assert weights.with_area.gamma == 0
    assert weights.without_area.beta == 1


def test_weights_need_a_drive_and_areas_that_are():
    with pytest.raises(ConfigError, match="no drive"):
        fit_weights(loop(), [])
    with pytest.raises(ConfigError, match="each of its frames"):
        TrainingDrive(np.zeros((3, 2)), np.zeros(2, int), np.zeros((3, 2)))
    with pytest.raises(ConfigError, match="absolute or increment"):
        PaperRectifier(loop(), np.eye(4), WEIGHTS, "relative")  # type: ignore[arg-type]
    with pytest.raises(AreaError, match="area index is 8"):
        PaperRectifier(loop(), np.eye(4), WEIGHTS).update(0.0, 8)


def test_made_up_answers_name_what_was_found():
    assert answers(np.array([3, 0]), 8).argmax(axis=1).tolist() == [3, 0]
