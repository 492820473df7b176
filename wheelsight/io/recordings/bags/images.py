"""Image and CameraInfo messages: colour as RGB bytes, depth in metres, and the `PinholeCamera` that a CameraInfo
describes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.geometry import MOST_PIXELS, ByteArray, Float32Array, FloatArray, PinholeCamera
from wheelsight.core.geometry.camera import fitted_lens
from wheelsight.io.recordings.bags.chunks import are_measured
from wheelsight.io.recordings.images import DepthEncoding, check_scale, decoded_color, decoded_units, depth_of_units

_Pixels = NDArray[Any]
_MILLIMETRES = 1000.0
_DEPTH: dict[str, type[np.generic]] = {"16uc1": np.uint16, "mono16": np.uint16, "z16": np.uint16, "32fc1": np.float32}


def _by(code: int) -> Callable[[_Pixels], _Pixels]:
    return lambda pixels: np.asarray(cv2.cvtColor(pixels, code))


_GREY, _BGR = _by(cv2.COLOR_GRAY2RGB), _by(cv2.COLOR_BGR2RGB)
_COLOR: dict[str, tuple[int, Callable[[_Pixels], _Pixels]]] = {
    "rgb": (3, lambda pixels: pixels),
    "bgr": (3, _BGR),
    "rgba": (4, _by(cv2.COLOR_RGBA2RGB)),
    "bgra": (4, _by(cv2.COLOR_BGRA2RGB)),
    "mono": (1, _GREY),
    # OpenCV names a Bayer pattern by the second and third pixel of its second row, ROS by its first two rows.
    "bayer_rggb": (1, _by(cv2.COLOR_BayerBG2RGB)),
    "bayer_bggr": (1, _by(cv2.COLOR_BayerRG2RGB)),
    "bayer_gbrg": (1, _by(cv2.COLOR_BayerGR2RGB)),
    "bayer_grbg": (1, _by(cv2.COLOR_BayerGB2RGB)),
}
# The pixel type and channels of an encoding, and its conversion to RGB.
_LAYOUTS: dict[str, tuple[type[np.generic], int, Callable[[_Pixels], _Pixels]]] = {
    f"{name}{bits}": (dtype, channels, to_rgb)
    for name, (channels, to_rgb) in _COLOR.items()
    for bits, dtype in ((8, np.uint8), (16, np.uint16))
} | {
    "8uc1": (np.uint8, 1, _GREY),
    "8uc3": (np.uint8, 3, _BGR),
    "8uc4": (np.uint8, 4, _by(cv2.COLOR_BGRA2RGB)),
    "16uc1": (np.uint16, 1, _GREY),
    "16uc3": (np.uint16, 3, _BGR),
    **dict.fromkeys(("yuv422", "uyvy"), (np.uint8, 2, _by(cv2.COLOR_YUV2RGB_UYVY))),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (np.uint8, 2, _by(cv2.COLOR_YUV2RGB_YUY2))),
}


def color_of(message: Any, path: Path) -> ByteArray:
    """The colour image (H, W, 3) of an Image or CompressedImage. Raises RecordingError naming the bag."""
    if hasattr(message, "format"):
        return decoded_color(bytes(message.data), path)
    layout = _LAYOUTS.get(message.encoding.lower())
    if layout is None:
        problem = f"colour images are encoded as {message.encoding!r}"
        raise RecordingError(problem, path=path, fix=f"known: {', '.join(sorted(_LAYOUTS))}")
    dtype, channels, to_rgb = layout
    rgb = to_rgb(_pixels(message, dtype, channels, path))
    return np.asarray(rgb if rgb.dtype == np.uint8 else rgb >> 8, np.uint8)


def depth_of(message: Any, factor: float | None, path: Path) -> Float32Array:
    """The depth image (H, W) in metres of an Image or CompressedImage, 0 where there is no measurement.

    Args:
        message: of integers in millimetres, or floats in metres.
        factor: units per metre, where it differs from that.

    Raises:
        RecordingError: the encoding is unknown, there is no depth at all, or its scale is implausible.
    """
    if hasattr(message, "format"):
        # compressedDepth has 12 bytes before its PNG: the format, and parameters a, b of the quantization of floats to
        # integers n, z = a / (n - b), which has the resolution of disparities (image_transport_plugins).
        data = bytes(message.data)
        start = data.find(b"\x89PNG", 0, 64)
        if start < 0:
            way = "RVL" if "rvl" in message.format.lower() else repr(message.format)
            raise RecordingError(f"depth images are compressed as {way}", path=path, fix="record them raw, or as PNG")
        raw = decoded_units(data[start:], path)
        if message.format.lower().startswith("32fc1"):
            if start < 12:
                raise RecordingError("compressed depth lacks its scale", path=path, fix="record it raw")
            a, b = struct.unpack_from("<ff", data, start - 8)
            above = raw.astype(np.float32) - np.float32(b)
            out = np.zeros(raw.shape, np.float32)
            raw = np.divide(np.float32(a), above, out=out, where=(raw > 0) & (above > 0))
    else:
        dtype = _DEPTH.get(message.encoding.lower())
        if dtype is None:
            problem = f"depth images are encoded as {message.encoding!r}"
            raise RecordingError(problem, path=path, fix="16UC1 in millimetres or 32FC1 in metres is read")
        raw = _pixels(message, dtype, 1, path)
    if raw.dtype != np.float32:
        return depth_of_units(raw, DepthEncoding(factor or _MILLIMETRES), path)
    with np.errstate(invalid="ignore", over="ignore"):  # damaged messages have NaN or infinite numbers
        scaled_m = raw / np.float32(factor or 1.0)
        depth_m = np.where((scaled_m > 0) & np.isfinite(scaled_m), scaled_m, np.float32(0))
    check_scale(depth_m, path)
    return depth_m


def is_depth(encoding: str, topic: str) -> bool:
    """Whether images are depth, by encoding and topic name; infrared has the same encodings."""
    words = topic.lower()
    if "compresseddepth" in encoding.lower() or words.endswith("compresseddepth"):
        return True
    first = encoding.lower().split(";")[0].strip()
    if first not in _DEPTH or any(word in words for word in ("/ir", "infra", "confidence", "disparity")):
        return False
    return first != "mono16" or "depth" in words


def _pixels(message: Any, dtype: type[np.generic], channels: int, path: Path) -> _Pixels:
    """The pixels (H, W) or (H, W, channels) of an Image, without padding of rows. Raises RecordingError."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * np.dtype(dtype).itemsize
    data = np.asarray(message.data, np.uint8)
    if not 0 < height * width <= MOST_PIXELS or step < row or len(data) < step * height:
        problem = (
            f"an image says it is {width}×{height} {message.encoding} in rows of {step} bytes, and has {len(data)}"
        )
        raise RecordingError(problem, path=path, fix="check the camera's driver")
    rows = data[: step * height].reshape(height, step)[:, :row]
    pixels = np.ascontiguousarray(rows).view(np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<"))
    native = pixels.astype(dtype) if np.dtype(dtype).itemsize > 1 else pixels
    return native.reshape((height, width) if channels == 1 else (height, width, channels))


_BROWN = ("plumb_bob", "radtan", "")
_RATIONAL = "rational_polynomial"
# Names of lens models in the RealSense SDK.
_BROWN_OF_SDK, _INVERSE = ("brown conrady", "modified brown conrady"), "inverse brown conrady"
_GRID = 25
_LENS_PX = 0.5  # largest error without a warning of five coefficients for a lens of eight, anywhere in the image
# Largest error of an inverted point, steps from the centre to each point, Newton's iterations and derivative step.
_INVERSE_PX, _INVERSE_STEPS, _NEWTON_STEPS, _DERIVATIVE_STEP = 0.01, 20, 4, 1e-6
_WIDEST = 2.0  # distance on the plane z = 1, 63° off the axis; polynomials do not fit wider lenses
_LEAST_SHOWN = 0.5  # share of the image that must map to a point


def camera_of(info: Any, is_rectified: bool) -> tuple[PinholeCamera, str | None]:
    """The camera with Brown's distortion, and a warning where that does not fit the lens well.

    Args:
        info: the message, of ROS 1 or ROS 2.
        is_rectified: whether the image is undistorted; P is then used, without distortion.

    Raises:
        CalibrationError: the camera is not calibrated, or has another lens model.
    """
    names = {name.lower(): name for name in ("D", "K", "P")} if hasattr(info, "K") else {n: n for n in "dkp"}
    D, K, P = (np.asarray(getattr(info, names[name]), float) for name in "dkp")
    if not are_measured((*D, *K, *P)):
        raise CalibrationError("its CameraInfo holds an invalid number", fix="give one with --camera")
    known = P.reshape(3, 4)[:, :3] if is_rectified and P.any() else K.reshape(3, 3)
    if not known[0, 0] > 0:
        raise CalibrationError("its CameraInfo is all zero: it was not calibrated", fix="give one with --camera")
    # The image may be a region of the sensor, with binned pixels.
    across, down = max(int(info.binning_x), 1), max(int(info.binning_y), 1)
    region = info.roi
    width, height = int(region.width) or int(info.width), int(region.height) or int(info.height)
    left, top = (int(region.x_offset), int(region.y_offset)) if region.width else (0, 0)
    cx, cy = (known[0, 2] - left + 0.5) / across - 0.5, (known[1, 2] - top + 0.5) / down - 0.5
    size = (width // across, height // down)
    lens = (float(known[0, 0] / across), float(known[1, 1] / down), float(cx), float(cy))
    if is_rectified or not D.any():
        return PinholeCamera(*size, *lens), None
    model = str(info.distortion_model)
    if model.lower() == _INVERSE and len(D) == 5:
        # Inverse coefficients map image to ray.
        camera = PinholeCamera(*size, *lens, tuple(D.tolist()))
        u, v = np.meshgrid(*(np.linspace(0, side - 1, _GRID) for side in (camera.width, camera.height)))
        seen = (np.stack([u.ravel(), v.ravel()], axis=1) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        xy = (camera.denormalise(seen) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        fit = fitted_lens(xy, seen)
        fitted = _checked(replace(camera, distortion=fit.distortion), np.array(fit.distortion))
        if fit.worst * camera.fx <= _LENS_PX:
            return fitted, None
        by = f"{fit.median * camera.fx:.2f} px in the median, and by {fit.worst * camera.fx:.1f} px at worst"
        return fitted, f"five coefficients miss the lens that is described from image to ray by {by}"
    if (model in _BROWN or model.lower() in _BROWN_OF_SDK) and len(D) <= 5:
        k1, k2, p1, p2, k3 = (*D.tolist(), 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
        return _checked(PinholeCamera(*size, *lens, (k1, k2, p1, p2, k3)), D), None
    if model not in (_RATIONAL, *_BROWN):
        problem = f"its lens is described as {model!r}, which is no pinhole camera's"
        raise CalibrationError(problem, fix="record the rectified image too, or give a camera with --camera")
    return _nearest(PinholeCamera(*size, *lens), D)


@np.errstate(all="ignore")  # invalid coefficients overflow
def _nearest(camera: PinholeCamera, D: FloatArray) -> tuple[PinholeCamera, str | None]:
    """The camera with Brown's five coefficients nearest to OpenCV's eight over valid pixels, and a warning or None."""
    D = np.pad(D, (0, max(0, 8 - len(D))))[:8]
    u, v = np.meshgrid(*(np.linspace(0, side - 1, _GRID) for side in (camera.width, camera.height)))
    px = np.stack([u.ravel(), v.ravel()], axis=1)
    seen = (px - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    xy = _undistorted(seen, D)
    off_px = np.linalg.norm(_rational(xy, D) - seen, axis=1) * max(camera.fx, camera.fy)
    # In the corners eight coefficients often have a pole, where no point maps to the pixel.
    shown = np.isfinite(off_px) & (off_px < _INVERSE_PX) & (np.linalg.norm(xy, axis=1) < _WIDEST)
    if shown.mean() < _LEAST_SHOWN:
        problem = f"its distortion {_numbers(D)} describes no lens"
        nothing = f"{100 * (1 - shown.mean()):.0f} % of the image show no point"
        raise CalibrationError(f"{problem}: {nothing}", fix="give one with --camera")
    fit = fitted_lens(xy[shown], seen[shown])
    fitted = replace(camera, distortion=fit.distortion)
    missed = (fitted.denormalise(xy[shown]) - px[shown]) if fitted.has_distortion else np.zeros((1, 2))
    missed_px = np.linalg.norm(missed, axis=1)
    share = float((missed_px > _LENS_PX).mean())
    if not share:
        return fitted, None
    by = f"{np.median(missed_px):.2f} px in the median, and by more than {_LENS_PX:g} px in {100 * share:.0f} %"
    return fitted, f"five coefficients miss the lens that CameraInfo describes by eight by {by} of the image"


def _undistorted(seen: FloatArray, D: FloatArray) -> FloatArray:
    """The undistorted points (N, 2) of distorted ones (N, 2) on the plane z = 1.

    Newton's method follows each point outwards from the centre. It therefore stays on the branch of the centre, inside
    any fold or pole.
    """
    xy = np.zeros_like(seen)
    steps = np.eye(2) * _DERIVATIVE_STEP
    for share in np.linspace(0, 1, _INVERSE_STEPS + 1)[1:]:
        for _ in range(_NEWTON_STEPS):
            off = _rational(xy, D) - share * seen
            (a, c), (b, d) = (((_rational(xy + h, D) - _rational(xy - h, D)) / (2 * _DERIVATIVE_STEP)).T for h in steps)
            by = np.stack([d * off[:, 0] - b * off[:, 1], a * off[:, 1] - c * off[:, 0]], axis=1)
            xy = xy - by / (a * d - b * c)[:, None]
    return xy


def _rational(xy: FloatArray, D: FloatArray) -> FloatArray:
    """The distorted points (N, 2) of points (N, 2) by OpenCV's eight coefficients, both on the plane z = 1."""
    k1, k2, p1, p2, k3, k4, k5, k6 = D
    x, y = xy.T
    r2 = x**2 + y**2
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    across = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    return np.stack([across, y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y], axis=1)


def _numbers(D: FloatArray) -> str:
    return f"({', '.join(f'{k:.5g}' for k in D)})"


def _checked(camera: PinholeCamera, D: FloatArray) -> PinholeCamera:
    """The camera itself. Raises CalibrationError where its distortion is not that of a lens."""
    fault = camera.lens_fault()
    if fault is not None:
        fix = "calibrate it: wheelsight calibrate camera, and give it by --camera; or record the rectified image"
        raise CalibrationError(f"its distortion {_numbers(D)} {fault}", fix=fix)
    return camera
