"""The camera odometry that the settings name, and where the camera sits."""

from __future__ import annotations

from wheelsight.calibration import Calibration
from wheelsight.config import Config
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray, se3
from wheelsight.localizer.map_builder import MapBuilder
from wheelsight.odometry.dense import DenseOdometry
from wheelsight.odometry.features import FeatureOdometry


def mount_of(calibration: Calibration) -> FloatArray:
    """T_base_camera (4, 4), made rigid, since files have few digits. Raises CalibrationError where it is not known."""
    if calibration.T_base_camera is None:
        problem = f"the calibration ({calibration.source}) does not say where the camera sits on the base"
        raise CalibrationError(problem, fix="wheelsight calibrate base finds T_base_camera; or --fusion none")
    return se3.nearest(calibration.T_base_camera)


def camera_odometry(
    calibration: Calibration, settings: Config
) -> tuple[FeatureOdometry | DenseOdometry, MapBuilder | None]:
    """Feature or dense odometry, whose map begins where the base was where that is known; and what builds a map.

    Beside wheels, tracking begins against keyframes; who joins both says when the map shows more.
    """
    if settings.map == "surfels":
        dense = DenseOdometry(calibration, settings.dense, T_map_first=calibration.T_base_camera)
        mapper = MapBuilder(dense, calibration, settings.surfels)
        mapper.track_map(settings.fusion.filter != "default")
        return dense, mapper
    if "dense" in settings.odometry:
        return DenseOdometry(calibration, settings.dense, T_map_first=calibration.T_base_camera), None
    return FeatureOdometry(calibration, settings.features, T_map_first=calibration.T_base_camera), None
