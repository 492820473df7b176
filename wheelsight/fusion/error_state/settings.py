"""What the default filter believes of wheels, floor, camera and gyroscope before the drive."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.geometry import FloatArray

_MAY_BE_INFINITE = ("level_sigma_rad",)
_MAY_BE_NEGATIVE = ("gyro_bias_rad_s",)
_SHARES = ("confidence", "healthy_share")
# As `PoseBelief.rest` has them, behind the twist; each has a sigma and a walk.
_ERRORS = (
    *("scale_{}", "drift_{}_rad_per_m", "turn_{}"),
    *("camera_scale_{}", "camera_drift_{}_rad_per_m", "camera_turn_{}", "camera_drift_{}_rad_per_m"),
    *("mount_{}_m", "mount_{}_m", "mount_{}_rad", "mount_{}_rad", "mount_{}_rad"),
    *("camera_lag_{}_s", "gyro_bias_{}_rad_s"),
)


@dataclass(frozen=True)
class ErrorStateSettings:
    """What is believed before the drive. Walks are random, told by their standard deviations after a metre or second;
    an error that walks is drawn back, so that it stays within what was believed of it before the drive.

    Attributes:
        scale_sigma, drift_sigma_rad_per_m, turn_sigma: of the wheels' errors: the ratio by which ways are wrong, the
            turn a metre too much (unequal radii), the ratio by which turns are wrong (track width). Of a data sheet's
            radius a tyre under load is off by some percent: more than a camera's ways are.
        scale_walk, drift_walk_rad_per_m, turn_walk: how these wander in one metre.
        camera_scale_sigma, camera_drift_sigma_rad_per_m, camera_turn_sigma: likewise of the camera's errors;
            its drift is that of its pitch, too. A focal length is known to a pixel of five hundred.
        camera_scale_walk, camera_drift_walk_rad_per_m, camera_turn_walk: how these wander in one metre.
        mount_sigma_m, mount_walk_m: how far ahead and aside the camera sits on the base of where it is said to be, and
            how that wanders in one metre. mount_sigma_rad, mount_walk_rad: likewise how far it is turned, about each
            axis.
        camera_lag_sigma_s, camera_lag_walk_s: how late the camera's stamps are, and how that wanders in one metre.
        wheel_noise_memory_m: along which way it fades how noisy the wheels were.
        side_m_per_sqrt_m, rise_m_per_sqrt_m, tilt_rad_per_sqrt_m: of what wheels do not tell: sideways, up, roll and
            pitch; the way is that of a point `lever_m` beside the base.
        level_sigma_rad, level_m: floors are level up to this, one stretch of so many metres like another, or else are
            ramps, of which nothing is believed; inf: never level.
        clock_sigma_s: by which stamps of camera and wheels are apart; at speed, that is a way.
        acceleration_m_s2, acceleration_rad_s2: how speeds change in a second while no wheel tells.
        leap_m_s2, leap_rad_s2: standard deviation of what a robot's accelerations may be; more is a leap.
        gyro_noise_rad_per_sqrt_s, gyro_bias_rad_s, gyro_bias_sigma_rad_s, gyro_bias_walk_rad_s: of the yaw rate, what
            it shows at rest, how far off that may be, and how it wanders in 1 s.
        slip_m_per_sqrt_s, slip_rad_per_sqrt_s: where slipping wheels may have gone instead.
        slip_rise_m_per_sqrt_s, slip_tilt_rad_per_sqrt_s: likewise up, and to either side.
        confidence: share of good measurements that a gate lets pass.
        decisive: evidence, in nats, that settles whether wheels slip or vision fails.
        leap_cap: most that one leap counts, as χ².
        persistence: evidence of slip in each further frame in which a healthy camera contradicts the wheels, and in
            the first one within `slippery_s` of slip.
        perseverance_per_s: likewise in each second, once the wheels are believed.
        ill_health: evidence of visual failure in one in which the camera is not healthy.
        healthy_share: a camera is healthy whose share of inliers is at least this part of its usual share.
        agreements: frames that must agree before trust returns.
        longest_doubt_s: after it, both possibilities become one that covers both.
        coast_after_s, lost_after_s: since vision was last believed, or since anything was heard.
        window_s: how late an event may come.
        even_s: over a longer step of the wheels, as across a pause, the base need not have gone evenly.
        max_clones: past poses remembered at most; the oldest goes.

    Raises:
        ConfigError: a value that is negative or not finite, or a share that is none.
    """

    scale_sigma: float = 0.04
    drift_sigma_rad_per_m: float = 0.02
    turn_sigma: float = 0.03
    scale_walk: float = 0.0005
    drift_walk_rad_per_m: float = 0.0005
    turn_walk: float = 0.0005
    camera_scale_sigma: float = 0.005
    camera_drift_sigma_rad_per_m: float = 0.0003
    camera_turn_sigma: float = 0.002
    camera_scale_walk: float = 0.0005
    camera_drift_walk_rad_per_m: float = 0.0001
    camera_turn_walk: float = 0.0001
    mount_sigma_m: float = 0.005
    mount_walk_m: float = 0.0001
    mount_sigma_rad: float = 0.005
    mount_walk_rad: float = 0.0002
    camera_lag_sigma_s: float = 0.02
    camera_lag_walk_s: float = 0.0001
    wheel_noise_memory_m: float = 10.0
    side_m_per_sqrt_m: float = 0.005
    rise_m_per_sqrt_m: float = 0.003
    tilt_rad_per_sqrt_m: float = 0.05
    lever_m: float = 0.25
    level_sigma_rad: float = 0.005
    level_m: float = 5.0
    clock_sigma_s: float = 0.01
    acceleration_m_s2: float = 1.0
    acceleration_rad_s2: float = 3.0
    leap_m_s2: float = 2.0
    leap_rad_s2: float = 6.0
    gyro_noise_rad_per_sqrt_s: float = 1e-3
    gyro_bias_rad_s: float = 0.0
    gyro_bias_sigma_rad_s: float = 0.02
    gyro_bias_walk_rad_s: float = 2e-5
    slip_m_per_sqrt_s: float = 0.3
    slip_rad_per_sqrt_s: float = 0.5
    slip_rise_m_per_sqrt_s: float = 0.1
    slip_tilt_rad_per_sqrt_s: float = 0.2
    confidence: float = 0.999
    decisive: float = 6.0
    leap_cap: float = 16.0
    persistence: float = 1.5
    slippery_s: float = 5.0
    perseverance_per_s: float = 8.0
    ill_health: float = 2.0
    healthy_share: float = 0.6
    agreements: int = 5
    longest_doubt_s: float = 2.0
    coast_after_s: float = 0.3
    lost_after_s: float = 2.0
    window_s: float = 0.5
    even_s: float = 0.25
    max_clones: int = 4

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            value = getattr(self, name)
            least = -np.inf if name in _MAY_BE_NEGATIVE else 0
            if not value >= least or (abs(value) == np.inf and name not in _MAY_BE_INFINITE):
                raise ConfigError(f"{name} is {value}", fix="0 or more")
        for name in _SHARES:
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{name} is {getattr(self, name)}", fix="between 0 and 1")
        if self.max_clones < 1 or 0 in (self.level_m, self.level_sigma_rad, self.wheel_noise_memory_m):
            raise ConfigError("max_clones, level_m, level_sigma_rad or wheel_noise_memory_m is 0", fix="more than 0")

    @cached_property
    def unseen_a_metre(self) -> FloatArray:
        """Covariance (6, 6) of what wheels do not tell of a metre: sideways, up, roll and pitch."""
        sigmas = [0.0, self.side_m_per_sqrt_m, self.rise_m_per_sqrt_m, *[self.tilt_rad_per_sqrt_m] * 2, 0.0]
        return np.diag(np.square(sigmas))

    @cached_property
    def variances(self) -> FloatArray:
        """Of the errors of wheels and camera and of the gyroscope's bias (14,), before the drive."""
        return self._squared("sigma")

    @cached_property
    def walks(self) -> FloatArray:
        """What these (14,) gain in a metre, the gyroscope's bias in a second."""
        return self._squared("walk")

    @cached_property
    def fades(self) -> FloatArray:
        """The share (14,) of an error that is drawn back in a metre, or second; none of one that was certain.

        Just so much that what nothing measures stays as uncertain as before the drive: a Gauss–Markov process.
        """
        return np.divide(self.walks, 2 * self.variances, out=np.zeros(len(_ERRORS)), where=self.variances > 0)

    def _squared(self, which: str) -> FloatArray:
        """Of all errors (14,), in a belief's order, the "sigma" or the "walk"."""
        return np.square([getattr(self, name.format(which)) for name in _ERRORS])
