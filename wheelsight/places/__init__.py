"""Places: which area of a building a frame was taken in."""

from wheelsight.places.calibration import (
    CalibrationCurve,
    ProbabilityScale,
    calibration_curve,
    fit_scale,
    held_out_folds,
    log_loss,
)
from wheelsight.places.describer import Describer, FrameSize, describer_from
from wheelsight.places.forest import Forest, ForestSettings, grow_forest
from wheelsight.places.histograms import HistogramDescriber, HistogramSettings
from wheelsight.places.layout import LayoutDescriber, LayoutSettings
from wheelsight.places.model import HeldOutFigures, PlaceMatch, PlaceModel, Unknown
from wheelsight.places.training import DescribedFrames, describe_all, train_places

__all__ = [
    "CalibrationCurve",
    "DescribedFrames",
    "Describer",
    "Forest",
    "ForestSettings",
    "FrameSize",
    "HeldOutFigures",
    "HistogramDescriber",
    "HistogramSettings",
    "LayoutDescriber",
    "LayoutSettings",
    "PlaceMatch",
    "PlaceModel",
    "ProbabilityScale",
    "Unknown",
    "calibration_curve",
    "describe_all",
    "describer_from",
    "fit_scale",
    "grow_forest",
    "held_out_folds",
    "log_loss",
    "train_places",
]
