"""ErrorStateSettings: what the default filter believes of wheels, floor and camera before the drive, and by what rules.

FilterParameters are these and the gyroscope's calibration: all that the filter is reckoned by.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from wheelsight.calibration import Gyro
from wheelsight.geometry import FloatArray
from wheelsight.settings import Settings

_Share = Annotated[float, Field(gt=0, lt=1)]
# As `PoseBelief.rest` has them, behind the twist; each has a sigma and a walk. Behind these, the gyroscope's bias.
_ERRORS = (
    *("scale_{}", "drift_{}_rad_per_m", "turn_{}"),
    *("camera_scale_{}", "camera_drift_{}_rad_per_m", "camera_turn_{}", "camera_drift_{}_rad_per_m"),
    *("mount_{}_m", "mount_{}_m", "mount_{}_rad", "mount_{}_rad", "mount_{}_rad"),
    "camera_lag_{}_s",
)


class ErrorStateSettings(Settings):
    """Settings of the error-state filter; unknown names are refused.

    Walks are random, told by their standard deviations after a metre; an error that walks is drawn back, so that it
    stays within what was believed of it before the drive.
    """

    # What is wrong with the wheels: sigmas before the drive, and random walks in one metre.
    scale_sigma: NonNegativeFloat = Field(
        default=0.04,
        description="ratio by which ways are wrong: of a data sheet's radius, a tyre under load is off by some percent",
    )
    drift_sigma_rad_per_m: NonNegativeFloat = Field(
        default=0.02, description="rad of turn a metre too much: of wheels 1 % unequal, 0.5 m apart"
    )
    turn_sigma: NonNegativeFloat = Field(
        default=0.03,
        description="ratio by which turns are wrong: of a track's width, told by where tyres touch the floor",
    )
    scale_walk: NonNegativeFloat = Field(
        default=0.0005, description="of the ratio of ways, per √m; found on the simulator alone"
    )
    drift_walk_rad_per_m: NonNegativeFloat = Field(
        default=0.0005, description="rad/m of the drift, per √m; found on the simulator alone"
    )
    turn_walk: NonNegativeFloat = Field(
        default=0.0005, description="of the ratio of turns, per √m; found on the simulator alone"
    )

    # What is wrong with the camera, likewise.
    camera_scale_sigma: NonNegativeFloat = Field(
        default=0.005, description="ratio by which its ways are wrong; assumed"
    )
    camera_drift_sigma_rad_per_m: NonNegativeFloat = Field(
        default=0.0003, description="rad of turn a metre too much, and of pitch; found on the simulator alone"
    )
    camera_turn_sigma: NonNegativeFloat = Field(
        default=0.002,
        description="ratio by which its turns are wrong: a focal length is known to a pixel of five hundred",
    )
    camera_scale_walk: NonNegativeFloat = Field(
        default=0.0005,
        description="of the ratio of its ways, per √m: it fades along 200 m; found on the simulator alone",
    )
    camera_drift_walk_rad_per_m: NonNegativeFloat = Field(
        default=0.0001, description="rad/m of its drift, per √m: it fades along 18 m; found on the simulator alone"
    )
    camera_turn_walk: NonNegativeFloat = Field(
        default=0.0001, description="of the ratio of its turns, per √m; found on the simulator alone"
    )
    mount_sigma_m: NonNegativeFloat = Field(
        default=0.005,
        description="m that the camera sits ahead and aside of where it is said to be, by a ruler; assumed",
    )
    mount_walk_m: NonNegativeFloat = Field(
        default=0.0001,
        description="m, per √m: the point about which tyres let a base turn is not quite fixed; found on the "
        "simulator alone",
    )
    mount_sigma_rad: NonNegativeFloat = Field(
        default=0.005, description="rad that it is turned about each axis, by a spirit level; assumed"
    )
    mount_walk_rad: NonNegativeFloat = Field(default=0.0002, description="rad, per √m; found on the simulator alone")
    camera_lag_sigma_s: NonNegativeFloat = Field(
        default=0.02, description="s that its stamps are late: less than a frame at 30 frames/s"
    )
    camera_lag_walk_s: NonNegativeFloat = Field(default=0.0001, description="s, per √m; found on the simulator alone")
    lag_chi2: PositiveFloat = Field(
        default=30.0,
        description="χ² of a change of twist, of which a lag is learned: noise alone has three, so nine tenths are "
        "motion",
    )
    chain_yaw_share: _Share = Field(
        default=0.4,
        description="of what alignments leave uncertain of turns, what adds up along a way: 3 to 18 m of ten "
        "simulated drives",
    )

    # Noise of the wheels, and of what they do not tell.
    wheel_noise_memory_m: PositiveFloat = Field(
        default=10.0,
        description="m of way along which it fades how noisy the wheels were: floors change from room to room; assumed",
    )
    wheel_noise_least: PositiveFloat = Field(
        default=0.0625,
        description="least ratio of their variance to the calibration's, a quarter of the σ: no floor is the next one",
    )
    wheel_noise_most: PositiveFloat = Field(
        default=4.0, description="most of it: a calibration may be wrong by a factor of two in σ"
    )
    wheel_noise_cap_nats: PositiveFloat = Field(
        default=4.0, description="most that one stretch of way tells of it: one that the camera saw wrong is one"
    )
    side_m_per_sqrt_m: NonNegativeFloat = Field(default=0.005, description="sideways; found on the simulator alone")
    rise_m_per_sqrt_m: NonNegativeFloat = Field(default=0.003, description="up; found on the simulator alone")
    tilt_rad_per_sqrt_m: NonNegativeFloat = Field(
        default=0.05, description="roll and pitch: ramps begin at once; assumed"
    )
    lever_m: NonNegativeFloat = Field(
        default=0.25,
        description="m beside the base of the point whose way these are told by: turns on the spot count, by about "
        "half a track",
    )
    level_sigma_rad: PositiveFloat | None = Field(
        default=0.005,
        description="floors are level up to this, 25 mm in 5 m, twice what DIN 18202 allows; null: never level",
    )
    level_m: PositiveFloat = Field(
        default=5.0, description="m; one stretch of floor so long is level or not whatever the one before was"
    )
    level_every_m: PositiveFloat = Field(
        default=0.25, description="m of way from one comparison with level to the next, for speed"
    )
    ramp_chi2: PositiveFloat = Field(
        default=9.21, description="of two tilts, 0.99: what is tilted more is a ramp, of which nothing is believed"
    )
    known_for_s: PositiveFloat = Field(
        default=0.25,
        description="s for which a twist that a measurement told says how a step changes with the wheels' errors",
    )

    # Motion while no wheel tells, and stamps.
    clock_sigma_s: NonNegativeFloat = Field(
        default=0.01, description="s by which stamps of camera and wheels are apart; at speed, that is a way"
    )
    acceleration_m_s2: NonNegativeFloat = Field(
        default=1.0, description="how speeds change in a second; assumed of a robot indoors"
    )
    acceleration_rad_s2: NonNegativeFloat = Field(default=3.0, description="likewise how yaw rates do")
    window_s: NonNegativeFloat = Field(
        default=0.5,
        description="how late an event may come: longer than hosts stall, short enough to be reckoned again",
    )
    even_s: NonNegativeFloat = Field(
        default=0.25,
        description="over a longer step of the wheels, as across a pause, the base need not have gone evenly",
    )
    swing_rad: NonNegativeFloat = Field(
        default=0.1, description="rad by which the heading on such a step may differ from that of an even one"
    )
    coast_after_s: NonNegativeFloat = Field(
        default=0.3, description="since vision was last believed: some frames at any usual rate"
    )
    lost_after_s: NonNegativeFloat = Field(
        default=2.0, description="since anything was heard: a speed of longer ago says nothing"
    )
    lost_sigma_m: PositiveFloat = Field(
        default=30.0, description="how far away a lost base may be: some rooms; assumed"
    )
    lost_rise_m: PositiveFloat = Field(default=1.0, description="how far up or down; assumed")
    lost_tilt_rad: PositiveFloat = Field(default=0.3, description="how far tilted; assumed")
    largest_sigma_m: PositiveFloat = Field(
        default=1000.0, description="a covariance beyond says nothing: anywhere about a town"
    )
    largest_sigma_rad: PositiveFloat = Field(
        default=6.283185307179586,
        description="likewise: any heading. Wheels alone come to 1 rad in some hundred metres",
    )
    max_clones: PositiveInt = Field(default=4, description="past poses remembered at most; the oldest goes")

    # The gyroscope; what it is worth, its calibration says.
    gyro_mean_s: PositiveFloat = Field(
        default=0.05,
        description="s; where no wheel tells, the mean over so long is one measurement: as a step of the wheels takes",
    )
    gyro_told_share: _Share = Field(
        default=0.5, description="of a time that it must have told of, to be measured by as if of all of it"
    )
    gyro_test_s: PositiveFloat = Field(
        default=0.3,
        description="s of readings of which `1 - confidence` are refused though good: each tells of slip for "
        "`coast_after_s`",
    )

    # Fault detection: do the wheels slip, or does vision fail? A sequential test (Wald 1945).
    confidence: _Share = Field(default=0.999, description="share of good measurements that a gate lets pass")
    decision_nats: NonNegativeFloat = Field(default=6.0, description="log-likelihood ratio that decides: 1 to 400")
    leap_m_s2: NonNegativeFloat = Field(
        default=2.0, description="σ of what a robot's acceleration may be; more is a leap of a sensor"
    )
    leap_rad_s2: NonNegativeFloat = Field(default=6.0, description="likewise of its yaw rate")
    leap_side_share: NonNegativeFloat = Field(default=0.25, description="of that, sideways: wheels hold a base")
    leap_confidence: _Share = Field(default=0.99, description="share of changes of speed that are no leap at all")
    leap_chi2_cap: NonNegativeFloat = Field(
        default=16.0, description="most that one leap counts: it may be no Gaussian"
    )
    contradiction_nats: NonNegativeFloat = Field(
        default=1.5,
        description="for slip, a frame in which a camera with its usual inliers contradicts the wheels, and once "
        "within `slippery_s` of slip; found on the simulator alone",
    )
    slip_m_per_sqrt_s: NonNegativeFloat = Field(
        default=0.3, description="where a base whose wheels slip may have gone instead: at a walk, any way"
    )
    slip_rad_per_sqrt_s: NonNegativeFloat = Field(default=0.5, description="likewise turned")
    slip_rise_m_per_sqrt_s: NonNegativeFloat = Field(default=0.1, description="likewise up: a wheel that is lifted")
    slip_tilt_rad_per_sqrt_s: NonNegativeFloat = Field(default=0.2, description="likewise to either side")
    slippery_s: NonNegativeFloat = Field(
        default=5.0, description="s for which a floor stays slippery, at a walk; found on the simulator alone"
    )
    contradiction_nats_per_s: NonNegativeFloat = Field(
        default=8.0,
        description="likewise a second, once decided for the wheels: a camera that fails does so for less than two",
    )
    poor_inliers_nats: NonNegativeFloat = Field(
        default=2.0,
        description="for visual failure, a frame with fewer inliers than usual; found on the simulator alone",
    )
    inlier_share: _Share = Field(
        default=0.6,
        description="of the usual share of inliers: with fewer, a camera that contradicts may be wrong itself",
    )
    inlier_memory: _Share = Field(
        default=0.05, description="of the usual share, what one frame changes: about the last twenty count"
    )
    likelihood_memory: NonNegativeFloat = Field(
        default=0.5, description="of the log-likelihood ratio, what is left after a frame in which both agree"
    )
    compared_s: PositiveFloat = Field(
        default=0.25, description="s; over more between two frames, speeds are not compared"
    )
    agreements: PositiveInt = Field(
        default=5, description="frames that must agree in a row before both are believed again"
    )
    undecided_s: NonNegativeFloat = Field(
        default=2.0, description="s after which both hypotheses become one that covers both"
    )
    covered_sigmas: PositiveFloat = Field(
        default=2.5, description="at which the other hypothesis lies, so that its own error, too, has room within three"
    )


class FilterParameters(ErrorStateSettings):
    """Settings, and what the gyroscope's readings are worth."""

    gyro: Gyro = Gyro()

    @classmethod
    def of(cls, settings: ErrorStateSettings, gyro: Gyro) -> FilterParameters:
        """Both together."""
        return cls(**{name: getattr(settings, name) for name in ErrorStateSettings.model_fields}, gyro=gyro)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Others, checked, of which nothing is reckoned yet."""
        return type(self)(**{name: getattr(self, name) for name in type(self).model_fields} | dict(update or {}))

    @cached_property
    def unseen_a_metre(self) -> FloatArray:
        """Covariance (6, 6) of what wheels do not tell of a metre: sideways, up, roll and pitch."""
        sigmas = [0.0, self.side_m_per_sqrt_m, self.rise_m_per_sqrt_m, *[self.tilt_rad_per_sqrt_m] * 2, 0.0]
        return np.diag(np.square(sigmas))

    @cached_property
    def variances(self) -> FloatArray:
        """Of the errors of wheels and camera and of the gyroscope's bias (14,), before the drive."""
        return np.square([*self._errors("sigma"), self.gyro.bias_sigma_rad_s])

    @cached_property
    def walks(self) -> FloatArray:
        """What these (14,) gain in a metre, the gyroscope's bias in a second."""
        return np.square([*self._errors("walk"), self.gyro.bias_walk_rad_s_per_sqrt_s])

    @cached_property
    def fades(self) -> FloatArray:
        """The share (14,) of an error that is drawn back in a metre, or second; none of one that was certain.

        Just so much that what nothing measures stays as uncertain as before the drive: a Gauss–Markov process.
        """
        variances = self.variances
        return np.divide(self.walks, 2 * variances, out=np.zeros(len(variances)), where=variances > 0)

    def _errors(self, which: str) -> list[float]:
        """Of all errors of wheels and camera, in a belief's order, the "sigma" or the "walk"."""
        return [getattr(self, name.format(which)) for name in _ERRORS]
