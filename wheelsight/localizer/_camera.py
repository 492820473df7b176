"""The camera odometry that the settings name."""

from __future__ import annotations

from wheelsight.calibration import Calibration
from wheelsight.config import Config
from wheelsight.mapping import SurfelMapper
from wheelsight.odometry.dense import DenseOdometry
from wheelsight.odometry.features import FeatureOdometry


def camera_odometry(
    calibration: Calibration, settings: Config
) -> tuple[FeatureOdometry | DenseOdometry, SurfelMapper | None]:
    """Feature or dense odometry, whose world is where the base was where that is known; and what builds a map.

    Beside wheels keyframes are tracked against, which reach as far as the camera sees: the map ends at
    `surfels.far_m`, and in a hall shows little but floor.
    """
    if settings.map == "surfels":
        tracks = settings.fusion != "default"
        mapper = SurfelMapper(calibration, settings.dense, settings.surfels, tracks=tracks)
        return mapper.odometry, mapper
    if "dense" in settings.odometry:
        return DenseOdometry(calibration, settings.dense, T_world_first=calibration.T_base_camera), None
    return FeatureOdometry(calibration, settings.features, T_world_first=calibration.T_base_camera), None
