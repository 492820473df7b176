"""Readings of a depth camera and where in its image they are taken: what a calibration is judged by."""

from __future__ import annotations

import numpy as np

from wheelsight.depth_error import DepthError
from wheelsight.geometry import FloatArray, PinholeCamera


def reading_m(error: DepthError, reading: FloatArray) -> FloatArray:
    """Readings in metres, still to be corrected, of readings in metres or of raw disparities."""
    if not error.is_of_disparity:
        return reading
    inverse = error.disparity_at_zero_per_m + error.disparity_step_per_m * reading
    return np.asarray(1 / np.maximum(inverse, 1e-3))


def readings_for(error: DepthError, depth_m: FloatArray, px: FloatArray, camera: PinholeCamera) -> FloatArray:
    """Readings that are corrected to about these depths: raw disparities where the error is of them."""
    reading = depth_m.copy()
    for _ in range(5):
        reading = np.maximum(reading + depth_m - error.of_readings(reading, px, camera), 0.05)
    if not error.is_of_disparity:
        return reading
    return np.asarray((1 / reading - error.disparity_at_zero_per_m) / error.disparity_step_per_m)


def grid_px(camera: PinholeCamera, across: int, down: int) -> FloatArray:
    """Pixels (across · down, 2), evenly over a camera's image."""
    u, v = np.meshgrid(
        np.linspace(0.05, 0.95, across) * (camera.width - 1), np.linspace(0.05, 0.95, down) * (camera.height - 1)
    )
    return np.stack([u.ravel(), v.ravel()], axis=-1)
