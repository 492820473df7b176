"""The mount of a camera on its robot and the clock offset of the wheels, from an ordinary drive with both."""

from wheelsight.vision.extrinsics.agreement import Agreement, Culprit, Explanation, depth_cause
from wheelsight.vision.extrinsics.calibration import (
    QUANTITIES,
    BaseCalibration,
    Sightings,
    base_from,
    calibrate_base,
    mount_values,
    watch,
)
from wheelsight.vision.extrinsics.mount import (
    Floor,
    FloorViews,
    MountFit,
    Turning,
    common_turning,
    fit_floor,
    fit_mount,
    height_below,
    tilt_of,
)
from wheelsight.vision.extrinsics.settings import AgreementSettings, ExtrinsicsSettings, FloorSettings

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
