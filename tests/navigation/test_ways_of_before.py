"""Of a way that was driven before, what was passed stays passed, however late the next plan is made."""

from __future__ import annotations

import numpy as np
from navigation.floors import CHAIR

from wheelsight.navigation import CellState, Costmap, StaticLayer
from wheelsight.navigation.planning import RecordedPath

FREE = StaticLayer(
    np.full((80, 160), CellState.FREE, np.uint8), np.full((80, 160), np.inf, np.float32), 0.05, (-1.0, -1.0)
)
COSTMAP = Costmap.of(FREE, CHAIR)


def driven(way: RecordedPath, places: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """What is left of a way after a robot was at places, half a second apart, and made no plan there."""
    for x, y in places:
        assert not way.is_met(np.array([x, y, 0.0]), FREE)
    x, y = places[-1]
    return [(float(one[0]), float(one[1])) for one in way.upcoming(np.array([x, y, 0.0]), COSTMAP)]


def test_who_plans_again_late_does_not_go_back_to_the_begin() -> None:
    way = RecordedPath([(x, 0.0, 0.0) for x in (0.0, 2.0, 4.0, 6.0)])
    assert driven(way, [(0.25 * n, 0.1) for n in range(17)]) == [(6.0, 0.0)]


def test_the_end_is_left_until_it_is_reached_and_a_crossing_is_no_shortcut() -> None:
    way = RecordedPath([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (4.0, 0.0, 0.0), (4.0, 2.0, 0.0), (0.2, 0.1, 0.0)])
    assert driven(way, [(0.0, 0.0), (0.1, 0.0)]) == [(2.0, 0.0), (4.0, 0.0), (4.0, 2.0), (0.2, 0.1)]
    assert driven(way, [(2.0, 0.0), (4.0, 0.0), (4.0, 2.0), (0.2, 0.1)]) == [(0.2, 0.1)]
