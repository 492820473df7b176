"""Drive: how far both wheels had turned at each reading, and where that takes a robot of given size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.calibration import Wheels
from wheelsight.calibration_parts import least_step
from wheelsight.errors import CalibrationError
from wheelsight.events import WheelSpeeds, WheelTicks
from wheelsight.geometry import FloatArray, se3
from wheelsight.recordings import Recording
from wheelsight.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Drive:
    """The angles of both wheels over time, free of radii and track width: what a calibration starts from.

    Attributes:
        stamps_s: (N,) strictly growing, as recorded.
        left_rad, right_rad: (N,) turned since the first reading, roll-over undone.
    """

    stamps_s: FloatArray
    left_rad: FloatArray
    right_rad: FloatArray

    def angles_at(self, stamps_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Left and right angle (M,) at stamps (M,), in proportion between readings."""
        wanted_s = np.asarray(stamps_s, float)
        return np.interp(wanted_s, self.stamps_s, self.left_rad), np.interp(wanted_s, self.stamps_s, self.right_rad)

    def between(self, start_s: float, end_s: float) -> Drive:
        """The readings with start ≤ stamp ≤ end."""
        which = (self.stamps_s >= start_s) & (self.stamps_s <= end_s)
        return Drive(self.stamps_s[which], self.left_rad[which], self.right_rad[which])


def drive_of(recording: Recording, wheels: Wheels) -> Drive:
    """The drive that a recording's wheel readings tell of.

    Raises:
        CalibrationError: it has fewer than two.
    """
    readings = [event for event in recording.events(images=False) if isinstance(event, WheelTicks | WheelSpeeds)]
    stamps_s = [reading.stamp_s for reading in readings]
    if len(readings) < 2:
        raise CalibrationError(f"{recording.name} has {len(readings)} wheel readings", fix="give a recording of wheels")
    if all(isinstance(reading, WheelTicks) for reading in readings):
        counts = [(reading.left, reading.right) for reading in readings if isinstance(reading, WheelTicks)]
        sides = [_narrowed(side, wheels.counter_span) for side in zip(*counts, strict=True)]
        return drive_from_ticks(wheels, stamps_s, *sides)
    speeds = [(reading.left_rad_s, reading.right_rad_s) for reading in readings if isinstance(reading, WheelSpeeds)]
    turned = np.array(speeds)[:-1] * np.diff(stamps_s)[:, None]
    left_rad, right_rad = np.concatenate([np.zeros((1, 2)), np.cumsum(turned, axis=0)]).T
    return Drive(np.array(stamps_s), left_rad, right_rad)


def drive_from_ticks(wheels: Wheels, stamps_s: ArrayLike, left: ArrayLike, right: ArrayLike) -> Drive:
    """The drive that cumulative ticks (N,) of both wheels, whole or not, at stamps (N,) tell of.

    Raises:
        CalibrationError: fewer than two readings, arrays that do not fit, or stamps that do not grow.
    """
    stamps_s = np.array(stamps_s, float)
    ticks = [np.asarray(counts, float) for counts in (left, right)]
    if len(stamps_s) < 2 or any(counts.shape != stamps_s.shape for counts in ticks):
        raise CalibrationError(f"{stamps_s.size} stamps with {ticks[0].size} and {ticks[1].size} ticks are no drive")
    if not np.isfinite(stamps_s).all() or (np.diff(stamps_s) <= 0).any():
        raise CalibrationError("stamps of wheel readings must be finite and strictly growing")
    angles = [2 * np.pi / wheels.ticks_per_turn * _unrolled(counts, wheels.counter_span) for counts in ticks]
    return Drive(stamps_s, *angles)


def drive_path(drive: Drive, wheels: Wheels, stamps_s: ArrayLike) -> Trajectory:
    """T_odom_base at stamps (M,) of the robot's clock (not the readings'), with circular arcs between readings."""
    sizes = np.array([wheels.left_radius_m, wheels.right_radius_m, wheels.track_width_m])
    x, y, yaw_rad = poses_at(drive, sizes, np.asarray(stamps_s, float) + wheels.delay_s).T
    return Trajectory(np.asarray(stamps_s, float), se3.from_plane(x, y, yaw_rad), body="base", frame="odom")


def yaw_at_readings(drive: Drive, wheels: Wheels) -> FloatArray:
    """Yaw (N,), from 0 at the first reading on beyond a turn; between readings it is linear in time."""
    sizes_m = np.array([wheels.left_radius_m, wheels.right_radius_m, wheels.track_width_m])
    return np.concatenate([[0.0], np.cumsum(_arcs(np.diff(drive.left_rad), np.diff(drive.right_rad), sizes_m)[1])])


def poses_at(drive: Drive, sizes_m: FloatArray, stamps_s: FloatArray) -> FloatArray:
    """x, y, yaw (M, 3) at stamps (M,) of the readings' clock; `sizes_m` is left radius, right radius, track width.

    Yaw counts on beyond a turn; it starts at 0, as the position does, with the first reading.
    """
    arc_m, turn_rad = _arcs(np.diff(drive.left_rad), np.diff(drive.right_rad), sizes_m)
    yaw_rad = np.concatenate([[0.0], np.cumsum(turn_rad)])
    corners = np.concatenate([[0.0], np.cumsum(_chords(arc_m, turn_rad, yaw_rad[:-1]))])
    step = np.searchsorted(drive.stamps_s, stamps_s, side="right").clip(1, len(drive.stamps_s) - 1) - 1
    share = (stamps_s - drive.stamps_s[step]) / np.diff(drive.stamps_s)[step]
    share = share.clip(0, 1)
    last = _chords(share * arc_m[step], share * turn_rad[step], yaw_rad[step])
    position = corners[step] + last
    return np.stack([position.real, position.imag, yaw_rad[step] + share * turn_rad[step]], axis=-1)


def _arcs(left_rad: FloatArray, right_rad: FloatArray, sizes_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Length and turn of each step (N,)."""
    left_m, right_m = sizes_m[0] * left_rad, sizes_m[1] * right_rad
    return (left_m + right_m) / 2, (right_m - left_m) / sizes_m[2]


def _chords(arc_m: FloatArray, turn_rad: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """The straight steps (N,) across arcs that begin at yaw, as complex numbers x + iy."""
    return np.asarray(arc_m * np.sinc(turn_rad / (2 * np.pi)) * np.exp(1j * (yaw_rad + turn_rad / 2)))


def _narrowed(counts: Sequence[int], span: int) -> Sequence[int]:
    """Counts since the first, where counters are so wide that floats would not tell them apart."""
    if max(span, *(abs(count) for count in counts)) <= 2**53:
        return counts
    steps = (least_step(int(now) - int(before), span) for before, now in pairwise(counts))
    return list(accumulate(steps, initial=0))


def _unrolled(ticks: FloatArray, span: int) -> FloatArray:
    """Ticks (N,) since the first reading, over roll-overs of a counter of so many values; 0 for none."""
    steps = np.diff(ticks)
    if span:
        steps = steps - span * np.floor(steps / span + 0.5)  # which keeps small steps of wide counters
    return np.concatenate([[0.0], np.cumsum(steps)])
