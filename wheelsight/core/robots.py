"""Interfaces of a robot that drives (`Robot`), the source of its pose (`Localization`), and of events (`EventSource`).

`WatchedRobot` wraps a robot. `VelocityControl` turns velocity commands into motor duties, within `RobotLimits`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.drive_model import DriveModel
from wheelsight.core.errors import WheelsightError
from wheelsight.core.estimates import Estimate
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import STOP, Event, NearbyReading, RgbdFrame, VelocityCommand, WheelTicks
from wheelsight.core.settings import CHOSEN, Settings, setting

CONTROL_PERIOD_S = 0.05
"""Duration of a step of a robot, 20 Hz; what `Navigator` assumes."""

STOPPED = "it was stopped"
"""The `stop_reason` after `stop`."""


@runtime_checkable
class Robot(Protocol):
    """A real or simulated robot that takes commands and yields events; a `with` block stops it at its end."""

    @property
    def calibration(self) -> Calibration:
        """The calibration of its sensors."""

    @property
    def stop_reason(self) -> str:
        """The reason why the robot ignores commands and stands; empty while it obeys.

        A robot that has stopped by itself stays stopped until the cause is gone and it receives STOP, so that it never
        restarts by itself.
        """

    @property
    def now_s(self) -> float:
        """The present time by the clock of the events' stamps."""

    def step(self, command: VelocityCommand) -> list[Event]:
        """Execute a command for one control period, and return the events of that period in the order of stamps.

        A robot without further steps stops by itself.
        """

    def stop(self) -> None:
        """Stop at once, without limits on deceleration, until the robot receives STOP.

        Another thread may call it during a step.
        """

    def close(self) -> None:
        """Stop, and release the device; may be called twice."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def nearby_of(robot: Robot) -> NearbyReading | None:
    """Return the last reading of a robot's bumpers and rangers, its attribute `nearby`; None for a robot without."""
    return getattr(robot, "nearby", None)


@runtime_checkable
class EventSource(Protocol):
    """Events in order of time, with the calibration of their sensors.

    A live source has no end and an unknown number of frames. A recording (`recordings.Recording`) knows both.
    """

    @property
    def name(self) -> str:
        """The name for titles and files."""

    @property
    def calibration(self) -> Calibration:
        """The calibration of the sensors."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user, one sentence each; events may add further ones."""

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """The events in order of time. Without `images` frames are left out, and none is decoded.

        `run` passes `images=False` for odometry by wheels alone, so the argument must have this name.
        docs/api/own-parts.md has an example.
        """


class Localization(Protocol):
    """Source of the robot's pose, such as `LocalizerInStep` and `LocalizerBeside`.

    It may also have `warnings`, a tuple of sentences about faults of sensors, which page, terminal and results show.
    """

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Keyframes with their poses; None for wheels alone."""

    @property
    def recognised(self) -> int | None:
        """Number of recognitions of an earlier map so far; None if there is no recognition."""

    def process(self, events: Sequence[Event]) -> Sequence[tuple[Event, Estimate | None]]:
        """Process events in order; return all estimates that are ready, of this and earlier calls, in order.

        Raises what `Localizer.process` raises.
        """

    def close(self) -> None:
        """Stop the worker threads."""


class WatchedRobot:
    """A `Robot` that reports the events of each period to listeners, and stands while it is held, whatever the command.

    Args:
        robot: the robot.
        held_by: returns why it must stand; "" if it may move.

    Attributes:
        frame: last frame of its camera; None before any.
        is_commanded: whether the last command that it passed on is a motion.
        command, command_s: that command, and when it was passed on by the robot's clock.
        listeners: called with the events of each period.
    """

    def __init__(self, robot: Robot, held_by: Callable[[], str] = lambda: "") -> None:
        self._robot, self._held_by = robot, held_by
        self.listeners: list[Callable[[Sequence[Event]], None]] = []
        self.frame: RgbdFrame | None = None
        self.is_commanded = False
        self.command, self.command_s = STOP, -math.inf

    @contextmanager
    def watched_by(self, *listeners: Callable[[Sequence[Event]], None]) -> Iterator[None]:
        """Call listeners with the events of each period within the block."""
        self.listeners += listeners
        try:
            yield
        finally:
            for listener in listeners:
                self.listeners.remove(listener)

    @property
    def calibration(self) -> Calibration:
        """See `Robot`."""
        return self._robot.calibration

    @property
    def nearby(self) -> NearbyReading | None:
        """The last reading of bumpers and rangers of a robot that has them; None else."""
        return nearby_of(self._robot)

    @property
    def stop_reason(self) -> str:
        """See `Robot`."""
        return self._held_by() or self._robot.stop_reason

    @property
    def now_s(self) -> float:
        """See `Robot`."""
        return self._robot.now_s

    def step(self, command: VelocityCommand) -> list[Event]:
        """See `Robot`."""
        obeyed = STOP if self._held_by() else command
        self.is_commanded = obeyed != STOP
        self.command, self.command_s = obeyed, self._robot.now_s
        events = self._robot.step(obeyed)
        self.frame = next((event for event in reversed(events) if isinstance(event, RgbdFrame)), self.frame)
        for listener in self.listeners:
            listener(events)
        return events

    def stop(self) -> None:
        """See `Robot`."""
        self._robot.stop()

    def close(self) -> None:
        """See `Robot`."""
        self._robot.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(WheelsightError):
            self.close()


class RobotLimits(Settings):
    """Limits on every command; a limit of zero disables that motion."""

    forward_m_s: float = setting(1.0, "fastest forward; a person walks at 1.4 m/s", CHOSEN, ge=0, le=3)
    backward_m_s: float = setting(0.2, "fastest backward, where no camera looks", CHOSEN, ge=0, le=1)
    turn_rad_s: float = setting(1.0, "fastest turn; a camera blurs beyond", CHOSEN, ge=0, le=4)
    acceleration_m_s2: float = setting(0.5, "at which speed grows; a rider bears as much", CHOSEN, gt=0, le=3)
    braking_m_s2: float = setting(
        1.0, "at which speed falls, in a stop too; much more throws a rider forward", CHOSEN, gt=0, le=5
    )
    turn_acceleration_rad_s2: float = setting(1.5, "at which turns change", CHOSEN, gt=0, le=10)
    jerk_m_s3: float = setting(2.0, "at which acceleration changes, but for stops", CHOSEN, gt=0, le=50)


class WheelControlSettings(Settings):
    """Motors of a robot, for the control of its wheels' speed."""

    full_speed_m_s: float = setting(
        2.6,
        "of a rim at a duty of 1; only feedback corrects an error of it",
        "Trinh et al., II.C: 157 pulses of 0.33 mm in 20 ms at top speed",
        gt=0.05,
        le=20,
    )
    dead_duty: float = setting(
        0.0, "duty at which wheels begin to turn, added to what a speed takes", CHOSEN, ge=0, le=0.5
    )


# Window in which pulses are counted: one of 0.33 mm more or less is 6 mm/s, and the speed is known half of it late.
_SPEED_WINDOW_S = 0.06
# Time constant with which a wheel answers and its speed is known; feedback compares with what should be by now.
# Computed from the simulator's motors, 0.1 s, and half of the window; no real motor was measured.
_ANSWER_S = 0.13
# Duty for an error of full speed, and duty a second for it. On the simulator, from 0.1 to 2 a ramp to 0.8 m/s ends 4.4
# % to 2.6 % too high at worst, with motors 15 % weaker or stronger that lag by 0.05 to 0.2 s. With 1 in place of 3 a
# second, weak motors reach 95 % of that speed half a second later.
_PROPORTIONAL, _INTEGRAL_PER_S = 1.0, 3.0
# Duty that feedback may add or take, by which a robot with an encoder that lies is too fast; and the largest duty.
_MOST_CORRECTION, _MOST_DUTY = 0.2, 1.0
# Speed of a rim below which a wheel stands.
_RIM_STANDS_M_S = 0.01
# Time without ticks after which the robot stops: seven readings of 20 ms, 15 cm at 1 m/s.
TICKS_SILENT_S = 0.15
# Time for which motors keep a duty without a new one, less than the firmware's 0.25; then they stand until STOP: 20 cm
# at 1 m/s.
HOLD_S = 0.2
# Difference of a rim's speed from the command at which it counts as blocked, running away, or wrongly wired (by chance
# it is 0.04 m/s on the simulator: floor4, real, five seeds, 37 s); and the time of it after which the robot stops, in
# proportion less where it is more, so that a wheel is off by 6 cm.
_FAULT_M_S, _FAULT_S = 0.15, 0.4
# After a stop the motors have no voltage until the wheels stand. A robot that rolls longer than this, down a slope, is
# braked by its motors again.
_ROLLS_S = 1.0
# Time for which the speed must stay below `_RIM_STANDS_M_S`; between single pulses it does so for less.
_STOOD_S = 0.1


@dataclass(frozen=True, slots=True)
class Duties:
    """Duties of both motors, -1 (full speed back) to 1; zeros and a reason if they must stop."""

    left: float = 0.0
    right: float = 0.0
    reason: str = ""


class LimitedVelocity:
    """Follows commands within the limits of a robot.

    Speed grows with limited jerk and acceleration, and falls with limited braking; angular speed changes with limited
    acceleration. A reversal passes through a standstill.
    """

    def __init__(self, limits: RobotLimits) -> None:
        self._limits = limits
        self._acceleration_m_s2 = 0.0
        self.now = STOP

    def reset(self) -> None:
        """Reset to a standstill, as after a stop without limits."""
        self.now, self._acceleration_m_s2 = STOP, 0.0

    def towards(self, command: VelocityCommand, seconds: float) -> VelocityCommand:
        """The velocity after the next `seconds`."""
        limits = self._limits
        wanted_m_s = min(max(command.forward_m_s, -limits.backward_m_s), limits.forward_m_s)
        wanted_rad_s = min(max(command.turn_rad_s, -limits.turn_rad_s), limits.turn_rad_s)
        turn_step = limits.turn_acceleration_rad_s2 * seconds
        turn_rad_s = self.now.turn_rad_s + min(max(wanted_rad_s - self.now.turn_rad_s, -turn_step), turn_step)
        self.now = VelocityCommand(self._forward(wanted_m_s, seconds), turn_rad_s)
        return self.now

    def _forward(self, wanted_m_s: float, seconds: float) -> float:
        limits, now_m_s = self._limits, self.now.forward_m_s
        if now_m_s * wanted_m_s < 0:
            wanted_m_s = 0.0
        left_m_s = abs(wanted_m_s) - abs(now_m_s)
        if left_m_s <= 0:
            self._acceleration_m_s2 = 0.0
            size_m_s = max(abs(wanted_m_s), abs(now_m_s) - limits.braking_m_s2 * seconds)
            return math.copysign(size_m_s, now_m_s)
        grown = self._acceleration_m_s2 + limits.jerk_m_s3 * seconds
        # The acceleration from which limited jerk reaches zero just at the wanted speed.
        ending = math.sqrt(2 * limits.jerk_m_s3 * left_m_s)
        self._acceleration_m_s2 = min(grown, limits.acceleration_m_s2, ending)
        size_m_s = min(abs(now_m_s) + self._acceleration_m_s2 * seconds, abs(wanted_m_s))
        return math.copysign(size_m_s, wanted_m_s)


class VelocityControl:
    """Converts commands and ticks into motor duties; call `update` with each wheel reading, and if one is missing.

    The duty of a wheel is a feed-forward term plus a proportional and an integral term of its speed error. If a wheel
    does not follow, the duties are zero with a reason, until the cause is gone and the command is STOP.

    Args:
        wheels: calibrated wheels.
        limits: limits on commands.
        settings: of the control loop.
        drive: the measured response of the robot, by which wheels are expected to follow; None for quick motors.
    """

    def __init__(
        self,
        wheels: Wheels,
        limits: RobotLimits | None = None,
        settings: WheelControlSettings | None = None,
        drive: DriveModel | None = None,
    ) -> None:
        self._settings = settings or WheelControlSettings()
        self._half_track_m = wheels.track_width_m / 2
        self._velocity = LimitedVelocity(limits or RobotLimits())
        m_per_tick = wheels.left_m_per_tick, wheels.right_m_per_tick
        self._loops = [
            _WheelLoop(name, m, self._settings, drive) for name, m in zip(("left", "right"), m_per_tick, strict=True)
        ]
        self._last_s: float | None = None
        self._last_ticks_s: float | None = None
        self._has_ticks = self._is_driven = False
        self._stopped_s: float | None = None
        self._rolled_s = -math.inf
        self.reason = ""

    @property
    def velocity(self) -> VelocityCommand:
        """The present velocity command after limits."""
        return self._velocity.now

    def stop(self, reason: str = "") -> None:
        """Reset to a standstill; with a reason, stay there until the command is STOP.

        Another thread than that of `update` may call it.
        """
        self.reason = reason or self.reason
        self._stopped_s = None
        self._velocity.reset()
        for loop in self._loops:
            loop.rest()

    def update(self, now_s: float, ticks: WheelTicks | None, command: VelocityCommand) -> Duties:
        """The duties until the next update.

        Args:
            now_s: by any clock with the rate of the ticks' stamps.
            ticks: a new reading, or None.
            command: the velocity command.
        """
        since_s = 0.0 if self._last_s is None else max(now_s - self._last_s, 0.0)
        self._last_s = now_s
        if since_s > HOLD_S:
            # The link has stopped the motors meanwhile; a command before the gap does not count after it.
            self.stop(f"the program stood still for {since_s:.1f} s" if self._is_driven else "")
            for loop in self._loops:
                loop.forget()
            since_s = 0.0
        self._last_ticks_s = now_s if ticks is not None or self._last_ticks_s is None else self._last_ticks_s
        if ticks is not None:
            self._has_ticks = True
            for loop, count in zip(self._loops, (ticks.left, ticks.right), strict=True):
                loop.count(ticks.stamp_s, count)
        if now_s - self._last_ticks_s > TICKS_SILENT_S:
            self.stop(self.reason or "no wheel readings come")
        else:
            self._stopped_s = now_s if self._stopped_s is None else self._stopped_s
            if any(abs(loop.speed_m_s) >= _RIM_STANDS_M_S for loop in self._loops):
                self._rolled_s = now_s
            # The wheels stand, or still roll after a long time without voltage.
            has_stood = now_s - self._rolled_s > _STOOD_S or now_s - self._stopped_s > _ROLLS_S
            if has_stood and command.is_stop:
                self.reason = ""
        self._is_driven = False
        if self.reason or not self._has_ticks:
            return Duties(reason=self.reason)
        duties = self._duties(command, since_s)
        self._is_driven = duties.left != 0 or duties.right != 0
        return duties

    def _duties(self, command: VelocityCommand, since_s: float) -> Duties:
        velocity = self._velocity.towards(command, since_s)
        across_m_s = velocity.turn_rad_s * self._half_track_m
        rims_m_s = velocity.forward_m_s - across_m_s, velocity.forward_m_s + across_m_s
        # If one wheel saturates, both are slowed by the same factor, so that the robot keeps its path.
        share = min(1.0, _MOST_DUTY * self._settings.full_speed_m_s / max(*map(abs, rims_m_s), 1e-9))
        left, right = (loop.duty(share * rim_m_s, since_s) for loop, rim_m_s in zip(self._loops, rims_m_s, strict=True))
        for loop in self._loops:
            if loop.reason:
                self.stop(loop.reason)
                return Duties(reason=self.reason)
        return Duties(left, right)


class _WheelLoop:
    """The control loop of one wheel: its speed by its encoder, and its duty."""

    def __init__(self, name: str, m_per_tick: float, settings: WheelControlSettings, drive: DriveModel | None) -> None:
        self._name, self._m_per_tick, self._settings = name, m_per_tick, settings
        self._axis = None if drive is None else drive.straight or drive.turn
        self._wanted, self._clock_s = deque[tuple[float, float]](), 0.0
        self._counts: deque[tuple[float, int]] = deque()
        self.rest()

    def rest(self) -> None:
        self._sum = self._fault_s = self._expected_m_s = 0.0
        self._wanted.clear()
        self.reason = ""

    def forget(self) -> None:
        """Drop the readings so far, because a mean speed over a gap is not the present speed."""
        self._counts.clear()

    def count(self, stamp_s: float, count: int) -> None:
        if self._counts and stamp_s <= self._counts[-1][0]:
            return
        self._counts.append((stamp_s, count))
        while len(self._counts) > 2 and stamp_s - self._counts[1][0] >= _SPEED_WINDOW_S - 1e-6:
            self._counts.popleft()

    @property
    def speed_m_s(self) -> float:
        if len(self._counts) < 2:
            return 0.0
        (begin_s, begin), (end_s, end) = self._counts[0], self._counts[-1]
        return self._m_per_tick * (end - begin) / (end_s - begin_s)

    def duty(self, wanted_m_s: float, since_s: float) -> float:
        """The duty from -1 to 1; sets `reason` if the wheel has not followed for too long."""
        full_m_s, speed_m_s = self._settings.full_speed_m_s, self.speed_m_s
        self._expect(wanted_m_s, since_s)
        fault, expected_m_s = "", self._expected_m_s
        if expected_m_s * speed_m_s < 0 and abs(speed_m_s) > _FAULT_M_S:
            fault = "turns the wrong way"
        elif abs(speed_m_s) > abs(expected_m_s) + _FAULT_M_S:
            fault = "runs away"
        elif abs(expected_m_s) > 2 * _RIM_STANDS_M_S:
            # A slow wheel cannot be slower by that much; it must turn at all.
            is_blocked = abs(speed_m_s) < abs(expected_m_s) - min(_FAULT_M_S, 0.8 * abs(expected_m_s))
            fault = "is blocked" if is_blocked else ""
        # A dead encoder shows a large error at once: the larger the error, the shorter the time to the fault.
        weight = max(abs(self._expected_m_s - speed_m_s) / _FAULT_M_S, 1.0)
        self._fault_s = self._fault_s + weight * since_s if fault else 0.0
        if self._fault_s > _FAULT_S:
            self.reason = f"the {self._name} wheel {fault}: command {wanted_m_s:.2f} m/s, encoder {speed_m_s:.2f}"
        if wanted_m_s == 0 and abs(speed_m_s) < _RIM_STANDS_M_S:
            self._sum = self._expected_m_s = 0.0
            return 0.0
        error = (self._expected_m_s - speed_m_s) / full_m_s
        most = _MOST_CORRECTION
        self._sum = min(max(self._sum + _INTEGRAL_PER_S * error * since_s, -most), most)
        correction = min(max(_PROPORTIONAL * error + self._sum, -most), most)
        known = wanted_m_s / full_m_s
        known += math.copysign(self._settings.dead_duty, wanted_m_s) if wanted_m_s else 0.0
        return min(max(known + correction, -_MOST_DUTY), _MOST_DUTY)

    def _expect(self, wanted_m_s: float, since_s: float) -> None:
        """Update the speed that the encoder should show by now."""
        if self._axis is None:
            self._expected_m_s += (1 - math.exp(-since_s / _ANSWER_S)) * (wanted_m_s - self._expected_m_s)
            return
        self._clock_s += since_s
        self._wanted.append((self._clock_s, wanted_m_s))
        acts_s = self._clock_s - self._axis.dead_time_s - _SPEED_WINDOW_S / 2
        while len(self._wanted) > 1 and self._wanted[1][0] <= acts_s:
            self._wanted.popleft()
        towards_m_s = self._wanted[0][1] if self._wanted[0][0] <= acts_s else 0.0
        self._expected_m_s = self._axis.after(self._expected_m_s, towards_m_s, since_s)
