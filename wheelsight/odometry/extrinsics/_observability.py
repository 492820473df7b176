"""When a drive does not show where the camera sits: said, with what to drive instead."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wheelsight.calibration import Wheels
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray
from wheelsight.odometry.extrinsics.floor import Floor
from wheelsight.odometry.extrinsics.hand_eye import MountFit
from wheelsight.odometry.extrinsics.settings import DEFAULTS, DriveSettings
from wheelsight.odometry.extrinsics.sightings import Sightings
from wheelsight.odometry.extrinsics.turning import Turning
from wheelsight.odometry.wheels import Drive, drive_path
from wheelsight.recordings.clocks import apart

WHAT_TO_DRIVE = "drive a minute or two as usual, straight and with turns both ways, some of them on the spot"

_TILT, _PLACE = ("roll", "pitch", "yaw"), ("x", "y", "height")


def refuse_if_hardly_moving(drive: Drive, wheels: Wheels, settings: DriveSettings = DEFAULTS.drive) -> None:
    """Raise CalibrationError for a drive that by its wheels alone can't do: before any image is looked at."""
    samples = np.arange(drive.stamps_s[0], drive.stamps_s[-1], settings.sample_s)
    if len(samples) < 2:
        raise CalibrationError(f"the wheels tell of {np.ptp(drive.stamps_s):.2f} s only", fix=WHAT_TO_DRIVE)
    path = drive_path(drive, wheels, samples - wheels.delay_s)
    yaw_rad = np.unwrap(np.arctan2(path.T_frame_body[:, 1, 0], path.T_frame_body[:, 0, 0]))
    turned_rad = float(np.abs(np.diff(yaw_rad)).sum())
    if path.length_m < settings.least_way_m and turned_rad < settings.least_turn_rad:
        raise CalibrationError(f"by its wheels the robot stands, it goes {path.length_m:.2f} m", fix=WHAT_TO_DRIVE)
    if turned_rad < settings.least_turn_rad:
        raise CalibrationError(
            f"the drive hardly turns, by {np.degrees(turned_rad):.0f}° in all: x and y of the camera stay unseen",
            fix="drive some turns too, both ways, also on the spot",
        )
    if path.length_m < settings.least_way_m:
        raise CalibrationError(
            f"the robot hardly leaves its place, it goes {path.length_m:.2f} m: where the camera looks stays unseen",
            fix="drive straight for some metres too",
        )


def refuse_if_apart(drive: Drive, first_s: float, last_s: float, settings: DriveSettings) -> None:
    """Raise CalibrationError where frames from `first_s` to `last_s` share hardly any time with the readings."""
    told = apart((float(drive.stamps_s[0]), float(drive.stamps_s[-1])), (first_s, last_s), settings.least_shared_s)
    if told is not None:
        raise CalibrationError(told[0], fix=told[1])


def refuse_if_lost(sightings: Sightings, settings: DriveSettings) -> None:
    """Raise CalibrationError where the camera could not be followed for most of the drive."""
    tracked, total = len(sightings.camera), sightings.frame_count
    if tracked < max(settings.fewest_tracked, settings.least_tracked_share * total):
        raise CalibrationError(
            f"the camera could be followed in {tracked} of {total} frames only",
            fix="drive slowly, past things one to four metres away, not at bare walls alone",
        )


def refuse_if_unlike(
    turning: Turning,
    wheels: Wheels,
    up_expected: FloatArray | None,
    largest_delay_s: float,
    settings: DriveSettings,
) -> None:
    """Raise CalibrationError where wheels and camera turn differently, or too far apart in time.

    `up_expected` (3,) is up in the camera frame by the nominal mount, or None; delays are searched up to the largest.
    """
    if turning.agreement < settings.least_agreement:
        raise CalibrationError(
            "wheels and camera do not turn together: their turns agree by "
            f"{100 * turning.agreement:.0f} %, less than {100 * settings.least_agreement:.0f} %",
            fix=f"see that both are of one drive and their clocks at most 10 s apart, and {WHAT_TO_DRIVE}",
        )
    up = np.array([0.0, -1.0, 0.0]) if up_expected is None else up_expected
    if turning.up_camera @ up < -0.5:
        raise CalibrationError(
            "the camera turns left where the wheels turn right",
            fix="swap left and right wheel, or, for a camera that hangs upside down, give T_base_camera roughly",
        )
    change_s = turning.delay_s - wheels.delay_s
    if abs(change_s) > largest_delay_s:
        raise CalibrationError(
            f"the wheels' stamps seem {change_s:+.2f} s late, more than the ±{largest_delay_s:g} s that are searched",
            fix=f"give wheels.delay_s: {turning.delay_s:.2f} by --calibration, or correct the clocks",
        )


def refuse_if_tilted(floor: Floor, turning: Turning, settings: DriveSettings) -> None:
    """Raise CalibrationError where the plane in sight is not the one on which the robot turns."""
    off_rad = float(np.arccos(np.clip(floor.up_camera @ turning.up_camera, -1, 1)))
    if off_rad > np.radians(settings.most_tilt_deg):
        raise CalibrationError(
            f"the plane under the camera leans by {np.degrees(off_rad):.1f}° against the one that the robot turns on",
            fix="drive on level ground with free floor before the camera",
        )


def refuse_if_few(segment_count: int, settings: DriveSettings) -> None:
    """Raise CalibrationError for too few pieces of the drive to judge them by one another."""
    if segment_count < settings.fewest_segments:
        raise CalibrationError(
            f"the drive holds {segment_count} pieces of a third of a metre or a quarter of a radian with readings and "
            f"frames, {settings.fewest_segments} are needed",
            fix=WHAT_TO_DRIVE,
        )


def refuse_if_unobservable(sigmas: Mapping[str, float], fit: MountFit, settings: DriveSettings) -> None:
    """Raise CalibrationError where a standard deviation is so large that a protractor and a tape would do as well."""
    vague = [name for name, sigma in sigmas.items() if not sigma <= _allowed(name, settings)]
    if vague:
        told = ", ".join(f"{name} (σ {_told(name, sigmas[name])})" for name in vague)
        raise CalibrationError(f"the drive does not determine: {told}", fix=_advice(vague, fit))


def refuse_if_out_of_scale(nominal: Wheels, fitted: Wheels, settings: DriveSettings) -> None:
    """Raise CalibrationError where camera and wheels tell of ways so different that something else is wrong."""
    factor = (fitted.left_radius_m + fitted.right_radius_m) / (nominal.left_radius_m + nominal.right_radius_m)
    if not 1 / settings.largest_factor < factor < settings.largest_factor:
        raise CalibrationError(
            f"the camera sees ways {factor:.2f} times as long as the wheels tell",
            fix="check the depth factor, the wheels' radii and ticks_per_turn",
        )


def _advice(vague: list[str], fit: MountFit) -> str:
    if vague == ["delay"]:
        return "start, stop and turn now and then, as steady motion hides the delay"
    turn_rad = fit.segments.motions[:, 2]
    left_rad, right_rad = turn_rad[turn_rad > 0].sum(), -turn_rad[turn_rad < 0].sum()
    if min(left_rad, right_rad) < 0.1 * max(left_rad, right_rad):
        return "the drive turns one way only: turn the other way too"
    return WHAT_TO_DRIVE.replace("a minute or two", "longer")


def _allowed(name: str, settings: DriveSettings) -> float:
    if name in _TILT:
        return float(np.radians(settings.most_uncertain_deg))
    return settings.most_uncertain_m if name in _PLACE else settings.most_uncertain_s


def _told(name: str, sigma: float) -> str:
    if name in _TILT:
        return f"{np.degrees(sigma):.2g}°"
    return f"{100 * sigma:.2g} cm" if name in _PLACE else f"{1e3 * sigma:.2g} ms"
