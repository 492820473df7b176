"""Fault detection: if camera and wheels contradict each other, do the wheels slip, or does vision fail?

While both agree, one belief uses both. A measurement outside the gate splits it into two hypotheses. In one, vision
fails and the pose follows the wheels. In the other, the wheels slip and the pose follows the camera. The log-likelihood
ratio between them, in nats, accumulates frame by frame (Wald 1945) until one is accepted:

- A sensor whose own velocity changed by more than a robot's can, at the onset or since, is wrong.
- A gyroscope, if there is one, agrees with one of both.
- A camera with its usual share of inliers that keeps contradicting the wheels indicates slip, which wheels cannot
  notice. One with fewer inliers, or that contradicts a part of its view or itself, indicates failing vision. One that
  does not see all directions indicates neither: errors in the unseen directions leak into the others.

A measurement that leaves the plane of the floor, so that not even slip explains it, is rejected and indicates neither.
Until a decision both hypotheses continue, and the estimate lies between them and covers both. If both agree again
before, the likelier one continues and covers the other. After a decision for the wheels, the estimate covers the
camera's while the camera looks well. A fault ends after several measurements in a row that agree. Slip is accepted
after all when a camera has looked well and contradicted the wheels for a second or two, since failures are mostly
shorter. The estimate then covers the wheels', because a failure may last that long.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from functools import cache

import numpy as np
from scipy.special import chdtri

from wheelsight.core.estimates import STEP_BEGIN, Reason
from wheelsight.core.geometry import FloatArray, IntArray
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry.chi_square import quantile as _quantile
from wheelsight.estimation.filter_kernels import leap_kernel, speed_kernel
from wheelsight.estimation.pose_belief import (
    IN_PLANE,
    LAG,
    FilterParameters,
    Innovation,
    Odometer,
    PoseBelief,
    Preintegration,
    RelativeMotion,
    Updates,
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
        return cls(*speed_kernel(T, covariance, seconds))

    def leap_from(self, before: Speed, seconds: float, settings: FilterParameters) -> float:
        """Return χ² of the change of velocity since `before`, for a robot's accelerations; 0 if it is plausible."""
        s = settings
        usual = (s.leap_m_s2 * seconds, s.leap_m_s2 * s.leap_side_share * seconds, s.leap_rad_s2 * seconds)
        leap = leap_kernel(self.mean, self.covariance, before.mean, before.covariance, usual)
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
    updates = Updates.MOUNT if stamp_s - detection.since_s > settings.slippery_s else Updates.ERRORS
    usual = detection.primary.innovation(measurement, settings, without_slip=True, updates=updates)
    agrees = usual.nis <= most
    agreed, nis = detection.agreed + 1 if agrees else 0, (usual.nis, len(usual.residual))
    now = changed(detection, last=last, agreed=agreed, nis=nis, measured_s=stamp_s)
    if detection.fault is Fault.NONE:
        now = changed(now, log_ratio=detection.log_ratio * settings.likelihood_memory + log_ratio)
        return _update_sound(now, stamp_s, measurement, usual, most, settings)
    if detection.fault is Fault.UNDECIDED:
        return _update_undecided(now, stamp_s, measurement, log_ratio, agrees, settings)
    if detection.fault is Fault.WHEEL_SLIP:
        by = now.primary.innovation(measurement, settings)
        if by.nis > most or not _is_healthy(now, measurement, settings):
            return now, Reason.CONTRADICTION
        if now.agreed >= settings.agreements:
            now = _with_fault(now, Fault.NONE, stamp_s)
        return changed(now, primary=now.primary.corrected(by).vision_accepted()), None
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
        primary = detection.primary.corrected(usual).vision_accepted()
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
    alternative = detection.alternative.corrected(by).vision_accepted() if fits else detection.alternative
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
        belief = belief.corrected(belief.innovation(measurement, settings)).vision_accepted()
        return changed(_with_fault(detection, Fault.NONE, stamp_s), primary=belief, log_ratio=0.0), None
    if not _is_healthy(detection, measurement, settings):
        return changed(detection, alternative=None), Reason.CONTRADICTION
    by = None if detection.alternative is None else detection.alternative.innovation(measurement, settings)
    if detection.alternative is None or by is None or by.nis > gate(settings, len(measurement.covariance)):
        return changed(
            detection, alternative=_slip_hypothesis(detection.primary, stamp_s, measurement, settings)
        ), Reason.CONTRADICTION
    log_ratio = max(detection.log_ratio + log_ratio, -settings.decision_nats)
    detection = changed(
        detection, alternative=detection.alternative.corrected(by).vision_accepted(), log_ratio=log_ratio
    )
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
    since_s = belief.remembered[belief.reference(measurement.name) - 1].stamp_s
    slipping = belief.slipped(max(stamp_s - since_s, 0.0), settings, since_s)
    by = slipping.innovation(measurement, settings)
    return slipping.corrected(by).vision_accepted() if by.nis <= gate(settings, len(measurement.covariance)) else None


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
    reference_s = belief.remembered[belief.reference(measurement.name) - 1].stamp_s
    if reference_s == last.stamp_s:
        return measurement.Z, measurement.spread[IN_PLANE]
    if reference_s > last.stamp_s or last.measurement.name != measurement.name:
        return None
    # The errors of both measurements add up.
    T, spread = motions.between(last.measurement.Z, -last.measurement.spread, measurement.Z, measurement.spread)
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
    between = one.moved(share * np.concatenate([*way, other.rest - one.rest]), one.covariance)
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
    apart[one.rest_at :] = 0.0  # measured again soon, which must not move the pose
    later = [0, *(place + 1 for place, pose in enumerate(one.remembered) if pose.stamp_s > since_s)]
    apart[: one.rest_at].reshape(-1, 6)[later] = apart[:6]
    P = one.covariance + np.outer(apart, apart) / sigmas**2
    P[: one.rest_at, : one.rest_at] += _less_known(one, other)
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
    poses, given = slice(belief.rest_at), belief.rest_at + np.array([0, 1, 2, LAG])
    C, V = belief.covariance[poses, given], belief.covariance[np.ix_(given, given)]
    return np.asarray(belief.covariance[poses, poses] - C @ np.linalg.pinv(V, hermitian=True) @ C.T)


def _shift(one: PoseBelief, other: PoseBelief) -> FloatArray:
    """Return the perturbation (n,) that, to first order, moves every pose to that of `other`, at any rotation."""
    shifts = np.zeros((len(one.T), 6))
    for shift, T, S in zip(shifts, other.T, one.T, strict=True):
        shift[:] = _shift_of(S, T)
    return np.concatenate([shifts.ravel(), other.rest - one.rest])


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
