"""Plans in floor plans of real buildings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from navigation.floors import CHAIR
from navigation.plain_polygons import cells_under

from benchmarks.planning import PLANS, asked_in, grid_of
from wheelsight.navigation import Costmap, Plan, PlannerSettings, StaticLayer

_GOALS, _EVERY = 4, 7


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("name", PLANS)
def test_a_chair_finds_its_way_in_a_real_building(data_folder: Path, name: str) -> None:
    path = data_folder / "maps" / name
    if not path.exists():
        pytest.skip(f"{path} is not there")
    grid = grid_of(path)
    costmap = Costmap.of(StaticLayer.of(grid), CHAIR)
    outline, found = CHAIR.padded(PlannerSettings().margin_m), 0
    for one in asked_in(grid, _GOALS, seed=1):
        if isinstance(one.answer, Plan):
            found += 1
            np.testing.assert_allclose(one.answer.poses[[0, -1]], [one.start, one.goal], atol=1e-9)
            for pose in one.answer.poses[::_EVERY]:
                assert cells_under(costmap.is_lethal, costmap.resolution_m, costmap.origin, outline.corners, pose) == 0
    # Goals lie where the chair fits, and what joins them may be too narrow for its length.
    assert found >= _GOALS - 1
