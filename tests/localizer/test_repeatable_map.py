"""Tracking against the map that is built: another run does not change the result."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import Float32Array, FloatArray
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer

FRAMES = 100
CALIBRATION = Calibration.registered_camera(synthetic.CAMERA)


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    truth = synthetic.wobbling_trajectory(FRAMES)
    return [RgbdFrame(s, *synthetic.render_room(T, depth_noise=True), k) for k, (s, T) in enumerate(truth)]


def positions_m(frames: list[RgbdFrame]) -> tuple[FloatArray, Float32Array]:
    """Of the camera at each frame (n, 3), and of all surfels in the end (m, 3)."""
    localizer = Localizer(CALIBRATION, load_config(overrides={"odometry": "dense", "map": "surfels"}))
    estimates = [localizer.process(frame) for frame in frames]
    poses = [estimate.T_odom_body for estimate in estimates if estimate is not None]
    assert all(T is not None for T in poses)
    assert localizer.map is not None
    return np.array(poses)[:, :3, 3], localizer.map.surfels().position


@pytest.mark.slow
def test_two_runs_are_identical(frames: list[RgbdFrame]) -> None:
    for first, second in zip(positions_m(frames), positions_m(frames), strict=True):
        np.testing.assert_array_equal(first, second)
