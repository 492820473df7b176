"""StopSwitch: stops a robot by a thread of its own, whatever else of the program hangs; StoppableRobot obeys it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType

from wheelsight.calibration import Calibration
from wheelsight.commands import STOP, VelocityCommand
from wheelsight.errors import WheelsightError
from wheelsight.events import Event, RgbdFrame
from wheelsight.robots import Robot

_ENDS_S = 2.0


class StopSwitch:
    """Pressed by anybody, from any thread; it waits for nobody.

    Args:
        robot: that it stops, by the robot's own `stop`.

    Attributes:
        problem: what the robot said against being stopped, last; empty where it obeyed.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot, self.problem = robot, ""
        self._lock, self._wake = threading.Lock(), threading.Event()
        self._reason, self._presses, self._is_closed = "", 0, False
        self._thread = threading.Thread(target=self._run, name="wheelsight-stop", daemon=True)
        self._thread.start()

    @property
    def reason(self) -> str:
        """Why the robot is to stand; empty while it may move."""
        return self._reason

    @property
    def presses(self) -> int:
        """How often it was pressed."""
        return self._presses

    def press(self, reason: str) -> None:
        """Stop the robot now, and hold it until `release`."""
        with self._lock:
            self._presses += 1
            self._reason = self._reason or reason
        self._wake.set()

    def release(self, presses: int) -> bool:
        """Let the robot move again, for who saw the switch pressed so often; not where it was pressed since."""
        with self._lock:
            if presses != self._presses:
                return False
            self._reason = ""
            return True

    def close(self) -> None:
        """End its thread; may be called twice."""
        self._is_closed = True
        self._wake.set()
        self._thread.join(_ENDS_S)

    def _run(self) -> None:
        while True:
            self._wake.wait()
            self._wake.clear()
            if self._is_closed:
                return
            try:
                self._robot.stop()
                self.problem = ""
            except WheelsightError as error:
                self.problem = str(error)


class StoppableRobot:
    """A `Robot` that stands while a switch is pressed, whatever it is told; it keeps the last frame of its camera.

    Args:
        robot: that moves.
        switch: that stops it.
        on_events: told what its sensors said in each period.

    Attributes:
        frame: the last one; None before any.
    """

    def __init__(
        self, robot: Robot, switch: StopSwitch, on_events: Callable[[Sequence[Event]], None] = lambda events: None
    ) -> None:
        self._robot, self._switch, self._on_events = robot, switch, on_events
        self.frame: RgbdFrame | None = None

    @property
    def calibration(self) -> Calibration:
        """As `Robot` has it."""
        return self._robot.calibration

    @property
    def stop_reason(self) -> str:
        """As `Robot` has it."""
        return self._switch.reason or self._robot.stop_reason

    @property
    def now_s(self) -> float:
        """As `Robot` has it."""
        return self._robot.now_s

    def step(self, command: VelocityCommand) -> list[Event]:
        """As `Robot` has it."""
        events = self._robot.step(STOP if self._switch.reason else command)
        frames = [event for event in events if isinstance(event, RgbdFrame)]
        self.frame = frames[-1] if frames else self.frame
        self._on_events(events)
        return events

    def stop(self) -> None:
        """As `Robot` has it."""
        self._robot.stop()

    def close(self) -> None:
        """As `Robot` has it."""
        self._robot.close()

    def __enter__(self) -> StoppableRobot:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(WheelsightError):
            self.close()
