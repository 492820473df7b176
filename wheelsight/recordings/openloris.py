"""OpenLORIS-Scene, a sequence of its package format: colour and depth aligned to it (Shi et al., ICRA 2020)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.calibration import Calibration, DepthNoise
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.inputs import is_there, read_yaml
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings._file_lists import read_file_list
from wheelsight.recordings._images import DepthEncoding
from wheelsight.recordings.image_recording import ImageRecording, pair_images, recording_of
from wheelsight.recordings.protocol import Layout, OpenOptions
from wheelsight.recordings.tum import read_truth

_CAMERA = "d400_color_optical_frame"
_BASE = "base_link"
_DEPTH_FACTOR = 1000.0
_RIGID_TOLERANCE = 1e-2  # files round to four digits and more
_FARTHEST_M = 1000.0  # of one part of a robot from another
_FIX = "correct it, or give a calibration.yaml with --camera"
_D435_NOISE = DepthNoise(quadratic_per_m=3.9e-3, near_m=0.3, far_m=10.0)
"""Intel's rule for stereo depth, σ = z² · subpixel / (f · baseline), with 0.08 px, 415 px and 0.05 m for the D435."""


class OpenLorisReader:
    """Colour and depth aligned to it, both of a RealSense D435i; 1000 depth units a metre; truth of base_link."""

    name = "openloris"
    layout = Layout.LISTS
    needs = "color.txt, aligned_depth.txt and sensors.yaml"

    def recognises(self, folder: Path) -> bool:
        """Whether the list of aligned depth, or that of colour beside the sensors' description, is there."""
        has_color = is_there(folder / "color.txt") and is_there(folder / "sensors.yaml")
        return has_color or is_there(folder / "aligned_depth.txt")

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        color, warnings = read_file_list(folder / "color.txt")
        depth, depth_warnings = read_file_list(folder / "aligned_depth.txt")
        warnings += depth_warnings
        calibration = choose_calibration(folder, options, lambda: _calibration(folder))
        images = pair_images(color, depth, options.max_gap_s, folder / "color.txt")
        if is_there(folder / "odom.txt"):
            warnings.append("odom.txt holds poses the robot computed, no encoder ticks; it is not used.")
        truth = read_truth(folder / "groundtruth.txt", warnings, body="base")
        if truth is not None and calibration.T_base_camera is None:
            warnings.append(
                "The ground truth describes the base, but nothing says where the camera is; it is not used."
            )
            truth = None
        return recording_of(
            folder,
            self.name,
            calibration,
            images,
            DepthEncoding(options.depth_factor or _DEPTH_FACTOR),
            truth,
            warnings,
        )


def _calibration(folder: Path) -> Calibration:
    """Intrinsics from sensors.yaml, T_base_camera from trans_matrix.yaml where that is there."""
    path = folder / "sensors.yaml"
    try:
        sensor = read_yaml(path, CalibrationError)[_CAMERA]
        fx, cx, fy, cy = _numbers(sensor["intrinsics"], 4)
        k1, k2, p1, p2, k3 = (*_numbers(sensor.get("distortion_coefficients") or {"data": []}), 0, 0, 0, 0, 0)[:5]
        camera = PinholeCamera(int(sensor["width"]), int(sensor["height"]), fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        problem = f"does not describe {_CAMERA} with width, height and intrinsics fx, cx, fy, cy: {error}"
        raise CalibrationError(problem, path=path, fix=_FIX) from error
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=path, fix=error.fix or _FIX) from error
    T_base_camera = _chain(folder / "trans_matrix.yaml")
    source = f"{path.name} of {folder.resolve().name}"
    return Calibration.registered_camera(camera, depth_noise=_D435_NOISE, T_base_camera=T_base_camera, source=source)


def _chain(path: Path) -> FloatArray | None:
    """T_base_camera, composed over the frames that the file joins; None where there is no such file."""
    if not is_there(path):
        return None
    try:
        links = [_link(link) for link in read_yaml(path, CalibrationError)["trans_matrix"]]
    except (KeyError, TypeError, ValueError) as error:
        problem = f"is not a list of parent_frame, child_frame, matrix: {error}"
        raise CalibrationError(problem, path=path, fix="each with four times four numbers in matrix.data") from error
    joined: dict[str, dict[str, FloatArray]] = {}
    for parent, child, T_parent_child in links:
        if not se3.is_valid(T_parent_child, _RIGID_TOLERANCE) or np.abs(T_parent_child).max() > _FARTHEST_M:
            problem = f"the matrix from {child} to {parent} is no rigid motion"
            raise CalibrationError(problem, path=path, fix="orthonormal rotation, metres, last row 0 0 0 1")
        joined.setdefault(parent, {}).setdefault(child, T_parent_child)
        joined.setdefault(child, {}).setdefault(parent, np.asarray(np.linalg.inv(T_parent_child), np.float64))
    T_base, reached = {_BASE: np.eye(4)}, [_BASE]
    while reached:
        parent = reached.pop()
        for child in joined.get(parent, {}).keys() - T_base.keys():
            T_base[child] = T_base[parent] @ joined[parent][child]
            reached.append(child)
    if _CAMERA not in T_base:
        fix = f"join them, parent_frame: {_BASE}, child_frame: {_CAMERA}"
        raise CalibrationError(f"no chain of frames leads from {_BASE} to {_CAMERA}", path=path, fix=fix)
    T = T_base[_CAMERA]
    return se3.from_parts(so3.nearest(T[:3, :3]), T[:3, 3])


def _link(link: Any) -> tuple[str, str, FloatArray]:
    """Parent, child and T_parent_child of an entry; KeyError, TypeError or ValueError where it is none."""
    parent, child = link["parent_frame"], link["child_frame"]
    return str(parent), str(child), np.reshape(_numbers(link["matrix"], 16), (4, 4))


def _numbers(matrix: dict[str, Any], count: int | None = None) -> list[float]:
    """The numbers of a tagged matrix; ValueError if they are not `count`."""
    numbers = [float(x) for x in matrix["data"]]
    if count is not None and len(numbers) != count:
        raise ValueError(f"{len(numbers)} numbers where {count} are expected")
    return numbers
