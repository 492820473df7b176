"""Keyframes to test with: small, each unlike the others, of a camera that is at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId
from wheelsight.slam import RelativePose
from wheelsight.slam.maps import MapFolder, SessionSettings

CAMERA = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
CALIBRATION = Calibration.registered_camera(CAMERA, source="made up")
COUNT = 7
SETTINGS = SessionSettings()
INTRINSICS = np.array([60.0, 60.0, 31.5, 23.5])


def keyframe(number: int, keypoints: int | None = 20, size: tuple[int, int] = (48, 64)) -> Keyframe:
    rng = np.random.default_rng(number)
    depth_m = rng.uniform(0.5, 4.0, size).astype(np.float32)
    depth_m[rng.random(size) < 0.2] = 0
    grey = rng.integers(0, 256, size).astype(np.float32)
    features = None
    if keypoints is not None:
        points = rng.uniform(0.5, 4.0, (keypoints, 3))
        points[::4] = 0
        px = rng.uniform(0, 48, (keypoints, 2))
        features = KeyframeFeatures(px, points, rng.integers(0, 2**63, (keypoints, 4)).astype(np.uint64))
    return Keyframe.of_images(float(number), INTRINSICS, depth_m, grey, features)


def pose(number: int) -> np.ndarray:
    return se3.exp([0.3 * number, 0.1, 0.0, 0.0, 0.0, 0.05 * number])


def edge(first: int, second: int, *, is_loop: bool = False) -> RelativePose:
    T = se3.invert(pose(first)) @ pose(second)
    return RelativePose(KeyframeId(first), KeyframeId(second), T, np.diag([1e-4] * 6), is_loop)


def write_map(path: Path, count: int = 7, settings: SessionSettings = SETTINGS) -> None:
    """A map of so many keyframes, three in each journal, with an edge from each to the next."""
    folder = MapFolder.create(path, CALIBRATION, settings, source="made up")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("wheelsight.slam.maps.folder._JOURNAL_KEYFRAMES", 3)
        for number in range(count):
            folder.append_keyframe(number, keyframe(number), pose(number), pose(number))
            if number:
                folder.append_edges([edge(number - 1, number)])
    folder.close()
