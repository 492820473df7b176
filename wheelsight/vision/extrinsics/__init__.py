"""The mount of a camera on its robot and the clock offset of the wheels, from an ordinary drive with both."""

from wheelsight.vision.extrinsics.agreement import Agreement, Culprit, Explanation, depth_cause
from wheelsight.vision.extrinsics.calibration import (
    QUANTITIES,
    BaseCalibration,
    ExtrinsicsSettings,
    Sightings,
    base_from,
    calibrate_base,
    mount_values,
    watch,
)
from wheelsight.vision.extrinsics.mount import (
    FloorDepths,
    FloorFit,
    FloorRangeSettings,
    MountFit,
    Turning,
    common_turning,
    fit_floor,
    fit_mount,
    height_below,
    tilt_of,
)

__all__ = [
    "QUANTITIES",
    "Agreement",
    "BaseCalibration",
    "Culprit",
    "Explanation",
    "ExtrinsicsSettings",
    "FloorDepths",
    "FloorFit",
    "FloorRangeSettings",
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
