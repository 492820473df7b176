"""What joins the parts into one pose.

Wheels with camera and gyroscope, as Ligocki does and with covariances; areas that rectify the wheels, as Trinh et al.
do and with probabilities.
"""

from wheelsight.fusion._settings import ErrorStateSettings
from wheelsight.fusion._two_beliefs import covering_pose
from wheelsight.fusion.area_filter import AreaFilter, AreaFilterSettings
from wheelsight.fusion.error_state import ErrorStateFilter, FusedEstimate
from wheelsight.fusion.kalman import JoinedEstimate, LigockiFilter, LigockiSettings
from wheelsight.fusion.place_meter import PlaceMeter
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
    "ErrorStateFilter",
    "ErrorStateSettings",
    "FusedEstimate",
    "JoinedEstimate",
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
