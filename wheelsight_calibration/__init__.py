"""Calibration that is made once, off line: cameras by a board, a camera's mount, wheels and clocks by a drive.

`solver` is the robust least squares of all that drives calibrate, and takes problems with bounds and priors. Each name
is loaded at its first use.
"""

from typing import TYPE_CHECKING, Any

from wheelsight.core.runtime import public_name

if TYPE_CHECKING:
    from wheelsight_calibration.base import (
        QUANTITIES,
        BaseCalibration,
        Sightings,
        base_from,
        calibrate_base,
        mount_values,
        watch,
    )
    from wheelsight_calibration.board import Board, board_from
    from wheelsight_calibration.camera_model import CameraSetup
    from wheelsight_calibration.cameras import CameraCalibration, calibrate_camera
    from wheelsight_calibration.live_views import ViewTaker, advise
    from wheelsight_calibration.loop_check import LoopCause, LoopCheck, check_loop
    from wheelsight_calibration.mount import FloorDepths, FloorFit, MountFit, Turning, fit_floor, fit_mount
    from wheelsight_calibration.squares import Umbmark, umbmark
    from wheelsight_calibration.views import ViewSet, read_views
    from wheelsight_calibration.wheel_drive import WheelDrive, drive_from_ticks, drive_of, drive_path
    from wheelsight_calibration.wheels import WheelFit, WheelTrial, fit_wheels, try_calibration

__all__ = [
    "QUANTITIES",
    "BaseCalibration",
    "Board",
    "CameraCalibration",
    "CameraSetup",
    "FloorDepths",
    "FloorFit",
    "LoopCause",
    "LoopCheck",
    "MountFit",
    "Sightings",
    "Turning",
    "Umbmark",
    "ViewSet",
    "ViewTaker",
    "WheelDrive",
    "WheelFit",
    "WheelTrial",
    "advise",
    "base_from",
    "board_from",
    "calibrate_base",
    "calibrate_camera",
    "check_loop",
    "drive_from_ticks",
    "drive_of",
    "drive_path",
    "fit_floor",
    "fit_mount",
    "fit_wheels",
    "mount_values",
    "read_views",
    "try_calibration",
    "umbmark",
    "watch",
]

_MODULES = (
    "wheel_drive", "wheels", "squares", "loop_check", "mount", "base", "board", "views", "live_views", "camera_model",
    "cameras",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    return public_name(__name__, name, __all__, _MODULES)
