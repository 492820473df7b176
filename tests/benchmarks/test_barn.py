"""The real fields as worlds, the two robots, and the challenge's score."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from benchmarks import barn
from benchmarks.barn_worlds import HEIGHT_M, RADIUS_M, ROBOTS, numbers_in, read_field
from benchmarks.plain_rooms import Pillars
from wheelsight.core.errors import InputError
from wheelsight_sim.clearance import obstacles
from wheelsight_sim.robot import outline_at

CROSSED = barn.Crossing("jackal", 0, 14.0, 20.0, 11.0, 0.9, (), 0.1, "at the goal", {"drives fast": 20.0})
FIELD = "what,x_m,y_m\ncylinder,-2.25,6.0\ncylinder,-4.425,3.0\ncylinder,-0.075,3.0\npath,-2.25,5.0\npath,-3.25,6.0\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "world_007.csv").write_text(FIELD, encoding="utf-8")
    return tmp_path


def test_a_field_begins_at_the_robot_and_heads_along_x(folder: Path) -> None:
    field = read_field(folder, 7, 1.75)
    np.testing.assert_allclose(field.pillars_m, 1.75 * np.array([[3.0, 0.0], [0.0, 2.175], [0.0, -2.175]]))
    np.testing.assert_allclose(field.path_m, 1.75 * np.array([[0, 0], [2.0, 0.0], [3.0, 1.0], [10.0, 0.0]]))
    assert field.best_m == pytest.approx(1.75 * (2 + np.sqrt(2) + np.sqrt(50)))
    assert numbers_in(folder) == [7]


def test_its_world_has_each_cylinder_in_its_place(folder: Path) -> None:
    field = read_field(folder, 7, 1.75)
    solid = obstacles(field.world)
    for x, y in field.pillars_m:
        disc = shapely.Point(x, y).buffer(1.75 * RADIUS_M, 16)
        assert solid.intersection(disc).area == pytest.approx(disc.area, rel=1e-3)
    assert solid.distance(shapely.LineString(field.path_m[:2] - [0, 0.5])) > 0.3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FIELD + "wall,1,2\n", "line 7 is no cylinder or path"),
        (FIELD + "path,nan,2\n", "line 7: x_m, y_m are nan, 2"),
        (FIELD + "path,1,far\n", "line 7: x_m, y_m are 1, far"),
        ("what,x_m,y_m\npath,1,2\n", "no cylinders or no path"),
    ],
)
def test_a_file_that_is_no_field_is_refused_with_its_line(folder: Path, text: str, words: str) -> None:
    (folder / "world_007.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        read_field(folder, 7, 1.0)


def test_a_folder_without_fields_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match=r"world_008\.csv"):
        read_field(folder, 8, 1.0)
    (folder / "world_007.csv").unlink()
    with pytest.raises(InputError, match=r"no world_NNN\.csv"):
        numbers_in(folder)


def test_the_outline_of_navigation_is_that_of_the_simulated_robot() -> None:
    for by in ROBOTS.values():
        outline = shapely.Polygon(by.settings.footprint.outline.corners)
        assert outline.symmetric_difference(outline_at(by.model, np.eye(4))).area == pytest.approx(0, abs=1e-9)
    assert shapely.Polygon(ROBOTS["jackal"].settings.footprint.outline.corners).area == pytest.approx(0.508 * 0.43)


def test_clearance_of_pillars_is_the_distance_of_polygons(rng: np.random.Generator) -> None:
    pillars = Pillars(rng.uniform(-2, 2, (30, 2)), 0.1, HEIGHT_M)
    solid = shapely.union_all([shapely.Point(at).buffer(0.1, 64) for at in pillars.centres])
    for pose in rng.uniform(-2, 2, (40, 3)):
        corners = ROBOTS["jackal"].settings.footprint.outline.at(pose)
        distance_m = shapely.Polygon(corners).distance(solid)
        if distance_m > 0:
            assert pillars.clearance_m(corners) == pytest.approx(distance_m, abs=2e-3)
        else:
            assert pillars.clearance_m(corners) <= 2e-3


@pytest.mark.parametrize(("time_s", "score"), [(10.0, 0.5), (14.0, 0.5), (28.0, 0.25), (56.0, 0.125), (90.0, 0.125)])
def test_the_score_is_the_challenges(time_s: float, score: float) -> None:
    one = replace(CROSSED, time_s=time_s)
    assert one.score() == pytest.approx(score)
    assert one.own_score == pytest.approx(score)  # a Jackal has the challenge's speed
    assert replace(one, robot="wheelchair").own_score == one.score(1.0)


@pytest.mark.parametrize("changed", [{"contacts": ("cylinder7",)}, {"off_m": 1.01}, {"time_s": 100.1}])
def test_who_touches_or_does_not_come_there_in_time_has_no_score(changed: dict[str, Any]) -> None:
    assert replace(CROSSED, **changed).score() == 0.0


def test_larger_fields_give_more_room_and_time() -> None:
    assert replace(CROSSED, robot="wheelchair", off_m=1.74, time_s=174.9).is_success
    assert not replace(CROSSED, robot="wheelchair", off_m=1.74, time_s=175.1).is_success


def test_the_table_has_shares_means_and_times() -> None:
    touched = replace(CROSSED, number=2, contacts=("cylinder7",), spent_s={"monitor: x": 60.0})
    sheet, spent, targets, missed = barn.sheets_of([CROSSED, touched])
    assert sheet.rows[0][1:5] == ("2", "50.0 %", "50.0 %", "0.175")
    assert spent.rows == (("monitor: x", "75.0 %"), ("drives fast", "25.0 %"))
    assert [row[3].startswith("missed") for row in targets.rows] == [True, True, True]
    assert "cylinder7" in missed.rows[0][0]


@pytest.mark.slow
def test_a_jackal_crosses_a_field_by_rays(folder: Path, tmp_path: Path) -> None:
    field = read_field(folder, 7, 1.0)
    found = barn.crossed_by_rays(field, ROBOTS["jackal"], 1, tmp_path / "way.png")
    assert found.is_success
    assert found.clearance_m > 0.02
    assert sum(found.spent_s.values()) == pytest.approx(found.time_s, abs=0.1)
    assert (tmp_path / "way.png").stat().st_size > 10_000
