"""OpenLORIS-Scene, a sequence of its package format: colour, depth aligned to it, odometry (Shi et al., ICRA 2020)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from wheelsight.calibration import Calibration, DepthNoise
from wheelsight.errors import CalibrationError, RecordingError
from wheelsight.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings._image_recording import ImageRecording, complete, pair_images
from wheelsight.recordings._images import DepthEncoding
from wheelsight.recordings._text import keep_growing, read_file_list, read_lines
from wheelsight.recordings.protocol import OpenOptions
from wheelsight.recordings.tum import read_truth
from wheelsight.trajectory import Trajectory

_CAMERA = "d400_color_optical_frame"
_BASE = "base_link"
_DEPTH_FACTOR = 1000.0
_D435_NOISE = DepthNoise(quadratic_per_m=3.9e-3, near_m=0.3, far_m=10.0)
"""Intel's rule for stereo depth, σ = z² · subpixel / (f · baseline), with 0.08 px, 415 px and 0.05 m for the D435."""


class OpenLorisReader:
    """Colour and depth aligned to it, both of a RealSense D435i; 1000 depth units a metre; truth of base_link."""

    name = "openloris"
    needs = "color.txt, aligned_depth.txt and sensors.yaml"

    def recognises(self, folder: Path) -> bool:
        """Whether the list of aligned depth, or that of colour beside the sensors' description, is there."""
        has_color = (folder / "color.txt").is_file() and (folder / "sensors.yaml").is_file()
        return has_color or (folder / "aligned_depth.txt").is_file()

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        color, warnings = read_file_list(folder / "color.txt")
        depth, depth_warnings = read_file_list(folder / "aligned_depth.txt")
        warnings += depth_warnings
        calibration = choose_calibration(folder, options, lambda: _calibration(folder))
        frames, association = pair_images(color, depth, options.max_gap_s, folder / "color.txt")
        odometry = _read_odometry(folder / "odom.txt", warnings)
        truth = read_truth(folder / "groundtruth.txt", warnings, body="base")
        if truth is not None and calibration.T_base_camera is None:
            warnings.append(
                "The ground truth describes the base, but nothing says where the camera is; it is not used."
            )
            truth = None
        return complete(
            ImageRecording(
                name=folder.resolve().name,
                path=folder,
                format=self.name,
                calibration=calibration,
                association=association,
                frames=frames,
                encoding=DepthEncoding(options.depth_factor or _DEPTH_FACTOR),
                ground_truth=truth,
                warnings=tuple(warnings),
                odometry=odometry,
            )
        )


def _calibration(folder: Path) -> Calibration:
    """Intrinsics from sensors.yaml, T_base_camera from trans_matrix.yaml where that is there."""
    path = folder / "sensors.yaml"
    try:
        sensor = _read_opencv_yaml(path)[_CAMERA]
        fx, cx, fy, cy = _numbers(sensor["intrinsics"], 4)
        k1, k2, p1, p2, k3 = (*_numbers(sensor.get("distortion_coefficients") or {"data": []}), 0, 0, 0, 0, 0)[:5]
        camera = PinholeCamera(int(sensor["width"]), int(sensor["height"]), fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    except (KeyError, TypeError, ValueError) as error:
        problem = f"does not describe {_CAMERA} with width, height and intrinsics fx, cx, fy, cy: {error}"
        raise CalibrationError(problem, path=path) from error
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=path, fix=error.fix) from error
    T_base_camera = _chain(folder / "trans_matrix.yaml")
    source = f"{path.name} of {folder.resolve().name}"
    return Calibration.registered_camera(camera, depth_noise=_D435_NOISE, T_base_camera=T_base_camera, source=source)


def _chain(path: Path) -> FloatArray | None:
    """T_base_camera, composed over the frames that the file joins; None where there is no such file."""
    if not path.is_file():
        return None
    try:
        links = [
            (link["parent_frame"], link["child_frame"], np.reshape(_numbers(link["matrix"], 16), (4, 4)))
            for link in _read_opencv_yaml(path)["trans_matrix"]
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"is not a list of parent_frame, child_frame, matrix: {error}", path=path) from error
    T_base = {_BASE: np.eye(4)}
    for _ in links:
        for parent, child, T_parent_child in links:
            if parent in T_base:
                T_base.setdefault(child, T_base[parent] @ T_parent_child)
            elif child in T_base:
                T_base[parent] = T_base[child] @ np.linalg.inv(T_parent_child)
    if _CAMERA not in T_base:
        raise CalibrationError(f"no chain of frames leads from {_BASE} to {_CAMERA}", path=path)
    T = T_base[_CAMERA]
    return se3.from_parts(so3.nearest(T[:3, :3]), T[:3, 3])


def _read_odometry(path: Path, warnings: list[str]) -> Trajectory | None:
    """T_odom_base of odom.txt: `stamp x y z qx qy qz qw` and speeds, which are not read."""
    if not path.is_file():
        return None
    lines = read_lines(path)
    rows = [_Row(line.text, path, line.number) for line in lines]
    growing, left_out = keep_growing(rows, [line.number for line in lines], path)
    warnings += [*left_out, "odom.txt holds poses the robot computed, no encoder ticks; it is kept as `odometry`."]
    values = np.array([row.values for row in growing], np.float64).reshape(-1, 8)
    return Trajectory(values[:, 0], se3.from_quaternion(values[:, 1:4], values[:, 4:]), body="base", world="odom")


class _Row:
    """The first eight numbers of a line: a stamp and a pose."""

    def __init__(self, text: str, path: Path, line: int) -> None:
        try:
            self.values = [float(word) for word in text.replace(",", " ").split()[:8]]
        except ValueError as error:
            raise RecordingError(str(error), path=path, line=line) from error
        if len(self.values) != 8 or not np.isfinite(self.values).all() or not any(self.values[4:]):
            raise RecordingError("stamp x y z qx qy qz qw are expected", path=path, line=line)
        self.stamp_s = self.values[0]


class _OpenCvLoader(yaml.SafeLoader):
    """Reads the YAML that OpenCV writes, where matrices are tagged."""


def _construct_matrix(loader: _OpenCvLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


_OpenCvLoader.add_constructor("tag:yaml.org,2002:opencv-matrix", _construct_matrix)


def _read_opencv_yaml(path: Path) -> Any:
    try:
        text = path.read_text(encoding="utf-8-sig")
        return yaml.load(text.replace("%YAML:1.0", "", 1), _OpenCvLoader)
    except OSError as error:
        raise CalibrationError(f"cannot be read: {error.strerror}", path=path) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise CalibrationError(f"is not YAML: {error}", path=path) from error


def _numbers(matrix: dict[str, Any], count: int | None = None) -> list[float]:
    """The numbers of a tagged matrix; ValueError if they are not `count`."""
    numbers = [float(x) for x in matrix["data"]]
    if count is not None and len(numbers) != count:
        raise ValueError(f"{len(numbers)} numbers where {count} are expected")
    return numbers
