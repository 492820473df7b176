"""open_way: straight on where most room is, by what was seen."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.navigation import Costmap, Footprint, LiveObstacles
from wheelsight.navigation.behaviours import OpenWay, open_way
from wheelsight.navigation.settings import outline_of

ROBOT = Footprint.rectangle(0.8, 0.3, 0.6)
MARGIN_M = 0.1


def seen(*boxes: tuple[float, float, float, float]) -> Costmap:
    """14 m of floor about the origin, with boxes of least and greatest x and y."""
    is_occupied = np.zeros((280, 280), bool)
    for left, right, bottom, top in boxes:
        columns, rows = (slice(round(20 * (a + 7)), round(20 * (b + 7))) for a, b in ((left, right), (bottom, top)))
        is_occupied[rows, columns] = True
    return Costmap.of_live(LiveObstacles(is_occupied, 0.05, (-7.0, -7.0), "odom", 0.0, is_occupied), ROBOT)


def found(costmap: Costmap, yaw: float = 0.0) -> OpenWay:
    return open_way(costmap, outline_of(ROBOT), np.array([0.0, 0.0, yaw]), MARGIN_M)


def test_where_nothing_stands_it_goes_straight_on() -> None:
    assert found(seen()) == OpenWay(0.0, 3.0)


def test_out_of_a_room_by_its_door() -> None:
    below, above, right = (-1.5, 1.5, -1.6, -1.5), (-1.5, 1.5, 1.5, 1.6), (1.5, 1.6, -1.6, 1.6)
    way = found(seen(below, above, right, (-1.6, -1.5, -1.6, -0.5), (-1.6, -1.5, 0.5, 1.6)), yaw=0.3)
    assert np.degrees(abs(way.turn_rad + 0.3)) == pytest.approx(180, abs=8)
    assert way.way_m == 3.0


@pytest.mark.parametrize("wall_m", [1.5, 2.0, 3.0])
def test_a_wall_ahead_ends_the_way_by_the_margin(wall_m: float) -> None:
    around = seen((-wall_m - 0.1, -wall_m, -3, 3), (wall_m, wall_m + 0.1, -3, 3), (-3, 3, -1, -0.9), (-3, 3, 0.9, 1))
    way = found(around)
    assert abs(way.turn_rad) in (0.0, pytest.approx(np.pi))
    assert way.way_m == pytest.approx(wall_m - 0.8 - MARGIN_M, abs=0.1)
