"""Wheels rectified by the areas that a model of places names: by Trinh et al., eq. 5, and with probabilities."""

from wheelsight.fusion.areas.filter import AreaFilter
from wheelsight.fusion.areas.paper import (
    AxisWeights,
    OdometryTerm,
    PaperRectifier,
    TrainingDrive,
    Weights,
    coordinates_of,
    fit_weights,
    rectify_drive,
)
from wheelsight.fusion.areas.place_meter import PlaceMeter
from wheelsight.fusion.areas.rectifier import AreaRectifier, RectifiedEstimate
from wheelsight.fusion.areas.settings import AreaFilterSettings, AreaRectifierSettings

__all__ = [
    "AreaFilter",
    "AreaFilterSettings",
    "AreaRectifier",
    "AreaRectifierSettings",
    "AxisWeights",
    "OdometryTerm",
    "PaperRectifier",
    "PlaceMeter",
    "RectifiedEstimate",
    "TrainingDrive",
    "Weights",
    "coordinates_of",
    "fit_weights",
    "rectify_drive",
]
