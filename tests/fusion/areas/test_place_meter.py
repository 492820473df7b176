"""PlaceMeter: areas as positions, equal to the product that they stand for; and wheels that they lead by the filter."""

from __future__ import annotations

import numpy as np
import pytest
from fusion.areas.loops import PERIOD_S, answers, drive_round, error_m, looks, loop, rectify
from narrowing import not_none

from wheelsight.core.areas import AreaMap
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import Reason
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.estimation import ErrorStateFilter, PlaceMeter, area_rectifier
from wheelsight.estimation.area_rectifier import AreaFilterParameters, FloorShares, equivalent

SOUTH, WEST = 0, 6


def updated(mean, covariance, reported):
    """A Gaussian (2,), (2, 2) after a Kalman filter has taken what was reported."""
    value, spread = reported
    gain = covariance @ np.linalg.inv(covariance + spread)
    return mean + gain @ (value - mean), covariance - gain @ covariance


def in_map(xy, sigma_m, yaw=0.0) -> tuple[FloatArray, FloatArray]:
    """T_odom_base there, and the covariance of its left perturbation with `sigma_m` in x and y and a sure heading."""
    T = se3.from_plane(xy[0], xy[1], yaw)
    Ad = se3.adjoint(T)
    return T, Ad @ np.diag([sigma_m**2, sigma_m**2, 0, 0, 0, 0]) @ Ad.T


def saying(area, confidence=0.9):
    return answers(np.array([area]), 8, confidence)[0]


def test_of_a_gaussian_likelihood_the_measurement_is_found_again(rng):
    for _ in range(20):
        root = rng.standard_normal((2, 2))
        value, spread = rng.standard_normal(2), root @ root.T + 0.05 * np.eye(2)
        found = not_none(equivalent(*updated(np.zeros(2), np.eye(2), (value, spread))))
        np.testing.assert_allclose(found[0], value, atol=1e-9)
        np.testing.assert_allclose(found[1], spread, atol=1e-9)


def test_a_filter_that_takes_it_has_the_moments(rng):
    for _ in range(20):
        turn = np.linalg.qr(rng.standard_normal((2, 2)))[0]
        mean, covariance = rng.standard_normal(2), turn @ np.diag(rng.uniform(0.05, 0.95, 2)) @ turn.T
        after = updated(np.zeros(2), np.eye(2), equivalent(mean, covariance))
        np.testing.assert_allclose(after[0], mean, atol=1e-9)
        np.testing.assert_allclose(after[1], covariance, atol=1e-9)


def test_a_direction_that_gets_no_narrower_is_left_open():
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    mean, covariance = turn @ [0.5, 0.7], turn @ np.diag([0.4, 1.3]) @ turn.T
    after = updated(np.zeros(2), np.eye(2), equivalent(mean, covariance))
    np.testing.assert_allclose(turn.T @ after[0], [0.5, 0.0], atol=1e-9)
    np.testing.assert_allclose(turn.T @ after[1] @ turn, np.diag([0.4, 1.0]), atol=2e-6)


@pytest.mark.parametrize("covariance", [np.eye(2), np.diag([1.2, 1.0]), 3 * np.eye(2)])
def test_nothing_is_reported_where_nothing_gets_narrower(covariance):
    assert equivalent(np.array([0.1, -0.2]), covariance) is None


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_the_first_frame_takes_the_belief_to_its_product_with_the_likelihood(yaw):
    """By sums over a fine grid: of the Gaussian times the likelihood of "south" at each of its points."""
    xy, sigma = np.array([2.3, 1.4]), 0.8
    reported = PlaceMeter(loop()).measure(*in_map(xy, sigma, yaw), saying(SOUTH))
    mean, covariance = updated(xy, sigma**2 * np.eye(2), reported)

    forest = AreaFilterParameters()
    steps = np.arange(-4 * sigma, 4 * sigma, 0.04)
    points = xy + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    tiny = 1e-9 * np.eye(2)
    floor = FloorShares(loop(), 0.4)
    shares = np.array([floor.parts_of(point, tiny)[0][:, 0] for point in points])
    weights = np.exp(-((points - xy) ** 2).sum(axis=1) / (2 * sigma**2))
    weights /= weights.sum()
    evidence = 8 * saying(SOUTH)
    evidence = (1 - forest.blip) * evidence + forest.blip
    wrong = np.where(np.arange(8) == SOUTH, 0.0, 1 / 7)
    of_area = np.ones(9)  # outside the areas any answer is as likely
    for area in range(8):
        near = loop().adjacency()[area] & (np.arange(8) != area)
        wrong = forest.neighbour_share * near / near.sum()
        wrong = wrong + (1 - forest.neighbour_share) * (np.arange(8) != area) / 7
        looks_like = [a * (np.arange(8) == area) + (1 - a) * wrong for a in forest.accuracies]
        of_area[area] = np.mean(looks_like, axis=0) @ evidence
    good, alone = float(weights @ shares @ of_area), float(evidence.mean())
    worth = forest.worth * good / (forest.worth * good + (1 - forest.worth) * alone)
    weights = weights * (1 + worth * (shares @ of_area / good - 1))
    wanted = weights @ points
    np.testing.assert_allclose(mean, wanted, atol=0.02)
    np.testing.assert_allclose(covariance, (points - wanted).T * weights @ (points - wanted), atol=0.02)


def test_what_says_nothing_or_nothing_that_fits_is_no_measurement(monkeypatch):
    meter = PlaceMeter(loop())
    here = in_map((7.0, 1.0), 0.1)
    assert meter.measure(*here, None) is None
    assert meter.measure(*here, np.full(8, 1 / 8)) is None
    monkeypatch.setattr(area_rectifier, "_LEAST_SUPPORT", 0.5)
    assert PlaceMeter(loop()).measure(*here, saying(WEST, 0.99)) is None


def test_in_the_middle_of_a_corridor_nothing_is_reported_along_it():
    reported = PlaceMeter(loop()).measure(*in_map((7.0, 1.0), 0.3), saying(SOUTH))
    assert reported is not None
    np.testing.assert_allclose(reported[0], (7.0, 1.0), atol=1e-6)
    assert reported[1][0, 0] > 1e3 > 10 > reported[1][1, 1]


def test_the_same_frame_seen_twice_from_one_spot_says_nothing_new():
    meter, here = PlaceMeter(loop()), in_map((2.3, 1.0), 0.8)
    first = meter.measure(*here, saying(SOUTH))
    assert first is not None
    xy, covariance = updated(here[0][:2, 3], 0.64 * np.eye(2), first)
    for _ in range(20):
        T, C = se3.from_plane(xy[0], xy[1], 0.0), np.zeros((6, 6))
        C[:2, :2] = covariance
        J = se3.adjoint(se3.from_plane(xy[0], xy[1], 0.0))
        reported = meter.measure(T, J @ C @ J.T, saying(SOUTH))
        if reported is not None:
            xy, covariance = updated(xy, covariance, reported)
    once = updated(here[0][:2, 3], 0.64 * np.eye(2), first)
    assert xy[0] - once[0][0] < 0.4 * (once[0][0] - 2.3)


def followed(drive, reported):
    """Poses (N, 3) of the default filter by wheels and places, and how often a place was refused."""
    T_start = se3.from_plane(*drive.truth[0])
    Ad = se3.adjoint(T_start)
    fusion = ErrorStateFilter(None, T_start, Ad @ np.diag([0.05**2, 0.05**2, 0, 0, 0, 0.01**2]) @ Ad.T)
    meter, poses, refused = PlaceMeter(loop()), [], 0
    answer = fusion.clone(0.0, "begin")
    for t in range(len(drive.truth)):
        if t:
            answer = fusion.predict(t * PERIOD_S, drive.steps[t - 1], drive.covariance, (t - 1) * PERIOD_S)
        place = meter.measure(not_none(answer.T_odom_body), not_none(answer.covariance), reported[t])
        if place is not None:
            answer = fusion.update_position(t * PERIOD_S, *place)
            refused += answer.reason is Reason.OUTLIER
        T = not_none(answer.T_odom_body)
        poses.append((T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])))
    return np.array(poses), refused


@pytest.mark.parametrize("drift", [0.005, 0.03])
def test_the_default_filter_is_as_good_by_them_as_the_rectifier(rng, drift):
    drive = drive_round(rng, laps=2, drift=drift)
    reported = answers(looks(rng, loop(), drive.truth, 0.85, 1.0), 8)
    poses, refused = followed(drive, reported)
    assert error_m(poses, drive.truth) < 0.4 * drive.wheels_error_m
    assert error_m(poses, drive.truth) < 1.3 * error_m(rectify(drive, reported).poses, drive.truth)
    assert refused < 0.02 * len(poses)


@pytest.mark.parametrize("kind", ["shuffled", "opposite", "always one"])
def test_a_forest_without_sense_does_not_ruin_the_wheels(rng, kind):
    drive = drive_round(rng, laps=1)
    reported = answers(looks(rng, loop(), drive.truth, 0.85, 1.0), 8)
    wrong = {"shuffled": reported[rng.permutation(len(reported))], "opposite": np.roll(reported, 4, axis=1)}
    wrong["always one"] = np.tile(saying(WEST, 0.97), (len(reported), 1))
    poses, _ = followed(drive, wrong[kind])
    assert error_m(poses, drive.truth) < 1.1 * drive.wheels_error_m


def test_what_cannot_be_is_refused():
    with pytest.raises(ConfigError, match="there is no area"):
        PlaceMeter(AreaMap(()))
    with pytest.raises(ConfigError, match="area_shares"):
        PlaceMeter(loop(), area_shares=np.zeros(8))
    for wrong in (np.ones(3), np.full(8, np.nan), np.zeros(8)):
        with pytest.raises(ConfigError, match="probabilities"):
            PlaceMeter(loop()).measure(*in_map((7.0, 1.0), 0.1), wrong)
