"""Two days in one room: a camera that turns in it, on the second day a step aside and the other way round."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from places.seen_room import frame_at, standing
from stand_ins import MemoryRecording
from synthetic import CAMERA

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory

RATE_HZ, STEP_RAD = 15.0, np.radians(4.0)
CALIBRATION = Calibration.registered_camera(CAMERA)
OTHER_ROOM = 3  # seed of its textures


def at(step: float, aside_m: float = 0.0) -> FloatArray:
    """T_room_camera (4, 4): it turns in the middle of the room."""
    return standing(0.1 * np.sin(0.2 * step) - 0.5, aside_m, STEP_RAD * step)


FIRST_DAY = [at(step) for step in range(45)]
SECOND_DAY = [at(step, 0.15) for step in range(40, 12, -1)]


def recorded(
    way: list[FloatArray], begin_s: float = 10.0, seed: int = 0, calibration: Calibration = CALIBRATION
) -> MemoryRecording:
    """Frames along T_room_camera (4, 4), with the truth."""
    frames = frames_of(way, begin_s, seed)
    truth = Trajectory(np.array([frame.stamp_s for frame in frames]), np.array(way), body="camera")
    return MemoryRecording(frames, truth, calibration)


def covered(frames: list[RgbdFrame], begin_s: float, count: int = 15) -> list[RgbdFrame]:
    """Black ones, one each 0.2 s from a time on."""
    black = [replace(frame, color=np.zeros_like(frame.color), depth_m=np.zeros_like(frame.depth_m)) for frame in frames]
    return [replace(frame, stamp_s=begin_s + 0.2 * k, index=100 + k) for k, frame in enumerate(black[:count])]


def frames_of(way: list[FloatArray], begin_s: float, seed: int = 0) -> list[RgbdFrame]:
    """One each 1/15 s."""
    made = [frame_at(T, seed=seed, stamp_s=begin_s + k / RATE_HZ) for k, T in enumerate(way)]
    return [RgbdFrame(frame.stamp_s, frame.color, frame.depth_m, index) for index, frame in enumerate(made)]
