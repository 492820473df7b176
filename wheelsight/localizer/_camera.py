"""The camera odometry that the settings name, and where the camera sits."""

from __future__ import annotations

from wheelsight.calibration import Calibration
from wheelsight.config import Config
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray, se3
from wheelsight.localizer._loops import begin_in
from wheelsight.localizer.choice import NO_PARTS, OwnParts
from wheelsight.localizer.map_builder import MapBuilder
from wheelsight.odometry.dense import DenseOdometry
from wheelsight.odometry.features import FeatureOdometry
from wheelsight.odometry.own import OwnOdometry
from wheelsight.slam.known import KnownMap

CameraOdometry = FeatureOdometry | DenseOdometry | OwnOdometry


def mount_of(calibration: Calibration) -> FloatArray:
    """T_base_camera (4, 4), made rigid, since files have few digits. Raises CalibrationError where it is not known."""
    if calibration.T_base_camera is None:
        problem = f"the calibration ({calibration.source}) does not say where the camera sits on the base"
        raise CalibrationError(problem, fix="wheelsight calibrate base finds T_base_camera; or --fusion none")
    return se3.nearest(calibration.T_base_camera)


def camera_odometry(
    calibration: Calibration, settings: Config, known: KnownMap | None = None, parts: OwnParts = NO_PARTS
) -> tuple[CameraOdometry, MapBuilder | None]:
    """The camera's odometry, whose map begins where the base was where that is known; and what builds a map.

    A user's own takes the place of dense and feature odometry. In a map of before it begins where somebody says, or
    apart from it where nobody does. Beside wheels, frames are aligned with keyframes alone: docs/decisions/0061.
    """
    store, T_map_first = (
        (None, calibration.T_base_camera)
        if known is None
        else (known.store, begin_in(known, calibration, settings.loops.pieces))
    )
    if parts.visual_odometry is not None:
        own = (parts.visual_odometry, calibration, settings.features)
        return OwnOdometry(*own, T_map_first=T_map_first, store=store), None
    if settings.map == "surfels":
        dense = DenseOdometry(calibration, settings.dense, T_map_first=T_map_first, store=store)
        mapper = MapBuilder(dense, calibration, settings.surfels)
        mapper.track_map(settings.fusion.filter != "default")
        return dense, mapper
    if "dense" in settings.odometry:
        return DenseOdometry(calibration, settings.dense, T_map_first=T_map_first, store=store), None
    return FeatureOdometry(calibration, settings.features, T_map_first=T_map_first, store=store), None
