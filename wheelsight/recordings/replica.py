"""Replica's rooms as NICE-SLAM renders them: results/, traj.txt, cam_params.json (Zhu et al., CVPR 2022)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError, RecordingError, TrajectoryError
from wheelsight.geometry import PinholeCamera
from wheelsight.inputs import Kind, is_there, parse_json, read_text
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings._images import DepthEncoding
from wheelsight.recordings._numbered import WrittenPose, need_files, numbered_files, rate_of, true_poses
from wheelsight.recordings.image_recording import ImageRecording, pair_images, recording_of
from wheelsight.recordings.protocol import Layout, OpenOptions
from wheelsight.recordings.text import read_lines
from wheelsight.trajectory import Trajectory

_COLOR = re.compile(r"frame(\d{1,9})\.(?:jpe?g|png)")
_DEPTH = re.compile(r"depth(\d{1,9})\.png")
_TRUTH, _CAMERA = "traj.txt", "cam_params.json"
_DEPTH_FACTOR = 6553.5  # 65535 is 10 m
_FIX = 'it needs {"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}}'
_POSE_FIX = "one pose a line, row by row"
_JSON = Kind("a camera's description", most_mb=1)


class ReplicaReader:
    """Colour and depth, both rendered at one place; units a metre as the camera's file says."""

    name = "replica"
    layout = Layout.NUMBERED
    needs = "results/frameN.jpg and depthN.png, and cam_params.json"

    def recognises(self, folder: Path) -> bool:
        """Whether images lie in results/ called as theirs."""
        results = folder / "results"
        return results.is_dir() and any(_DEPTH.fullmatch(path.name) for path in results.glob("depth*.png"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""
        warnings: list[str] = []
        rate_hz = rate_of(options, warnings)
        written = _read_camera(folder)
        calibration = choose_calibration(folder, options, lambda: _calibration(folder, written))
        files = list((folder / "results").iterdir())
        color, depth = (numbered_files(files, pattern, rate_hz) for pattern in (_COLOR, _DEPTH))
        need_files(color, "colour image", folder / "results", self.needs)
        images = pair_images(color, depth, 0.0, folder / "results")
        return recording_of(
            folder,
            self.name,
            calibration,
            images,
            DepthEncoding(options.depth_factor or _units_a_metre(written)),
            _read_truth(folder / _TRUTH, rate_hz, warnings),
            warnings,
        )


@dataclass(frozen=True, slots=True)
class _Written:
    """What a camera's file holds, and which that is."""

    path: Path
    values: dict[str, Any]


def _read_camera(folder: Path) -> _Written | None:
    """The camera's file in the folder, else in the one above, where one serves all rooms; None without any."""
    beside = [above / _CAMERA for above in (folder, folder.resolve().parent)]
    path = next((path for path in beside if is_there(path)), None)
    if path is None:
        return None
    try:
        values = parse_json(read_text(path, _JSON, CalibrationError))["camera"]
        return _Written(path, dict(values))
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"describes no camera: {error}", path=path, fix=_FIX) from error


def _units_a_metre(written: _Written | None) -> float:
    if written is None:
        return _DEPTH_FACTOR
    factor = written.values.get("scale", _DEPTH_FACTOR)
    if isinstance(factor, bool) or not isinstance(factor, int | float) or not factor > 0:
        raise CalibrationError(f"scale is {factor!r}, not a positive number", path=written.path, fix=_FIX)
    return float(factor)


def _calibration(folder: Path, written: _Written | None) -> Calibration:
    if written is None:
        fix = f"copy {_CAMERA} of the data set here, or say which camera with --camera"
        raise CalibrationError(f"there is no {_CAMERA}, here or in the folder above", path=folder, fix=fix)
    try:
        width, height, fx, fy, cx, cy = (written.values[name] for name in ("w", "h", "fx", "fy", "cx", "cy"))
        camera = PinholeCamera(width, height, fx, fy, cx, cy)
        return Calibration.registered_camera(camera, source=_CAMERA)
    except KeyError as error:
        raise CalibrationError(f"camera has no {error}", path=written.path, fix=_FIX) from error
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=written.path, fix=error.fix or _FIX) from error


def _read_truth(path: Path, rate_hz: float, warnings: list[str]) -> Trajectory | None:
    """T_frame_camera, sixteen numbers a line, a line a frame from 0, in the optical frame already."""
    if not is_there(path):
        return None
    poses = []
    for number, line in enumerate(read_lines(path)):
        try:
            T = np.array([float(word) for word in line.text.split()], np.float64)
        except ValueError as error:
            raise TrajectoryError(
                f"holds what is no number: {error}", path=path, line=line.number, fix=_POSE_FIX
            ) from error
        if T.size != 16:
            problem = f"holds {T.size} numbers where the sixteen of a 4×4 matrix are expected"
            raise TrajectoryError(problem, path=path, line=line.number, fix=_POSE_FIX)
        poses.append(WrittenPose(number / rate_hz, T.reshape(4, 4), path, line.number))
    if not poses:
        raise RecordingError("holds no poses", path=path, fix="copy it again, or remove it")
    return true_poses(poses, warnings)
