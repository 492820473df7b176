"""What physics leaves of a drive: where the base truly was, and what its sensors of motion said."""

from __future__ import annotations

from dataclasses import dataclass

from wheelsight.events import HolonomicReading, WheelReading, WheelTicks, YawRate
from wheelsight.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Drive:
    """A finished drive; the camera's images are rendered along `truth` afterwards, in any order.

    Attributes:
        truth: T_world_base at a constant rate of at least 100 Hz, from 0 s; interpolate between.
        ticks: the wheel controller's readings in order of time, every 20 ms where none dropped out.
        yaw_rates: of the gyroscope; empty where the robot has none.
        is_complete: False where the driver gave up or the time limit ended the drive before the route's end.
        reason: why not, in words; empty where it is complete.
        holonomic: in place of `ticks`, the readings of a holonomic base.
    """

    truth: Trajectory
    ticks: tuple[WheelTicks, ...]
    yaw_rates: tuple[YawRate, ...] = ()
    is_complete: bool = True
    reason: str = ""
    holonomic: tuple[HolonomicReading, ...] = ()

    @property
    def readings(self) -> tuple[WheelReading, ...]:
        """Of the wheels, whichever the base has."""
        return self.holonomic or self.ticks

    @property
    def duration_s(self) -> float:
        """From the first to the last pose."""
        return self.truth.duration_s
