"""What a depth image shows to a collision monitor, and what it looks through: boxes on a floor, by rays in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from navigation.floors import CHAIR
from navigation.test_live_layer import CALIBRATION, T_BASE_CAMERA, Box, depth_of

from wheelsight.navigation import DepthViewer
from wheelsight.navigation.fields import outline_of
from wheelsight.navigation.monitor_settings import MonitorSettings
from wheelsight.navigation.surroundings import Surroundings

CAMERA_X_M, CAMERA_HEIGHT_M = T_BASE_CAMERA[0, 3], T_BASE_CAMERA[2, 3]


def box(away_m: float, height_m: float) -> Box:
    """So far before the camera."""
    near = CAMERA_X_M + away_m
    return (near, near + 0.02, -0.15, 0.15, 0.0, height_m)


@pytest.mark.parametrize("height_m", [0.2, 0.45, 0.6])
def test_so_near_as_it_says_a_thing_shows_and_no_nearer(height_m: float) -> None:
    viewer = DepthViewer(CALIBRATION, CHAIR)
    view = viewer.view(depth_of([box(2.5, height_m)]), 1.0)
    assert view.shows_m is not None
    front = view.points[:, 0] < CAMERA_X_M + 2.53
    shows_m = float(view.shows_m[front].min())
    # Three rows of pixels make a thing: from 2.5 m off that is 5 cm of its height, and as much where it comes near.
    slope = view.near_m / CAMERA_HEIGHT_M
    assert shows_m == pytest.approx(slope * (CAMERA_HEIGHT_M - height_m), abs=0.06 * slope)
    assert len(viewer.view(depth_of([box(shows_m + 0.1, height_m)]), 1.0).points)
    # It says it of all bearings; ahead the lowest ray meets the floor nearer than at the sides.
    assert not len(viewer.view(depth_of([box(0.8 * shows_m, height_m)]), 1.0).points)


@pytest.mark.parametrize(("height_m", "is_left"), [(1.3, False), (0.2, True)])
def test_who_has_left_is_forgotten_nearer_than_the_floor_is_seen_but_a_low_box_is_not(
    height_m: float, is_left: bool
) -> None:
    """Seen once, from afar; then looked over from so near that the floor there does not show."""
    viewer, known = DepthViewer(CALIBRATION, CHAIR), Surroundings(outline_of(CHAIR), MonitorSettings())
    known.hear(0.0, 0.0, 0.0)
    known.see(viewer.view(depth_of([box(2.5, height_m)]), 0.0))
    known.hear(0.2, 0.0, 0.0, rolled=(1.6, 0.0))
    nobody = viewer.view(depth_of([]), 0.2)
    assert nobody.near_m > 0.9 > MonitorSettings().air_m
    known.see(nobody)
    pose = known.pose_at(0.2)
    assert pose is not None
    assert bool(len(known.points_at(pose, 0.2, 2.0))) is is_left


def test_as_high_as_its_pixels_say_and_not_as_a_single_one() -> None:
    """At an edge a ray may measure a mean of near and far."""
    viewer = DepthViewer(CALIBRATION, CHAIR)
    depth = depth_of([box(2.5, 0.2)])
    low = viewer.view(depth, 1.0).shows_m
    depth[70, 80] = 2.5
    flying = viewer.view(depth, 1.0).shows_m
    assert low is not None
    assert flying is not None
    np.testing.assert_array_equal(flying, low)


def test_a_cell_that_a_tall_thing_grazes_is_as_tall() -> None:
    """Three low pixels of it lie in the cell before."""
    viewer = DepthViewer(CALIBRATION, CHAIR)
    depth = depth_of([box(2.5, 1.3)])
    rows, ahead = np.flatnonzero(np.abs(depth[:, 80] - 2.5) < 1e-3), depth.copy()
    ahead[rows[-20:-17], 80] = 2.46
    grazed, plain = viewer.view(ahead, 1.0), viewer.view(depth, 1.0)
    assert grazed.shows_m is not None
    assert len(grazed.points) == len(plain.points) + 1
    assert (grazed.shows_m < MonitorSettings().air_m).all()
