"""UncertainRestart: the estimate after the camera restarts at a pose that the wheels know poorly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.core.estimates import PoseFinding, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.estimation import FusedEstimate
from wheelsight.estimation.consistency_check import UncertainRestart

T_ODOM_BASE = se3.from_plane(5.0, -2.0, 1.0)


def answer(sigma_m: float) -> FusedEstimate:
    """At a place that is known so well, each way."""
    return FusedEstimate(10.0, Status.TRACKING, T_ODOM_BASE, _about(T_ODOM_BASE, sigma_m), body="base")


def _about(T: FloatArray, sigma_m: float) -> FloatArray:
    """Of a position alone, the heading being known."""
    return np.diag([sigma_m**2 / 2, sigma_m**2 / 2, 1e-6, 1e-12, 1e-12, 1e-12])


def is_uncertain(subject: UncertainRestart, sigma_m: float) -> bool:
    fused = answer(sigma_m)
    evidence = subject.update_evidence(not_none(fused.T_odom_body), not_none(fused.covariance))
    assert evidence is None or (evidence.finding, evidence.covariance) == (PoseFinding.UNCERTAIN_RESTART, None)
    return evidence is not None


def begun(spread_m: float | None) -> UncertainRestart:
    subject = UncertainRestart()
    subject.add_accepted(answer(0.1))
    subject.begin(spread_m, 7)
    return subject


def test_it_is_doubtful_until_the_place_is_known_about_as_well_as_before() -> None:
    subject = begun(0.5)
    assert is_uncertain(subject, 0.5)
    assert is_uncertain(subject, 0.28)  # 0.1 m before and 0.25 m more are 0.269 m
    assert not is_uncertain(subject, 0.26)
    assert not is_uncertain(subject, 0.5)


@pytest.mark.parametrize("spread_m", [0.2, None])
def test_where_wheels_knew_it_nothing_is_said(spread_m: float | None) -> None:
    assert not is_uncertain(begun(spread_m), 0.5)


def test_a_camera_that_begins_once_more_is_no_surer_for_it() -> None:
    subject = begun(0.5)
    subject.add_accepted(answer(0.5))
    subject.begin(0.5, 9)
    assert is_uncertain(subject, 0.5)
    assert subject.since == 7  # loops between its own keyframes tell nothing


def test_loops_end_it_however_wide_the_answer_is_in_odom() -> None:
    subject = begun(0.5)
    assert is_uncertain(subject, 0.5)
    subject.relocalized()
    assert not is_uncertain(subject, 0.5)


def test_where_a_camera_is_followed_that_failed_it_is_doubtful_though_that_tracks() -> None:
    subject = UncertainRestart()
    for sigma_m in (0.1, 0.12, 0.14):
        subject.add_accepted(replace(answer(sigma_m), slip=True))
    assert not is_uncertain(subject, 0.14)
    subject.add_accepted(replace(answer(1.3), slip=True))
    subject.add_accepted(answer(1.3))
    assert is_uncertain(subject, 1.3)
    assert not is_uncertain(subject, 0.2)


def test_without_slip_a_wide_answer_says_itself_how_wide_it_is() -> None:
    subject = UncertainRestart()
    for sigma_m in (0.1, 1.3):
        subject.add_accepted(answer(sigma_m))
    assert not is_uncertain(subject, 1.3)
