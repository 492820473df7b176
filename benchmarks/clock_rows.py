"""What is wrong with stamps in each row of `benchmarks.clocks`, and the drives on which it is."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmarks.clock_faults import (
    ClockFault,
    ClockLeaps,
    ColorLate,
    ReadingsJitter,
    ReadingsStalled,
    ReadingsTogether,
    Sensors,
)
from wheelsight.core.calibration import Calibration
from wheelsight.core.messages import Event, WheelTicks
from wheelsight.io.recordings import Recording, open_recording
from wheelsight_sim import SimulationSettings, simulate, write_simulation
from wheelsight_sim.faults import CameraFault, LowRate

Fault = CameraFault | ClockFault

DRIVE = SimulationSettings("flat", size=(320, 240), rate_hz=10.0, duration_s=25.0)
_LEAP_S, _MOVING_S = 8.0, 12.0


@dataclass(frozen=True, slots=True)
class TimedTicks(WheelTicks):
    """A reading that knows when it was truly taken, whatever its stamp becomes."""

    true_s: float = math.nan

    @property
    def plain(self) -> WheelTicks:
        """The reading as a source gives it."""
        return WheelTicks(self.stamp_s, self.left, self.right)


@dataclass(frozen=True, slots=True)
class ShortCounters:
    """Counters of so few bits."""

    bits: int = 8

    def apply(self, events: Iterable[Event]) -> list[Event]:
        """The events with counts that roll over."""
        ends = 2**self.bits
        return [
            replace(event, left=event.left % ends, right=event.right % ends) if isinstance(event, WheelTicks) else event
            for event in events
        ]


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the table.

    Attributes:
        name: as it stands in the table.
        faults: the first given acts first.
        wheels: what the calibration says of the wheels in place of what it says.
        is_at_readings: joined answers are judged at wheel readings, since its frames are refused.
    """

    name: str
    faults: tuple[Fault, ...] = ()
    wheels: Mapping[str, Any] = field(default_factory=dict)
    is_at_readings: bool = False

    def events(self, events: Iterable[Event]) -> list[Event]:
        """The events as they come."""
        for fault in self.faults:
            events = fault.apply(events)
        return list(events)

    def calibration(self, calibration: Calibration) -> Calibration:
        """What the robot's owner believes."""
        assert calibration.wheels is not None
        return replace(calibration, wheels=replace(calibration.wheels, **self.wheels))


def _leap(by_s: float, sensors: Sensors = "both") -> Row:
    whose = {"both": "both clocks jump", "wheels": "the wheels' clock jumps", "camera": "the camera's clock jumps"}
    reported = {1e9: "+10⁹"}.get(by_s, f"{by_s:+g}".replace("-", "−"))
    return Row(f"{whose[sensors]} {reported} s", (ClockLeaps(_LEAP_S, by_s, sensors),))


ROWS = (
    Row("clean"),
    *(Row(f"readings in pairs {1000 * s:g} ms apart", (ReadingsTogether(2, s),)) for s in (1e-4, 1e-3, 5e-3)),
    Row("readings stall then come 1 µs apart", (ReadingsStalled(apart_s=1e-6),)),
    Row("readings stall then come 1 ms apart", (ReadingsStalled(apart_s=1e-3),)),
    Row("readings late by chance: Gaussian 10 ms", (ReadingsJitter(0.01),)),
    *map(_leap, (60.0, 3600.0, 1e9, -60.0)),
    _leap(60.0, "wheels"),
    _leap(-60.0, "wheels"),
    _leap(60.0, "camera"),
    _leap(1.0, "wheels"),
    _leap(0.3, "wheels"),
    Row("a pause of 300 s standing", (ClockLeaps(_LEAP_S, 300.0, missing_s=0.02),)),
    Row("a pause of 300 s moving", (ClockLeaps(_MOVING_S, 300.0, missing_s=1.0),)),
    Row("counters of 8 bits", (ShortCounters(8),), {"counter_bits": 8}),
    Row("max_speed of 0.3 m/s", wheels={"max_speed_m_s": 0.3}),
    Row("frames at 2 Hz", (LowRate(rate_hz=2.0),)),
    Row("frames at 1 Hz", (LowRate(rate_hz=1.0),)),
    Row("colour one frame late", (ColorLate(1),)),
    Row("colour two frames late", (ColorLate(2),)),
    Row("wheels in another epoch by 1.6·10⁹ s", (ClockLeaps(-math.inf, 1.6e9, "wheels"),), is_at_readings=True),
    Row("wheels in another epoch by 18 s", (ClockLeaps(-math.inf, 18.0, "wheels"),), is_at_readings=True),
)


def drive_of(seed: int, folder: Path, settings: SimulationSettings = DRIVE) -> Recording:
    """The drive of a seed, from `folder`/`world`-`seed`; where there is none it is made.

    Nothing shows that the simulator has changed since: then the folder is to be deleted.
    """
    kept = folder / f"{settings.world}-{seed}"
    if not kept.is_dir():
        unfinished = folder / f"{kept.name}.unfinished"
        write_simulation(simulate(replace(settings, seed=seed)), unfinished, force=True)
        unfinished.rename(kept)
    return open_recording(kept)


def timed(events: Iterable[Event]) -> list[Event]:
    """The events, readings with their true time."""
    return [
        TimedTicks(event.stamp_s, event.left, event.right, event.stamp_s) if isinstance(event, WheelTicks) else event
        for event in events
    ]
