"""Where two motions to one pose meet: by least squares, never far off the short one, and with less drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none
from odometry.dense.scenes import Plane, dense, frame_of
from odometry.views import run
from scipy.optimize import least_squares

from wheelsight.core.estimates import MotionEstimate
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.vision.dense import odometry
from wheelsight.vision.dense.odometry import joined

T_SHORT = se3.exp([0.4, 0.1, 0.9, 0.1, -0.3, 0.2])
T_LONG = T_SHORT @ se3.exp([1e-3, -2e-3, 2e-3, 4e-4, -6e-4, 3e-4])


def met(T_short: FloatArray, short: MotionEstimate, T_long: FloatArray, long: MotionEstimate) -> FloatArray:
    return joined(T_short, short, T_long, long, np.zeros((6, 6)))


def reported(T_reference_current: FloatArray, covariance: FloatArray) -> MotionEstimate:
    return MotionEstimate(T_reference_current, covariance)


def spread(rng: np.random.Generator) -> FloatArray:
    """A covariance (6, 6) of millimetres and hundredths of degrees, with correlations."""
    A = rng.standard_normal((6, 6)) * np.array([2e-3, 2e-3, 2e-3, 5e-4, 5e-4, 5e-4])[:, None]
    return A @ A.T + np.diag([1e-6] * 3 + [1e-7] * 3)


def test_ways_as_sure_as_each_other_meet_where_the_short_one_counts_twice() -> None:
    C = np.diag([1e-6] * 3 + [1e-7] * 3)
    T = met(T_SHORT, reported(np.eye(4), C), T_LONG, reported(np.eye(4), C))
    expected = T_SHORT @ se3.exp(2 / 3 * se3.log(se3.invert(T_SHORT) @ T_LONG))
    np.testing.assert_allclose(T, expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_ways_meet_where_least_squares_has_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motions = [reported(se3.exp(rng.normal(0, 0.5, 6)), spread(rng)) for _ in range(2)]
    # Each as a left perturbation in its reference's frame, which stands where the motion comes from.
    roots = [
        np.linalg.inv(np.linalg.cholesky(times * not_none(m.covariance)))
        for times, m in zip((2, 1), motions, strict=True)
    ]

    def residuals(xi: FloatArray) -> FloatArray:
        T = T_SHORT @ se3.exp(xi)
        off = []
        for T_reported, motion, root in zip((T_SHORT, T_LONG), motions, roots, strict=True):
            T_map_reference = T_reported @ se3.invert(not_none(motion.T_reference_current))
            there = se3.invert(T_map_reference) @ T
            off.append(root @ se3.log(there @ se3.invert(not_none(motion.T_reference_current))))
        return np.concatenate(off)

    best = T_SHORT @ se3.exp(least_squares(residuals, np.zeros(6), x_scale=1e-3, xtol=1e-14, ftol=1e-14).x)
    np.testing.assert_allclose(met(T_SHORT, motions[0], T_LONG, motions[1]), best, atol=2e-6)


@pytest.mark.parametrize("left", [0.0, -1e-9])
def test_where_nothing_is_left_but_what_both_share_the_short_one_stands(left: float) -> None:
    """It ended a drive: a matrix of rounding alone cannot be solved."""
    C = np.diag([1e-6] * 3 + [1e-7] * 3)
    given = (T_SHORT, reported(np.eye(4), C), T_LONG, reported(np.eye(4), C))
    np.testing.assert_array_equal(joined(*given, C - left * np.eye(6)), T_SHORT)


def test_ways_that_contradict_each_other_leave_the_short_one() -> None:
    C = np.diag([1e-6] * 3 + [1e-7] * 3)
    T_far = T_SHORT @ se3.exp([0.02, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(met(T_SHORT, reported(np.eye(4), C), T_far, reported(np.eye(4), C)), T_SHORT)


@pytest.mark.parametrize("place", [0, 1])
def test_what_does_not_show_all_is_not_mixed_in(place: int) -> None:
    motions = [reported(np.eye(4), 1e-6 * np.eye(6))] * 2
    motions[place] = replace(motions[place], degenerate=np.eye(6)[:1])
    np.testing.assert_array_equal(met(T_SHORT, motions[0], T_LONG, motions[1]), T_SHORT)


@pytest.mark.slow
def test_motions_reported_by_two_keyframes_drift_less(monkeypatch: pytest.MonkeyPatch) -> None:
    corridor = [
        Plane((1, 0, 0), 1.2, is_painted=True),
        Plane((-1, 0, 0), 1.2, is_painted=True),
        Plane((0, 1, 0), 0.9, is_painted=True),
    ]
    poses = [se3.exp([0, 0, 0.1 * k, 0, 0, 0]) for k in range(28)]
    drives = [
        [frame_of(corridor, T, 0.1 * k, noise_seed=1000 * seed + k) for k, T in enumerate(poses)] for seed in range(3)
    ]

    def ends() -> FloatArray:
        """(3, 6) how far off the last pose is in as many drives."""
        off = []
        for frames in drives:
            subject = dense()
            found = not_none(run(subject, frames)[-1].T_odom_body)
            assert len(subject.store) > 3
            off.append(se3.log(se3.invert(poses[-1]) @ found))
        return np.array(off)

    by_two = ends()
    monkeypatch.setattr(odometry, "joined", lambda T_short, *_: T_short)
    by_one = ends()
    assert not np.array_equal(by_two, by_one)
    assert (by_two[:, 3:] ** 2).mean() < 0.8 * (by_one[:, 3:] ** 2).mean()
