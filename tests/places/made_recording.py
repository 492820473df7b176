"""A small recording of a drive through three areas, as files: frames, truth, labels and polygons that agree."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from places.made import NAMES, frame_of

from wheelsight.core.areas import Area, AreaMap, save_areas
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import RecordingWriter

RATE_HZ = 10.0
ROOM_M = 3.0
T_BASE_CAMERA = np.array([[0, 0, 1, 0.3], [-1, 0, 0, 0], [0, -1, 0, 0.9], [0, 0, 0, 1]], float)
CALIBRATION = Calibration(
    color=PinholeCamera(32, 24, 26.0, 26.0, 15.5, 11.5),
    depth=PinholeCamera(32, 24, 26.0, 26.0, 15.5, 11.5),
    T_base_camera=T_BASE_CAMERA,
    source="made",
)


def rooms(names: Sequence[str] = NAMES) -> AreaMap:
    """Rooms of 3 m in a row along x."""
    return AreaMap(tuple(room(name, index) for index, name in enumerate(names)))


def room(name: str, index: int) -> Area:
    left, right = ROOM_M * index, ROOM_M * (index + 1)
    return Area(name, np.array([[left, -1], [right, -1], [right, 1], [left, 1]]), x_m=(left + right) / 2)


def straight(stamps_s: np.ndarray, x_m: np.ndarray, body: str = "base") -> Trajectory:
    """A body at (x, 0, 0) that looks along x."""
    T = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    T[:, 0, 3] = x_m
    return Trajectory(stamps_s, T, body=body)


def write_drive(
    folder: Path,
    each: int = 20,
    seed: int = 5,
    *,
    start_s: float = 0.0,
    with_areas: bool = True,
    with_truth: bool = True,
    with_labels: bool = False,
    blind: Sequence[int] = (),
    visited: Sequence[int] = (0, 1, 2),
) -> Path:
    """Write a drive that spends `each` frames in one room after the other; `blind` frames have depth in one pixel."""
    rng = np.random.default_rng(seed)
    labels = np.repeat(np.asarray(visited), each)
    stamps_s = start_s + np.arange(len(labels)) / RATE_HZ
    within = (np.arange(len(labels)) % each + 0.5) / each
    with RecordingWriter(folder, CALIBRATION) as writer:
        if with_truth:
            writer.add_ground_truth(straight(stamps_s, ROOM_M * (labels + within)))
        for index, (stamp_s, area) in enumerate(zip(stamps_s.tolist(), labels.tolist(), strict=True)):
            frame = frame_of(area, rng, stamp_s)
            depth_m = frame.depth_m
            if index in blind:
                depth_m = np.zeros_like(depth_m)
                depth_m[1, 1] = 1.0  # readers leave out frames with none at all
            if with_labels:
                writer.add_label(stamp_s, NAMES[area])
            writer.add(RgbdFrame(stamp_s, frame.color, depth_m, index))
    if with_areas:
        save_areas(rooms(), folder / "areas.yaml")
    (folder / "wheels.csv").write_text("stamp_s,left,right\n0,0,0\n1,1,1\n")
    return folder
