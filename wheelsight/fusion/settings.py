"""FusionSettings: by which filter sensors are joined, and all that the filters go by."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from wheelsight.fusion.areas import AreaRectifierSettings
from wheelsight.fusion.error_state import ErrorStateSettings
from wheelsight.fusion.ligocki import LigockiSettings
from wheelsight.settings import Settings

FusionName = Literal["default", "ligocki", "none"]


class JoiningSettings(Settings):
    """What the default filter's way of joining goes by beside the filter; unknown names are refused."""

    anchor_way_m: PositiveFloat = Field(
        default=0.3,
        description="way from the frame that the camera's motions are told against to the next such one, a turn by "
        "1 rad as 1.5 m: against one that is held for a while, errors of single frames do not add up",
    )
    dark_s: PositiveFloat = Field(
        default=1.0,
        description="after so long in the dark a measurement is believed only where it shows all directions: one that "
        "slides along a wall may have taken one place for another, and wheels alone do not go astray so soon",
    )
    restart_after: PositiveInt = Field(
        default=5,
        description="frames in a row that show nothing known, after which the camera goes on from where the wheels are",
    )
    map_turn_rad_s: PositiveFloat = Field(
        default=0.1,
        description="from here on a base turns, and keyframes lead instead of the map, which turns 0.08 % too far; of "
        "five flats of the simulator alone",
    )
    uncalm_s: NonNegativeFloat = Field(
        default=5.0, description="so long after a measurement that was not believed, people may go on to mislead"
    )
    same_view_m: PositiveFloat = Field(
        default=0.3,
        description="a camera that by the wheels has moved less, a turn by 1 rad as 1.5 m, shows what it showed before",
    )
    carried_m_s: PositiveFloat = Field(
        default=0.7, description="σ of the speed at which people carry a robot in the dark: up to a walk"
    )
    known_turn_rad: PositiveFloat = Field(
        default=0.5, description="σ of a heading that areas have told again after that: a third of a right angle"
    )


class FusionSettings(Settings):
    """Settings of all filters; a name alone says which one joins."""

    filter: FusionName = Field(
        default="none",
        description="how wheels and one camera odometry are joined: by the default filter, which is the default where "
        "both are named, by Ligocki's, or not at all",
    )
    joining: JoiningSettings = JoiningSettings()
    error_state: ErrorStateSettings = ErrorStateSettings()
    areas: AreaRectifierSettings = AreaRectifierSettings()
    ligocki: LigockiSettings = LigockiSettings()

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any) -> Any:
        return {"filter": given} if isinstance(given, str) else given
