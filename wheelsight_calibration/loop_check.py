"""Check of wheels by a drive that ends where it started: the error of its path at the end, and possible causes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray, chi_square
from wheelsight_calibration.wheel_drive import WheelDrive, poses_at, sizes_m

_STEP = 1e-5  # of numeric derivatives
_ROUNDS, _NOTHING = 6, 1e-6  # of Gauss-Newton; information below which a size has no effect
# Chosen.
_SHORTEST_M = 5.0  # of a loop: in a shorter one, the error of the mark is most of the error (computed)
_CONFIDENCE = 0.9973  # share of loops found as stated, of wheels that are: 3σ of one number
_EXPLAINED_SHARE = 0.9  # of the squared error, in σ: a size that explains it is a cause, even if slip leaves too much
_GOOD_SHARE, _GOOD_DEG_PER_M = 0.02, 0.2  # error per way: a calibrated differential drive has about 1 %


class LoopCause(StrEnum):
    """Possible errors of the wheels' sizes. A loop does not depend on the mean radius."""

    DRIFT = "one radius against the other"
    TURN = "track width against radii"


@dataclass(frozen=True, slots=True)
class LoopCheck:
    """Error of a loop at its end.

    Attributes:
        way_m: distance, with that of driving backwards, without turns on the spot.
        turns: whole turns between start and end, counter-clockwise positive; 0 for a figure of eight.
        off_m, off_rad: error at the end, by the wheels; the heading counter-clockwise.
        off_sigma_m, off_sigma_rad: σ of the error by the stated σ of the wheels, their slip, and the mark.
        sizes_sigma_m, sizes_sigma_rad: the part of the stated σ of the wheels.
        is_as_stated: whether the error is consistent with these, in all three numbers.
        is_good: whether the error is small, whatever is stated.
        causes: single causes that explain the error, the likeliest first, with their amounts: radians per metre to the
            left, or the relative error of turns. Empty if it is as stated.
    """

    way_m: float
    turns: int
    off_m: float
    off_rad: float
    off_sigma_m: float
    off_sigma_rad: float
    sizes_sigma_m: float
    sizes_sigma_rad: float
    is_as_stated: bool
    is_good: bool
    causes: tuple[tuple[LoopCause, float], ...]


def check_loop(drive: WheelDrive, wheels: Wheels, *, mark_m: float = 0.02, mark_deg: float = 1.0) -> LoopCheck:
    """Check wheels by a drive whose final pose is its initial one, heading included.

    Args:
        drive: readings of the wheels.
        wheels: of the robot.
        mark_m, mark_deg: σ of the robot's return to its mark, along each axis and in heading.

    Raises:
        CalibrationError: the drive is too short.
    """
    poses = poses_at(drive, sizes_m(wheels), drive.stamps_s)
    steps_m = np.diff(np.stack([drive.left_rad, drive.right_rad], axis=-1), axis=0) * sizes_m(wheels)[:2]
    way_m = float(np.abs(steps_m.mean(axis=1)).sum())
    if way_m < _SHORTEST_M:
        problem, fix = f"is a drive of {way_m:.1f} m", f"drive {_SHORTEST_M:g} m or more"
        raise CalibrationError(problem, fix=fix)
    off = poses[-1].copy()
    turns = round(off[2] / (2 * np.pi))
    off[2] -= 2 * np.pi * turns
    # Derivatives (3, 3) of the end by scale, drift and turn, as a calibration states their σ.
    here = _end(drive, wheels)
    J = np.stack([(_end(drive, wheels, *change) - here) / _STEP for change in _STEP * np.eye(3)], axis=-1)
    stated = np.array([wheels.scale_sigma, wheels.drift_sigma_rad_per_m, wheels.turn_sigma])
    of_sizes = (J * stated**2) @ J.T
    of_mark = np.diag(np.square([mark_m, mark_m, np.radians(mark_deg)]))
    # By each wheel's random slip: an excess δ moves the base forward by δ/2 and turns it by ±δ over the track width,
    # with all of the path from there to the end.
    rest, by_slip = poses[-1, :2] - poses[1:, :2], np.zeros((3, 3))
    ahead = np.stack([np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])], axis=-1) / 2
    for side, sign in ((0, -1.0), (1, 1.0)):
        turn = sign / wheels.track_width_m
        moved = np.column_stack([ahead + turn * np.column_stack([-rest[:, 1], rest[:, 0]]), np.full(len(rest), turn)])
        by_slip += (moved * (wheels.slip_m_per_sqrt_m**2 * np.abs(steps_m)[:, side : side + 1])).T @ moved
    of_drive = by_slip + of_mark
    sigmas, of_sizes_alone = _sigmas(of_sizes + of_drive), _sigmas(of_sizes)
    most = chi_square.quantile(_CONFIDENCE, 3)
    is_as_stated = float(off @ np.linalg.solve(of_sizes + of_drive, off)) <= most
    most = max(most, (1 - _EXPLAINED_SHARE) * float(off @ np.linalg.solve(of_drive, off)))
    off_m, off_rad = float(np.hypot(*off[:2])), float(off[2])
    is_good = off_m <= _GOOD_SHARE * way_m and np.degrees(abs(off_rad)) <= _GOOD_DEG_PER_M * way_m
    closed = np.array([0.0, 0.0, 2 * np.pi * turns])
    found = []  # single causes of an end other than `closed`, the likeliest first
    for cause, unit in ((LoopCause.DRIFT, np.eye(3)[1]), (LoopCause.TURN, np.eye(3)[2])) if not is_as_stated else ():
        amount = _amount(drive, wheels, unit, closed, of_drive)
        left = _end(drive, wheels, *(-amount * unit)) - closed
        found.append((float(left @ np.linalg.solve(of_drive, left)), cause, amount))
    causes = tuple((cause, amount) for rest, cause, amount in sorted(found, key=lambda one: one[0]) if rest <= most)
    return LoopCheck(way_m, turns, off_m, off_rad, *sigmas, *of_sizes_alone, is_as_stated, bool(is_good), causes)


def _end(drive: WheelDrive, wheels: Wheels, scale: float = 0.0, drift: float = 0.0, turn: float = 0.0) -> FloatArray:
    """Return x, y, yaw (3,) of the end for wheels with errors of scale, drift per metre and turn."""
    half = drift * wheels.track_width_m / 2
    sizes = sizes_m(wheels) * (1 + scale) * np.array([1 - half, 1 + half, 1 / (1 + turn)])
    return np.asarray(poses_at(drive, sizes, drive.stamps_s[-1:])[0], float)


def _sigmas(covariance: FloatArray) -> tuple[float, float]:
    """Return σ of the position, both axes together, and of the heading."""
    return float(np.sqrt(covariance[0, 0] + covariance[1, 1])), float(np.sqrt(covariance[2, 2]))


def _amount(drive: WheelDrive, wheels: Wheels, unit: FloatArray, closed: FloatArray, of_drive: FloatArray) -> float:
    """Return the amount of one error (of `_end`, by its unit) whose removal brings the end nearest to `closed`, in σ.

    The first step uses the heading, which is linear in the amount. Then Gauss-Newton.
    """
    amount, weights = 0.0, np.diag([0.0, 0.0, 1.0])
    for _ in range(_ROUNDS):
        left = _end(drive, wheels, *(-amount * unit)) - closed
        column = (_end(drive, wheels, *(-(amount + _STEP) * unit)) - closed - left) / _STEP
        information = float(column @ weights @ column)
        # The track width has no effect at the end of a figure of eight.
        amount -= float(column @ weights @ left) / information if information > _NOTHING else 0.0
        weights = np.linalg.inv(of_drive)
    return amount


def with_sigmas(wheels: Wheels, scale: float, drift_rad_per_m: float, turn: float) -> Wheels:
    """Return wheels without stated σ with these ones; other wheels unchanged."""
    if wheels.scale_sigma or wheels.drift_sigma_rad_per_m or wheels.turn_sigma:
        return wheels
    return replace(wheels, scale_sigma=scale, drift_sigma_rad_per_m=drift_rad_per_m, turn_sigma=turn)
