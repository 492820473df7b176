"""Directions that a view does not show are named and left to the prior; those it shows are not touched."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from odometry.dense.scenes import Plane, apart, bench, dense, frame_of

from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import se3
from wheelsight.vision.dense import DenseEstimate
from wheelsight.vision.dense.alignment import DenseAlignment, MotionPrior, judge
from wheelsight.vision.dense.tracking import PRIOR_SIGMA_M_S, KeypointTracker

WALL = [Plane((0.0, 0.0, -1.0), -1.6)]
PAINTED_WALL = [Plane((0.0, 0.0, -1.0), -1.6, is_painted=True)]
CORRIDOR = [Plane((1.0, 0.0, 0.0), -1.0), Plane((-1.0, 0.0, 0.0), -1.0), Plane((0.0, -1.0, 0.0), -0.6)]
# Sideways, upwards and forwards at once, and a turn about all axes.
MOTION = se3.exp([0.02, -0.015, 0.03, 0.005, -0.008, 0.01])
WRONG = se3.exp([0.01, 0.008, 0.0, 0.0, 0.0, 0.012])


def tracked(planes: list[Plane], T_prior: np.ndarray | None, **settings: Any) -> DenseEstimate:
    """The estimate at the second of two noisy frames, MOTION apart."""
    odometry = dense(**settings)
    odometry.process(frame_of(planes, np.eye(4), 0.0, noise_seed=1))
    return odometry.process(frame_of(planes, MOTION, 1 / 30, noise_seed=2), T_prior)


def span(directions: np.ndarray, axes: list[int]) -> float:
    """Smallest share of the axes' unit vectors that lies in the span of `directions`."""
    return min(float(np.linalg.norm(directions[:, axis])) for axis in axes)


def test_one_plain_wall_shows_three_directions() -> None:
    estimate = tracked(WALL, MOTION @ WRONG)
    degenerate = not_none(estimate.motion.degenerate)
    assert estimate.status is Status.TRACKING
    assert len(degenerate) == 3
    assert span(degenerate, [0, 1, 5]) > 0.95  # sideways, up and down, and roll about the wall's normal
    error = se3.log(not_none(estimate.T_odom_body) @ se3.invert(MOTION @ WRONG))
    assert np.abs(error[[0, 1, 5]]).max() < 2e-3  # the prior stands
    exact = se3.log(not_none(estimate.T_odom_body) @ se3.invert(MOTION))
    assert np.abs(exact[[2, 3, 4]]).max() < 2e-3  # what is seen is found


def test_unseen_directions_have_the_priors_variance() -> None:
    estimate = tracked(WALL, MOTION)
    sigma = np.sqrt(np.diag(not_none(estimate.motion.covariance)))
    assert sigma[[0, 1]] == pytest.approx(PRIOR_SIGMA_M_S / 30, rel=0.1)
    assert sigma[2] < 0.1 * sigma[0]


def test_paint_shows_what_the_wall_does_not() -> None:
    estimate = tracked(PAINTED_WALL, MOTION @ WRONG)
    assert len(not_none(estimate.motion.degenerate)) == 0
    assert apart(MOTION, not_none(estimate.T_odom_body))[0] < 2e-3


def test_paint_shows_nothing_to_depth_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(KeypointTracker, "track", lambda *_: None)
    monkeypatch.setattr(KeypointTracker, "recognise", lambda *_: None)
    estimate = tracked(PAINTED_WALL, MOTION, color_weight=0.0)
    assert len(not_none(estimate.motion.degenerate)) == 3


def test_a_plain_corridor_hides_the_way_along_it() -> None:
    estimate = tracked(CORRIDOR, MOTION)
    degenerate = not_none(estimate.motion.degenerate)
    assert len(degenerate) == 1
    assert abs(degenerate[0, 2]) > 0.95
    assert apart(MOTION, not_none(estimate.T_odom_body))[0] < 5e-3


def test_judge_keeps_an_alignment_that_shows_all() -> None:
    T = se3.exp([0.1, 0.2, 0.3, 0.1, 0.2, 0.3])
    found = DenseAlignment(
        T, 1e9 * np.eye(6), 1000, 900, 1000, 1.0, grey_sigma=8.0, claimed=np.eye(6), compared=np.zeros((6, 6))
    )
    judged = judge(found, MotionPrior(np.eye(4), 0.01))
    np.testing.assert_array_equal(judged.T_reference_frame, T)
    assert judged.reason is None
    assert len(judged.degenerate) == 0


@pytest.mark.parametrize(
    ("planes", "residual", "strength", "reason"),
    [
        (100, 1.0, 1e9, Reason.TOO_LITTLE_OVERLAP),
        (900, 9.0, 1e9, Reason.POOR_FIT),
        (900, 1.0, 0.0, Reason.DEGENERATE),
        (0, np.inf, 0.0, Reason.TOO_LITTLE_OVERLAP),
    ],
)
def test_judge_says_why_not(planes: int, residual: float, strength: float, reason: Reason) -> None:
    found = DenseAlignment(
        np.eye(4),
        strength * np.eye(6),
        1000,
        planes,
        1000,
        residual,
        grey_sigma=8.0,
        claimed=np.eye(6),
        compared=np.zeros((6, 6)),
    )
    assert judge(found, MotionPrior(np.eye(4), 0.01)).reason is reason


@pytest.mark.parametrize(("first_off_m", "is_kept"), [(0.002, True), (0.05, False)])
def test_what_is_hidden_is_left_to_the_expectation_that_fits_what_is_seen(first_off_m: float, is_kept: bool) -> None:
    """Wheels that slip expect too far a way ahead, which is seen, and aside, which is not."""
    information = np.diag([0.0, 1e9, 1e9, 1e9, 1e9, 1e9])
    found = DenseAlignment(
        np.eye(4), information, 1000, 900, 1000, 1.0, grey_sigma=8.0, claimed=np.eye(6), compared=np.zeros((6, 6))
    )
    first, other = se3.exp([0.3, 0, first_off_m, 0, 0, 0]), se3.exp([0.01, 0, 0.001, 0, 0, 0])
    judged = judge(found, MotionPrior(first, 0.05, (other,)))
    assert judged.T_reference_frame[0, 3] == pytest.approx(0.3 if is_kept else 0.01)
    np.testing.assert_allclose(judged.T_reference_frame[1:3, 3], 0, atol=1e-12)


@pytest.mark.parametrize(("confirmed", "is_shown"), [(0.9, True), (0.2, False)])
def test_a_direction_that_the_frame_does_not_confirm_is_not_shown(confirmed: float, is_shown: bool) -> None:
    compared = 1e9 * np.eye(6)
    information = np.diag([confirmed, 1, 1, 1, 1, 1]) @ compared
    found = DenseAlignment(
        se3.exp([0.1, 0, 0, 0, 0, 0]),
        information,
        1000,
        900,
        1000,
        1.0,
        grey_sigma=8.0,
        claimed=np.eye(6),
        compared=compared,
    )
    judged = judge(found, MotionPrior(np.eye(4), 0.01))
    assert (len(judged.degenerate) == 0) is is_shown
    assert judged.T_reference_frame[0, 3] == pytest.approx(0.1 if is_shown else 0.0)


@pytest.mark.parametrize(("planes", "least", "most"), [(PAINTED_WALL, 0.7, 1.0), (WALL, -0.3, 0.3)])
def test_a_frame_confirms_the_marks_that_it_shows(planes: list[Plane], least: float, most: float) -> None:
    reference = frame_of(PAINTED_WALL, np.eye(4), 0.0, noise_seed=1)
    found = bench().align(reference, frame_of(planes, np.eye(4), 0.0, noise_seed=2))
    along = np.eye(6)[0]
    share = float(along @ found.information @ along / (along @ found.compared @ along))
    assert least < share < most


def test_information_counts_independent_residuals_only(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = bench()
    first, second = (frame_of(PAINTED_WALL, T, 0.0, noise_seed=seed) for seed, T in ((1, np.eye(4)), (2, MOTION)))
    found = parts.align(first, second)
    judged = []
    for alike in (1.0, 30.0):
        monkeypatch.setattr("wheelsight.vision.dense.alignment.CORRELATION", alike)
        judged.append(judge(found, MotionPrior(MOTION, 0.1)))
    one, thirty = judged
    np.testing.assert_allclose(thirty.covariance, 30 * one.covariance, rtol=1e-9)


def test_what_only_the_reference_shows_shows_nothing() -> None:
    """From where a corridor's painted end was in sight to where it is plain, nothing shows how far one has come."""
    painted = [replace(plane, is_painted=True) for plane in CORRIDOR]
    odometry = dense(reference="previous")
    odometry.process(frame_of(painted, np.eye(4), 0.0, noise_seed=0))
    estimate = odometry.process(frame_of(painted, np.eye(4), 1 / 30, noise_seed=1), np.eye(4))
    assert len(not_none(estimate.motion.degenerate)) == 0
    estimate = odometry.process(frame_of(CORRIDOR, np.eye(4), 2 / 30, noise_seed=2), np.eye(4))
    degenerate = not_none(estimate.motion.degenerate)
    assert len(degenerate) == 1
    assert abs(degenerate[0, 2]) > 0.95
