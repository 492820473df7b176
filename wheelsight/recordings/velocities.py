"""Speeds as a robot's own odometry tells them: odometry.csv, with true poses in ground_truth.csv."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wheelsight.events import WheelSpeeds
from wheelsight.geometry import se3
from wheelsight.inputs import is_there
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings._wheel_recording import WheelRecording, need_wheels, shipped_robot, speeds_of_wheels
from wheelsight.recordings.protocol import Layout, OpenOptions
from wheelsight.recordings.tables import read_columns, read_table
from wheelsight.recordings.text import keep_growing
from wheelsight.trajectory import Trajectory


class VelocityReader:
    """Forward speed and yaw rate, each until the next row, and poses of a motion-capture system.

    odometry.csv: stamp_s, v_mps, w_radps. ground_truth.csv: stamp_s, x_m, y_m, yaw_rad and valid, 0 where the pose is
    none. The robot's wheels are not told of: `robots/velocities.yaml` stands for them.
    """

    name = "velocities"
    layout = Layout.WHEELS
    needs = "odometry.csv and ground_truth.csv"

    def recognises(self, folder: Path) -> bool:
        """Whether both are there."""
        return all(is_there(folder / name) for name in ("odometry.csv", "ground_truth.csv"))

    def open(self, folder: Path, options: OpenOptions) -> WheelRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        speeds, warnings = _read_speeds(folder / "odometry.csv")
        truth, more = _read_truth(folder / "ground_truth.csv")
        return WheelRecording(
            name=folder.resolve().name,
            path=folder,
            format=self.name,
            calibration=choose_calibration(folder, options, lambda: shipped_robot("velocities")),
            wheels=tuple(speeds),
            ground_truth=truth,
            warnings=(*warnings, *more),
        )


def _read_speeds(path: Path) -> tuple[list[WheelSpeeds], list[str]]:
    nominal = need_wheels(shipped_robot("velocities"))
    table, warnings = read_columns(path, numbers=("v_mps", "w_radps"))
    told = zip(table.stamps_s, table["v_mps"], table["w_radps"], strict=True)
    growing, more = keep_growing([speeds_of_wheels(nominal, *row) for row in told], table.lines, path)
    return growing, warnings + more


def _read_truth(path: Path) -> tuple[Trajectory | None, list[str]]:
    """T_frame_base of the rows that are valid."""
    rows, warnings = read_table(path, ("stamp_s", "x_m", "y_m", "yaw_rad", "valid"))
    rows = [row for row in rows if row["valid"] != 0]
    rows, more = keep_growing(rows, [row.number for row in rows], path)
    warnings += more
    if not rows:
        return None, [*warnings, f"{path.name}: no true pose is marked valid."]
    x, y, yaw = np.array([[row[name] for name in ("x_m", "y_m", "yaw_rad")] for row in rows]).T
    stamps_s = np.array([row.stamp_s for row in rows])
    return Trajectory(stamps_s, se3.from_plane(x, y, yaw), body="base"), warnings
