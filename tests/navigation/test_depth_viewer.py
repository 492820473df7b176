"""What a collision monitor is reported a depth image, and what it forgets by it: made floors, walls and boxes."""

from __future__ import annotations

import numpy as np
import pytest
from navigation.floors import CHAIR
from navigation.test_live_layer import CALIBRATION, CAMERA, T_BASE_CAMERA, Box, depth_of
from odometry.plain_kernels import plain

from wheelsight.core.geometry import FloatArray
from wheelsight.navigation import DepthViewer
from wheelsight.navigation import costmap_kernels as kernels
from wheelsight.navigation.collision_monitor import AIR_M, FloorMemory
from wheelsight.navigation.perception import DepthView
from wheelsight.navigation.settings import MonitorSettings, outline_of

AHEAD_M, HEIGHT_M = float(T_BASE_CAMERA[0, 3]), float(T_BASE_CAMERA[2, 3])
VIEWER = DepthViewer(CALIBRATION, CHAIR)


def bearings(view: DepthView) -> FloatArray:
    """(B,) of the middles of its columns."""
    return np.asarray(view.first_rad + (np.arange(len(view.seen_m)) + 0.5) * view.step_rad)


@pytest.mark.parametrize("away_m", [0.6, 1.0, 1.6])
def test_each_bearing_sees_up_to_a_wall_that_hides_all_floor(away_m: float) -> None:
    """A robot may stand so before one, and no one who sees a wall is blind."""
    face_m = AHEAD_M + away_m
    view = VIEWER.view(depth_of([(face_m, face_m + 0.1, -5.0, 5.0, 0.0, 3.0)]), 0.0)
    assert view.near_m > away_m
    assert view.share == 1.0
    # A bearing's end is nearer than its middle.
    assert np.abs(view.seen_m - away_m / np.cos(bearings(view))).max() < 0.01


def test_beside_a_thing_the_view_goes_on() -> None:
    view = VIEWER.view(depth_of([(1.35, 1.45, 0.0, 0.3, 0.0, 1.7), (4.0, 4.1, -5.0, 5.0, 0.0, 3.0)]), 0.0)
    left_rad, at = np.arctan2(0.3, 1.0), bearings(view)
    # A bearing at an outline shows both.
    is_beside = (at > left_rad + view.step_rad) | (at < -view.step_rad)
    is_before = (at < left_rad - view.step_rad) & (at > view.step_rad)
    assert view.seen_m[is_beside].min() > 3.0
    assert view.seen_m[is_before].max() < 1.01 / np.cos(left_rad)


def test_specks_hide_nothing() -> None:
    wall = depth_of([(4.0, 4.1, -5.0, 5.0, 0.0, 3.0)])
    specked = wall.copy()
    specked[60, 20], specked[40, 100:102] = 0.8, 0.8
    np.testing.assert_array_equal(VIEWER.view(specked, 0.0).seen_m, VIEWER.view(wall, 0.0).seen_m)


def test_kernels_equal_their_plain_form() -> None:
    depth = depth_of([(1.35, 1.45, -0.2, 0.2, 0.0, 1.7)], floor_until_m=3.0)[::4, ::4].copy()
    depth[-4:, :8] = 0
    ways = CAMERA.rays()[::4, ::4] @ T_BASE_CAMERA[:3, :3].T
    columns = np.tile(np.arange(40, dtype=np.int16) - 1, (30, 1))
    floor_m = np.where(ways[..., 2] < 0, np.hypot(ways[..., 0], ways[..., 1]) * HEIGHT_M / np.abs(ways[..., 2]), 0)
    floor_m = np.where(floor_m < 4.5, floor_m, 0).astype(np.float32)
    rays = kernels.Rays(np.ascontiguousarray(ways, np.float32), columns, T_BASE_CAMERA[:3, 3].copy(), floor_m)
    heights, results = kernels.ViewHeights(0.05, 0.1, 0.015, 1.4, 4.5), []
    for module in (kernels, plain(kernels)):
        shown = kernels.ViewContent(
            np.zeros((39, 45), np.uint8),
            np.zeros((200, 200, 3), np.float32),
            np.zeros((200, 200, 3), np.float32),
            np.zeros(39, np.int64),
            np.zeros((39, 45, 2), np.int64),
            np.full((39, 45), np.inf),
            0.1,
            0.05,
        )
        module.sort_pixels(depth, rays, heights, shown)
        nearest_m = np.full(39, np.inf)
        module.reach(depth, rays, heights, shown, shown.cells[..., 0] >= 3, nearest_m)
        results.append(
            (shown.floor, shown.measured, shown.cells, shown.tops, shown.lacks[..., 0], shown.lacks_m, nearest_m)
        )
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)
    assert {bool(one.any()) for one in results[0]} == {True}
    assert np.isfinite(results[0][-1]).any()
    assert not np.isfinite(results[0][-1]).all()


def box(away_m: float, height_m: float) -> Box:
    """So far before the camera."""
    near = AHEAD_M + away_m
    return (near, near + 0.02, -0.15, 0.15, 0.0, height_m)


@pytest.mark.parametrize("height_m", [0.2, 0.45, 0.6])
def test_so_near_as_it_says_a_thing_shows_and_no_nearer(height_m: float) -> None:
    view = VIEWER.view(depth_of([box(2.5, height_m)]), 1.0)
    assert view.shows_m is not None
    front = view.points[:, 0] < AHEAD_M + 2.53
    shows_m = float(view.shows_m[front].min())
    # Three rows of pixels make a thing: from 2.5 m off that is 5 cm of its height, and as much where it comes near.
    slope = view.near_m / HEIGHT_M
    assert shows_m == pytest.approx(slope * (HEIGHT_M - height_m), abs=0.06 * slope)
    assert len(VIEWER.view(depth_of([box(shows_m + 0.1, height_m)]), 1.0).points)
    # It says it of all bearings; ahead the lowest ray meets the floor nearer than at the sides.
    assert not len(VIEWER.view(depth_of([box(0.8 * shows_m, height_m)]), 1.0).points)


@pytest.mark.parametrize(("height_m", "is_left"), [(1.3, False), (0.2, True)])
def test_who_has_left_is_forgotten_nearer_than_the_floor_is_seen_but_a_low_box_is_not(
    height_m: float, is_left: bool
) -> None:
    """Seen once, from afar; then looked over from so near that the floor there does not show."""
    known = FloorMemory(outline_of(CHAIR), MonitorSettings().fresh_s)
    known.add_reading(0.0, 0.0, 0.0)
    known.add_view(VIEWER.view(depth_of([box(2.5, height_m)]), 0.0))
    known.add_reading(0.2, 0.0, 0.0, rolled=(1.6, 0.0))
    no_one = VIEWER.view(depth_of([]), 0.2)
    assert no_one.near_m > 0.9 > AIR_M
    known.add_view(no_one)
    pose = known.pose_at(0.2)
    assert pose is not None
    assert bool(len(known.points_at(pose, 0.2, 2.0))) is is_left


def test_as_high_as_its_pixels_say_and_not_as_a_single_one() -> None:
    """At an edge a ray may measure a mean of near and far."""
    depth = depth_of([box(2.5, 0.2)])
    low = VIEWER.view(depth, 1.0).shows_m
    depth[70, 80] = 2.5
    flying = VIEWER.view(depth, 1.0).shows_m
    assert low is not None
    assert flying is not None
    np.testing.assert_array_equal(flying, low)


def test_a_cell_that_a_tall_thing_grazes_is_as_tall() -> None:
    """Three low pixels of it lie in the cell before."""
    depth = depth_of([box(2.5, 1.3)])
    rows, ahead = np.flatnonzero(np.abs(depth[:, 80] - 2.5) < 1e-3), depth.copy()
    ahead[rows[-20:-17], 80] = 2.46
    grazed, plain = VIEWER.view(ahead, 1.0), VIEWER.view(depth, 1.0)
    assert grazed.shows_m is not None
    assert len(grazed.points) == len(plain.points) + 1
    assert (grazed.shows_m < AIR_M).all()
