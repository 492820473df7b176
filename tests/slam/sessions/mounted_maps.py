"""Maps of a robot whose camera sits in a known place: a way round a room with a floor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mapping.floor_scenes import INTRINSICS, ROBOT, depth_of, turning
from sessions.seen_maps import step

from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import Keyframe, KeyframeStore
from wheelsight.slam.maps import MapFolder, MapWriter, SessionSettings

WAY = turning(6)


def view(T_map_camera: FloatArray, stamp_s: float) -> Keyframe:
    depth_m = depth_of(T_map_camera)
    rng = np.random.default_rng(int(stamp_s))
    return Keyframe.of_images(stamp_s, INTRINSICS, depth_m, rng.integers(1, 255, depth_m.shape).astype(np.float32))


def drive(path: Path, way: list[FloatArray], settings: SessionSettings | None = None) -> MapWriter:
    """A drive that is over, whose map is not yet finished."""
    store = KeyframeStore()
    writer = MapWriter(MapFolder.create(path, ROBOT, settings), store)
    for number, T in enumerate(way):
        store.add(view(T, float(number)), T)
        writer.update(None)
    writer.add_edges([step(way, number) for number in range(len(way) - 1)])
    return writer
