"""`calibrate_base` returns the mount of a camera and the clock offset of the wheels. It refuses drives in which
these are not observable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.camera_errors import moved_in_camera_m
from wheelsight.core.checks import Repeats
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.messages import RgbdFrame, SkippedFrame
from wheelsight.core.settings.calibration import ExtrinsicsSettings, MountSigmaSettings
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import HasClocksOfItsOwn, Recording
from wheelsight.io.recordings.clock_checks import apart, refuse_if_apart
from wheelsight.vision.dense import DenseOdometry
from wheelsight_calibration.motion_errors import motion_errors
from wheelsight_calibration.mount import (
    FloorDepths,
    FloorFit,
    MountFit,
    Turning,
    common_turning,
    cut_level,
    fit_floor,
    fit_mount,
    level_rotation,
    levelled,
    tilt_of,
)
from wheelsight_calibration.parameters import LARGEST_DELAY_S
from wheelsight_calibration.wheel_drive import WheelDrive, drive_of, drive_path

WHAT_TO_DRIVE = "drive a minute or two as usual, straight and with turns both ways, some of them on the spot"

_TILT, _PLACE = ("roll", "pitch", "yaw"), ("x", "y", "height")

# What a drive must show; chosen. Interval at which the wheels' rotations are added up, and the least distance and
# rotation: without rotations x and y are unobservable, without distance the yaw.
_SAMPLE_S, _LEAST_WAY_M, _LEAST_TURN_RAD = 0.5, 2.0, 1.0
_LEAST_SHARED_S = 5.0  # time in which readings and frames overlap
_FEWEST_TRACKED, _LEAST_TRACKED_SHARE = 50, 0.5  # frames
_LEAST_AGREEMENT = 0.6  # correlation of the rotations of wheels and camera
_FEWEST_SEGMENTS = 24  # pieces, to estimate their spread
_MOST_TILT_DEG = 4.0  # of the floor against the axis of rotation
_LARGEST_FACTOR = 1.25  # of the wheels' sizes relative to nominal ones
_FAR_OFF_DEG = 30.0  # of the mount from its nominal one, beyond which a warning follows


def refuse_if_hardly_moving(drive: WheelDrive, wheels: Wheels) -> None:
    """Raise CalibrationError if the wheels alone show that the drive is unsuitable, before any image is read."""
    samples = np.arange(drive.stamps_s[0], drive.stamps_s[-1], _SAMPLE_S)
    if len(samples) < 2:
        raise CalibrationError(f"the wheel readings span {np.ptp(drive.stamps_s):.2f} s only", fix=WHAT_TO_DRIVE)
    path = drive_path(drive, wheels, samples - wheels.delay_s)
    yaw_rad = np.unwrap(np.arctan2(path.T_frame_body[:, 1, 0], path.T_frame_body[:, 0, 0]))
    turned_rad = float(np.abs(np.diff(yaw_rad)).sum())
    if path.length_m < _LEAST_WAY_M and turned_rad < _LEAST_TURN_RAD:
        raise CalibrationError(f"by its wheels the robot stands, it goes {path.length_m:.2f} m", fix=WHAT_TO_DRIVE)
    if turned_rad < _LEAST_TURN_RAD:
        raise CalibrationError(
            f"the drive hardly turns, by {np.degrees(turned_rad):.0f}° in all: x and y of the camera stay unseen",
            fix="drive some turns too, both ways, also on the spot",
        )
    if path.length_m < _LEAST_WAY_M:
        raise CalibrationError(
            f"the robot hardly leaves its place, it goes {path.length_m:.2f} m: where the camera looks stays unseen",
            fix="drive straight for some metres too",
        )


def refuse_if_lost(sightings: Sightings) -> None:
    """Raise CalibrationError if frames hardly overlap in time with the readings, or the camera was mostly lost."""
    stamps_s = sightings.drive.stamps_s
    problem = apart((float(stamps_s[0]), float(stamps_s[-1])), sightings.span_s, _LEAST_SHARED_S)
    if problem is not None:
        raise CalibrationError(problem[0], fix=problem[1])
    tracked, total = len(sightings.camera), sightings.frame_count
    if tracked < max(_FEWEST_TRACKED, _LEAST_TRACKED_SHARE * total):
        raise CalibrationError(
            f"the camera could be followed in {tracked} of {total} frames only",
            fix="drive slowly, past things one to four metres away, not at bare walls alone",
        )


def refuse_if_unlike(turning: Turning, wheels: Wheels, up_expected: FloatArray | None) -> None:
    """Raise CalibrationError if wheels and camera turn differently, or if their delay is too large.

    `up_expected` (3,) is up in the camera frame by the nominal mount, or None.
    """
    if turning.agreement < _LEAST_AGREEMENT:
        raise CalibrationError(
            "wheels and camera do not turn together: their turns agree by "
            f"{100 * turning.agreement:.0f} %, less than {100 * _LEAST_AGREEMENT:.0f} %",
            fix=f"see that both are of one drive and their clocks at most 10 s apart, and {WHAT_TO_DRIVE}",
        )
    up = np.array([0.0, -1.0, 0.0]) if up_expected is None else up_expected
    if turning.up_camera @ up < -0.5:
        raise CalibrationError(
            "the camera turns left where the wheels turn right",
            fix="swap left and right wheel, or, for a camera that hangs upside down, give T_base_camera roughly",
        )
    change_s = turning.delay_s - wheels.delay_s
    if abs(change_s) > LARGEST_DELAY_S:
        raise CalibrationError(
            f"the wheels' stamps seem {change_s:+.2f} s late, more than the ±{LARGEST_DELAY_S:g} s that are searched",
            fix=f"give wheels.delay_s: {turning.delay_s:.2f} by --calibration, or correct the clocks",
        )


def refuse_if_tilted(floor: FloorFit, turning: Turning) -> None:
    """Raise CalibrationError if the plane in view is not the one on which the robot turns."""
    off_rad = float(np.arccos(np.clip(floor.up_camera @ turning.up_camera, -1, 1)))
    if off_rad > np.radians(_MOST_TILT_DEG):
        raise CalibrationError(
            f"the plane under the camera leans by {np.degrees(off_rad):.1f}° against the one that the robot turns on",
            fix="drive on level ground with free floor before the camera",
        )


def refuse_if_unobservable(sigmas: Mapping[str, float], fit: MountFit, settings: MountSigmaSettings) -> None:
    """Raise CalibrationError if a standard deviation exceeds that of a measurement with protractor and tape."""
    most = dict.fromkeys(_TILT, float(np.radians(settings.most_uncertain_deg)))
    most |= dict.fromkeys(_PLACE, settings.most_uncertain_m) | {"delay": settings.most_uncertain_s}
    vague = [name for name, sigma in sigmas.items() if not sigma <= most[name]]
    if not vague:
        return
    units = dict.fromkeys(_TILT, (180 / math.pi, "°")) | dict.fromkeys(_PLACE, (100.0, " cm")) | {"delay": (1e3, " ms")}
    names = ", ".join(f"{name} (σ {units[name][0] * sigmas[name]:.2g}{units[name][1]})" for name in vague)
    fix, turn_rad = WHAT_TO_DRIVE.replace("a minute or two", "longer"), fit.segments.motions[:, 2]
    left_rad, right_rad = turn_rad[turn_rad > 0].sum(), -turn_rad[turn_rad < 0].sum()
    if vague == ["delay"]:
        fix = "start, stop and turn now and then, as steady motion hides the delay"
    elif min(left_rad, right_rad) < 0.1 * max(left_rad, right_rad):
        fix = "the drive turns one way only: turn the other way too"
    raise CalibrationError(f"the drive does not determine: {names}", fix=fix)


def refuse_if_out_of_scale(nominal: Wheels, fitted: Wheels) -> None:
    """Raise CalibrationError if the scales of camera and wheels differ too much for nominal wheel sizes."""
    factor = (fitted.left_radius_m + fitted.right_radius_m) / (nominal.left_radius_m + nominal.right_radius_m)
    if not 1 / _LARGEST_FACTOR < factor < _LARGEST_FACTOR:
        raise CalibrationError(
            f"distances by the camera are {factor:.2f} times those by the wheels",
            fix="check the depth factor, the wheels' radii and ticks_per_turn",
        )


@dataclass(frozen=True, eq=False)
class Sightings:
    """The data of one drive that calibration needs.

    Attributes:
        drive: the wheels' readings.
        camera: T_map_camera by dense odometry of the frames with all directions constrained; the map is the first one.
        frame_count: number of all frames, lost ones included.
        span_s: stamps of the first and last of them; NaN without any.
        views: thinned depth images.
    """

    drive: WheelDrive
    camera: Trajectory
    frame_count: int
    span_s: tuple[float, float]
    views: FloorDepths


def watch(recording: Recording, wheels: Wheels, on_frame: Callable[[str], None] = lambda _: None) -> Sightings:
    """Read a recording once, wheels and images.

    Args:
        recording: with wheel readings and a camera.
        wheels: what its counters count.
        on_frame: called with the camera's status after each frame.

    Raises:
        CalibrationError: fewer than two wheel readings, or no camera.
    """
    drive = drive_of(recording, wheels)
    _, depth_camera = recording.calibration.cameras
    odometry = DenseOdometry(recording.calibration)
    gatherer = _ViewGatherer(depth_camera)
    poses, repeats = list[tuple[float, FloatArray]](), Repeats()
    frame_count, span_s = 0, (math.nan, math.nan)
    for event in recording.events():
        if isinstance(event, SkippedFrame):
            estimate = odometry.miss(event.stamp_s)
        elif isinstance(event, RgbdFrame):
            if repeats.lasting_s(event) > 0:
                continue
            estimate = odometry.process(event)
            gatherer.add(event)
        else:
            continue
        frame_count, span_s = frame_count + 1, (event.stamp_s if not frame_count else span_s[0], event.stamp_s)
        if estimate.T_odom_body is not None and estimate.motion.shows_all:
            poses.append((estimate.stamp_s, estimate.T_odom_body))
        on_frame(estimate.status)
    odometry.store.close()
    return Sightings(
        drive,
        Trajectory(np.array([stamp_s for stamp_s, _ in poses]), np.array([T for _, T in poses]).reshape(-1, 4, 4)),
        frame_count,
        span_s,
        gatherer.views,
    )


# Rows of the grid that depth images are thinned to, the interval between views, which doubles if more are kept than the
# last figure; chosen.
_GRID_ROWS, _FIRST_PERIOD_S, _MOST_VIEWS = 30, 0.5, 400


class _ViewGatherer:
    """Keeps a coarse grid of depth at intervals that double as the drive grows, so that memory stays bounded."""

    def __init__(self, camera: PinholeCamera) -> None:
        step = max(1, camera.height // _GRID_ROWS)
        self._grid = np.s_[step // 2 :: step, step // 2 :: step]
        self._rays = camera.rays()[self._grid].reshape(-1, 3)
        self._stamps_s: list[float] = []
        self._depths_m: list[Float32Array] = []
        self._period_s = _FIRST_PERIOD_S

    def add(self, frame: RgbdFrame) -> None:
        if self._stamps_s and frame.stamp_s < self._stamps_s[-1] + self._period_s:
            return
        self._stamps_s.append(frame.stamp_s)
        self._depths_m.append(frame.depth_m[self._grid].ravel())
        if len(self._stamps_s) > _MOST_VIEWS:
            del self._stamps_s[1::2], self._depths_m[1::2]
            self._period_s *= 2

    @property
    def views(self) -> FloorDepths:
        depth_m = np.array(self._depths_m, np.float64).reshape(len(self._stamps_s), len(self._rays))
        return FloorDepths(np.array(self._stamps_s), self._rays, depth_m)


_MOST_POINTS = 4000  # that propagate the camera's errors to its motions; more give the same result

QUANTITIES = ("roll", "pitch", "yaw", "x", "y", "height", "delay")


@dataclass(frozen=True, eq=False)
class BaseCalibration:
    """A camera's mount and the wheels' delay, with intermediate results.

    Attributes:
        recording: name of the recording.
        nominal: the calibration before.
        T_base_camera: (4, 4).
        wheels: the nominal wheels with the estimated delay.
        values, sigmas: each of QUANTITIES in radians, metres and seconds (see `mount_values`), and its standard
            deviation.
        camera_sigmas: the part of `sigmas` by the camera's calibration, which a longer drive does not reduce.
        sightings, turning, floor, fit: results of the steps.
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
    floor: FloorFit
    fit: MountFit
    warnings: tuple[str, ...] = ()

    @property
    def calibration(self) -> Calibration:
        """Mount and wheels alone, to replace those of a recording."""
        source = f"mount found on {self.recording}"
        return Calibration(T_base_camera=self.T_base_camera, wheels=self.wheels, gyro=self.nominal.gyro, source=source)

    @property
    def nominal_values(self) -> dict[str, float]:
        """The nominal values of QUANTITIES; the delay alone without a nominal mount."""
        mount, wheels = self.nominal.T_base_camera, self.nominal.wheels
        before = {} if mount is None else mount_values(mount)
        return before if wheels is None else before | {"delay": wheels.delay_s}


def calibrate_base(
    recording: Recording, on_frame: Callable[[str], None] = lambda _: None, settings: ExtrinsicsSettings | None = None
) -> BaseCalibration:
    """Estimate T_base_camera and the wheels' delay from a drive with wheels and camera.

    Rotations of the robot give the vertical axis in the camera frame, and the delay roughly. The floor in depth images
    gives roll, pitch and height. The motions of wheels and levelled camera give yaw, x, y and the delay.

    Args:
        recording: its calibration has nominal wheels with sizes correct to a few percent. A nominal T_base_camera only
            serves for comparison.
        on_frame: called with the camera's status after each frame.
        settings: default `ExtrinsicsSettings()`.

    Raises:
        RecordingError: wheels and camera hardly overlap in time.
        CalibrationError: no wheels or no camera, or an unobservable quantity; the fix says what to drive.
    """
    recording = recording.as_stamped() if isinstance(recording, HasClocksOfItsOwn) else recording
    nominal = recording.calibration
    if nominal.wheels is None:
        raise CalibrationError(
            f"the calibration of {recording.name} ({nominal.source}) {nominal.lacks_two_wheels}",
            fix="give nominal ones in a calibration.yaml by --calibration: radii, track width, ticks a turn",
        )
    nominal.cameras  # noqa: B018  refuses a recording without, before anything is read
    refuse_if_apart(recording, _LEAST_SHARED_S)
    refuse_if_hardly_moving(drive_of(recording, nominal.wheels), nominal.wheels)
    sightings = watch(recording, nominal.wheels, on_frame)
    found = base_from(sightings, nominal, settings)
    return replace(found, recording=recording.name, warnings=(*recording.warnings, *found.warnings))


def base_from(
    sightings: Sightings, nominal: Calibration, settings: ExtrinsicsSettings | None = None
) -> BaseCalibration:
    """`calibrate_base` for the data of a recording; `nominal` has wheels. Raises CalibrationError."""
    settings = settings or ExtrinsicsSettings()
    wheels, drive, mount = nominal.wheels, sightings.drive, nominal.T_base_camera
    assert wheels is not None
    refuse_if_lost(sightings)
    turning = common_turning(drive, wheels, sightings.camera)
    refuse_if_unlike(turning, wheels, None if mount is None else mount[2, :3])
    floor = fit_floor(sightings.views, turning.up_camera, nominal.depth_noise, settings.floor)
    refuse_if_tilted(floor, turning)
    segments = cut_level(drive, wheels, levelled(sightings.camera, floor.up_camera))
    if len(segments) < _FEWEST_SEGMENTS:
        raise CalibrationError(
            f"the drive holds {len(segments)} pieces of a third of a metre or a quarter of a radian with readings and "
            f"frames, {_FEWEST_SEGMENTS} are needed",
            fix=WHAT_TO_DRIVE,
        )
    errors = level_errors(sightings.views, floor, nominal, settings.floor.farthest_m)
    fit = fit_mount(drive, wheels, segments, turning.delay_s, errors)
    refuse_if_out_of_scale(wheels, fit.wheels)
    x, y, yaw = fit.mount
    T_base_level = se3.from_plane(x, y, yaw)
    T_base_level[2, 3] = floor.height_m
    T_level_camera = se3.invert(se3.from_parts(level_rotation(floor.up_camera), np.zeros(3)))
    T_base_camera = T_base_level @ T_level_camera
    values = mount_values(T_base_camera) | {"delay": fit.wheels.delay_s}
    by_drive = _sigmas(fit.covariance, floor.covariance)
    refuse_if_unobservable(by_drive, fit, settings.drive)
    by_camera = _sigmas(fit.by_camera, floor.by_camera(moved_in_camera_m(nominal, floor.points_m)))
    sigmas = {name: float(np.hypot(by_drive[name], by_camera[name])) for name in QUANTITIES}
    warnings = []
    if nominal.T_base_camera is not None:
        cosine = (np.trace(nominal.T_base_camera[:3, :3].T @ T_base_camera[:3, :3]) - 1) / 2
        off_rad = float(np.arccos(np.clip(cosine, -1, 1)))
        if off_rad >= np.radians(_FAR_OFF_DEG):
            warnings.append(
                f"The camera looks {np.degrees(off_rad):.0f}° away from where its nominal mount says: if it does not, "
                "the wheels may count backwards."
            )
    if nominal.point_errors is None:
        turn_deg = np.degrees(max(by_camera[name] for name in ("roll", "pitch", "yaw")))
        way_mm = 1e3 * max(by_camera[name] for name in ("x", "y", "height"))
        warnings.append(
            "The camera's calibration does not say how sure it is, as one by a board does: by what nominal values are "
            f"off, the mount is unsure by {turn_deg:.1f}° and {way_mm:.0f} mm, as σ says (wheelsight calibrate camera)."
        )
    late = replace(wheels, delay_s=fit.wheels.delay_s)
    found = (T_base_camera, late, values, sigmas, by_camera, sightings, turning, floor, fit)
    return BaseCalibration("", nominal, *found, tuple(warnings))


def mount_values(T_base_camera: FloatArray) -> dict[str, float]:
    """roll, pitch, yaw of a camera (4, 4), positive to the right, down and left, and its x, y, height."""
    roll, pitch = tilt_of(T_base_camera[2, :3])
    yaw = np.arctan2(T_base_camera[1, 2], T_base_camera[0, 2])
    names = ("roll", "pitch", "yaw", "x", "y", "height")
    return dict(zip(names, map(float, (roll, pitch, yaw, *T_base_camera[:3, 3])), strict=True))


def level_errors(views: FloorDepths, floor: FloorFit, calibration: Calibration, farthest_m: float) -> FloatArray:
    """`motion_errors` (K, 3, 3) of the levelled camera, by a sample of the points in views."""
    noise = calibration.depth_noise
    view, pixel = np.nonzero((views.depth_m > noise.near_m) & (views.depth_m < min(noise.far_m, farthest_m)))
    some = np.linspace(0, len(view) - 1, min(len(view), _MOST_POINTS)).astype(int)
    depth_m = views.depth_m[view[some], pixel[some]]
    points_m = views.rays[pixel[some]] * depth_m[:, None]
    T_level_camera = se3.invert(se3.from_parts(level_rotation(floor.up_camera), np.zeros(3)))
    return motion_errors(calibration, T_level_camera, points_m)


def _sigmas(of_mount: FloatArray, of_floor: FloatArray) -> dict[str, float]:
    roll, pitch, height = np.sqrt(np.diag(of_floor)).tolist()
    x, y, yaw, delay = np.sqrt(np.diag(of_mount)[3:7]).tolist()
    return dict(zip(QUANTITIES, (roll, pitch, yaw, x, y, height, delay), strict=True))
