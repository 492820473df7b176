"""Edits of a map: what they say of cells, that they move with their keyframe, and files of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.io.ros_map import FREE, OCCUPIED
from wheelsight.mapping import CellKind, EditKind, MapEdit, MapEdits, OccupancyGrid

SQUARE = np.array([[0.2, 0.2], [0.6, 0.2], [0.6, 0.6], [0.2, 0.6]])
LIMIT = 0.3


def grid_of(kind: CellKind = CellKind.FREE) -> OccupancyGrid:
    """A metre by a metre in cells of 0.1 m."""
    kinds = np.full((10, 10), kind, np.uint8)
    return OccupancyGrid.of_kinds(kinds, np.ones((10, 10), bool), 0.1, (0.0, 0.0))


def kinds_in(grid: OccupancyGrid, polygon: FloatArray) -> Any:
    low, high = grid.cells_at(polygon.min(axis=0) + 0.01), grid.cells_at(polygon.max(axis=0) - 0.01)
    return grid.kind[low[0] : high[0] + 1, low[1] : high[1] + 1]


def test_a_keep_out_zone_is_occupied_and_all_else_as_it_was() -> None:
    edited = MapEdits((MapEdit(EditKind.KEEP_OUT, SQUARE + [0.01, 0.0]),)).applied(grid_of())
    assert_array_equal(kinds_in(edited, SQUARE), CellKind.KEEP_OUT)
    assert_array_equal(edited.occupancy == OCCUPIED, edited.kind == CellKind.KEEP_OUT)
    # 0.21 to 0.61 m touch five columns; 0.2 to 0.6 m four rows, and the next ones at their sides.
    assert np.count_nonzero((edited.kind == CellKind.KEEP_OUT).any(axis=0)) == 5
    assert edited.kind[8, 8] == CellKind.FREE


def test_a_zone_thinner_than_a_cell_still_bars_the_way() -> None:
    thin = np.array([[0.0, 0.43], [1.0, 0.43], [1.0, 0.44], [0.0, 0.44]])
    edited = MapEdits((MapEdit(EditKind.KEEP_OUT, thin),)).applied(grid_of())
    assert_array_equal(edited.kind[4], CellKind.KEEP_OUT)


def test_what_is_wiped_is_free_and_the_unknown_stays_unknown() -> None:
    wiped = MapEdits((MapEdit(EditKind.WIPED, SQUARE),))
    for kind in (CellKind.OBSTACLE, CellKind.DROP_OFF):
        edited = wiped.applied(grid_of(kind))
        assert_array_equal(edited.kind[2:6, 2:6], CellKind.FREE)
        assert_array_equal(edited.occupancy[2:6, 2:6], FREE)
        assert np.count_nonzero(edited.kind == CellKind.FREE) == 16
    assert_array_equal(wiped.applied(grid_of(CellKind.UNKNOWN)).kind, CellKind.UNKNOWN)


def test_the_last_one_counts() -> None:
    out, wiped = MapEdit(EditKind.KEEP_OUT, SQUARE), MapEdit(EditKind.WIPED, SQUARE)
    assert MapEdits((out, wiped)).applied(grid_of()).kind[3, 3] == CellKind.FREE
    assert MapEdits((wiped, out)).applied(grid_of()).kind[3, 3] == CellKind.KEEP_OUT


def test_speed_zones_limit_and_occupy_nothing() -> None:
    edits = MapEdits((MapEdit(EditKind.SPEED, SQUARE, LIMIT),))
    assert_array_equal(edits.applied(grid_of()).kind, grid_of().kind)
    limits = edits.limits_m_s(grid_of())
    assert limits[3, 3] == np.float32(LIMIT)
    assert np.isinf(limits[8, 8])


def test_a_zone_beyond_the_grid_says_nothing() -> None:
    edits = MapEdits((MapEdit(EditKind.KEEP_OUT, SQUARE + 7.0),))
    assert_array_equal(edits.applied(grid_of()).kind, CellKind.FREE)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_an_anchored_zone_moves_with_its_keyframe(x: float, y: float, yaw_rad: float) -> None:
    then = np.array([np.eye(4), se3.from_plane(1.0, 2.0, 0.4)])
    T_new_old = se3.from_plane(x, y, yaw_rad)
    zone = MapEdit(EditKind.KEEP_OUT, SQUARE).anchored(KeyframeId(1), then[1])
    assert_allclose(zone.polygon_now(then), SQUARE, atol=1e-12)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    expected = SQUARE @ np.array([[c, s], [-s, c]]) + [x, y]
    assert_allclose(zone.polygon_now(T_new_old @ then), expected, atol=1e-9)
    assert_array_equal(MapEdit(EditKind.KEEP_OUT, SQUARE).polygon_now(T_new_old @ then), SQUARE)


def test_edits_are_carried_to_a_map_of_some_of_the_keyframes() -> None:
    T = np.array([se3.from_plane(float(k), 0.0, 0.0) for k in range(4)])
    zones = [MapEdit(EditKind.KEEP_OUT, SQUARE + [2.0, 0.0]).anchored(KeyframeId(k), T[k]) for k in (1, 2)]
    edits = MapEdits((*zones, MapEdit(EditKind.WIPED, SQUARE)))
    numbers = np.array([0, 1, -1, 2])
    carried = edits.transferred(T, numbers)
    assert [edit.keyframe for edit in carried.edits] == [1, 2, None]
    for before, after in zip(edits.edits, carried.edits, strict=True):
        assert_allclose(after.polygon_now(T[[0, 1, 3]]), before.polygon_now(T), atol=1e-12)
    # In the frame of another map all of them must hang on something.
    elsewhere = edits.transferred(T, numbers, is_same_frame=False)
    assert [edit.keyframe for edit in elsewhere.edits] == [1, 2, 0]
    T_other = se3.from_plane(5.0, 1.0, 1.0)
    for before, after in zip(edits.edits, elsewhere.edits, strict=True):
        there = se3.apply(T_other, np.c_[before.polygon_now(T), np.zeros(4)])[:, :2]
        assert_allclose(after.polygon_now(T_other @ T[[0, 1, 3]]), there, atol=1e-12)


@given(
    st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(0.01, 10)), max_size=4),
    st.integers(0, 10**6),
)
def test_files_come_back(
    tmp_path_factory: pytest.TempPathFactory, places: list[tuple[float, float, float]], number: int
) -> None:
    path = tmp_path_factory.mktemp("edits") / "edits.json"
    made = [MapEdit(EditKind.SPEED, SQUARE + [x, y], limit) for x, y, limit in places]
    made += [MapEdit(EditKind.WIPED, 3 * SQUARE).anchored(KeyframeId(number), se3.exp([1, 2, 3, 0.1, 0.2, 0.3]))]
    MapEdits(tuple(made)).save(path)
    back = MapEdits.load(path)
    assert len(back) == len(made)
    for one, other in zip(made, back.edits, strict=True):
        assert (one.kind, one.limit_m_s, one.keyframe) == (other.kind, other.limit_m_s, other.keyframe)
        assert_array_equal(one.polygon, other.polygon)
        assert_array_equal(one.T_map_keyframe, other.T_map_keyframe)


def area(name: str, shift_m: float = 0.0) -> MapEdit:
    return MapEdit(EditKind.AREA, SQUARE + shift_m, name=name)


def test_an_area_says_nothing_of_cells() -> None:
    edits = MapEdits((area("kitchen"),))
    assert_array_equal(edits.applied(grid_of()).kind, grid_of().kind)
    assert np.isinf(edits.limits_m_s(grid_of())).all()


def test_an_area_moves_with_the_nearest_keyframe_and_keeps_its_name_wherever_it_hangs() -> None:
    T = np.array([se3.from_plane(x, 0.0, 0.3) for x in (9.0, 0.5, -7.0)])
    hung = area("kitchen").attached_to_nearest(T, np.array([0, 1, 2]))
    assert hung.keyframe == 1
    assert area("kitchen").attached_to_nearest(T, np.array([0, 2])).keyframe == 2
    assert area("kitchen").attached_to_nearest(T, np.array([], np.int64)).keyframe is None
    T_new_old = se3.from_plane(1.0, -2.0, 0.7)
    there = se3.apply(T_new_old, np.c_[SQUARE, np.zeros(4)])[:, :2]
    assert_allclose(hung.polygon_now(T_new_old @ T), there, atol=1e-12)
    (carried,) = MapEdits((hung,)).transferred(T, np.array([0, -1, 1])).edits
    assert (carried.name, carried.keyframe) == ("kitchen", 1)
    assert_allclose(carried.polygon, SQUARE, atol=1e-12)


def test_an_edit_on_a_keyframe_that_its_map_never_had_is_where_it_was_drawn() -> None:
    zone = MapEdit(EditKind.KEEP_OUT, SQUARE).anchored(KeyframeId(99), np.eye(4))
    (carried,) = MapEdits((zone,)).transferred(np.array([se3.from_plane(3.0, 0.0, 1.0)]), np.array([0])).edits
    assert carried.keyframe == 0
    assert_array_equal(carried.polygon, SQUARE)


def test_a_name_is_that_of_one_area() -> None:
    with pytest.raises(MapError, match="two areas are called 'kitchen'"):
        MapEdits((area("kitchen"), area("kitchen", 1.0)))
    zone = MapEdit(EditKind.KEEP_OUT, SQUARE)
    edits = MapEdits((area("kitchen"), zone)).with_edit(area("kitchen", 1.0))
    assert [edit.name for edit in edits.edits] == [None, "kitchen"]
    assert_array_equal(edits.areas[0].polygon, SQUARE + 1.0)
    both = edits.beside(MapEdits((area("kitchen"), area("hall"), area("kitchen 2"), zone)))
    assert len(both) == 6
    assert both.area_names == ("hall", "kitchen", "kitchen 2", "kitchen 2 2")
    assert_array_equal(both.areas[0].polygon, SQUARE + 1.0)


def test_areas_come_back_from_files_that_older_programs_refuse(tmp_path: Path) -> None:
    path = tmp_path / "edits.json"
    MapEdits((area("Büro  im Hof").anchored(KeyframeId(3), np.eye(4)), MapEdit(EditKind.KEEP_OUT, SQUARE))).save(path)
    assert json.loads(path.read_text(encoding="utf-8"))["version"] == 2
    back, zone = MapEdits.load(path).edits
    assert (back.kind, back.name, back.keyframe, zone.name) == (EditKind.AREA, "Büro im Hof", 3, None)
    path.write_text(path.read_text(encoding="utf-8").replace('"keep_out"', '"area", "name": "Büro im Hof"'), "utf-8")
    with pytest.raises(MapError, match=r"edits\.json: two areas are called 'Büro im Hof'"):
        MapEdits.load(path)


def test_without_areas_a_file_is_as_it_was_before_there_were_any(tmp_path: Path) -> None:
    path = tmp_path / "edits.json"
    corners = np.array([[0, 0], [1, 0], [0, 1.0]])
    MapEdits((MapEdit(EditKind.SPEED, corners, 0.5).anchored(KeyframeId(2), np.eye(4)),)).save(path)
    rows = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    zone = {"kind": "speed", "polygon": [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], "limit_m_s": 0.5}
    before = {"format": "wheelsight-map-edits", "version": 1, "edits": [zone | {"keyframe": 2, "T_map_keyframe": rows}]}
    assert path.read_text() == json.dumps(before, indent=1) + "\n"


SOUND = {"kind": "speed", "polygon": SQUARE.tolist(), "limit_m_s": 0.5}


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"kind": "slow"}, "kind is 'slow' (one of keep_out, speed, wiped, area, floor)"),
        ({"limit_m_s": None}, "limit_m_s is None of speed (speed zones have a limit"),
        ({"limit_m_s": -1}, "limit_m_s is -1 (metres a second, over 0"),
        ({"limit_m_s": "fast"}, "limit_m_s is 'fast'"),
        ({"kind": "wiped"}, "limit_m_s is 0.5 of wiped"),
        ({"polygon": [[0, 0], [1, 1]]}, "a polygon has fewer than three corners"),
        ({"polygon": [[0, 0], [1, 1], [1, 0], [0, 1]]}, "a polygon crosses itself"),
        ({"polygon": [[0, 0], [1, 1], [2, 2]]}, "a polygon crosses itself or has no surface"),
        ({"polygon": [[0, 0], [1e9, 1], [2, 2]]}, "a polygon has corners beyond 1000 km"),
        ({"polygon": "square"}, "polygon is not a table of numbers"),
        ({"polygon": [[0, 0, 0], [1, 1, 0], [1, 0, 0]]}, "polygon is not a table of numbers (2 numbers a row)"),
        ({"keyframe": 3}, "an anchor is a keyframe and its pose"),
        ({"keyframe": -3, "T_map_keyframe": np.eye(4).tolist()}, "keyframe is -3"),
        ({"keyframe": 3, "T_map_keyframe": (2 * np.eye(4)).tolist()}, "the pose of keyframe 3 is no rigid motion"),
        ({"colour": "red"}, "is no edit"),
        ({"name": "kitchen"}, "name is 'kitchen' of speed (areas have a name, no others do)"),
        ({"kind": "area", "limit_m_s": None}, "name is None of area"),
        ({"kind": "area", "limit_m_s": None, "name": "a, b"}, "'a, b' is no name for a place"),
        ({"kind": "area", "limit_m_s": None, "name": 5}, "5 is no name for a place"),
    ],
)
def test_an_edit_that_is_wrong_is_named(tmp_path: Path, change: dict[str, Any], problem: str) -> None:
    path = tmp_path / "edits.json"
    wrong = {name: value for name, value in (SOUND | change).items() if value is not None}
    path.write_text(json.dumps({"format": "wheelsight-map-edits", "version": 1, "edits": [SOUND, wrong]}))
    with pytest.raises(MapError) as caught:
        MapEdits.load(path)
    assert str(caught.value).startswith(f"{path}: edit 1: {problem}")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("{", "is no JSON"),
        ("[]", "is not of format 'wheelsight-map-edits'"),
        (
            '{"format": "wheelsight-map-edits", "version": 4, "edits": []}',
            "its version is 4, and this wheelsight reads 3",
        ),
        ('{"format": "wheelsight-map-edits", "version": true, "edits": []}', "its version is True"),
        ('{"format": "wheelsight-map-edits", "version": 1}', "its edits are no list"),
        ('{"format": "wheelsight-map-edits", "version": 1, "edits": [NaN]}', "is no JSON: holds NaN"),
    ],
)
def test_what_is_no_file_of_edits_is_named(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "edits.json"
    path.write_text(text)
    with pytest.raises(MapError) as caught:
        MapEdits.load(path)
    assert str(caught.value).startswith(f"{path}: {problem}")


def test_an_anchor_without_its_pose_is_refused() -> None:
    zone = MapEdit(EditKind.KEEP_OUT, SQUARE).anchored(KeyframeId(3), np.eye(4))
    with pytest.raises(ArgumentError, match="there is no pose of keyframe 3"):
        MapEdits((zone,)).applied(grid_of())
    with pytest.raises(ArgumentError, match="there is no pose of keyframe 3"):
        zone.polygon_now(np.full((5, 4, 4), np.nan))


def test_more_edits_than_anyone_draws_are_refused(tmp_path: Path) -> None:
    path, one = tmp_path / "edits.json", {"kind": "wiped", "polygon": [[0, 0], [1, 0], [1, 1]]}
    path.write_text(json.dumps({"format": "wheelsight-map-edits", "version": 1, "edits": [one] * 20_000}, indent=1))
    with pytest.raises(MapError, match=r"edits\.json: holds 20,000 edits, more than 10,000"):
        MapEdits.load(path)
    edit = MapEdit(EditKind.WIPED, np.array([[0, 0], [1, 0], [1, 1]], float))
    with pytest.raises(MapError, match="there are more than 10,000 edits"):
        MapEdits((edit,) * 10_001)
