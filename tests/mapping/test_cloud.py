"""A map as few points: how many, where, and that both sides of a wall stay apart."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.geometry import FloatArray
from wheelsight.mapping import Surfels
from wheelsight.mapping.plan import cloud_of


def sheet(count: int, x: float, normal_x: float, color: float, rng: np.random.Generator) -> Surfels:
    """A wall of 4 m by 3 m at x, seen from one side."""
    position = np.column_stack([np.full(count, x), rng.uniform((0, 0), (4, 3), (count, 2))]).astype(np.float32)
    normal = np.tile(np.array([normal_x, 0, 0], np.float32), (count, 1))
    flat = np.ones(count, np.float32)
    colors = np.tile(np.array([color, 0, 255 - color], np.float32), (count, 1))
    seen = (np.zeros(count), np.zeros(count), np.full(count, -1, np.int32))
    return Surfels(position, normal, 0.02 * flat, colors, 90 * flat, 9 * flat, 1e-6 * flat, *seen)


def both(*parts: Surfels) -> Surfels:
    return Surfels(*(np.concatenate([getattr(part, name) for part in parts]) for name in Surfels.__slots__))


def pieces_of(surfels: Surfels) -> list[Surfels]:
    """Of uneven lengths, one of them empty."""
    cuts = (slice(0, 30), slice(30, 30), slice(30, 7000), slice(7000, None))
    return [Surfels(*(getattr(surfels, name)[cut] for name in Surfels.__slots__)) for cut in cuts]


def made(surfels: Surfels, most: int) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    cloud = cloud_of(lambda: pieces_of(surfels), most)
    assert cloud is not None
    assert cloud.of == len(surfels.grey)
    return cloud.position.astype(float), cloud.normal.astype(float), cloud.color.astype(float), cloud.edge_m


@pytest.mark.parametrize("most", [100, 1000, 5000])
def test_it_has_nearly_as_many_points_as_it_may_and_they_cover_the_wall(most: int, rng: np.random.Generator) -> None:
    surfels = sheet(40_000, 1.0, 1.0, 200, rng)
    position, _, _, edge_m = made(surfels, most)
    assert 0.7 * most < len(position) <= most
    assert edge_m == pytest.approx(np.sqrt(12 / most), rel=0.25)
    spots = rng.uniform((0, 0), (4, 3), (200, 2))
    nearest = np.linalg.norm(position[None, :, 1:] - spots[:, None], axis=2).min(axis=1)
    assert nearest.max() < 1.5 * edge_m
    np.testing.assert_allclose(position[:, 0], 1.0)


def test_both_sides_of_a_thin_wall_stay_apart(rng: np.random.Generator) -> None:
    surfels = both(sheet(20_000, 1.0, 1.0, 200, rng), sheet(20_000, 1.0, -1.0, 20, rng))
    _, normal, color, _ = made(surfels, 2000)
    np.testing.assert_allclose(np.abs(normal[:, 0]), 1.0)
    np.testing.assert_allclose(color[normal[:, 0] > 0], [[200, 0, 55]] * int((normal[:, 0] > 0).sum()))
    np.testing.assert_allclose(color[normal[:, 0] < 0], [[20, 0, 235]] * int((normal[:, 0] < 0).sum()))


def test_few_surfels_are_the_points_themselves(rng: np.random.Generator) -> None:
    surfels = sheet(50, 1.0, 1.0, 200, rng)
    position, _, _, edge_m = made(surfels, 50)
    np.testing.assert_array_equal(position, surfels.position)
    assert edge_m == 0


def test_all_in_one_place_is_one_point(rng: np.random.Generator) -> None:
    surfels = sheet(50, 1.0, 1.0, 200, rng)
    surfels.position[:] = (1, 2, 3)
    position, *_ = made(surfels, 10)
    np.testing.assert_allclose(position, [[1, 2, 3]])


def test_nothing_is_no_cloud(rng: np.random.Generator) -> None:
    assert cloud_of(lambda: [sheet(0, 1.0, 1.0, 200, rng)], 10) is None
    assert cloud_of(lambda: [sheet(10, 1.0, 1.0, 200, rng)], 0) is None
