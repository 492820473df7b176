"""A recording of wheels without images: what all formats of that kind come down to once their files are read."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from wheelsight.calibration import Calibration, Wheels, load_calibration
from wheelsight.errors import CalibrationError
from wheelsight.events import Event, WheelReading, WheelSpeeds, YawRate
from wheelsight.matches import Match, SpeedVariances
from wheelsight.recordings.protocol import AssociationReport
from wheelsight.trajectory import Trajectory

_FOLDER = Path(__file__).parent / "robots"


@dataclass(frozen=True, eq=False)
class WheelRecording:
    """A `Recording` of wheel readings. Attributes beside the protocol's:

    wheels: readings of the wheels in order of time, all ticks or all speeds.
    yaw_rates: readings of a gyroscope in order of time.
    matches: where somebody took two places for one.
    speed_variances: what the recording states of its odometry's errors, or None.
    """

    name: str
    path: Path
    format: str
    calibration: Calibration
    wheels: tuple[WheelReading, ...]
    yaw_rates: tuple[YawRate, ...] = ()
    ground_truth: Trajectory | None = None
    warnings: tuple[str, ...] = ()
    matches: tuple[Match, ...] = ()
    speed_variances: SpeedVariances | None = None

    @property
    def body(self) -> str:
        """The frame the ground truth describes."""
        return "base"

    @property
    def frame_count(self) -> int:
        """None has images."""
        return 0

    @property
    def wheel_count(self) -> int:
        """How many wheel readings `events()` will yield."""
        return len(self.wheels)

    @property
    def association(self) -> AssociationReport:
        """Nothing to pair."""
        return AssociationReport(0, 0, 0, 0.0)

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """Readings of gyroscope and wheels in order of time, from the start at each call; there are no `images`."""
        sources: Sequence[Sequence[Event]] = (self.yaw_rates, self.wheels)
        yield from heapq.merge(*sources, key=lambda event: event.stamp_s)


def shipped_robot(name: str) -> Calibration:
    """Nominal wheels that come with the package for a format whose files do not tell of them."""
    return load_calibration(_FOLDER / f"{name}.yaml")


def speeds_of_wheels(wheels: Wheels, stamp_s: float, forward_m_s: float, yaw_rate_rad_s: float) -> WheelSpeeds:
    """The speeds of wheels that together go forward and turn so: what `wheels` would have told."""
    across_m_s = yaw_rate_rad_s * wheels.track_width_m / 2
    left, right = forward_m_s - across_m_s, forward_m_s + across_m_s
    return WheelSpeeds(stamp_s, left / wheels.left_radius_m, right / wheels.right_radius_m)


def need_wheels(calibration: Calibration) -> Wheels:
    """The calibration's wheels. Raises CalibrationError where there are none."""
    if calibration.wheels is None:
        problem = f"the calibration ({calibration.source}) {calibration.lacks_two_wheels}"
        raise CalibrationError(problem, fix="give a calibration.yaml with wheels by --calibration")
    return calibration.wheels
