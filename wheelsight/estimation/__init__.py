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
from wheelsight.estimation.localizer import Localizer
from wheelsight.estimation.localizer_workers import LocalizerApart, LocalizerBeside, LocalizerInStep
from wheelsight.estimation.odometry_choice import Choice, Sensors, choose_odometry

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
    "LigockiSettings",
    "Localizer",
    "LocalizerApart",
    "LocalizerBeside",
    "LocalizerInStep",
    "OdometryTerm",
    "PlaceMeter",
    "Places",
    "RectifiedEstimate",
    "Sensors",
    "Weights",
    "choose_odometry",
    "covering_pose",
    "load_places",
]
