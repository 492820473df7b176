"""Which way is up, by surfels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.geometry import FloatArray, so3
from wheelsight.mapping import Surfels
from wheelsight.mapping.plan import upward

# A camera held upright in a world whose z points up, looking along x.
LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
UP = np.array([0.0, 0.0, 1.0])


def facing(*groups: tuple[FloatArray, int], spread_rad: float = 0.0, radius_m: float = 0.01) -> Surfels:
    """So many surfels of each normal, which is turned a little at random."""
    rng = np.random.default_rng(3)
    normal = np.concatenate([np.tile(n, (count, 1)) for n, count in groups])
    turns = so3.exp(spread_rad * rng.standard_normal((len(normal), 3)))
    normal = np.einsum("nij,nj->ni", turns, normal).astype(np.float32)
    n, flat = len(normal), np.ones(len(normal), np.float32)
    return Surfels(
        np.zeros((n, 3), np.float32), normal, radius_m * flat, np.full((n, 3), -1.0, np.float32),
        100 * flat, 9 * flat, 1e-6 * flat, np.zeros(n), np.zeros(n), np.full(n, -1, np.int32),
    )  # fmt: skip


def angle_deg(a: FloatArray, b: FloatArray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


@given(pitch=st.floats(-0.6, 0.6), roll=st.floats(-0.3, 0.3))
def test_a_floor_shows_it_however_the_camera_was_tilted(pitch: float, roll: float) -> None:
    surfels = facing((UP, 800), (np.array([-1.0, 0, 0]), 3000), (-UP, 2000), spread_rad=0.05)
    R_map_camera = so3.exp([0.0, pitch, 0.0]) @ so3.exp([roll, 0.0, 0.0]) @ LEVEL
    assert angle_deg(upward(lambda: [surfels], R_map_camera), UP) < 0.5


def test_a_floor_counts_for_more_than_a_ramp_that_is_smaller():
    ramp = np.array([-np.sin(0.5), 0.0, np.cos(0.5)])
    surfels = facing((UP, 900), (ramp, 300), spread_rad=0.03)
    assert angle_deg(upward(lambda: [surfels], so3.exp([0.0, 0.3, 0.0]) @ LEVEL), UP) < 0.5


@pytest.mark.parametrize("surfels", [facing((np.array([-1.0, 0, 0]), 500)), facing((UP, 40))], ids=["wall", "crumb"])
def test_where_nothing_shows_it_is_the_cameras_own(surfels: Surfels) -> None:
    R_map_camera = so3.exp([0.1, 0.2, 0.0]) @ LEVEL
    np.testing.assert_allclose(upward(lambda: [surfels], R_map_camera), -R_map_camera[:, 1])
