"""What is believed of areas, of the model that names them, and of the wheels that they rectify."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, NonNegativeFloat, PositiveFloat

from wheelsight.settings import Settings

_Share = Annotated[float, Field(gt=0, lt=1)]
_Probability = Annotated[float, Field(ge=0, le=1)]


class AreaFilterSettings(Settings):
    """What is believed of areas and of the model that names them, before the first frame."""

    accuracies: tuple[_Share, ...] = Field(
        default=(0.95, 0.8, 0.6), min_length=1, description="of a model that does not fail, one level each; assumed"
    )
    failing_appearances_m: tuple[PositiveFloat, ...] = Field(
        default=(0.1, 1.0, 5.0, 25.0),
        min_length=1,
        description="m of way after which the answer of a model that fails changes, one level each: decades",
    )
    worth: _Share = Field(
        default=0.9, description="probability before the first frame that the model is worth anything; assumed"
    )
    appearance_m: PositiveFloat = Field(
        default=1.0, description="m of way after which an answer, right or wrong, says something new"
    )
    appearance_per_rad_m: NonNegativeFloat = Field(
        default=0.5, description="m that a turn of one radian counts as, likewise"
    )
    area_m: PositiveFloat = Field(default=10.0, description="mean way through an area, m: some rooms; assumed")
    level_m: PositiveFloat = Field(
        default=200.0, description="mean way, m, until the level of a model that does not fail may change; assumed"
    )
    failure_m: PositiveFloat = Field(default=2000.0, description="mean way until it fails, m; assumed")
    recovery_m: PositiveFloat = Field(default=15.0, description="mean way until it does no longer, m; assumed")
    blip: _Probability = Field(default=0.05, description="share of single frames whose answer means nothing; assumed")
    neighbour_share: _Probability = Field(
        default=0.5, description="of the wrong answers, those that are of a neighbouring area; assumed"
    )


class AreaRectifierSettings(Settings):
    """What is believed of wheels, areas and model before the drive."""

    position_sigma_m: NonNegativeFloat = Field(default=0.05, description="of the start, m: as by a ruler; assumed")
    yaw_sigma_rad: NonNegativeFloat = Field(default=0.01, description="of the start, rad; assumed")
    scale_sigma: NonNegativeFloat = Field(
        default=0.01, description="ratio by which ways are wrong, of wheels that were calibrated"
    )
    drift_sigma_rad_per_m: NonNegativeFloat = Field(
        default=0.015, description="rad of turn a metre too much; wheels 1 % unequal, 0.5 m apart, drift by 0.02"
    )
    turn_sigma: NonNegativeFloat = Field(default=0.03, description="ratio by which turns are wrong: of a track's width")
    scale_walk: NonNegativeFloat = Field(
        default=0.0002, description="of the ratio of ways, per √m; found on the simulator alone"
    )
    drift_walk_rad_per_m: NonNegativeFloat = Field(
        default=0.0003, description="rad/m of the drift, per √m; found on the simulator alone"
    )
    turn_walk: NonNegativeFloat = Field(
        default=0.0005, description="of the ratio of turns, per √m; found on the simulator alone"
    )
    border_m: PositiveFloat = Field(
        default=0.4,
        description="m from an area's border at which frames may name the next area already, or the last one still",
    )
    least_support: NonNegativeFloat = Field(
        default=0.01, description="an answer that so little of the position's belief agrees with corrects nothing"
    )
    stray: _Probability = Field(
        default=0.001, description="share of the areas' belief that goes by their adjacency alone, not by the position"
    )
    forest: AreaFilterSettings = AreaFilterSettings()
