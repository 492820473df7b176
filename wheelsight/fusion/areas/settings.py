"""What is believed of areas, of the model that names them, and of the wheels that they rectify."""

from __future__ import annotations

from typing import Annotated

from wheelsight.settings import CHOSEN, ON_SIMULATOR, Settings, bounds, setting

_Share = Annotated[float, bounds(gt=0, lt=1)]
_Way = Annotated[float, bounds(gt=0, le=1e4)]


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
        0.015, "rad of turn a metre too much; wheels 1 % unequal, 0.5 m apart, drift by 0.02", "reckoned", ge=0, le=1
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
