"""Settings of sensor fusion: which filter joins the sensors, and the parameters of each filter. The configuration
reads them, so they stand below it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import model_validator

from wheelsight.core.calibration_parts import WHEEL_SIGMAS, Gyro, HolonomicWheels, Wheels
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.settings.base import ASKED, CHOSEN, ON_SIMULATOR, Settings, bounds, setting

# ErrorStateSettings: what the default filter believes of wheels, floor and camera before the drive, and by what
# rules.
#
# FilterParameters are these and the gyroscope's calibration: all that the filter is reckoned by.


# As `PoseBelief.rest` has them, behind the twist; each has a sigma and a walk. Behind these, the gyroscope's bias.
_ERRORS = (
    *("scale_{}", "drift_{}_rad_per_m", "turn_{}"),
    *("camera_scale_{}", "camera_drift_{}_rad_per_m", "camera_turn_{}", "camera_drift_{}_rad_per_m"),
    *("mount_{}_m", "mount_{}_m", "mount_{}_rad", "mount_{}_rad", "mount_{}_rad"),
    "camera_lag_{}_s",
)


_FROM_0041 = f"{ON_SIMULATOR}: docs/decisions/0041"
_FROM_0049 = "two real recordings: docs/decisions/0049"
_FROM_0070 = "two real recordings: docs/decisions/0070"
_FROM_0046 = f"{ON_SIMULATOR}: docs/decisions/0046"


class ErrorStateSettings(Settings):
    """Settings of the error-state filter; unknown names are refused.

    Walks are random, told by their standard deviations after a metre; an error that walks is drawn back, so that it
    stays within what was believed of it before the drive.
    """

    # What is wrong with the wheels: sigmas before the drive, and random walks in one metre.
    scale_sigma: float = setting(
        0.04,
        "ratio by which ways are wrong: of a data sheet's radius, a tyre under load is off by some percent",
        _FROM_0041,
        ge=0,
        le=1,
    )
    drift_sigma_rad_per_m: float = setting(
        0.02, "rad of rotation a metre too much: of wheels 1 % unequal, 0.5 m apart", "computed", ge=0, le=1
    )
    turn_sigma: float = setting(
        0.03,
        "ratio by which turns are wrong: of a track's width, which depends on where tyres touch the floor",
        CHOSEN,
        ge=0,
        le=1,
    )
    scale_walk: float = setting(0.0005, "of the ratio of ways, per √m", ON_SIMULATOR, ge=0, le=1)
    drift_walk_rad_per_m: float = setting(0.0005, "rad/m of the drift, per √m", ON_SIMULATOR, ge=0, le=1)
    turn_walk: float = setting(0.0005, "of the ratio of turns, per √m", ON_SIMULATOR, ge=0, le=1)

    # What is wrong with the camera, likewise.
    camera_scale_sigma: float = setting(
        0.02,
        "ratio by which its ways are wrong: Kinects' depth was found 3.1 and 3.5 % off (Sturm et al., IROS 2012)",
        _FROM_0049,
        ge=0,
        le=1,
    )
    camera_drift_sigma_rad_per_m: float = setting(
        0.003, "rad of turn a metre too much, and of pitch: 0.002 to 0.009 on real recordings", _FROM_0049, ge=0, le=1
    )
    camera_turn_sigma: float = setting(
        0.02,
        "ratio by which its turns are wrong: a Kinect calibrated by a board was 1 to 4 % off about its upright axis",
        _FROM_0070,
        ge=0,
        le=1,
    )
    camera_scale_walk: float = setting(
        0.002, "of the ratio of its ways, per √m: it fades along 200 m", ON_SIMULATOR, ge=0, le=1
    )
    camera_drift_walk_rad_per_m: float = setting(
        0.001, "rad/m of its drift, per √m: it fades along 18 m", ON_SIMULATOR, ge=0, le=1
    )
    camera_turn_walk: float = setting(0.00025, "of the ratio of its turns, per √m", ON_SIMULATOR, ge=0, le=1)
    mount_sigma_m: float = setting(
        0.005, "m that the camera sits ahead and aside of where it is said to be, by a ruler", CHOSEN, ge=0, le=10
    )
    mount_walk_m: float = setting(
        0.0001, "m, per √m: the point about which tyres let a base turn is not quite fixed", ON_SIMULATOR, ge=0, le=1
    )
    mount_sigma_rad: float = setting(
        0.005, "rad that it is turned about each axis, by a spirit level", CHOSEN, ge=0, le=3
    )
    mount_walk_rad: float = setting(0.0002, "rad, per √m", ON_SIMULATOR, ge=0, le=1)
    camera_lag_sigma_s: float = setting(
        0.02, "s that its stamps are late: less than a frame at 30 frames/s", CHOSEN, ge=0, le=10
    )
    camera_lag_walk_s: float = setting(0.0001, "s, per √m", ON_SIMULATOR, ge=0, le=1)
    lag_chi2: float = setting(
        30.0,
        "χ² of a change of twist, of which a lag is learned: noise alone has three, so nine tenths are motion",
        "computed",
        gt=0,
        le=1e6,
    )

    # Noise of the wheels, and of motion that they do not measure.
    wheel_noise_memory_m: float = setting(
        10.0,
        "m of way along which it fades how noisy the wheels were: floors change from room to room",
        CHOSEN,
        gt=0,
        le=1e9,
    )
    wheel_noise_least: float = setting(
        0.00390625,
        "least ratio of their variance to the calibration's, a sixteenth of the σ: so well wheels hold on a hard floor",
        f"{ON_SIMULATOR}: docs/decisions/0065",
        gt=0,
        le=1,
    )
    wheel_noise_most: float = setting(
        4.0, "most of it: a calibration may be wrong by a factor of two in σ", CHOSEN, ge=1, le=1e4
    )
    wheel_noise_cap_nats: float = setting(
        4.0,
        "largest weight of one stretch, so that a single wrong measurement of the camera has little effect",
        CHOSEN,
        gt=0,
        le=1000,
    )
    wheel_noise_heard_share: float = setting(
        0.95, "share of the time since a pose that wheel readings must cover for a comparison", CHOSEN, ge=0, le=1
    )
    side_m_per_sqrt_m: float = setting(0.005, "sideways", ON_SIMULATOR, ge=0, le=10)
    rise_m_per_sqrt_m: float = setting(0.003, "up", ON_SIMULATOR, ge=0, le=10)
    tilt_rad_per_sqrt_m: float = setting(0.05, "roll and pitch: ramps begin at once", CHOSEN, ge=0, le=3)
    lever_m: float = setting(
        0.25,
        "m beside the base of the point whose way these are told by: turns on the spot count, by about half a track",
        "computed, of wheels 0.5 m apart",
        ge=0,
        le=10,
    )
    level_sigma_rad: float | None = setting(
        0.005,
        "floors are level up to this, 25 mm in 5 m, twice what DIN 18202 allows; null: never level",
        "computed; DIN 18202",
        gt=0,
        le=1,
    )
    level_m: float = setting(
        5.0, "m; one stretch of floor so long is level or not whatever the one before was", CHOSEN, gt=0, le=1e4
    )
    level_every_m: float = setting(
        0.25, "m of way from one comparison with level to the next, for speed", CHOSEN, gt=0, le=1e4
    )
    ramp_chi2: float = setting(
        9.21,
        "of two tilts, 0.99: a larger tilt is a ramp, and is ignored",
        "computed: χ² of 2",
        gt=0,
        le=1e6,
    )
    known_for_s: float = setting(
        0.25,
        "s for which a twist that a measurement told says how a step changes with the wheels' errors",
        CHOSEN,
        gt=0,
        le=60,
    )

    # Motion without wheel readings, and stamps.
    clock_sigma_s: float = setting(
        0.01, "s by which stamps of camera and wheels are apart; at speed, that is a way", CHOSEN, ge=0, le=10
    )
    acceleration_m_s2: float = setting(
        1.0, "how speeds change in a second; assumed of a robot indoors", CHOSEN, ge=0, le=1000
    )
    side_acceleration_m_s2: float = setting(
        0.005,
        "the same to the side, where wheels roll ahead alone; of a holonomic base it is that of all directions",
        CHOSEN,
        ge=0,
        le=1000,
    )
    acceleration_rad_s2: float = setting(3.0, "likewise how yaw rates do", CHOSEN, ge=0, le=1000)
    window_s: float = setting(
        0.5,
        "how late an event may come: longer than hosts stall, short enough to be recomputed",
        CHOSEN,
        ge=0,
        le=60,
    )
    rate_readings: int = setting(
        16,
        "readings over which their rate is averaged: longer than a busy host stalls, shorter than rates change",
        CHOSEN,
        ge=2,
        le=100_000,
    )
    even_s: float = setting(
        0.25,
        "over a longer step of the wheels, as across a pause, the base need not have gone evenly",
        CHOSEN,
        ge=0,
        le=60,
    )
    swing_rad: float = setting(
        0.1, "rad by which the heading on such a step may differ from that of an even one", CHOSEN, ge=0, le=3.2
    )
    coast_after_s: float = setting(
        0.3, "since vision was last believed: some frames at any usual rate", CHOSEN, ge=0, le=600
    )
    lost_after_s: float = setting(2.0, "since the last event: an older speed says nothing", CHOSEN, ge=0, le=3600)
    lost_sigma_m: float = setting(30.0, "how far away a lost base may be: some rooms", CHOSEN, gt=0, le=1e5)
    lost_rise_m: float = setting(1.0, "how far up or down", CHOSEN, gt=0, le=1e4)
    lost_tilt_rad: float = setting(0.3, "how far tilted", CHOSEN, gt=0, le=3.2)
    largest_sigma_m: float = setting(
        1000.0, "a covariance beyond says nothing: anywhere about a town", CHOSEN, gt=0, le=1e6
    )
    largest_sigma_rad: float = setting(
        6.283185307179586,
        "likewise: any heading. Wheels alone come to 1 rad in some hundred metres",
        "computed: 2 π",
        gt=0,
        le=100,
    )
    max_clones: int = setting(
        16,
        "past poses remembered at most; the oldest goes. Four and a keyframe mostly: more while camera and wheels "
        "contradict each other, so that it is known afterwards how keyframes of then lie",
        CHOSEN,
        ge=5,
        le=1000,
    )

    # The gyroscope; what it is worth, its calibration says.
    gyro_mean_s: float = setting(
        0.05,
        "s; without wheel readings, the mean over this time is one measurement, as long as a step of the wheels",
        CHOSEN,
        gt=0,
        le=10,
    )
    gyro_told_share: float = setting(
        0.5, "of a time that it must have told of, to be measured by as if of all of it", CHOSEN, gt=0, lt=1
    )
    gyro_test_s: float = setting(
        0.3,
        "s of readings of which `1 - confidence` are refused though good: each reports slip for `coast_after_s`",
        CHOSEN,
        gt=0,
        le=60,
    )

    # Fault detection: do the wheels slip, or does vision fail? A sequential test (Wald 1945).
    confidence: float = setting(0.999, "share of good measurements that a gate lets pass", CHOSEN, gt=0, lt=1)
    decision_nats: float = setting(
        6.0,
        "log-likelihood ratio that decides: 1 to 400",
        "chosen, as Wald 1945 chooses error rates: e⁶ is 400",
        ge=0,
        le=1000,
    )
    leap_m_s2: float = setting(
        2.0, "σ of what a robot's acceleration may be; more is a leap of a sensor", CHOSEN, ge=0, le=1000
    )
    leap_rad_s2: float = setting(6.0, "likewise of its yaw rate", CHOSEN, ge=0, le=1000)
    leap_side_share: float = setting(0.25, "of that, sideways: wheels hold a base", CHOSEN, ge=0, le=10)
    leap_confidence: float = setting(0.99, "share of changes of speed that are no leap at all", CHOSEN, gt=0, lt=1)
    leap_chi2_cap: float = setting(16.0, "most that one leap counts: it may be no Gaussian", CHOSEN, ge=0, le=1e6)
    contradiction_nats: float = setting(
        1.5,
        "for slip, a frame in which a camera with its usual inliers contradicts the wheels, and once within "
        "`slippery_s` of slip",
        _FROM_0046,
        ge=0,
        le=1000,
    )
    slip_m_per_sqrt_s: float = setting(
        0.3, "where a base whose wheels slip may have gone instead: at a walk, any way", CHOSEN, ge=0, le=100
    )
    slip_rad_per_sqrt_s: float = setting(0.5, "likewise turned", CHOSEN, ge=0, le=100)
    slip_rise_m_per_sqrt_s: float = setting(0.1, "likewise up: a wheel that is lifted", CHOSEN, ge=0, le=100)
    slip_tilt_rad_per_sqrt_s: float = setting(0.2, "likewise to either side", CHOSEN, ge=0, le=100)
    slippery_s: float = setting(5.0, "s for which a floor stays slippery, at a walk", _FROM_0046, ge=0, le=3600)
    contradiction_nats_per_s: float = setting(
        8.0,
        "likewise a second, once decided for the wheels: a camera that fails does so for less than two",
        ON_SIMULATOR,
        ge=0,
        le=1000,
    )
    poor_inliers_nats: float = setting(
        2.0, "for visual failure, a frame with fewer inliers than usual", ON_SIMULATOR, ge=0, le=1000
    )
    inlier_share: float = setting(
        0.6,
        "of the usual share of inliers: with fewer, a camera that contradicts may be wrong itself",
        CHOSEN,
        gt=0,
        lt=1,
    )
    fitting_share: float = setting(
        0.75,
        "of the view's regions that must lie where they are known: a camera that contradicts the wheels, and a part of "
        "its view, follows what moves",
        CHOSEN,
        ge=0,
        le=1,
    )
    inlier_memory: float = setting(
        0.05, "of the usual share, what one frame changes: about the last twenty count", CHOSEN, gt=0, lt=1
    )
    likelihood_memory: float = setting(
        0.5, "of the log-likelihood ratio, what is left after a frame in which both agree", CHOSEN, ge=0, le=1
    )
    compared_s: float = setting(0.25, "s; over more between two frames, speeds are not compared", CHOSEN, gt=0, le=60)
    agreements: int = setting(
        5, "frames that must agree in a row before both are believed again", CHOSEN, gt=0, le=10_000
    )
    undecided_s: float = setting(
        2.0, "s after which both hypotheses become one that covers both", CHOSEN, ge=0, le=3600
    )
    covered_sigmas: float = setting(
        2.5,
        "at which the other hypothesis lies, so that its own error, too, has room within three",
        CHOSEN,
        gt=0,
        le=100,
    )

    def with_wheels(self, wheels: Wheels | HolonomicWheels | None) -> ErrorStateSettings:
        """The same, with what a calibration states of how sure the wheels' sizes are, and of what they let the base do.

        A holonomic base changes its speed to the side as it does ahead.
        """
        stated = {} if wheels is None else {name: getattr(wheels, name) for name in WHEEL_SIGMAS}
        known = {name: sigma for name, sigma in stated.items() if sigma > 0}
        if isinstance(wheels, HolonomicWheels):
            known |= {"side_acceleration_m_s2": self.acceleration_m_s2, "leap_side_share": 1.0}
        return self.model_copy(update=known)


class FilterParameters(ErrorStateSettings):
    """Settings, and what the gyroscope's readings are worth."""

    gyro: Gyro = setting(Gyro(), "what its readings are worth", "the calibration")

    @classmethod
    def of(cls, settings: ErrorStateSettings, gyro: Gyro) -> FilterParameters:
        """Both together."""
        return cls(**{name: getattr(settings, name) for name in ErrorStateSettings.model_fields}, gyro=gyro)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Other parameters, validated, without derived values."""
        return type(self)(**{name: getattr(self, name) for name in type(self).model_fields} | dict(update or {}))

    @cached_property
    def unseen_a_metre(self) -> FloatArray:
        """Covariance (6, 6) per metre of motion that wheels do not measure: sideways, up, roll and pitch."""
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


# What is believed of areas, of the model that names them, and of the wheels that they rectify.


_Share = Annotated[float, bounds(gt=0, lt=1)]
_Way = Annotated[float, bounds(gt=0, le=1e4)]

OdometryTerm = Literal["absolute", "increment"]

_SUM_TOLERANCE = 1e-9


class AreaFilterSettings(Settings):
    """What is believed of areas and of the model that names them, before the first frame."""

    accuracies: tuple[_Share, ...] = setting(
        (0.95, 0.8, 0.6), "of a model that does not fail, one level each", CHOSEN, min_length=1, max_length=20
    )
    failing_appearances_m: tuple[_Way, ...] = setting(
        (0.1, 1.0, 5.0, 25.0),
        "m of way after which the answer of a model that fails changes, one level each: decades",
        CHOSEN,
        min_length=1,
        max_length=20,
    )
    worth: float = setting(
        0.9, "probability before the first frame that the model is worth anything", CHOSEN, gt=0, lt=1
    )
    appearance_m: float = setting(
        1.0, "m of way after which an answer, right or wrong, says something new", CHOSEN, gt=0, le=1e4
    )
    appearance_per_rad_m: float = setting(0.5, "m that a turn of one radian counts as, likewise", CHOSEN, ge=0, le=1000)
    area_m: float = setting(10.0, "mean way through an area, m: some rooms", CHOSEN, gt=0, le=1e5)
    level_m: float = setting(
        200.0, "mean way, m, until the level of a model that does not fail may change", CHOSEN, gt=0, le=1e6
    )
    failure_m: float = setting(2000.0, "mean way until it fails, m", CHOSEN, gt=0, le=1e7)
    recovery_m: float = setting(15.0, "mean way until it does no longer, m", CHOSEN, gt=0, le=1e6)
    blip: float = setting(0.05, "share of single frames whose answer means nothing", CHOSEN, ge=0, le=1)
    neighbour_share: float = setting(
        0.5, "of the wrong answers, those that are of a neighbouring area", CHOSEN, ge=0, le=1
    )


class AreaRectifierSettings(Settings):
    """What is believed of wheels, areas and model before the drive."""

    position_sigma_m: float = setting(0.05, "of the start, m: as by a ruler", CHOSEN, ge=0, le=1e4)
    yaw_sigma_rad: float = setting(0.01, "of the start, rad", CHOSEN, ge=0, le=100)
    scale_sigma: float = setting(
        0.01, "ratio by which ways are wrong, of wheels that were calibrated", CHOSEN, ge=0, le=1
    )
    drift_sigma_rad_per_m: float = setting(
        0.015, "rad of turn a metre too much; wheels 1 % unequal, 0.5 m apart, drift by 0.02", "computed", ge=0, le=1
    )
    turn_sigma: float = setting(0.03, "ratio by which turns are wrong: of a track's width", CHOSEN, ge=0, le=1)
    scale_walk: float = setting(0.0002, "of the ratio of ways, per √m", ON_SIMULATOR, ge=0, le=1)
    drift_walk_rad_per_m: float = setting(0.0003, "rad/m of the drift, per √m", ON_SIMULATOR, ge=0, le=1)
    turn_walk: float = setting(0.0005, "of the ratio of turns, per √m", ON_SIMULATOR, ge=0, le=1)
    border_m: float = setting(
        0.4,
        "m from an area's border at which frames may name the next area already, or the last one still",
        CHOSEN,
        gt=0,
        le=100,
    )
    least_support: float = setting(
        0.01, "an answer that so little of the position's belief agrees with corrects nothing", CHOSEN, ge=0, le=1
    )
    stray: float = setting(
        0.001, "share of the areas' belief that goes by their adjacency alone, not by the position", CHOSEN, ge=0, le=1
    )
    forest: AreaFilterSettings = AreaFilterSettings()


@dataclass(frozen=True, slots=True)
class AxisWeights:
    """Eq. 5's weights on one axis, of the last coordinate, of odometry and of the area; each 0 to 1, together 1.

    Raises:
        ConfigError: weights that are not.
    """

    alpha: float
    beta: float
    gamma: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"weight {name} is {getattr(self, name)}", fix="0 to 1")
        total = self.alpha + self.beta + self.gamma
        if abs(total - 1) > _SUM_TOLERANCE:
            raise ConfigError(f"weights alpha + beta + gamma are {total:.9g}", fix="they sum to 1")

    def as_array(self) -> FloatArray:
        """(3,) alpha, beta, gamma."""
        return np.array([self.alpha, self.beta, self.gamma])


@dataclass(frozen=True, slots=True)
class Weights:
    """Eq. 5's weights in both cases, the same for x and y.

    Attributes:
        told: where the area determines the axis' coordinate.
        untold: where it does not, or no area is named; gamma is 0.

    Raises:
        ConfigError: a gamma where there is no coordinate.
    """

    told: AxisWeights = field(default_factory=lambda: AxisWeights(0.0, 0.9, 0.1))
    untold: AxisWeights = field(default_factory=lambda: AxisWeights(0.0, 1.0))

    def __post_init__(self) -> None:
        if self.untold.gamma != 0:
            raise ConfigError(f"weight gamma is {self.untold.gamma} where areas tell nothing", fix="give 0 there")


# FusionSettings: by which filter sensors are joined, and all that the filters go by.


FusionName = Literal["default", "ligocki", "none"]


class JoiningSettings(Settings):
    """What the default filter's way of joining goes by beside the filter; unknown names are refused."""

    anchor_way_m: float = setting(
        0.3,
        "distance from the reference frame of the camera's motions to the next one, a turn by 1 rad as "
        "1.5 m: against one that is held for a while, errors of single frames do not add up",
        CHOSEN,
        gt=0,
        le=100,
    )
    frame_walk_per_m: float = setting(
        25.0,
        "of the variance by which a frame errs as a whole, what a metre of the camera's way adds, a turn by 1 rad as "
        "1.5 m: such errors add up as a view changes",
        "freiburg1_desk against motion capture: docs/decisions/0065",
        ge=0,
        le=10_000,
    )
    dark_s: float = setting(
        1.0,
        "after so long in the dark a measurement is believed only where it shows all directions: one that slides "
        "along a wall may have taken one place for another, and wheels alone do not go astray so soon",
        CHOSEN,
        gt=0,
        le=3600,
    )
    restart_after: int = setting(
        5,
        "frames in a row that show nothing known, after which the camera goes on from where the wheels are",
        CHOSEN,
        gt=0,
        le=10_000,
    )
    same_view_m: float = setting(
        0.3,
        "a camera that by the wheels has moved less, a turn by 1 rad as 1.5 m, shows what it showed before",
        CHOSEN,
        gt=0,
        le=100,
    )
    recognised_m: float = setting(
        0.7,
        "after the dark a camera that by the wheels has moved less, a turn by 1 rad as 1.5 m, recognises its last view",
        "43 of 44 views that far in three recordings: docs/decisions/0050",
        gt=0,
        le=100,
    )
    stands_m: float = setting(
        0.02,
        "a base that by the wheels stays so near, a turn by 1 rad as 1.5 m, stands; a count of coarse encoders is less",
        CHOSEN,
        gt=0,
        le=10,
    )
    stands_s: float = setting(
        2.0,
        "wheels that have stood for longer may have stood in an elevator; its doors alone take as long to close",
        CHOSEN,
        gt=0,
        le=3600,
    )
    carried_m_s: float = setting(
        0.7, "σ of the speed at which people carry a robot in the dark: up to a walk", CHOSEN, gt=0, le=100
    )
    floor_m: float = setting(
        3.0, "σ of the height after another view of wheels that stood: from floor to floor", CHOSEN, ge=0, le=1000
    )
    unsure_m: float = setting(
        0.25,
        "where wheels know to no better σ how far the robot went since the camera was last believed, nobody knows the"
        " place at which the camera begins again: by as much a robot misses a door",
        CHOSEN,
        gt=0,
        le=100,
    )
    known_turn_rad: float = setting(
        0.5, "σ of a heading that areas have told again after that: a third of a right angle", CHOSEN, gt=0, le=3.2
    )


class LigockiSettings(Settings):
    """What the paper leaves open; unknown names are refused."""

    weight: float = setting(
        0.95,
        "C of eq. 2, of the wheels in each frame; the paper asks for 0 ≪ C < 1",
        "Ligocki's paper, eq. 2: 0 ≪ C < 1; the figure is chosen",
        ge=0.5,
        lt=1,
    )
    wheel_sigma_m_per_sqrt_s: float = setting(0.02, "how wheels drift, for the covariance only", CHOSEN, ge=0, le=100)
    wheel_sigma_rad_per_sqrt_s: float = setting(0.02, "likewise in yaw", CHOSEN, ge=0, le=100)
    visual_sigma_m_per_sqrt_s: float = setting(
        0.005, "how vision drifts, for the covariance only", CHOSEN, ge=0, le=100
    )
    visual_sigma_rad_per_sqrt_s: float = setting(0.003, "likewise in yaw", CHOSEN, ge=0, le=100)


class FusionSettings(Settings):
    """Settings of all filters; a name alone says which one joins."""

    filter: FusionName = setting(
        "none",
        "how wheels and one camera odometry are joined: by the default filter, which is the default where both are"
        " named, by Ligocki's, or not at all",
        ASKED,
    )
    joining: JoiningSettings = JoiningSettings()
    error_state: ErrorStateSettings = ErrorStateSettings()
    areas: AreaRectifierSettings = AreaRectifierSettings()
    ligocki: LigockiSettings = LigockiSettings()

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any) -> Any:
        return {"filter": given} if isinstance(given, str) else given
