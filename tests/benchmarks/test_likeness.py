"""Likeness: ways are laid upright where depths are likest, and residuals are those of the depth that was put in."""

from __future__ import annotations

import numpy as np
import pytest
from small_rooms import looking, room, wall

from benchmarks.likeness_desk import desk_world
from benchmarks.likeness_residuals import residuals
from benchmarks.likeness_ways import QUANTILES, placed, upright
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import PinholeCamera, se3, so3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim.scene import Scene

CAMERA = PinholeCamera(160, 120, 146, 146, 79.5, 59.5)


def test_a_way_is_laid_upright_at_its_height() -> None:
    stamps_s = np.arange(5.0)
    level = looking(z=0.3, pitch=0.4) @ se3.exp(stamps_s[:, None] * [0.1, 0, 0.2, 0, 0.1, 0])
    tilt = se3.from_parts(so3.exp([0.5, -0.8, 0.3]), np.array([3.0, 2.0, 1.0]))
    up = tilt[:3, :3] @ np.array([0, 0, 1.0])
    way = upright(Trajectory(stamps_s, tilt @ level), up, 1.4)
    assert way.positions_m[:, 2].mean() == pytest.approx(1.4)
    np.testing.assert_allclose(way.T_frame_body[:, 2, :3], level[:, 2, :3], atol=1e-9)
    np.testing.assert_allclose(np.diff(way.positions_m[:, 2]), np.diff(level[:, 2, 3]), atol=1e-9)


def test_a_way_is_laid_where_depths_are_likest() -> None:
    world, stamps_s = desk_world(1), np.arange(4.0)
    there = (
        se3.from_plane(0.3, -0.6, 0.0) @ looking(z=1.5, pitch=0.7) @ se3.exp(stamps_s[:, None] * [0.05, 0, 0, 0, 0, 0])
    )
    scene = Scene(world, threads=1)
    depths = [np.quantile(scene.cast(CAMERA, T).depth_m, QUANTILES) for T in there]
    away = se3.from_plane(20.0, 5.0, 1.0)
    found = placed(Trajectory(stamps_s, away @ there), world, np.mean(depths, axis=0))
    assert found.unlike < 0.15  # places are tried every 30 cm, in eight directions
    assert np.hypot(*found.way.positions_m[:, :2].mean(axis=0)) < 2.5


def test_the_desk_is_another_with_another_seed() -> None:
    assert desk_world(1).mjcf == desk_world(1).mjcf != desk_world(2).mjcf


@pytest.mark.parametrize(("noise_per_m", "grey"), [(0.0, 0), (0.003, 5)])
def test_residuals_are_what_was_put_in(rng: np.random.Generator, noise_per_m: float, grey: int) -> None:
    scene = Scene(room(wall(3.0, 0.4)), threads=1)
    stamps_s = np.arange(11.0) * 0.1
    way = looking() @ se3.exp(stamps_s[:, None] * [0.1, 0, 0.2, 0, 0.05, 0])
    frames = []
    for k, T in enumerate(way):
        depth_m = scene.cast(CAMERA, T).depth_m
        depth_m = depth_m + noise_per_m * depth_m**2 * rng.standard_normal(depth_m.shape, np.float32)
        levels = np.rint(
            100 + 10 * k + rng.normal(0, grey, depth_m.shape)
        )  # brighter from frame to frame, as by exposure
        frames.append(RgbdFrame(stamps_s[k], np.repeat(levels[..., None], 3, axis=2).astype(np.uint8), depth_m, k))
    found = residuals(frames, Trajectory(stamps_s, way), Calibration.registered_camera(CAMERA))
    assert found is not None
    # The median of |difference of two normal numbers| is 0.95 σ; a wall's neighbouring pixels add a little.
    assert found.depth_per_m == pytest.approx(0.954 * noise_per_m, rel=0.1, abs=6e-4)
    assert found.grey == pytest.approx(0.954 * grey, abs=0.6)
