"""Simulated drives and robots with a calibration of their owner's in place of the data sheet's; depth is freed of it.

What a reader of recordings and a live camera do with `depth_error` is done here with the simulator's frames. The
simulator goes on as it was: a calibration is what is believed, not what is.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, fields, replace
from types import TracebackType
from typing import Self

from wheelsight.core.calibration import Calibration
from wheelsight.core.messages import Event, RgbdFrame, VelocityCommand
from wheelsight_sim import SimulatedRecording
from wheelsight_sim.simulator import Simulator


def freed(events: Iterable[Event], calibration: Calibration) -> Iterator[Event]:
    """Events whose depth images are freed of the error that the calibration states."""
    _, depth = calibration.cameras
    for event in events:
        if isinstance(event, RgbdFrame):
            event = replace(event, depth_m=calibration.depth_error.corrected(event.depth_m, depth))
        yield event


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibratedRecording(SimulatedRecording):
    """A `SimulatedRecording` whose owner has calibrated the robot; the truth is the same.

    Attributes:
        owned: what was found.
    """

    owned: Calibration

    @property
    def calibration(self) -> Calibration:
        """What was found."""
        return self.owned

    def events(self, *, images: bool = True) -> Generator[Event]:
        """As of the simulated recording, depth freed of its errors."""
        events = super().events(images=images)
        try:
            yield from freed(events, self.owned)
        finally:
            events.close()


def with_calibration(recording: SimulatedRecording, owned: Calibration) -> CalibratedRecording:
    """The same drive of a robot that was calibrated."""
    made_of = {field.name: getattr(recording, field.name) for field in fields(SimulatedRecording)}
    return CalibratedRecording(**made_of, owned=owned)


class CalibratedRobot:
    """A `Robot`: a simulator whose owner has calibrated it. Its wheel controller keeps the data sheet's wheels."""

    def __init__(self, simulator: Simulator, owned: Calibration) -> None:
        self._simulator, self._owned = simulator, owned

    @property
    def calibration(self) -> Calibration:
        """What was found."""
        return self._owned

    @property
    def stop_reason(self) -> str:
        """As `Robot` has it."""
        return self._simulator.stop_reason

    @property
    def now_s(self) -> float:
        """As `Robot` has it."""
        return self._simulator.now_s

    def step(self, command: VelocityCommand) -> list[Event]:
        """As of the simulator, depth freed of its errors."""
        return list(freed(self._simulator.step(command), self._owned))

    def stop(self) -> None:
        """As of the simulator."""
        self._simulator.stop()

    def close(self) -> None:
        """As of the simulator."""
        self._simulator.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
