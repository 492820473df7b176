"""Where a wheeled robot is and what its place looks like: wheel encoders and a depth camera, joined.

All in one: `run(open_recording(folder), Config(), out)`; `simulate(SimulationSettings())` where there is no recording.
Frame by frame: `Localizer(calibration).process(event)`. Every step by hand: `DenseOdometry`, `ErrorStateFilter`,
`SurfelMap` and the other names below, and the sub-packages. A name is loaded when it is first asked for, so
`import wheelsight` costs next to nothing.
"""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

from wheelsight._version import __version__

if TYPE_CHECKING:
    from wheelsight.app.runs import run, run_each
    from wheelsight.config import Config, load_config, save_config
    from wheelsight.core.areas import AreaMap, load_areas, save_areas
    from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
    from wheelsight.core.calibration_parts import Gyro, HolonomicWheels, Wheels
    from wheelsight.core.checks import ClockSettings, SessionClock
    from wheelsight.core.errors import WheelsightError
    from wheelsight.core.estimates import CameraEstimate, Estimate, MotionEstimate, Reason, Status
    from wheelsight.core.geometry import PinholeCamera
    from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore, PredictedView, ReferenceModel
    from wheelsight.core.messages import (
        Event,
        OdometryReading,
        RgbdFrame,
        SkippedFrame,
        WheelCounts,
        WheelSpeeds,
        WheelTicks,
        YawRate,
    )
    from wheelsight.core.robots import EventSource
    from wheelsight.core.trajectory import Trajectory, read_kitti, read_tum, write_kitti, write_tum
    from wheelsight.estimation import ErrorStateFilter, ErrorStateSettings, FusedEstimate, LigockiSettings, Localizer
    from wheelsight.evaluation import Evaluation, evaluate
    from wheelsight.io.recordings import OpenOptions, Recording, open_recording, write_recording
    from wheelsight.mapping import (
        OccupancyGrid,
        OccupancyMapper,
        OccupancySettings,
        SurfelMap,
        SurfelSettings,
        load_map,
        save_map,
    )
    from wheelsight.places import PlaceMatch, PlaceModel
    from wheelsight.slam.place_recognition import LoopDetector
    from wheelsight.vision.dense import DenseOdometry, DenseSettings
    from wheelsight.vision.features import FeatureOdometry, FeatureSettings
    from wheelsight.vision.visual_odometry import VisualOdometry
    from wheelsight.wheels import HolonomicOdometry, WheelOdometry
    from wheelsight_export import mesh_of, write_mesh_ply, write_ply
    from wheelsight_papers import LigockiFilter
    from wheelsight_sim import SimulatedRecording, SimulationSettings, write_simulation
    from wheelsight_sim.simulate import simulate

__all__ = [
    "AreaMap",
    "Calibration",
    "CameraEstimate",
    "ClockSettings",
    "Config",
    "DenseOdometry",
    "DenseSettings",
    "ErrorStateFilter",
    "ErrorStateSettings",
    "Estimate",
    "Evaluation",
    "Event",
    "EventSource",
    "FeatureOdometry",
    "FeatureSettings",
    "FusedEstimate",
    "Gyro",
    "HolonomicOdometry",
    "HolonomicWheels",
    "Keyframe",
    "KeyframeId",
    "KeyframeStore",
    "LigockiFilter",
    "LigockiSettings",
    "Localizer",
    "LoopDetector",
    "MotionEstimate",
    "OccupancyGrid",
    "OccupancyMapper",
    "OccupancySettings",
    "OdometryReading",
    "OpenOptions",
    "PinholeCamera",
    "PlaceMatch",
    "PlaceModel",
    "PredictedView",
    "Reason",
    "Recording",
    "ReferenceModel",
    "RgbdFrame",
    "SessionClock",
    "SimulatedRecording",
    "SimulationSettings",
    "SkippedFrame",
    "Status",
    "SurfelMap",
    "SurfelSettings",
    "Trajectory",
    "VisualOdometry",
    "WheelCounts",
    "WheelOdometry",
    "WheelSpeeds",
    "WheelTicks",
    "Wheels",
    "WheelsightError",
    "YawRate",
    "__version__",
    "evaluate",
    "load_areas",
    "load_calibration",
    "load_config",
    "load_map",
    "mesh_of",
    "open_recording",
    "read_kitti",
    "read_tum",
    "run",
    "run_each",
    "save_areas",
    "save_calibration",
    "save_config",
    "save_map",
    "simulate",
    "write_kitti",
    "write_mesh_ply",
    "write_ply",
    "write_recording",
    "write_simulation",
    "write_tum",
]

_NAMES_OF = {
    "wheelsight.app.runs": (
        "run",
        "run_each",
    ),
    "wheelsight.config": (
        "Config",
        "load_config",
        "save_config",
    ),
    "wheelsight.core.areas": (
        "AreaMap",
        "load_areas",
        "save_areas",
    ),
    "wheelsight.core.calibration": (
        "Calibration",
        "Gyro",
        "HolonomicWheels",
        "Wheels",
        "load_calibration",
        "save_calibration",
    ),
    "wheelsight.core.checks": (
        "ClockSettings",
        "SessionClock",
    ),
    "wheelsight.core.errors": ("WheelsightError",),
    "wheelsight.core.estimates": (
        "CameraEstimate",
        "Estimate",
        "MotionEstimate",
        "Reason",
        "Status",
    ),
    "wheelsight.core.geometry": ("PinholeCamera",),
    "wheelsight.core.keyframes": (
        "Keyframe",
        "KeyframeId",
        "KeyframeStore",
        "PredictedView",
        "ReferenceModel",
    ),
    "wheelsight.core.messages": (
        "Event",
        "OdometryReading",
        "RgbdFrame",
        "SkippedFrame",
        "WheelCounts",
        "WheelSpeeds",
        "WheelTicks",
        "YawRate",
    ),
    "wheelsight.core.robots": ("EventSource",),
    "wheelsight.core.trajectory": (
        "Trajectory",
        "read_kitti",
        "read_tum",
        "write_kitti",
        "write_tum",
    ),
    "wheelsight.estimation": (
        "ErrorStateFilter",
        "ErrorStateSettings",
        "FusedEstimate",
        "LigockiSettings",
        "Localizer",
    ),
    "wheelsight.evaluation": (
        "Evaluation",
        "evaluate",
    ),
    "wheelsight.io.recordings": (
        "OpenOptions",
        "Recording",
        "open_recording",
        "write_recording",
    ),
    "wheelsight.mapping": (
        "OccupancyGrid",
        "OccupancyMapper",
        "OccupancySettings",
        "SurfelMap",
        "SurfelSettings",
        "load_map",
        "save_map",
    ),
    "wheelsight.places": (
        "PlaceMatch",
        "PlaceModel",
    ),
    "wheelsight.slam.place_recognition": ("LoopDetector",),
    "wheelsight.vision.dense": (
        "DenseOdometry",
        "DenseSettings",
    ),
    "wheelsight.vision.features": (
        "FeatureOdometry",
        "FeatureSettings",
    ),
    "wheelsight.vision.visual_odometry": ("VisualOdometry",),
    "wheelsight.wheels": (
        "HolonomicOdometry",
        "WheelOdometry",
    ),
    "wheelsight_export": (
        "mesh_of",
        "write_mesh_ply",
        "write_ply",
    ),
    "wheelsight_papers": ("LigockiFilter",),
    "wheelsight_sim": (
        "SimulatedRecording",
        "SimulationSettings",
        "simulate",
        "write_simulation",
    ),
}
# A program that wants the library's records gives this logger a handler; without one nothing is printed.
logging.getLogger(__name__).addHandler(logging.NullHandler())
_MODULE_OF = {name: module for module, names in _NAMES_OF.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'wheelsight' has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return __all__
