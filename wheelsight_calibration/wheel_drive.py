"""`WheelDrive` holds the wheel angles of a recorded drive and integrates them for given wheels.

`Segments` cuts a reference trajectory into pieces, whose motions the wheels must explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration_parts import Wheels, least_step
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray, se2, se3
from wheelsight.core.messages import WheelSpeeds, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import Recording


@dataclass(frozen=True, eq=False)
class WheelDrive:
    """Angles of both wheels over time, independent of radii and track width. Input of a calibration.

    Attributes:
        stamps_s: (N,) strictly growing, as recorded.
        left_rad, right_rad: (N,) angles since the first reading, without roll-over.
    """

    stamps_s: FloatArray
    left_rad: FloatArray
    right_rad: FloatArray

    def angles_at(self, stamps_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return left and right angle (M,) at stamps (M,), interpolated between readings."""
        wanted_s = np.asarray(stamps_s, float)
        return np.interp(wanted_s, self.stamps_s, self.left_rad), np.interp(wanted_s, self.stamps_s, self.right_rad)

    def between(self, start_s: float, end_s: float) -> WheelDrive:
        """Return the readings with start ≤ stamp ≤ end."""
        which = (self.stamps_s >= start_s) & (self.stamps_s <= end_s)
        return WheelDrive(self.stamps_s[which], self.left_rad[which], self.right_rad[which])


def drive_of(recording: Recording, wheels: Wheels) -> WheelDrive:
    """Return the drive of a recording's wheel readings.

    Raises:
        CalibrationError: fewer than two readings.
    """
    readings = [event for event in recording.events(images=False) if isinstance(event, WheelTicks | WheelSpeeds)]
    stamps_s = [reading.stamp_s for reading in readings]
    if len(readings) < 2:
        raise CalibrationError(f"{recording.name} has {len(readings)} wheel readings", fix="give a recording of wheels")
    if all(isinstance(reading, WheelTicks) for reading in readings):
        counts = [(reading.left, reading.right) for reading in readings if isinstance(reading, WheelTicks)]
        sides: list[Sequence[int]] = []
        for side in zip(*counts, strict=True):
            if max(wheels.counter_span, *(abs(count) for count in side)) <= 2**53:
                sides.append(side)
                continue
            # Floats do not represent such counts exactly, but those since the first one.
            steps = (least_step(int(now) - int(before), wheels.counter_span) for before, now in pairwise(side))
            sides.append(list(accumulate(steps, initial=0)))
        return drive_from_ticks(wheels, stamps_s, *sides)
    speeds = [(reading.left_rad_s, reading.right_rad_s) for reading in readings if isinstance(reading, WheelSpeeds)]
    turned = np.array(speeds)[:-1] * np.diff(stamps_s)[:, None]
    left_rad, right_rad = np.concatenate([np.zeros((1, 2)), np.cumsum(turned, axis=0)]).T
    return WheelDrive(np.array(stamps_s), left_rad, right_rad)


def drive_from_ticks(wheels: Wheels, stamps_s: ArrayLike, left: ArrayLike, right: ArrayLike) -> WheelDrive:
    """Return the drive of cumulative ticks (N,) of both wheels, whole or not, at stamps (N,).

    Raises:
        CalibrationError: fewer than two readings, arrays that do not fit, or stamps that do not grow.
    """
    stamps_s = np.array(stamps_s, float)
    ticks = [np.asarray(counts, float) for counts in (left, right)]
    if len(stamps_s) < 2 or any(counts.shape != stamps_s.shape for counts in ticks):
        raise CalibrationError(f"{stamps_s.size} stamps with {ticks[0].size} and {ticks[1].size} ticks are no drive")
    if not np.isfinite(stamps_s).all() or (np.diff(stamps_s) <= 0).any():
        raise CalibrationError("stamps of wheel readings must be finite and strictly growing")
    angles, span = [], wheels.counter_span
    for counts in ticks:
        steps = np.diff(counts)
        if span:  # remove roll-overs; exact for small steps of wide counters
            steps = steps - span * np.floor(steps / span + 0.5)
        angles.append(2 * np.pi / wheels.ticks_per_turn * np.concatenate([[0.0], np.cumsum(steps)]))
    return WheelDrive(stamps_s, *angles)


def sizes_m(wheels: Wheels) -> FloatArray:
    """Return left radius, right radius and track width (3,)."""
    return np.array([wheels.left_radius_m, wheels.right_radius_m, wheels.track_width_m])


def drive_path(drive: WheelDrive, wheels: Wheels, stamps_s: ArrayLike) -> Trajectory:
    """Return T_odom_base at stamps (M,) of the robot's clock (not the readings'), by arcs between readings."""
    x, y, yaw_rad = poses_at(drive, sizes_m(wheels), np.asarray(stamps_s, float) + wheels.delay_s).T
    return Trajectory(np.asarray(stamps_s, float), se3.from_plane(x, y, yaw_rad), body="base", frame="odom")


def yaw_at_readings(drive: WheelDrive, wheels: Wheels) -> FloatArray:
    """Return the unwrapped yaw (N,), 0 at the first reading; between readings it is linear in time."""
    arcs = _arcs(np.diff(drive.left_rad), np.diff(drive.right_rad), sizes_m(wheels))
    return np.concatenate([[0.0], np.cumsum(arcs[1])])


def poses_at(drive: WheelDrive, sizes_m: FloatArray, stamps_s: FloatArray) -> FloatArray:
    """Return x, y, yaw (M, 3) at stamps (M,) of the readings' clock.

    `sizes_m` is left radius, right radius, track width. Yaw is unwrapped. All start at 0 with the first reading.
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
    """Return length and turn of each step (N,)."""
    left_m, right_m = sizes_m[0] * left_rad, sizes_m[1] * right_rad
    return (left_m + right_m) / 2, (right_m - left_m) / sizes_m[2]


def _chords(arc_m: FloatArray, turn_rad: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return the chords (N,) of arcs that begin at yaw, as complex numbers x + iy."""
    return np.asarray(arc_m * np.sinc(turn_rad / (2 * np.pi)) * np.exp(1j * (yaw_rad + turn_rad / 2)))


_LONGEST = 3.0  # length of a segment that a gap in the reference may make, relative to the usual one


@dataclass(frozen=True, eq=False)
class Segments:
    """M segments of a reference trajectory of similar length; neighbours may share a pose.

    Attributes:
        start_s, end_s: (M,) on the reference's clock.
        motions: (M, 3), x, y in metres and yaw in radians of T_start_end.
    """

    start_s: FloatArray
    end_s: FloatArray
    motions: FloatArray

    def __len__(self) -> int:
        return len(self.start_s)

    def predicted(self, drive: WheelDrive, sizes_m: FloatArray, delay_s: float, mount: FloatArray) -> FloatArray:
        """Return the same motions (M, 3) by the wheels.

        `sizes_m` is left radius, right radius, track width. `mount` (3,) is x, y and yaw of T_axle_body: the pose of
        the reference's body relative to the middle of the axle.
        """
        # Both in one call, since each call integrates the whole drive.
        both = poses_at(drive, sizes_m, np.concatenate([self.start_s, self.end_s]) + delay_s)
        start, end = both[: len(self)], both[len(self) :]
        step = (end - start)[:, :2] @ np.array([1, 1j])
        turn_rad = end[:, 2] - start[:, 2]
        swing = complex(*mount[:2]) * (np.exp(1j * turn_rad) - 1)
        moved = (step * np.exp(-1j * start[:, 2]) + swing) * np.exp(-1j * mount[2])
        return np.stack([moved.real, moved.imag, turn_rad], axis=-1)

    def residuals(self, motions: FloatArray) -> FloatArray:
        """Return `motions` (M, 3) minus the reference's: along and across its chord in metres, yaw in radians."""
        off = motions - self.motions
        along = (off[:, 0] + 1j * off[:, 1]) * np.exp(-0.5j * self.motions[:, 2])
        return np.stack([along.real, along.imag, se2.wrap_angle(off[:, 2])], axis=-1)


def cut(
    drive: WheelDrive, reference: Trajectory, wheels: Wheels, length_m: float, margin_s: float, turn_rad: float = 1.0
) -> Segments:
    """Cut `reference` where the wheels, by nominal size, have moved by `length_m` or `turn_rad` since the last cut.

    Cuts lie on poses of the reference, at least `margin_s` inside the readings. There are no segments at rest, which
    would only contain noise. Segments are left out if readings are missing for longer than `wheels.max_gap_s` or exceed
    `wheels.max_speed_m_s`, or if a gap in the reference makes them over three times too long.

    Raises:
        CalibrationError: readings and reference share no time.
    """
    inside = reference.between(drive.stamps_s[0] + margin_s, drive.stamps_s[-1] - margin_s)
    if len(inside) < 2:
        raise CalibrationError(
            f"wheels ({_span(drive.stamps_s)}) and reference ({_span(reference.stamps_s)}) share less than the "
            f"{2 * margin_s:g} s that the search for their delay needs",
            fix="give the reference of this very drive, on the same clock",
        )
    # The number of segments before each stamp, with fractions, by nominal wheels; a jump of a counter is no distance.
    left_m, right_m = wheels.left_radius_m * drive.left_rad, wheels.right_radius_m * drive.right_rad
    forward_m = np.abs(np.diff(left_m + right_m)) / 2
    gone = np.maximum(forward_m / length_m, np.abs(np.diff(right_m - left_m)) / wheels.track_width_m / turn_rad)
    total = np.concatenate([[0.0], np.cumsum(np.minimum(gone, 1.0))])
    along: FloatArray = np.interp(inside.stamps_s + wheels.delay_s, drive.stamps_s, total)
    progress = np.asarray(along - along[0])
    marks = np.arange(np.floor(progress[-1]) + 1) if progress[-1] >= 1 else np.zeros(1)
    cuts = np.unique(np.searchsorted(progress, marks).clip(0, len(inside) - 1))
    start, end = cuts[:-1], cuts[1:]
    T_start_end = se3.invert(inside.T_frame_body[start]) @ inside.T_frame_body[end]
    yaw_rad = np.arctan2(T_start_end[:, 1, 0], T_start_end[:, 0, 0])
    motions = np.column_stack([T_start_end[:, :2, 3], yaw_rad])
    start_s, end_s = inside.stamps_s[start], inside.stamps_s[end]
    # Readings that are missing for long, or jump.
    step_s = np.diff(drive.stamps_s)
    rolled_m = np.maximum(
        wheels.left_radius_m * np.abs(np.diff(drive.left_rad)), wheels.right_radius_m * np.abs(np.diff(drive.right_rad))
    )
    fault = np.flatnonzero((step_s > wheels.max_gap_s) | (rolled_m > wheels.max_speed_m_s * step_s))
    opens_s, closes_s = drive.stamps_s[fault], drive.stamps_s[fault + 1]
    begun, over = (
        np.searchsorted(opens_s, end_s + margin_s),
        np.searchsorted(closes_s, start_s - margin_s, side="right"),
    )
    whole = begun <= over
    whole &= progress[end] - progress[start] <= _LONGEST
    return Segments(start_s[whole], end_s[whole], motions[whole])


def _span(stamps_s: FloatArray) -> str:
    return f"{stamps_s[0]:.3f} to {stamps_s[-1]:.3f} s" if len(stamps_s) else "empty"
