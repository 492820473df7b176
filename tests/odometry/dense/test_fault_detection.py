"""Which poses are suspected that only surfaces speak for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from odometry.dense.scenes import Plane, bench, frame_of

from wheelsight.core.estimates import MotionEstimate
from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import KeyframeId
from wheelsight.vision.dense import DenseSettings
from wheelsight.vision.dense.odometry import FaultDetector
from wheelsight.vision.dense.tracking import Tracked

STEP_S = 1 / 30
FRAME = bench().grid(frame_of([Plane((0, 0, 1), 2.0)], np.eye(4), 0.0))
SMOOTH = {"is_alone": True, "is_steady": True}


def fitting(residual: float, twist: FloatArray | None = None) -> Tracked:
    """A pose whose planes lie so far off, at that speed; the speed expected was none."""
    motion = MotionEstimate(np.eye(4), np.eye(6))
    found = Tracked(FRAME, np.eye(4), np.eye(6), motion, KeyframeId(0), np.zeros(6) if twist is None else twist)
    return replace(found, residual=residual)


def after(*residuals: float) -> FaultDetector:
    faults = FaultDetector(DenseSettings().max_unseen_s)
    for residual in residuals:
        faults.learn(fitting(residual))
    return faults


def test_a_pose_that_fits_twice_as_badly_as_a_perfect_one_is_suspected_at_the_start():
    assert not after().suspects(fitting(1.9), STEP_S, **SMOOTH)
    assert after().suspects(fitting(2.1), STEP_S, **SMOOTH)


@given(st.lists(st.floats(0.0, 10.0), max_size=40))
def test_what_fits_no_worse_than_a_perfect_pose_twice_over_is_never_suspected_for_it(before: list[float]) -> None:
    assert not after(*before).suspects(fitting(2.0), STEP_S, **SMOOTH)


def test_where_surfaces_always_fit_badly_that_is_usual_and_where_they_fit_well_again_no_longer():
    """Depth and colour of some cameras are not of one instant: four times the noise is usual there."""
    rough = after(*(min(2.0 * 1.1**k, 4.0) for k in range(40)))
    assert not rough.suspects(fitting(4.5), STEP_S, **SMOOTH)
    assert rough.suspects(fitting(9.0), STEP_S, **SMOOTH)
    for _ in range(60):
        rough.learn(fitting(0.7))
    assert rough.suspects(fitting(2.1), STEP_S, **SMOOTH)


def test_one_bad_frame_is_not_yet_usual():
    """Else the frame after a wrong one would be believed."""
    assert after(0.8, 0.8, 50.0).suspects(fitting(2.5), STEP_S, **SMOOTH)


@pytest.mark.parametrize("is_alone", [True, False])
def test_another_sensor_stands_in_for_what_does_not_fit_or_is_not_seen(is_alone: bool) -> None:
    assert after().suspects(fitting(5.0), STEP_S, is_alone=is_alone, is_steady=True) == is_alone
    blind = after()
    for _ in range(20):
        blind.count(STEP_S, shows_all=False)
    assert blind.is_blind
    assert blind.suspects(fitting(0.8), STEP_S, is_alone=is_alone, is_steady=True) == is_alone


@pytest.mark.parametrize("is_alone", [True, False])
def test_a_gap_and_a_leap_are_suspected_anyone_who_helps(is_alone: bool) -> None:
    leap = np.array([1.5, 0, 0, 0, 0, 0])
    assert after().suspects(fitting(0.8), 0.5, is_alone=is_alone, is_steady=True)
    assert after().suspects(fitting(0.8, leap), STEP_S, is_alone=is_alone, is_steady=True)
    assert not after().suspects(fitting(0.8, leap), STEP_S, is_alone=is_alone, is_steady=False)
    assert not after().suspects(fitting(0.8, 0.5 * leap), STEP_S, is_alone=is_alone, is_steady=True)


def test_what_is_seen_now_and_then_counts_half_against_what_is_not():
    faults = after()
    for k in range(30):
        faults.count(STEP_S, shows_all=k % 3 == 2)
    assert faults.unseen_s == pytest.approx((20 - 0.5 * 10) * STEP_S)
    for _ in range(40):
        faults.count(STEP_S, shows_all=True)
    assert faults.unseen_s == 0


def test_a_pose_is_off_the_prior_that_moves_or_turns_by_more_than_rolling_wheels_err():
    """Wheels of 2 % too large a radius at 1 m/s, or of 3 % too wide a track at 90 degrees/s, are not."""
    for twist in ([0.02, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0.05, 0]):
        assert not after().is_off_prior(fitting(0.8, np.array(twist)))
    for twist in ([0, 0, 0.25, 0, 0, 0], [0, 0, 0, 0, 0.25, 0]):
        assert after().is_off_prior(fitting(0.8, np.array(twist)))
