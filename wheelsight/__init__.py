"""Where a wheeled robot is and what its place looks like: wheel encoders and a depth camera, joined.

All in one: `run(open_recording(folder), Config(), out)`; `simulate(SimulationSettings())` where there is no recording.
Frame by frame: `Localizer(calibration).process(frame)`. Every step by hand: the sub-packages. The names below are
loaded when first asked for, so `import wheelsight` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from wheelsight._version import __version__

if TYPE_CHECKING:
    from wheelsight.calibration import Calibration, Gyro, Wheels, load_calibration, save_calibration
    from wheelsight.config import Config, load_config, save_config
    from wheelsight.errors import WheelsightError
    from wheelsight.estimates import Estimate, MotionEstimate, Reason, Status
    from wheelsight.evaluation import Evaluation, evaluate
    from wheelsight.events import RgbdFrame, SkippedFrame, WheelSpeeds, WheelTicks, YawRate
    from wheelsight.geometry import PinholeCamera
    from wheelsight.localizer import Localizer
    from wheelsight.odometry.features import FeatureOdometry
    from wheelsight.odometry.wheels import WheelOdometry
    from wheelsight.recordings import OpenOptions, Recording, open_recording, write_recording
    from wheelsight.runs import run, run_each
    from wheelsight.simulation import SimulatedRecording, SimulationSettings, write_simulation
    from wheelsight.simulation.simulate import simulate
    from wheelsight.sources import EventSource
    from wheelsight.trajectory import Trajectory, read_kitti, read_tum, write_kitti, write_tum

__all__ = [
    "Calibration",
    "Config",
    "Estimate",
    "Evaluation",
    "EventSource",
    "FeatureOdometry",
    "Gyro",
    "Localizer",
    "MotionEstimate",
    "OpenOptions",
    "PinholeCamera",
    "Reason",
    "Recording",
    "RgbdFrame",
    "SimulatedRecording",
    "SimulationSettings",
    "SkippedFrame",
    "Status",
    "Trajectory",
    "WheelOdometry",
    "WheelSpeeds",
    "WheelTicks",
    "Wheels",
    "WheelsightError",
    "YawRate",
    "__version__",
    "evaluate",
    "load_calibration",
    "load_config",
    "open_recording",
    "read_kitti",
    "read_tum",
    "run",
    "run_each",
    "save_calibration",
    "save_config",
    "simulate",
    "write_kitti",
    "write_recording",
    "write_simulation",
    "write_tum",
]

_NAMES_OF = {
    "calibration": ("Calibration", "Gyro", "Wheels", "load_calibration", "save_calibration"),
    "config": ("Config", "load_config", "save_config"),
    "errors": ("WheelsightError",),
    "estimates": ("Estimate", "MotionEstimate", "Reason", "Status"),
    "evaluation": ("Evaluation", "evaluate"),
    "events": ("RgbdFrame", "SkippedFrame", "WheelSpeeds", "WheelTicks", "YawRate"),
    "geometry": ("PinholeCamera",),
    "localizer": ("Localizer",),
    "odometry.features": ("FeatureOdometry",),
    "odometry.wheels": ("WheelOdometry",),
    "runs": ("run", "run_each"),
    "recordings": ("OpenOptions", "Recording", "open_recording", "write_recording"),
    "sources": ("EventSource",),
    "simulation": ("SimulatedRecording", "SimulationSettings", "simulate", "write_simulation"),
    "trajectory": ("Trajectory", "read_kitti", "read_tum", "write_kitti", "write_tum"),
}
_MODULE_OF = {name: module for module, names in _NAMES_OF.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'wheelsight' has no attribute {name!r}")
    return getattr(import_module(f"wheelsight.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
