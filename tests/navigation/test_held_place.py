"""A place in the map that the wheels carry on while the localization is less sure than it was."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from navigation.test_where_now import SPEED_M_S, ticks

from benchmarks.plain_rooms import WHEELS
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import se2, se3
from wheelsight.estimation import FusedEstimate
from wheelsight.navigation.senses import HeldPlace, WhereNow

HOLD_S, HOLD_M = 3.0, 1.0
LEAP_M = 0.3


class Drive:
    """Straight on by the wheels, and by a localization that is right but for a leap to the side."""

    def __init__(self, speed_m_s: float = SPEED_M_S) -> None:
        self.where, self.speed, self.time_s = WhereNow(WHEELS), speed_m_s / SPEED_M_S, 0.0

    def go(self, until_s: float, leap_m: float, sigma_m: float, slip: bool = False) -> float:
        """How far off it is in the end, metres."""
        while self.time_s < until_s - 1e-9:
            self.time_s += 0.02
            reading = ticks(self.speed * self.time_s, self.time_s)
            self.where.roll(reading)
            T = se3.from_plane(self.speed * SPEED_M_S * self.time_s, 0.0, 0.0)
            T_map_odom, C = se3.from_plane(0.0, leap_m, 0.0), np.diag([sigma_m**2] * 3 + [0.001**2] * 3)
            said = FusedEstimate(
                self.time_s, Status.TRACKING, T, C, body="base", T_map_odom=T_map_odom, covariance_map=C, slip=slip
            )
            self.where.answer(said)
        pose = not_none(self.where.state).pose
        there = se2.to_parts(se2.from_parts(*self.where.T_map_odom) @ se2.from_parts(*not_none(self.where.odom_pose)))
        assert there == pytest.approx(pose, abs=1e-9)
        return float(np.hypot(*(pose[:2] - (self.speed * SPEED_M_S * self.time_s, 0.0))))


def test_who_walks_past_leads_no_place_astray() -> None:
    drive = Drive()
    assert drive.go(1.0, 0.0, 0.015) < 0.005
    assert drive.go(2.5, LEAP_M, 0.2) < 0.01
    assert drive.go(2.6, 0.0, 0.015) < 0.005


@pytest.mark.parametrize(("sigma_m", "slip"), [(0.03, False), (0.2, True)])
def test_a_place_that_is_stated_surely_or_wheels_that_slip_are_taken_at_once(sigma_m: float, slip: bool) -> None:
    """As after a loop."""
    drive = Drive()
    drive.go(1.0, 0.0, 0.015)
    assert drive.go(1.1, LEAP_M, sigma_m, slip) == pytest.approx(LEAP_M, abs=0.01)


@pytest.mark.parametrize(("speed_m_s", "held_s"), [(0.1, HOLD_S), (0.8, HOLD_M / 0.8)])
def test_it_is_held_for_no_longer_time_or_way(speed_m_s: float, held_s: float) -> None:
    drive = Drive(speed_m_s)
    drive.go(1.0, 0.0, 0.015)
    assert drive.go(1.0 + held_s - 0.1, LEAP_M, 0.2) < 0.01
    assert drive.go(1.0 + held_s + 0.1, LEAP_M, 0.2) == pytest.approx(LEAP_M, abs=0.01)


def test_it_becomes_less_sure_by_the_way_of_the_wheels(monkeypatch: pytest.MonkeyPatch) -> None:
    held = HeldPlace(np.eye(3), np.eye(3), 0.03, 0.0)
    assert held.holds(0.06, se2.from_parts(0.3, 0.4, -0.2), 1.0)
    assert held.holds(0.06, far := se2.from_parts(0.99, 0.0, 0.0), 1.0)
    # Until the way makes it no better than the new estimate.
    monkeypatch.setattr("wheelsight.navigation.senses._WHEELS_SHARE", 0.1)
    assert not held.holds(0.06, far, 1.0)


def test_nothing_is_held_once_the_robot_is_lost() -> None:
    drive = Drive()
    drive.go(1.0, 0.0, 0.015)
    drive.where.answer(FusedEstimate(1.1, Status.LOST, body="base"))
    assert drive.where.state is None
