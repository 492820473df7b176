"""Frames that are numbered and have no stamps, and poses that are matrices: what several formats share."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wheelsight.errors import CalibrationError, RecordingError, TrajectoryError
from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.recordings._file_lists import ListedFile
from wheelsight.recordings.protocol import LeftOut, OpenOptions
from wheelsight.recordings.text import read_lines
from wheelsight.trajectory import Trajectory

_ASSUMED_RATE_HZ = 30.0  # of the Kinects, Xtions and renderings that these formats come from
_ORTHONORMAL_TOLERANCE = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class WrittenPose:
    """A pose as a file holds it: its time, the matrix (4, 4), and where it stands."""

    stamp_s: float
    T: FloatArray
    path: Path
    line: int | None = None


def rate_of(options: OpenOptions, warnings: list[str]) -> float:
    """How many frames a second are counted, the one given or 30; what is assumed is added to the warnings."""
    rate_hz = options.rate_hz or _ASSUMED_RATE_HZ
    assumed = "" if options.rate_hz else "; others by --rate-hz"
    warnings.append(f"The format has no time stamps; {rate_hz:g} frames a second are assumed{assumed}.")
    return rate_hz


def numbered_files(paths: Iterable[Path], pattern: re.Pattern[str], rate_hz: float) -> list[ListedFile]:
    """The files whose whole names match, in order of the number in the pattern's first group, stamped by it."""
    matches = ((pattern.fullmatch(path.name), path) for path in paths)
    found = {int(match[1]): path for match, path in sorted(matches, key=lambda item: item[1]) if match}
    return [ListedFile(number / rate_hz, found[number]) for number in sorted(found)]


def need_files(files: Sequence[ListedFile], what: str, folder: Path, needs: str) -> None:
    """Raise RecordingError where there are none."""
    if not files:
        raise RecordingError(f"holds no {what}", path=folder, fix=f"it needs {needs}")


def read_matrix(path: Path, size: int) -> FloatArray:
    """The (size, size) numbers in a text file. Raises RecordingError naming it."""
    try:
        rows = [[float(word) for word in line.text.split()] for line in read_lines(path)]
        matrix = np.array(rows, np.float64)
    except ValueError as error:
        raise RecordingError(f"is not a {size}×{size} matrix: {error}", path=path) from error
    if matrix.shape != (size, size):
        raise RecordingError(f"holds {matrix.size} numbers, not a {size}×{size} matrix", path=path)
    return matrix


def intrinsic_numbers(path: Path) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of the matrix (3, 3) in a text file. Raises RecordingError or CalibrationError."""
    (fx, skew, cx), (_, fy, cy), bottom = read_matrix(path, 3).tolist()
    if skew != 0 or bottom != [0, 0, 1]:
        raise CalibrationError("is not an intrinsic matrix fx 0 cx, 0 fy cy, 0 0 1")
    return fx, fy, cx, cy


def true_poses(poses: Sequence[WrittenPose], warnings: list[str]) -> Trajectory | None:
    """T_frame_camera; poses that are not finite, where tracking was lost, are left out, and told of in the warnings.

    Rotations are brought to the nearest orthonormal one. Raises TrajectoryError for what is none.
    """
    known = [pose for pose in poses if np.isfinite(pose.T).all()]
    if len(known) < len(poses):
        gone = len(poses) - len(known)
        told = f"{gone} of {len(poses)} true poses are not finite and were left out."
        warnings.append(LeftOut(told, gone, len(poses), "true poses are not finite"))
    if not known:
        return None
    T = np.stack([pose.T for pose in known])
    R = so3.nearest(T[:, :3, :3])
    off = np.abs(R - T[:, :3, :3]).max(axis=(1, 2))
    if off.max() > _ORTHONORMAL_TOLERANCE:
        worst = known[int(off.argmax())]
        fix = "give poses as rotation and translation, without scale"
        raise TrajectoryError("the first 3×3 numbers are no rotation", path=worst.path, line=worst.line, fix=fix)
    return Trajectory(np.array([pose.stamp_s for pose in known]), se3.from_parts(R, T[:, :3, 3]))
