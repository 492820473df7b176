"""Where a wheeled robot is and what its place looks like: wheel encoders and a depth camera, joined.

The names below are loaded when first asked for, so `import wheelsight` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from wheelsight._version import __version__

if TYPE_CHECKING:
    from wheelsight.calibration import Calibration, load_calibration, save_calibration
    from wheelsight.errors import WheelsightError
    from wheelsight.estimates import Estimate, MotionEstimate, Reason, Status
    from wheelsight.events import RgbdFrame, SkippedFrame, WheelTicks
    from wheelsight.geometry import PinholeCamera
    from wheelsight.trajectory import Trajectory

__all__ = [
    "Calibration",
    "Estimate",
    "MotionEstimate",
    "PinholeCamera",
    "Reason",
    "RgbdFrame",
    "SkippedFrame",
    "Status",
    "Trajectory",
    "WheelTicks",
    "WheelsightError",
    "__version__",
    "load_calibration",
    "save_calibration",
]

_NAMES_OF = {
    "calibration": ("Calibration", "load_calibration", "save_calibration"),
    "errors": ("WheelsightError",),
    "estimates": ("Estimate", "MotionEstimate", "Reason", "Status"),
    "events": ("RgbdFrame", "SkippedFrame", "WheelTicks"),
    "geometry": ("PinholeCamera",),
    "trajectory": ("Trajectory",),
}
_MODULE_OF = {name: module for module, names in _NAMES_OF.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'wheelsight' has no attribute {name!r}")
    return getattr(import_module(f"wheelsight.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
