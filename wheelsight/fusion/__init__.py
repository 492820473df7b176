"""What joins the parts into one pose.

Wheels with camera and gyroscope, as Ligocki does and with covariances; areas that rectify the wheels, as Trinh et al.
do and with probabilities.
"""

from wheelsight.fusion.areas import (
    AreaFilter,
    AreaFilterSettings,
    AreaRectifier,
    AreaRectifierSettings,
    AxisWeights,
    OdometryTerm,
    PaperRectifier,
    PlaceMeter,
    RectifiedEstimate,
    TrainingDrive,
    Weights,
    coordinates_of,
    fit_weights,
    rectify_drive,
)
from wheelsight.fusion.error_state import (
    STEP_BEGIN,
    ErrorStateFilter,
    ErrorStateSettings,
    FrameUpdate,
    FusedEstimate,
    covering_pose,
)
from wheelsight.fusion.ligocki import JoinedEstimate, LigockiFilter, LigockiSettings
from wheelsight.fusion.settings import FusionName, FusionSettings, JoiningSettings

__all__ = [
    "STEP_BEGIN",
    "AreaFilter",
    "AreaFilterSettings",
    "AreaRectifier",
    "AreaRectifierSettings",
    "AxisWeights",
    "ErrorStateFilter",
    "ErrorStateSettings",
    "FrameUpdate",
    "FusedEstimate",
    "FusionName",
    "FusionSettings",
    "JoinedEstimate",
    "JoiningSettings",
    "LigockiFilter",
    "LigockiSettings",
    "OdometryTerm",
    "PaperRectifier",
    "PlaceMeter",
    "RectifiedEstimate",
    "TrainingDrive",
    "Weights",
    "coordinates_of",
    "covering_pose",
    "fit_weights",
    "rectify_drive",
]
