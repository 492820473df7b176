"""calibrate_base: where the camera sits on its robot, and how late the wheels' clock is, from an ordinary drive.

The robot's turns tell which way is up for the camera, and the delay roughly. The floor seen in depth tells roll, pitch
and height. With the camera levelled by that, the motions of wheels and camera tell yaw, x, y and the delay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.calibration import Calibration, Wheels
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray, se3
from wheelsight.odometry.camera_errors import motion_errors, moved_in_camera_m
from wheelsight.odometry.extrinsics import _observability as observability
from wheelsight.odometry.extrinsics.floor import Floor, FloorViews, fit_floor, tilt_of
from wheelsight.odometry.extrinsics.hand_eye import MountFit, cut_level, fit_mount, level_rotation, levelled
from wheelsight.odometry.extrinsics.settings import DEFAULTS, ExtrinsicsSettings, FloorSettings
from wheelsight.odometry.extrinsics.sightings import Sightings, watch
from wheelsight.odometry.extrinsics.turning import Turning, common_turning
from wheelsight.odometry.wheels import drive_of
from wheelsight.recordings import Recording
from wheelsight.recordings.clocks import refuse_if_apart

_MOST_POINTS = 4000  # that tell what a camera's errors make of its motions: more tell the same

QUANTITIES = ("roll", "pitch", "yaw", "x", "y", "height", "delay")


@dataclass(frozen=True, eq=False)
class BaseCalibration:
    """A camera's mount and the wheels' delay, with what they were found by.

    Attributes:
        recording: its name.
        nominal: what was known before.
        T_base_camera: (4, 4).
        wheels: nominal ones with the delay found.
        values, sigmas: of each of QUANTITIES, radians, metres and seconds, see `mount_values`; and their standard
            deviations.
        camera_sigmas: the part of these that the camera's calibration leaves open, however long the drive.
        sightings, turning, floor, fit: the steps.
        warnings: one sentence each.
    """

    recording: str
    nominal: Calibration
    T_base_camera: FloatArray
    wheels: Wheels
    values: dict[str, float]
    sigmas: dict[str, float]
    camera_sigmas: dict[str, float]
    sightings: Sightings
    turning: Turning
    floor: Floor
    fit: MountFit
    warnings: tuple[str, ...] = ()

    @property
    def calibration(self) -> Calibration:
        """Mount and wheels alone, to stand in place of those of a recording."""
        source = f"mount found on {self.recording}"
        return Calibration(T_base_camera=self.T_base_camera, wheels=self.wheels, gyro=self.nominal.gyro, source=source)

    @property
    def nominal_values(self) -> dict[str, float]:
        """What was known before of QUANTITIES; the delay alone where no mount was known."""
        mount, wheels = self.nominal.T_base_camera, self.nominal.wheels
        before = {} if mount is None else mount_values(mount)
        return before if wheels is None else before | {"delay": wheels.delay_s}


def calibrate_base(
    recording: Recording,
    on_frame: Callable[[str], None] = lambda _: None,
    settings: ExtrinsicsSettings = DEFAULTS,
) -> BaseCalibration:
    """Find T_base_camera and the wheels' delay from a drive with wheels and camera.

    Args:
        recording: with nominal wheels in its calibration, sizes right to a few hundredths. A nominal T_base_camera is
            only compared with.
        on_frame: told the camera's status after each frame.
        settings: or the defaults.

    Raises:
        RecordingError: wheels and camera share hardly any time.
        CalibrationError: no wheels or camera, or a drive that does not show what is sought; says what to drive.
    """
    nominal = recording.calibration
    if nominal.wheels is None:
        raise CalibrationError(
            f"the calibration of {recording.name} ({nominal.source}) {nominal.lacks_two_wheels}",
            fix="give nominal ones in a calibration.yaml by --calibration: radii, track width, ticks a turn",
        )
    nominal.cameras  # noqa: B018  refuses a recording without, before anything is read
    refuse_if_apart(recording, settings.drive.least_shared_s)
    observability.refuse_if_hardly_moving(drive_of(recording, nominal.wheels), nominal.wheels, settings.drive)
    sightings = watch(recording, nominal.wheels, on_frame, settings.sightings)
    found = base_from(sightings, nominal, settings)
    return replace(found, recording=recording.name, warnings=(*recording.warnings, *found.warnings))


def base_from(sightings: Sightings, nominal: Calibration, settings: ExtrinsicsSettings = DEFAULTS) -> BaseCalibration:
    """The same from what a pass over a recording left; `nominal` has wheels. Raises CalibrationError."""
    wheels, drive, mount = nominal.wheels, sightings.drive, nominal.T_base_camera
    assert wheels is not None
    observability.refuse_if_apart(drive, *sightings.span_s, settings.drive)
    observability.refuse_if_lost(sightings, settings.drive)
    turning = common_turning(drive, wheels, sightings.camera, settings.turning)
    up_expected, largest_s = None if mount is None else mount[2, :3], settings.mount.largest_delay_s
    observability.refuse_if_unlike(turning, wheels, up_expected, largest_s, settings.drive)
    floor = fit_floor(sightings.views, turning.up_camera, nominal.depth_noise, settings.floor)
    observability.refuse_if_tilted(floor, turning, settings.drive)
    segments = cut_level(drive, wheels, levelled(sightings.camera, floor.up_camera), settings.mount)
    observability.refuse_if_few(len(segments), settings.drive)
    errors = level_errors(sightings.views, floor, nominal, settings.floor)
    fit = fit_mount(drive, wheels, segments, turning.delay_s, settings.mount, settings.fit, errors)
    observability.refuse_if_out_of_scale(wheels, fit.wheels, settings.drive)
    T_base_camera = _mount(fit, floor)
    values = mount_values(T_base_camera) | {"delay": fit.wheels.delay_s}
    by_drive = _sigmas(fit.covariance, floor.covariance)
    observability.refuse_if_unobservable(by_drive, fit, settings.drive)
    by_camera = _sigmas(fit.by_camera, floor.by_camera(moved_in_camera_m(nominal, floor.points_m)))
    sigmas = {name: float(np.hypot(by_drive[name], by_camera[name])) for name in QUANTITIES}
    late = replace(wheels, delay_s=fit.wheels.delay_s)
    told = (T_base_camera, late, values, sigmas, by_camera, sightings, turning, floor, fit)
    doubts = (*_doubts(T_base_camera, mount, settings), *_uncalibrated(nominal, by_camera))
    return BaseCalibration("", nominal, *told, doubts)


def mount_values(T_base_camera: FloatArray) -> dict[str, float]:
    """roll, pitch, yaw (how far a camera (4, 4) leans right, looks down, looks left) and x, y, height of it."""
    roll, pitch = tilt_of(T_base_camera[2, :3])
    yaw = np.arctan2(T_base_camera[1, 2], T_base_camera[0, 2])
    names = ("roll", "pitch", "yaw", "x", "y", "height")
    return dict(zip(names, map(float, (roll, pitch, yaw, *T_base_camera[:3, 3])), strict=True))


def _mount(fit: MountFit, floor: Floor) -> FloatArray:
    x, y, yaw = fit.mount
    T_base_level = se3.from_plane(x, y, yaw)
    T_base_level[2, 3] = floor.height_m
    T_level_camera = se3.invert(se3.from_parts(level_rotation(floor.up_camera), np.zeros(3)))
    return T_base_level @ T_level_camera


def level_errors(
    views: FloorViews, floor: Floor, calibration: Calibration, settings: FloorSettings = DEFAULTS.floor
) -> FloatArray:
    """`motion_errors` (K, 3, 3) of the levelled camera, by some of the points that views show."""
    noise = calibration.depth_noise
    view, pixel = np.nonzero((views.depth_m > noise.near_m) & (views.depth_m < min(noise.far_m, settings.farthest_m)))
    some = np.linspace(0, len(view) - 1, min(len(view), _MOST_POINTS)).astype(int)
    depth_m = views.depth_m[view[some], pixel[some]]
    points_m = views.rays[pixel[some]] * depth_m[:, None]
    T_level_camera = se3.invert(se3.from_parts(level_rotation(floor.up_camera), np.zeros(3)))
    return motion_errors(calibration, T_level_camera, points_m)


def _sigmas(of_mount: FloatArray, of_floor: FloatArray) -> dict[str, float]:
    roll, pitch, height = np.sqrt(np.diag(of_floor)).tolist()
    x, y, yaw, delay = np.sqrt(np.diag(of_mount)[3:7]).tolist()
    return dict(zip(QUANTITIES, (roll, pitch, yaw, x, y, height, delay), strict=True))


def _uncalibrated(nominal: Calibration, by_camera: dict[str, float]) -> tuple[str, ...]:
    """What it costs that no board says how far off the camera's points are."""
    if nominal.point_errors is not None:
        return ()
    turn_deg = np.degrees(max(by_camera[name] for name in ("roll", "pitch", "yaw")))
    way_mm = 1e3 * max(by_camera[name] for name in ("x", "y", "height"))
    return (
        "The camera's calibration does not say how sure it is, as one by a board does: by what nominal values are off, "
        f"the mount is unsure by {turn_deg:.1f}° and {way_mm:.0f} mm, as σ says (wheelsight calibrate camera).",
    )


def _doubts(T_base_camera: FloatArray, nominal: FloatArray | None, settings: ExtrinsicsSettings) -> tuple[str, ...]:
    if nominal is None:
        return ()
    cosine = (np.trace(nominal[:3, :3].T @ T_base_camera[:3, :3]) - 1) / 2
    off_rad = float(np.arccos(np.clip(cosine, -1, 1)))
    if off_rad < np.radians(settings.drive.far_off_deg):
        return ()
    return (
        f"The camera looks {np.degrees(off_rad):.0f}° away from where its nominal mount says: if it does not, "
        "the wheels may count backwards.",
    )
