"""Areas: what they refuse, where points fall, which are neighbours, and YAML that loses nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.areas import Area, AreaMap, load_areas, save_areas
from wheelsight.core.errors import AreaError, OutputError


def box(name: str, left: float, bottom: float, right: float, top: float, **reported: float) -> Area:
    corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]], float)
    return Area(name, corners, **(reported or {"x_m": (left + right) / 2}))


def floor() -> AreaMap:
    """Two rooms that share a wall, a third 0.3 m away, a fourth far off."""
    return AreaMap(
        (box("a", 0, 0, 2, 2), box("b", 2, 0, 4, 2), box("c", 4.3, 0, 6, 2), box("d", 10, 0, 12, 2, y_m=1.0))
    )


def document(**entry: object) -> str:
    fields = {"name": "hall", "polygon": "[[0, 0], [4, 0], [4, 2], [0, 2]]", "x_m": "2.0"} | entry
    body = "\n    ".join(f"{key}: {value}" for key, value in fields.items() if value is not None)
    return f"format: wheelsight-areas-1\nareas:\n  - {body}\n"


def test_points_fall_into_their_area_in_any_shape_of_batch():
    points = np.array([[[1.0, 1.0], [3.0, 1.0]], [[4.1, 1.0], [11.0, 0.5]]])
    np.testing.assert_array_equal(floor().index_at(points), [[0, 1], [-1, 3]])
    assert floor().index_at([1.0, 1.0]).shape == ()
    assert floor().name_at(5.0, 1.0) == "c"
    assert floor().name_at(8.0, 1.0) is None


def test_a_point_on_a_common_border_belongs_to_the_first_area():
    assert floor().index_at([2.0, 1.0]) == 0


@pytest.mark.parametrize("point", [(np.nan, 1.0), (1.0, np.nan), (np.inf, 1.0)])
def test_a_point_that_is_no_number_is_nowhere(point):
    assert floor().index_at(point) == -1


def test_an_empty_map_holds_no_point():
    np.testing.assert_array_equal(AreaMap().index_at(np.zeros((3, 2))), [-1, -1, -1])
    assert AreaMap().adjacency().shape == (0, 0)


@given(
    st.lists(st.floats(0.2, 5.0), min_size=3, max_size=12),
    st.tuples(st.floats(-6, 6), st.floats(-6, 6)),
)
def test_a_star_shaped_area_holds_what_is_nearer_than_its_border(radii, point):
    angles = np.linspace(0, 2 * np.pi, len(radii), endpoint=False)
    corners = np.array(radii)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    area = Area("star", corners, x_m=0.0 if corners[:, 0].min() <= 0 <= corners[:, 0].max() else corners[0, 0])
    turned = np.arctan2(point[1], point[0]) % (2 * np.pi)
    first = min(int(turned / (2 * np.pi) * len(radii)), len(radii) - 1)
    one, other = corners[first], corners[(first + 1) % len(radii)]
    # Where the ray from the middle crosses this side, in units of the point's own distance.
    weights = np.linalg.solve(np.column_stack([one, other]), point)
    if len(radii) == 3 or abs(weights.sum() - 1) < 1e-9:
        return
    assert (AreaMap((area,)).index_at(point) == 0) == (weights.sum() < 1)


def test_neighbours_touch_or_come_close():
    near = floor().adjacency(within_m=0.5)
    wanted = np.eye(4, dtype=bool)
    wanted[0, 1] = wanted[1, 0] = wanted[1, 2] = wanted[2, 1] = True
    np.testing.assert_array_equal(near, wanted)
    np.testing.assert_array_equal(floor().adjacency(within_m=0.0), wanted & (np.add.outer(range(4), range(4)) != 3))


def test_what_is_saved_is_what_is_loaded(tmp_path: Path):
    areas = AreaMap((*floor().areas, Area("Flur Süd", np.array([[20, 0], [21, 0.1], [20.5, 1 / 3]]), 20.5, 0.1)))
    save_areas(areas, tmp_path / "areas.yaml")
    loaded = load_areas(tmp_path / "areas.yaml")
    assert loaded.names == areas.names
    for one, other in zip(loaded, areas, strict=True):
        np.testing.assert_array_equal(one.polygon, other.polygon)
        assert (one.x_m, one.y_m) == (other.x_m, other.y_m)


def test_a_map_that_cannot_be_written_says_so(tmp_path: Path):
    with pytest.raises(OutputError, match=r"areas\.yaml: the folder does not exist"):
        save_areas(floor(), tmp_path / "nowhere" / "areas.yaml")


@pytest.mark.parametrize(
    ("entry", "problem"),
    [
        ({"polygon": "[[0, 0], [4, 2], [4, 0], [0, 2]]"}, "area 'hall' has a polygon that crosses itself"),
        ({"polygon": "[[0, 0], [4, 2]]"}, "area 'hall' has a polygon of 2 corners"),
        ({"polygon": "[[0, 0], [4, 0], [0, 0]]"}, "area 'hall' has a polygon without surface"),
        ({"polygon": "[[0, 0], [1, 0], [4, 0]]"}, "area 'hall' has a polygon without surface"),
        ({"polygon": "[[0, 0], [4, .nan], [4, 2]]"}, "area 'hall' has a corner that is not finite"),
        ({"polygon": "[[0, 0], [4, .inf], [4, 2]]"}, "area 'hall' has a corner that is not finite"),
        ({"polygon": "[0, 1, 2]"}, "area 'hall' has a polygon that is no list of corners"),
        ({"polygon": "[[0, 0], [1, 0, 3], [2, 2]]"}, "area 'hall' has a polygon that is no list of corners"),
        ({"polygon": None}, "area 'hall' has no polygon"),
        ({"x_m": None}, "area 'hall' has neither x_m nor y_m"),
        ({"x_m": "null"}, "area 'hall' has neither x_m nor y_m"),
        ({"x_m": ".nan"}, "area 'hall' has x_m nan, not a number"),
        ({"x_m": "true"}, "area 'hall' has x_m True, not a number"),
        ({"x_m": "middle"}, "area 'hall' has x_m 'middle', not a number"),
        ({"x_m": "5.5"}, "area 'hall' has x_m 5.5, but its polygon reaches from 0 to 4 m"),
        ({"x": "2.0"}, r"area 'hall' has an unknown field 'x' \(did you mean x_m\?\)"),
        ({"name": "3"}, "area 1 has the name 3"),
        ({"name": None, "format": "1"}, "area 1 has the name None"),
        ({"name": "'  '"}, "an area has no name"),
    ],
)
def test_a_bad_area_is_refused_by_file_and_name(tmp_path: Path, entry, problem):
    path = tmp_path / "areas.yaml"
    path.write_text(document(**entry))
    with pytest.raises(AreaError, match=rf"areas.yaml(:\d+)?: {problem}") as caught:
        load_areas(path)
    assert str(caught.value).endswith(")"), "it says how to mend it"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("areas: []", "field format is None"),
        ("- 1", "field format is None"),
        ("format: wheelsight-areas-2", "field format is 'wheelsight-areas-2'"),
        ("format: wheelsight-areas-1", "field areas is no list"),
        ("format: wheelsight-areas-1\nareas: []", "field areas is no list"),
        ("format: wheelsight-areas-1\nareas: [hall]", "area 1 must hold names and values"),
        ("format: wheelsight-areas-1\nplaces: []\nareas: []", "the file has an unknown field 'places'"),
        ("format: [", "is not YAML"),
    ],
)
def test_a_file_that_is_no_map_is_refused(tmp_path: Path, text, problem):
    path = tmp_path / "areas.yaml"
    path.write_text(text)
    with pytest.raises(AreaError, match=rf"areas.yaml(:\d+)?: {problem}"):
        load_areas(path)


def test_a_missing_file_is_named(tmp_path: Path):
    with pytest.raises(AreaError, match=r"nothing\.yaml: cannot be read: No such file"):
        load_areas(tmp_path / "nothing.yaml")


def test_areas_that_overlap_are_refused_and_a_shared_border_is_not():
    assert len(AreaMap((box("a", 0, 0, 2, 2), box("b", 2 - 1e-6, 0, 4, 2)))) == 2
    with pytest.raises(AreaError, match=r"area 'a' overlaps area 'b' by 0\.2 m²"):
        AreaMap((box("a", 0, 0, 2, 2), box("b", 1.9, 0, 4, 2)))


def test_two_areas_of_one_name_are_refused():
    with pytest.raises(AreaError, match="area 'a' is there twice"):
        AreaMap((box("a", 0, 0, 2, 2), box("a", 3, 0, 4, 2)))


def test_a_polygon_may_be_closed_or_not_and_go_either_way():
    corners = np.array([[0, 0], [4, 0], [4, 2], [0, 2]], float)
    for polygon in (corners, corners[::-1], np.vstack([corners, corners[:1]])):
        area = Area("hall", polygon, x_m=2.0)
        assert len(area.polygon) == 4
        assert AreaMap((area,)).name_at(1.0, 1.0) == "hall"


def test_an_area_is_looked_up_by_name():
    assert floor().index_of("c") == 2
    with pytest.raises(AreaError, match="no area is called 'attic'"):
        floor().index_of("attic")


def test_many_areas_are_compared_with_their_neighbours_alone():
    """Each with all others would take minutes."""
    tiles = [box(f"{x},{y}", x, y, x + 1, y + 1) for x in range(40) for y in range(40)]
    assert len(AreaMap(tuple(tiles))) == 1600
    with pytest.raises(AreaError, match=r"area '7,9' overlaps area 'odd' by 0\.04 m²"):
        AreaMap((*tiles, box("odd", 7.2, 9.2, 7.4, 9.4)))
    with pytest.raises(AreaError, match="there are more than 2,000 areas"):
        AreaMap((tiles[0],) * 2001)
