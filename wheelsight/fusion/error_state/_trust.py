"""Whom to believe when camera and wheels contradict each other: a sequential test of slip against visual failure.

While both agree, one belief takes both. A look that lies outside the gate splits it in two: one in which vision fails
and the wheels go on, one in which the wheels slip and the camera leads. Evidence between them, in nats, sums up frame
by frame (Wald 1945) until one is settled:

- who leapt: the one whose own speed changed more than a robot's can, at the onset or since, is the one that is wrong;
- the gyroscope, where there is one: with whom it turns;
- a camera with its usual share of inliers that goes on contradicting the wheels speaks for slip, since wheels cannot
  notice that they slip; one with fewer, or that fails, against itself.

A look that even slipping wheels could not explain, because it leaves the floor's plane, is refused and speaks for
nobody. Until it is settled both beliefs go on, and the answer lies between and covers both. Where both agree again
before, the one for which more speaks goes on, and covers the other. Settled for the wheels, the
answer is theirs, and covers the camera's as long as that looks well. Trust comes back with a row of looks that agree;
or the camera gets it, when it has gone on looking well and contradicting for a second or two: what fails does not last.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from functools import cache

import numpy as np

from wheelsight.estimates import Reason
from wheelsight.fusion.error_state import _step_kernels as steps
from wheelsight.fusion.error_state._changed import changed
from wheelsight.fusion.error_state._measurements import Innovation, Look
from wheelsight.fusion.error_state._odometer import Odometer
from wheelsight.fusion.error_state._pose_belief import IN_PLANE, PoseBelief, Teaches
from wheelsight.fusion.error_state._two_beliefs import covering, mixed
from wheelsight.fusion.error_state._wheel_noise import Ride, WheelNoise
from wheelsight.fusion.error_state.settings import FilterParameters
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions

_YAW = 2


class Trust(Enum):
    """Who is believed."""

    BOTH = "both"
    DOUBT = "doubt"
    CAMERA = "camera"
    WHEELS = "wheels"


@dataclass(frozen=True, slots=True, eq=False)
class Speed:
    """Mean velocity (3,) in the plane over an interval, and its covariance (3, 3)."""

    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def over(cls, T: FloatArray, covariance: FloatArray, seconds: float) -> Speed:
        """Of a motion (4, 4) with its covariance (3, 3)."""
        return cls(*steps.speed(T, covariance, seconds))

    def leap_from(self, before: Speed, seconds: float, settings: FilterParameters) -> float:
        """χ² of the change of speed since, against what a robot does in so many seconds; 0 where that is no wonder."""
        s = settings
        usual = (s.leap_m_s2 * seconds, s.leap_m_s2 * s.leap_side_share * seconds, s.leap_rad_s2 * seconds)
        leap = steps.leap(self.mean, self.covariance, before.mean, before.covariance, usual)
        return min(leap, s.leap_chi2_cap) if leap > _quantile(s.leap_confidence, 3) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """The last look, and the odometer then, kept to tell leaps at the next."""

    stamp_s: float
    look: Look
    odometer: Odometer
    camera: Speed | None = None
    wheels: Speed | None = None


@dataclass(frozen=True, eq=False)
class Court:
    """Beliefs, whom to trust, and why.

    Attributes:
        belief: the one that is answered; in DOUBT, the one that trusts the wheels.
        rival: in DOUBT, the one that trusts the camera; with WHEELS too, while the camera is well and agrees with it.
        trust: whom.
        evidence: nats for slip, less those for visual failure.
        agreed: looks that agreed in a row.
        since_s: when `trust` last changed.
        glance: the last look.
        odometer: of wheels and gyroscope.
        usual_share: of inliers, where looks tell it.
        nis: of the measurement just taken, and its degrees of freedom; or None.
        gyro_s: of the last yaw rate.
        gyro_rad, gyro_told_s: how far the gyroscope turned since it was last measured by, and in how long.
        turn_slip_s: when the gyroscope last contradicted the wheels.
        looked_s: of the last look that told anything.
        slipped_s: when wheels were last known to slip.
        ride: of the wheels, since the pose was remembered that the camera looks at.
        noise: of the wheels, as known by now.
    """

    belief: PoseBelief
    rival: PoseBelief | None = None
    trust: Trust = Trust.BOTH
    evidence: float = 0.0
    agreed: int = 0
    since_s: float = -np.inf
    glance: Glance | None = None
    odometer: Odometer = field(default_factory=Odometer)
    usual_share: float | None = None
    nis: tuple[float, int] | None = None
    gyro_s: float | None = None
    gyro_rad: float = 0.0
    gyro_told_s: float = 0.0
    turn_slip_s: float = -np.inf
    looked_s: float = -np.inf
    slipped_s: float = -np.inf
    ride: Ride | None = None
    noise: WheelNoise = field(default_factory=WheelNoise)

    @property
    def rival_share(self) -> float:
        """Probability that the camera is right, in DOUBT."""
        return float(1 / (1 + np.exp(-self.evidence)))

    def answer(self, settings: FilterParameters) -> PoseBelief:
        """The belief to answer with: it covers the rival, and lies between both in DOUBT."""
        if self.rival is None:
            return self.belief
        if self.trust is Trust.WHEELS:
            return covering(self.belief, self.rival, self.since_s, settings.covered_sigmas)
        return mixed(self.belief, self.rival, self.rival_share)

    def likelier(self, settings: FilterParameters) -> PoseBelief:
        """Where doubt ends unsettled: the belief for which more speaks, so much less certain that it covers the other.

        Not what lies between: looks at poses remembered since tell so little of who was right that noise decided.
        """
        if self.rival is None:
            return self.belief
        first, second = (self.rival, self.belief) if self.evidence > 0 else (self.belief, self.rival)
        return covering(first, second, self.since_s, settings.covered_sigmas).believed()


def gate(settings: FilterParameters, degrees: int) -> float:
    """The largest NIS that a good measurement of so many degrees of freedom has, but for `1 - confidence` of them."""
    return _quantile(settings.confidence, degrees)


@cache
def gate_of(wrongly: float) -> float:
    """The largest NIS of one degree of freedom that a good measurement has, but for such a share of them."""
    from scipy.stats import chi2

    return float(chi2.isf(wrongly, 1))


@cache
def _quantile(share: float, degrees: int) -> float:
    from scipy.stats import chi2

    return float(chi2.ppf(share, degrees))


def see(court: Court, stamp_s: float, look: Look, settings: FilterParameters) -> tuple[Court, Reason | None]:
    """The court after a look, and why it was not believed, or None."""
    most = gate(settings, len(look.covariance))
    glance, evidence = _compare(court, stamp_s, look, settings)
    teaches = Teaches.MOUNT if stamp_s - court.since_s > settings.slippery_s else Teaches.ERRORS
    usual = court.belief.innovation(look, settings, without_doubt=True, teaches=teaches)
    agrees = usual.nis <= most
    agreed, nis = court.agreed + 1 if agrees else 0, (usual.nis, len(usual.residual))
    heard = changed(court, glance=glance, agreed=agreed, nis=nis, looked_s=stamp_s)
    if court.trust is Trust.BOTH:
        heard = changed(heard, evidence=court.evidence * settings.likelihood_memory + evidence)
        return _together(heard, stamp_s, look, usual, most, settings)
    if court.trust is Trust.DOUBT:
        return _in_doubt(heard, stamp_s, look, evidence, agrees, settings)
    if court.trust is Trust.CAMERA:
        return _by_camera(heard, stamp_s, look, most, settings)
    seconds = 0.0 if court.glance is None else stamp_s - court.glance.stamp_s
    if agreed == 0:
        evidence += min(seconds, settings.compared_s) * settings.contradiction_nats_per_s
    return _by_wheels(heard, stamp_s, look, evidence, settings)


def fail(court: Court, stamp_s: float, settings: FilterParameters) -> Court:
    """The court after a frame in which the camera itself says that it sees nothing."""
    blind = changed(court, glance=None, agreed=0)
    if court.trust is Trust.DOUBT:
        return _settled(changed(blind, evidence=court.evidence - settings.poor_inliers_nats), stamp_s, settings)
    return changed(blind, rival=None)


def end_doubt(court: Court, stamp_s: float, settings: FilterParameters) -> Court:
    """The court with doubt, or distrust of wheels that no camera renews, ended when it has lasted too long."""
    if stamp_s - court.since_s <= settings.undecided_s:
        return court
    if court.trust is Trust.DOUBT:
        return changed(_trusting(court, Trust.BOTH, stamp_s), belief=court.likelier(settings), evidence=0.0)
    lone = stamp_s - court.looked_s > settings.undecided_s
    if court.trust is not Trust.CAMERA or not lone:
        return court
    return changed(_trusting(court, Trust.BOTH, stamp_s), belief=court.belief.believed())


def _together(
    court: Court, stamp_s: float, look: Look, usual: Innovation, most: float, settings: FilterParameters
) -> tuple[Court, Reason | None]:
    if usual.nis <= most:
        return changed(_healthier(court, look, settings), belief=court.belief.corrected(usual).believed()), None
    rival = _led_by_camera(court.belief, stamp_s, look, settings)
    if rival is None:
        return court, Reason.CONTRADICTION
    # Where wheels slipped a moment ago, they do so again sooner than the camera fails.
    again = settings.contradiction_nats if stamp_s - court.slipped_s <= settings.slippery_s else 0.0
    split = changed(_trusting(court, Trust.DOUBT, stamp_s), rival=rival, evidence=court.evidence + again)
    return _verdict(_settled(split, stamp_s, settings))


def _in_doubt(
    court: Court, stamp_s: float, look: Look, evidence: float, agrees: bool, settings: FilterParameters
) -> tuple[Court, Reason | None]:
    assert court.rival is not None
    by = court.rival.innovation(look, settings)
    fits = by.nis <= gate(settings, len(look.covariance))
    rival = court.rival.corrected(by).believed() if fits else court.rival
    if not agrees:
        is_healthy = fits and _is_healthy(court, look, settings)
        evidence += settings.contradiction_nats if is_healthy else -settings.poor_inliers_nats
    court = changed(court, rival=rival, evidence=court.evidence + evidence)
    if court.agreed >= settings.agreements:
        return changed(_trusting(court, Trust.BOTH, stamp_s), belief=court.likelier(settings), evidence=0.0), None
    return _verdict(_settled(court, stamp_s, settings))


def _by_camera(
    court: Court, stamp_s: float, look: Look, most: float, settings: FilterParameters
) -> tuple[Court, Reason | None]:
    by = court.belief.innovation(look, settings)
    if by.nis > most or not _is_healthy(court, look, settings):
        return court, Reason.CONTRADICTION
    if court.agreed >= settings.agreements:
        court = _trusting(court, Trust.BOTH, stamp_s)
    return changed(court, belief=court.belief.corrected(by).believed()), None


def _by_wheels(
    court: Court, stamp_s: float, look: Look, evidence: float, settings: FilterParameters
) -> tuple[Court, Reason | None]:
    if court.agreed >= settings.agreements:
        belief = court.answer(settings).believed()
        belief = belief.corrected(belief.innovation(look, settings)).believed()
        return changed(_trusting(court, Trust.BOTH, stamp_s), belief=belief, evidence=0.0), None
    if not _is_healthy(court, look, settings):
        return changed(court, rival=None), Reason.CONTRADICTION
    by = None if court.rival is None else court.rival.innovation(look, settings)
    if court.rival is None or by is None or by.nis > gate(settings, len(look.covariance)):
        return changed(court, rival=_led_by_camera(court.belief, stamp_s, look, settings)), Reason.CONTRADICTION
    evidence = max(court.evidence + evidence, -settings.decision_nats)
    court = changed(court, rival=court.rival.corrected(by).believed(), evidence=evidence)
    return _verdict(_settled(court, stamp_s, settings))


def _settled(court: Court, stamp_s: float, settings: FilterParameters) -> Court:
    """The court, with one of both beliefs alone where the evidence is decisive."""
    if court.evidence > settings.decision_nats:
        assert court.rival is not None
        return changed(_trusting(court, Trust.CAMERA, stamp_s), belief=court.rival, evidence=0.0)
    if court.evidence < -settings.decision_nats:
        return changed(_trusting(court, Trust.WHEELS, stamp_s), rival=court.rival, evidence=-settings.decision_nats)
    return court


def _verdict(court: Court) -> tuple[Court, Reason | None]:
    return court, None if court.trust is Trust.CAMERA else Reason.CONTRADICTION


def _trusting(court: Court, trust: Trust, stamp_s: float) -> Court:
    slipped_s = stamp_s if court.trust is Trust.CAMERA else court.slipped_s
    return changed(court, trust=trust, rival=None, agreed=0, since_s=stamp_s, slipped_s=slipped_s)


def _led_by_camera(belief: PoseBelief, stamp_s: float, look: Look, settings: FilterParameters) -> PoseBelief | None:
    """The belief if wheels slipped since the look's reference; None where not even that explains it."""
    since_s = belief.remembered[belief.reference(look.name) - 1].stamp_s
    distrusting = belief.distrusted(max(stamp_s - since_s, 0.0), settings)
    by = distrusting.innovation(look, settings)
    return distrusting.corrected(by).believed() if by.nis <= gate(settings, len(look.covariance)) else None


def _compare(court: Court, stamp_s: float, look: Look, settings: FilterParameters) -> tuple[Glance, float]:
    """This look as a glance, and the evidence of leaps and of the gyroscope."""
    last = court.glance
    seconds = np.inf if last is None else stamp_s - last.stamp_s
    step = None if last is None else _since(last, look, court.belief)
    if last is None or step is None or not 0 < seconds <= settings.compared_s:
        return Glance(stamp_s, look, court.odometer), 0.0
    told, evidence = court.odometer.since(last.odometer), 0.0
    camera, wheels = Speed.over(step[0], step[1], seconds), None
    if told.heard_s > 0.5 * seconds:
        wheels = Speed.over(told.T, court.noise.ratio * told.covariance[IN_PLANE], told.heard_s)
    if wheels is not None and last.wheels is not None and last.camera is not None:
        evidence += 0.5 * wheels.leap_from(last.wheels, seconds, settings)
        evidence -= 0.5 * camera.leap_from(last.camera, seconds, settings)
    if wheels is not None and told.turned_s > 0.5 * seconds:
        rate = told.turn_rad / told.turned_s
        evidence += _turns_against(wheels, rate, seconds, settings) - _turns_against(camera, rate, seconds, settings)
    return Glance(stamp_s, look, court.odometer, camera, wheels), evidence


def _turns_against(speed: Speed, rate_rad_s: float, seconds: float, settings: FilterParameters) -> float:
    """Evidence of a gyroscope against a source that turns so."""
    variance = settings.gyro.noise_rad_per_sqrt_s**2 / seconds + speed.covariance[_YAW, _YAW]
    return float(min((speed.mean[_YAW] - rate_rad_s) ** 2 / variance, settings.leap_chi2_cap) / 2)


def _since(last: Glance, look: Look, belief: PoseBelief) -> tuple[FloatArray, FloatArray] | None:
    """The camera's own motion since the last look, and its covariance (3, 3); None where references differ."""
    reference_s = belief.remembered[belief.reference(look.name) - 1].stamp_s
    if reference_s == last.stamp_s:
        return look.Z, look.spread[IN_PLANE]
    if reference_s > last.stamp_s or last.look.name != look.name:
        return None
    # What both looks have wrong adds up.
    T, spread = motions.between(last.look.Z, -last.look.spread, look.Z, look.spread)
    return T, spread[IN_PLANE]


def _is_healthy(court: Court, look: Look, settings: FilterParameters) -> bool:
    """Whether a look that contradicts the wheels may be right: it has its usual share of inliers."""
    if look.inlier_share is None or court.usual_share is None:
        return True
    return look.inlier_share >= settings.inlier_share * court.usual_share


def _healthier(court: Court, look: Look, settings: FilterParameters) -> Court:
    if look.inlier_share is None:
        return court
    if court.usual_share is None:
        return changed(court, usual_share=look.inlier_share)
    change = settings.inlier_memory * (look.inlier_share - court.usual_share)
    return changed(court, usual_share=court.usual_share + change)
