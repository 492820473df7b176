"""PoseBelief: a Gaussian over poses, twist and sensor errors. The module also holds its measurements and the
adaptive wheel noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.estimates import DEGENERATE_SCALE, STEP_BEGIN, MotionEstimate, Reason
from wheelsight.core.geometry import FloatArray, IntArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.settings.fusion import FilterParameters
from wheelsight.estimation.filter_kernels import (
    Poses,
    Step,
    Told,
    Unseen,
    apart_kernel,
    coast,
    correct,
    expected,
    imaged_at,
    imaged_now,
    measured,
    odometer_kernel,
    seen_from,
    shown_kernel,
    wheel_step,
)

# PoseBelief: a Gaussian over the base's pose now and at remembered instants, its twist, and the sensors' errors.
#
# Poses err by perturbations from the left, δ with T = exp(δ) T̂. In these, a step T_before_now with error ζ gives
#
# δ_now = δ_before + Ad(T̂_before) ζ,
#
# so that what was uncertain stays as it is, whatever the way since; and a motion Z seen against a remembered pose c
# has
#
# log(Z Ẑ⁻¹) = Ad(T̂_c⁻¹) (δ_now - δ_c) + η, Ẑ = T̂_c⁻¹ T̂_now,
#
# which does not change when all poses are perturbed alike, wherever it is linearised: relative measurements never
# claim to know where the whole drive lies (Barrau & Bonnabel 2017; cloning: Roumeliotis & Burdick 2002). Beliefs do
# not change; each step answers a new one, so that a filter can go back to any it has kept.


PLANE = np.array([0, 1, 5])  # vx, vy, ωz of a (6,) perturbation
IN_PLANE = np.ix_(PLANE, PLANE)
_SIX = np.arange(6)
# Behind all poses stand, in this order: the twist, what is wrong with wheels and camera, and the gyroscope's bias.
TWIST, ERRORS, CAMERA_ERRORS, LAG, BIAS = slice(0, 3), slice(3, 6), slice(6, 15), 15, 16
REST_SIZE = 17
MOUNT_SHIFT = [10, 11]  # of the camera's errors
_NO_TWIST = np.full(3, np.nan)
_NO_SLIP = np.zeros((6, 6))


class Teaches(Enum):
    """What a measurement tells beside motion: nothing, what is wrong with the sensors, and where the camera sits, too.

    To a camera that sits elsewhere on the base, turns seem to go aside; so they do where a base still slides a little.
    """

    MOTION = 1
    ERRORS = 2
    MOUNT = 3


_UNLEARNED = {
    (teaches, shows_lag): np.array(places if shows_lag else sorted({*places, LAG}), int)
    for teaches, places in {
        Teaches.MOTION: [*range(ERRORS.start, BIAS)],
        Teaches.ERRORS: MOUNT_SHIFT,
        Teaches.MOUNT: [],
    }.items()
    for shows_lag in (True, False)
}


@dataclass(frozen=True, slots=True, eq=False)
class Remembered:
    """Of a remembered pose: its name and stamp, and the base's twist (3,), `slip_covariance` and `told` then."""

    name: str
    stamp_s: float
    twist: FloatArray
    slip_covariance: FloatArray
    told: FloatArray


@dataclass(frozen=True, eq=False)
class PoseBelief:
    """The belief; see the module.

    Attributes:
        T: (1 + K, 4, 4) T_odom_base now, and when the images were taken that have the remembered stamps.
        remembered: these instants.
        rest: (17,) twist (vx, vy, ωz), the wheels' errors (scale, drift, turn), the camera's (the same, its drift in
            pitch, its mount's shift and rotation, how late its stamps are), the gyroscope's bias.
        covariance: (6 + 6K + 17, 6 + 6K + 17) of all perturbations of poses, then of `rest`.
        slip_covariance: (6, 6) part of the pose's covariance that is there because wheels may have slipped since vision
            was last believed.
        way_m: since the floor was last taken for level.
        part_s: length of the last part of a wheel step.
        known_twist: (3,) the twist when a measurement last told it; `known_for_s` ago, its yaw rate by a gyroscope
            `turn_known_for_s` ago.
        told: (6, 3) how the wheels' errors moved the pose since the begin, as left perturbations in the map.
    """

    T: FloatArray
    remembered: tuple[Remembered, ...]
    rest: FloatArray
    covariance: FloatArray
    slip_covariance: FloatArray
    way_m: float = 0.0
    part_s: float = 0.0
    known_twist: FloatArray = field(default_factory=lambda: np.zeros(3))
    known_for_s: float = np.inf
    turn_known_for_s: float = np.inf
    told: FloatArray = field(default_factory=lambda: np.zeros((6, 3)))

    @classmethod
    def begin(cls, T_odom_base: FloatArray, covariance: FloatArray, settings: FilterParameters) -> PoseBelief:
        """At rest, at a pose with its covariance (6, 6)."""
        s = settings
        P = np.zeros((6 + REST_SIZE, 6 + REST_SIZE))
        P[:6, :6] = covariance
        still = [s.acceleration_m_s2, s.side_m_per_sqrt_m, s.acceleration_rad_s2]
        P[6:, 6:] = np.diag([*np.square(still), *s.variances])
        return cls(T_odom_base[None].copy(), (), np.zeros(REST_SIZE), P, _NO_SLIP)

    @property
    def gyro_bias_rad_s(self) -> float:
        """What the gyroscope is thought to show at rest beyond what was said before the drive."""
        return float(self.rest[BIAS])

    @property
    def wheel_errors(self) -> FloatArray:
        """(3,) scale of ways, turn a metre, scale of turns: what is thought to be wrong with the wheels."""
        return self.rest[ERRORS].copy()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the remembered poses."""
        return tuple(pose.name for pose in self.remembered)

    @property
    def rest_at(self) -> int:
        """Where `rest` begins in the covariance."""
        return len(self.covariance) - REST_SIZE

    def place(self, part: slice) -> slice:
        """Where a part of `rest` stands in the covariance."""
        return slice(self.rest_at + part.start, self.rest_at + part.stop)

    def moved_by_wheels(
        self, step: WheelStep, share: float, settings: FilterParameters, is_slipping: bool
    ) -> PoseBelief:
        """After a share of what the wheels tell, corrected by what is known to be wrong with them."""
        s, dt_s = settings, (step.end_s - step.begin_s) * share
        known = self._known_before(step, s.known_for_s)
        told_by = Step(step.xi, step.covariance, share, dt_s, known)
        unseen = Unseen(s.unseen_a_metre, s.walks, s.fades, s.lever_m)
        T, rest, P, told, way_m = wheel_step(self.T, self.rest, self.covariance, told_by, unseen)
        times = {"way_m": self.way_m + way_m, "part_s": dt_s, "known_for_s": self.known_for_s + dt_s}
        times["turn_known_for_s"] = self.turn_known_for_s + dt_s
        after = changed(self, T=T, rest=rest, covariance=P, told=self.told + told, **times)
        after = after.slipped(dt_s, s) if is_slipping else after
        return after._levelled(s) if after.way_m > s.level_every_m else after

    def _known_before(self, step: WheelStep, known_for_s: float) -> FloatArray:
        """The twist (3,) as known before a step, NaN where it is not: by its own numbers its noise would be learned."""
        if self.known_for_s < known_for_s:
            return self.known_twist
        if self.turn_known_for_s < known_for_s:  # of ways, a gyroscope teaches nothing
            return np.array([*step.xi[:2] / (step.end_s - step.begin_s), self.known_twist[2]])
        return _NO_TWIST

    def coasted(self, dt_s: float, settings: FilterParameters) -> PoseBelief:
        """After a time of which the wheels tell nothing: the twist goes on, by white noise of acceleration."""
        s = settings
        rest = self.rest
        q = np.square([s.acceleration_m_s2, s.side_acceleration_m_s2, s.acceleration_rad_s2])
        way_m = (abs(rest[0]) + s.lever_m * abs(rest[2])) * dt_s
        noise = (q, s.unseen_a_metre * way_m, dt_s, s.gyro.bias_walk_rad_s_per_sqrt_s**2 * dt_s)
        T, P = coast(self.T, rest, self.covariance, *noise)
        return changed(self, T=T, covariance=P)

    def cloned(self, name: str, stamp_s: float, most: int, spread: FloatArray | None = None) -> PoseBelief:
        """With the pose now remembered as `name`; a pose of that name before, or the oldest of too many, goes.

        `spread` (6, 6), in the base's own frame, is added to its covariance: by what the camera has it elsewhere.
        """
        there = self._at(name, stamp_s, most)
        place = there.names.index(name) + 1
        at = slice(6 * place, 6 * place + 6)
        there.T[place], rows, spread_now = there.imaged()
        there.covariance[at], there.covariance[:, at] = rows, rows.T
        there.covariance[at, at] = spread_now if spread is None else spread_now + motions.carried(self.T[0], spread)
        return there

    def _at(self, name: str, stamp_s: float, most: int) -> PoseBelief:
        """With a place for a pose of that name: the one it has, or one more, whatever stands there."""
        if name in self.names:
            poses = tuple(self._as(name, stamp_s) if pose.name == name else pose for pose in self.remembered)
            return changed(self, T=self.T.copy(), covariance=self.covariance.copy(), remembered=poses)
        here = self
        while len(here.remembered) >= most:
            here = here.dropped(min(here.remembered, key=lambda pose: pose.stamp_s).name)
        poses = (*here.remembered, self._as(name, stamp_s))
        return changed(here._selected(np.append(np.arange(len(here.T)), 0)), remembered=poses)

    def imaged(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The pose (4, 4) when the image of now was taken, its covariance with the state (6, n), and its own (6, 6).

        The camera's stamps are late by what is known as little as all else (Li & Mourikis, IJRR 2014).
        """
        T, rows, spread = imaged_now(self.T[0], self.rest, self.covariance)
        return T, rows, spread

    def dropped(self, name: str) -> PoseBelief:
        """Without the remembered pose `name`: it is marginalised, all else stays as it is."""
        if name not in self.names:
            return self
        place = self.names.index(name)
        without = self._selected(np.delete(np.arange(len(self.T)), place + 1))
        return changed(without, remembered=(*self.remembered[:place], *self.remembered[place + 1 :]))

    def _as(self, name: str, stamp_s: float) -> Remembered:
        return Remembered(name, stamp_s, self.rest[TWIST].copy(), self.slip_covariance, self.told)

    def _selected(self, poses: IntArray) -> PoseBelief:
        rows = np.concatenate([(6 * poses[:, None] + _SIX).ravel(), np.arange(self.rest_at, len(self.covariance))])
        return changed(self, T=self.T[poses], covariance=self.covariance[rows[:, None], rows])

    def reference(self, name: str) -> int:
        """Which of `T` the remembered pose `name` is. Raises KeyError."""
        if name not in self.names:
            raise KeyError(name)
        return self.names.index(name) + 1

    def seen_from(self, name: str, T_base_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
        """T_reference_current (4, 4) of the camera since the pose remembered as `name`, and its covariance (6, 6)."""
        T, C = seen_from(self.T, self.rest, self.covariance, self.reference(name), T_base_camera)
        return T, C

    def between(self, first: str, second: str, T_base_camera: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """T_first_second (4, 4) of the camera, and its covariance (6, 6); None where one of both is not remembered."""
        if first not in self.names or second not in self.names:
            return None
        one, other = self.reference(first), self.reference(second)
        T_camera_odom = motions.inverse(motions.times(self.T[one], T_base_camera))
        both = np.r_[6 * other + _SIX, 6 * one + _SIX]
        P = self.covariance[np.ix_(both, both)]
        apart = P[:6, :6] - P[:6, 6:] - P[6:, :6] + P[6:, 6:]
        T = motions.times(motions.times(T_camera_odom, self.T[other]), T_base_camera)
        return motions.mended(T), motions.carried(T_camera_odom, apart)

    def apart(self, measurement: RelativePose) -> FloatArray:
        """log(Z Ẑ⁻¹) (6,): how far the camera's motion, mended by what is known of its errors, is from the expected."""
        T_now, T_reference, told = self.since(self.reference(measurement.name))
        T_imaged = imaged_at(T_now, self.rest)
        return np.asarray(apart_kernel(T_imaged, T_reference, told, measurement.Z, self.rest[CAMERA_ERRORS]))

    def innovation(
        self,
        measurement: RelativePose,
        settings: FilterParameters,
        *,
        without_slip: bool = False,
        teaches: Teaches = Teaches.MOTION,
    ) -> Innovation:
        """What a measurement says; `without_slip` as if no wheel had slipped since vision was last believed.

        `teaches`: what else than motion. Where wheels may slip, what is off is no error of theirs or of the camera.
        """
        at = self.reference(measurement.name)
        then = self.remembered[at - 1]
        told = Told(measurement.Z, measurement.seen, measurement.covariance)
        poses = Poses(*self.since(at), 6 * at, then.twist)
        residual, S, PHt, H, nis, change = measured(poses, self.rest, self.covariance, told)
        if without_slip and not (self.slip_covariance is then.slip_covariance is _NO_SLIP):
            certain = S - H @ (self.slip_covariance - then.slip_covariance) @ H.T
            # Corrections have made some of it smaller than it was written down.
            if np.linalg.eigvalsh(certain - measurement.covariance)[0] >= 0:
                S, nis = certain, motions.chi_squared(residual, certain)
        # Where the twist changed no more, it is the wheels' noise that would be taken for a lag of the stamps.
        unlearned = _UNLEARNED[teaches, bool(change > settings.lag_chi2)]
        return Innovation(residual, S, PHt, nis, unlearned)

    def since(self, at: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The pose now, the one at a place, and how the wheels' errors moved the one since the other."""
        return self.T[0], self.T[at], self.told - self.remembered[at - 1].told

    def position(self, xy: FloatArray, covariance: FloatArray) -> Innovation:
        """What a position (2,) in the map with its covariance (2, 2) says."""
        x, y, z = self.T[0][:3, 3]
        H = np.array([[1.0, 0, 0, 0, z, -y], [0, 1.0, 0, -z, 0, x]])
        PHt = self.covariance[:, :6] @ H.T
        return _innovation(xy - self.T[0][:2, 3], H @ PHt[:6] + covariance, PHt)

    def yaw_rate(self, rate_rad_s: float, variance: float) -> Innovation:
        """What a gyroscope's yaw rate says."""
        place = self.place(TWIST).stop - 1
        PHt = self.covariance[:, [place]] + self.covariance[:, [-1]]
        residual = np.array([rate_rad_s - self.rest[2] - self.rest[BIAS]])
        return _innovation(residual, PHt[[place]] + PHt[[-1]] + variance, PHt)

    def gyro_bias(self, bias_rad_s: float, variance: float) -> Innovation:
        """What is said elsewhere of the gyroscope's bias."""
        PHt = self.covariance[:, [-1]]
        return _innovation(np.array([bias_rad_s - self.rest[BIAS]]), PHt[[-1]] + variance, PHt)

    def corrected(self, by: Innovation) -> PoseBelief:
        """The Kalman update."""
        by_this = (by.with_state, by.covariance, by.residual, self.rest_at + by.unlearned)
        T, rest, P = correct(self.T, self.rest, self.covariance, *by_this)
        return changed(self, T=T, rest=rest, covariance=P)

    def moved(self, x: FloatArray, covariance: FloatArray) -> PoseBelief:
        """All poses perturbed, and the rest shifted, by x (n,). Raises ValueError for another number."""
        if len(x) != len(self.covariance):
            raise ValueError(f"a shift of {len(x)} numbers for a belief of {len(self.covariance)}")
        poses = 6 * len(self.T)
        T = np.ascontiguousarray(se3.exp(x[:poses].reshape(-1, 6)) @ self.T)
        return changed(self, T=T, rest=self.rest + x[poses:], covariance=covariance)

    def slipped(self, seconds: float, settings: FilterParameters, since_s: float | None = None) -> PoseBelief:
        """As if wheels had slipped for so long; a wheel that is lifted tilts the base, too.

        With `since_s`, when that began: the pose at the begin of a step had slipped by then for its share of the time.
        """
        s = settings
        aside = [s.slip_rise_m_per_sqrt_s, s.slip_tilt_rad_per_sqrt_s, s.slip_tilt_rad_per_sqrt_s]
        q = np.square([s.slip_m_per_sqrt_s, s.slip_m_per_sqrt_s, *aside, s.slip_rad_per_sqrt_s]) * seconds
        Ad = motions.adjoint(self.T[0])
        grown = (Ad * q) @ Ad.T
        P = self.covariance.copy()
        P[:6, :6] += grown
        if since_s is not None and STEP_BEGIN in self.names:
            at = self.reference(STEP_BEGIN)
            before_s = self.remembered[at - 1].stamp_s - since_s
            then, shared = slice(6 * at, 6 * at + 6), grown * min(max(before_s / seconds, 0.0), 1.0) if seconds else 0.0
            P[then, then] += shared
            P[:6, then] += shared
            P[then, :6] += shared
        return changed(self, covariance=P, slip_covariance=self.slip_covariance + grown)

    def scattered(self, settings: FilterParameters) -> PoseBelief:
        """As if the base might be anywhere about, turned any way."""
        s, Ad, P = settings, motions.adjoint(self.T[0]), self.covariance.copy()
        anywhere = [s.lost_sigma_m, s.lost_sigma_m, s.lost_rise_m, s.lost_tilt_rad, s.lost_tilt_rad, np.pi]
        P[:6, :6] += (Ad * np.square(anywhere)) @ Ad.T
        return changed(self, covariance=P)

    def turn_slipped(self, settings: FilterParameters) -> PoseBelief:
        """As if the wheels' last yaw rate, and the turn it made, were any."""
        twist = self.place(TWIST).stop - 1
        G = np.r_[motions.adjoint(self.T[0])[:, 5] * self.part_s, 1.0]
        P = self.covariance.copy()
        P[np.ix_(*[np.r_[:6, twist]] * 2)] += np.outer(G, G) * settings.acceleration_rad_s2**2
        return changed(self, covariance=P)

    def vision_accepted(self) -> PoseBelief:
        """With what slip may have done since vision was last believed settled by what it said, and the twist known."""
        poses = self.remembered
        if any(pose.slip_covariance is not _NO_SLIP for pose in poses):
            poses = tuple(replace(pose, slip_covariance=_NO_SLIP) for pose in poses)
        return changed(self, slip_covariance=_NO_SLIP, remembered=poses, known_twist=self.rest[TWIST], known_for_s=0.0)

    def turn_known(self) -> PoseBelief:
        """With the yaw rate known, by a gyroscope."""
        return changed(self, known_twist=np.array([*self.known_twist[:2], self.rest[2]]), turn_known_for_s=0.0)

    def _levelled(self, settings: FilterParameters) -> PoseBelief:
        here = changed(self, way_m=0.0)
        if settings.level_sigma_rad is None:
            return here
        # δω × up, where up = R e_z; level is where its x and y are 0.
        up = self.T[0][:3, 2]
        H = np.array([[0.0, 0, 0, 0, up[2], -up[1]], [0, 0, 0, -up[2], 0, up[0]]])
        PHt = self.covariance[:, :6] @ H.T
        spread, one_sigma2 = H @ PHt[:6], settings.level_sigma_rad**2
        if _innovation(-up[:2], spread + one_sigma2 * np.eye(2), PHt).nis > settings.ramp_chi2:
            return here
        variance = one_sigma2 * settings.level_m / self.way_m
        return here.corrected(_innovation(-up[:2], spread + variance * np.eye(2), PHt))


def _innovation(residual: FloatArray, S: FloatArray, PHt: FloatArray) -> Innovation:
    return Innovation(residual, S, PHt, float(motions.chi_squared(residual, S)))


# What sensors tell, as a PoseBelief takes it: WheelStep, RelativePose; and what it makes of it, Innovation.


@dataclass(frozen=True, slots=True, eq=False)
class WheelStep:
    """What the wheels tell of an interval: ξ (6,), and the covariance (6, 6) of the left perturbation of exp(ξ)."""

    begin_s: float
    end_s: float
    xi: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """A motion of the base as the camera saw it against the remembered pose `name`.

    Attributes:
        Z: (4, 4) T_reference_now of the base.
        seen: (m, 6) rows that take a left perturbation of Z to the directions that the camera shows.
        covariance: (m, m) in these.
        spread: (6, 6) of the left perturbation of Z, very wide where nothing is shown.
        inlier_share: of the matches, or None.
        fitting: share of the regions of the view, each with one vote, or None.
    """

    name: str
    Z: FloatArray
    seen: FloatArray
    covariance: FloatArray
    spread: FloatArray
    inlier_share: float | None = None
    fitting: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """A measurement against the belief: residual (m,), its covariance (m, m), that with the state (n, m), its NIS.

    `unlearned` (k,): what of a belief's `rest` it cannot tell from noise. That stays as uncertain as it is, and is
    reckoned with (Schmidt 1966).
    """

    residual: FloatArray
    covariance: FloatArray
    with_state: FloatArray
    nis: float
    unlearned: IntArray = field(default_factory=lambda: np.zeros(0, int))


def is_pose(T: FloatArray | None, covariance: FloatArray | None) -> bool:
    """Whether a pose is there, with its covariance, and both are what they should be."""
    if T is None or covariance is None:
        return False
    return T.shape == (4, 4) and covariance.shape == (6, 6) and bool(motions.is_pose(T, covariance))


def of_unknown_path(xi: FloatArray, swing_rad: float) -> FloatArray:
    """Covariance (6, 6) of a step whose ends are told and whose path is not: anywhere between an early and a late turn.

    An arc with the same ends lies aside of the farthest of them by half of way times turn; unseen, a base may swing.
    """
    way_m, turn_rad = float(np.hypot(xi[0], xi[1])), abs(float(xi[5]))
    aside_m = way_m * (turn_rad / 4 + swing_rad)
    short_m = way_m * (turn_rad / 4 + swing_rad) ** 2
    return np.diag(np.square([short_m, aside_m, 0.0, 0.0, 0.0, 0.0]))


# How noisy the wheels are: Odometer and Preintegration, what they tell, and WheelNoise, which is learned of it.
#
# It is learned from how that fits a camera that is believed.
#
# A calibration tells of wheels how far they slip in a metre on whatever floor (`slip_m_per_sqrt_m`); on the one that
# is driven they may hold ten times as well. What a filter thinks of them decides what it believes of the camera after
# the dark, and in a crowd. So the ratio ρ of their variance to the calibration's is part of what it knows, as a
# distribution over a few values (multiple models: Magill 1965): from one remembered pose to the next, camera and
# wheels differ in way and turn by d ~ N(0, R + ρ N), with N the wheels' covariance by the calibration and R all else
# that is uncertain.


_VALUES = 21
_WAY_AND_TURN = np.array([0, 5])
_IN_THESE = np.ix_(_WAY_AND_TURN, _WAY_AND_TURN)
_ERRORS = slice(ERRORS.start, LAG + 1)


@dataclass(frozen=True, eq=False)
class Odometer:
    """What wheels and gyroscope alone tell, whoever is believed: sums since the filter began, or between two instants.

    Attributes:
        T: (4, 4) the wheels' motion, and its covariance (6, 6) by their calibration, as a left perturbation.
        way_m: of both wheels' middle.
        heard_s: for how long they told anything.
        turn_rad: by the gyroscope, and for how long it told anything: turned_s.
    """

    T: FloatArray = field(default_factory=lambda: np.eye(4))
    covariance: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    way_m: float = 0.0
    heard_s: float = 0.0
    turn_rad: float = 0.0
    turned_s: float = 0.0

    def moved_by_wheels(self, step: WheelStep, share: float) -> Odometer:
        """After a share of a wheel step."""
        T, covariance = odometer_kernel(self.T, self.covariance, step.xi, step.covariance, share)
        way_m, heard_s = abs(step.xi[0]) * share, (step.end_s - step.begin_s) * share
        return changed(self, T=T, covariance=covariance, way_m=self.way_m + way_m, heard_s=self.heard_s + heard_s)

    def turned(self, turn_rad: float, seconds: float) -> Odometer:
        """After a turn that the gyroscope told."""
        return changed(self, turn_rad=self.turn_rad + turn_rad, turned_s=self.turned_s + seconds)

    def since(self, before: Odometer) -> Odometer:
        """What was told since it stood as `before`."""
        moved = motions.between(before.T, before.covariance, self.T, self.covariance)
        turn = self.turn_rad - before.turn_rad, self.turned_s - before.turned_s
        return Odometer(*moved, self.way_m - before.way_m, self.heard_s - before.heard_s, *turn)


@dataclass(frozen=True, eq=False)
class Preintegration:
    """Of the wheels alone, since a pose was remembered.

    Attributes:
        name, begin_s: of that pose.
        begin: the odometer then.
        spread: (6, 6) by which the camera may have that pose elsewhere, in its frame.
        errors, unsure: (13,) of wheels and camera as known then, and their covariance (13, 13).
        twist: (3,) of the base then.
    """

    name: str
    begin_s: float
    begin: Odometer
    spread: FloatArray
    errors: FloatArray
    unsure: FloatArray
    twist: FloatArray

    @classmethod
    def of(
        cls, name: str, stamp_s: float, odometer: Odometer, spread: FloatArray | None, belief: PoseBelief
    ) -> Preintegration:
        """From a pose that is about to be remembered."""
        rows, none = belief.place(_ERRORS), np.zeros((6, 6))
        known = belief.rest[_ERRORS].copy(), belief.covariance[rows, rows].copy(), belief.rest[TWIST].copy()
        return cls(name, stamp_s, odometer, none if spread is None else spread, *known)

    def is_told(self, told: Odometer, stamp_s: float, share: float) -> bool:
        """Whether the wheels moved since, and told of such a share of the time up to a stamp."""
        return told.heard_s > share * (stamp_s - self.begin_s) and bool(told.covariance[5, 5] > 0)

    def against(
        self, measurement: RelativePose, told: Odometer, belief: PoseBelief
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """D (2,), by what way and turn a measurement against that pose differs from the wheels; R and N (2, 2)."""
        at = belief.reference(measurement.name)
        since = belief.since(at)
        _, B, Ad = expected(*since)
        late = motions.adjoint(measurement.Z)[:, PLANE] @ belief.rest[TWIST]
        late[PLANE] -= self.twist
        J = np.column_stack([Ad @ since[2], -B, -late])[_WAY_AND_TURN]
        off = motions.log(motions.times(measurement.Z, motions.inverse(told.T)))[_WAY_AND_TURN]
        # By the errors as known before: what the measurement itself has taught of them would make it fit too well.
        R = (measurement.spread + self.spread)[_IN_THESE] + J @ self.unsure @ J.T
        return off - J @ self.errors, R, told.covariance[_IN_THESE]


@dataclass(frozen=True, eq=False)
class WheelNoise:
    """The ratio of the wheels' variance to the calibration's.

    Attributes:
        nats: (21,) log of how likely each of `ratios` is, up to a constant; None before the first.
        ratio: its mean.
    """

    nats: FloatArray | None = None
    ratio: float = 1.0

    def after(
        self,
        preintegration: Preintegration,
        told: Odometer,
        measurement: RelativePose,
        belief: PoseBelief,
        settings: FilterParameters,
    ) -> WheelNoise:
        """After a measurement against the pose where it began; what was known fades along the way."""
        d, R, N = preintegration.against(measurement, told, belief)
        ratios = np.geomspace(settings.wheel_noise_least, settings.wheel_noise_most, _VALUES)
        before = -0.5 * np.abs(np.log2(ratios))  # a calibration may be wrong by a factor of four as well as by two
        S = R + ratios[:, None, None] * N
        if not (np.linalg.eigvalsh(S)[:, 0] > 0).all():  # rounding has left nothing of so small a difference
            return self
        chi2 = (np.linalg.solve(S, np.broadcast_to(d[:, None], (len(S), 2, 1)))[..., 0] * d).sum(axis=1)
        likely = -0.5 * (chi2 + np.log(np.linalg.det(S)))
        known = before if self.nats is None else self.nats
        kept = before + np.exp(-told.way_m / settings.wheel_noise_memory_m) * (known - before)
        nats = kept + np.maximum(likely - likely.max(), -settings.wheel_noise_cap_nats)
        weights = np.exp(nats - nats.max())
        return WheelNoise(nats, float(weights @ ratios / weights.sum()))


# Mount: a motion that the camera saw, as the base's, checked for being one.


_ALL, _NONE = np.eye(6), np.zeros((0, 6))


class Mount:
    """Where the camera sits on the base: T_base_camera (4, 4)."""

    def __init__(self, T_base_camera: FloatArray) -> None:
        self.T_base_camera = T_base_camera
        self._T_camera_base = motions.inverse(T_base_camera)
        self._Ad_base_camera = motions.adjoint(T_base_camera)
        self._to_camera = DEGENERATE_SCALE[:, None] * motions.inverse_adjoint(T_base_camera)
        self._from_camera = self._Ad_base_camera / DEGENERATE_SCALE

    def spread(self, covariance: FloatArray) -> FloatArray:
        """Of a perturbation in the camera's frame (6, 6), in the base's."""
        return np.asarray(self._Ad_base_camera @ covariance @ self._Ad_base_camera.T)

    def measurement(self, motion: MotionEstimate, name: str) -> RelativePose | Reason:
        """What a motion against the pose remembered as `name` says, or why it says nothing."""
        if motion.T_reference_current is None or motion.covariance is None:
            return motion.reason or Reason.INVALID
        T, R = np.array(motion.T_reference_current, float), np.array(motion.covariance, float)
        split = _split(motion.degenerate)
        if T.shape != (4, 4) or R.shape != (6, 6) or split is None or not motions.is_pose(T, R):
            return Reason.INVALID
        seen, unseen = split
        if len(seen) == 0:
            return Reason.DEGENERATE
        shown, rows, spread = shown_kernel(R, seen, unseen, DEGENERATE_SCALE, self._to_camera, self._from_camera)
        if not motions.is_definite(shown):
            return Reason.INVALID
        Z = motions.times(motions.times(self.T_base_camera, T), self._T_camera_base)
        share = motion.inliers / motion.matches if motion.matches > 0 else None
        return RelativePose(name, Z, rows, shown, spread, share, motion.fitting)


def motion_of(T: ArrayLike | None) -> FloatArray | None:
    """A rigid motion (4, 4), or None where it is none."""
    found = numbers_of(T)
    return found if found is not None and found.shape == (4, 4) and motions.is_motion(found) else None


def covariance_of(C: ArrayLike | None, size: int) -> FloatArray | None:
    """A covariance (size, size), made exactly symmetric, or None where it is none."""
    found = numbers_of(C)
    is_one = found is not None and found.shape == (size, size) and motions.is_covariance(found)
    return (found + found.T) / 2 if found is not None and is_one else None


def numbers_of(value: ArrayLike | None) -> FloatArray | None:
    """An array of numbers of any shape, or None where it is none."""
    try:
        return np.array(value, float)
    except (TypeError, ValueError):
        return None


def _split(hidden: FloatArray | None) -> tuple[FloatArray, FloatArray] | None:
    """Orthonormal rows (6 - K, 6) of the directions seen, and (K, 6) of those `hidden`; None where these are none."""
    if hidden is None:
        return _ALL, _NONE
    hidden = np.asarray(hidden, float)
    if hidden.ndim != 2 or hidden.shape[1] != 6 or not np.isfinite(hidden).all():
        return None
    if len(hidden) == 0:
        return _ALL, _NONE
    _, strength, rows = np.linalg.svd(hidden)
    rank = int((strength > 1e-6).sum())
    return rows[rank:], rows[:rank]


# Copies of frozen values with some fields changed, for what a filter does hundreds of times a second.


Value = TypeVar("Value")


def changed(value: Value, **fields: Any) -> Value:
    """As `dataclasses.replace`, in a sixth of its time: for dataclasses without slots, whose fields are all that is."""
    assert value.__dict__.keys() >= fields.keys(), f"not all of {fields.keys()} are fields"
    copy = object.__new__(type(value))
    copy.__dict__.update(value.__dict__, **fields)
    return copy
