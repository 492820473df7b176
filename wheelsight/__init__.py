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
    from wheelsight.areas import AreaMap, load_areas, save_areas
    from wheelsight.calibration import (
        Calibration,
        Gyro,
        HolonomicWheels,
        Wheels,
        load_calibration,
        save_calibration,
    )
    from wheelsight.clocks import ClockSettings, SessionClock
    from wheelsight.config import Config, load_config, save_config
    from wheelsight.errors import WheelsightError
    from wheelsight.estimates import CameraEstimate, Estimate, MotionEstimate, Reason, Status
    from wheelsight.evaluation import Evaluation, evaluate
    from wheelsight.events import (
        Event,
        OdometryReading,
        RgbdFrame,
        SkippedFrame,
        WheelCounts,
        WheelSpeeds,
        WheelTicks,
        YawRate,
    )
    from wheelsight.fusion import ErrorStateFilter, ErrorStateSettings, FusedEstimate, LigockiFilter, LigockiSettings
    from wheelsight.geometry import PinholeCamera
    from wheelsight.keyframes import Keyframe, KeyframeId, KeyframeStore
    from wheelsight.localizer import Localizer
    from wheelsight.mapping import (
        OccupancyGrid,
        OccupancyMapper,
        OccupancySettings,
        SurfelMap,
        SurfelSettings,
        load_map,
        mesh_of,
        save_map,
        write_mesh_ply,
        write_ply,
    )
    from wheelsight.odometry.dense import DenseOdometry, DenseSettings
    from wheelsight.odometry.features import FeatureOdometry, FeatureSettings
    from wheelsight.odometry.own import VisualOdometry
    from wheelsight.odometry.wheels import HolonomicOdometry, WheelOdometry
    from wheelsight.places import PlaceMatch, PlaceModel
    from wheelsight.recordings import OpenOptions, Recording, open_recording, write_recording
    from wheelsight.runs import run, run_each
    from wheelsight.simulation import SimulatedRecording, SimulationSettings, write_simulation
    from wheelsight.simulation.simulate import simulate
    from wheelsight.slam.recognised import LoopDetector
    from wheelsight.sources import EventSource
    from wheelsight.trajectory import Trajectory, read_kitti, read_tum, write_kitti, write_tum
    from wheelsight.views import PredictedView, ReferenceModel

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
    "areas": ("AreaMap", "load_areas", "save_areas"),
    "calibration": ("Calibration", "Gyro", "HolonomicWheels", "Wheels", "load_calibration", "save_calibration"),
    "clocks": ("ClockSettings", "SessionClock"),
    "config": ("Config", "load_config", "save_config"),
    "errors": ("WheelsightError",),
    "estimates": ("CameraEstimate", "Estimate", "MotionEstimate", "Reason", "Status"),
    "evaluation": ("Evaluation", "evaluate"),
    "events": (
        *("Event", "OdometryReading", "RgbdFrame", "SkippedFrame"),
        *("WheelCounts", "WheelSpeeds", "WheelTicks", "YawRate"),
    ),
    "fusion": ("ErrorStateFilter", "ErrorStateSettings", "FusedEstimate", "LigockiFilter", "LigockiSettings"),
    "geometry": ("PinholeCamera",),
    "keyframes": ("Keyframe", "KeyframeId", "KeyframeStore"),
    "localizer": ("Localizer",),
    "mapping": (
        *("OccupancyGrid", "OccupancyMapper", "OccupancySettings"),
        *("SurfelMap", "SurfelSettings", "load_map", "mesh_of", "save_map", "write_mesh_ply", "write_ply"),
    ),
    "odometry.dense": ("DenseOdometry", "DenseSettings"),
    "odometry.features": ("FeatureOdometry", "FeatureSettings"),
    "odometry.own": ("VisualOdometry",),
    "odometry.wheels": ("HolonomicOdometry", "WheelOdometry"),
    "places": ("PlaceMatch", "PlaceModel"),
    "recordings": ("OpenOptions", "Recording", "open_recording", "write_recording"),
    "sources": ("EventSource",),
    "runs": ("run", "run_each"),
    "slam.recognised": ("LoopDetector",),
    "simulation": ("SimulatedRecording", "SimulationSettings", "simulate", "write_simulation"),
    "trajectory": ("Trajectory", "read_kitti", "read_tum", "write_kitti", "write_tum"),
    "views": ("PredictedView", "ReferenceModel"),
}
# A program that wants the library's records gives this logger a handler; without one nothing is printed.
logging.getLogger(__name__).addHandler(logging.NullHandler())
_MODULE_OF = {name: module for module, names in _NAMES_OF.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'wheelsight' has no attribute {name!r}")
    return getattr(import_module(f"wheelsight.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
