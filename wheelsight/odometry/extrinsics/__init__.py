"""Where the camera sits on its robot, and how late the wheels' clock is, from an ordinary drive with both."""

from wheelsight.odometry.extrinsics.agreement import Agreement, Culprit, Explanation, depth_cause
from wheelsight.odometry.extrinsics.calibrate import (
    QUANTITIES,
    BaseCalibration,
    base_from,
    calibrate_base,
    mount_values,
)
from wheelsight.odometry.extrinsics.floor import Floor, FloorViews, fit_floor, height_below, tilt_of
from wheelsight.odometry.extrinsics.hand_eye import MountFit, fit_mount
from wheelsight.odometry.extrinsics.settings import AgreementSettings, ExtrinsicsSettings, FloorSettings
from wheelsight.odometry.extrinsics.sightings import Sightings, watch
from wheelsight.odometry.extrinsics.turning import Turning, common_turning

__all__ = [
    "QUANTITIES",
    "Agreement",
    "AgreementSettings",
    "BaseCalibration",
    "Culprit",
    "Explanation",
    "ExtrinsicsSettings",
    "Floor",
    "FloorSettings",
    "FloorViews",
    "MountFit",
    "Sightings",
    "Turning",
    "base_from",
    "calibrate_base",
    "common_turning",
    "depth_cause",
    "fit_floor",
    "fit_mount",
    "height_below",
    "mount_values",
    "tilt_of",
    "watch",
]
