"""Calibrations that a camera's kind tells, where the device tells none: good until it is calibrated."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from wheelsight.calibration import Calibration, DepthNoise
from wheelsight.geometry import PinholeCamera
from wheelsight.recordings import load_camera

# Chosen, no measurement: of a lens that nobody measured, where that of the 7-Scenes' Kinect, fitted, has 2.
_NOMINAL_SIGMA_PX = 5.0
# Kinect v2: what one device tells of itself, as its owners publish it, rounded; another's differs.
_V2_DEPTH = PinholeCamera(512, 424, 365.0, 365.0, 256.0, 206.0, (0.09, -0.27, 0.0, 0.0, 0.095))
_V2_COLOR = PinholeCamera(1920, 1080, 1081.0, 1081.0, 959.5, 539.5)
_V2_BASELINE_M = 0.052
# The axial noise of Fankhauser et al., ICAR 2015, at normal incidence, 1.3 mm at 1 m and 4.3 mm at 4 m, by these two
# terms; the maker names 0.5 to 4.5 m reliable.
_V2_NOISE = DepthNoise(constant_m=0.0011, quadratic_per_m=0.0002, near_m=0.5, far_m=4.5)


def structured_light(
    color: tuple[int, int],
    depth: tuple[int, int],
    color_view: float | None,
    depth_view: float | None,
    *,
    is_registered: bool,
) -> Calibration:
    """Of a camera of PrimeSense's kind: Kinect v1, Xtion.

    Args:
        color, depth: width and height of the images.
        color_view, depth_view: horizontal fields of view, radians; None for a Kinect v1's.
        is_registered: whether depth comes on colour's pixels.
    """
    known = load_camera("seven_scenes")
    color_of, depth_of = known.cameras
    color_camera = _by_view(color, color_view) if color_view else _scaled(color_of, color)
    depth_camera = _by_view(depth, depth_view) if depth_view else _scaled(depth_of, depth)
    how = "the field of view it tells" if color_view else "a Kinect v1's nominal values"
    common: dict[str, Any] = {
        "source": f"{how}; nothing was calibrated",
        "color_sigma_px": _NOMINAL_SIGMA_PX * color[0] / 640,
        "rolling_shutter_s": known.rolling_shutter_s,
        "depth_noise": known.depth_noise,
    }
    if is_registered:
        return Calibration.registered_camera(color_camera, **common)
    return Calibration(color_camera, depth_camera, known.T_color_depth, **common)


def kinect_v2() -> Calibration:
    """Of a Kinect v2: depth 512×424 by time of flight, colour 1920×1080 beside it."""
    T_color_depth = np.eye(4)
    T_color_depth[0, 3] = -_V2_BASELINE_M
    return Calibration(
        _V2_COLOR,
        _V2_DEPTH,
        T_color_depth,
        source="nominal values of a Kinect v2; nothing was calibrated",
        color_sigma_px=3 * _NOMINAL_SIGMA_PX,
        depth_noise=_V2_NOISE,
    )


def _by_view(size: tuple[int, int], view: float) -> PinholeCamera:
    width, height = size
    focal_px = width / 2 / math.tan(view / 2)
    return PinholeCamera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)


def _scaled(camera: PinholeCamera, size: tuple[int, int]) -> PinholeCamera:
    """The same lens on an image of another size, cut off below or above where its shape differs."""
    share = size[0] / camera.width
    focal_px = camera.fx * share
    return PinholeCamera(*size, focal_px, focal_px, (size[0] - 1) / 2, (size[1] - 1) / 2)
