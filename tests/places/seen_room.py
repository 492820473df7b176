"""Views of the synthetic room, for recognition and verification."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from synthetic import CAMERA, render_room

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.keyframes import Keyframe
from wheelsight.core.messages import RgbdFrame
from wheelsight.places.recognition import SeenView, ViewMaker
from wheelsight.vision.dense import DenseSettings

EXACT = Calibration.registered_camera(CAMERA, frame_sigma_m=0.0, frame_sigma_rad=0.0)
_FORWARDS = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def standing(x: float, y: float, yaw: float, z: float = 1.3) -> FloatArray:
    """T_map_camera (4, 4) of a camera that looks level."""
    return se3.from_parts(so3.exp([0.0, 0.0, yaw]) @ _FORWARDS, [x, y, z])


@lru_cache(maxsize=1)
def maker() -> ViewMaker:
    return ViewMaker(EXACT, DenseSettings())


def frame_at(T_map_camera: FloatArray, *, seed: int = 0, stamp_s: float = 0.0, blank: bool = False) -> RgbdFrame:
    color, depth_m = render_room(T_map_camera, seed=seed, depth_noise=True, blank=blank)
    return RgbdFrame(stamp_s, color, depth_m)


def seen(T_map_camera: FloatArray, *, seed: int = 0, blank: bool = False) -> SeenView:
    """The room from there, `seed` chooses its textures."""
    return maker().of_frame(frame_at(T_map_camera, seed=seed, blank=blank))


def kept(view: SeenView) -> Keyframe:
    """A view as a keyframe of a store."""
    finest = view.grid.levels[0]
    return Keyframe.of_images(0.0, finest.intrinsics, finest.depth_m, finest.grey, view.features)


def ring(count: int = 24) -> list[FloatArray]:
    """Poses all round the room."""
    turns = 2 * np.pi * np.arange(count) / count
    return [standing(0.5 * np.cos(turn) - 0.5, 0.5 * np.sin(turn), turn) for turn in turns]
