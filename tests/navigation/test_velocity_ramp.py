"""VelocityRamp: limits hold whatever is asked."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from wheelsight.core.errors import ArgumentError
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.navigation import RobotLimits
from wheelsight.navigation.collision_monitor import VelocityRamp

LIMITS = RobotLimits()
anything = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-2, 2)


@examples(max_examples=200)
@given(asked=st.lists(st.tuples(anything, anything), min_size=1, max_size=40), period_s=st.floats(0.01, 0.2))
def test_limits_hold_for_anything_that_is_asked(asked: list[tuple[float, float]], period_s: float) -> None:
    ramp, before, grew = VelocityRamp(LIMITS), STOP, 0.0
    for forward, turn in asked:
        now = ramp.step(forward, turn, period_s)
        assert -LIMITS.backward_m_s <= now.forward_m_s <= LIMITS.forward_m_s
        assert abs(now.turn_rad_s) <= LIMITS.turn_rad_s
        change = abs(now.forward_m_s) - abs(before.forward_m_s)
        assert before.forward_m_s * now.forward_m_s >= 0
        assert -LIMITS.braking_m_s2 * period_s - 1e-9 <= change <= LIMITS.acceleration_m_s2 * period_s + 1e-9
        assert change / period_s <= max(grew, 0.0) + LIMITS.jerk_m_s3 * period_s + 1e-9
        assert abs(now.turn_rad_s - before.turn_rad_s) <= LIMITS.turn_acceleration_rad_s2 * period_s + 1e-9
        before, grew = now, change / period_s


def test_what_is_no_number_asks_for_a_stop() -> None:
    for forward, turn in ((math.nan, 0.5), (0.5, math.nan), (math.inf, 0.0)):
        ramp = VelocityRamp(LIMITS)
        ramp.follow(VelocityCommand(0.5, 0.5))
        first = ramp.step(forward, turn, 0.05)
        assert (first.forward_m_s, first.turn_rad_s) == pytest.approx((0.45, 0.425))
        for _ in range(20):
            last = ramp.step(forward, turn, 0.05)
        assert last == STOP


@pytest.mark.parametrize("period_s", [0.01, 0.05, 0.1])
def test_a_speed_is_reached_without_going_beyond_and_acceleration_falls_by_jerk(period_s: float) -> None:
    """From 0 to 1 m/s by 0.5 m/s² and 2 m/s³: v / a + a / j = 2.25 s, and a period or two."""
    ramp, speeds = VelocityRamp(LIMITS), [0.0]
    while speeds[-1] < 1.0:
        speeds.append(ramp.step(1.0, 0.0, period_s).forward_m_s)
    assert (len(speeds) - 1) * period_s == pytest.approx(2.25, abs=2.5 * period_s)
    accelerations = [(b - a) / period_s for a, b in zip([0.0, *speeds], [*speeds, 1.0], strict=True)]
    jerks = [(b - a) / period_s for a, b in pairwise(accelerations)]
    assert max(jerks) <= LIMITS.jerk_m_s3 + 1e-6
    # The step that reaches the speed is a part of one.
    assert min(jerks) >= -LIMITS.jerk_m_s3 * 1.125 - 1e-6


def test_a_stop_is_not_delayed_by_jerk() -> None:
    ramp = VelocityRamp(LIMITS)
    for _ in range(60):
        ramp.step(1.0, 0.0, 0.05)
    assert ramp.given.forward_m_s == 1.0
    assert ramp.step(0.0, 0.0, 0.05).forward_m_s == pytest.approx(1.0 - LIMITS.braking_m_s2 * 0.05)


def test_it_goes_on_from_what_was_driven() -> None:
    ramp = VelocityRamp(LIMITS)
    for _ in range(60):
        ramp.step(1.0, 0.0, 0.05)
    ramp.follow(VelocityCommand(0.2, 0.0))
    assert 0.2 < ramp.step(1.0, 0.0, 0.05).forward_m_s <= 0.2 + LIMITS.jerk_m_s3 * 0.05**2 + 1e-9


@pytest.mark.parametrize("period_s", [0.0, -0.1, math.nan, math.inf])
def test_a_period_that_is_none_is_refused(period_s: float) -> None:
    with pytest.raises(ArgumentError):
        VelocityRamp(LIMITS).step(0.1, 0.0, period_s)


def test_limits_of_zero_stand() -> None:
    still = VelocityRamp(RobotLimits(forward_m_s=0, backward_m_s=0, turn_rad_s=0))
    assert {still.step(v, 1.0, 0.05) for v in (1.0, -1.0, 0.5)} == {STOP}
