"""What a collision monitor is told of a depth image: made floors, walls and boxes, by rays in plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from navigation.floors import CHAIR
from navigation.test_live_layer import CALIBRATION, CAMERA, T_BASE_CAMERA, depth_of
from odometry.plain_kernels import plain

from wheelsight.geometry import FloatArray
from wheelsight.navigation import DepthViewer
from wheelsight.navigation import _depth_view_kernels as kernels
from wheelsight.navigation.surroundings import DepthView

AHEAD_M = float(T_BASE_CAMERA[0, 3])
VIEWER = DepthViewer(CALIBRATION, CHAIR)


def bearings(view: DepthView) -> FloatArray:
    """(B,) of the middles of its columns."""
    return np.asarray(view.first_rad + (np.arange(len(view.seen_m)) + 0.5) * view.step_rad)


@pytest.mark.parametrize("away_m", [0.6, 1.0, 1.6])
def test_each_bearing_sees_up_to_a_wall_that_hides_all_floor(away_m: float) -> None:
    """A robot may stand so before one, and nobody who sees a wall is blind."""
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
    ways = CAMERA.rays()[::4, ::4] @ T_BASE_CAMERA[:3, :3].T
    columns = np.tile(np.arange(40, dtype=np.int16) - 1, (30, 1))
    rays = kernels.Rays(np.ascontiguousarray(ways, np.float32), columns, T_BASE_CAMERA[:3, 3].copy())
    heights, results = kernels.Heights(0.05, 0.1, 0.015, 1.4, 4.5), []
    for module in (kernels, plain(kernels)):
        shown = kernels.Shown(
            np.zeros((39, 45), np.uint8), np.zeros((200, 200, 3), np.float32), np.zeros(39, np.int64), 0.1, 0.05
        )
        module.look(depth, rays, heights, shown)
        nearest_m = np.full(39, np.inf)
        module.reach(depth, rays, heights, shown, shown.cells[..., 0] >= 3, nearest_m)
        results.append((shown.floor, shown.measured, shown.cells, nearest_m))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)
    assert {bool(one.any()) for one in results[0]} == {True}
    assert np.isfinite(results[0][-1]).any()
    assert not np.isfinite(results[0][-1]).all()
