"""What joins the parts into one pose: areas that rectify the wheels, as Trinh et al. do and with probabilities."""

from wheelsight.fusion.area_filter import AreaFilter, AreaFilterSettings
from wheelsight.fusion.probabilistic import AreaRectifier, AreaRectifierSettings, RectifiedEstimate
from wheelsight.fusion.rectifier import (
    AxisWeights,
    OdometryTerm,
    PaperRectifier,
    TrainingDrive,
    Weights,
    coordinates_of,
    fit_weights,
    rectify_drive,
)

__all__ = [
    "AreaFilter",
    "AreaFilterSettings",
    "AreaRectifier",
    "AreaRectifierSettings",
    "AxisWeights",
    "OdometryTerm",
    "PaperRectifier",
    "RectifiedEstimate",
    "TrainingDrive",
    "Weights",
    "coordinates_of",
    "fit_weights",
    "rectify_drive",
]
