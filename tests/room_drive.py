"""A robot that drives an arc through the synthetic room: wheels, images and truth in one recording."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from drives import simulate
from synthetic import CAMERA, render_room

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import RecordingWriter

WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
T_BASE_CAMERA = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])
_T_WORLD_START = se3.exp([-1.4, -0.3, 0, 0, 0, 0.1])
_STEPS_A_FRAME = 4


def make_room_drive(folder: Path, frames: int = 12, *, with_truth: bool = True, mounted: bool = True) -> Trajectory:
    """Write the recording, 50 readings and 12.5 frames a second, and return the true T_odom_base at its readings.

    It stands for a second, drives for `frames` frames, and stands for another second.
    Not `mounted`, its calibration does not tell where the camera is on the base, and the truth is the camera's.
    """
    truth, files = _made(frames, with_truth, mounted)
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return truth


@lru_cache(maxsize=8)
def _made(frames: int, with_truth: bool, mounted: bool) -> tuple[Trajectory, dict[Path, bytes]]:
    """The truth, and what is in each file by its name: many tests ask for the same drive."""
    with TemporaryDirectory() as name:
        folder = Path(name) / "drive"
        truth = _write(folder, frames, with_truth, mounted)
        return truth, {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _write(folder: Path, frames: int, with_truth: bool, mounted: bool) -> Trajectory:
    rng = np.random.default_rng(11)
    drive = simulate(WHEELS, [(frames * _STEPS_A_FRAME / 50, 0.4, 0.3)])
    truth = drive.truth.moved(_T_WORLD_START)
    mount = T_BASE_CAMERA if mounted else None
    calibration = Calibration.registered_camera(CAMERA, wheels=WHEELS, T_base_camera=mount, source="room")
    with RecordingWriter(folder, calibration) as writer:
        for index, (stamp_s, T_odom_base) in enumerate(truth):
            writer.add(WheelTicks(stamp_s, int(drive.left[index]), int(drive.right[index])))
            if index % _STEPS_A_FRAME == 0:
                color, depth_m = render_room(T_odom_base @ T_BASE_CAMERA)
                writer.add(RgbdFrame(stamp_s + 0.001, _noisy(color, rng), depth_m, index // _STEPS_A_FRAME))
        if with_truth and mounted:
            writer.add_ground_truth(truth)
        elif with_truth:
            writer.add_ground_truth(Trajectory(truth.stamps_s, truth.T_frame_body @ T_BASE_CAMERA))
    return truth


def _noisy(color: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """By a level, as a camera is that stands still: the same image twice would be one that was logged twice."""
    return np.clip(color + rng.integers(-1, 2, color.shape), 0, 255).astype(np.uint8)
