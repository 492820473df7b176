"""Images as an ideal camera takes them, without the lens."""

from __future__ import annotations

import cv2
import numpy as np

from wheelsight.geometry import Float32Array, PinholeCamera


def maps_without_lens(camera: PinholeCamera) -> tuple[Float32Array, Float32Array]:
    """Where (h, w) in a camera's images each pixel of the ideal one is found: its column and row, for `cv2.remap`."""
    size = (camera.width, camera.height)
    maps = cv2.initUndistortRectifyMap(camera.K, np.array(camera.distortion), None, camera.K, size, cv2.CV_32FC1)
    return np.asarray(maps[0], np.float32), np.asarray(maps[1], np.float32)
