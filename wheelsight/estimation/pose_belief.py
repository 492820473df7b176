"""PoseBelief: a Gaussian over the base's pose now and at remembered instants, its twist, and the sensors' errors.

Poses have perturbations from the left, δ with T = exp(δ) T̂. With these, a step T_before_now with error ζ gives

    δ_now = δ_before + Ad(T̂_before) ζ,

so that earlier uncertainty does not change with the motion since. A motion Z measured against a remembered pose c gives

    log(Z Ẑ⁻¹) = Ad(T̂_c⁻¹) (δ_now - δ_c) + η,  Ẑ = T̂_c⁻¹ T̂_now,

which is invariant to a common perturbation of all poses, at any linearisation point: relative measurements add no
information about the absolute pose (Barrau & Bonnabel 2017; cloning: Roumeliotis & Burdick 2002). Beliefs are
immutable; each step returns a new one, so that a filter can return to any that it has kept.

The module also has the measurements of a belief (`WheelStep`, `RelativeMotion`), its `Innovation`, the adaptive noise
of the wheels (`WheelNoise`), the mount of the camera (`Mount`), and the `FilterParameters`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration_parts import Gyro, HolonomicWheels, Wheels
from wheelsight.core.estimates import DEGENERATE_SCALE, STEP_BEGIN, MotionEstimate, Reason
from wheelsight.core.geometry import FloatArray, IntArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.settings.fusion import ErrorStateSettings
from wheelsight.estimation.filter_kernels import (
    ObservedMotion,
    ReferencePoses,
    StepPart,
    UnmeasuredMotion,
    coast,
    correct,
    expected,
    imaged_at,
    imaged_now,
    measured,
    odometer_kernel,
    residual_kernel,
    seen_from,
    shown_kernel,
    wheel_step,
)

PLANE = np.array([0, 1, 5])  # vx, vy, ωz of a (6,) perturbation
IN_PLANE = np.ix_(PLANE, PLANE)
_SIX = np.arange(6)
# Order of the state after all poses: the twist, the errors of wheels and camera, and the gyroscope's bias.
TWIST, ERRORS, CAMERA_ERRORS, LAG, BIAS = slice(0, 3), slice(3, 6), slice(6, 15), 15, 16
AUX_SIZE = 17
# The errors in the order of `aux`, after the twist; each has a sigma and a walk. The gyroscope's bias follows.
_ERROR_NAMES = (
    *("scale_{}", "drift_{}_rad_per_m", "turn_{}"),
    *("camera_scale_{}", "camera_drift_{}_rad_per_m", "camera_turn_{}", "camera_drift_{}_rad_per_m"),
    *("mount_{}_m", "mount_{}_m", "mount_{}_rad", "mount_{}_rad", "mount_{}_rad"),
    "camera_lag_{}_s",
)
COAST_AFTER_S = 0.3  # without an accepted frame: some frames at any usual rate
_NO_TWIST = np.full(3, np.nan)
_NO_SLIP = np.zeros((6, 6))  # this very array means that no slip was possible


@dataclass(frozen=True)
class FilterParameters:
    """Numbers of the filter: the settings, the gyroscope's calibration, and constants, each with unit and reason.

    Errors of sensors are random walks, given by their standard deviation after a metre. They are drawn back, so that an
    error stays within its standard deviation before the drive.
    """

    # Settings, and noise of the gyroscope.
    scale_sigma: float
    drift_sigma_rad_per_m: float
    turn_sigma: float
    camera_scale_sigma: float
    mount_sigma_m: float
    mount_sigma_rad: float
    camera_lag_sigma_s: float
    clock_sigma_s: float
    level_sigma_rad: float | None
    acceleration_m_s2: float
    acceleration_rad_s2: float
    window_s: float
    confidence: float
    gyro: Gyro
    # Random walks of the wheels' errors per √m (simulator).
    scale_walk: float = 0.0005
    drift_walk_rad_per_m: float = 0.0005
    turn_walk: float = 0.0005
    # Errors of the camera. Turn and pitch per metre are 0.002 to 0.009 on real recordings. A Kinect that
    # is calibrated by a board has turns 1 to 4 % off. Scale fades along 200 m, drift along 18 m.
    camera_drift_sigma_rad_per_m: float = 0.003
    camera_turn_sigma: float = 0.02
    camera_scale_walk: float = 0.002
    camera_drift_walk_rad_per_m: float = 0.001
    camera_turn_walk: float = 0.00025
    mount_walk_m: float = 0.0001  # the point about which tyres let a base turn is not quite fixed
    mount_walk_rad: float = 0.0002
    camera_lag_walk_s: float = 0.0001
    lag_chi2: float = 30.0  # of a change of twist that shows a delay: noise has 3, so nine tenths are motion
    # Noise of the wheels, relative to the calibration's variance: floors change along 10 m. The least ratio is that of
    # a hard floor; at most, a calibration is wrong by a factor of two in σ. One stretch has a limited
    # weight, so that a single wrong measurement has little effect. Readings must cover nearly all of its time.
    wheel_noise_memory_m: float = 10.0
    wheel_noise_least: float = 0.00390625
    wheel_noise_most: float = 4.0
    wheel_noise_cap_nats: float = 4.0
    wheel_noise_covered_share: float = 0.95
    # Motion that wheels do not measure; ramps begin at once. Turns on the spot count by half a track of 0.5 m.
    side_m_per_sqrt_m: float = 0.005
    rise_m_per_sqrt_m: float = 0.003
    tilt_rad_per_sqrt_m: float = 0.05
    lever_m: float = 0.25
    # The level floor: length over which floors are level independently, way between two comparisons (for speed), and
    # the tilt of a ramp: χ² of 2, 0.99.
    level_m: float = 5.0
    level_every_m: float = 0.25
    ramp_chi2: float = 9.21
    known_for_s: float = 0.25  # how long a measured twist gives the derivative of a step by the wheels' errors
    # Acceleration to the side: wheels roll ahead alone. Of a holonomic base, that ahead.
    side_acceleration_m_s2: float = 0.005
    rate_readings: int = 16  # for their mean rate: longer than a busy host stalls, shorter than rates change
    # Over a longer step, as across a pause, the base need not move evenly, and its heading may swing.
    even_s: float = 0.25
    swing_rad: float = 0.1
    coast_after_s: float = COAST_AFTER_S
    lost_after_s: float = 2.0  # since the last event: an older speed is worthless
    # Position, height and tilt of a lost base: some rooms away.
    lost_sigma_m: float = 30.0
    lost_rise_m: float = 1.0
    lost_tilt_rad: float = 0.3
    # A pose with a larger covariance is unknown: anywhere in a town, any heading.
    largest_sigma_m: float = 1000.0
    largest_sigma_rad: float = 2 * np.pi
    max_clones: int = 16  # remembered poses; mostly four and a keyframe, more during a contradiction
    # The gyroscope: mean without wheel readings, share of a time that its readings must cover, and time of readings of
    # which a share 1 - confidence fails the gate: each reports slip for `coast_after_s`.
    gyro_mean_s: float = 0.05
    gyro_covered_share: float = 0.5
    gyro_test_s: float = 0.3
    # Fault detection. The log-likelihood ratio that decides is 1 to 400, as Wald 1945 chooses error rates.
    decision_nats: float = 6.0
    # Jumps of velocity: σ of a robot's accelerations, share of that to the side, share of changes that are no jump, and
    # the largest weight of a jump, which may be no Gaussian.
    leap_m_s2: float = 2.0
    leap_rad_s2: float = 6.0
    leap_side_share: float = 0.25
    leap_confidence: float = 0.99
    leap_chi2_cap: float = 16.0
    contradiction_nats: float = 1.5  # for slip: a contradicting frame with usual inliers
    # Motion of a base whose wheels slip, at a walk; a lifted wheel tilts it.
    slip_m_per_sqrt_s: float = 0.3
    slip_rad_per_sqrt_s: float = 0.5
    slip_rise_m_per_sqrt_s: float = 0.1
    slip_tilt_rad_per_sqrt_s: float = 0.2
    contradiction_nats_per_s: float = 8.0  # after a decision for the wheels: cameras fail for less than 2 s (simulator)
    poor_inliers_nats: float = 2.0  # for visual failure: a frame with few inliers (simulator)
    inlier_share: float = 0.6  # of the usual share; with fewer, a contradicting camera may be wrong
    fitting_share: float = 0.75  # regions of the view that must fit, else the camera follows what moves
    inlier_memory: float = 0.05  # change of the usual share by one frame: the last twenty count
    likelihood_memory: float = 0.5  # rest of the log-likelihood ratio after a frame in which both agree
    compared_s: float = 0.25  # longest time between frames whose speeds are compared
    agreements: int = 5  # frames in a row that end a fault
    undecided_s: float = 2.0  # then one hypothesis continues, and covers both

    @classmethod
    def of(
        cls,
        settings: ErrorStateSettings | None = None,
        gyro: Gyro | None = None,
        wheels: Wheels | HolonomicWheels | None = None,
    ) -> FilterParameters:
        """Return the parameters of a robot; None for the defaults. Holonomic bases accelerate to the side as ahead."""
        settings = settings or ErrorStateSettings()
        known: dict[str, Any] = dict(settings.with_wheels(wheels))
        if isinstance(wheels, HolonomicWheels):
            known |= {"side_acceleration_m_s2": settings.acceleration_m_s2, "leap_side_share": 1.0}
        return cls(**known, gyro=gyro or Gyro())

    @cached_property
    def unseen_a_metre(self) -> FloatArray:
        """Covariance (6, 6) per metre of motion that wheels do not measure: sideways, up, roll and pitch."""
        sigmas = [0.0, self.side_m_per_sqrt_m, self.rise_m_per_sqrt_m, *[self.tilt_rad_per_sqrt_m] * 2, 0.0]
        return np.diag(np.square(sigmas))

    @cached_property
    def variances(self) -> FloatArray:
        """(14,) of the errors of wheels and camera and of the gyroscope's bias, before the drive."""
        return np.square([*self._errors("sigma"), self.gyro.bias_sigma_rad_s])

    @cached_property
    def walks(self) -> FloatArray:
        """(14,) growth of these per metre, of the gyroscope's bias per second."""
        return np.square([*self._errors("walk"), self.gyro.bias_walk_rad_s_per_sqrt_s])

    @cached_property
    def fades(self) -> FloatArray:
        """(14,) share of an error that fades per metre, or second; none of one that was certain.

        With it, an error that nothing measures stays as uncertain as before the drive: a Gauss–Markov process.
        """
        variances = self.variances
        return np.divide(self.walks, 2 * variances, out=np.zeros(len(variances)), where=variances > 0)

    def _errors(self, which: str) -> list[float]:
        """Return "sigma" or "walk" of all errors of wheels and camera, in a belief's order."""
        return [getattr(self, name.format(which)) for name in _ERROR_NAMES]


# Indices in `aux` that a measurement does not update, by whether it updates the errors of sensors and shows a delay.
_CONSIDERED = {
    (True, True): np.zeros(0, int),
    (True, False): np.array([LAG]),
    (False, True): np.arange(ERRORS.start, BIAS),
    (False, False): np.arange(ERRORS.start, BIAS),
}


@dataclass(frozen=True, slots=True, eq=False)
class Remembered:
    """A remembered pose: name and stamp, and the base's twist (3,), `slip_covariance` and `by_errors` at that time."""

    name: str
    stamp_s: float
    twist: FloatArray
    slip_covariance: FloatArray
    by_errors: FloatArray


@dataclass(frozen=True, eq=False)
class PoseBelief:
    """Mean and covariance; see the module.

    Attributes:
        T: (1 + K, 4, 4) T_filter_base now, and at the times when the images with the remembered stamps were taken.
        remembered: the K remembered poses.
        aux: (17,) auxiliary states: twist (vx, vy, ωz); errors of the wheels (scale, drift, turn); errors of the camera
            (the same, drift in pitch, shift and rotation of its mount, delay of its stamps); bias of the gyroscope.
        covariance: (6 + 6K + 17, 6 + 6K + 17) of the perturbations of all poses, then of `aux`.
        slip_covariance: (6, 6) part of the pose's covariance that is due to possible slip since the last accepted
            camera measurement.
        way_m: distance since the last measurement of the level floor.
        part_s: duration of the last part of a wheel step.
        known_twist: (3,) twist at the last measurement, `known_for_s` ago; its yaw rate is from a gyroscope,
            `turn_known_for_s` ago.
        turn_known_for_s: see `known_twist`.
        by_errors: (6, 3) derivative of the pose by the wheels' errors, as left perturbations in the filter's frame.
    """

    T: FloatArray
    remembered: tuple[Remembered, ...]
    aux: FloatArray
    covariance: FloatArray
    slip_covariance: FloatArray
    way_m: float = 0.0
    part_s: float = 0.0
    known_twist: FloatArray = field(default_factory=lambda: np.zeros(3))
    known_for_s: float = np.inf
    turn_known_for_s: float = np.inf
    by_errors: FloatArray = field(default_factory=lambda: np.zeros((6, 3)))

    @classmethod
    def begin(cls, T_filter_base: FloatArray, covariance: FloatArray, settings: FilterParameters) -> PoseBelief:
        """Return a belief at rest, at a pose with its covariance (6, 6)."""
        s = settings
        P = np.zeros((6 + AUX_SIZE, 6 + AUX_SIZE))
        P[:6, :6] = covariance
        still = [s.acceleration_m_s2, s.side_m_per_sqrt_m, s.acceleration_rad_s2]
        P[6:, 6:] = np.diag([*np.square(still), *s.variances])
        return cls(T_filter_base[None].copy(), (), np.zeros(AUX_SIZE), P, _NO_SLIP)

    @property
    def gyro_bias_rad_s(self) -> float:
        """Estimated bias of the gyroscope, relative to that of the calibration."""
        return float(self.aux[BIAS])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the remembered poses."""
        return tuple(map(attrgetter("name"), self.remembered))

    def find_index(self, name: str) -> int | None:
        """Return the index in `T` of the pose remembered as `name`; None if there is none."""
        for index, pose in enumerate(self.remembered, 1):
            if pose.name == name:
                return index
        return None

    @property
    def aux_offset(self) -> int:
        """Index of `aux` in the covariance."""
        return len(self.covariance) - AUX_SIZE

    def aux_slice(self, part: slice) -> slice:
        """Return the slice of a part of `aux` in the covariance."""
        return slice(self.aux_offset + part.start, self.aux_offset + part.stop)

    def moved_by_wheels(
        self, step: WheelStep, share: float, settings: FilterParameters, is_slipping: bool
    ) -> PoseBelief:
        """Predict by a share of a wheel step, corrected by the estimated errors of the wheels."""
        s, dt_s = settings, (step.end_s - step.begin_s) * share
        # The noise must not depend on the step itself, else it correlates with what it measures.
        known = _NO_TWIST
        if self.known_for_s < s.known_for_s:
            known = self.known_twist
        elif self.turn_known_for_s < s.known_for_s:  # a gyroscope does not measure distances
            known = np.array([*step.xi[:2] / (step.end_s - step.begin_s), self.known_twist[2]])
        part = StepPart(step.xi, step.covariance, share, dt_s, known)
        unseen = UnmeasuredMotion(s.unseen_a_metre, s.walks, s.fades, s.lever_m)
        T, aux, P, by_errors, way_m = wheel_step(self.T, self.aux, self.covariance, part, unseen)
        times = {"way_m": self.way_m + way_m, "part_s": dt_s, "known_for_s": self.known_for_s + dt_s}
        times["turn_known_for_s"] = self.turn_known_for_s + dt_s
        after = changed(self, T=T, aux=aux, covariance=P, by_errors=self.by_errors + by_errors, **times)
        after = after.slipped(dt_s, s) if is_slipping else after
        return after.levelled(s) if after.way_m > s.level_every_m else after

    def predicted_at_constant_twist(self, dt_s: float, settings: FilterParameters) -> PoseBelief:
        """Predict without wheels, at constant twist with white noise of acceleration."""
        s = settings
        aux = self.aux
        q = np.square([s.acceleration_m_s2, s.side_acceleration_m_s2, s.acceleration_rad_s2])
        way_m = (abs(aux[0]) + s.lever_m * abs(aux[2])) * dt_s
        noise = (q, s.unseen_a_metre * way_m, dt_s, s.gyro.bias_walk_rad_s_per_sqrt_s**2 * dt_s)
        T, P = coast(self.T, aux, self.covariance, *noise)
        return changed(self, T=T, covariance=P)

    def cloned(self, name: str, stamp_s: float, most: int, spread: FloatArray | None = None) -> PoseBelief:
        """Remember the current pose as `name`; replace one of that name, or else the oldest of too many.

        It is the pose when the image with that stamp was taken, but for the begin of a step of `odom`.

        `spread` (6, 6), in the base's own frame, is added to its covariance: the error of the camera's pose there.
        """
        entry = Remembered(name, stamp_s, self.aux[TWIST].copy(), self.slip_covariance, self.by_errors)
        index = self.find_index(name)
        if index is not None:
            poses = (*self.remembered[: index - 1], entry, *self.remembered[index:])
            there = changed(self, T=self.T.copy(), covariance=self.covariance.copy(), remembered=poses)
        else:
            here = self
            while len(here.remembered) >= most:
                here = here.dropped(min(here.remembered, key=attrgetter("stamp_s")).name)
            there = here.selected(np.append(np.arange(len(here.T)), 0), (*here.remembered, entry))
            index = len(there.remembered)
        at = slice(6 * index, 6 * index + 6)
        if name == STEP_BEGIN:  # no image: a change of the delay is no motion
            there.T[index], rows, spread_now = there.T[0], there.covariance[:6].copy(), there.covariance[:6, :6].copy()
        else:  # the delay of the camera's stamps is part of the state (Li & Mourikis, IJRR 2014)
            there.T[index], rows, spread_now = imaged_now(there.T[0], there.aux, there.covariance)
        there.covariance[at], there.covariance[:, at] = rows, rows.T
        there.covariance[at, at] = spread_now if spread is None else spread_now + motions.carried(self.T[0], spread)
        return there

    def dropped(self, name: str) -> PoseBelief:
        """Marginalise the remembered pose `name`."""
        index = self.find_index(name)
        if index is None:
            return self
        rows = np.delete(np.arange(len(self.T)), index)
        return self.selected(rows, (*self.remembered[: index - 1], *self.remembered[index:]))

    def selected(self, poses: IntArray, remembered: tuple[Remembered, ...]) -> PoseBelief:
        """Return a belief with some of the poses (K,), by their indices in `T`; all else stays."""
        first = len(self.covariance) - AUX_SIZE
        rows = np.concatenate([(6 * poses[:, None] + _SIX).ravel(), np.arange(first, len(self.covariance))])
        covariance = self.covariance[rows[:, None], rows]
        return changed(self, T=self.T[poses], covariance=covariance, remembered=remembered)

    def index_of(self, name: str) -> int:
        """Return the index in `T` of the remembered pose `name`. Raises KeyError."""
        for index, pose in enumerate(self.remembered, 1):
            if pose.name == name:
                return index
        raise KeyError(name)

    def seen_from(self, name: str, T_base_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return T_reference_current (4, 4) of the camera since the pose `name`, and its covariance (6, 6)."""
        T, C = seen_from(self.T, self.aux, self.covariance, self.index_of(name), T_base_camera)
        return T, C

    def between(self, first: str, second: str, T_base_camera: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return T_first_second (4, 4) of the camera, and its covariance (6, 6); None unless both are remembered."""
        one, other = self.find_index(first), self.find_index(second)
        if one is None or other is None:
            return None
        T_camera_filter = motions.inverse(motions.times(self.T[one], T_base_camera))
        both = np.r_[6 * other + _SIX, 6 * one + _SIX]
        P = self.covariance[np.ix_(both, both)]
        apart = P[:6, :6] - P[:6, 6:] - P[6:, :6] + P[6:, 6:]
        T = motions.times(motions.times(T_camera_filter, self.T[other]), T_base_camera)
        return motions.renormalized(T), motions.carried(T_camera_filter, apart)

    def residual(self, measurement: RelativeMotion) -> FloatArray:
        """Return log(Z Ẑ⁻¹) (6,), of the camera's motion without its estimated errors against the predicted one."""
        T_now, T_reference, by_errors = self.since(self.index_of(measurement.name))
        T_imaged = imaged_at(T_now, self.aux)
        return np.asarray(residual_kernel(T_imaged, T_reference, by_errors, measurement.Z, self.aux[CAMERA_ERRORS]))

    def innovation(
        self,
        measurement: RelativeMotion,
        settings: FilterParameters,
        *,
        without_slip: bool = False,
        updates_errors: bool = False,
    ) -> Innovation:
        """Return the innovation of a camera measurement.

        Args:
            measurement: against a remembered pose.
            settings: of the filter.
            without_slip: assume that no wheel has slipped since the last accepted camera measurement.
            updates_errors: whether it updates the errors of sensors, too; not while wheels may slip.
        """
        at = self.index_of(measurement.name)
        then = self.remembered[at - 1]
        seen = ObservedMotion(measurement.Z, measurement.observed_basis, measurement.covariance)
        poses = ReferencePoses(*self.since(at), 6 * at, then.twist)
        residual, S, PHt, H, nis, change = measured(poses, self.aux, self.covariance, seen)
        has_slip = self.slip_covariance is not _NO_SLIP or then.slip_covariance is not _NO_SLIP
        if without_slip and has_slip:
            certain = S - H @ (self.slip_covariance - then.slip_covariance) @ H.T
            # Updates since then have reduced a part of it: the difference may not be positive definite.
            if np.linalg.eigvalsh(certain - measurement.covariance)[0] >= 0:
                S, nis = certain, motions.chi_squared(residual, certain)
        # At constant twist, noise of the wheels would be taken for a delay of the stamps.
        considered_states = _CONSIDERED[updates_errors, bool(change > settings.lag_chi2)]
        return Innovation(residual, S, PHt, nis, considered_states)

    def since(self, at: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the current pose, the one at an index, and the derivative of the motion by the wheels' errors."""
        return self.T[0], self.T[at], self.by_errors - self.remembered[at - 1].by_errors

    def position(self, xy: FloatArray, covariance: FloatArray) -> Innovation:
        """Return the innovation of a position (2,) in the map with its covariance (2, 2)."""
        x, y, z = self.T[0][:3, 3]
        H = np.array([[1.0, 0, 0, 0, z, -y], [0, 1.0, 0, -z, 0, x]])
        PHt = self.covariance[:, :6] @ H.T
        return _innovation(xy - self.T[0][:2, 3], H @ PHt[:6] + covariance, PHt)

    def yaw_rate(self, rate_rad_s: float, variance: float) -> Innovation:
        """Return the innovation of a gyroscope's yaw rate."""
        place = self.aux_slice(TWIST).stop - 1
        PHt = self.covariance[:, [place]] + self.covariance[:, [-1]]
        residual = np.array([rate_rad_s - self.aux[2] - self.aux[BIAS]])
        return _innovation(residual, PHt[[place]] + PHt[[-1]] + variance, PHt)

    def gyro_bias(self, bias_rad_s: float, variance: float) -> Innovation:
        """Return the innovation of an external estimate of the gyroscope's bias."""
        PHt = self.covariance[:, [-1]]
        return _innovation(np.array([bias_rad_s - self.aux[BIAS]]), PHt[[-1]] + variance, PHt)

    def updated(self, by: Innovation) -> PoseBelief:
        """Return the belief after a Kalman update."""
        considered = len(self.covariance) - AUX_SIZE + by.considered_states
        numbers = by.cross_covariance, by.covariance, by.residual, considered
        T, aux, P = correct(self.T, self.aux, self.covariance, *numbers)
        return changed(self, T=T, aux=aux, covariance=P)

    def retracted(self, x: FloatArray, covariance: FloatArray) -> PoseBelief:
        """Perturb all poses, and shift `aux`, by x (n,). Raises ValueError for another size."""
        if len(x) != len(self.covariance):
            raise ValueError(f"a shift of {len(x)} numbers for a belief of {len(self.covariance)}")
        poses = 6 * len(self.T)
        T = np.ascontiguousarray(se3.exp(x[:poses].reshape(-1, 6)) @ self.T)
        return changed(self, T=T, aux=self.aux + x[poses:], covariance=covariance)

    def slipped(self, seconds: float, settings: FilterParameters, since_s: float | None = None) -> PoseBelief:
        """Add the covariance of slip over a time. A lifted wheel also tilts the base.

        With `since_s`, the begin of the slip, the pose at the begin of a step gets the share of the time before it.
        """
        s = settings
        aside = [s.slip_rise_m_per_sqrt_s, s.slip_tilt_rad_per_sqrt_s, s.slip_tilt_rad_per_sqrt_s]
        q = np.square([s.slip_m_per_sqrt_s, s.slip_m_per_sqrt_s, *aside, s.slip_rad_per_sqrt_s]) * seconds
        Ad = motions.adjoint(self.T[0])
        grown = (Ad * q) @ Ad.T
        P = self.covariance.copy()
        P[:6, :6] += grown
        at = None if since_s is None else self.find_index(STEP_BEGIN)
        if since_s is not None and at is not None:
            before_s = self.remembered[at - 1].stamp_s - since_s
            then, shared = slice(6 * at, 6 * at + 6), grown * min(max(before_s / seconds, 0.0), 1.0) if seconds else 0.0
            P[then, then] += shared
            P[:6, then] += shared
            P[then, :6] += shared
        return changed(self, covariance=P, slip_covariance=self.slip_covariance + grown)

    def inflated_as_lost(self, settings: FilterParameters) -> PoseBelief:
        """Add the covariance of a lost base, turned by any angle."""
        s, Ad, P = settings, motions.adjoint(self.T[0]), self.covariance.copy()
        anywhere = [s.lost_sigma_m, s.lost_sigma_m, s.lost_rise_m, s.lost_tilt_rad, s.lost_tilt_rad, np.pi]
        P[:6, :6] += (Ad * np.square(anywhere)) @ Ad.T
        return changed(self, covariance=P)

    def turn_slipped(self, settings: FilterParameters) -> PoseBelief:
        """Add the covariance of an unknown yaw rate over the last part of a wheel step."""
        twist = self.aux_slice(TWIST).stop - 1
        G = np.r_[motions.adjoint(self.T[0])[:, 5] * self.part_s, 1.0]
        P = self.covariance.copy()
        P[np.ix_(*[np.r_[:6, twist]] * 2)] += np.outer(G, G) * settings.acceleration_rad_s2**2
        return changed(self, covariance=P)

    def vision_accepted(self) -> PoseBelief:
        """Note an accepted camera measurement: no slip since it, and a known twist."""
        poses = self.remembered
        for pose in poses:
            if pose.slip_covariance is not _NO_SLIP:
                poses = tuple(replace(pose, slip_covariance=_NO_SLIP) for pose in poses)
                break
        return changed(self, slip_covariance=_NO_SLIP, remembered=poses, known_twist=self.aux[TWIST], known_for_s=0.0)

    def turn_known(self) -> PoseBelief:
        """Note an accepted yaw rate of a gyroscope."""
        return changed(self, known_twist=np.array([*self.known_twist[:2], self.aux[2]]), turn_known_for_s=0.0)

    def levelled(self, settings: FilterParameters) -> PoseBelief:
        """Return the belief after a measurement that the floor is level."""
        here = changed(self, way_m=0.0)
        if settings.level_sigma_rad is None:
            return here
        # δω × up, where up = R e_z. On a level floor its x and y are 0.
        up = self.T[0][:3, 2]
        H = np.array([[0.0, 0, 0, 0, up[2], -up[1]], [0, 0, 0, -up[2], 0, up[0]]])
        PHt = self.covariance[:, :6] @ H.T
        spread, one_sigma2 = H @ PHt[:6], settings.level_sigma_rad**2
        if _innovation(-up[:2], spread + one_sigma2 * np.eye(2), PHt).nis > settings.ramp_chi2:
            return here
        variance = one_sigma2 * settings.level_m / self.way_m
        return here.updated(_innovation(-up[:2], spread + variance * np.eye(2), PHt))


def _innovation(residual: FloatArray, S: FloatArray, PHt: FloatArray) -> Innovation:
    return Innovation(residual, S, PHt, float(motions.chi_squared(residual, S)))


@dataclass(frozen=True, slots=True, eq=False)
class WheelStep:
    """Motion of the wheels over an interval: ξ (6,), and the covariance (6, 6) of the left perturbation of exp(ξ)."""

    begin_s: float
    end_s: float
    xi: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RelativeMotion:
    """Motion of the base, measured by the camera against the remembered pose `name`.

    Attributes:
        name: of the reference.
        Z: (4, 4) T_reference_now of the base.
        observed_basis: (m, 6) rows that map a left perturbation of Z to the observed directions.
        covariance: (m, m) of these directions.
        covariance_full: (6, 6) of the left perturbation of Z, very large in unobserved directions.
        inlier_share: share of inliers among the matches, or None.
        fitting: share of the regions of the view that fit, or None.
    """

    name: str
    Z: FloatArray
    observed_basis: FloatArray
    covariance: FloatArray
    covariance_full: FloatArray
    inlier_share: float | None = None
    fitting: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """A measurement minus its prediction.

    Attributes:
        residual: (m,).
        covariance: (m, m) of the residual.
        cross_covariance: (n, m) covariance of state and residual.
        nis: normalized innovation squared.
        considered_states: (k,) indices in `aux` of states that the update leaves as they are. It considers their
            uncertainty (Schmidt 1966).
    """

    residual: FloatArray
    covariance: FloatArray
    cross_covariance: FloatArray
    nis: float
    considered_states: IntArray = field(default_factory=lambda: np.zeros(0, int))


def is_pose(T: FloatArray | None, covariance: FloatArray | None) -> bool:
    """Whether a pose (4, 4) and its covariance (6, 6) are given and valid."""
    if T is None or covariance is None:
        return False
    return T.shape == (4, 4) and covariance.shape == (6, 6) and bool(motions.is_pose(T, covariance))


def of_unknown_path(xi: FloatArray, swing_rad: float) -> FloatArray:
    """Return the covariance (6, 6) of a step with an unknown path, which may turn early or late.

    The farthest such path deviates sideways from the arc by a quarter of distance times turn. `swing_rad` adds a swing
    of the base that the ends do not show.
    """
    way_m, turn_rad = float(np.hypot(xi[0], xi[1])), abs(float(xi[5]))
    aside_m = way_m * (turn_rad / 4 + swing_rad)
    short_m = way_m * (turn_rad / 4 + swing_rad) ** 2
    return np.diag(np.square([short_m, aside_m, 0.0, 0.0, 0.0, 0.0]))


# Adaptive noise of the wheels.
#
# A calibration states how far wheels slip per metre on an average floor (`slip_m_per_sqrt_m`). On the actual floor
# they may slip ten times less. This decides how far the filter accepts the camera after the dark, and among people.
# Therefore the ratio ρ of the wheels' variance to the calibration's is estimated, as a distribution over a few values
# (multiple models: Magill 1965). From one remembered pose to the next, camera and wheels differ in distance and turn by
# d ~ N(0, R + ρ N), with N the covariance of the wheels by the calibration and R that of all other errors.


_VALUES = 21
_WAY_AND_TURN = np.array([0, 5])
_IN_THESE = np.ix_(_WAY_AND_TURN, _WAY_AND_TURN)
_ERRORS = slice(ERRORS.start, LAG + 1)


@dataclass(frozen=True, eq=False)
class Odometer:
    """Dead reckoning by wheels and gyroscope alone, since the filter started, or between two instants.

    Attributes:
        T: (4, 4) motion of the wheels.
        covariance: (6, 6) of its left perturbation, by the calibration.
        way_m: distance of the middle of both wheels.
        rolled_s: time that wheel steps cover.
        turn_rad: turn of the gyroscope.
        turned_s: time that its readings cover.
    """

    T: FloatArray = field(default_factory=lambda: np.eye(4))
    covariance: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    way_m: float = 0.0
    rolled_s: float = 0.0
    turn_rad: float = 0.0
    turned_s: float = 0.0

    def moved_by_wheels(self, step: WheelStep, share: float) -> Odometer:
        """Add a share of a wheel step."""
        T, covariance = odometer_kernel(self.T, self.covariance, step.xi, step.covariance, share)
        way_m, rolled_s = abs(step.xi[0]) * share, (step.end_s - step.begin_s) * share
        return changed(self, T=T, covariance=covariance, way_m=self.way_m + way_m, rolled_s=self.rolled_s + rolled_s)

    def turned(self, turn_rad: float, seconds: float) -> Odometer:
        """Add a turn of the gyroscope."""
        return changed(self, turn_rad=self.turn_rad + turn_rad, turned_s=self.turned_s + seconds)

    def since(self, before: Odometer) -> Odometer:
        """Return the motion since `before`."""
        moved = motions.between(before.T, before.covariance, self.T, self.covariance)
        turn = self.turn_rad - before.turn_rad, self.turned_s - before.turned_s
        return Odometer(*moved, self.way_m - before.way_m, self.rolled_s - before.rolled_s, *turn)


@dataclass(frozen=True, eq=False)
class Preintegration:
    """Start of a preintegrated motion of the wheels, at a remembered pose.

    Attributes:
        name: of that pose.
        begin_s: its stamp.
        begin: the odometer at that time.
        spread: (6, 6) error of the camera's pose there, in the base's frame.
        errors: (13,) errors of wheels and camera as estimated at that time.
        unsure: (13, 13) their covariance.
        twist: (3,) of the base at that time.
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
        """Start at a pose that is about to be remembered."""
        rows, none = belief.aux_slice(_ERRORS), np.zeros((6, 6))
        known = belief.aux[_ERRORS].copy(), belief.covariance[rows, rows].copy(), belief.aux[TWIST].copy()
        return cls(name, stamp_s, odometer, none if spread is None else spread, *known)

    def is_covered(self, rolled: Odometer, stamp_s: float, share: float) -> bool:
        """Whether the wheels moved since the start, and their steps cover a share of the time up to a stamp."""
        return rolled.rolled_s > share * (stamp_s - self.begin_s) and bool(rolled.covariance[5, 5] > 0)

    def against(
        self, measurement: RelativeMotion, rolled: Odometer, belief: PoseBelief
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return d (2,), the difference of measurement and wheels in distance and turn, and R and N (2, 2)."""
        at = belief.index_of(measurement.name)
        since = belief.since(at)
        _, B, Ad = expected(*since)
        late = motions.adjoint(measurement.Z)[:, PLANE] @ belief.aux[TWIST]
        late[PLANE] -= self.twist
        J = np.column_stack([Ad @ since[2], -B, -late])[_WAY_AND_TURN]
        off = motions.log(motions.times(measurement.Z, motions.inverse(rolled.T)))[_WAY_AND_TURN]
        # Errors as estimated before: an update by the measurement itself would make it fit too well.
        R = (measurement.covariance_full + self.spread)[_IN_THESE] + J @ self.unsure @ J.T
        return off - J @ self.errors, R, rolled.covariance[_IN_THESE]


@dataclass(frozen=True, eq=False)
class WheelNoise:
    """Distribution of the ratio of the wheels' variance to the calibration's.

    Attributes:
        nats: (21,) log-probabilities of the ratios, up to a constant; None before the first measurement.
        ratio: mean of the distribution.
    """

    nats: FloatArray | None = None
    ratio: float = 1.0

    def after(
        self,
        preintegration: Preintegration,
        rolled: Odometer,
        measurement: RelativeMotion,
        belief: PoseBelief,
        settings: FilterParameters,
    ) -> WheelNoise:
        """Return the distribution after a measurement. Earlier information fades with the distance."""
        d, R, N = preintegration.against(measurement, rolled, belief)
        ratios = np.geomspace(settings.wheel_noise_least, settings.wheel_noise_most, _VALUES)
        before = -0.5 * np.abs(np.log2(ratios))  # prior: a factor of four is little less likely than one of two
        S = R + ratios[:, None, None] * N
        if not (np.linalg.eigvalsh(S)[:, 0] > 0).all():  # rounding
            return self
        chi2 = (np.linalg.solve(S, np.broadcast_to(d[:, None], (len(S), 2, 1)))[..., 0] * d).sum(axis=1)
        likely = -0.5 * (chi2 + np.log(np.linalg.det(S)))
        known = before if self.nats is None else self.nats
        kept = before + np.exp(-rolled.way_m / settings.wheel_noise_memory_m) * (known - before)
        nats = kept + np.maximum(likely - likely.max(), -settings.wheel_noise_cap_nats)
        weights = np.exp(nats - nats.max())
        return WheelNoise(nats, float(weights @ ratios / weights.sum()))


_ALL, _NONE = np.eye(6), np.zeros((0, 6))


class Mount:
    """Converts motions of the camera to motions of the base by T_base_camera (4, 4), and validates them."""

    def __init__(self, T_base_camera: FloatArray) -> None:
        self.T_base_camera = T_base_camera
        self._T_camera_base = motions.inverse(T_base_camera)
        self._Ad_base_camera = motions.adjoint(T_base_camera)
        self._to_camera = DEGENERATE_SCALE[:, None] * motions.inverse_adjoint(T_base_camera)
        self._from_camera = self._Ad_base_camera / DEGENERATE_SCALE

    def spread(self, covariance: FloatArray) -> FloatArray:
        """Convert the covariance (6, 6) of a perturbation in the camera's frame to the base's."""
        return np.asarray(self._Ad_base_camera @ covariance @ self._Ad_base_camera.T)

    def measurement(self, motion: MotionEstimate, name: str) -> RelativeMotion | Reason:
        """Return the measurement of a motion against the pose remembered as `name`, or why there is none."""
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
        return RelativeMotion(name, Z, rows, shown, spread, share, motion.fitting)


def motion_of(T: ArrayLike | None) -> FloatArray | None:
    """Return a rigid motion (4, 4), or None if it is invalid."""
    found = numbers_of(T)
    return found if found is not None and found.shape == (4, 4) and motions.is_motion(found) else None


def covariance_of(C: ArrayLike | None, size: int) -> FloatArray | None:
    """Return a covariance (size, size), made exactly symmetric, or None if it is invalid."""
    found = numbers_of(C)
    is_one = found is not None and found.shape == (size, size) and motions.is_covariance(found)
    return (found + found.T) / 2 if found is not None and is_one else None


def numbers_of(value: ArrayLike | None) -> FloatArray | None:
    """Return an array of numbers of any shape, or None if it is invalid."""
    try:
        return np.array(value, float)
    except (TypeError, ValueError):
        return None


def _split(hidden: FloatArray | None) -> tuple[FloatArray, FloatArray] | None:
    """Return orthonormal rows of the observed (6 - K, 6) and the `hidden` directions (K, 6); None if invalid."""
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


Value = TypeVar("Value")


@dataclass(frozen=True, slots=True, eq=False)
class FilterEvent:
    """An event. The one field that is not None gives its kind; a measurement may have `clone` as well.

    Attributes:
        stamp_s: time of the event.
        wheels: step of the wheels that ends then.
        yaw_rate_rad_s: of a gyroscope.
        measurement: of the camera.
        failure: why the camera has no measurement.
        position: x, y (2,) in the map, and covariance (2, 2).
        gyro_bias: bias of the gyroscope relative to the calibration's, and its variance.
        clone: name by which to remember the pose.
        drop: name of a pose to forget.
        spread: (6, 6) error of the camera's pose at `clone`.
        original: the event with the measurement of a sensor that is left out.
    """

    stamp_s: float
    wheels: WheelStep | None = None
    yaw_rate_rad_s: float | None = None
    measurement: RelativeMotion | None = None
    failure: Reason | None = None
    position: tuple[FloatArray, FloatArray] | None = None
    gyro_bias: tuple[float, float] | None = None
    clone: str | None = None
    drop: str | None = None
    spread: FloatArray | None = None
    original: FilterEvent | None = None

    @property
    def rank(self) -> int:
        """Order at equal stamps: measurements before changes of remembered poses."""
        kinds = (self.wheels, self.gyro_bias, self.yaw_rate_rad_s, self.measurement, self.failure, self.position)
        for rank, kind in enumerate(kinds):
            if kind is not None:
                return rank
        return len(kinds) if self.drop is not None else len(kinds) + 1

    @property
    def since_s(self) -> float:
        """Stamp from which on it changes states: the begin of a wheel step."""
        return self.stamp_s if self.wheels is None else self.wheels.begin_s


def changed(value: Value, **fields: Any) -> Value:
    """As `dataclasses.replace`, in a sixth of its time. For dataclasses without slots and without derived fields."""
    assert value.__dict__.keys() >= fields.keys(), f"not all of {fields.keys()} are fields"
    copy = object.__new__(type(value))
    copy.__dict__.update(value.__dict__, **fields)
    return copy
