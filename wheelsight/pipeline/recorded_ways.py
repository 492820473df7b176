"""A way that a robot is to drive along again: read from a trajectory that wheelsight wrote."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError, TrajectoryError
from wheelsight.files import StrPath
from wheelsight.geometry import FloatArray
from wheelsight.pipeline.loops import CORRECTED_FILE
from wheelsight.pipeline.outputs import TRAJECTORY_FILE
from wheelsight.recordings import express_for
from wheelsight.trajectory import Trajectory, read_tum

_log = logging.getLogger(__name__)

# Where a run has its trajectory, and first the file that knows more: loops have corrected it.
_TRACKS = ("", "joined", "dense", "features", "own")
_FILES = (CORRECTED_FILE, TRAJECTORY_FILE)
# A base that is tipped farther drives on no floor: the poses are of a camera, or of another frame.
_MOST_TIPPED_DEG = 30.0


def read_way(path: StrPath, calibration: Calibration, warn: Callable[[str], None] = _log.warning) -> FloatArray:
    """(N, 3) x, y, yaw of the base in the map, metres and radians, in the order driven.

    Args:
        path: TUM text, such as the trajectory.txt of a run or of a drive; or the folder of one of these. Of a file
            whose header names no frames, poses are taken to be of the base in the map.
        calibration: of the robot; where the poses are of its camera, they are told for its base.
        warn: told in a sentence what was left out.

    Raises:
        TrajectoryError: no such file, no poses, a value that is not finite (with its line), poses in another frame
            than the map, or of a base that is tipped over.
        CalibrationError: the poses are of the camera, and the calibration does not say where that sits.
    """
    file = _file_of(Path(path))
    found = read_tum(file, "base", warn)
    if found.frame != "map":
        problem = f"the field frames says that its poses are in {found.frame}, not in the map"
        raise TrajectoryError(problem, path=file, fix=f"give {TRAJECTORY_FILE} or {CORRECTED_FILE} of a run in the map")
    try:
        of_base = express_for("base", found, calibration)
    except CalibrationError as error:
        problem = f"its poses are of the {found.body}, and the map's calibration has no T_base_camera"
        raise CalibrationError(problem, path=file, fix="give a way of the base, as wheelsight drive writes") from error
    _refuse_tipped(of_base, file)
    T = of_base.T_frame_body
    return np.column_stack([T[:, :2, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])


def _file_of(path: Path) -> Path:
    """The file itself, or that in the folder of a run. Raises TrajectoryError for a folder without any."""
    if not os.path.isdir(path):  # noqa: PTH112 (a name that is too long is none)
        return path
    within = [path / track / name for track in _TRACKS for name in _FILES]
    found = next((file for file in within if file.is_file()), None)
    if found is None:
        problem = f"the folder holds neither {TRAJECTORY_FILE} nor {CORRECTED_FILE}"
        raise TrajectoryError(problem, path=path, fix="give a trajectory, or the folder of a run or a drive")
    return found


def _refuse_tipped(way: Trajectory, path: Path) -> None:
    """Raises TrajectoryError naming the first pose whose base does not stand upright in the map."""
    tipped_deg = np.degrees(np.arccos(np.clip(way.T_frame_body[:, 2, 2], -1.0, 1.0)))
    for bad in np.flatnonzero(tipped_deg > _MOST_TIPPED_DEG):
        problem = f"the quaternion at stamp {way.stamps_s[bad]:.6f} tips the base by {tipped_deg[bad]:.0f}°"
        raise TrajectoryError(problem, path=path, fix="give poses of the base in the map, whose z points up")
