"""What an Azure Kinect's calibration attachment says, and its depth laid onto its colour's pixels by that.

Its lenses have eight coefficients, more than `PinholeCamera` has: colour is straightened, and depth registered to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np

from wheelsight.calibration import Calibration, DepthNoise
from wheelsight.errors import CalibrationError
from wheelsight.geometry import ByteArray, Float32Array, FloatArray, IntArray, PinholeCamera, se3
from wheelsight.geometry.arrays import UInt16Array


class _Mode(NamedTuple):
    """The sensor's image scaled to `sensor` pixels, of which `size` are cut out from `corner` on."""

    sensor: tuple[int, int]
    corner: tuple[int, int]
    size: tuple[int, int]


# From the maker's SDK (MIT), mode_specific_calibration.c.
_DEPTH_MODES = {
    "NFOV_2X2BINNED": _Mode((512, 512), (96, 90), (320, 288)),
    "NFOV_UNBINNED": _Mode((1024, 1024), (192, 180), (640, 576)),
    "WFOV_2X2BINNED": _Mode((512, 512), (0, 0), (512, 512)),
    "WFOV_UNBINNED": _Mode((1024, 1024), (0, 0), (1024, 1024)),
}
# In metres, from the maker's data sheet: what it names for 15 to 95 % of reflectance.
_RANGES_M = {
    "NFOV_2X2BINNED": (0.5, 5.46),
    "NFOV_UNBINNED": (0.5, 3.86),
    "WFOV_2X2BINNED": (0.25, 2.88),
    "WFOV_UNBINNED": (0.25, 2.21),
}
_COLOR_MODES = {
    (1280, 720): _Mode((1280, 960), (0, 120), (1280, 720)),
    (1920, 1080): _Mode((1920, 1440), (0, 180), (1920, 1080)),
    (2560, 1440): _Mode((2560, 1920), (0, 240), (2560, 1440)),
    (2048, 1536): _Mode((2048, 1536), (0, 0), (2048, 1536)),
    (3840, 2160): _Mode((3840, 2880), (0, 360), (3840, 2160)),
    (4096, 3072): _Mode((4096, 3072), (0, 0), (4096, 3072)),
}
_MODEL, _PARAMETERS = "CALIBRATION_LensDistortionModelBrownConrady", 14
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-9)
# Focal lengths are in widths of the image, 0.2 to 1; coefficients of the camera's lenses are below 100.
_MOST_PARAMETER, _LEAST_FOCAL = 1e4, 0.01
# Beyond what a lens shows, undistorting finds nothing; where it does, it is right to far less than this.
_CONVERGED_PX = 0.05
_FAR_M = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """A camera of the attachment in one mode: K (3, 3), OpenCV's eight coefficients, size, and its place.

    Attributes:
        reach: distance from the axis on the plane z = 1 up to which the coefficients hold.
        T_camera_device: (4, 4); the device's frame is the depth camera's.
    """

    K: FloatArray
    coefficients: FloatArray
    size: tuple[int, int]
    reach: float
    T_camera_device: FloatArray


def read_lenses(document: Any, depth_mode: str, color_size: tuple[int, int]) -> tuple[Lens, Lens]:
    """Colour and depth camera of a recording in these modes. Raises CalibrationError naming what is missing."""
    if depth_mode not in _DEPTH_MODES:
        raise CalibrationError(f"depth mode {depth_mode} measures no depth", fix=f"record {', '.join(_DEPTH_MODES)}")
    if color_size not in _COLOR_MODES:
        raise CalibrationError(f"colour images of {color_size[0]}×{color_size[1]} are none of the camera's")
    try:
        cameras = document["CalibrationInformation"]["Cameras"]
        by_place = {camera["Location"]: camera for camera in cameras}
        color = _lens(by_place["CALIBRATION_CameraLocationPV0"], _COLOR_MODES[color_size])
        return color, _lens(by_place["CALIBRATION_CameraLocationD0"], _DEPTH_MODES[depth_mode])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError) as error:
        raise CalibrationError(f"the calibration in it cannot be read: {error!r}") from error


def _lens(camera: Any, mode: _Mode) -> Lens:
    intrinsics = camera["Intrinsics"]
    parameters = np.array(intrinsics["ModelParameters"], float)
    if intrinsics["ModelType"] != _MODEL or parameters.shape != (_PARAMETERS,):
        raise ValueError(f"lens model {intrinsics['ModelType']} of {parameters.size} numbers")
    if not (np.abs(parameters) <= _MOST_PARAMETER).all() or parameters[2:4].min() <= _LEAST_FOCAL:
        raise ValueError("numbers that are no lens's")
    aspect = camera["SensorWidth"] / camera["SensorHeight"]
    if abs(aspect - mode.sensor[0] / mode.sensor[1]) > 1e-3:
        raise ValueError(f"a sensor of {camera['SensorWidth']}×{camera['SensorHeight']}")
    cx, cy, fx, fy = parameters[:4] * np.tile(mode.sensor, 2)
    # The attachment counts from the image's corner, OpenCV and we from the first pixel's middle.
    cx, cy = cx - mode.corner[0] - 0.5, cy - mode.corner[1] - 0.5
    k1, k2, k3, k4, k5, k6, _, _, p2, p1 = parameters[4:]
    T_camera_device = np.eye(4)
    T_camera_device[:3, :3] = np.reshape(camera["Rt"]["Rotation"], (3, 3))
    T_camera_device[:3, 3] = camera["Rt"]["Translation"]
    if wrong := se3.why_invalid(T_camera_device, tolerance=1e-4):
        raise ValueError(wrong[0])
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    reach = float(camera["MetricRadius"]) or np.inf
    if not reach > 0:
        raise ValueError(f"a lens that reaches {reach}")
    return Lens(K, np.array([k1, k2, p1, p2, k3, k4, k5, k6]), mode.size, reach, T_camera_device)


class Registration:
    """Straightens colour, and lays depth onto its pixels.

    A depth pixel covers more than one of colour's; each is taken as four quarters of one depth, so that a surface has
    no holes, and where several fall on a pixel the nearest counts, as it hides the others.
    """

    def __init__(self, color: Lens, depth: Lens) -> None:
        self._color, self._depth = color, depth
        width, height = color.size
        self._map_u, self._map_v = cv2.initUndistortRectifyMap(
            color.K, color.coefficients, np.eye(3), color.K, (width, height), cv2.CV_32FC1
        )
        T_color_depth = se3.compose(color.T_camera_device, se3.invert(depth.T_camera_device))
        self._rays: Float32Array = (_quarter_rays(depth) @ T_color_depth[:3, :3].T).astype(np.float32)
        self._t: Float32Array = T_color_depth[:3, 3].astype(np.float32)

    def calibration(self, depth_mode: str, serial: str) -> Calibration:
        """Of the images that come out."""
        (fx, _, cx), (_, fy, cy), _ = self._color.K.tolist()
        camera = PinholeCamera(*self._color.size, fx, fy, cx, cy)
        near_m, far_m = _RANGES_M[depth_mode]
        noise = DepthNoise(near_m=near_m, far_m=far_m)
        source = f"the calibration in the recording, of the Azure Kinect {serial}"
        return Calibration.registered_camera(camera, depth_noise=noise, source=source)

    def straightened(self, color: ByteArray) -> ByteArray:
        """The colour image without its lens' distortion; what the lens did not see repeats the border."""
        done = cv2.remap(color, self._map_u, self._map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(done, np.uint8)

    def registered(self, depth_mm: UInt16Array) -> Float32Array:
        """Depth in metres along colour's axis on the straightened colour's pixels, 0 where nothing was measured."""
        width, height = self._color.size
        z_m = np.repeat(np.repeat(depth_mm, 2, axis=0), 2, axis=1).reshape(-1) * np.float32(1e-3)
        is_seen = (z_m > 0) & np.isfinite(self._rays[:, 2])
        p_color = self._rays[is_seen] * z_m[is_seen, None] + self._t
        fx, fy, cx, cy = self._color.K[[0, 1, 0, 1], [0, 1, 2, 2]].astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.rint(fx * p_color[:, 0] / p_color[:, 2] + cx)
            v = np.rint(fy * p_color[:, 1] / p_color[:, 2] + cy)
        inside = (p_color[:, 2] > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        index: IntArray = (v[inside] * width + u[inside]).astype(np.int64)
        nearest = np.full(width * height, _FAR_M, np.float32)
        np.minimum.at(nearest, index, p_color[inside, 2])
        nearest[nearest >= _FAR_M] = 0
        return nearest.reshape(height, width)


def _quarter_rays(depth: Lens) -> FloatArray:
    """Directions (4·H·W, 3) with z = 1 of the quarters of depth pixels, row by row; NaN beyond the lens' reach."""
    width, height = depth.size
    u, v = np.meshgrid(np.arange(2 * width) / 2 - 0.25, np.arange(2 * height) / 2 - 0.25)
    px = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    if hasattr(cv2, "undistortPointsIter"):  # before OpenCV 5
        undistorted = cv2.undistortPointsIter(px, depth.K, depth.coefficients, None, None, _UNDISTORT)
    else:
        undistorted = cv2.undistortPoints(px, depth.K, depth.coefficients, criteria=_UNDISTORT)
    xy: FloatArray = np.asarray(undistorted, float).reshape(-1, 2)
    focal_px, middle = depth.K[[0, 1], [0, 1]], depth.K[:2, 2]
    off_px = np.abs(_distorted(xy, depth.coefficients) * focal_px + middle - px.reshape(-1, 2)).max(axis=1)
    is_beyond = (off_px > _CONVERGED_PX) | (np.linalg.norm(xy, axis=1) > depth.reach)
    rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    rays[is_beyond] = np.nan
    return rays


def _distorted(xy: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Where a lens shows points (N, 2) of the plane z = 1; OpenCV's also takes derivatives, and seconds."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = xy.T
    r2 = x**2 + y**2
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    moved = (2 * p1 * x * y + p2 * (r2 + 2 * x**2), p1 * (r2 + 2 * y**2) + 2 * p2 * x * y)
    return np.stack([x * radial + moved[0], y * radial + moved[1]], axis=1)
