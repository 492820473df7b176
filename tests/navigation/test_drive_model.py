"""What a measured drive changes: the collision monitor, the wheel check, and the lag of the controllers."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from navigation.unicycle import CHAIR, Camera, clearance_m

from wheelsight.core.drive_model import DriveAxis, DriveModel
from wheelsight.core.estimates import Status
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.core.robots import LimitedVelocity
from wheelsight.navigation import RobotLimits
from wheelsight.navigation.collision_monitor import (
    CollisionMonitor,
    MonitorReason,
    MonitorState,
    PendingMotion,
    VelocityRamp,
    WheelCheck,
)
from wheelsight.navigation.settings import FollowSettings, MonitorSettings

# As `wheelsight calibrate drive` finds it on the shared log of a real chair.
STRAIGHT = DriveAxis(dead_time_s=0.27, rise_s=0.43, fall_s=0.45, dead_time_sigma_s=0.04, stop_sigma_s=0.04)
TURN = DriveAxis(dead_time_s=0.2, rise_s=0.1, fall_s=0.11, dead_time_sigma_s=0.05, stop_sigma_s=0.04)
REAL = DriveModel("velocity", STRAIGHT, TURN)
ALL_AROUND = Camera(0.0, np.pi, 0.0, 5.0)
SETTINGS = MonitorSettings(slow_zone_m=0.0)


class HeavyChair:
    """A chair that ramps its commands, and answers after a dead time with a lag, by steps of 5 ms."""

    def __init__(self, model: DriveModel, limits: RobotLimits | None = None) -> None:
        self.pose = np.zeros(3)
        self.speeds = [0.0, 0.0]
        self._model, self._ramp = model, LimitedVelocity(limits or RobotLimits())
        self._sent: deque[tuple[float, float]] = deque()

    def step(self, command: VelocityCommand, period_s: float = 0.05) -> None:
        straight, turn = self._model.straight, self._model.turn
        assert straight is not None
        assert turn is not None
        for _ in range(round(period_s / 0.005)):
            now = self._ramp.towards(command, 0.005)
            self._sent.append((now.forward_m_s, now.turn_rad_s))
            while len(self._sent) > 200:
                self._sent.popleft()
            for index, axis in enumerate((straight, turn)):
                late = round(axis.dead_time_s / 0.005) + 1
                towards = self._sent[-late][index] if len(self._sent) >= late else 0.0
                self.speeds[index] = axis.after(self.speeds[index], towards, 0.005)
            yaw = self.pose[2] + self.speeds[1] * 0.0025
            way = self.speeds[0] * 0.005
            self.pose = self.pose + [way * np.cos(yaw), way * np.sin(yaw), self.speeds[1] * 0.005]


def wall(away_m: float) -> np.ndarray:
    along = np.arange(-4.0, 4.0, 0.03)
    return np.stack([np.full_like(along, away_m), along], axis=-1)


def driven_at(points: np.ndarray, model: DriveModel | None, chair: DriveModel, asked: VelocityCommand) -> float:
    """Least clearance of a chair that is driven at points for 8 s with a monitor of a model."""
    base, monitor, least_m = HeavyChair(chair), CollisionMonitor(CHAIR, settings=SETTINGS, drive=model), np.inf
    ramp = VelocityRamp()
    for period in range(160):
        now_s = 0.05 * period
        monitor.add_reading(now_s, base.speeds[0], base.speeds[1])
        if period % 2 == 0:
            monitor.add_view(ALL_AROUND.view(points, base.pose, now_s))
        ramped = ramp.step(asked.forward_m_s, asked.turn_rad_s, 0.05)
        result = monitor.check(ramped, now_s, Status.TRACKING)
        if result.state is not MonitorState.FREE:
            ramp.follow(result.command)
        assert model is None or result.reason is not MonitorReason.WHEELS_OFF
        base.step(result.command)
        if period % 3 == 0:
            least_m = min(least_m, clearance_m(CHAIR, base.pose, points))
    return float(least_m)


def test_a_chair_as_it_is_stops_before_a_wall_only_with_its_model():
    """The stop that suits a lag of 0.1 s is too late for a real chair."""
    ahead = VelocityCommand(1.0, 0.0)
    assert driven_at(wall(3.0), None, REAL, ahead) < SETTINGS.margin_m
    # It stands near the wall: the way of the model, not a timid one.
    assert SETTINGS.margin_m <= driven_at(wall(3.0), REAL, REAL, ahead) < 0.25


@pytest.mark.slow
def test_it_stops_in_time_for_a_chair_that_is_as_slow_as_95_of_100():
    slow = replace(REAL, straight=replace(STRAIGHT, fall_s=STRAIGHT.fall_s + 1.6 * STRAIGHT.stop_sigma_s))
    assert driven_at(wall(4.0), REAL, slow, VelocityCommand(1.0, 0.0)) >= SETTINGS.margin_m


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0.4, -0.8])
def test_it_stops_on_arcs(turn):
    assert driven_at(wall(2.5), REAL, REAL, VelocityCommand(0.8, turn)) >= SETTINGS.margin_m - 0.02


@given(speed=st.floats(0.1, 1.0), turn=st.floats(-0.8, 0.8))
def test_what_is_pending_is_what_a_chair_still_goes(speed, turn):
    """After two seconds of a command and then none: the way of a chair of the same model, which has no σ here."""
    exact = DriveModel("velocity", replace(STRAIGHT, stop_sigma_s=0.0), replace(TURN, stop_sigma_s=0.0))
    base, pending = HeavyChair(exact), PendingMotion(RobotLimits(), exact)
    for period in range(80):
        # In the last 0.6 s it is led to stand, so that a part of the ramp is on its way, too.
        command = VelocityCommand(speed, turn) if period < 68 else STOP
        pending.record(command, 0.05 * period)
        base.step(command)
    pending.update((base.speeds[0], base.speeds[1]), 4.0)
    ramp = pending.velocity
    expected_m = pending.way_m + ramp[0] ** 2 / 2  # it slows down by 1 m/s²
    expected_rad = pending.turned_rad + np.sign(ramp[1]) * ramp[1] ** 2 / (2 * RobotLimits().turn_acceleration_rad_s2)
    gone_m = gone_rad = 0.0
    for _ in range(1200):
        base.step(STOP, 0.005)
        gone_m += 0.005 * base.speeds[0]
        gone_rad += 0.005 * base.speeds[1]
    assert gone_m == pytest.approx(expected_m, abs=0.03)
    assert gone_rad == pytest.approx(expected_rad, abs=0.03)


def test_a_turn_in_place_takes_the_turns_of_the_model():
    assert REAL.stop_s(straight=False, turn=True, sigmas=0.0) == pytest.approx(0.31)
    assert REAL.stop_s(straight=True, turn=True, sigmas=0.0) == pytest.approx(0.72)
    # Not driven: the other kind is what is known.
    assert replace(REAL, turn=None).stop_s(straight=False, turn=True, sigmas=0.0) == pytest.approx(0.72)


def test_the_wheel_check_bears_with_a_slow_chair_and_still_sees_a_blocked_one():
    for is_blocked in (False, True):
        base, check, ramp, found = HeavyChair(REAL), WheelCheck(RobotLimits(), REAL), VelocityRamp(), False
        for period in range(240):
            asked = [VelocityCommand(0.9, 0.0), VelocityCommand(0.2, 0.6), STOP][period // 80]
            command = ramp.step(asked.forward_m_s, asked.turn_rad_s, 0.05)
            speeds = [0.0, 0.0] if is_blocked and period < 80 else base.speeds
            found |= check.is_off(speeds[0], speeds[1], 0.05 * period)
            check.record(command, 0.05 * period)
            base.step(command)
        assert found is is_blocked


def test_controllers_take_the_lag_of_the_drive():
    usual = FollowSettings()
    assert usual.of_drive(None) is usual
    assert usual.of_drive(REAL).lag_s == pytest.approx(0.72)
    quick = DriveModel("velocity", DriveAxis(0.0, 0.05, 0.05))
    assert usual.of_drive(quick).lag_s == usual.lag_s
