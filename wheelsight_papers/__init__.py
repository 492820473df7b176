"""Methods of the papers kept for comparison, training and trials of place models.

Each name is loaded at its first use.
"""

from typing import TYPE_CHECKING, Any

from wheelsight.core.runtime import public_name

if TYPE_CHECKING:
    from wheelsight_papers.dataset import (
        ContactSheet,
        LabelFile,
        LabelledDrive,
        LabelSource,
        check_every_area,
        chosen_frames,
        describe_drive,
        frames_of,
        label_source,
        labels_on_the_way,
        make_sheet,
        names_of_all,
        read_labels,
        stamps_of,
        train_on_drives,
    )
    from wheelsight_papers.ligocki import JoinedEstimate, LigockiFilter
    from wheelsight_papers.paper_rectifier import (
        PaperRectifier,
        TrainingDrive,
        coordinates_of,
        fit_weights,
        rectify_drive,
    )
    from wheelsight_papers.places_page import write_places_page, write_sheet
    from wheelsight_papers.training import (
        Answers,
        CalibrationCurve,
        DescribedFrames,
        Mistake,
        PlaceTrial,
        answer_all,
        calibration_curve,
        describe_all,
        fit_scale,
        grow_forest,
        held_out_folds,
        log_loss,
        predictions_csv,
        train_places,
        try_places,
    )

__all__ = [
    "Answers",
    "CalibrationCurve",
    "ContactSheet",
    "DescribedFrames",
    "JoinedEstimate",
    "LabelFile",
    "LabelSource",
    "LabelledDrive",
    "LigockiFilter",
    "Mistake",
    "PaperRectifier",
    "PlaceTrial",
    "TrainingDrive",
    "answer_all",
    "calibration_curve",
    "check_every_area",
    "chosen_frames",
    "coordinates_of",
    "describe_all",
    "describe_drive",
    "fit_scale",
    "fit_weights",
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
    "rectify_drive",
    "stamps_of",
    "train_on_drives",
    "train_places",
    "try_places",
    "write_places_page",
    "write_sheet",
]

_MODULES = ("dataset", "ligocki", "paper_rectifier", "places_page", "training")


def __getattr__(name: str) -> Any:
    return public_name(__name__, name, __all__, _MODULES)
