"""Fault detection by two hypotheses: the wheels slip, or vision fails. A mixture covers both until one is rejected."""

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
from wheelsight.core.settings.fusion import FilterParameters
from wheelsight.estimation.filter_kernels import leap_kernel, speed_kernel
from wheelsight.estimation.pose_belief import (
    IN_PLANE,
    LAG,
    Innovation,
    Odometer,
    PoseBelief,
    Preintegration,
    RelativePose,
    Teaches,
    WheelNoise,
    changed,
)

# Fault detection: where camera and wheels contradict each other, do the wheels slip, or does vision fail?
#
# While both agree, one belief takes both. A measurement that lies outside the gate splits it into two hypotheses: one
# in which vision fails and the wheels go on, one in which the wheels slip and the camera leads. The log-likelihood
# ratio between them, in nats, sums up frame by frame (Wald 1945) until one is decided:
#
# - the one whose own speed changed more than a robot's can, at the onset or since, is the one that is wrong; - the
# gyroscope, where there is one, turns with one of both; - a camera with its usual share of inliers that goes on
# contradicting the wheels speaks for slip, since wheels cannot notice that they slip; one with fewer, or that
# contradicts a part of its view, or fails, against itself. One that does not see all directions speaks for neither:
# what it has wrong of these it mistakes for the others.
#
# A measurement that even slipping wheels could not explain, because it leaves the floor's plane, is refused and tells
# nothing of both. Until it is decided both hypotheses go on, and the answer lies between and covers both. Where both
# agree again before, the likelier one goes on, and covers the other. Decided for the wheels, the answer is theirs,
# and covers the camera's as long as that looks well. A fault is over after a row of measurements that agree; or slip
# is decided after all, when a camera has gone on looking well and contradicting for a second or two: what fails
# mostly does not last so long. As it may, the answer then covers the wheels'.


_YAW = 2


class Fault(Enum):
    """What is wrong: nothing; one of wheels and vision, undecided which; the wheels slip; vision fails."""

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
        """Of a motion (4, 4) with its covariance (3, 3)."""
        return cls(*speed_kernel(T, covariance, seconds))

    def leap_from(self, before: Speed, seconds: float, settings: FilterParameters) -> float:
        """χ² of the change of speed since, against what a robot does in so many seconds; 0 where that is no wonder."""
        s = settings
        usual = (s.leap_m_s2 * seconds, s.leap_m_s2 * s.leap_side_share * seconds, s.leap_rad_s2 * seconds)
        leap = leap_kernel(self.mean, self.covariance, before.mean, before.covariance, usual)
        return min(leap, s.leap_chi2_cap) if leap > _quantile(s.leap_confidence, 3) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class LastMeasurement:
    """The last measurement, and the odometer then, kept to tell leaps at the next."""

    stamp_s: float
    measurement: RelativePose
    odometer: Odometer
    camera: Speed | None = None
    wheels: Speed | None = None


@dataclass(frozen=True, eq=False)
class FaultDetection:
    """What is wrong, the hypotheses, and what speaks for each.

    Attributes:
        primary: the belief that is answered; while UNDECIDED, the hypothesis that vision fails.
        alternative: while UNDECIDED, the hypothesis that wheels slip; with VISION too, while the camera looks well and
            agrees with it.
        fault: what is wrong.
        log_ratio: log-likelihood ratio of slip to visual failure, nats.
        agreed: measurements that agreed in a row.
        since_s: when `fault` last changed.
        last: the last measurement.
        odometer: of wheels and gyroscope.
        usual_share: of inliers, where measurements tell it.
        nis: of the measurement just taken, and its degrees of freedom; or None.
        gyro_s: of the last yaw rate.
        gyro_rad, gyro_told_s: how far the gyroscope turned since it was last measured by, and in how long.
        turn_slip_s: when the gyroscope last contradicted the wheels.
        measured_s: of the last measurement that told anything.
        slipped_s: when wheels were last known to slip.
        preintegration: of the wheels, since the pose was remembered that the camera measures against.
        noise: of the wheels, as known by now.
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
    gyro_told_s: float = 0.0
    turn_slip_s: float = -np.inf
    measured_s: float = -np.inf
    slipped_s: float = -np.inf
    preintegration: Preintegration | None = None
    noise: WheelNoise = field(default_factory=WheelNoise)

    @property
    def alternative_probability(self) -> float:
        """Probability that wheels slip, while UNDECIDED."""
        return float(1 / (1 + np.exp(-self.log_ratio)))

    def answer(self, settings: FilterParameters) -> PoseBelief:
        """The belief to answer with: it covers the alternative, and lies between both while UNDECIDED."""
        if self.alternative is None:
            return self.primary
        if self.fault is Fault.VISION:
            return covering(self.primary, self.alternative, self.since_s, settings.covered_sigmas)
        return mixed(self.primary, self.alternative, self.alternative_probability)

    def likelier(self, settings: FilterParameters) -> PoseBelief:
        """Where it stays undecided: the likelier hypothesis, so much less certain that it covers the other.

        Not what lies between: measurements against poses remembered since tell so little of it that noise would decide.
        """
        if self.alternative is None:
            return self.primary
        first, second = (self.alternative, self.primary) if self.log_ratio > 0 else (self.primary, self.alternative)
        return covering(first, second, self.since_s, settings.covered_sigmas).vision_accepted()


def gate(settings: FilterParameters, degrees: int) -> float:
    """The largest NIS that a good measurement of so many degrees of freedom has, but for `1 - confidence` of them."""
    return _quantile(settings.confidence, degrees)


@cache
def gate_of(wrongly: float) -> float:
    """The largest NIS of one degree of freedom that a good measurement has, but for such a share of them."""
    return float(chdtri(1, wrongly))


def updated(
    detection: FaultDetection, stamp_s: float, measurement: RelativePose, settings: FilterParameters
) -> tuple[FaultDetection, Reason | None]:
    """The detection after a measurement, and why it was not believed, or None."""
    most = gate(settings, len(measurement.covariance))
    last, log_ratio = _compare(detection, stamp_s, measurement, settings)
    teaches = Teaches.MOUNT if stamp_s - detection.since_s > settings.slippery_s else Teaches.ERRORS
    usual = detection.primary.innovation(measurement, settings, without_slip=True, teaches=teaches)
    agrees = usual.nis <= most
    agreed, nis = detection.agreed + 1 if agrees else 0, (usual.nis, len(usual.residual))
    heard = changed(detection, last=last, agreed=agreed, nis=nis, measured_s=stamp_s)
    if detection.fault is Fault.NONE:
        heard = changed(heard, log_ratio=detection.log_ratio * settings.likelihood_memory + log_ratio)
        return _without_fault(heard, stamp_s, measurement, usual, most, settings)
    if detection.fault is Fault.UNDECIDED:
        return _undecided(heard, stamp_s, measurement, log_ratio, agrees, settings)
    if detection.fault is Fault.WHEEL_SLIP:
        return _by_camera(heard, stamp_s, measurement, most, settings)
    seconds = 0.0 if detection.last is None else stamp_s - detection.last.stamp_s
    if agreed == 0 and _shows_all(measurement):
        log_ratio += min(seconds, settings.compared_s) * settings.contradiction_nats_per_s
    return _by_wheels(heard, stamp_s, measurement, log_ratio, settings)


def vision_failed(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """The detection after a frame in which the camera itself says that it sees nothing."""
    blind = changed(detection, last=None, agreed=0)
    if detection.fault is Fault.UNDECIDED:
        return _settled(changed(blind, log_ratio=detection.log_ratio - settings.poor_inliers_nats), stamp_s, settings)
    return changed(blind, alternative=None)


def end_undecided(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """With a fault that has been undecided too long, or slip that no camera shows any more, ended."""
    if stamp_s - detection.since_s <= settings.undecided_s:
        return detection
    if detection.fault is Fault.UNDECIDED:
        return changed(_with_fault(detection, Fault.NONE, stamp_s), primary=detection.likelier(settings), log_ratio=0.0)
    lone = stamp_s - detection.measured_s > settings.undecided_s
    if detection.fault is not Fault.WHEEL_SLIP or not lone:
        return detection
    return changed(_with_fault(detection, Fault.NONE, stamp_s), primary=detection.primary.vision_accepted())


def _without_fault(
    detection: FaultDetection,
    stamp_s: float,
    measurement: RelativePose,
    usual: Innovation,
    most: float,
    settings: FilterParameters,
) -> tuple[FaultDetection, Reason | None]:
    if usual.nis <= most:
        return changed(
            _healthier(detection, measurement, settings), primary=detection.primary.corrected(usual).vision_accepted()
        ), None
    alternative = _led_by_camera(detection.primary, stamp_s, measurement, settings)
    if alternative is None:
        return detection, Reason.CONTRADICTION
    # Where wheels slipped a moment ago, they do so again sooner than the camera fails.
    again = settings.contradiction_nats if stamp_s - detection.slipped_s <= settings.slippery_s else 0.0
    split = changed(
        _with_fault(detection, Fault.UNDECIDED, stamp_s), alternative=alternative, log_ratio=detection.log_ratio + again
    )
    return _verdict(_settled(split, stamp_s, settings))


def _undecided(
    detection: FaultDetection,
    stamp_s: float,
    measurement: RelativePose,
    log_ratio: float,
    agrees: bool,
    settings: FilterParameters,
) -> tuple[FaultDetection, Reason | None]:
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


def _by_camera(
    detection: FaultDetection, stamp_s: float, measurement: RelativePose, most: float, settings: FilterParameters
) -> tuple[FaultDetection, Reason | None]:
    by = detection.primary.innovation(measurement, settings)
    if by.nis > most or not _is_healthy(detection, measurement, settings):
        return detection, Reason.CONTRADICTION
    if detection.agreed >= settings.agreements:
        detection = _with_fault(detection, Fault.NONE, stamp_s)
    return changed(detection, primary=detection.primary.corrected(by).vision_accepted()), None


def _by_wheels(
    detection: FaultDetection, stamp_s: float, measurement: RelativePose, log_ratio: float, settings: FilterParameters
) -> tuple[FaultDetection, Reason | None]:
    if detection.agreed >= settings.agreements:
        belief = detection.answer(settings).vision_accepted()
        belief = belief.corrected(belief.innovation(measurement, settings)).vision_accepted()
        return changed(_with_fault(detection, Fault.NONE, stamp_s), primary=belief, log_ratio=0.0), None
    if not _is_healthy(detection, measurement, settings):
        return changed(detection, alternative=None), Reason.CONTRADICTION
    by = None if detection.alternative is None else detection.alternative.innovation(measurement, settings)
    if detection.alternative is None or by is None or by.nis > gate(settings, len(measurement.covariance)):
        return changed(
            detection, alternative=_led_by_camera(detection.primary, stamp_s, measurement, settings)
        ), Reason.CONTRADICTION
    log_ratio = max(detection.log_ratio + log_ratio, -settings.decision_nats)
    detection = changed(
        detection, alternative=detection.alternative.corrected(by).vision_accepted(), log_ratio=log_ratio
    )
    return _verdict(_settled(detection, stamp_s, settings))


def _settled(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """The detection, with one of both beliefs alone where the log_ratio is decisive."""
    if detection.log_ratio > settings.decision_nats:
        assert detection.alternative is not None
        camera = detection.alternative
        if detection.fault is Fault.VISION:
            # A camera that fails for long looks just so: whoever is right, the other has to be covered.
            camera = covering(camera, detection.primary, detection.since_s, settings.covered_sigmas).vision_accepted()
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
    slipped_s = stamp_s if detection.fault is Fault.WHEEL_SLIP else detection.slipped_s
    return changed(detection, fault=fault, alternative=None, agreed=0, since_s=stamp_s, slipped_s=slipped_s)


def _led_by_camera(
    belief: PoseBelief, stamp_s: float, measurement: RelativePose, settings: FilterParameters
) -> PoseBelief | None:
    """The belief if wheels slipped since the measurement's reference; None where not even that explains it."""
    since_s = belief.remembered[belief.reference(measurement.name) - 1].stamp_s
    slipping = belief.slipped(max(stamp_s - since_s, 0.0), settings, since_s)
    by = slipping.innovation(measurement, settings)
    return slipping.corrected(by).vision_accepted() if by.nis <= gate(settings, len(measurement.covariance)) else None


def _compare(
    detection: FaultDetection, stamp_s: float, measurement: RelativePose, settings: FilterParameters
) -> tuple[LastMeasurement, float]:
    """This measurement as a last, and the log_ratio of leaps and of the gyroscope."""
    last = detection.last
    seconds = np.inf if last is None else stamp_s - last.stamp_s
    step = None if last is None else _since(last, measurement, detection.primary)
    if last is None or step is None or not 0 < seconds <= settings.compared_s:
        return LastMeasurement(stamp_s, measurement, detection.odometer), 0.0
    told, log_ratio = detection.odometer.since(last.odometer), 0.0
    camera, wheels = Speed.over(step[0], step[1], seconds), None
    if told.heard_s > 0.5 * seconds:
        wheels = Speed.over(told.T, detection.noise.ratio * told.covariance[IN_PLANE], told.heard_s)
    if wheels is not None and last.wheels is not None and last.camera is not None:
        log_ratio += 0.5 * wheels.leap_from(last.wheels, seconds, settings)
        log_ratio -= 0.5 * camera.leap_from(last.camera, seconds, settings)
    if wheels is not None and told.turned_s > 0.5 * seconds:
        rate = told.turn_rad / told.turned_s
        log_ratio += _turns_against(wheels, rate, seconds, settings) - _turns_against(camera, rate, seconds, settings)
    return LastMeasurement(stamp_s, measurement, detection.odometer, camera, wheels), log_ratio


def _turns_against(speed: Speed, rate_rad_s: float, seconds: float, settings: FilterParameters) -> float:
    """Nats that a gyroscope tells against a source that turns so."""
    variance = settings.gyro.noise_rad_per_sqrt_s**2 / seconds + speed.covariance[_YAW, _YAW]
    return float(min((speed.mean[_YAW] - rate_rad_s) ** 2 / variance, settings.leap_chi2_cap) / 2)


def _since(
    last: LastMeasurement, measurement: RelativePose, belief: PoseBelief
) -> tuple[FloatArray, FloatArray] | None:
    """The camera's own motion since the last measurement, and its covariance (3, 3); None where references differ."""
    reference_s = belief.remembered[belief.reference(measurement.name) - 1].stamp_s
    if reference_s == last.stamp_s:
        return measurement.Z, measurement.spread[IN_PLANE]
    if reference_s > last.stamp_s or last.measurement.name != measurement.name:
        return None
    # What both measurements have wrong adds up.
    T, spread = motions.between(last.measurement.Z, -last.measurement.spread, measurement.Z, measurement.spread)
    return T, spread[IN_PLANE]


def _shows_all(measurement: RelativePose) -> bool:
    return len(measurement.covariance) == 6


def _is_healthy(detection: FaultDetection, measurement: RelativePose, settings: FilterParameters) -> bool:
    """Whether a measurement that contradicts the wheels may be right.

    It has its usual share of inliers, and does not contradict the view. Somebody who walks past close by has most
    inliers, and the room behind is left out, or off: wheels that slip leave the view whole.
    """
    if measurement.fitting is not None and measurement.fitting < settings.fitting_share:
        return False
    if measurement.inlier_share is None or detection.usual_share is None:
        return True
    return measurement.inlier_share >= settings.inlier_share * detection.usual_share


def _healthier(detection: FaultDetection, measurement: RelativePose, settings: FilterParameters) -> FaultDetection:
    if measurement.inlier_share is None:
        return detection
    if detection.usual_share is None:
        return changed(detection, usual_share=measurement.inlier_share)
    change = settings.inlier_memory * (measurement.inlier_share - detection.usual_share)
    return changed(detection, usual_share=detection.usual_share + change)


# Two beliefs, of which one is right, as one: what lies between both, or the one that covers the other.


def mixed(one: PoseBelief, other: PoseBelief, share: float) -> PoseBelief:
    """One belief with the moments of both, where `other` is right with probability `share`: it covers both."""
    way = [motions.log(motions.times(T, motions.inverse(S))) for T, S in zip(other.T, one.T, strict=True)]
    between = one.moved(share * np.concatenate([*way, other.rest - one.rest]), one.covariance)
    P = np.zeros_like(one.covariance)
    for belief, weight in ((one, 1 - share), (other, share)):
        apart = _shift(between, belief)
        P += weight * (belief.covariance + np.outer(apart, apart))
    return changed(between, covariance=P).vision_accepted()


def covering(one: PoseBelief, other: PoseBelief, since_s: float, sigmas: float) -> PoseBelief:
    """The one, so much less certain that `other` lies at so many standard deviations.

    They have gone apart since a stamp; of poses remembered later, all err as the one now does.
    """
    apart = _shift(one, other)
    apart[one.rest_at :] = 0.0  # twist and wheels are soon known again; they must not pull the pose along then
    later = [0, *(place + 1 for place, pose in enumerate(one.remembered) if pose.stamp_s > since_s)]
    apart[: one.rest_at].reshape(-1, 6)[later] = apart[:6]
    P = one.covariance + np.outer(apart, apart) / sigmas**2
    P[: one.rest_at, : one.rest_at] += _less_known(one, other)
    return changed(one, covariance=P)


def _less_known(one: PoseBelief, other: PoseBelief) -> FloatArray:
    """Covariance (6 + 6K, 6 + 6K) that the one's poses lack to be as uncertain as those of `other`.

    What both were uncertain of before they went apart counts once; where one is in the map is of no account, so they
    are compared from where the base is. The begin of a step lacks what the base does: the step is as certain as it was.
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
    """Where poses stand in a covariance."""
    return np.asarray((6 * np.array(places)[:, None] + np.arange(6)).ravel())


def _of_poses_alone(belief: PoseBelief) -> FloatArray:
    """Covariance (6 + 6K, 6 + 6K) of the poses if twist and lag were known, by which the camera has them apart."""
    poses, given = slice(belief.rest_at), belief.rest_at + np.array([0, 1, 2, LAG])
    C, V = belief.covariance[poses, given], belief.covariance[np.ix_(given, given)]
    return np.asarray(belief.covariance[poses, poses] - C @ np.linalg.pinv(V, hermitian=True) @ C.T)


def _shift(one: PoseBelief, other: PoseBelief) -> FloatArray:
    """The perturbation (n,) that, to first order, puts every pose where `other` has it, however they are turned."""
    shifts = np.zeros((len(one.T), 6))
    for shift, T, S in zip(shifts, other.T, one.T, strict=True):
        shift[:] = _shift_of(S, T)
    return np.concatenate([shifts.ravel(), other.rest - one.rest])


def covering_pose(
    T_one: FloatArray, one: FloatArray, T_other: FloatArray, other: FloatArray, sigmas: float
) -> tuple[FloatArray, FloatArray]:
    """The one pose (4, 4), and a covariance (6, 6) by which the other's lies at so many standard deviations."""
    apart = _shift_of(T_one, T_other)
    return T_one, one + other + np.outer(apart, apart) / sigmas**2


def _shift_of(T_from: FloatArray, T_to: FloatArray) -> FloatArray:
    """The perturbation (6,) that, to first order, puts one pose (4, 4) where the other is."""
    turn = motions.log(motions.times(T_to, motions.inverse(T_from)))[3:]
    return np.concatenate([T_to[:3, 3] - T_from[:3, 3] - np.cross(turn, T_from[:3, 3]), turn])
