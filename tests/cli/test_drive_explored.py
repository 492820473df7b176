"""`wheelsight drive --explore` to its end, and a drive in the map that it leaves."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import Result

from wheelsight.io.ros_map import FREE, OCCUPIED, read_ros_map
from wheelsight.slam.maps import MapFolder, find_map

Command = Callable[..., Result]
# The smallest world, by small images: two rooms, in the order of three minutes of its time.
STUDIO = ("--sim", "studio", "--rate", "5", "--size", "160x120")
# In the map, which begins where the robot did, (1.3, 2.3) in the world: in the other room.
IN_THE_BEDROOM = np.array([4.8, 0.1])


def told_of(folder: Path) -> dict[str, Any]:
    """What came of a drive, none of which may have touched anything."""
    told: dict[str, Any] = json.loads((folder / "drive.json").read_text())
    assert told["has_arrived"] is True
    assert told["truth"]["contacts"] == []
    assert told["truth"]["clearance_m"] > 0
    return told


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_home_is_explored_to_its_end_and_driven_in_by_the_map_of_that(wheelsight: Command, tmp_path: Path) -> None:
    home, drive = tmp_path / "home", tmp_path / "drive"
    result = wheelsight("drive", *STUDIO, "--explore", "--out", home)
    assert result.exit_code == 0, result.output
    assert told_of(home)["loops"] > 0
    folder = MapFolder.open(find_map(home))
    assert len(folder.store) > 20
    folder.close()
    plan = read_ros_map(home / "map" / "occupancy.yaml")
    free_m2 = (plan.occupancy == FREE).sum() * plan.resolution_m**2
    assert 15 < free_m2 < 8.2 * 4.8
    assert (plan.occupancy == OCCUPIED).any()
    # By small images of a unit without calibration, the pose is known to 0.1 or 0.2 m, with 95 %.
    settings = tmp_path / "settings.yaml"
    settings.write_text("navigation:\n  follow:\n    goal_m: 0.25\n")
    to = "--config", settings, "--map", home, "--to", ",".join(map(str, IN_THE_BEDROOM))
    result = wheelsight("drive", *STUDIO, *to, "--out", drive)
    assert result.exit_code == 0, result.output
    (goal,) = told_of(drive)["goals"]
    assert goal["off_m"] < 0.2
