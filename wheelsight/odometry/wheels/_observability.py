"""When a drive does not determine the wheels, or is not the reference's: said, with what would help."""

from __future__ import annotations

import numpy as np

from wheelsight.calibration import Wheels
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray
from wheelsight.odometry.wheels.drive import Drive
from wheelsight.odometry.wheels.segments import Segments

_MOST_UNCERTAIN_SHARE = 0.03  # a tape measure does as well
_MOST_UNCERTAIN_DELAY_S = 0.1
_LARGEST_FACTOR = 2.5
_LEAST_EXPLAINED = 0.5
_LITTLE_TURNING_RAD, _LITTLE_WAY_M = 0.05, 0.02
_NAMES = {
    "left_radius_m": "left radius",
    "right_radius_m": "right radius",
    "track_width_m": "track width",
    "delay_s": "delay",
}


def refuse_if_unlike(segments: Segments, residuals: FloatArray, drive: Drive, delay_s: float) -> None:
    """Raise CalibrationError where even the best wheels leave most of the reference's motion unexplained.

    Args:
        segments, residuals: M of them, and (M, 3) what the fitted wheels leave.
        drive, delay_s: to tell wheels that are swapped from those that are another drive's.
    """
    along_m, turn_rad = chords_m(segments), segments.motions[:, 2]
    way_m, way_left_m = _typical(along_m, residuals[:, 0])
    turning_rad, turning_left_rad = _typical(turn_rad, residuals[:, 2])
    wrong = way_left_m > _LEAST_EXPLAINED * way_m > _LEAST_EXPLAINED * _LITTLE_WAY_M
    wrong |= turning_left_rad > _LEAST_EXPLAINED * turning_rad > _LEAST_EXPLAINED * _LITTLE_TURNING_RAD
    if not wrong:
        return
    start, end = (drive.angles_at(stamps_s + delay_s) for stamps_s in (segments.start_s, segments.end_s))
    left_rad, right_rad = (after - before for before, after in zip(start, end, strict=True))
    forward = _agreement(left_rad + right_rad, along_m)
    turned = _agreement(right_rad - left_rad, turn_rad)
    fix = "give the reference of this very drive, on the same clock, or raise the segments' length"
    if turned < -0.5:
        fix = "both wheels count backwards" if forward < -0.5 else "left and right are swapped"
    raise CalibrationError(
        f"wheels and reference do not tell of one drive: where a segment goes {way_m:.2g} m, {way_left_m:.2g} m stay "
        f"unexplained, and {np.degrees(turning_left_rad):.2g}° where it turns by {np.degrees(turning_rad):.2g}°",
        fix=fix,
    )


def refuse_if_unobservable(sigmas: dict[str, float], wheels: Wheels, segments: Segments) -> None:
    """Raise CalibrationError where a standard deviation is so large that a tape measure would do as well."""
    vague = [name for name, sigma in sigmas.items() if not sigma <= _allowed(name, wheels)]
    if vague:
        told = ", ".join(f"{_NAMES[name]} (σ {_uncertainty(name, sigmas[name], wheels)})" for name in vague)
        raise CalibrationError(f"the drive does not determine: {told}", fix=_advice(vague, segments))


def refuse_if_impossible(nominal: Wheels, fitted: Wheels, largest_delay_s: float) -> None:
    """Raise CalibrationError for a fit so far from nominal that something else must be wrong."""
    for name in ("left_radius_m", "right_radius_m", "track_width_m"):
        factor = getattr(fitted, name) / getattr(nominal, name)
        if not 1 / _LARGEST_FACTOR < factor < _LARGEST_FACTOR:
            raise CalibrationError(
                f"the reference asks for {factor:.3g} times the nominal {_NAMES[name]}",
                fix="check ticks_per_turn and the nominal sizes, and that the reference is in metres",
            )
    change_s = fitted.delay_s - nominal.delay_s
    if abs(change_s) > largest_delay_s:
        raise CalibrationError(
            f"wheels and reference seem {change_s:+.2f} s apart, more than the {largest_delay_s:g} s that are searched",
            fix="correct the clocks by that, or give delay_s, first",
        )


def chords_m(segments: Segments) -> FloatArray:
    """Way (M,) along each segment's chord, negative backwards."""
    x, y, yaw_rad = segments.motions.T
    return np.asarray(x * np.cos(yaw_rad / 2) + y * np.sin(yaw_rad / 2))


def _typical(motion: FloatArray, residual: FloatArray) -> tuple[float, float]:
    """Medians of the sizes of motion (M,) and residual (M,) over the segments that move as such drives do."""
    moving = np.abs(motion) >= 0.5 * np.sqrt(np.mean(motion**2))
    return float(np.median(np.abs(motion[moving]))), float(np.median(np.abs(residual[moving])))


def _allowed(name: str, wheels: Wheels) -> float:
    return _MOST_UNCERTAIN_DELAY_S if name == "delay_s" else _MOST_UNCERTAIN_SHARE * float(getattr(wheels, name))


def _uncertainty(name: str, sigma: float, wheels: Wheels) -> str:
    if name == "delay_s":
        return f"{sigma:.2g} s"
    share = sigma / float(getattr(wheels, name))
    return f"{100 * share:.2g} %" if share < 1 else "over 100 %"


def _advice(vague: list[str], segments: Segments) -> str:
    """What to drive so that the parameters become known."""
    turn_rad = segments.motions[:, 2]
    turned_left, turned_right = turn_rad[turn_rad > 0].sum(), -turn_rad[turn_rad < 0].sum()
    if vague == ["delay_s"]:
        return "start, stop and turn now and then, as steady motion hides the delay, or keep it (--no-delay)"
    if np.abs(chords_m(segments)).sum() < 2.0:
        return "the run hardly leaves its place: drive straight for some metres too"
    if turned_left + turned_right < 2 * np.pi:
        return "the run hardly turns: drive some full turns, both ways"
    if min(turned_left, turned_right) < 0.1 * max(turned_left, turned_right):
        return "the run turns one way only: turn the other way and drive straight too"
    return "drive longer, straight and with turns both ways, or give a better reference"


def _agreement(a: FloatArray, b: FloatArray) -> float:
    """Cosine between (M,) and (M,), -1 to 1."""
    size = float(np.sqrt(np.sum(a**2) * np.sum(b**2)))
    return float(np.sum(a * b)) / size if size > 0 else 0.0
