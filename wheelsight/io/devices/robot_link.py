"""LinkRobot: a robot on a wheel controller's serial line, whose motors take a voltage and know no speed."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType
from typing import Protocol

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, DeviceError
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, VelocityCommand, WheelTicks, YawRate
from wheelsight.core.robots import STOPPED, RobotLimits, VelocityControl, WheelControlSettings
from wheelsight.io.devices.live_camera import take_angular_velocities
from wheelsight.io.devices.wheel_link import WheelLink
from wheelsight.io.devices.wire_formats import Format

PERIOD_S = 0.05
# The first program that stops its motors 0.25 s after the last command; the one before waited for half a second, in
# which a robot at 1 m/s goes on blind for 0.5 m (docs/decisions/0074).
OLDEST_FIRMWARE = (1, 1)


class Frames(Protocol):
    """A camera that is asked what it has."""

    def take(self) -> Sequence[RgbdFrame | SkippedFrame]:
        """Frames that came since the last call, in order, stamped by the link's clock; waits for none."""

    def close(self) -> None:
        """Give the camera back; may be called twice."""


class LinkRobot:
    """A `Robot`: commands become duties by a loop on each wheel's speed, closed over the encoders' ticks.

    It only listens until it is first commanded to move. It stops by itself, and says why in `stop_reason`, where ticks
    stay away or are old, a wheel does not do what it was told, the port vanishes, or the controller begins anew. Where
    `step` is no longer called, the link stops the motors after `control.hold_s`; where the program is dead, the
    firmware does after a quarter of a second. A controller with an older firmware, which waits longer, is not driven:
    it is asked before the first command to move.

    Args:
        link: to the wheel controller; closed with the robot.
        calibration: with wheels.
        limits: which commands are held to.
        frames: the camera, closed with the robot; None for none. Where it has a gyroscope (`HasGyro`), and the
            calibration a T_base_camera, what that tells comes as `YawRate`.
        control: of the wheels' loop.
        period_s: of a step.

    Raises:
        ArgumentError: a calibration without wheels.
    """

    def __init__(
        self,
        link: WheelLink,
        calibration: Calibration,
        limits: RobotLimits | None = None,
        *,
        frames: Frames | None = None,
        control: WheelControlSettings | None = None,
        period_s: float = PERIOD_S,
    ) -> None:
        if calibration.wheels is None:
            fix = "a robot with two driven wheels, calibrated: docs/wheel-calibration.md"
            raise ArgumentError(f"the calibration {calibration.lacks_two_wheels}", fix=fix)
        self._link, self._frames, self._calibration, self._period_s = link, frames, calibration, period_s
        self._control = VelocityControl(calibration.wheels.never_rolling_over, limits, control)
        self._restarts = link.report().restarts
        self._quickest_s: float | None = None
        self._has_driven = self._is_closed = False
        self._stepping = threading.Lock()

    @property
    def calibration(self) -> Calibration:
        """As it was given."""
        return self._calibration

    @property
    def now_s(self) -> float:
        """As `Robot` has it; before the first ticks the host's time, of which stamps are late by the line's delay."""
        after_s = self._quickest_s
        return time.time() if after_s is None else time.monotonic() - after_s

    @property
    def stop_reason(self) -> str:
        """As `Robot` has it."""
        return self._control.reason

    def check_firmware(self) -> None:
        """Ask the controller for its version; in the paper's format nobody can, and nothing is asked.

        Raises:
            DeviceError: its firmware is too old to stop the motors in time, with what to do; no answer came; or it
                takes no commands.
        """
        if self._link.report().format is Format.PAPER:
            return
        version = self._link.ask_version()
        if (version.major, version.minor) >= OLDEST_FIRMWARE:
            return
        told = f"{version.major}.{version.minor}, older than {OLDEST_FIRMWARE[0]}.{OLDEST_FIRMWARE[1]}"
        raise DeviceError(
            f"the controller's firmware is {told}: it stops the motors too late",
            path=self._link.port,
            fix="write the new one: make -C firmware/atmega8 flash, docs/firmware.md",
        )

    def step(self, command: VelocityCommand) -> list[Event]:
        """Obey for one control period; what came meanwhile, by stamps.

        A frame may be stamped before ticks that an earlier step has answered: cameras deliver later than wheels.

        Raises:
            DeviceError: the robot is closed, or is stepped by somebody else at this moment; then it stops.
        """
        if self._is_closed:
            raise DeviceError("the robot is closed", path=self._link.port)
        if not self._stepping.acquire(blocking=False):
            self._control.stop("two programs drive it at once")
            raise DeviceError("the robot is driven by somebody else", path=self._link.port, fix="let one drive")
        try:
            return self._step(command)
        finally:
            self._stepping.release()

    def _step(self, command: VelocityCommand) -> list[Event]:
        ends_s = time.monotonic() + self._period_s
        events: list[Event] = [*self._backlog()]
        self._watch_controller()
        self._obey(events[-1] if events and isinstance(events[-1], WheelTicks) else None, command)
        while (left_s := ends_s - time.monotonic()) > 0:
            ticks = self._link.read(left_s)
            self._obey(ticks, command)
            events += [] if ticks is None else [ticks]
            if ticks is None and (left_s := ends_s - time.monotonic()) > 0:
                time.sleep(left_s)  # the link is closed, and waits no more
        events += [] if self._frames is None else self._frames.take()
        events += self._yaw_rates()
        return sorted(events, key=lambda event: event.stamp_s)

    def _yaw_rates(self) -> list[YawRate]:
        """What the camera's gyroscope told; nothing where it is not known how the camera sits."""
        turns, mount = take_angular_velocities(self._frames), self._calibration.T_base_camera
        return [] if mount is None else [turn.yaw_rate(mount) for turn in turns]

    def stop(self) -> None:
        """Stop both motors at once.

        Raises:
            DeviceError: the port is gone, or the controller does not confirm; then it stops by itself.
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

    def __enter__(self) -> LinkRobot:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _backlog(self) -> list[WheelTicks]:
        """What has come since the last step."""
        found = []
        while (ticks := self._link.read(0)) is not None:
            found.append(ticks)
        return found

    def _watch_controller(self) -> None:
        restarts = self._link.report().restarts
        if restarts != self._restarts:
            self._restarts = restarts
            self._control.stop("the wheel controller began anew")

    def _obey(self, ticks: WheelTicks | None, command: VelocityCommand) -> None:
        now_s = time.monotonic()
        if ticks is not None and self._age_s(ticks, now_s) > self._control.settings.silence_s:
            ticks = None
        duties = self._control.update(now_s, ticks, command)
        if not self._has_driven and duties.left == duties.right == 0:
            return
        if not (self._has_driven or self._is_firmware_good()):
            return
        self._has_driven = True
        try:
            self._link.drive(duties.left, duties.right, self._control.settings.hold_s)
        except DeviceError as error:
            self._control.stop(error.problem)

    def _is_firmware_good(self) -> bool:
        """Whether it may be driven; the reason to stop says what to do where not. The robot stands meanwhile."""
        try:
            self.check_firmware()
        except DeviceError as error:
            self._control.stop(f"{error.problem} ({error.fix})" if error.fix else error.problem)
            return False
        return True

    def _age_s(self, ticks: WheelTicks, now_s: float) -> float:
        """How much later than the quickest ones they came."""
        after_s = now_s - ticks.stamp_s
        self._quickest_s = after_s if self._quickest_s is None else min(self._quickest_s, after_s)
        return after_s - self._quickest_s
