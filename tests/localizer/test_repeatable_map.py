"""Tracking against the map that is built: neither threads nor another run change what comes of it."""

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


def positions_m(frames: list[RgbdFrame], threads: int) -> tuple[FloatArray, Float32Array]:
    """Of the camera at each frame (n, 3), and of all surfels in the end (m, 3)."""
    settings = {"odometry": "dense", "map": "surfels", "dense.threads": threads, "surfels.threads": threads}
    localizer = Localizer(CALIBRATION, load_config(overrides=settings))
    estimates = [localizer.process(frame) for frame in frames]
    poses = [estimate.T_odom_body for estimate in estimates if estimate is not None]
    assert all(T is not None for T in poses)
    assert localizer.map is not None
    return np.array(poses)[:, :3, 3], localizer.map.surfels().position


@pytest.mark.slow
def test_threads_agree_and_two_runs_are_identical(frames: list[RgbdFrame]) -> None:
    single, twice, again = (positions_m(frames, threads) for threads in (1, 2, 2))
    np.testing.assert_allclose(twice[0], single[0], atol=1e-4)
    for first, second in zip(twice, again, strict=True):
        np.testing.assert_array_equal(first, second)
