"""Maps of the synthetic room: half of a way round it, in whatever frame the drive had."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from places.seen_room import EXACT, kept, ring, seen

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam import RelativePose
from wheelsight.slam.maps import MapFolder

RING = ring(16)
SIGMAS = np.array([0.01, 0.01, 0.01, 0.005, 0.005, 0.005])


def aside(T: FloatArray, way_m: float) -> FloatArray:
    return np.asarray(T @ se3.exp([way_m, 0, 0, 0, 0, 0]))


def step(T: Sequence[FloatArray], number: int, sigmas: FloatArray = SIGMAS) -> RelativePose:
    """From a keyframe to the next."""
    first, second = KeyframeId(number), KeyframeId(number + 1)
    return RelativePose(first, second, se3.invert(T[number]) @ T[number + 1], np.diag(sigmas**2))


def write_seen(
    path: Path, way: Sequence[FloatArray], T_drive_map: FloatArray | None = None, *, room: int = 0, begin_s: float = 0.0
) -> list[FloatArray]:
    """A map of what was seen on a way, in a frame of its own; where its keyframes are in that."""
    drive = np.eye(4) if T_drive_map is None else T_drive_map
    T = [drive @ pose for pose in way]
    folder = MapFolder.create(path, EXACT, source=path.name)
    for number, pose in enumerate(way):
        view = replace(kept(seen(pose, seed=room)), stamp_s=begin_s + number)
        folder.append_keyframe(number, view, T[number], T[number])
    folder.append_edges([step(T, number) for number in range(len(T) - 1)])
    folder.close()
    return T
