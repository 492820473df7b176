"""Wheels held at their speeds: by limits, a loop over encoders, and reasons to stop; motors by closed form."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from wheelsight.core import robots
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import STOP, VelocityCommand, WheelTicks
from wheelsight.core.robots import Duties, LimitedVelocity, RobotLimits, VelocityControl, WheelControlSettings

WHEELS = Wheels(0.17, 0.17, 0.52, 3200)
M_PER_TICK = WHEELS.left_m_per_tick
PERIOD_S = 0.02
FULL_M_S = WheelControlSettings().full_speed_m_s
QUICK = RobotLimits(
    forward_m_s=1.5, turn_rad_s=4, acceleration_m_s2=3, braking_m_s2=5, turn_acceleration_rad_s2=10, jerk_m_s3=50
)


class Plant:
    """Two motors with a lag, encoders, and the loop on them."""

    def __init__(
        self,
        limits: RobotLimits | None = None,
        settings: WheelControlSettings | None = None,
        *,
        strength: float = 1.0,
        lag_s: float = 0.1,
    ) -> None:
        self.control = VelocityControl(WHEELS, limits or RobotLimits(), settings)
        self.strength, self.lag_s = strength, lag_s
        self.speeds_m_s, self.ways_m = np.zeros(2), np.zeros(2)
        self.now_s = 0.0
        self.seen: Callable[[FloatArray], FloatArray] = lambda ways_m: ways_m
        self.is_silent = False
        self.duties: list[Duties] = []

    def step(self, command: VelocityCommand) -> Duties:
        left, right = (math.floor(way_m / M_PER_TICK) for way_m in self.seen(self.ways_m))
        ticks = None if self.is_silent else WheelTicks(self.now_s, left, right)
        duties = self.control.update(self.now_s, ticks, command)
        goal = self.strength * FULL_M_S * np.array([duties.left, duties.right])
        self.speeds_m_s += (1 - math.exp(-PERIOD_S / self.lag_s)) * (goal - self.speeds_m_s)
        self.ways_m += self.speeds_m_s * PERIOD_S
        self.now_s += PERIOD_S
        self.duties.append(duties)
        return duties

    def run(self, command: VelocityCommand, seconds: float) -> FloatArray:
        """Speeds (N, 2) of the rims."""
        speeds = []
        for _ in range(round(seconds / PERIOD_S)):
            self.step(command)
            speeds.append(self.speeds_m_s.copy())
        return np.array(speeds)


@pytest.mark.parametrize("strength", [0.85, 1.0, 1.15])
@pytest.mark.parametrize("lag_s", [0.05, 0.1, 0.2])
def test_a_step_is_answered_without_swinging(strength: float, lag_s: float) -> None:
    speeds = Plant(strength=strength, lag_s=lag_s).run(VelocityCommand(0.8), 6.0)
    assert speeds[-50:] == pytest.approx(0.8, abs=0.01)
    assert speeds.max() < 0.8 * 1.04
    first = int(np.flatnonzero(speeds[:, 0] > 0.76)[0])
    assert first * PERIOD_S < 2.0  # 0.8 m/s at 0.5 m/s² take 1.85 s
    np.testing.assert_array_equal(speeds[:, 0], speeds[:, 1])


def test_turns_and_arcs_have_the_speeds_of_their_wheels() -> None:
    plant = Plant(strength=0.9)
    half_m = WHEELS.track_width_m / 2
    for command in (VelocityCommand(0.0, 0.6), VelocityCommand(0.4, -0.5), VelocityCommand(-0.2, 0.0)):
        wanted = command.forward_m_s + np.array([-half_m, half_m]) * command.turn_rad_s
        assert plant.run(command, 5.0)[-1] == pytest.approx(wanted, abs=0.01)
    assert plant.control.reason == ""
    plant.run(STOP, 2.0)
    assert plant.duties[-1] == Duties()
    assert np.abs(plant.speeds_m_s).max() < 1e-3


def test_speed_keeps_acceleration_braking_and_jerk() -> None:
    limits = RobotLimits()
    velocity = LimitedVelocity(limits)
    speeds = [0.0]
    for command in [VelocityCommand(0.9, 2.0)] * 150 + [VelocityCommand(-0.9, -2.0)] * 150 + [STOP] * 50:
        speeds.append(velocity.towards(command, PERIOD_S).forward_m_s)
    sizes = np.abs(speeds)
    rates = np.diff(sizes) / PERIOD_S
    assert max(speeds) == 0.9
    assert min(speeds) == -limits.backward_m_s
    assert rates.max() == pytest.approx(limits.acceleration_m_s2)
    assert rates.min() == pytest.approx(-limits.braking_m_s2)
    grows = (rates[1:] > 0) & (rates[:-1] >= 0)
    jerks = (np.diff(rates) / PERIOD_S)[grows]
    assert jerks.max() <= limits.jerk_m_s3 + 1e-9
    reversing = np.flatnonzero(np.diff(np.sign(speeds)) < 0)
    assert 0.0 in np.array(speeds)[reversing[0] : reversing[0] + 3]
    # Time to 0.9 m/s: v / a, and a / j more for the two ramps of acceleration.
    reached_s = PERIOD_S * int(np.argmax(np.array(speeds) >= 0.9 - 1e-9))
    assert reached_s == pytest.approx(0.9 / 0.5 + 0.5 / 2.0, abs=0.1)


def test_turns_keep_their_acceleration() -> None:
    velocity = LimitedVelocity(RobotLimits())
    turns = [velocity.towards(VelocityCommand(0.0, 3.0), PERIOD_S).turn_rad_s for _ in range(100)]
    assert turns[-1] == 1.0
    assert max(np.diff([0.0, *turns])) == pytest.approx(1.5 * PERIOD_S)


def test_limits_of_zero_let_nothing_move() -> None:
    plant = Plant(RobotLimits(forward_m_s=0, backward_m_s=0, turn_rad_s=0))
    for command in (VelocityCommand(1.0, 1.0), VelocityCommand(-1.0, -1.0)):
        assert not plant.run(command, 1.0).any()


def test_saturated_wheels_keep_the_bend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robots, "_MOST_DUTY", 0.3)
    plant = Plant(QUICK)
    speeds = plant.run(VelocityCommand(0.9, 1.5), 4.0)[-1]
    assert max(max(abs(d.left), abs(d.right)) for d in plant.duties) <= 0.3
    half_m = WHEELS.track_width_m / 2
    assert speeds[1] == pytest.approx(0.3 * FULL_M_S, abs=0.02)
    assert speeds[0] / speeds[1] == pytest.approx((0.9 - 1.5 * half_m) / (0.9 + 1.5 * half_m), abs=0.03)
    assert plant.control.reason == ""


def test_feedback_has_its_bounds_and_comes_back_from_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Motors so weak that all correction is not enough; once they are strong again, the speed is soon as reported."""
    monkeypatch.setattr(robots, "_FAULT_M_S", 2.0)
    plant = Plant(strength=0.4)
    plant.run(VelocityCommand(0.9), 4.0)
    assert plant.duties[-1].left == pytest.approx(0.9 / FULL_M_S + 0.2)
    plant.strength = 1.0
    speeds = plant.run(VelocityCommand(0.9), 4.0)
    assert speeds.max() < 0.9 + 0.2 * FULL_M_S
    assert speeds[-1] == pytest.approx(0.9, abs=0.01)


def test_silence_stops_until_somebody_lets_go() -> None:
    plant = Plant()
    ahead = VelocityCommand(0.5)
    plant.run(ahead, 2.0)
    plant.is_silent = True
    plant.run(ahead, 0.14)
    assert plant.control.reason == ""
    plant.run(ahead, 0.06)
    assert plant.control.reason == "no wheel readings come"
    assert plant.duties[-1] == Duties(reason="no wheel readings come")
    plant.run(STOP, 0.5)
    assert plant.control.reason  # the cause is not gone
    plant.is_silent = False
    plant.run(ahead, 0.5)
    assert plant.duties[-1].left == 0.0
    plant.run(STOP, 0.1)
    assert plant.control.reason == ""
    assert plant.run(ahead, 2.0)[-1] == pytest.approx(0.5, abs=0.01)


def test_nothing_moves_before_the_first_ticks() -> None:
    plant = Plant()
    plant.is_silent = True
    assert not plant.run(VelocityCommand(0.5), 0.1).any()
    plant.is_silent = False
    assert plant.run(VelocityCommand(0.5), 2.0)[-1] == pytest.approx(0.5, abs=0.01)


def test_ticks_that_stand_still_are_found() -> None:
    plant = Plant()
    plant.run(VelocityCommand(0.5), 2.0)
    frozen = plant.ways_m.copy()
    plant.seen = lambda ways_m: np.array([frozen[0], ways_m[1]])
    speeds = plant.run(VelocityCommand(0.5), 0.24)
    assert "the left wheel is blocked: command 0.50 m/s" in plant.control.reason
    assert speeds.max() < 0.5 + 0.2 * FULL_M_S


def test_wheels_that_are_swapped_or_run_away_are_found() -> None:
    backwards = Plant()
    backwards.seen = lambda ways_m: -ways_m
    backwards.run(VelocityCommand(0.6), 2.0)
    assert "wheel turns the wrong way" in backwards.control.reason or "is blocked" in backwards.control.reason
    assert np.abs(np.diff(backwards.ways_m)) < 1e-9
    assert backwards.ways_m[0] < 0.6
    pushed = Plant()
    pushed.run(VelocityCommand(0.1), 1.0)
    offset = pushed.now_s
    pushed.seen = lambda ways_m: ways_m + 0.6 * (pushed.now_s - offset)
    pushed.run(VelocityCommand(0.1), 1.0)
    assert "runs away" in pushed.control.reason


def test_after_a_stop_motors_have_no_voltage_until_the_wheels_stand() -> None:
    plant = Plant()
    plant.run(VelocityCommand(0.8), 3.0)
    plant.control.stop("it was stopped")
    while abs(plant.speeds_m_s).max() > 0.02:
        duties = plant.step(STOP)
        assert (duties.left, duties.right, duties.reason) == (0.0, 0.0, "it was stopped")
    plant.run(STOP, 0.3)
    assert plant.control.reason == ""
    assert plant.step(VelocityCommand(0.8)).reason == ""


def test_a_stopped_robot_that_rolls_down_a_slope_is_braked() -> None:
    plant = Plant()
    plant.run(VelocityCommand(0.3), 2.0)
    plant.control.stop("it was stopped")
    for _ in range(60):
        plant.speeds_m_s[:] = 0.3  # the slope keeps it rolling
        duties = plant.step(STOP)
    assert duties.reason == ""
    assert max(duties.left, duties.right) < 0


def test_after_a_pause_it_waits_for_a_stop_and_begins_from_a_stand() -> None:
    """A program that stood still does not go on by itself with the command that it had before."""
    plant = Plant()
    plant.run(VelocityCommand(0.8), 3.0)
    plant.now_s += 0.5
    plant.speeds_m_s[:] = 0.0
    duties = plant.step(VelocityCommand(0.8))
    assert (duties.left, duties.right, duties.reason) == (0.0, 0.0, "the program stood still for 0.5 s")
    plant.run(VelocityCommand(0.8), 1.0)
    assert not plant.speeds_m_s.any()
    plant.step(STOP)
    assert plant.step(VelocityCommand(0.8)).left < 0.05
    assert plant.run(VelocityCommand(0.8), 4.0)[-1] == pytest.approx(0.8, abs=0.01)


def test_equal_readings_equal_duties() -> None:
    one, other = Plant(strength=0.9), Plant(strength=0.9)
    for plant in (one, other):
        plant.run(VelocityCommand(0.7, 0.3), 2.0)
    assert one.duties == other.duties
