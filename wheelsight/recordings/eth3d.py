"""The ETH3D SLAM benchmark's RGB-D layout: TUM's lists, and calibration.txt (Schöps, Sattler, Pollefeys, CVPR 2019)."""

from __future__ import annotations

import math
from pathlib import Path

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError
from wheelsight.geometry import PinholeCamera
from wheelsight.inputs import is_there
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings._images import color_size
from wheelsight.recordings.image_recording import FramePaths, ImageRecording
from wheelsight.recordings.protocol import Layout, OpenOptions
from wheelsight.recordings.text import read_lines
from wheelsight.recordings.tum import open_lists

_INTRINSICS = "calibration.txt"
_FIX = "write fx fy cx cy in pixels, or remove the file to have the folder read as TUM's"


class Eth3dReader:
    """Undistorted colour and depth registered to it, both of a global shutter; 5000 depth units a metre."""

    name = "eth3d"
    layout = Layout.LISTS
    needs = "as tum, and calibration.txt"

    def recognises(self, folder: Path) -> bool:
        """Whether intrinsics lie beside a list of images."""
        return is_there(folder / _INTRINSICS) and any(is_there(folder / name) for name in ("rgb.txt", "depth.txt"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Raises InputError naming file and line."""

        def calibration_of(frames: tuple[FramePaths, ...]) -> Calibration:
            return choose_calibration(folder, options, lambda: _calibration(folder / _INTRINSICS, frames))

        return open_lists(folder, options, self.name, calibration_of)


def _calibration(path: Path, frames: tuple[FramePaths, ...]) -> Calibration:
    """Of four numbers; the size of images, which the file does not tell, is that of the first."""
    lines = read_lines(path)
    try:
        numbers = [float(word) for line in lines for word in line.text.split()]
    except ValueError as error:
        raise CalibrationError(f"holds what is no number: {error}", path=path, fix=_FIX) from error
    if len(numbers) != 4 or not all(map(math.isfinite, numbers)):
        problem = f"holds {len(numbers)} numbers where the four fx fy cx cy are expected"
        raise CalibrationError(problem, path=path, fix=_FIX)
    width, height = color_size(frame.color for frame in frames)
    try:
        fx, fy, cx, cy = numbers
        camera = PinholeCamera(width, height, fx, fy, cx, cy)
        return Calibration.registered_camera(camera, source=f"{path.name} of {path.resolve().parent.name}")
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=path, fix=_FIX) from error
