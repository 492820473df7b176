"""Settings of sensor fusion: which filter joins the sensors, and what is known of sensors and floor before a drive."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from pydantic import model_validator

from wheelsight.core.calibration_parts import WHEEL_SIGMAS, HolonomicWheels, Wheels
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.settings.base import ASKED, CHOSEN, ON_SIMULATOR, Settings, setting

_FROM_DRIVES = f"{ON_SIMULATOR}: docs/decisions/filter.md"
_FROM_RECORDINGS = "two real recordings: docs/decisions/filter.md"

OdometryTerm = Literal["absolute", "increment"]
FusionName = Literal["default", "ligocki", "none"]

_SUM_TOLERANCE = 1e-9


class ErrorStateSettings(Settings):
    """What the default filter knows of sensors, robot and floor before a drive: standard deviations."""

    scale_sigma: float = setting(
        0.04,
        "ratio of the error of distances: a tyre under load differs from a data sheet's radius by some percent",
        _FROM_DRIVES,
        ge=0,
        le=1,
    )
    drift_sigma_rad_per_m: float = setting(
        0.02, "rotation error per metre: of wheels that differ by 1 %, 0.5 m apart", "computed", ge=0, le=1
    )
    turn_sigma: float = setting(
        0.03, "ratio of the error of turns: of a track width, which depends on where tyres touch", CHOSEN, ge=0, le=1
    )
    camera_scale_sigma: float = setting(
        0.02,
        "ratio of the error of the camera's distances: Kinects' depth is 3.1 and 3.5 % off (Sturm et al., IROS 2012)",
        _FROM_RECORDINGS,
        ge=0,
        le=1,
    )
    mount_sigma_m: float = setting(
        0.005, "error of the camera's position on the base, ahead and aside, metres: by a ruler", CHOSEN, ge=0, le=10
    )
    mount_sigma_rad: float = setting(
        0.005, "error of its rotation about each axis, radians: by a spirit level", CHOSEN, ge=0, le=3
    )
    camera_lag_sigma_s: float = setting(
        0.02, "delay of its stamps, seconds: less than a frame at 30 frames/s", CHOSEN, ge=0, le=10
    )
    clock_sigma_s: float = setting(
        0.01, "difference between stamps of camera and wheels, seconds; at speed, that is a way", CHOSEN, ge=0, le=10
    )
    level_sigma_rad: float | None = setting(
        0.005,
        "tilt of a level floor, 25 mm in 5 m: twice what DIN 18202 allows; null: no floor is level",
        "computed; DIN 18202",
        gt=0,
        le=1,
    )
    acceleration_m_s2: float = setting(
        1.0, "change of the robot's speed in a second, for a robot indoors", CHOSEN, ge=0, le=1000
    )
    acceleration_rad_s2: float = setting(3.0, "change of its yaw rate in a second", CHOSEN, ge=0, le=1000)
    window_s: float = setting(
        0.5,
        "longest delay of an event, seconds: longer than hosts stall, short enough to be computed again",
        CHOSEN,
        ge=0,
        le=60,
    )
    confidence: float = setting(0.999, "share of good measurements that pass a gate", CHOSEN, gt=0, lt=1)

    def with_wheels(self, wheels: Wheels | HolonomicWheels | None) -> ErrorStateSettings:
        """Return the settings with the accuracy of the wheels' sizes that a calibration states.

        The default drift is that of two wheels. Without a stated one, it becomes that of a holonomic base's wheels.
        """
        stated = {} if wheels is None else {name: getattr(wheels, name) for name in WHEEL_SIGMAS}
        known = {name: sigma for name, sigma in stated.items() if sigma > 0}
        is_default = self.drift_sigma_rad_per_m == type(self).model_fields["drift_sigma_rad_per_m"].default
        if isinstance(wheels, HolonomicWheels) and is_default:
            known.setdefault("drift_sigma_rad_per_m", wheels.nominal_drift_sigma_rad_per_m)
        return self.model_copy(update=known)


class AreaRectifierSettings(Settings):
    """What is known of the start on a drive by areas: standard deviations."""

    position_sigma_m: float = setting(0.05, "of the start, metres: by a ruler", CHOSEN, ge=0, le=1e4)
    yaw_sigma_rad: float = setting(0.01, "of the start, radians", CHOSEN, ge=0, le=100)


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
        with_area: where the area determines the axis' coordinate.
        without_area: where it does not, or no area is recognized; gamma is 0.

    Raises:
        ConfigError: a gamma where there is no coordinate.
    """

    with_area: AxisWeights = field(default_factory=lambda: AxisWeights(0.0, 0.9, 0.1))
    without_area: AxisWeights = field(default_factory=lambda: AxisWeights(0.0, 1.0))

    def __post_init__(self) -> None:
        if self.without_area.gamma != 0:
            raise ConfigError(f"weight gamma is {self.without_area.gamma} without an area", fix="give 0 there")


class LigockiSettings(Settings):
    """Setting of Ligocki's filter."""

    weight: float = setting(
        0.95,
        "C of eq. 2, of the wheels in each frame; the paper asks for 0 ≪ C < 1",
        "Ligocki's paper, eq. 2: 0 ≪ C < 1; the figure is chosen",
        ge=0.5,
        lt=1,
    )


class FusionSettings(Settings):
    """Settings of all filters; a name alone selects the filter."""

    filter: FusionName = setting(
        "none",
        "how wheels and one camera odometry are joined: by the default filter, which is the default where both are"
        " named, by Ligocki's, or not at all",
        ASKED,
    )
    error_state: ErrorStateSettings = ErrorStateSettings()
    areas: AreaRectifierSettings = AreaRectifierSettings()
    ligocki: LigockiSettings = LigockiSettings()

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any) -> Any:
        return {"filter": given} if isinstance(given, str) else given
