"""The camera that a CameraInfo describes."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray, PinholeCamera
from wheelsight.recordings.rosbag.definitions import are_measured

_BROWN = ("plumb_bob", "radtan", "")
_RATIONAL = "rational_polynomial"
_GRID = 25


def camera_of(info: Any, is_rectified: bool, lens_px: float) -> tuple[PinholeCamera, str | None]:
    """Intrinsics and Brown's distortion of an image, and a sentence where these do not quite fit.

    Args:
        info: the message, of ROS 1 or ROS 2.
        is_rectified: whether the image was undistorted: then P tells, and there is no distortion.
        lens_px: how far five coefficients may miss what eight describe.

    Raises:
        CalibrationError: the camera was not calibrated, or its lens is of another kind.
    """
    names = {name.lower(): name for name in ("D", "K", "P")} if hasattr(info, "K") else {n: n for n in "dkp"}
    D, K, P = (np.asarray(getattr(info, names[name]), float) for name in "dkp")
    if not are_measured((*D, *K, *P)):
        raise CalibrationError("its CameraInfo holds what is no number of a camera", fix="give one with --camera")
    known = P.reshape(3, 4)[:, :3] if is_rectified and P.any() else K.reshape(3, 3)
    if not known[0, 0] > 0:
        raise CalibrationError("its CameraInfo is all zero: it was not calibrated", fix="give one with --camera")
    size, lens = _pixels(info, known)
    if is_rectified or not D.any():
        return PinholeCamera(*size, *lens), None
    model = str(info.distortion_model)
    if model in _BROWN and len(D) <= 5:
        k1, k2, p1, p2, k3 = (*D.tolist(), 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
        return PinholeCamera(*size, *lens, (k1, k2, p1, p2, k3)), None
    if model not in (_RATIONAL, *_BROWN):
        problem = f"its lens is described as {model!r}, which is no pinhole camera's"
        raise CalibrationError(problem, fix="record the rectified image too, or give a camera with --camera")
    return _nearest(PinholeCamera(*size, *lens), D, lens_px)


def _pixels(info: Any, K: FloatArray) -> tuple[tuple[int, int], tuple[float, float, float, float]]:
    """Size and fx, fy, cx, cy of the image as it was sent: a region of the sensor, of pixels joined to larger ones."""
    across, down = max(int(info.binning_x), 1), max(int(info.binning_y), 1)
    region = info.roi
    width, height = int(region.width) or int(info.width), int(region.height) or int(info.height)
    left, top = (int(region.x_offset), int(region.y_offset)) if region.width else (0, 0)
    cx, cy = (K[0, 2] - left + 0.5) / across - 0.5, (K[1, 2] - top + 0.5) / down - 0.5
    return (width // across, height // down), (float(K[0, 0] / across), float(K[1, 1] / down), float(cx), float(cy))


@np.errstate(all="ignore")  # of numbers that describe no lens
def _nearest(camera: PinholeCamera, D: FloatArray, lens_px: float) -> tuple[PinholeCamera, str | None]:
    """Brown's five coefficients nearest to OpenCV's eight over the image; they are linear in where a point goes."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(D, (0, max(0, 8 - len(D))))[:8]
    u, v = (np.linspace(0, side - 1, _GRID) for side in (camera.width, camera.height))
    x, y = np.meshgrid((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
    r2 = x**2 + y**2
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    wanted_x = x * (radial - 1) + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    wanted_y = y * (radial - 1) + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    columns_x = (x * r2, x * r2**2, 2 * x * y, r2 + 2 * x**2, x * r2**3)
    columns_y = (y * r2, y * r2**2, r2 + 2 * y**2, 2 * x * y, y * r2**3)
    A = np.stack([np.concatenate([a, b]).ravel() for a, b in zip(columns_x, columns_y, strict=True)], axis=1)
    wanted = np.concatenate([wanted_x, wanted_y]).ravel()
    if not (np.isfinite(A).all() and np.isfinite(wanted).all()):
        raise CalibrationError("its CameraInfo describes no lens", fix="give one with --camera")
    found = np.linalg.lstsq(A, wanted, rcond=None)[0]
    worst_px = float(np.abs(A @ found - wanted).max() * max(camera.fx, camera.fy))
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    f1, f2, f3, f4, f5 = found.tolist()
    fitted = PinholeCamera(camera.width, camera.height, *lens, (f1, f2, f3, f4, f5))
    if worst_px <= lens_px:
        return fitted, None
    return fitted, f"five coefficients miss the lens that CameraInfo describes by eight by up to {worst_px:.1f} px"
