"""`LinkRobot` drives a robot through a wheel controller's serial line. It controls wheel speeds through duty cycles."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Protocol

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, DeviceError
from wheelsight.core.messages import Event, NearbyReading, RgbdFrame, SkippedFrame, VelocityCommand, WheelTicks
from wheelsight.core.robots import (
    CONTROL_PERIOD_S,
    HOLD_S,
    STOPPED,
    TICKS_SILENT_S,
    RobotLimits,
    VelocityControl,
    WheelControlSettings,
)
from wheelsight.core.threads import Closing
from wheelsight.io.devices.live_camera import take_angular_velocities
from wheelsight.io.devices.wheel_link import WheelLink
from wheelsight.io.devices.wire_formats import Format

# The first firmware that stops the motors 0.25 s after the last command. The one before waits for half a second, in
# which a robot at 1 m/s moves 0.5 m without control (docs/decisions/monitor-and-safety).
OLDEST_FIRMWARE = (1, 1)
_NOW_S = 1e-9  # rounding of simulated time


class Frames(Protocol):
    """A camera that is polled for frames."""

    def take(self) -> Sequence[RgbdFrame | SkippedFrame]:
        """Frames since the last call, in order, stamped by the link's clock. Does not wait."""

    def close(self) -> None:
        """Release the camera; may be called twice."""


class LinkRobot(Closing):
    """A `Robot` with closed-loop control of each wheel's speed, from the encoders' ticks.

    It sends nothing before the first command to move. It stops the motors, with the reason in `stop_reason`, where
    ticks are missing or old, a wheel does not follow its command, the port vanishes, or the controller restarts. Where
    `step` is no longer called, the link stops the motors after `HOLD_S` (core.robots). Where the program is dead, the
    firmware stops them after a quarter of a second. Older firmware takes longer and is refused: its version is read
    before the first command to move.

    Args:
        link: to the wheel controller; closed with the robot.
        calibration: with two wheels.
        frames: the camera, closed with the robot, or None. Readings of its gyroscope (`HasGyro`) become `YawRate` where
            the calibration has T_base_camera.
        control: of the wheels' loop.

    Raises:
        ArgumentError: the calibration has no two wheels.
    """

    def __init__(
        self,
        link: WheelLink,
        calibration: Calibration,
        limits: RobotLimits | None = None,
        *,
        frames: Frames | None = None,
        control: WheelControlSettings | None = None,
        period_s: float = CONTROL_PERIOD_S,
    ) -> None:
        if calibration.wheels is None:
            fix = "a robot with two driven wheels, calibrated: docs/wheel-calibration.md"
            raise ArgumentError(f"the calibration {calibration.lacks_two_wheels}", fix=fix)
        self._link, self._frames, self.calibration, self._period_s = link, frames, calibration, period_s
        self._control = VelocityControl(calibration.wheels.never_rolling_over, limits, control, calibration.drive_model)
        self._restarts = link.report().restarts
        self._quickest_s: float | None = None
        self._has_driven = self._is_closed = False
        self._stepping = threading.Lock()

    @property
    def now_s(self) -> float:
        """See `Robot`; before the first ticks the host's time, without the delay of the line."""
        host = self._link.host
        return host.now_s() + (host.unix_offset_s() if self._quickest_s is None else -self._quickest_s)

    @property
    def nearby(self) -> NearbyReading | None:
        """The newest reading of the controller's bumpers and rangers."""
        return self._link.nearby

    @property
    def stop_reason(self) -> str:
        """See `Robot`."""
        return self._control.reason

    def check_firmware(self) -> None:
        """Check the version of the controller's firmware, except in the paper's format, which cannot give it.

        Raises:
            DeviceError: the firmware is too old to stop the motors in time, does not answer, or takes no commands.
        """
        if self._link.report().format is Format.PAPER:
            return
        version = self._link.ask_version()
        if (version.major, version.minor) >= OLDEST_FIRMWARE:
            return
        found = f"{version.major}.{version.minor}, older than {OLDEST_FIRMWARE[0]}.{OLDEST_FIRMWARE[1]}"
        raise DeviceError(
            f"the controller's firmware is {found}: it stops the motors too late",
            path=self._link.port,
            fix="write the new one: make -C firmware/atmega8 flash, docs/firmware.md",
        )

    def step(self, command: VelocityCommand) -> list[Event]:
        """Execute a command for one control period. Returns the events of this time, in order of stamps.

        A frame may be older than ticks of an earlier step: cameras deliver later than wheels.

        Raises DeviceError where the robot is closed, or another thread steps it at this moment; then it stops.
        """
        if self._is_closed:
            raise DeviceError("the robot is closed", path=self._link.port)
        if not self._stepping.acquire(blocking=False):
            self._control.stop("two programs drive it at once")
            raise DeviceError("another program drives the robot", path=self._link.port, fix="let one drive")
        try:
            now_s = self._link.host.now_s
            ends_s = now_s() + self._period_s
            events: list[Event] = []
            while (backlog := self._link.read(0)) is not None:
                events.append(backlog)
            restarts = self._link.report().restarts
            if restarts != self._restarts:
                self._restarts = restarts
                self._control.stop("the wheel controller restarted")
            self._obey(events[-1] if events and isinstance(events[-1], WheelTicks) else None, command)
            while (left_s := ends_s - now_s()) > _NOW_S:
                ticks = self._link.read(left_s)
                self._obey(ticks, command)
                events += [] if ticks is None else [ticks]
                if ticks is None and (left_s := ends_s - now_s()) > _NOW_S:
                    time.sleep(left_s)  # a closed link returns at once
        finally:
            self._stepping.release()
        events += [] if self._frames is None else self._frames.take()
        turns, mount = take_angular_velocities(self._frames), self.calibration.T_base_camera
        events += [] if mount is None else [turn.yaw_rate(mount) for turn in turns]
        return sorted(events, key=lambda event: event.stamp_s)

    def stop(self) -> None:
        """Stop both motors at once.

        Raises:
            DeviceError: the port is gone, or the controller does not confirm; its firmware then stops the motors.
        """
        self._control.stop(STOPPED)
        if self._has_driven:
            self._link.stop()

    def close(self) -> None:
        """Stop, and close link and camera; may be called twice."""
        if self._is_closed:
            return
        self._is_closed = True
        try:
            with suppress(DeviceError):
                self.stop()
        finally:
            self._link.close()
            if self._frames is not None:
                self._frames.close()

    def _obey(self, ticks: WheelTicks | None, command: VelocityCommand) -> None:
        """Update the wheels' loop and send its duties. Ticks that came late are ignored."""
        now_s = self._link.host.now_s()
        if ticks is not None:
            after_s = now_s - ticks.stamp_s
            self._quickest_s = after_s if self._quickest_s is None else min(self._quickest_s, after_s)
            if after_s - self._quickest_s > TICKS_SILENT_S:
                ticks = None
        duties = self._control.update(now_s, ticks, command)
        if not self._has_driven and duties.left == duties.right == 0:
            return
        try:
            if not self._has_driven:
                self.check_firmware()
        except DeviceError as error:
            self._control.stop(f"{error.problem} ({error.fix})" if error.fix else error.problem)
            return
        self._has_driven = True
        try:
            self._link.drive(duties.left, duties.right, HOLD_S)
        except DeviceError as error:
            self._control.stop(error.problem)
