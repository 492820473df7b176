"""`wheelsight map zone`: zones and areas drawn, listed and forgotten; goals in areas; and what is refused."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sessions.kept_views import write_map
from sessions.mounted_maps import WAY, drive
from typer.testing import Result

from wheelsight.app.cli.drive import poses_of
from wheelsight.core.areas import Area, AreaMap, save_areas
from wheelsight.core.errors import MapError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.io.ros_map import FREE, OCCUPIED, read_ros_map
from wheelsight.mapping import EditKind
from wheelsight.navigation import Costmap, Footprint, KnownFloor, Plan, Planner
from wheelsight.slam.maps import MapFolder, occupancy_of
from wheelsight.slam.maps.contents import current_edits

Command = Callable[..., Result]
Refusal = Callable[..., str]


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    write_map(tmp_path / "home", 5)
    return tmp_path / "home"


@pytest.fixture(scope="module")
def one_mapped_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mapped") / "room"
    drive(folder, WAY).close()
    return folder


@pytest.fixture
def mapped(one_mapped_room: Path, tmp_path: Path) -> Path:
    """Of a room from (-3, -2) to (3, 2), whose floor the map has."""
    return Path(shutil.copytree(one_mapped_room, tmp_path / "room"))


def did(result: Result) -> str:
    assert result.exit_code == 0, result.output
    return result.stdout


def listed(wheelsight: Command, folder: Path) -> list[str]:
    return [line.strip() for line in did(wheelsight("map", "zone", folder)).splitlines()[1:]]


def test_zones_are_drawn_listed_and_forgotten(wheelsight: Command, kept: Path) -> None:
    zone = ("map", "zone", kept)
    assert did(wheelsight(*zone)).startswith("the map has no zones: wheelsight map zone MAP --keep-out ")
    reported = did(wheelsight(*zone, "--keep-out", "-1,2", "-.5,2", "-0.5,3"))
    assert re.fullmatch(r"1: keep-out zone: 0\.25 m², moves with keyframe \d\n", reported)
    did(wheelsight(*zone, "0,0 1,0 1,2.5", "--speed", 0.3))
    did(wheelsight(*zone, "--wipe", "-1,-1", "0,1"))
    assert did(wheelsight(*zone, "--area", "kitchen", "1,0", "2,0", "2,2", "1,2")).startswith(
        "4: area kitchen: 2.00 m²"
    )
    assert listed(wheelsight, kept) == [
        "1  keep-out zone: -1.00,2.00 -0.50,2.00 -0.50,3.00",
        "2  speed zone, at most 0.3 m/s: 0.00,0.00 1.00,0.00 1.00,2.50",
        "3  wiped place: -1.00,-1.00 0.00,-1.00 0.00,1.00 -1.00,1.00",
        "4  area kitchen: 1.00,0.00 2.00,0.00 2.00,2.00 1.00,2.00",
    ]
    reported = did(wheelsight("map", "info", kept))
    assert re.search(r"^edits +3 zones and wiped places", reported, re.MULTILINE)
    assert re.search(r"^areas +kitchen", reported, re.MULTILINE)
    assert did(wheelsight(*zone, "--forget", 2)) == "forgotten: speed zone, at most 0.3 m/s\n"
    assert [edit.kind for edit in MapFolder.open(kept).map_edits().edits] == ["keep_out", "wiped", "area"]
    assert did(wheelsight(*zone, "--floor", "0,0", "1,1")).startswith("4: declared floor: 1.00 m²")
    assert did(wheelsight(*zone, "--forget", 4)) == "forgotten: declared floor\n"
    assert all(edit.keyframe is not None for edit in MapFolder.open(kept).map_edits().edits)


def test_zones_are_listed_where_their_keyframes_are_by_now(wheelsight: Command, kept: Path) -> None:
    did(wheelsight("map", "zone", kept, "--keep-out", "0,0", "1,0", "1,1"))
    folder = MapFolder.open(kept, read_only=False)
    numbers = list(folder.store)
    folder.append_poses(numbers, se3.from_plane(2.0, -3.0, np.pi / 2) @ folder.store.T_map_keyframe[numbers])
    folder.close()
    assert listed(wheelsight, kept) == ["1  keep-out zone: 2.00,-3.00 2.00,-2.00 1.00,-2.00"]


def test_an_area_drawn_again_takes_the_place_of_the_one_before(wheelsight: Command, kept: Path) -> None:
    for corners in ("0,0 1,1", "0,0 2,2"):
        did(wheelsight("map", "zone", kept, "--area", "kitchen", corners))
    assert listed(wheelsight, kept) == ["1  area kitchen: 0.00,0.00 2.00,0.00 2.00,2.00 0.00,2.00"]


def test_areas_of_a_file_are_taken_at_once(wheelsight: Command, kept: Path, tmp_path: Path) -> None:
    square = np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]])
    areas = Area("hall", square, x_m=1.0), Area("kitchen", square + [2, 0], y_m=1.0)
    save_areas(AreaMap(areas), tmp_path / "areas.yaml")
    reported = did(wheelsight("map", "zone", kept, "--areas", tmp_path / "areas.yaml"))
    assert [line.partition(": 4")[0] for line in reported.splitlines()] == ["1: area hall", "2: area kitchen"]
    found = MapFolder.open(kept).map_edits()
    assert found.area_names == ("hall", "kitchen")
    assert_allclose(found.areas[1].polygon, square + [2, 0])


def test_one_beyond_what_the_map_shows_and_a_name_given_twice_are_warned_of(wheelsight: Command, kept: Path) -> None:
    did(wheelsight("map", "name", kept, "kitchen", "--at", "0,0"))
    assert wheelsight("map", "zone", kept, "--keep-out", "3,0 4,0 4,1").stderr == ""
    reported = wheelsight("map", "zone", kept, "--area", "kitchen", "100,0 101,0 101,1")
    assert reported.exit_code == 0
    first, second = (" ".join(line.split()) for line in reported.stderr.splitlines())
    assert re.match(r"warning: area kitchen: it lies wholly beyond what the map shows, 9\d\.\d m from", first)
    assert second.startswith("warning: a place is called kitchen, too, and is where wheelsight drive --to goes")


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("0,0", "1,0", "1,1"), "what is in these corners is not said (--keep-out, --speed M_S, --wipe"),
        (("--keep-out",), "--keep-out has no corners (X,Y in metres in the map, such as"),
        (("--wipe", "-1,2"), "--wipe has one corner"),
        (("--keep-out", "0,0", "1,0", "1;1"), "'1;1' is no corner (X,Y in metres"),
        (("--keep-out", "0,0", "1,0", "nan,1"), "'nan,1' is no corner"),
        (("--keep-out", "0,0,0", "1,0", "2,1"), "'0,0,0' is no corner"),
        (("--keep-out", "0,0", "1,1", "1,0", "0,1"), "a polygon crosses itself or has no surface (give its corners in"),
        (("--kep-out", "0,0", "1,0", "1,1"), "there is no option --kep-out (--keep-out, --speed M_S"),
        (("--keep-out", "--speed", "1", "0,0", "1,1"), "--keep-out and --speed are given at once"),
        (("--speed", "0", "0,0", "1,1"), "--speed is 0 (metres a second, over 0, such as 0.3; or"),
        (("--speed", "nan", "0,0", "1,1"), "--speed is nan"),
        (("--area", "a,b", "0,0", "1,1"), "'a,b' is no name for a place"),
        (("--forget", "1"), "--forget is 1 (the map has no zones)"),
        (("--forget", "1", "0,0"), "--forget has no corners (leave them out)"),
        (("--areas", "nowhere.yaml"), "nowhere.yaml: "),
    ],
)
def test_zones_that_mean_nothing_are_refused(
    refusal: Refusal, kept: Path, words: tuple[str, ...], problem: str
) -> None:
    assert refusal("map", "zone", kept, *words).startswith(problem)
    assert not (kept / "edits.json").exists()


def test_a_number_that_none_has_is_reported_with_those_there_are(
    wheelsight: Command, refusal: Refusal, kept: Path
) -> None:
    did(wheelsight("map", "zone", kept, "--keep-out", "0,0 1,1"))
    assert refusal("map", "zone", kept, "--forget", 2).startswith("--forget is 2 (1 to 1; wheelsight map zone MAP")
    assert len(MapFolder.open(kept).map_edits()) == 1


def occupancy_at(path: Path, xy: tuple[float, float]) -> int:
    plan = read_ros_map(path)
    column, row = np.floor(plan.to_cells(np.array(xy))).astype(int)
    return int(plan.occupancy[row, column])


def test_a_keep_out_zone_is_occupied_in_the_maps_own_plan_and_in_those_that_are_exported(
    wheelsight: Command, mapped: Path, tmp_path: Path
) -> None:
    own, exported, middle = mapped / "occupancy.yaml", tmp_path / "plan.yaml", (0.75, 0.25)
    assert occupancy_at(own, middle) == FREE
    did(wheelsight("map", "zone", mapped, "--keep-out", "0.5,0", "1,0.5"))
    did(wheelsight("map", "export", mapped, "--occupancy", exported))
    assert occupancy_at(own, middle) == occupancy_at(exported, middle) == OCCUPIED
    did(wheelsight("map", "zone", mapped, "--speed", "0.2", "0.5,0", "1,0.5"))
    did(wheelsight("map", "zone", mapped, "--forget", "1"))
    assert occupancy_at(own, middle) == FREE
    assert [edit.kind for edit in MapFolder.open(mapped).map_edits().edits] == [EditKind.SPEED]


ROBOT = Footprint.rectangle(front_m=0.2, back_m=0.2, width_m=0.3)


def plan_across(folder: MapFolder) -> Plan:
    floor = KnownFloor(occupancy_of(folder), current_edits(folder), folder.store.T_map_keyframe)
    plan = Planner(ROBOT).plan(Costmap.of(floor.layer, ROBOT), (-1.5, 0.0, 0.0), (1.5, 0.0, 0.0))
    assert isinstance(plan, Plan), plan
    return plan


def test_a_plan_goes_round_a_keep_out_zone_and_slowly_through_a_speed_zone(wheelsight: Command, mapped: Path) -> None:
    before = plan_across(MapFolder.open(mapped))
    assert np.abs(before.poses[:, 1]).max() < 0.1
    did(wheelsight("map", "zone", mapped, "--keep-out", "-0.3,-0.6", "0.3,-0.6", "0.3,1.9", "-0.3,1.9"))
    did(wheelsight("map", "zone", mapped, "--speed", "0.25", "1,-1", "2,1"))
    folder = MapFolder.open(mapped)
    plan = plan_across(folder)
    beside = np.abs(plan.poses[:, 0]) < 0.3
    assert plan.poses[beside, 1].max() < -0.6 - 0.15
    assert plan.length_m > before.length_m + 0.3
    floor = KnownFloor(occupancy_of(folder), current_edits(folder), folder.store.T_map_keyframe)
    row, column = np.floor((np.array([0.0, 1.5]) - floor.layer.origin[::-1]) / floor.layer.resolution_m).astype(int)
    assert floor.layer.speed_m_s[row, column] == np.float32(0.25)


def goal_of(folder: Path, word: str) -> FloatArray:
    (goal,) = poses_of([word], MapFolder.open(folder))
    return goal


def test_an_area_is_a_goal_where_it_has_most_room(wheelsight: Command, mapped: Path) -> None:
    """The room's right half, then less of it; and a name goes before an area."""
    did(wheelsight("map", "zone", mapped, "--area", "kitchen", "0,-1.5", "2.4,1.5"))
    goal = goal_of(mapped, "kitchen")
    assert_allclose(goal[:2], (1.2, 0.0), atol=0.1)
    assert np.isnan(goal[2])
    did(wheelsight("map", "zone", mapped, "--keep-out", "0,-2", "1,-2", "1,2", "0,2"))
    assert_allclose(goal_of(mapped, "kitchen")[0], 1.7, atol=0.1)
    did(wheelsight("map", "name", mapped, "kitchen", "--at", "-1,0.5,90"))
    assert_allclose(goal_of(mapped, "kitchen"), (-1.0, 0.5, np.pi / 2), atol=1e-9)


def test_an_area_without_free_floor_is_no_goal(wheelsight: Command, mapped: Path) -> None:
    did(wheelsight("map", "zone", mapped, "--area", "garden", "8,0 9,0 9,1"))
    with pytest.raises(MapError, match=r"no free floor of the map lies in the area 'garden' \(wheelsight map zone MAP"):
        goal_of(mapped, "garden")


def test_a_name_that_nothing_has_is_reported_with_places_and_areas(
    wheelsight: Command, refusal: Refusal, kept: Path
) -> None:
    did(wheelsight("map", "zone", kept, "--area", "kitchen", "0,0 1,1"))
    did(wheelsight("map", "name", kept, "desk", "--at", "0,0"))
    reported = refusal("drive", "--sim", "flat", "--map", kept, "--to", "kichen")
    assert reported == "no place of the map is called 'kichen' (did you mean kitchen?) (known: desk, kitchen)"
