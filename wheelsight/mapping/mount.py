"""Where a robot's camera sits over the floor: who makes maps of the floor cannot do without."""

from __future__ import annotations

from wheelsight.calibration import Calibration
from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray


def camera_over_floor(calibration: Calibration) -> FloatArray:
    """T_base_camera (4, 4). Raises MapError where the calibration does not say it."""
    if calibration.T_base_camera is None:
        problem = "where the floor is nobody knows: the calibration does not say where the camera sits"
        raise MapError(problem, fix="wheelsight calibrate base, or T_base_camera in the calibration")
    return calibration.T_base_camera
