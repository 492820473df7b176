"""Robot: what a program that drives needs of a robot, be it real or simulated."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from wheelsight.calibration import Calibration
from wheelsight.commands import VelocityCommand
from wheelsight.events import Event

STOPPED = "it was stopped"
"""The `stop_reason` after `stop`."""


@runtime_checkable
class Robot(Protocol):
    """Commands in, events out; use it in a `with` block, which stops it however it ends.

    `simulation.Simulator` and `devices.LinkRobot` are such.
    """

    @property
    def calibration(self) -> Calibration:
        """Of its sensors, as its owner has it."""

    @property
    def stop_reason(self) -> str:
        """Why it stands whatever it is told, in words; empty while it obeys.

        A robot that has stopped by itself stays so until the reason is gone and it is commanded to stand (STOP), so
        that it does not set off again by itself.
        """

    @property
    def now_s(self) -> float:
        """Now, by the clock of the events' stamps."""

    def step(self, command: VelocityCommand) -> list[Event]:
        """Obey a command for one control period; what the sensors said meanwhile, in the order of stamps.

        A robot that is not stepped on stops by itself.
        """

    def stop(self) -> None:
        """Stop at once, without the gentleness of commands; then it stands until it is commanded to stand.

        May be called by another thread, while a step goes on.
        """

    def close(self) -> None:
        """Stop, and give up what it is driven by; may be called twice."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
