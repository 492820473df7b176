"""Calibration of wheels against a reference trajectory: both radii, track width and clock delay by least squares.

The reference, ground truth or visual odometry, is cut into short segments. `fit_wheels` seeks the sizes and the delay
for which the motions of the wheels differ least from those of the reference, along, across, and in yaw. The reference's
body, a marker or a camera, may sit off the middle of the axle, so its mount is fitted as well. Segments with slip or a
jump of the reference lose their weight (`solver`).

`try_calibration` fits on the first part of a recording and evaluates on the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError, EvaluationError
from wheelsight.core.geometry import BoolArray, FloatArray, se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import Evaluation, evaluate
from wheelsight.io.recordings import HasClocksOfItsOwn, Recording
from wheelsight.io.recordings.recording import express_for
from wheelsight_calibration.motion_errors import typical_motion_errors
from wheelsight_calibration.parameters import LARGEST_DELAY_S, WHEELS_BY_REFERENCE, DriveProblem, stated
from wheelsight_calibration.solver import robust_fit, spread
from wheelsight_calibration.wheel_drive import Segments, WheelDrive, cut, drive_of, drive_path

PARAMETERS = ("left_radius_m", "right_radius_m", "track_width_m", "delay_s")

_FEWEST_SEGMENTS = 12
_COARSE_STEP_S = 0.02


@dataclass(frozen=True, eq=False)
class WheelFit:
    """Wheels fitted to a reference.

    Attributes:
        nominal, wheels: before and after.
        sigmas: standard deviation of each fitted parameter of PARAMETERS, by name, in its unit.
        ratio_sigma: standard deviation of right radius over left, far smaller than that of a single radius.
        mount: (3,) x, y in metres and yaw in radians of T_axle_body, the fitted pose of the reference's body.
        segments: of the reference.
        residuals: (M, 3) of the fitted wheels, along and across each segment in metres, yaw in radians.
        weights: (M,) 0 to 1 of the segments; about 0 for slip.
        is_slip: (M,) whether the residual exceeds that of one in a thousand segments without slip.
    """

    nominal: Wheels
    wheels: Wheels
    sigmas: dict[str, float]
    ratio_sigma: float
    mount: FloatArray
    segments: Segments
    residuals: FloatArray
    weights: FloatArray
    is_slip: BoolArray

    @property
    def spread(self) -> FloatArray:
        """Robust standard deviation (3,) of the residuals of a segment: along, across in metres, yaw in radians."""
        return spread(self.residuals)


def fit_wheels(
    wheels: Wheels,
    drive: WheelDrive,
    reference: Trajectory,
    *,
    segment_m: float = 1.0,
    with_delay: bool = True,
    on_step: Callable[[str], None] = lambda _: None,
    camera_errors: FloatArray | None = None,
) -> WheelFit:
    """Return the wheels that explain `reference`, with standard deviations. An error states a suitable drive.

    Args:
        wheels: nominal ones: radii and track width within a factor of two, delay within half a second.
        drive: readings of both wheels.
        reference: T_odom_base, accurate to decimetres and degrees (of the camera: `recordings.bodies.express_for`).
        segment_m: length of a segment: long for a noisy reference, short for frequent slip.
        with_delay: whether to fit `delay_s`; else the nominal one stays.
        on_step: called with the name of each step.
        camera_errors: (K, 3, 3) of the base, for a reference by a camera (`camera_errors.motion_errors`); added to σ.

    Raises:
        CalibrationError: a drive that is too short or does not determine all, or a reference of another drive or body.
    """
    if reference.body != "base":
        raise CalibrationError(
            f"the reference is of the {reference.body}, but wheels move the base", fix="give T_base_camera to join them"
        )
    segments = cut(drive, reference, wheels, segment_m, LARGEST_DELAY_S + abs(wheels.delay_s))
    if len(segments) < _FEWEST_SEGMENTS:
        raise CalibrationError(
            f"the drive holds {len(segments)} pieces of {segment_m:g} m or a radian with readings and reference, "
            f"{_FEWEST_SEGMENTS} are needed",
            fix="drive further, turning both ways, or choose a larger part of the recording",
        )
    parameters = WHEELS_BY_REFERENCE if with_delay else WHEELS_BY_REFERENCE[:6]
    problem = DriveProblem(parameters, drive, segments, wheels, wheels.delay_s, np.zeros(3))
    on_step("searching the delay")
    start = _coarse(problem)
    on_step("fitting")
    found = robust_fit(problem, start)
    values, fitted = found.values, problem.fitted(found.values)
    refuse_if_unlike(segments, found.residuals, drive, fitted.delay_s)
    refuse_if_unobservable(_sigmas(problem, values, found.covariance), fitted, segments)
    refuse_if_impossible(wheels, fitted, LARGEST_DELAY_S)
    covariance = found.covariance + (0 if camera_errors is None else problem.covariance_by(found, camera_errors))
    sigmas = _sigmas(problem, values, covariance)
    difference = np.array([-1, 1]) @ covariance[:2, :2] @ np.array([-1, 1])
    ratio_sigma = float(fitted.right_radius_m / fitted.left_radius_m * np.sqrt(difference))
    # Of the mean of both radii' logarithms, in which common errors add up.
    scale_sigma = float(np.sqrt(covariance[:2, :2].sum()) / 2)
    known = stated(fitted, ratio_sigma, sigmas["track_width_m"] / fitted.track_width_m, scale_sigma)
    explained = (found.residuals, found.weights, found.is_outlier)
    return WheelFit(wheels, known, sigmas, ratio_sigma, problem.mount(values), segments, *explained)


def _coarse(problem: DriveProblem) -> FloatArray:
    """Return nominal values with the delay for which wheel angles fit the reference best, in a linear model."""
    values = np.zeros(len(problem.bounds))
    if len(values) < len(WHEELS_BY_REFERENCE):
        return values
    segments, drive = problem.segments, problem.drive
    yaw_rad = segments.motions[:, 2]
    along_m = chords_m(segments) / np.sinc(yaw_rad / (2 * np.pi))
    steps = round(LARGEST_DELAY_S / _COARSE_STEP_S)
    delays_s = _COARSE_STEP_S * np.arange(-steps, steps + 1)
    misfits = np.zeros(len(delays_s))
    for i, delay_s in enumerate(delays_s):
        clock_s = problem.nominal.delay_s + delay_s
        start, end = (drive.angles_at(s + clock_s) for s in (segments.start_s, segments.end_s))
        turned = np.stack([end[0] - start[0], end[1] - start[1]], axis=-1)
        for wanted in (along_m, yaw_rad):
            # Logarithm of the mean squared residual, with residuals limited to three spreads.
            off = wanted - turned @ np.linalg.lstsq(turned, wanted)[0]
            limit = 3 * max(float(spread(off[:, None])[0]), 1e-9)
            misfits[i] += float(np.log(np.mean(np.minimum(off**2, limit**2)) + 1e-12))
    values[6] = delays_s[np.argmin(misfits)]
    return values


def _sigmas(problem: DriveProblem, values: FloatArray, covariance: FloatArray) -> dict[str, float]:
    deviations = np.sqrt(np.diag(covariance))
    found = dict(zip(PARAMETERS, (problem.sizes_m(values) * deviations[:3]).tolist(), strict=False))
    return found | ({"delay_s": float(deviations[6])} if len(values) > 6 else {})


@dataclass(frozen=True, eq=False)
class Attempt:
    """Dead reckoning of the part of a recording that was not used for the fit.

    Attributes:
        path: T_odom_base at the reference's stamps, from the reference's first pose there.
        evaluation: of the path.
        end_error_m: distance of its end from the reference.
    """

    path: Trajectory
    evaluation: Evaluation
    end_error_m: float

    @classmethod
    def of(cls, drive: WheelDrive, wheels: Wheels, held_out: Trajectory) -> Attempt:
        """Evaluate wheels on a part of the reference. Raises CalibrationError if it is too short."""
        path = drive_path(drive, wheels, held_out.stamps_s)
        if len(path):
            T_there_here = held_out.T_frame_body[0] @ se3.invert(path.T_frame_body[0])
            path = Trajectory(path.stamps_s, T_there_here @ path.T_frame_body, body="base", frame=held_out.frame)
        try:
            evaluation = evaluate(path, held_out)
        except EvaluationError as error:
            raise CalibrationError(
                f"too little is left to try the wheels on: {error}", fix="calibrate on a smaller share"
            ) from error
        end_error_m = float(np.linalg.norm(path.positions_m[-1] - held_out.positions_m[-1]))
        return cls(path, evaluation, end_error_m)


@dataclass(frozen=True, eq=False)
class WheelTrial:
    """A calibration and its evaluation.

    Attributes:
        recording: its name.
        fit: to the part before `split_s`, a stamp in seconds.
        reference: of the whole recording, T_odom_base.
        held_out: the part of the reference after `split_s`, of the middle of the axle (by `fit.mount`).
        before, after: nominal and fitted wheels on that part.
        warnings: of the recording, one sentence each.
    """

    recording: str
    fit: WheelFit
    reference: Trajectory
    split_s: float
    held_out: Trajectory
    before: Attempt
    after: Attempt
    warnings: tuple[str, ...] = ()


def try_calibration(
    recording: Recording,
    reference: Trajectory | None = None,
    *,
    train_share: float = 0.5,
    segment_m: float = 1.0,
    with_delay: bool = True,
    by_camera: bool = False,
    on_step: Callable[[str], None] = lambda _: None,
) -> WheelTrial:
    """Fit a recording's wheels to the first `train_share` of the time of `reference`; evaluate on the rest.

    Args:
        recording: with wheel readings, and nominal wheels in its calibration.
        reference: of the base or the camera; None for the recording's ground truth.
        train_share: between 0 and 1.
        by_camera: whether the reference is by the robot's camera: σ then has the errors of its calibration.
        segment_m, with_delay, on_step: see `fit_wheels`.

    Raises:
        CalibrationError: no wheels, no reference, a camera's reference without T_base_camera, a drive that does not
            determine the wheels (see `fit_wheels`), or too short a rest.
    """
    if not 0 < train_share < 1:
        raise CalibrationError(f"the share to calibrate on is {train_share:g}, not between 0 and 1")
    recording = recording.as_stamped() if isinstance(recording, HasClocksOfItsOwn) else recording
    nominal = recording.calibration.wheels
    if nominal is None:
        raise CalibrationError(
            f"the calibration of {recording.name} ({recording.calibration.source}) has no wheels",
            fix="give nominal ones in a calibration.yaml by --calibration: radii, track width, ticks a turn",
        )
    on_step("reading")
    reference = reference or recording.ground_truth
    if reference is None:
        raise CalibrationError(
            f"{recording.name} has no ground truth to calibrate against",
            fix="give a trajectory with --reference, such as visual odometry's of this very recording",
        )
    reference = express_for("base", reference, recording.calibration)
    drive = drive_of(recording, nominal)
    common = reference.between(*(drive.stamps_s[[0, -1]] - nominal.delay_s))
    split_s = float(common.stamps_s[0] + train_share * common.duration_s) if len(common) else reference.stamps_s[0]
    seen = reference.between(-np.inf, split_s) if len(common) else reference
    known = recording.calibration
    is_known = by_camera and known.color is not None and known.T_base_camera is not None
    errors = typical_motion_errors(known) if is_known else None
    fit = fit_wheels(
        nominal, drive, seen, segment_m=segment_m, with_delay=with_delay, on_step=on_step, camera_errors=errors
    )
    rest, T_body_axle = common.between(split_s, np.inf), se3.invert(se3.from_plane(*fit.mount))
    held_out = Trajectory(rest.stamps_s, rest.T_frame_body @ T_body_axle, body="base", frame=rest.frame)
    on_step("trying on the rest")
    before, after = (Attempt.of(drive, wheels, held_out) for wheels in (nominal, fit.wheels))
    return WheelTrial(recording.name, fit, reference, split_s, held_out, before, after, recording.warnings)


_MOST_UNCERTAIN_SHARE = 0.03  # that of a tape measure
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


def refuse_if_unlike(segments: Segments, residuals: FloatArray, drive: WheelDrive, delay_s: float) -> None:
    """Raise CalibrationError if the best wheels leave most of the reference's motion unexplained.

    Args:
        segments: M of the reference.
        residuals: (M, 3) of the fitted wheels.
        drive: readings of both wheels, which show swapped wheels.
        delay_s: of the readings.
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
        f"wheels and reference are not of one drive: where a segment goes {way_m:.2g} m, {way_left_m:.2g} m stay "
        f"unexplained, and {np.degrees(turning_left_rad):.2g}° where it turns by {np.degrees(turning_rad):.2g}°",
        fix=fix,
    )


def refuse_if_unobservable(sigmas: dict[str, float], wheels: Wheels, segments: Segments) -> None:
    """Raise CalibrationError if a standard deviation exceeds that of a tape measure."""
    allowed = {name: _MOST_UNCERTAIN_SHARE * float(getattr(wheels, name)) for name in PARAMETERS[:3]}
    allowed["delay_s"] = _MOST_UNCERTAIN_DELAY_S
    vague = [name for name, sigma in sigmas.items() if not sigma <= allowed[name]]
    if vague:
        shown = {"delay_s": f"{sigmas.get('delay_s', 0.0):.2g} s"}
        for name in PARAMETERS[:3]:
            share = sigmas[name] / float(getattr(wheels, name))
            shown[name] = f"{100 * share:.2g} %" if share < 1 else "over 100 %"
        names = ", ".join(f"{_NAMES[name]} (σ {shown[name]})" for name in vague)
        raise CalibrationError(f"the drive does not determine: {names}", fix=_advice(vague, segments))


def refuse_if_impossible(nominal: Wheels, fitted: Wheels, largest_delay_s: float) -> None:
    """Raise CalibrationError for a fit that is too far from nominal."""
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
    """Return the distance (M,) along each segment's chord, negative backwards."""
    x, y, yaw_rad = segments.motions.T
    return np.asarray(x * np.cos(yaw_rad / 2) + y * np.sin(yaw_rad / 2))


def _typical(motion: FloatArray, residual: FloatArray) -> tuple[float, float]:
    """Return the medians of absolute motion (M,) and residual (M,) over the moving segments."""
    moving = np.abs(motion) >= 0.5 * np.sqrt(np.mean(motion**2))
    return float(np.median(np.abs(motion[moving]))), float(np.median(np.abs(residual[moving])))


def _advice(vague: list[str], segments: Segments) -> str:
    """Return a drive that determines the parameters."""
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
    """Return the cosine between (M,) and (M,), -1 to 1."""
    size = float(np.sqrt(np.sum(a**2) * np.sum(b**2)))
    return float(np.sum(a * b)) / size if size > 0 else 0.0
