"""Writes trajectories as TUM, KITTI or EuRoC's csv."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from wheelsight.app.exports.sources import Exported
from wheelsight.core.errors import TrajectoryError
from wheelsight.core.files import StrPath, write_text
from wheelsight.core.geometry import so3
from wheelsight.core.trajectory import Trajectory, write_kitti, write_tum
from wheelsight.io.recordings import express_for
from wheelsight.io.recordings.bags.writing import nanoseconds

# As EuRoC's data.csv of state_groundtruth_estimate0 begins, without velocities and biases, which a trajectory lacks.
_EUROC = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"


def export_trajectory(source: Exported, form: str, path: StrPath, body: str | None = None) -> Trajectory:
    """Write a run's final trajectory in one of TRAJECTORY_FORMATS. Returns the written trajectory.

    Args:
        source: a run.
        form: format of the file.
        path: of the file.
        body: "base" or "camera"; None for the body of the run. KITTI's rules ask for a camera, but its tools take any
            body.

    Raises:
        TrajectoryError: there is none.
        CalibrationError: it is of another body, and there is no transform between the two.
        OutputError: the file cannot be written.
    """
    found = source.corrected or source.trajectory
    if found is None:
        fix = "give the folder of a run: wheelsight run RECORDING --out DIR"
        raise TrajectoryError("holds no trajectory", path=source.path, fix=fix)
    if body is not None and body != found.body:
        calibration = source.calibration
        if calibration is None:
            raise TrajectoryError(f"is of the {found.body}, and no calibration is there", path=source.path)
        found = express_for(body, found, calibration)
    TRAJECTORY_FORMATS[form](found, path)
    return found


def write_euroc(trajectory: Trajectory, path: StrPath) -> None:
    """Write EuRoC's csv, atomically: nanoseconds, position, and the quaternion with w first. Raises OutputError."""
    q_wxyz = np.roll(so3.to_quaternion(trajectory.T_frame_body[:, :3, :3]), 1, axis=1)
    lines = [
        ",".join([str(nanoseconds(stamp_s)), *(f"{value:.9f}" for value in (*position, *quaternion))])
        for stamp_s, position, quaternion in zip(
            trajectory.stamps_s.tolist(), trajectory.positions_m, q_wxyz, strict=True
        )
    ]
    write_text(Path(path), _EUROC + "".join(f"{line}\n" for line in lines))


TRAJECTORY_FORMATS: dict[str, Callable[[Trajectory, StrPath], None]] = {
    "euroc": write_euroc,
    "kitti": write_kitti,
    "tum": write_tum,
}
"""How each format is written, by its name."""
