"""Kernels of occupancy against plain Python, and a ray's cells against points all along it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from odometry.plain_kernels import plain

from wheelsight.mapping import occupancy_kernels as kernels

SIDE, CHANNELS, CELL_M = 60, 12, 0.1
BANDS = kernels.Bands(CELL_M, 0.05, 0.1, 0.015, 0.1, 1.05, 2.0, 5.0, 0.15, 0.5)
NO_NOISE = kernels.OccupancyNoise(0.0, 0.0, 0.0)
STEPS = kernels.Steps(28, -14, -64, 112)
MIDDLE = SIDE / 2 + 0.37


def window() -> kernels.Window:
    seen, touched = np.zeros((SIDE, SIDE, CHANNELS), np.uint8), np.zeros((SIDE * SIDE, 2), np.int32)
    return kernels.Window(seen, np.zeros((SIDE, SIDE), np.uint8), touched, np.zeros(1, np.int64))


def level(height_m: float) -> np.ndarray:
    """M (3, 4) of a camera in the window's middle that looks along x."""
    return np.array([[0, 0, 1 / CELL_M, MIDDLE], [-1 / CELL_M, 0, 0, MIDDLE], [0, -1.0, 0, height_m]])


def rays(depth_m: np.ndarray, focal_px: float = 20.0) -> kernels.DepthRays:
    h, w = depth_m.shape
    slopes = ((np.arange(size) - (size - 1) / 2) / focal_px for size in (w, h))
    return kernels.DepthRays(depth_m.astype(np.float32), *(slope.astype(np.float32) for slope in slopes))


def channel_of(h_m: float) -> int:
    """As docs/occupancy.md shows it; -1 for what is in none."""
    if not 0.05 <= h_m < 2.0:
        return -1
    return CHANNELS - 1 if h_m >= 1.05 else min(1 + int((h_m - 0.05) / 0.1), CHANNELS - 2)


@given(st.floats(0.3, 2.6), st.floats(0.2, 1.8), st.floats(-0.9, 0.9), st.floats(-0.9, 0.9))
def test_a_ray_passes_the_cells_that_points_along_it_lie_in(z: float, height_m: float, u: float, v: float) -> None:
    """Those alone; a corner that is cut between two points may be missed by the points."""
    alone = kernels.DepthRays(np.array([[z]], np.float32), np.array([u], np.float32), np.array([v], np.float32))
    found, M = window(), level(height_m)
    kernels.trace(alone, M, BANDS, NO_NOISE, found)
    end = M[:, :3] @ (np.float32(z) * np.array([np.float32(u), np.float32(v), 1.0])) + M[:, 3]
    way_m = CELL_M * np.hypot(*(end - M[:, 3])[:2])
    crossing = height_m / (height_m - end[2]) if end[2] < -0.1 - 0.015 * min(way_m, 5.0) else 1.0
    until = min(min(1.0, 5.0 / way_m), crossing - CELL_M / way_m)
    points = M[:, 3] + np.linspace(0, max(until, 0), 4000)[:, None] * (end - M[:, 3])
    passed = {(int(y), int(x), channel_of(h)) for x, y, h in points} if until > 0 else set()
    passed = {cell for cell in passed if cell[2] > 0}
    marked = {tuple(map(int, cell)) for cell in np.argwhere(found.seen[..., 1:] >= kernels.PASSED) + [0, 0, 1]}
    met = {tuple(map(int, cell)) for cell in np.argwhere(found.seen[..., 1:] == kernels.MET) + [0, 0, 1]}
    assert len(met) <= 1
    near_an_edge = {cell for cell in marked ^ passed if cell not in met and _is_inside(cell, M[:, 3], end, until)}
    assert near_an_edge == set()


def _is_inside(cell: tuple[int, ...], begin: np.ndarray, end: np.ndarray, until: float) -> bool:
    """Whether more than a hair of a ray lies in a cell and its layer."""
    row, column, channel = cell
    share = np.linspace(0, max(until, 0), 4000)
    x, y, h = (begin + share[:, None] * (end - begin)).T
    at = (np.floor(y) == row) & (np.floor(x) == column)
    return bool(np.count_nonzero(at & (np.array([channel_of(one) for one in h]) == channel)) > 3)


@pytest.mark.parametrize("height_m", [0.4, 1.1])
def test_compiled_and_plain_kernels_say_the_same(rng: np.random.Generator, height_m: float) -> None:
    depth_m = rng.uniform(0.3, 4.0, (18, 24))
    depth_m[rng.random(depth_m.shape) < 0.1] = 0
    noise = kernels.OccupancyNoise(0.001, 0.0014, 3.0)
    results: list[Any] = []
    for module in (kernels, plain(kernels)):
        found, table = window(), np.zeros((SIDE + 5, SIDE + 3, CHANNELS), np.int8)
        for _ in range(3):
            module.trace(rays(depth_m), level(height_m), BANDS, noise, found)
            module.stand(found, MIDDLE, MIDDLE, 2.5)
            seen = found.seen.copy()
            module.add(found, table, 5, 3, STEPS)
        assert not found.seen.any()
        assert not found.is_touched.any()
        results.append((seen, table))
    (seen, table), (plain_seen, plain_table) = results
    np.testing.assert_array_equal(seen, plain_seen)
    np.testing.assert_array_equal(table, plain_table)
    assert {0, kernels.HIDDEN, kernels.PASSED, kernels.MET} == set(np.unique(seen[..., 1:]).tolist())


def test_log_odds_are_of_what_was_reported_last_and_stay_within_bounds() -> None:
    found, table = window(), np.zeros((SIDE, SIDE, CHANNELS), np.int8)

    def tell(channel: int, what: int, times: int) -> int:
        for _ in range(times):
            found.seen[3, 4, channel], found.is_touched[3, 4] = what, 1
            found.touched[0], found.count[0] = (3, 4), 1
            kernels.add(found, table, 0, 0, STEPS)
        return int(table[3, 4, channel])

    assert [tell(2, kernels.MET, 1), tell(2, kernels.MET, 9), tell(2, kernels.PASSED, 1)] == [28, 112, 98]
    assert tell(2, kernels.PASSED, 30) == -64
    assert tell(2, kernels.HIDDEN, 3) == -64
    assert [tell(3, kernels.HIDDEN, 3), tell(3, kernels.PASSED, 1)] == [1, -14]
    assert [tell(4, kernels.HIDDEN, 1), tell(4, kernels.MET, 1)] == [1, 28]
    assert [tell(0, kernels.FLOOR, 1), tell(0, kernels.DROP, 2), tell(0, kernels.DROP, 20)] == [28, -28, -112]
    assert np.count_nonzero(table) == 4
