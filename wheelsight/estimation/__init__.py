"""Estimation: sensor fusion, consistency checks and the Localizer. Events go in, poses with covariance come out."""

from wheelsight.core.estimates import STEP_BEGIN, FrameUpdate, FusedEstimate
from wheelsight.core.settings.fusion import (
    AreaRectifierSettings,
    AxisWeights,
    ErrorStateSettings,
    FusionName,
    FusionSettings,
    LigockiSettings,
    OdometryTerm,
    Weights,
)
from wheelsight.estimation.area_localizer import Places, load_places
from wheelsight.estimation.area_rectifier import AreaFilter, AreaRectifier, PlaceMeter, RectifiedEstimate
from wheelsight.estimation.fault_detection import covering_pose
from wheelsight.estimation.filter import ErrorStateFilter
from wheelsight.estimation.ligocki import JoinedEstimate, LigockiFilter
from wheelsight.estimation.localizer import Localizer
from wheelsight.estimation.localizer_workers import LocalizerApart, LocalizerBeside, LocalizerInStep
from wheelsight.estimation.odometry_choice import Choice, Sensors, choose_odometry
from wheelsight.estimation.paper_rectifier import (
    PaperRectifier,
    TrainingDrive,
    coordinates_of,
    fit_weights,
    rectify_drive,
)

__all__ = [
    "STEP_BEGIN",
    "AreaFilter",
    "AreaRectifier",
    "AreaRectifierSettings",
    "AxisWeights",
    "Choice",
    "ErrorStateFilter",
    "ErrorStateSettings",
    "FrameUpdate",
    "FusedEstimate",
    "FusionName",
    "FusionSettings",
    "JoinedEstimate",
    "LigockiFilter",
    "LigockiSettings",
    "Localizer",
    "LocalizerApart",
    "LocalizerBeside",
    "LocalizerInStep",
    "OdometryTerm",
    "PaperRectifier",
    "PlaceMeter",
    "Places",
    "RectifiedEstimate",
    "Sensors",
    "TrainingDrive",
    "Weights",
    "choose_odometry",
    "coordinates_of",
    "covering_pose",
    "fit_weights",
    "load_places",
    "rectify_drive",
]
