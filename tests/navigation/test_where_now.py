"""WhereNow: the last answer carried on by the wheels, and speeds that jittered stamps do not break."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none
from scipy.stats import chi2

from benchmarks.plain_rooms import WHEELS
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import WheelTicks
from wheelsight.navigation.senses import WhereNow

SPEED_M_S = 0.5
PER_M = WHEELS.ticks_per_turn / (2 * np.pi * 0.17)


def ticks(time_s: float, stamp_s: float | None = None) -> WheelTicks:
    """Of a base that goes straight on."""
    count = round(SPEED_M_S * time_s * PER_M)
    return WheelTicks(time_s if stamp_s is None else stamp_s, count, count)


def estimate_of(stamp_s: float, x: float, status: Status = Status.TRACKING, sigma_m: float = 0.01) -> Estimate:
    return Estimate(stamp_s, status, se3.from_plane(x, 0.0, 0.0), np.diag([sigma_m**2] * 3 + [0.0] * 3), body="base")


def rolled(until_s: float) -> WhereNow:
    where = WhereNow(WHEELS)
    for n in range(round(until_s / 0.02) + 1):
        where.roll(ticks(0.02 * n))
    return where


def test_the_wheels_carry_the_last_answer_on() -> None:
    where = rolled(1.0)
    where.answer(estimate_of(0.6, 7.0))
    assert not_none(where.state).pose == pytest.approx((7.0 + 0.4 * SPEED_M_S, 0.0, 0.0), abs=2e-3)
    assert not_none(where.odom_pose) == pytest.approx(not_none(where.state).pose)
    assert not_none(where.state).forward_m_s == pytest.approx(SPEED_M_S, rel=0.05)


def test_in_the_map_it_is_where_that_lies() -> None:
    where = rolled(0.2)
    where.answer(replace(estimate_of(0.2, 1.0), T_map_odom=se3.from_plane(0.0, 2.0, np.pi / 2)))
    assert not_none(where.state).pose == pytest.approx((0.0, 3.0, np.pi / 2), abs=1e-6)
    assert where.T_map_odom == pytest.approx((0.0, 2.0, np.pi / 2))


@pytest.mark.parametrize("status", [Status.LOST, Status.FAILING, Status.INITIALIZING])
def test_where_it_is_not_known_there_is_no_state(status: Status) -> None:
    where = rolled(0.2)
    assert where.state is None
    where.answer(estimate_of(0.2, 1.0, status))
    assert where.state is None
    assert where.is_rolling is (status is not Status.LOST)


def test_accuracy_is_that_of_the_pose_in_the_map_and_of_the_way_since() -> None:
    assert rolled(1.0).accuracy == (np.inf, np.inf)
    where = rolled(1.0)
    where.answer(estimate_of(1.0, 7.0))
    assert where.accuracy is None  # without loops there is no covariance in the map
    C = np.diag([0.02**2, 0.01**2, 0.0, 0.0, 0.0, 0.03**2])
    where.answer(replace(estimate_of(1.0, 0.0), covariance_map=C))
    quantiles = np.sqrt(chi2.ppf(0.95, [2, 1]))
    assert where.accuracy == pytest.approx(quantiles * (0.02, 0.03), rel=0.01)
    for n in range(51, 61):
        where.roll(ticks(0.02 * n))
    assert not_none(where.accuracy)[0] == pytest.approx(quantiles[0] * np.hypot(0.02, 0.05 * 0.2 * SPEED_M_S), rel=0.02)
    where.answer(replace(estimate_of(1.2, 0.0, Status.UNCONFIRMED), covariance_map=C))
    assert where.accuracy == (np.inf, np.inf)


def test_a_reading_stamped_right_after_another_is_no_burst_of_speed() -> None:
    where = WhereNow(WHEELS)
    speeds = []
    for n in range(50):
        jitter_s = 0.0198 if n % 7 == 3 else 0.0
        speed = where.roll(ticks(0.02 * n, 0.02 * n + jitter_s))
        if n > 5:
            speeds.append(not_none(speed).forward_m_s)
    assert max(speeds) < 2 * SPEED_M_S
    assert min(speeds) > 0.4 * SPEED_M_S


def test_while_it_coasts_it_says_how_much_less_sure_it_became() -> None:
    where = rolled(0.2)
    where.answer(estimate_of(0.2, 1.0, sigma_m=0.3))
    assert where.grown_sigma_m == 0.0
    where.answer(estimate_of(0.3, 1.0, Status.COASTING, sigma_m=0.5))
    assert where.grown_sigma_m == pytest.approx(0.4, abs=0.01)


def test_the_ways_between_readings_add_up_to_the_whole_while_it_gains_speed() -> None:
    """Means of speeds do not: they are late, by 4 cm at 2 m/s that were gained within a second."""
    where, way_m, by_speeds_m, before_m_s = WhereNow(WHEELS), 0.0, 0.0, 0.0
    for n in range(51):
        count = round((0.02 * n) ** 2 * PER_M)
        speed = not_none(where.roll(WheelTicks(0.02 * n, count, count)))
        way_m += speed.rolled[0]
        by_speeds_m += 0.02 * (before_m_s + speed.forward_m_s) / 2
        before_m_s = speed.forward_m_s
    assert way_m == pytest.approx(1.0, abs=1e-3)
    assert not_none(speed).rolled[1] == 0.0
    assert by_speeds_m < 0.97
