"""Places: which area of a building a frame was taken in."""

from wheelsight.places.calibration import (
    CalibrationCurve,
    ProbabilityScale,
    calibration_curve,
    fit_scale,
    held_out_folds,
    log_loss,
)
from wheelsight.places.contact_sheet import ContactSheet, chosen_frames, make_sheet
from wheelsight.places.dataset import (
    LabelledDrive,
    LabelSource,
    check_every_area,
    describe_drive,
    frames_of,
    label_source,
    names_of_all,
    stamps_of,
    train_on_drives,
)
from wheelsight.places.describer import Describer, FrameSize
from wheelsight.places.describers import describer_from
from wheelsight.places.forest import Forest, ForestSettings, grow_forest
from wheelsight.places.histograms import HistogramDescriber, HistogramSettings
from wheelsight.places.labels import LabelFile, labels_on_the_way, read_labels
from wheelsight.places.layout import LayoutDescriber, LayoutSettings
from wheelsight.places.model import HeldOutFigures, PlaceMatch, PlaceModel, Unknown
from wheelsight.places.training import DescribedFrames, describe_all, train_places
from wheelsight.places.trial import Answers, Mistake, PlaceTrial, answer_all, predictions_csv, try_places

__all__ = [
    "Answers",
    "CalibrationCurve",
    "ContactSheet",
    "DescribedFrames",
    "Describer",
    "Forest",
    "ForestSettings",
    "FrameSize",
    "HeldOutFigures",
    "HistogramDescriber",
    "HistogramSettings",
    "LabelFile",
    "LabelSource",
    "LabelledDrive",
    "LayoutDescriber",
    "LayoutSettings",
    "Mistake",
    "PlaceMatch",
    "PlaceModel",
    "PlaceTrial",
    "ProbabilityScale",
    "Unknown",
    "answer_all",
    "calibration_curve",
    "check_every_area",
    "chosen_frames",
    "describe_all",
    "describe_drive",
    "describer_from",
    "fit_scale",
    "frames_of",
    "grow_forest",
    "held_out_folds",
    "label_source",
    "labels_on_the_way",
    "log_loss",
    "make_sheet",
    "names_of_all",
    "predictions_csv",
    "read_labels",
    "stamps_of",
    "train_on_drives",
    "train_places",
    "try_places",
]
