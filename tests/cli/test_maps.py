from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from grids import mostly_slow
from sessions.kept_views import write_map
from sessions.mounted_maps import WAY, drive
from sessions.seen_maps import RING, aside, write_seen
from typer.testing import Result

from wheelsight.io.ros_map import read_ros_map
from wheelsight.slam.maps import MapFolder
from wheelsight.slam.maps.journal import read_journal

Command = Callable[..., Result]


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    (tmp_path / "run").mkdir()
    write_map(tmp_path / "run" / "map", 5)
    return tmp_path / "run"


def damage(run: Path) -> None:
    path = run / "map" / "keyframes-00000.journal"
    data = bytearray(path.read_bytes())
    data[read_journal(path).records[1][0].offset + 99] ^= 1
    path.write_bytes(data)


def test_what_a_map_holds_is_reported_within_80_columns(
    wheelsight: Command, kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    result = wheelsight("map", "info", kept)
    assert result.exit_code == 0, result.output
    lines = [line.rstrip() for line in result.stdout.splitlines()]
    assert lines[0] == "map of made up"
    assert max(map(len, lines)) <= 80
    facts = {line.split()[0]: " ".join(line.split()[1:]) for line in lines[1:]}
    assert facts["camera"] == "64×48, fx 60.0, fy 60.0, cx 31.5, cy 23.5 px"
    assert facts["keyframes"].startswith("5, ")
    assert facts["edges"] == "4 by odometry, 0 loops; all hang together"
    assert facts["surfels"] == "none; wheelsight map rebuild makes them"
    assert facts["time"] == "4.0 s"
    assert facts["health"] == "whole"
    assert result.stderr == ""


def test_damage_is_reported_in_the_table_and_as_json(wheelsight: Command, kept: Path) -> None:
    damage(kept)
    result = wheelsight("map", "info", kept / "map")
    assert result.exit_code == 0, result.output
    assert "damaged, see below" in result.stdout
    first, second = result.stderr.splitlines()
    assert first.startswith("warning: keyframes-00000.journal: ")
    assert second == "warning: 1 keyframes are lost: 1."
    reported = json.loads(wheelsight("map", "info", kept, "--json").stdout)
    assert reported["health"]["is_whole"] is False
    assert reported["keyframes"] == 4
    assert (reported["source"], reported["camera"]["width"]) == ("made up", 64)


def test_a_cut_end_is_reported_in_the_table(wheelsight: Command, kept: Path) -> None:
    with (kept / "map" / "keyframes-00000.journal").open("ab") as journal:
        journal.write(b"half a record")
    result = wheelsight("map", "info", kept)
    assert result.exit_code == 0, result.output
    assert "whole but for its end, see below" in result.stdout
    assert result.stderr.startswith("warning: The drive was cut off: ")


def test_a_map_is_rebuilt_and_its_points_are_written(wheelsight: Command, kept: Path, tmp_path: Path) -> None:
    result = wheelsight("map", "rebuild", kept, "--out", tmp_path / "new")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("5 keyframes, 0 loops, ")
    assert MapFolder.open(tmp_path / "new").surfels() is not None
    full = wheelsight("map", "rebuild", kept, "--out", tmp_path / "new").stderr
    assert "is not empty (choose a folder that is empty or not there yet" in full
    assert "--force" not in full
    ply = tmp_path / "points.ply"
    result = wheelsight("map", "export", tmp_path / "new", "--all", "--out", ply)
    assert result.exit_code == 0, result.output
    assert ply.read_bytes().startswith(b"ply\n")
    count = int(result.stdout.split()[0].replace(",", ""))
    assert f"element vertex {count}\n".encode() in ply.read_bytes()[:500]
    assert "is there already" in wheelsight("map", "export", tmp_path / "new", "--out", ply).stderr
    bare = wheelsight("map", "export", kept, "--all", "--out", tmp_path / "bare.ply")
    assert bare.stderr.strip() == "the map has no surfels; they are fused of its keyframes"
    assert bare.stdout.split()[0] == result.stdout.split()[0]


def test_what_of_the_floor_is_free_is_exported_and_drawn(wheelsight: Command, tmp_path: Path) -> None:
    drive(tmp_path / "map", WAY).close()
    facts = wheelsight("map", "info", tmp_path / "map").stdout
    assert re.search(r"^occupancy +1\d kB", facts, re.MULTILINE)
    plan, picture = tmp_path / "plan.yaml", tmp_path / "plan.png"
    asked = ("map", "export", tmp_path / "map", "--occupancy", plan, "--picture", picture, "--resolution", 0.1)
    result = wheelsight(*asked)
    assert result.exit_code == 0, result.output
    first, second = result.stdout.splitlines()
    assert re.fullmatch(r"6\.[3-6] × 4\.[3-6] m in cells of 0\.1 m, 2\d\.\d m² free: .+plan\.yaml, plan\.pgm", first)
    found = read_ros_map(plan)
    assert found.resolution_m == 0.1
    assert set(np.unique(found.occupancy)) == {-1, 0, 100}
    image = cv2.imread(str(picture))
    assert image is not None
    (x, y, _), (rows, columns) = found.origin, found.occupancy.shape
    reach = f"x {x:.2f} to {x + 0.1 * columns:.2f} m, y {y:.2f} to {y + 0.1 * rows:.2f} m"
    assert second == f"{image.shape[1]} × {image.shape[0]} pixels: {picture}; above its legend {reach}"
    assert "is there already" in wheelsight(*asked).stderr
    assert wheelsight(*asked, "--force").exit_code == 0


@pytest.mark.parametrize("count", mostly_slow([0, 1, 2], [1]))
def test_every_command_takes_a_map_of_few_keyframes(wheelsight: Command, tmp_path: Path, count: int) -> None:
    """Such as one that was saved before the robot moved; without keyframes some have nothing to work on."""
    drive(tmp_path / "map", WAY[:count]).close()
    asked = (
        ("info",),
        ("name", "kitchen", "--at", "1,0,0"),
        ("name", "--list"),
        ("zone", "--keep-out", "1,1", "2,1", "2,2"),
        ("zone", "--wipe", "1,1", "2,2"),
        ("zone",),
        ("zone", "--forget", "1"),
        ("export", "--occupancy", tmp_path / "plan.yaml", "--picture", tmp_path / "plan.png"),
        ("export", "--all", "--out", tmp_path / "points.ply"),
        ("rebuild", "--out", tmp_path / "rebuilt"),
        ("prune", "--out", tmp_path / "pruned"),
        ("merge", tmp_path / "map", "--out", tmp_path / "merged"),
    )
    for name, *options in asked:
        result = wheelsight("map", name, tmp_path / "map", *options)
        said = " ".join(result.stderr.split())
        if not count and (name in ("rebuild", "prune", "merge") or "--all" in options):
            assert (result.exit_code, said.endswith("has no keyframes (give a map of a drive that kept some)")) == (
                2,
                True,
            )
        elif name == "merge":  # the views of these maps show too little to be recognised
            assert (result.exit_code, "is recognised in it" in said) == (2, True)
        else:
            assert result.exit_code == 0, (name, options, result.output)


def test_what_cannot_be_exported_is_refused_in_a_line(refusal: Callable[..., str], kept: Path, tmp_path: Path) -> None:
    assert refusal("map", "export", kept).startswith("nothing is asked for (--out points.ply, --occupancy plan.yaml")
    occupancy = ("map", "export", kept, "--occupancy")
    assert "does not end in .yaml or .yml" in refusal(*occupancy, tmp_path / "plan.pgm")
    assert "pose above the floor is unknown" in refusal(*occupancy, tmp_path / "plan.yaml")
    (tmp_path / "plan.pgm").touch()
    assert "plan.pgm: is there already" in refusal(*occupancy, tmp_path / "plan.yaml")
    assert "--resolution is of occupancy maps" in refusal(
        "map", "export", kept, "--out", tmp_path / "points.ply", "--resolution", 0.1
    )
    assert "does not end in .png" in refusal("map", "export", kept, "--picture", tmp_path / "plan.jpg")


def test_what_is_no_map_is_refused_in_a_line(refusal: Callable[..., str], kept: Path, tmp_path: Path) -> None:
    assert refusal("map", "info", tmp_path / "nowhere").endswith("nowhere: there is no such folder (check the path)")
    assert "does not end in .ply" in refusal("map", "export", kept, "--out", tmp_path / "points.obj")
    path = kept / "map" / "map.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"version": 9}))
    assert "is of version 9, newer than 1" in refusal("map", "info", kept)


def test_places_get_names_that_can_be_listed_and_forgotten(wheelsight: Command, kept: Path) -> None:
    reported = wheelsight("map", "name", kept, "kitchen", "--at", "0.5,0.2,90")
    assert reported.exit_code == 0, reported.output
    assert re.fullmatch(r"kitchen is at 0\.50, 0\.20 m, 90°, and moves with keyframe \d\n", reported.stdout)
    assert wheelsight("map", "name", kept / "map", "desk", "--at", "-1,0").exit_code == 0
    listed = [line.split(maxsplit=1) for line in wheelsight("map", "name", kept, "--list").stdout.splitlines()]
    assert [(name, where.strip()) for name, where in listed[1:]] == [
        ("desk", "-1.00, 0.00 m, any heading"),
        ("kitchen", "0.50, 0.20 m, 90°"),
    ]
    assert re.search(r"^places +desk, kitchen", wheelsight("map", "info", kept).stdout, re.MULTILINE)
    assert wheelsight("map", "name", kept, "kitchen", "--remove").stdout == "forgotten: kitchen\n"
    assert [one.name for one in MapFolder.open(kept / "map").named_poses()] == ["desk"]


def test_a_name_where_no_keyframe_sees_floor_is_warned_of(wheelsight: Command, kept: Path) -> None:
    assert wheelsight("map", "name", kept, "near", "--at", "3,0,0").stderr == ""
    reported = wheelsight("map", "name", kept, "far", "--at", "100,0,0")
    assert reported.exit_code == 0
    words = " ".join(reported.stderr.split())
    assert re.match(r"warning: far is 9\d\.\d m from the nearest keyframe, which shows the floor to 5 m", words)


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("kitchen",), "one of --at, --remove and --list is needed"),
        (("kitchen", "--at", "1,2", "--remove"), "one of --at, --remove and --list is needed"),
        (("--at", "1,2"), "NAME is missing"),
        (("kitchen", "--list"), "--list is of all names"),
        (("kitchen", "--at", "1"), "--at is '1' (X,Y,YAW_DEG in metres and degrees"),
        (("kitchen", "--at", "1,nan,3"), "--at is '1,nan,3'"),
        (("a,b", "--at", "1,2"), "'a,b' is no name for a place"),
        (("kichen", "--remove"), "no place of the map is called 'kichen'"),
    ],
)
def test_names_that_mean_nothing_are_refused(
    refusal: Callable[..., str], kept: Path, words: tuple[str, ...], problem: str
) -> None:
    assert refusal("map", "name", kept, *words).startswith(problem)
    assert not (kept / "map" / "places.json").exists()


def test_two_maps_are_merged_and_pruned(wheelsight: Command, tmp_path: Path) -> None:
    write_seen(tmp_path / "monday", RING[:4])
    write_seen(tmp_path / "tuesday", [aside(T, 0.03) for T in RING[:5]], begin_s=100.0)
    for day in ("monday", "tuesday"):
        assert wheelsight("map", "name", tmp_path / day, "here", "--at", "0,0").exit_code == 0
        assert wheelsight("map", "zone", tmp_path / day, "--area", "room", "-1,-1", "1,1").exit_code == 0
    result = wheelsight("map", "merge", tmp_path / "monday", tmp_path / "tuesday", "--out", tmp_path / "both")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("4 keyframes and 5, joined by ")
    assert result.stderr == ""
    result = wheelsight("map", "prune", tmp_path / "both", "--out", tmp_path / "pruned")
    assert result.exit_code == 0, result.output
    count = len(MapFolder.open(tmp_path / "pruned").store)
    assert 5 <= count < 9
    assert result.stdout.startswith(f"{count} keyframes, {9 - count} left out: ")
    for made in ("both", "pruned"):
        folder = MapFolder.open(tmp_path / made)
        poses = folder.named_poses()
        assert folder.map_edits().area_names == ("room", "room 2")
        assert poses.names == ("here", "here 2")
        assert all(one.keyframe is not None for one in poses)


def test_maps_that_cannot_be_merged_are_refused_and_nothing_is_written(
    refusal: Callable[..., str], kept: Path, tmp_path: Path
) -> None:
    write_seen(tmp_path / "room", RING[:2])
    out = tmp_path / "new"
    assert "is of another camera than" in refusal("map", "merge", tmp_path / "room", kept, "--out", out)
    write_map(tmp_path / "noise", 2)
    assert "nothing of " in refusal("map", "merge", kept, tmp_path / "noise", "--out", out)
    assert "is not empty" in refusal("map", "prune", kept, "--out", kept)
    assert not out.exists()
