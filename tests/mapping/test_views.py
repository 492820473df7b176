"""Predicted views against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from mapping.scenes import GRID, SHAPE, Wall, look_at, made_map, pose, see
from narrowing import not_none

from wheelsight.core.errors import MapError
from wheelsight.mapping import Surfels

FRAMES = 12


@pytest.mark.parametrize("slope", [0.0, 0.7, -0.4])
@pytest.mark.parametrize("T", [pose(), pose(0.15, 0.1, 0.2, -0.05), pose(z=-0.6), pose(z=0.7)], ids=repr)
def test_a_fused_plane_is_predicted_where_it_is(slope, T):
    surfel_map, wall = made_map(), Wall(2.0, slope=slope)
    look_at(surfel_map, [wall], [pose()] * FRAMES)
    view, truth = surfel_map.predict(T, GRID, SHAPE), see([wall], T)
    inner = view.depth_m[20:-20, 25:-25] > 0
    there = view.depth_m > 0
    if T[2, 3] >= 0:
        assert inner.mean() > 0.97, "holes"
    assert np.abs(view.depth_m - truth.depth_m)[there].max() < 1e-3
    assert (view.normal[there] * truth.normal[there]).sum(axis=1).min() > 0.999
    # Grey is interpolated between surfels; the pattern's amplitude is 60.
    assert np.abs(view.grey - truth.grey)[there].mean() < 2.0


def test_from_where_it_was_seen_there_are_no_holes():
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.0, slope=0.5)], [pose()] * FRAMES)
    assert surfel_map.predict(pose(), GRID, SHAPE).depth_m.all()


def test_where_nothing_was_seen_nothing_is_predicted():
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.0, low=0.0)], [pose()] * FRAMES)
    view = surfel_map.predict(pose(), GRID, SHAPE)
    empty = see([Wall(2.0, low=0.05)], pose()).depth_m == 0
    empty[:, int(GRID[2]) - 2 :] = False
    assert empty.any()
    assert not view.depth_m[empty].any()
    assert not view.normal[empty].any()
    assert (view.grey[empty] == -1).all()
    assert (view.depth_m[see([Wall(2.0, low=0.03)], pose()).depth_m > 0] > 0).all()


def test_an_empty_map_predicts_nothing():
    view = made_map().predict(pose(), GRID, SHAPE)
    assert view.depth_m.shape == view.grey.shape == SHAPE
    assert not view.depth_m.any()
    assert (view.grey == -1).all()
    assert (made_map().render(pose(), GRID, SHAPE).color == -1).all()


def test_the_nearer_of_two_surfaces_hides_the_other():
    surfel_map = made_map()
    wall, board = Wall(3.0), Wall(1.5, low=-0.3, high=0.3)
    look_at(surfel_map, [wall], [pose()] * FRAMES)
    look_at(surfel_map, [wall, board], [pose()] * FRAMES, start_s=1.0)
    view = surfel_map.predict(pose(), GRID, SHAPE)
    truth = see([wall, board], pose())
    assert np.mean(np.abs(view.depth_m - truth.depth_m) < 1e-3) > 0.97


def test_unstable_surfels_show_only_where_no_stable_one_does():
    surfel_map = made_map()
    wall, passing = Wall(3.0, low=-0.6), Wall(1.5)
    look_at(surfel_map, [wall], [pose()] * 40)
    look_at(surfel_map, [passing], [pose()] * 2, start_s=2.0)
    depth_m = surfel_map.predict(pose(), GRID, SHAPE).depth_m
    was_wall = see([Wall(3.0, low=-0.55)], pose()).depth_m > 0
    assert (np.abs(depth_m[was_wall] - 3.0) < 1e-3).all()
    was_empty = see([Wall(3.0, high=-0.65)], pose()).depth_m > 0
    assert (np.abs(depth_m[was_empty] - 1.5) < 1e-3).all()


def test_unstable_disks_reach_out_from_beside_stable_ones_only():
    # One stable surfel, and unstable ones farther off: in its middle, half hidden by it, and all beside it.
    middles = np.array([[0.0, 0, 1], [0.005, 0, 1.2], [0.08, 0, 1.2], [0.4, 0, 1.2]], np.float32)
    n, facing = len(middles), np.array([0, 0, -1], np.float32)
    grey, confidence = np.array([10, 20, 30, 40], np.float32), np.array([20, 1, 1, 1], np.float32)
    looks = (np.full(n, 0.05, np.float32), np.repeat(grey[:, None], 3, axis=1), grey, confidence)
    surfel_map = made_map()
    seen = (np.zeros(n), np.zeros(n), np.full(n, -1, np.int32))
    surfel_map.add(Surfels(middles, np.tile(facing, (n, 1)), *looks, np.full(n, 1e-6, np.float32), *seen), 0.0)
    view = surfel_map.predict(pose(), GRID, SHAPE)
    shades, counts = np.unique(np.round(view.grey), return_counts=True)
    np.testing.assert_array_equal(shades, [-1, 10, 30, 40])
    stable, half, beside = counts[1:]
    assert stable == pytest.approx(np.pi * (0.05 * GRID[0]) ** 2, rel=0.1)
    assert beside == pytest.approx(stable / 1.44, rel=0.1)
    assert 0 < half < beside
    np.testing.assert_allclose(view.depth_m[np.round(view.grey) == 30], 1.2, rtol=1e-5)


def test_the_back_of_a_surface_is_not_shown():
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.0)], [pose()] * FRAMES)
    assert not surfel_map.predict(pose(z=4.0, yaw=np.pi), GRID, SHAPE).depth_m.any()


def test_color_is_rendered_as_it_was_seen():
    surfel_map, wall = made_map(), Wall(2.0)
    look_at(surfel_map, [wall], [pose()] * FRAMES)
    view, truth = surfel_map.render(pose(), GRID, SHAPE, "stable"), see([wall], pose())
    there = view.depth_m > 0
    assert np.abs(view.color - not_none(truth.color))[there].mean() < 2.0
    np.testing.assert_allclose(view.color[there][:, 0], view.grey[there], atol=0.01)


def test_another_camera_may_look_at_the_map():
    surfel_map, wall = made_map(), Wall(2.0, slope=0.3)
    look_at(surfel_map, [wall], [pose()] * FRAMES)
    grid, shape = np.array([340.0, 345.0, 199.5, 149.5]), (300, 400)
    view, truth = surfel_map.predict(pose(), grid, shape), see([wall], pose(), grid=grid, shape=shape)
    assert (view.depth_m > 0).mean() > 0.99
    there = view.depth_m > 0
    assert np.abs(view.depth_m - truth.depth_m)[there].max() < 2e-3


def test_a_pose_that_is_none_is_refused():
    with pytest.raises(MapError, match="T_map_camera"):
        made_map().predict(np.full((4, 4), np.nan), GRID, SHAPE)


@pytest.mark.parametrize("turn", [0.0, 0.3, -0.3])
def test_the_floor_under_a_camera_that_looks_along_it_has_no_holes(turn):
    """A disk beside the axis is wide in the image by perspective alone where its plane holds the axis."""
    surfel_map = made_map()
    across, along = np.meshgrid(np.arange(-2.0, 2.0, 0.02), np.arange(0.4, 4.0, 0.02))
    spots = np.stack([across.ravel(), np.full(across.size, 0.8), along.ravel()], axis=-1).astype(np.float32)
    flat = np.ones(len(spots), np.float32)
    normal = np.tile(np.array([0, -1, 0], np.float32), (len(spots), 1))
    color, stamps_s = np.full((len(spots), 3), 90, np.float32), np.zeros(len(spots))
    seen = (stamps_s, stamps_s, np.full(len(spots), -1, np.int32))
    surfel_map.add(Surfels(spots, normal, 0.015 * flat, color, 90 * flat, 20 * flat, 1e-6 * flat, *seen), 0.0)
    view = surfel_map.predict(pose(0.0, 0.0, 0.0, turn), GRID, SHAPE)
    y = (np.arange(SHAPE[0]) - GRID[3]) / GRID[1]
    depth_m = np.broadcast_to(np.divide(0.8, y, out=np.full_like(y, np.inf), where=y > 0)[:, None], SHAPE)
    is_floor = (depth_m > 0.7) & (depth_m < 2.5)
    is_floor[:, :10] = is_floor[:, -10:] = False
    assert is_floor.sum() > 1000
    assert (view.depth_m[is_floor] > 0).mean() > 0.999
