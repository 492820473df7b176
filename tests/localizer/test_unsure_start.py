"""UncertainRestart: the estimate after the camera restarts at a pose that the wheels know poorly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.estimation import FusedEstimate, JoiningSettings
from wheelsight.estimation.kidnap_detection import UncertainRestart

T_ODOM_BASE = se3.from_plane(5.0, -2.0, 1.0)


def answer(sigma_m: float) -> FusedEstimate:
    """At a place that is known so well, each way."""
    return FusedEstimate(10.0, Status.TRACKING, T_ODOM_BASE, _about(T_ODOM_BASE, sigma_m), body="base")


def _about(T: FloatArray, sigma_m: float) -> FloatArray:
    """Of a position alone, the heading being known."""
    return np.diag([sigma_m**2 / 2, sigma_m**2 / 2, 1e-6, 1e-12, 1e-12, 1e-12])


def begun(spread_m: float | None) -> UncertainRestart:
    subject = UncertainRestart(JoiningSettings())
    subject.add_believed(answer(0.1))
    subject.begin(spread_m, 7)
    return subject


def test_it_is_doubtful_until_the_place_is_known_about_as_well_as_before() -> None:
    subject = begun(0.5)
    told = subject.apply(answer(0.5))
    assert (told.status, told.doubtful, told.reason) == (Status.COASTING, True, Reason.NOT_RECOGNISED)
    np.testing.assert_array_equal(told.covariance, answer(0.5).covariance)
    assert subject.apply(answer(0.28)).doubtful  # 0.1 m before and 0.25 m more are 0.269 m
    assert not subject.apply(answer(0.26)).doubtful
    assert not subject.apply(answer(0.5)).doubtful


@pytest.mark.parametrize("spread_m", [0.2, None])
def test_where_wheels_knew_it_nothing_is_said(spread_m: float | None) -> None:
    wide = answer(0.5)
    assert begun(spread_m).apply(wide) is wide


def test_a_camera_that_begins_once_more_is_no_surer_for_it() -> None:
    subject = begun(0.5)
    subject.add_believed(answer(0.5))
    subject.begin(0.5, 9)
    assert subject.apply(answer(0.5)).doubtful
    assert subject.since == 7  # loops between its own keyframes tell nothing


def test_loops_end_it_however_wide_the_answer_is_in_odom() -> None:
    subject = begun(0.5)
    assert subject.apply(answer(0.5)).doubtful
    subject.relocalized()
    wide = answer(0.5)
    assert subject.apply(wide) is wide


def test_where_a_camera_is_followed_that_failed_it_is_doubtful_though_that_tracks() -> None:
    subject = UncertainRestart(JoiningSettings())
    for sigma_m in (0.1, 0.12, 0.14):
        subject.add_believed(replace(answer(sigma_m), slip=True))
    assert not subject.apply(answer(0.14)).doubtful
    subject.add_believed(replace(answer(1.3), slip=True))
    subject.add_believed(answer(1.3))
    told = subject.apply(answer(1.3))
    assert (told.status, told.doubtful, told.reason) == (Status.COASTING, True, Reason.NOT_RECOGNISED)
    assert not subject.apply(answer(0.2)).doubtful


def test_without_slip_a_wide_answer_says_itself_how_wide_it_is() -> None:
    subject = UncertainRestart(JoiningSettings())
    for sigma_m in (0.1, 1.3):
        subject.add_believed(answer(sigma_m))
    assert not subject.apply(answer(1.3)).doubtful
