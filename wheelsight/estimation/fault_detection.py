"""Fault detection: `FaultDetection` of slip and failing vision within seconds, `SensorHealth` during the whole drive.

If camera and wheels contradict each other, do the wheels slip, or does vision fail?

While both agree, one belief uses both. A measurement outside the gate splits it into two hypotheses. In one, vision
fails and the pose follows the wheels. In the other, the wheels slip and the pose follows the camera. The log-likelihood
ratio between them, in nats, accumulates frame by frame (Wald 1945) until one is accepted:

- A sensor whose own velocity changed by more than a robot's can, at the onset or since, is wrong.
- A gyroscope, if there is one, agrees with one of both.
- A camera with its usual share of inliers that keeps contradicting the wheels indicates slip, which wheels cannot
  notice. One with fewer inliers, or that contradicts a part of its view or itself, indicates failing vision. One that
  does not see all directions indicates neither: errors in the unseen directions leak into the others.

A measurement that leaves the plane of the floor, which not even slip explains, is rejected and indicates neither.
Until a decision the estimate lies between both hypotheses and covers both. If they agree again before, the likelier one
continues and covers the other. After a decision for the wheels, the estimate covers the camera's while the camera looks
well. A fault ends after several measurements in a row that agree. Slip is accepted after all when a camera that looks
well contradicts the wheels for a second or two: failures are mostly shorter. The estimate then covers the wheels'.

`SensorHealth` detects a sensor that no longer follows the motion of the base. A faulty sensor has a larger variance, or
measures a multiple of the truth. The log-likelihood ratio of each sensor to "all sound" accumulates in a one-sided
CUSUM (Page 1954, Biometrika 41), over short pieces for large errors and over longer ones for small errors. A fault is
found when one sum passes `_ALARM_NATS` and leads all others by `_MARGIN_NATS`. Two sensors that agree name the third. A
wheel that agrees with a new scale is used with it. A chair cannot move sideways, rise, or tilt as fast as it drives, so
such motion counts against the camera. The ratio of each wheel to the camera is learned along 20 m; its changes count.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from operator import itemgetter

import numpy as np
from scipy.special import chdtri

from wheelsight.core.checks import left_out_warning
from wheelsight.core.estimates import STEP_BEGIN, Reason
from wheelsight.core.geometry import FloatArray, IntArray
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry.chi_square import quantile as _quantile
from wheelsight.estimation.agreement import (
    ANY_CAMERA,
    CAMERA,
    FLIPS,
    GYRO,
    HYPOTHESES,
    LEFT,
    MIRRORED,
    OF_SENSOR,
    PLACES,
    RIGHT,
    SCALES,
    WHEEL_SENSORS,
    WHEELS,
    Exclusion,
    Piece,
    RobotSensor,
    Usual,
    begin_of_scale,
    cause_of,
    factor_of,
    ways_by_camera,
    wheel_ways,
)
from wheelsight.estimation.pose_belief import (
    IN_PLANE,
    LAG,
    FilterParameters,
    Innovation,
    Odometer,
    PoseBelief,
    Preintegration,
    RelativeMotion,
    WheelNoise,
    changed,
)

_YAW = 2
# At which the other hypothesis lies, so that its own error, too, has room within three.
COVERED_SIGMAS = 2.5


class Fault(Enum):
    """No fault; a fault of wheels or vision, undecided which; wheel slip; failing vision."""

    NONE = "none"
    UNDECIDED = "undecided"
    WHEEL_SLIP = "wheel slip"
    VISION = "vision"


@dataclass(frozen=True, slots=True, eq=False)
class Speed:
    """Mean velocity (3,) in the plane over an interval, and its covariance (3, 3)."""

    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def over(cls, T: FloatArray, covariance: FloatArray, seconds: float) -> Speed:
        """Return the mean velocity of a motion (4, 4) with its covariance (3, 3)."""
        return cls(motions.log(T)[[0, 1, 5]] / seconds, covariance / (seconds * seconds))

    def leap_from(self, before: Speed, seconds: float, settings: FilterParameters) -> float:
        """Return χ² of the change of velocity since `before`, for a robot's accelerations; 0 if it is plausible."""
        s = settings
        usual = (s.leap_m_s2 * seconds, s.leap_m_s2 * s.leap_side_share * seconds, s.leap_rad_s2 * seconds)
        covariance = self.covariance + before.covariance + np.diag(np.square(usual))
        leap = float(motions.chi_squared(self.mean - before.mean, covariance))
        return min(leap, s.leap_chi2_cap) if leap > _quantile(s.leap_confidence, 3) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class LastMeasurement:
    """The last measurement and the odometer at that time, kept to detect jumps at the next one."""

    stamp_s: float
    measurement: RelativeMotion
    odometer: Odometer
    camera: Speed | None = None
    wheels: Speed | None = None


@dataclass(frozen=True, eq=False)
class FaultDetection:
    """The hypotheses, and the evidence for each.

    Attributes:
        primary: belief of the estimate; while UNDECIDED, the hypothesis that vision fails.
        alternative: while UNDECIDED, the hypothesis that wheels slip; also with VISION, while the camera looks well and
            agrees with it.
        fault: the current fault.
        log_ratio: log-likelihood ratio of slip to visual failure, nats.
        agreed: number of measurements in a row that agreed.
        since_s: stamp of the last change of `fault`.
        last: the last measurement.
        odometer: of wheels and gyroscope.
        usual_share: usual share of inliers; None if measurements do not have it.
        nis: NIS of the current measurement, and its degrees of freedom; or None.
        gyro_s: stamp of the last yaw rate.
        gyro_rad: turn of the gyroscope since the last update by it.
        gyro_sum_s: time of that turn.
        turn_slip_s: when the gyroscope last contradicted the wheels.
        measured_s: stamp of the last camera measurement.
        preintegration: of the wheels, since the pose that the camera measures against.
        noise: estimated noise of the wheels.
    """

    primary: PoseBelief
    alternative: PoseBelief | None = None
    fault: Fault = Fault.NONE
    log_ratio: float = 0.0
    agreed: int = 0
    since_s: float = -np.inf
    last: LastMeasurement | None = None
    odometer: Odometer = field(default_factory=Odometer)
    usual_share: float | None = None
    nis: tuple[float, int] | None = None
    gyro_s: float | None = None
    gyro_rad: float = 0.0
    gyro_sum_s: float = 0.0
    turn_slip_s: float = -np.inf
    measured_s: float = -np.inf
    preintegration: Preintegration | None = None
    noise: WheelNoise = field(default_factory=WheelNoise)

    @property
    def alternative_probability(self) -> float:
        """Probability of wheel slip, while UNDECIDED."""
        return float(1 / (1 + np.exp(-self.log_ratio)))

    def answer(self, settings: FilterParameters) -> PoseBelief:
        """Return the belief of the estimate: it covers the alternative; while UNDECIDED it is a mixture of both."""
        if self.alternative is None:
            return self.primary
        if self.fault is Fault.VISION:
            return covering(self.primary, self.alternative, self.since_s, COVERED_SIGMAS)
        return mixed(self.primary, self.alternative, self.alternative_probability)

    def likelier(self, settings: FilterParameters) -> PoseBelief:
        """Return the likelier hypothesis, with a covariance that covers the other, at the end of an undecided fault.

        A mixture would not do: measurements against poses remembered since constrain it so little that noise decides.
        """
        if self.alternative is None:
            return self.primary
        first, second = (self.alternative, self.primary) if self.log_ratio > 0 else (self.primary, self.alternative)
        return covering(first, second, self.since_s, COVERED_SIGMAS).vision_accepted()


def gate(settings: FilterParameters, degrees: int) -> float:
    """Return the largest NIS of a share `confidence` of the correct measurements, by their degrees of freedom."""
    return _quantile(settings.confidence, degrees)


@cache
def gate_of(wrongly: float) -> float:
    """Return the NIS, of one degree of freedom, that a share `wrongly` of the correct measurements exceeds."""
    return float(chdtri(1, wrongly))


def updated(
    detection: FaultDetection, stamp_s: float, measurement: RelativeMotion, settings: FilterParameters
) -> tuple[FaultDetection, Reason | None]:
    """Return the detection after a measurement, and why it was rejected, or None."""
    most = gate(settings, len(measurement.covariance))
    last, log_ratio = _compare(detection, stamp_s, measurement, settings)
    usual = detection.primary.innovation(measurement, settings, without_slip=True, updates_errors=True)
    agrees = usual.nis <= most
    agreed, nis = detection.agreed + 1 if agrees else 0, (usual.nis, len(usual.residual))
    known = detection.log_ratio
    sum_nats = known * settings.likelihood_memory + log_ratio if detection.fault is Fault.NONE else known
    now = changed(detection, last=last, agreed=agreed, nis=nis, measured_s=stamp_s, log_ratio=sum_nats)
    if detection.fault is Fault.NONE:
        return _update_sound(now, stamp_s, measurement, usual, most, settings)
    if detection.fault is Fault.UNDECIDED:
        return _update_undecided(now, stamp_s, measurement, log_ratio, agrees, settings)
    if detection.fault is Fault.WHEEL_SLIP:
        by = now.primary.innovation(measurement, settings)
        if by.nis > most or not _is_healthy(now, measurement, settings):
            return now, Reason.CONTRADICTION
        if now.agreed >= settings.agreements:
            now = _with_fault(now, Fault.NONE, stamp_s)
        return changed(now, primary=now.primary.updated(by).vision_accepted()), None
    seconds = 0.0 if detection.last is None else stamp_s - detection.last.stamp_s
    if agreed == 0 and _shows_all(measurement):
        log_ratio += min(seconds, settings.compared_s) * settings.contradiction_nats_per_s
    return _update_failing(now, stamp_s, measurement, log_ratio, settings)


def vision_failed(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """Return the detection after a frame without a camera measurement."""
    blind = changed(detection, last=None, agreed=0)
    if detection.fault is Fault.UNDECIDED:
        return _settled(changed(blind, log_ratio=detection.log_ratio - settings.poor_inliers_nats), stamp_s, settings)
    return changed(blind, alternative=None)


def end_undecided(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """End a fault that is undecided for too long, or slip without camera measurements."""
    if stamp_s - detection.since_s <= settings.undecided_s:
        return detection
    if detection.fault is Fault.UNDECIDED:
        return changed(_with_fault(detection, Fault.NONE, stamp_s), primary=detection.likelier(settings), log_ratio=0.0)
    lone = stamp_s - detection.measured_s > settings.undecided_s
    if detection.fault is not Fault.WHEEL_SLIP or not lone:
        return detection
    return changed(_with_fault(detection, Fault.NONE, stamp_s), primary=detection.primary.vision_accepted())


def _update_sound(
    detection: FaultDetection,
    stamp_s: float,
    measurement: RelativeMotion,
    usual: Innovation,
    most: float,
    settings: FilterParameters,
) -> tuple[FaultDetection, Reason | None]:
    """Accept a measurement within the gate; else split the belief into both hypotheses, if slip explains it."""
    if usual.nis <= most:
        share, usual_share = measurement.inlier_share, detection.usual_share
        if share is not None:
            usual_share = share if usual_share is None else usual_share + settings.inlier_memory * (share - usual_share)
        primary = detection.primary.updated(usual).vision_accepted()
        return changed(detection, usual_share=usual_share, primary=primary), None
    alternative = _slip_hypothesis(detection.primary, stamp_s, measurement, settings)
    if alternative is None:
        return detection, Reason.CONTRADICTION
    split = changed(_with_fault(detection, Fault.UNDECIDED, stamp_s), alternative=alternative)
    return _verdict(_settled(split, stamp_s, settings))


def _update_undecided(
    detection: FaultDetection,
    stamp_s: float,
    measurement: RelativeMotion,
    log_ratio: float,
    agrees: bool,
    settings: FilterParameters,
) -> tuple[FaultDetection, Reason | None]:
    """Update both hypotheses and their log-likelihood ratio; decide if that is enough."""
    assert detection.alternative is not None
    by = detection.alternative.innovation(measurement, settings)
    fits = by.nis <= gate(settings, len(measurement.covariance))
    alternative = detection.alternative.updated(by).vision_accepted() if fits else detection.alternative
    if not agrees and _shows_all(measurement):
        is_healthy = fits and _is_healthy(detection, measurement, settings)
        log_ratio += settings.contradiction_nats if is_healthy else -settings.poor_inliers_nats
    detection = changed(detection, alternative=alternative, log_ratio=detection.log_ratio + log_ratio)
    if detection.agreed >= settings.agreements:
        return changed(
            _with_fault(detection, Fault.NONE, stamp_s), primary=detection.likelier(settings), log_ratio=0.0
        ), None
    return _verdict(_settled(detection, stamp_s, settings))


def _update_failing(
    detection: FaultDetection, stamp_s: float, measurement: RelativeMotion, log_ratio: float, settings: FilterParameters
) -> tuple[FaultDetection, Reason | None]:
    """Follow the wheels while vision fails; end that after enough measurements that agree, or decide for slip."""
    if detection.agreed >= settings.agreements:
        belief = detection.answer(settings).vision_accepted()
        belief = belief.updated(belief.innovation(measurement, settings)).vision_accepted()
        return changed(_with_fault(detection, Fault.NONE, stamp_s), primary=belief, log_ratio=0.0), None
    if not _is_healthy(detection, measurement, settings):
        return changed(detection, alternative=None), Reason.CONTRADICTION
    by = None if detection.alternative is None else detection.alternative.innovation(measurement, settings)
    if detection.alternative is None or by is None or by.nis > gate(settings, len(measurement.covariance)):
        return changed(
            detection, alternative=_slip_hypothesis(detection.primary, stamp_s, measurement, settings)
        ), Reason.CONTRADICTION
    log_ratio = max(detection.log_ratio + log_ratio, -settings.decision_nats)
    detection = changed(detection, alternative=detection.alternative.updated(by).vision_accepted(), log_ratio=log_ratio)
    return _verdict(_settled(detection, stamp_s, settings))


def _settled(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """Return the detection with one hypothesis alone, if the log-likelihood ratio is decisive."""
    if detection.log_ratio > settings.decision_nats:
        assert detection.alternative is not None
        camera = detection.alternative
        if detection.fault is Fault.VISION:
            # A camera that fails for long looks the same, so the estimate has to cover the other hypothesis.
            camera = covering(camera, detection.primary, detection.since_s, COVERED_SIGMAS).vision_accepted()
        return changed(_with_fault(detection, Fault.WHEEL_SLIP, stamp_s), primary=camera, log_ratio=0.0)
    if detection.log_ratio < -settings.decision_nats:
        return changed(
            _with_fault(detection, Fault.VISION, stamp_s),
            alternative=detection.alternative,
            log_ratio=-settings.decision_nats,
        )
    return detection


def _verdict(detection: FaultDetection) -> tuple[FaultDetection, Reason | None]:
    return detection, None if detection.fault is Fault.WHEEL_SLIP else Reason.CONTRADICTION


def _with_fault(detection: FaultDetection, fault: Fault, stamp_s: float) -> FaultDetection:
    return changed(detection, fault=fault, alternative=None, agreed=0, since_s=stamp_s)


def _slip_hypothesis(
    belief: PoseBelief, stamp_s: float, measurement: RelativeMotion, settings: FilterParameters
) -> PoseBelief | None:
    """Return the belief if wheels slipped since the measurement's reference; None if that does not explain it."""
    since_s = belief.remembered[belief.index_of(measurement.name) - 1].stamp_s
    slipping = belief.slipped(max(stamp_s - since_s, 0.0), settings, since_s)
    by = slipping.innovation(measurement, settings)
    return slipping.updated(by).vision_accepted() if by.nis <= gate(settings, len(measurement.covariance)) else None


def _compare(
    detection: FaultDetection, stamp_s: float, measurement: RelativeMotion, settings: FilterParameters
) -> tuple[LastMeasurement, float]:
    """Return this measurement as the last one, and the log-likelihood ratio by jumps and by the gyroscope."""
    last = detection.last
    seconds = np.inf if last is None else stamp_s - last.stamp_s
    step = None if last is None else _motion_since(last, measurement, detection.primary)
    if last is None or step is None or not 0 < seconds <= settings.compared_s:
        return LastMeasurement(stamp_s, measurement, detection.odometer), 0.0
    moved, log_ratio = detection.odometer.since(last.odometer), 0.0
    camera, wheels = Speed.over(step[0], step[1], seconds), None
    if moved.rolled_s > 0.5 * seconds:
        wheels = Speed.over(moved.T, detection.noise.ratio * moved.covariance[IN_PLANE], moved.rolled_s)
    if wheels is not None and last.wheels is not None and last.camera is not None:
        log_ratio += 0.5 * wheels.leap_from(last.wheels, seconds, settings)
        log_ratio -= 0.5 * camera.leap_from(last.camera, seconds, settings)
    if wheels is not None and moved.turned_s > 0.5 * seconds:
        rate = moved.turn_rad / moved.turned_s
        log_ratio += _rate_nats(wheels, rate, seconds, settings) - _rate_nats(camera, rate, seconds, settings)
    return LastMeasurement(stamp_s, measurement, detection.odometer, camera, wheels), log_ratio


def _rate_nats(speed: Speed, rate_rad_s: float, seconds: float, settings: FilterParameters) -> float:
    """Return the nats of a gyroscope's rate against the yaw rate of a sensor."""
    variance = settings.gyro.noise_rad_per_sqrt_s**2 / seconds + speed.covariance[_YAW, _YAW]
    return float(min((speed.mean[_YAW] - rate_rad_s) ** 2 / variance, settings.leap_chi2_cap) / 2)


def _motion_since(
    last: LastMeasurement, measurement: RelativeMotion, belief: PoseBelief
) -> tuple[FloatArray, FloatArray] | None:
    """Return the camera's motion since the last measurement, and its covariance (3, 3); None for other references."""
    reference_s = belief.remembered[belief.index_of(measurement.name) - 1].stamp_s
    if reference_s == last.stamp_s:
        return measurement.Z, measurement.covariance_full[IN_PLANE]
    if reference_s > last.stamp_s or last.measurement.name != measurement.name:
        return None
    # The errors of both measurements add up.
    before = last.measurement
    T, spread = motions.between(before.Z, -before.covariance_full, measurement.Z, measurement.covariance_full)
    return T, spread[IN_PLANE]


def _shows_all(measurement: RelativeMotion) -> bool:
    return len(measurement.covariance) == 6


def _is_healthy(detection: FaultDetection, measurement: RelativeMotion, settings: FilterParameters) -> bool:
    """Whether a measurement that contradicts the wheels may be correct: usual inliers, and the whole view fits.

    A person who walks past closely has most inliers, and the room behind is left out or does not fit. With slipping
    wheels the whole view fits.
    """
    if measurement.fitting is not None and measurement.fitting < settings.fitting_share:
        return False
    if measurement.inlier_share is None or detection.usual_share is None:
        return True
    return measurement.inlier_share >= settings.inlier_share * detection.usual_share


def mixed(one: PoseBelief, other: PoseBelief, share: float) -> PoseBelief:
    """Return a belief with the moments of a mixture, in which `other` has the probability `share`."""
    way = [motions.log(motions.times(T, motions.inverse(S))) for T, S in zip(other.T, one.T, strict=True)]
    between = one.retracted(share * np.concatenate([*way, other.aux - one.aux]), one.covariance)
    P = np.zeros_like(one.covariance)
    for belief, weight in ((one, 1 - share), (other, share)):
        apart = _shift(between, belief)
        P += weight * (belief.covariance + np.outer(apart, apart))
    return changed(between, covariance=P).vision_accepted()


def covering(one: PoseBelief, other: PoseBelief, since_s: float, sigmas: float) -> PoseBelief:
    """Return `one` with a covariance in which `other` lies at a number of standard deviations.

    Both differ since a stamp. Poses that were remembered later get the error of the current one.
    """
    apart = _shift(one, other)
    apart[one.aux_offset :] = 0.0  # measured again soon, which must not move the pose
    later = [0, *(place + 1 for place, pose in enumerate(one.remembered) if pose.stamp_s > since_s)]
    apart[: one.aux_offset].reshape(-1, 6)[later] = apart[:6]
    P = one.covariance + np.outer(apart, apart) / sigmas**2
    P[: one.aux_offset, : one.aux_offset] += _less_known(one, other)
    return changed(one, covariance=P)


def _less_known(one: PoseBelief, other: PoseBelief) -> FloatArray:
    """Return the covariance (6 + 6K, 6 + 6K) by which the poses of `other` are more uncertain than those of `one`.

    The uncertainty before both differ counts once. The comparison is relative to the base, so that the place in the map
    does not matter. The begin of a step gets the same as the base, so that the step keeps its covariance.
    """
    kept = [0, *(place for place, name in enumerate(one.names, 1) if name != STEP_BEGIN)]
    at, same = _rows(kept), np.eye(len(kept))
    to_base, to_world = np.kron(same, motions.inverse_adjoint(one.T[0])), np.kron(same, motions.adjoint(one.T[0]))
    lacks = to_base @ (_of_poses_alone(other) - _of_poses_alone(one))[np.ix_(at, at)] @ to_base.T
    strength, axes = np.linalg.eigh((lacks + lacks.T) / 2)
    axes = to_world @ axes
    of = _rows([kept.index(place) if place in kept else 0 for place in range(len(one.T))])
    return np.asarray((axes * np.maximum(strength, 0.0)) @ axes.T)[np.ix_(of, of)]


def _rows(places: list[int]) -> IntArray:
    """Return the rows of poses in a covariance."""
    return np.asarray((6 * np.array(places)[:, None] + np.arange(6)).ravel())


def _of_poses_alone(belief: PoseBelief) -> FloatArray:
    """Return the covariance (6 + 6K, 6 + 6K) of the poses for a known twist and delay of the camera."""
    poses, given = slice(belief.aux_offset), belief.aux_offset + np.array([0, 1, 2, LAG])
    C, V = belief.covariance[poses, given], belief.covariance[np.ix_(given, given)]
    return np.asarray(belief.covariance[poses, poses] - C @ np.linalg.pinv(V, hermitian=True) @ C.T)


def _shift(one: PoseBelief, other: PoseBelief) -> FloatArray:
    """Return the perturbation (n,) that, to first order, moves every pose to that of `other`, at any rotation."""
    shifts = np.zeros((len(one.T), 6))
    for shift, T, S in zip(shifts, other.T, one.T, strict=True):
        shift[:] = _shift_of(S, T)
    return np.concatenate([shifts.ravel(), other.aux - one.aux])


def covering_pose(
    T_one: FloatArray, one: FloatArray, T_other: FloatArray, other: FloatArray, sigmas: float
) -> tuple[FloatArray, FloatArray]:
    """Return one pose (4, 4), and a covariance (6, 6) in which the other lies at a number of standard deviations."""
    apart = _shift_of(T_one, T_other)
    return T_one, one + other + np.outer(apart, apart) / sigmas**2


def _shift_of(T_from: FloatArray, T_to: FloatArray) -> FloatArray:
    """Return the perturbation (6,) that, to first order, moves one pose (4, 4) to the other."""
    turn = motions.log(motions.times(T_to, motions.inverse(T_from)))[3:]
    return np.concatenate([T_to[:3, 3] - T_from[:3, 3] - np.cross(turn, T_from[:3, 3]), turn])


# Sums that find a fault, by which it leads, that leave a sensor out for the moment, and below which ratios are learned.
_ALARM_NATS, _MARGIN_NATS, _SUSPECT_NATS, _SOUND_NATS = 12.0, 3.0, 6.0, 2.0
_AGREES_NATS = 0.5  # of one piece, for a sensor that agrees with the others
_HEAD_START_NATS = 5.0  # of a camera that restarted
_LARGEST_NATS = 60.0  # at which sums end
# Errors of a sound camera over a piece (metres, and share of the way; radians, and share of the turn), of a sound
# wheel, of the way to the side, and of a gyroscope, also per second for its bias. Found on the simulator.
_CAMERA_M, _CAMERA_SHARE, _CAMERA_RAD, _CAMERA_TURN_SHARE = 0.008, 0.03, 0.004, 0.012
_WHEEL_M, _WHEEL_SHARE, _SIDE_M, _SIDE_SHARE = 0.003, 0.01, 0.01, 0.15
_GYRO_RAD, _GYRO_SHARE, _GYRO_RAD_S = 0.003, 0.01, 0.004
_NOTHING = 10.0  # error of a sensor that does not count, as a multiple of way or turn
# Motion out of the plane of the floor that is usual over a piece, and how much larger a faulty camera's is.
_RISE_M, _RISE_SHARE, _TILT_RAD, _FAR_OFF = 0.03, 0.15, 0.06, 5.0
# One piece counts at most this much, since errors have longer tails than a Gaussian.
_PIECE_NATS, _LEAST_NATS = 8.0, -6.0
_PIECES_S, _SHORTEST_S, _GAP_S = (0.25, 1.25), 0.15, 2.0
# Of a gyroscope's bias: its prior, its growth in a second, and the error of one piece.
_BIAS_SIGMA_RAD_S, _BIAS_WALK_RAD_S, _BIAS_PIECE_RAD_S = 0.05, 0.0003, 0.02
_RATIO_WAY_M, _RATIO_PRIOR_M, _RATIO_STEP = 20.0, 5.0, 0.1
# Sound way, time and, for a fault that turns show, turn after which a sensor is used again.
_AGAIN_WAY_M, _AGAIN_S, _AGAIN_RAD = 1.0, 2.0, 0.6
# A wheel with a new scale is used again after this way and time; limits of the scale, and its largest σ. Simulator.
_RESCALED_WAY_M, _RESCALED_S, _RESCALED, _RESCALED_SIGMA = 2.0, 4.0, (0.5, 2.0), 0.02
_KEPT_S, _MOST_WAITING = 5.0, 4096  # of readings; while the camera is dark, older ones are dropped
_DESCRIBED = 120  # pieces by which a fault is described


def log_ratios(piece: Piece, half_m: float, usual: Usual, faulty: Collection[RobotSensor] = ()) -> FloatArray:
    """Return the log-likelihood ratio of each of `HYPOTHESES` to no other fault, nats; 0 for those of faulty sensors.

    Args:
        piece: of the drive.
        half_m: half of the track.
        usual: in this drive.
        faulty: sensors whose measurements do not count.
    """
    x, y, z, roll, pitch, yaw = piece.camera
    ways_m, seconds = piece.ways_m, piece.end_s - piece.begin_s
    turn = None if piece.turn_rad is None else piece.turn_rad - usual.bias_rad_s * seconds
    wheel_yaw, rolled_m = (ways_m[1] - ways_m[0]) / (2 * half_m), float(np.abs(ways_m).max())
    way_m = max(rolled_m, abs(x) + half_m * abs(yaw), abs(y))
    turn_rad = max(abs(wheel_yaw), abs(yaw), 0.0 if turn is None else abs(turn))
    rows = 3 if turn is None else 4
    J = np.zeros((4, 7))
    J[:2, 0], J[:2, 2], J[:2, 3:5] = -1, (half_m, -half_m), np.eye(2)
    J[2, [1, 5]], J[3, [2, 6]] = 1, (-1, 1)
    J = J[:rows]
    camera_m, wheel_m = _CAMERA_M + _CAMERA_SHARE * way_m, _WHEEL_M + _WHEEL_SHARE * way_m
    camera_rad = _CAMERA_RAD + _CAMERA_TURN_SHARE * turn_rad
    side_m, gyro_rad = _SIDE_M + _SIDE_SHARE * rolled_m, _GYRO_RAD + _GYRO_SHARE * turn_rad
    gyro_rad += math.hypot(_GYRO_RAD_S, usual.bias_sigma_rad_s) * seconds
    sound = np.square([camera_m, camera_m, camera_rad, wheel_m, wheel_m, side_m, gyro_rad])
    sizes = np.array([way_m, way_m, turn_rad, way_m, way_m, 0.0, turn_rad])
    if not piece.shows_all:
        sound[:2] += 1.0
    for sensor in faulty:
        sound[PLACES[sensor]] += np.square(_NOTHING * sizes[PLACES[sensor]] + 1.0)
    flips = np.vstack([np.ones(4), FLIPS])
    variances = sound + np.square(np.vstack([np.zeros(7), SCALES]) * sizes)
    true_yaw = flips[:, 2] * yaw  # a mirrored camera measures the opposite of the truth
    by_camera = usual.ratios * np.stack([x - half_m * true_yaw, x + half_m * true_yaw], axis=-1)
    apart = np.empty((len(flips), 4))
    apart[:, :2] = ways_m - flips[:, :2] * by_camera
    apart[:, 2] = flips[:, 2] * y
    apart[:, 3] = 0.0 if turn is None else turn - flips[:, 3] * true_yaw
    apart = apart[:, :rows]
    C = (J * variances[:, None, :]) @ J.T
    chi2 = (apart * np.linalg.solve(C, apart[:, :, None])[:, :, 0]).sum(axis=1)
    logs = -0.5 * (np.linalg.slogdet(C)[1] + chi2)
    sound_log, logs = logs[0], logs[1:]
    # The camera's motion out of the plane of the floor: a faulty camera has one in half of the cases.
    off = np.array([z, roll, pitch]) / (_RISE_M + _RISE_SHARE * rolled_m, _TILT_RAD, _TILT_RAD)
    out = float((0.5 * (1 - 1 / _FAR_OFF**2) * off**2 - math.log(_FAR_OFF)).sum()) if piece.shows_all else 0.0
    logs[ANY_CAMERA] += math.log(0.5) + float(np.logaddexp(0.0, out))
    unknown = faulty if turn is not None else {*faulty, GYRO}
    is_judged = np.array([one.sensor not in unknown for one in HYPOTHESES])
    sound_log = max(sound_log, logs[is_judged].max() - _PIECE_NATS)
    return np.where(is_judged, np.maximum(logs - sound_log, _LEAST_NATS), 0.0)


def turns_alike(piece: Piece, half_m: float) -> bool:
    """Whether wheels and camera turn in the same direction over a piece, one at most twice as far as the other."""
    by_wheels, by_camera = (piece.ways_m[1] - piece.ways_m[0]) / (2 * half_m), piece.camera[5]
    return bool(by_wheels * by_camera > 0 and 0.5 < by_wheels / by_camera < 2.0)


def of_sensors(values: FloatArray) -> dict[RobotSensor, int]:
    """Return the place of the largest value of each sensor among those of `HYPOTHESES`."""
    return {sensor: max(places, key=values.__getitem__) for sensor, places in OF_SENSOR.items()}


class Sums:
    """CUSUM of each hypothesis over pieces of one length.

    Attributes:
        nats: largest sum of each sensor, and `places`, whose sum that is among `HYPOTHESES`.
        zero_s: where that sum was last zero.
        begin: stamp and pose (4, 4) of the camera at the begin of the current piece.
        shows_all: whether all frames since then showed all directions.
    """

    def __init__(self, piece_s: float) -> None:
        self.piece_s, self.begin, self.shows_all = piece_s, (math.nan, np.eye(4)), True
        self.clear(math.nan)

    def clear(self, now_s: float) -> None:
        """Start over."""
        self._sums, self._zero_s = np.zeros(len(HYPOTHESES)), np.full(len(HYPOTHESES), now_s)
        self.places = of_sensors(self._sums)
        self.nats, self.zero_s = dict.fromkeys(RobotSensor, 0.0), dict.fromkeys(RobotSensor, now_s)

    def suspect(self, sensor: RobotSensor, since_s: float) -> None:
        """Give the sums of a sensor a head start."""
        at = OF_SENSOR[sensor]
        self._sums[at], self._zero_s[at] = np.maximum(self._sums[at], _HEAD_START_NATS), since_s

    def add(self, ratios: FloatArray, piece: Piece) -> None:
        """Add the ratios of a piece."""
        self._zero_s[np.isnan(self._zero_s)] = piece.begin_s
        sums = np.maximum(self._sums + ratios, 0.0)
        self._zero_s[sums == 0.0] = piece.end_s
        self._sums = np.maximum(sums - max(0.0, sums.max() - _LARGEST_NATS), 0.0)
        self.places = of_sensors(self._sums)
        self.nats = {sensor: float(self._sums[place]) for sensor, place in self.places.items()}
        self.zero_s = {sensor: float(self._zero_s[place]) for sensor, place in self.places.items()}

    def leads(self, least_nats: float) -> RobotSensor | None:
        """Return the sensor whose sum passes a value and leads all others; None without one."""
        (sensor, first_nats), (_, second_nats) = sorted(self.nats.items(), key=itemgetter(1), reverse=True)[:2]
        return sensor if first_nats > least_nats and first_nats - second_nats > _MARGIN_NATS else None


class SensorHealth:
    """Compares the sensors piece by piece.

    Args:
        track_m: distance between the wheels.
        T_base_camera: (4, 4).

    Attributes:
        steps: of the wheels, to which the caller appends: stamp of the end, way in metres and turn in radians.
        rates: of the gyroscope, to which the caller appends: stamp, and mean rate since the last one in rad/s.
        faults: begin of the current fault of each faulty sensor, stamp.
        exclusions: sensors that are left out, now or earlier; see `update`.
        warnings: a sentence for each sensor that was faulty.
        is_suspicious: whether a sensor may be wrong, without certainty.
        is_without_wheels: whether a wheel is left out.
        suspected: the sensor that is most likely wrong, without certainty; None if all are likely sound.
        is_armed: whether faults are looked for; before, usual values are learned.
        knows_turns: whether wheels and camera have agreed over turns. Before, turns in the same direction are no
            fault: the track may be wrong.
    """

    def __init__(self, track_m: float, T_base_camera: FloatArray) -> None:
        self.steps: deque[tuple[float, float, float]] = deque(maxlen=_MOST_WAITING)
        self.rates: deque[tuple[float, float]] = deque(maxlen=_MOST_WAITING)
        self.faults: dict[RobotSensor, float] = {}
        self.exclusions: tuple[Exclusion, ...] = ()
        self.warnings: tuple[str, ...] = ()
        # Of each sensor: how often it was left out, and the last time from when, until when, and why.
        self._found: dict[RobotSensor, tuple[int, float, float, str]] = {}
        self.is_suspicious = self.is_without_wheels = self._has_news = False
        self.is_armed = self.knows_turns = False
        self.suspected: RobotSensor | None = None
        self._half_m = track_m / 2
        self._T_base_camera, self._T_camera_base = T_base_camera, motions.inverse(T_base_camera)
        self._first_s: float | None = None
        self._rolled: deque[tuple[float, float, float]] = deque()  # stamp, and way of both wheels, m
        self._turned: deque[tuple[float, float]] = deque()  # stamp, and angle of the gyroscope, rad
        self._scales = tuple(Sums(piece_s) for piece_s in _PIECES_S)
        self._waiting: deque[tuple[float, FloatArray, bool]] = deque(maxlen=8)
        self._pieces: deque[Piece] = deque(maxlen=_DESCRIBED)
        self._usual = Usual(np.ones(2), 0.0, _BIAS_SIGMA_RAD_S)
        self._weights = np.full(2, _RATIO_PRIOR_M)
        # Whether a restarted camera has not agreed yet, and when it restarted last.
        self._is_unproven, self._restarted_s = False, -math.inf
        # Way, time and turn over which a faulty sensor agrees again, and over which it has to.
        self._sound = {sensor: np.zeros(3) for sensor in RobotSensor}
        self._again: dict[RobotSensor, tuple[float, float, float]] = {}
        self._rescaled = {sensor: np.zeros(3) for sensor in (LEFT, RIGHT)}
        self._new_scales = np.ones(2)  # of both wheels, for the caller

    def update(self, stamp_s: float) -> float | None:
        """Update the exclusions at a frame; return the stamp since which they changed, or None.

        A sensor is left out since a piece before its fault, which may begin in one. So is one that leads before that is
        certain. One that turns out to be sound counts as if nothing had happened.
        """
        if not self._has_news:
            return None
        self._has_news = False
        past = tuple(one for one in self.exclusions if one.is_sure and one.end_s < math.inf)
        current = {one.sensor: one for one in self.exclusions if one.end_s == math.inf}
        wanted = {one: Exclusion(one, self._earliest_s(one, at_s), is_sure=True) for one, at_s in self.faults.items()}
        suspects: dict[RobotSensor, float] = {}
        for scale in self._scales:
            leader = scale.leads(_SUSPECT_NATS)
            if leader is not None:
                suspects.setdefault(leader, self._earliest_s(leader, scale.zero_s[leader]))
        is_alone = bool(WHEEL_SENSORS & self.faults.keys())
        for sensor, begin_s in suspects.items():
            if sensor is CAMERA and is_alone:  # doubtful, but nothing else gives the pose
                continue
            known = current.get(sensor)
            wanted.setdefault(sensor, Exclusion(sensor, begin_s) if known is None or known.is_sure else known)
        largest = max((one for scale in self._scales for one in scale.nats.items()), key=itemgetter(1))
        self.suspected = largest[0] if largest[1] > _SOUND_NATS else None
        self.is_suspicious = not all(one.is_sure for one in wanted.values()) or largest[1] > _ALARM_NATS
        self.is_without_wheels = bool(WHEEL_SENSORS & wanted.keys())
        since_s = stamp_s
        for sensor in {*wanted, *current}:
            now, before = wanted.get(sensor), current.get(sensor)
            if before is not None and before.is_sure and now is None:
                past = (*past, before._replace(end_s=stamp_s))
            elif now != before:
                since_s = min([since_s, *[one.begin_s for one in (now, before) if one is not None]])
        self.exclusions = (*past, *wanted.values())
        return None if wanted == current else since_s

    def _earliest_s(self, sensor: RobotSensor, zero_s: float) -> float:
        """Return when a fault may have begun whose sum was last zero at a stamp; a camera was sound until a restart."""
        begin_s = zero_s - _PIECES_S[-1]
        return max(begin_s, min(self._restarted_s, zero_s)) if sensor is CAMERA else begin_s

    def take_new_scales(self) -> FloatArray:
        """Return new scales of both wheels (2,) since the last call. The caller divides their ways by them."""
        taken, self._new_scales = self._new_scales, np.ones(2)
        return taken

    def interrupt(self, restarted_s: float | None = None) -> None:
        """Note that the next pose of the camera does not continue the previous ones.

        A camera that restarted shows a view that it does not know. Its sums get a head start (Lucas & Crosier 1982), so
        that one piece that contradicts is enough.
        """
        self._waiting.clear()
        self._has_news = True
        for scale in self._scales:
            scale.begin = math.nan, scale.begin[1]
        if restarted_s is not None and self.is_armed and CAMERA not in self.faults:
            self._is_unproven, self._restarted_s = True, restarted_s
            self._scales[0].suspect(CAMERA, restarted_s)

    def move(self, T_new_old: FloatArray) -> None:
        """Apply a correction (4, 4) of the camera's map, from the left."""
        for scale in self._scales:
            scale.begin = scale.begin[0], np.asarray(motions.times(T_new_old, scale.begin[1]))
        moved = [(stamp_s, np.asarray(motions.times(T_new_old, T)), shows) for stamp_s, T, shows in self._waiting]
        self._waiting = deque(moved, maxlen=self._waiting.maxlen)

    def add_frame(self, stamp_s: float, T_map_camera: FloatArray, *, shows_all: bool = True) -> None:
        """Add the camera's pose (4, 4) by itself at a frame, and whether the frame shows all directions.

        A piece is compared once the wheels cover it.
        """
        self._first_s = stamp_s if self._first_s is None else self._first_s
        self._gather(stamp_s)
        self._waiting.append((stamp_s, T_map_camera, shows_all))
        while self._waiting and self._rolled and self._waiting[0][0] <= self._rolled[-1][0]:
            now_s, T, shows_all = self._waiting.popleft()
            for scale in self._scales:
                (begin_s, T_begin), scale.shows_all = scale.begin, scale.shows_all and shows_all
                is_over = now_s - begin_s >= (_SHORTEST_S if self._is_unproven else scale.piece_s)
                if is_over or not now_s - begin_s <= _GAP_S:
                    piece = self._piece(begin_s, T_begin, now_s, T) if now_s - begin_s <= _GAP_S else None
                    if piece is not None:
                        self._compare(scale, piece._replace(shows_all=scale.shows_all))
                    scale.begin, scale.shows_all = (now_s, T), shows_all

    def _gather(self, now_s: float) -> None:
        """Add up the steps and rates since the last call."""
        while self.steps:
            end_s, way_m, turn_rad = self.steps.popleft()
            last_s, left_m, right_m = self._rolled[-1] if self._rolled else (-math.inf, 0.0, 0.0)
            if end_s > last_s:
                aside_m = self._half_m * turn_rad
                self._rolled.append((end_s, left_m + way_m - aside_m, right_m + way_m + aside_m))
        while self.rates:
            rate_s, rate_rad_s = self.rates.popleft()
            last_s, angle_rad = self._turned[-1] if self._turned else (rate_s, 0.0)
            if rate_s >= last_s:
                self._turned.append((rate_s, angle_rad + rate_rad_s * (rate_s - last_s)))
        for known in (self._rolled, self._turned):
            while known and known[0][0] < now_s - _KEPT_S:
                known.popleft()

    def _piece(self, begin_s: float, T_begin: FloatArray, end_s: float, T_end: FloatArray) -> Piece | None:
        """Return the motions between two frames; None where the wheels do not cover them."""
        if self._rolled[0][0] > begin_s:
            return None
        T_begin_end = motions.times(motions.inverse(T_begin), T_end)
        T = motions.times(self._T_base_camera, motions.times(T_begin_end, self._T_camera_base))
        stamps_s, *sums_m = np.array(self._rolled).T
        ends = begin_s, end_s
        ways_m = np.array([np.diff(np.interp(ends, stamps_s, one))[0] for one in sums_m])
        turn = None
        if self._turned and self._turned[0][0] <= begin_s and end_s <= self._turned[-1][0] + 0.1:
            turn = float(np.diff(np.interp(ends, *np.array(self._turned).T))[0])
        return Piece(begin_s, end_s, motions.log(motions.renormalized(T)), ways_m, turn)

    def _compare(self, scale: Sums, piece: Piece) -> None:
        ratios, is_first = log_ratios(piece, self._half_m, self._usual, self.faults), scale is self._scales[0]
        self._has_news = True
        if is_first:
            self._pieces.append(piece)
            if ratios[of_sensors(ratios)[CAMERA]] <= _AGREES_NATS:
                self._is_unproven = False
        if self.is_armed and (self.knows_turns or not turns_alike(piece, self._half_m)):
            self._end_faults(piece, is_first)
            scale.add(ratios, piece)
        if is_first and not self.faults and all(max(one.nats.values()) < _SOUND_NATS for one in self._scales):
            self._learn(piece)
        sensor = scale.leads(_ALARM_NATS)
        if sensor is None:
            return
        begin_s = scale.zero_s[sensor]
        self._sound[sensor][:] = 0.0
        if sensor in self._rescaled:
            self._rescaled[sensor][:] = 0.0
            ways = wheel_ways(self._pieces, sensor, self._usual, self._half_m)
            begin_s = begin_of_scale(self._pieces, begin_s, *ways)
        self.faults[sensor] = begin_s
        shows_in_turns = sensor is GYRO or scale.places[sensor] == MIRRORED
        self._again[sensor] = (_AGAIN_WAY_M, _AGAIN_S, _AGAIN_RAD if shows_in_turns else 0.0)
        if sensor is CAMERA:
            self._is_unproven = False
        for one in self._scales:  # what this fault explains accuses no other sensor
            one.clear(piece.end_s)
        pieces = [one for one in self._pieces if one.end_s > begin_s]
        turns_rad = np.array([math.nan if one.turn_rad is None else one.turn_rad for one in pieces])
        camera, ways_m = (np.array(each) for each in zip(*((one.camera, one.ways_m) for one in pieces), strict=True))
        cause = cause_of(sensor, camera, ways_m, turns_rad, self._half_m, self._usual.ratios)
        self._found[sensor] = self._found.get(sensor, (0,))[0] + 1, begin_s, math.inf, cause
        self._warn()

    def _warn(self) -> None:
        """Update the warnings."""
        first_s = self._first_s or 0.0
        found = []
        for sensor, (times, begin_s, end_s, cause) in self._found.items():
            sensor_was = "both wheels were" if sensor is WHEELS else f"the {sensor.value} was"
            found.append(left_out_warning(sensor_was, times, begin_s - first_s, end_s - first_s, cause))
        self.warnings = tuple(found)

    def _learn(self, piece: Piece) -> None:
        """Update the usual values."""
        ratios, (_, bias, sigma), seconds = self._usual.ratios.copy(), self._usual, piece.end_s - piece.begin_s
        by_camera = ways_by_camera(piece.camera[None], self._half_m)[0]
        for i, way_m in enumerate(np.abs(by_camera)):
            if way_m > 0.03:
                self._weights[i] = self._weights[i] * math.exp(-way_m / _RATIO_WAY_M) + way_m
                step = np.clip(piece.ways_m[i] / by_camera[i] - ratios[i], -_RATIO_STEP, _RATIO_STEP)
                ratios[i] += way_m / self._weights[i] * step
        if piece.turn_rad is not None:
            variance = sigma**2 + _BIAS_WALK_RAD_S**2 * seconds
            gain = variance / (variance + _BIAS_PIECE_RAD_S**2)
            bias += gain * ((piece.turn_rad - piece.camera[5]) / seconds - bias)
            sigma = math.sqrt((1 - gain) * variance)
        self._usual = Usual(ratios, bias, sigma)

    def _end_faults(self, piece: Piece, is_first: bool) -> None:
        """End each fault whose sensor has agreed with the others for long enough, over pieces of all lengths."""
        for sensor in list(self.faults):
            agrees = self._agrees(piece, sensor, self._usual, self._sound[sensor], is_first)
            if agrees and (self._sound[sensor] >= self._again[sensor]).all():
                self._end_fault(sensor, piece.end_s, self._found[sensor][3])
            elif sensor in self._rescaled:  # a slow piece agrees with both scales
                self._use_new_scale(piece, sensor, is_first)

    def _use_new_scale(self, piece: Piece, sensor: RobotSensor, is_first: bool) -> None:
        """End the fault of a wheel that has agreed with the others by a new scale for long enough."""
        side, agreed = 0 if sensor is LEFT else 1, self._rescaled[sensor]
        pieces = [one for one in self._pieces if one.begin_s > self.faults[sensor]]
        measured_m, true_m = wheel_ways(pieces, sensor, self._usual, self._half_m)
        _, sigma = factor_of(measured_m, true_m)
        # Of the whole way, in which the errors of the camera at the ends of its pieces cancel.
        factor = float(measured_m @ np.sign(true_m) / max(np.abs(true_m).sum(), 1e-9))
        usual = self._usual._replace(ratios=self._usual.ratios * np.where(np.arange(2) == side, factor, 1.0))
        is_scale = _RESCALED[0] < factor < _RESCALED[1] and sigma < _RESCALED_SIGMA
        if not (is_scale and self._agrees(piece, sensor, usual, agreed, is_first)):
            agreed[:] = 0.0
        elif agreed[0] >= _RESCALED_WAY_M and agreed[1] >= _RESCALED_S:
            self._new_scales[side] *= factor
            cause = f"it counts {factor:.2f} times its way, and is used with that scale; check its tyre"
            self._end_fault(sensor, piece.end_s, cause)
            self.interrupt()  # the next pieces have the new scale

    def _agrees(self, piece: Piece, sensor: RobotSensor, usual: Usual, agreed: FloatArray, is_first: bool) -> bool:
        """Return whether a faulty sensor agrees with the others over a piece; add it to `agreed`, or clear that."""
        ratios = log_ratios(piece, self._half_m, usual, self.faults.keys() - {sensor})
        if ratios[of_sensors(ratios)[sensor]] > _AGREES_NATS:
            agreed[:] = 0.0
            return False
        if is_first:
            way_m = max(float(np.abs(piece.ways_m).max()), abs(piece.camera[0]))
            agreed += way_m, piece.end_s - piece.begin_s, abs(piece.camera[5])
        return True

    def _end_fault(self, sensor: RobotSensor, now_s: float, cause: str) -> None:
        del self.faults[sensor]
        for scale in self._scales:
            scale.clear(now_s)
        self._found[sensor] = *self._found[sensor][:2], now_s, cause
        self._warn()
