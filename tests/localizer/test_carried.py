"""Carried: what is believed of a robot that may have been carried in the dark."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.estimates import Status
from wheelsight.fusion import FusedEstimate
from wheelsight.geometry import se3
from wheelsight.localizer._carried import Carried
from wheelsight.settings import CarriedSettings

ANSWER = FusedEstimate(10.0, Status.TRACKING, np.eye(4), 1e-6 * np.eye(6), body="base")
AHEAD = se3.exp([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])


def carried(**settings: float) -> Carried:
    """In a dark of 4 s, at the origin."""
    subject = Carried(CarriedSettings(**settings))
    subject.unknown(4.0, AHEAD, np.eye(4))
    return subject


def test_wheels_that_stood_and_another_view_say_so_and_a_known_view_takes_it_back() -> None:
    subject = carried()
    assert subject.is_so
    answer = subject.answered(ANSWER)
    assert (answer.status, answer.doubtful) == (Status.COASTING, True)
    assert answer.covariance is not None
    sigmas = np.sqrt(np.diag(answer.covariance))
    np.testing.assert_allclose(sigmas[[0, 1, 5]], [2.8, 2.8, np.pi / np.sqrt(3)], rtol=1e-3)
    subject.known()
    assert not subject.is_so


@pytest.mark.parametrize(("same_view_m", "is_so"), [(0.3, True), (0.1, False)])
def test_wheels_that_went_on_tell_where_the_view_changed(same_view_m: float, is_so: bool) -> None:
    assert carried(same_view_m=same_view_m).is_so == is_so


def test_the_spread_is_as_it_is_set() -> None:
    answer = carried(speed_m_s=0.1, turned_rad=0.2).answered(ANSWER)
    assert answer.covariance is not None
    np.testing.assert_allclose(np.sqrt(np.diag(answer.covariance))[[0, 1, 5]], [0.4, 0.4, 0.2], rtol=1e-3)


@pytest.mark.parametrize(("astray_share", "expected_m"), [(2 / 3, 2.0), (0.1, 0.3)])
def test_from_then_on_a_way_leads_astray(astray_share: float, expected_m: float) -> None:
    subject = carried(astray_share=astray_share, speed_m_s=1e-6, turned_rad=3.0)
    subject.scatter(np.eye(4), np.eye(6))
    gone = FusedEstimate(12.0, Status.TRACKING, se3.from_plane(3.0, 0.0, 0.0), np.eye(6), body="base")
    answer = subject.answered(gone)
    assert answer.covariance is not None
    assert np.sqrt(answer.covariance[0, 0] - 1.0) == pytest.approx(expected_m)


@pytest.mark.parametrize(("known_rad", "is_so"), [(0.5, False), (0.001, True)])
def test_a_heading_that_is_known_again_ends_it(known_rad: float, is_so: bool) -> None:
    subject = carried(known_rad=known_rad)
    subject.scatter(np.eye(4), np.eye(6))
    subject.answered(FusedEstimate(12.0, Status.TRACKING, np.eye(4), 0.01 * np.eye(6), body="base"))
    assert subject.is_so == is_so
