"""Redwood's indoor recordings: folders of images and a trajectory in .log (Choi, Zhou, Koltun, CVPR 2015)."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from wheelsight.errors import RecordingError, TrajectoryError
from wheelsight.recordings._cameras import choose_calibration, load_camera
from wheelsight.recordings._file_lists import ListedFile
from wheelsight.recordings._images import DepthEncoding
from wheelsight.recordings._numbered import WrittenPose, need_files, numbered_files, rate_of, true_poses
from wheelsight.recordings.image_recording import ImageRecording, pair_images, recording_of
from wheelsight.recordings.protocol import Layout, OpenOptions
from wheelsight.recordings.text import Line, read_lines

_COLOR_FOLDERS = ("rgb", "image", "color")
_IMAGE = re.compile(r"(\d{1,9})(?:-\d+)?\.(?:png|jpe?g)", re.IGNORECASE)
_DEPTH_FACTOR = 1000.0
_LINES_A_POSE = 5
_FIX = "a pose is a line of three whole numbers and four lines of four"


class RedwoodReader:
    """Colour and registered depth in millimetres; poses in the log map the camera into the room."""

    name = "redwood"
    layout = Layout.NUMBERED
    needs = "rgb/, image/ or color/ with N.jpg, depth/N.png and one *.log"

    def recognises(self, folder: Path) -> bool:
        """Whether a log lies beside folders called as theirs."""
        has_images = _color_folder(folder) is not None and (folder / "depth").is_dir()
        return has_images and any(True for _ in folder.glob("*.log"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Stamps are the frames' numbers at 30 Hz, or the rate given. Raises InputError."""
        warnings: list[str] = []
        rate_hz = rate_of(options, warnings)
        calibration = choose_calibration(folder, options, lambda: load_camera(self.name))
        color_folder = _color_folder(folder) or folder
        color, depth = (numbered_files(place.iterdir(), _IMAGE, rate_hz) for place in (color_folder, folder / "depth"))
        need_files(color, "colour image called by its number", color_folder, self.needs)
        need_files(depth, "depth image called by its number", folder / "depth", self.needs)
        images = pair_images(color, depth, 0.0, folder)
        return recording_of(
            folder,
            self.name,
            calibration,
            images,
            DepthEncoding(options.depth_factor or _DEPTH_FACTOR),
            true_poses(_read_log(_only_log(folder), depth, warnings), warnings),
            warnings,
        )


def _color_folder(folder: Path) -> Path | None:
    return next((folder / name for name in _COLOR_FOLDERS if (folder / name).is_dir()), None)


def _only_log(folder: Path) -> Path:
    logs = sorted(folder.glob("*.log"))
    if len(logs) != 1:
        problem = f"holds {len(logs)} logs: {', '.join(log.name for log in logs)}"
        raise RecordingError(problem, path=folder, fix="leave the one with these images' poses")
    return logs[0]


def _read_log(path: Path, depth: list[ListedFile], warnings: list[str]) -> list[WrittenPose]:
    """Poses of depth images, which the third number counts from 1 in order. Raises TrajectoryError with the line."""
    lines = read_lines(path)
    if not lines or len(lines) % _LINES_A_POSE:
        problem = f"holds {len(lines)} lines, not five a pose"
        raise TrajectoryError(problem, path=path, line=lines[-1].number if lines else None, fix=_FIX)
    poses = [_pose(lines[at : at + _LINES_A_POSE], depth, path) for at in range(0, len(lines), _LINES_A_POSE)]
    known = [pose for pose in poses if pose is not None]
    if len(known) < len(poses):
        warnings.append(f"{len(poses) - len(known)} of {len(poses)} poses of {path.name} are of no depth image here.")
    stamps = [pose.stamp_s for pose in known]
    if any(later <= before for before, later in pairwise(stamps)):
        raise TrajectoryError("its third numbers do not grow", path=path, fix="put its poses in order of frames")
    return known


def _pose(lines: list[Line], depth: list[ListedFile], path: Path) -> WrittenPose | None:
    """The pose of five lines; None where there is no depth image of its number."""
    first = lines[0]
    try:
        _, _, count = (int(word) for word in first.text.split())
    except ValueError as error:
        raise TrajectoryError("three whole numbers are expected", path=path, line=first.number, fix=_FIX) from error
    rows = []
    for line in lines[1:]:
        try:
            a, b, c, d = (float(word) for word in line.text.split())
        except ValueError as error:
            raise TrajectoryError("four numbers are expected", path=path, line=line.number, fix=_FIX) from error
        rows.append((a, b, c, d))
    if not 1 <= count <= len(depth):
        return None
    return WrittenPose(depth[count - 1].stamp_s, np.array(rows), path, first.number)
