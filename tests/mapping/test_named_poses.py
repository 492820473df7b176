"""Names of poses: kept, found, refused where they are missing, and moved with their keyframes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.mapping import NamedPose, NamedPoses

KITCHEN = NamedPose("kitchen", np.array([3.2, 1.5, 0.5]))
DESK = NamedPose("desk", np.array([-1.0, 2.0]))
TABLE = np.array([se3.from_plane(x, 0.0, 0.2) for x in (0.0, 2.0, 4.0)])


def test_a_place_moves_with_its_keyframe() -> None:
    hung = KITCHEN.attached_to_nearest(TABLE, np.arange(3))
    assert hung.keyframe == 2
    assert_allclose(hung.pose_now(TABLE), KITCHEN.pose, atol=1e-12)
    moved = TABLE.copy()
    T_new_old = se3.from_plane(0.3, -0.1, 0.1)
    moved[2] = T_new_old @ TABLE[2]
    expected = T_new_old @ se3.from_plane(*KITCHEN.pose)
    assert_allclose(hung.pose_now(moved)[:2], expected[:2, 3])
    assert_allclose(hung.pose_now(moved)[2], 0.6)
    anywhere = DESK.attached_to_nearest(TABLE, np.arange(3)).pose_now(moved)
    assert np.isnan(anywhere[2])
    with pytest.raises(ArgumentError, match="there is no pose of keyframe 2"):
        hung.pose_now(TABLE[:2])


def test_names_are_written_and_read_again(tmp_path: Path) -> None:
    poses = NamedPoses((KITCHEN.attached_to_nearest(TABLE, np.arange(2)), DESK, NamedPose("Büro  im Hof", np.zeros(3))))
    poses.save(tmp_path / "places.json")
    found = NamedPoses.load(tmp_path / "places.json")
    assert found.names == ("Büro im Hof", "desk", "kitchen")
    for before, after in zip(poses, found, strict=True):
        assert_allclose(after.pose, before.pose)
        assert after.keyframe == before.keyframe
        assert_allclose(after.pose_now(TABLE), before.pose_now(TABLE))


def test_a_name_that_is_unknown_is_reported_with_the_nearest_and_all() -> None:
    poses = NamedPoses((KITCHEN, DESK))
    with pytest.raises(MapError) as reported:
        poses.named("Kichen")
    assert "no place of the map is called 'Kichen' (did you mean kitchen?)" in str(reported.value)
    assert "known: desk, kitchen" in str(reported.value)
    with pytest.raises(MapError, match="the map has no names yet"):
        NamedPoses().named("kitchen")
    assert poses.without("desk").names == ("kitchen",)
    assert len(poses.with_pose(NamedPose("desk", np.ones(3)))) == 2


@pytest.mark.parametrize("name", ["", "  ", "1,2", "x" * 61, "a\x1bb", "-v", None])
def test_what_is_no_name_is_refused(name: Any) -> None:
    with pytest.raises(MapError, match="is no name for a place"):
        NamedPose(name, np.zeros(3))


@pytest.mark.parametrize("pose", [[1.0], [1.0, np.nan, 0.0], [1e9, 0.0, 0.0], [0.0, 0.0, np.inf], np.zeros((4, 4))])
def test_what_is_no_pose_is_refused(pose: Any) -> None:
    with pytest.raises(MapError, match="is beyond 1000 km"):
        NamedPose("desk", pose)


def test_names_are_carried_to_a_map_of_some_of_the_keyframes() -> None:
    hung = [NamedPose(f"at {k}", TABLE[k, :2, 3]).attached_to_nearest(TABLE, np.array([k])) for k in range(3)]
    astray = NamedPose("astray", np.array([0.1, 0.0]), KeyframeId(9), np.eye(4))
    carried = NamedPoses((*hung, astray, DESK)).transferred(TABLE, np.array([-1, 0, 1]))
    numbers = {one.name: one.keyframe for one in carried}
    assert numbers == {"at 0": 0, "at 1": 0, "at 2": 1, "astray": 0, "desk": None}
    for one in carried:
        before = next(pose for pose in (*hung, astray, DESK) if pose.name == one.name)
        assert_allclose(one.pose_now(TABLE[1:])[:2], before.pose[:2], atol=1e-12)
    elsewhere = NamedPoses((DESK,)).transferred(TABLE, np.array([-1, 0, 1]), is_same_frame=False)
    assert [one.keyframe for one in elsewhere] == [0]


def test_of_two_maps_both_keep_their_names() -> None:
    both = NamedPoses((KITCHEN,)).beside(NamedPoses((NamedPose("kitchen", np.zeros(3)), DESK)))
    assert both.names == ("desk", "kitchen", "kitchen 2")
    assert_allclose(both.named("kitchen").pose, KITCHEN.pose)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"format": "else"}, "is not of format"),
        ({"version": 2}, "its version is 2"),
        ({"places": {}}, "its places are no list"),
        ({"places": [{"name": "a", "pose": [1, 2], "color": 3}]}, "a place has wrong fields"),
        ({"places": [{"name": "a", "pose": [1, "x"]}]}, "is no pose"),
        ({"places": [{"pose": [1, 2]}]}, "is no name for a place"),
        ({"places": [{"name": "a", "pose": [1, 2], "keyframe": -1}]}, "is -1"),
        ({"places": [{"name": "a", "pose": [1, 2], "keyframe": 1}]}, "an anchor is a keyframe and its pose"),
        ({"places": [{"name": "a", "pose": [1, 2]}, {"name": "a", "pose": [1, 3]}]}, "is given twice"),
    ],
)
def test_a_file_that_is_wrong_is_reported_by_its_path(change: dict[str, Any], problem: str, tmp_path: Path) -> None:
    path = tmp_path / "places.json"
    NamedPoses((KITCHEN,)).save(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(MapError, match=problem) as reported:
        NamedPoses.load(path)
    assert reported.value.path == path
    path.write_text("{")
    with pytest.raises(MapError, match="is no JSON"):
        NamedPoses.load(path)


def test_as_many_names_as_are_allowed_are_read_and_no_more(tmp_path: Path) -> None:
    """To count each name among all others would take a minute of 100 000."""
    path, places = tmp_path / "places.json", [{"name": f"shelf {k}", "pose": [0.0, 0.0]} for k in range(40_000)]
    document = {"format": "wheelsight-named-poses", "version": 1}
    path.write_text(json.dumps(document | {"places": places}, indent=1))
    with pytest.raises(MapError, match=r"places\.json: holds 40,000 names, more than 10,000"):
        NamedPoses.load(path)
    path.write_text(json.dumps(document | {"places": places[:2000]}, indent=1))
    found = NamedPoses.load(path)
    assert len(found) == 2000
    with pytest.raises(MapError, match=r"known: shelf 0, .* and 1,950 more"):
        found.named("desk")
    path.write_text(json.dumps(document | {"places": [*places[:2000], places[7]]}, indent=1))
    with pytest.raises(MapError, match="the name 'shelf 7' is given twice"):
        NamedPoses.load(path)
    with pytest.raises(MapError, match="there are more than 10,000 names"):
        NamedPoses((KITCHEN,) * 10_001)


def test_many_names_that_both_maps_have_get_numbers(tmp_path: Path) -> None:
    long = "a" * 58
    first = NamedPoses(tuple(NamedPose(name, np.zeros(2)) for name in ("a", "a 2", "b", f"{long}1", f"{long}2")))
    both = first.beside(NamedPoses(first.poses))
    assert both.names[:6] == ("a", "a 2", "a 2 2", "a 3", f"{'a' * 54} 2", f"{'a' * 54} 3")
    shelves = NamedPoses(tuple(NamedPose(f"{'x' * 55}{k}", np.zeros(2)) for k in range(1000)))
    assert len(shelves.beside(shelves)) == 2000
