"""Depth images as navigation takes them: of the size that the calibration says."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import ArgumentError
from wheelsight.geometry import Float32Array, PinholeCamera


def checked_depth(depth_m: ArrayLike, camera: PinholeCamera) -> Float32Array:
    """(H, W) metres, contiguous. Raises ArgumentError for an image of another size than the camera's."""
    depth = np.ascontiguousarray(depth_m, np.float32)
    if depth.shape != (camera.height, camera.width):
        fix = f"give {camera.height} rows of {camera.width}, as the calibration says"
        raise ArgumentError(f"a depth image of shape {depth.shape}", fix=fix)
    return depth
