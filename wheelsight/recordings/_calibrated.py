"""Decoded images as their calibration has them: of its cameras' sizes, depth freed of its errors."""

from __future__ import annotations

from pathlib import Path

from wheelsight.calibration import Calibration
from wheelsight.errors import RecordingError
from wheelsight.geometry import ByteArray, Float32Array, PinholeCamera
from wheelsight.recordings._images import image_size

_FIX = "choose another with --camera"


def corrected_depth(
    color: ByteArray, depth_m: Float32Array, calibration: Calibration, paths: tuple[Path, Path], fix: str = _FIX
) -> Float32Array:
    """Depth (H, W) in metres of a frame, freed of the errors that the calibration states.

    Args:
        color: colour image (H, W, 3), which is only checked.
        depth_m: depth as decoded.
        calibration: says sizes and errors.
        paths: where colour and depth come from, for the message.
        fix: what to do where a size is wrong.

    Raises:
        RecordingError: an image is not of its camera's size; names the file.
    """
    color_camera, depth_camera = calibration.cameras
    _check_size("colour", image_size(color), color_camera, paths[0], fix)
    _check_size("depth", image_size(depth_m), depth_camera, paths[1], fix)
    return calibration.depth_error.corrected(depth_m, depth_camera)


def _check_size(name: str, size: str, camera: PinholeCamera, path: Path, fix: str) -> None:
    expected = f"{camera.width}×{camera.height}"
    if size != expected:
        raise RecordingError(f"{name} image is {size}, the calibration's {expected}", path=path, fix=fix)
