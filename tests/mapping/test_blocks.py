"""Blocks: what is in view is found, memory has a bound, and compiled loops do as plain Python does."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from mapping.scenes import GRID, NOISE, SHAPE, Wall, fuse, look_at, made_map, pose, see
from odometry.plain_kernels import plain

from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.mapping import Surfels, blocks, surfels
from wheelsight.mapping import block_kernels as _block_kernels
from wheelsight.mapping import fusion_kernels as _fusion_kernels
from wheelsight.mapping import view_kernels as _view_kernels
from wheelsight.mapping.block_kernels import PAGE, STRAY_M, SurfelArrays
from wheelsight.mapping.blocks import Blocks

RULES = np.array([8.0, 3.0, 60.0, 1.0])


def scattered(rng: np.random.Generator, n: int, size_m: float = 20.0) -> SurfelArrays:
    """Surfels in balls of a hundred that hang on no keyframe."""
    geometry = np.zeros((n, 8), np.float32)
    middle = rng.uniform(-size_m, size_m, (n // 100 + 1, 3)).repeat(100, axis=0)[:n]
    geometry[:, :3] = middle + rng.normal(0, 0.05, (n, 3))
    geometry[:, 3], geometry[:, 6], geometry[:, 7] = 0.01, -1.0, rng.uniform(0.1, 50.0, n)
    return made_of(geometry)


def made_of(geometry: np.ndarray) -> SurfelArrays:
    n = len(geometry)
    looks = (np.full((n, 4), 100, np.float32), np.zeros((n, 2)), np.full(n, 1e-6, np.float32))
    return SurfelArrays(geometry, *looks, np.full(n, -1, np.int32))


def any_pose(rng: np.random.Generator) -> FloatArray:
    return se3.from_parts(so3.exp(rng.normal(0, 2, 3)), rng.uniform(-8, 8, 3))


def seen_of(points: np.ndarray, T_map_camera: FloatArray, far_m: float) -> np.ndarray:
    """By projecting all of them."""
    p = se3.apply(se3.invert(T_map_camera), points.astype(float))
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = GRID[0] * p[:, 0] / p[:, 2] + GRID[2], GRID[1] * p[:, 1] / p[:, 2] + GRID[3]
    inside = (u >= -0.5) & (u <= SHAPE[1] - 0.5) & (v >= -0.5) & (v <= SHAPE[0] - 0.5)
    return inside & (p[:, 2] > 0) & (p[:, 2] <= far_m)


@pytest.mark.parametrize("trial", range(8))
def test_every_surfel_in_view_is_in_the_pages_found_and_most_others_are_not(trial):
    rng = np.random.default_rng(trial)
    made, new = Blocks(0.5, 1 << 20), scattered(rng, 40_000, 10.0)
    assert made.append(new, 0.0, RULES) == 40_000
    T = any_pose(rng)
    pages = made.pages_in_view(T, GRID, SHAPE, 5.0, -np.inf)
    slots = (pages[:, None] * PAGE + np.arange(PAGE)).ravel()
    slots = slots[made.geometry[slots, 7] > 0]
    expected = np.flatnonzero(seen_of(made.geometry[:, :3], T, 5.0) & (made.geometry[:, 7] > 0))
    assert np.isin(expected, slots).all()
    assert len(np.unique(slots)) == len(slots) < 0.1 * 40_000


def test_what_is_in_view_costs_the_same_however_large_the_map_is(rng):
    near, T = scattered(rng, 5000, 3.0), pose()
    small, large = Blocks(0.5, 1 << 20), Blocks(0.5, 1 << 20)
    small.append(near, 0.0, RULES)
    large.append(near, 0.0, RULES)
    far = scattered(rng, 100_000, 20.0)
    far.geometry[:, 2] -= 40.0
    large.append(far, 0.0, RULES)
    found = [len(made.pages_in_view(T, GRID, SHAPE, 6.0, -np.inf)) for made in (small, large)]
    assert found[0] == found[1] > 0


def test_a_map_that_grows_is_not_copied_and_takes_the_memory_that_it_needs(rng):
    made = Blocks(0.5, 1 << 20)
    lies, empty = [array.ctypes.data for array in made.surfels], made.memory_bytes
    for _ in range(3):
        assert made.append(scattered(rng, 40_000), 0.0, RULES) == 40_000
    assert [array.ctypes.data for array in made.surfels] == lies, "a frame would wait for the copy"
    assert empty < 1e6
    assert 120_000 * 72 < made.memory_bytes < 120_000 * 72 * 2.5


def test_surfels_survive_sweeping_whole(rng):
    made, new = Blocks(0.5, 1 << 20), scattered(rng, 20_000, 3.0)
    made.append(new, 0.0, RULES)
    slots = made.slots()
    dead = slots[rng.random(len(slots)) < 0.6]
    kept = np.setdiff1d(slots, dead)
    expected = np.sort(made.geometry[kept], axis=0)
    made.geometry[dead, 7] = 0
    made.count_deaths(len(dead))
    assert made.sweep(0.0, RULES) == 0
    assert len(made.slots()) == made.alive == len(kept)
    np.testing.assert_array_equal(np.sort(made.geometry[made.slots()], axis=0), expected)
    used = made.memory_bytes
    assert made.append(SurfelArrays(*(part[:10_000] for part in new)), 0.0, RULES) == 10_000
    assert made.memory_bytes == used, "room of the dead is used again"


def test_memory_has_a_bound_and_the_least_useful_go_first(rng):
    made = Blocks(0.5, 4096)
    sure, doubtful, late = (scattered(rng, 1800, 1.0) for _ in range(3))
    sure.geometry[:, 7], doubtful.geometry[:, 7], late.geometry[:, 7] = 50.0, 0.5, 5.0
    for new, seen_s in ((sure, 100.0), (doubtful, 90.0), (late, 101.0)):
        new.seen_s[:] = seen_s
        new.geometry[:, :3] *= 0.3
        made.append(new, seen_s, np.array([8.0, 1000.0, 60.0, 1000.0]))
    confidence = made.geometry[made.slots(), 7]
    assert made.alive <= 4096
    assert made.dropped > 0
    assert made.alive + made.dropped == 3 * 1800
    assert np.count_nonzero(confidence == 50.0) == 1800
    assert np.count_nonzero(confidence == 0.5) < 1800


def test_a_long_drive_keeps_to_the_bound_and_says_what_it_dropped(rng):
    surfel_map = made_map(max_surfels=40_000)
    most = 0
    for k in range(40):
        T = pose(x=0.5 * k)
        fuse(surfel_map, see([Wall(2.0)], T, rng), T, 0.1 * k)
        assert len(surfel_map) <= 40_064
        most = max(most, surfel_map.memory_bytes)
    status = surfel_map.status()
    assert status.dropped == surfel_map.dropped > 40_000
    assert most < 40_000 * 80 + 4e6
    assert surfel_map.predict(T, GRID, SHAPE).depth_m.mean() > 1.0, "what is new finds room"


def test_positions_far_out_and_negative_find_their_blocks():
    made = Blocks(0.5, 1 << 14)
    geometry = np.zeros((4, 8), np.float32)
    geometry[:, :3] = [[1e3, -1e3, 5], [-0.01, -0.01, -0.01], [-1e4, 1e4, 0], [0.49, 0.51, 0]]
    geometry[:, 7] = 1
    made.append(made_of(geometry), 0.0, RULES)
    cells = {tuple(made.cell_xyz[made.page_cell[slot // PAGE]]) for slot in made.slots()}
    assert cells == {(2000, -2000, 10), (-1, -1, -1), (-20000, 20000, 0), (0, 1, 0)}


def uncompiled(module: ModuleType) -> SimpleNamespace:
    return SimpleNamespace(**(vars(module) | vars(plain(module))))


def test_compiled_loops_do_as_plain_python_does(monkeypatch, rng):
    grid, shape = np.array([26.0, 26.0, 15.8, 11.6]), (24, 32)
    walls = [Wall(2.0, slope=0.3), Wall(1.4, low=-0.1, high=0.1)]
    views = [see(walls[: 1 + (k < 4)], pose(0.02 * k), rng, grid, shape) for k in range(8)]

    monkeypatch.setattr("wheelsight.mapping.surfels._UNSTABLE_S", 0.15)

    def made() -> tuple[Surfels, list[np.ndarray]]:
        surfel_map = made_map(stable_confidence=3.0)
        for k, view in enumerate(views):
            surfel_map.fuse(view, grid, pose(0.02 * k), k / 30, NOISE)
        drawn = surfel_map.render(pose(0.1), grid, shape)
        return surfel_map.surfels(), [drawn.depth_m, drawn.normal, drawn.grey, drawn.color]

    compiled, compiled_view = made()
    monkeypatch.setattr(surfels, "fusion", uncompiled(_fusion_kernels))
    monkeypatch.setattr(surfels, "view", uncompiled(_view_kernels))
    monkeypatch.setattr(blocks, "kernels", uncompiled(_block_kernels))
    with np.errstate(all="ignore"):
        in_python, view_in_python = made()
    for name in Surfels.__slots__:
        np.testing.assert_allclose(getattr(in_python, name), getattr(compiled, name), rtol=1e-4, atol=1e-6)
    for first, second in zip(view_in_python, compiled_view, strict=True):
        np.testing.assert_allclose(first, second, rtol=1e-3, atol=1e-3)


def test_surfels_may_stray_from_their_block_only_as_far_as_it_is_looked_for(monkeypatch):
    monkeypatch.setattr("wheelsight.mapping.surfels._BLOCK_M", 0.1)
    surfel_map = made_map()
    for k in range(60):
        look_at(surfel_map, [Wall(2.02 + 0.003 * k)], [pose()], start_s=0.05 * k)
    made = surfel_map.blocks
    slots = made.slots()
    cells = made.cell_xyz[made.page_cell[slots // PAGE]]
    low = cells * 0.1
    stray = np.maximum(low - made.geometry[slots, :3], made.geometry[slots, :3] - low - 0.1).max()
    assert 0.0 < stray <= 0.05 + 1e-4


def test_a_floor_between_two_blocks_takes_no_more_memory_where_loops_move_it_up_and_down(rng):
    """All surfels of a floor left their block at each move by a millimetre, and what they left was free too late."""
    made, n = Blocks(0.5, 1 << 18), 50_000
    geometry = np.zeros((n, 8), np.float32)
    geometry[:, :2], geometry[:, 2] = rng.uniform(-5, 5, (n, 2)), rng.normal(0.0, 0.005, n)
    geometry[:, 3], geometry[:, 6], geometry[:, 7] = 0.01, 1.0, 20.0
    made.append(made_of(geometry), 0.0, RULES)
    took = made.memory_bytes
    for way_m in (*(0.02, -0.02) * 3, 0.02):
        made.move(np.array([se3.from_parts(np.eye(3), [0.0, 0.0, way_m])]), 0.0, RULES)
        made.sweep(0.0, RULES)
    assert made.alive == n
    assert made.memory_bytes < 1.2 * took
    slots = made.slots()
    cells = made.cell_xyz[made.page_cell[slots // PAGE]]
    stray = np.abs(made.geometry[slots, :3] - 0.5 * (cells + 0.5)).max() - 0.25
    assert 0.0 < stray <= STRAY_M + 1e-6
    made.move(np.array([se3.from_parts(np.eye(3), [0.0, 0.0, 0.1])]), 0.0, RULES)
    slots = made.slots()
    assert (made.cell_xyz[made.page_cell[slots // PAGE], 2] == 0).mean() > 0.99


def test_a_map_that_loops_move_far_takes_its_memory_once(rng):
    """As at the end of a first lap: all surfels left their block at each move, faster than the sweep came by."""
    made = Blocks(0.5, 1 << 20)
    made.append(scattered(rng, 100_000), 0.0, RULES)
    took = made.memory_bytes
    for _ in range(4):
        made.move(np.array([se3.from_parts(np.eye(3), [0.6, 0.0, 0.0])]), 0.0, RULES)
        made.sweep(0.0, RULES)
    assert made.alive == 100_000
    assert made.memory_bytes < 1.5 * took
