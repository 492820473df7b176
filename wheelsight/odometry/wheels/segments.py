"""Segments: a reference trajectory cut into pieces of like way, each a motion that the wheels must explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Wheels
from wheelsight.errors import CalibrationError
from wheelsight.geometry import BoolArray, FloatArray, se2, se3
from wheelsight.odometry.wheels.drive import Drive, poses_at
from wheelsight.trajectory import Trajectory

_LONGEST = 3.0


@dataclass(frozen=True, eq=False)
class Segments:
    """M pieces of a reference trajectory; neighbours may share a pose.

    Attributes:
        start_s, end_s: (M,) on the reference's clock.
        motions: (M, 3), x, y in metres and yaw in radians of T_start_end.
    """

    start_s: FloatArray
    end_s: FloatArray
    motions: FloatArray

    def __len__(self) -> int:
        return len(self.start_s)

    def predicted(self, drive: Drive, sizes_m: FloatArray, delay_s: float, mount: FloatArray) -> FloatArray:
        """The same motions (M, 3) by the wheels.

        `sizes_m` is left radius, right radius, track width; `mount` (3,) is x, y and yaw of T_axle_body: where the
        body that the reference follows sits, seen from the middle of the axle.
        """
        # Both at once: the whole drive is integrated for each call.
        both = poses_at(drive, sizes_m, np.concatenate([self.start_s, self.end_s]) + delay_s)
        start, end = both[: len(self)], both[len(self) :]
        step = (end - start)[:, :2] @ np.array([1, 1j])
        turn_rad = end[:, 2] - start[:, 2]
        swing = complex(*mount[:2]) * (np.exp(1j * turn_rad) - 1)
        moved = (step * np.exp(-1j * start[:, 2]) + swing) * np.exp(-1j * mount[2])
        return np.stack([moved.real, moved.imag, turn_rad], axis=-1)

    def residuals(self, motions: FloatArray) -> FloatArray:
        """Predicted `motions` (M, 3) minus the reference's: along and across its chord in metres, yaw in radians."""
        off = motions - self.motions
        along = (off[:, 0] + 1j * off[:, 1]) * np.exp(-0.5j * self.motions[:, 2])
        return np.stack([along.real, along.imag, se2.wrap_angle(off[:, 2])], axis=-1)


def cut(
    drive: Drive, reference: Trajectory, wheels: Wheels, length_m: float, margin_s: float, turn_rad: float = 1.0
) -> Segments:
    """Cut `reference` where the wheels, by nominal size, have gone on by `length_m` or `turn_rad` since the last cut.

    Cuts lie on poses of the reference, at least `margin_s` inside the readings. Time at rest makes no pieces, in which
    a reference would only show its noise. Left out are pieces in which readings are missing for longer than
    `wheels.max_gap_s` or need more than `wheels.max_speed_m_s`, and those that a gap in the reference makes over three
    times too long.

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
    progress = _progress(drive, wheels, length_m, turn_rad, inside.stamps_s)
    marks = np.arange(np.floor(progress[-1]) + 1) if progress[-1] >= 1 else np.zeros(1)
    cuts = np.unique(np.searchsorted(progress, marks).clip(0, len(inside) - 1))
    start, end = cuts[:-1], cuts[1:]
    T_start_end = se3.invert(inside.T_frame_body[start]) @ inside.T_frame_body[end]
    yaw_rad = np.arctan2(T_start_end[:, 1, 0], T_start_end[:, 0, 0])
    motions = np.column_stack([T_start_end[:, :2, 3], yaw_rad])
    start_s, end_s = inside.stamps_s[start], inside.stamps_s[end]
    whole = ~_has_fault(drive, wheels, start_s - margin_s, end_s + margin_s)
    whole &= progress[end] - progress[start] <= _LONGEST
    return Segments(start_s[whole], end_s[whole], motions[whole])


def _progress(drive: Drive, wheels: Wheels, length_m: float, turn_rad: float, stamps_s: FloatArray) -> FloatArray:
    """How many segments lie before each stamp (N,), by nominal wheels."""
    left_m, right_m = wheels.left_radius_m * drive.left_rad, wheels.right_radius_m * drive.right_rad
    gone = np.maximum(
        np.abs(np.diff(left_m + right_m)) / 2 / length_m,
        np.abs(np.diff(right_m - left_m)) / wheels.track_width_m / turn_rad,
    )
    total = np.concatenate([[0.0], np.cumsum(np.minimum(gone, 1.0))])  # a counter that jumps is no long way
    along: FloatArray = np.interp(stamps_s + wheels.delay_s, drive.stamps_s, total)
    return np.asarray(along - along[0])


def _has_fault(drive: Drive, wheels: Wheels, start_s: FloatArray, end_s: FloatArray) -> BoolArray:
    """Whether readings are missing for long, or jump, anywhere between each start (M,) and end (M,)."""
    step_s = np.diff(drive.stamps_s)
    rolled_m = np.maximum(
        wheels.left_radius_m * np.abs(np.diff(drive.left_rad)), wheels.right_radius_m * np.abs(np.diff(drive.right_rad))
    )
    fault = np.flatnonzero((step_s > wheels.max_gap_s) | (rolled_m > wheels.max_speed_m_s * step_s))
    opens_s, closes_s = drive.stamps_s[fault], drive.stamps_s[fault + 1]
    is_inside: BoolArray = np.searchsorted(opens_s, end_s) > np.searchsorted(closes_s, start_s, side="right")
    return is_inside


def _span(stamps_s: FloatArray) -> str:
    return f"{stamps_s[0]:.3f} to {stamps_s[-1]:.3f} s" if len(stamps_s) else "empty"
