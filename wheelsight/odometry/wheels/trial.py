"""WheelTrial: wheels calibrated on the first part of a recording and tried on the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import Calibration, Wheels
from wheelsight.errors import CalibrationError, EvaluationError
from wheelsight.evaluation import Evaluation, evaluate
from wheelsight.geometry import FloatArray, se3
from wheelsight.odometry.camera_errors import typical_motion_errors
from wheelsight.odometry.wheels.drive import Drive, drive_of, drive_path
from wheelsight.odometry.wheels.fit import WheelFit, fit_wheels
from wheelsight.recordings import Recording
from wheelsight.recordings.bodies import express_for
from wheelsight.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Attempt:
    """What some wheels make of the part of a recording that they were not fitted to.

    Attributes:
        path: dead-reckoned T_odom_base at the reference's stamps, begun at the reference's first pose there.
        evaluation: of it.
        end_error_m: how far from the reference it ends.
    """

    path: Trajectory
    evaluation: Evaluation
    end_error_m: float


@dataclass(frozen=True, eq=False)
class WheelTrial:
    """A calibration and its proof.

    Attributes:
        recording: its name.
        fit: to the part before `split_s`, a stamp in seconds.
        reference: of the whole recording, T_odom_base.
        held_out: the part of the reference after `split_s`, of the axle's middle: `fit.mount` taken off.
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
    """Fit a recording's wheels to the first `train_share` of the time it shares with `reference`; try them on the rest.

    Args:
        recording: with wheel readings, and nominal wheels in its calibration.
        reference: of the base or the camera; None for the recording's ground truth.
        train_share: 0 to 1, both left out.
        by_camera: whether the reference is by its own camera: σ then holds what that one's calibration leaves open.
        segment_m, with_delay, on_step: see `fit_wheels`.

    Raises:
        CalibrationError: no wheels, no reference, a camera's reference without T_base_camera, a drive that does not
            determine the wheels (see `fit_wheels`), or a rest too short to try them on.
    """
    if not 0 < train_share < 1:
        raise CalibrationError(f"the share to calibrate on is {train_share:g}, not between 0 and 1")
    nominal = _nominal(recording)
    on_step("reading")
    reference = _reference(recording, reference)
    drive = drive_of(recording, nominal)
    common = reference.between(*(drive.stamps_s[[0, -1]] - nominal.delay_s))
    split_s = float(common.stamps_s[0] + train_share * common.duration_s) if len(common) else reference.stamps_s[0]
    seen = reference.between(-np.inf, split_s) if len(common) else reference
    errors = _camera_errors(recording.calibration) if by_camera else None
    fit = fit_wheels(
        nominal, drive, seen, segment_m=segment_m, with_delay=with_delay, on_step=on_step, camera_errors=errors
    )
    held_out = _at_axle(common.between(split_s, np.inf), fit.mount)
    on_step("trying on the rest")
    before, after = (_attempt(drive, wheels, held_out) for wheels in (nominal, fit.wheels))
    return WheelTrial(recording.name, fit, reference, split_s, held_out, before, after, recording.warnings)


def _camera_errors(calibration: Calibration) -> FloatArray | None:
    is_known = calibration.color is not None and calibration.T_base_camera is not None
    return typical_motion_errors(calibration) if is_known else None


def _nominal(recording: Recording) -> Wheels:
    wheels = recording.calibration.wheels
    if wheels is None:
        raise CalibrationError(
            f"the calibration of {recording.name} ({recording.calibration.source}) has no wheels",
            fix="give nominal ones in a calibration.yaml by --calibration: radii, track width, ticks a turn",
        )
    return wheels


def _reference(recording: Recording, given: Trajectory | None) -> Trajectory:
    reference = given or recording.ground_truth
    if reference is None:
        raise CalibrationError(
            f"{recording.name} has no ground truth to calibrate against",
            fix="give a trajectory with --reference, such as visual odometry's of this very recording",
        )
    return express_for("base", reference, recording.calibration)


def _at_axle(reference: Trajectory, mount: FloatArray) -> Trajectory:
    """T_odom_axle from the trajectory of a body that sits there by x, y, yaw (3,) of T_axle_body."""
    T_body_axle = se3.invert(se3.from_plane(*mount))
    return Trajectory(reference.stamps_s, reference.T_frame_body @ T_body_axle, body="base", frame=reference.frame)


def _attempt(drive: Drive, wheels: Wheels, held_out: Trajectory) -> Attempt:
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
    return Attempt(path, evaluation, end_error_m)
