"""LigockiFilter: eq. 2 of the paper as it is printed, and what follows from it."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from pydantic import ValidationError

from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import se2, se3
from wheelsight.estimation import LigockiSettings
from wheelsight_papers import LigockiFilter, ligocki
from wheelsight_papers.ligocki import measurement_matrix, process_matrix


def yaw_of(T):
    return np.arctan2(T[1, 0], T[0, 0])


def test_the_matrix_is_that_of_equation_2():
    C, dt_s = 0.9, 0.05
    expected = [[C, 1 - C, 0, 0], [C / dt_s, (1 - C) / dt_s, -C / dt_s, -(1 - C) / dt_s]]
    np.testing.assert_allclose(measurement_matrix(C, dt_s), expected)


def test_sensors_that_agree_are_followed_exactly():
    fusion = LigockiFilter()
    for i in range(400):  # three times round: yaw passes ±π
        T = se3.from_plane(np.sin(0.05 * i), 1 - np.cos(0.05 * i), 0.05 * i)
        found = fusion.update(0.1 * i, T, se2.from_parts(T[0, 3], T[1, 3], 0.05 * i))
        np.testing.assert_allclose(not_none(found.T_odom_body), T, atol=1e-9)
    np.testing.assert_allclose(not_none(found.velocity)[2], 0.5, atol=1e-9)


def test_drift_of_the_wheels_is_forgotten_with_the_weight_as_base():
    settings = LigockiSettings(weight=0.9)
    fusion = LigockiFilter(settings)
    fusion.update(0.0, np.eye(4), np.eye(4))
    fusion.update(0.1, se3.from_plane(1.0, 0, 0), np.eye(4))  # a leap of the wheels by 1 m
    for k in range(1, 30):
        found = fusion.update(0.1 + 0.1 * k, se3.from_plane(1.0, 0, 0), np.eye(4))
        np.testing.assert_allclose(not_none(found.T_odom_body)[0, 3], 0.9 ** (k + 1), atol=1e-12)


def test_wheels_that_drift_for_ever_leave_a_bounded_error():
    fusion = LigockiFilter(LigockiSettings(weight=0.95))
    for i in range(2000):
        found = fusion.update(0.1 * i, se3.from_plane(0.01 * i, 0, 0), se3.from_plane(0.0, 0, 0))
    np.testing.assert_allclose(not_none(found.T_odom_body)[0, 3], 0.01 * 0.95 / 0.05, rtol=1e-6)


def test_velocity_is_the_weighted_mean_of_both_velocities():
    fusion = LigockiFilter(LigockiSettings(weight=0.8))
    fusion.update(0.0, np.eye(4), np.eye(4))
    found = fusion.update(0.5, se3.from_plane(1.0, 0, 0), se3.from_plane(0.5, 0, 0))
    np.testing.assert_allclose(not_none(found.velocity), [0.8 * 2 + 0.2 * 1, 0, 0], atol=1e-12)


def test_covariance_is_that_of_scattered_readings(rng, monkeypatch):
    monkeypatch.setattr(ligocki, "_WHEEL_DRIFT", np.array([0.05, 0.05, 0.0]))
    monkeypatch.setattr(ligocki, "_VISUAL_DRIFT", np.array([0.02, 0.02, 0.0]))
    settings = LigockiSettings(weight=0.9)
    steps, runs, dt_s = 30, 4000, 0.1
    x, A, H = np.zeros((runs, 4)), process_matrix(0.9), measurement_matrix(0.9, dt_s)
    for _ in range(steps):
        noise = np.zeros((runs, 4))
        noise[:, :2] = rng.normal(size=(runs, 2)) * [0.05 * np.sqrt(dt_s), 0.02 * np.sqrt(dt_s)]
        x = x @ A.T + noise
    fusion = LigockiFilter(settings)
    for i in range(steps + 1):
        found = fusion.update(i * dt_s, np.eye(4), np.eye(4))
    scattered = (x @ H.T).var(axis=0)
    np.testing.assert_allclose(
        [not_none(found.covariance)[0, 0], not_none(found.velocity_covariance)[0, 0]], scattered, rtol=0.1
    )


def test_steps_of_the_wheels_are_turned_into_the_joined_frame():
    """A heading of the wheels that is wrong by 90° only matters until vision corrects it."""
    fusion = LigockiFilter(LigockiSettings(weight=0.5))
    fusion.update(0.0, np.eye(4), np.eye(4))
    for k in range(60):
        fusion.update(0.1 + 0.1 * k, se3.from_plane(0, 0, np.pi / 2), np.eye(4))
    found = fusion.update(10.0, se3.from_plane(0, 1.0, np.pi / 2), se3.from_plane(1.0, 0, 0))
    np.testing.assert_allclose(not_none(found.T_odom_body)[:2, 3], [1.0, 0.0], atol=1e-9)


def test_without_vision_the_wheels_lead_on():
    fusion = LigockiFilter()
    fusion.update(0.0, np.eye(4), np.eye(4))
    found = fusion.update(1.0, se3.from_plane(1.0, 0, 0), None)
    assert found.status is Status.COASTING
    np.testing.assert_allclose(not_none(found.T_odom_body)[0, 3], 1.0)


def test_a_stamp_that_is_not_later_changes_nothing():
    fusion = LigockiFilter()
    fusion.update(1.0, np.eye(4), np.eye(4))
    found = fusion.update(1.0, se3.from_plane(5.0, 0, 0), np.eye(4))
    assert (found.status, found.reason) == (Status.FAILING, Reason.CLOCK_BACKWARDS)
    np.testing.assert_allclose(not_none(found.T_odom_body), np.eye(4))


@pytest.mark.parametrize("bad", [np.full((4, 4), np.nan), 2 * np.eye(4), 2 * np.eye(3), np.eye(2)])
def test_what_is_no_pose_is_refused(bad):
    with pytest.raises(ConfigError):
        LigockiFilter().update(0.0, bad, np.eye(4))
    with pytest.raises(ConfigError):
        LigockiFilter().update(0.0, np.eye(4), bad)
    with pytest.raises(ConfigError):
        LigockiFilter().update(np.nan, np.eye(4), np.eye(4))


@pytest.mark.parametrize("weight", [0.0, 0.3, 1.0, np.nan])
def test_a_weight_that_equation_2_excludes_is_refused(weight):
    with pytest.raises(ValidationError):
        LigockiSettings(weight=weight)
