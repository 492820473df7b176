"""FusionSettings: by which filter sensors are joined, and all that the filters go by."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import model_validator

from wheelsight.fusion.areas import AreaRectifierSettings
from wheelsight.fusion.error_state import ErrorStateSettings
from wheelsight.fusion.ligocki import LigockiSettings
from wheelsight.settings import ASKED, CHOSEN, Settings, setting

FusionName = Literal["default", "ligocki", "none"]


class JoiningSettings(Settings):
    """What the default filter's way of joining goes by beside the filter; unknown names are refused."""

    anchor_way_m: float = setting(
        0.3,
        "way from the frame that the camera's motions are told against to the next such one, a turn by 1 rad as "
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
