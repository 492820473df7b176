"""Boxes stand where they are placed, in a hall and in a world that was made without them."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from benchmarks.box_worlds import Box, hall, with_boxes
from wheelsight_sim import build_world
from wheelsight_sim.clearance import footprints, obstacles

SIZE_M = (-1.0, -2.0, 5.0, 2.0)
TURNED = Box(2.0, 0.5, 0.6, 0.2, 0.7, yaw_rad=np.pi / 2)


def test_corners_are_turned_about_the_middle() -> None:
    x, y = TURNED.corners_m.T
    assert (x.min(), x.max()) == pytest.approx((1.9, 2.1))
    assert (y.min(), y.max()) == pytest.approx((0.2, 0.8))


def test_a_hall_is_free_but_for_its_boxes_and_has_walls_all_round() -> None:
    world = hall("hall", SIZE_M, [TURNED], 1)
    solid = obstacles(world)
    inside = solid.intersection(shapely.box(*SIZE_M).buffer(-1e-6))
    assert inside.area == pytest.approx(0.6 * 0.2, rel=1e-3)
    assert inside.symmetric_difference(shapely.Polygon(TURNED.corners_m)).area == pytest.approx(0.0, abs=1e-4)
    border = shapely.box(*SIZE_M).buffer(0.05, join_style="mitre").exterior
    assert border.difference(solid).length == pytest.approx(0.0, abs=0.5)  # but for the corners


def test_a_thing_put_into_a_world_is_as_high_as_reported_and_looks_like_something() -> None:
    before = build_world("flat", 3)
    after = with_boxes(before, [TURNED], 3)
    (thing,) = [one for one in footprints(after) if one.name == "box0"]
    assert (thing.bottom_m, thing.top_m) == pytest.approx((0.0, 0.7))
    assert thing.polygon.symmetric_difference(shapely.Polygon(TURNED.corners_m)).area == pytest.approx(0.0, abs=1e-4)
    assert len(footprints(after)) == len(footprints(before)) + 1
    assert set(after.surfaces) - set(before.surfaces) == {"box0"}
