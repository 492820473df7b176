from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from synthetic import make_tum_recording
from typer.testing import Result

from wheelsight.app.cli.run import RunStatus, count
from wheelsight.app.run import FrameRecord
from wheelsight.core.estimates import Status

Command = Callable[..., Result]
MAPPED = ("--odometry", "dense", "--map", "surfels")


def answer(status: Status = Status.TRACKING, surfels: int | None = None, dropped: int = 0) -> FrameRecord:
    return FrameRecord(0, 1.0, status, None, 100, 90, 0.01, surfels=surfels, surfels_dropped=dropped)


def test_a_terminal_sees_the_map_grow(wheelsight: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "140")
    make_tum_recording(tmp_path / "room", frames=4)
    result = wheelsight("run", tmp_path / "room", *MAPPED, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    surfels = json.loads((tmp_path / "out" / "metrics.json").read_text())["map"]["surfels"]
    assert f"tracking · {count(surfels)} surfels" in result.stderr
    assert "frames/s" in result.stderr
    path = tmp_path / "out" / "map" / "map.surfels"
    assert path.is_file()
    assert f"map: {path} ({surfels:,} surfels, " in result.stdout.replace("\n", "")
    assert wheelsight("export", tmp_path / "out", "--ply", "--all").exit_code == 0
    assert (tmp_path / "out" / "points.ply").is_file()  # in the run's folder, and not among the map's files
    assert wheelsight("export", path, "--ply", "--all", "--force").exit_code == 0


def test_a_map_needs_dense_odometry(refusal: Callable[..., str], room: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out")
    assert (
        refusal("run", room, "--odometry", "features", "--map", "surfels", *out)
        == "--map is built by dense odometry (add --odometry dense)"
    )
    assert refusal("run", room, "--odometry", "dense", "--map", "voxels", *out) == (
        "--map is 'voxels' (known: 'surfels')"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("n", "text"), [(0, "0"), (950, "950"), (411_600, "412k"), (999_600, "1.00M"), (2_345_678, "2.35M")]
)
def test_counts_are_short(n: int, text: str) -> None:
    assert count(n) == text


def test_status_and_size_are_reported_and_what_was_given_up() -> None:
    reported = RunStatus()
    assert reported.after({"dense": answer(surfels=411_600)}) == "tracking · 412k surfels"
    full = reported.after({"dense": answer(Status.FAILING, 3_000_000, 12_300)})
    assert full == "failing · 3.00M surfels, 12k given up for want of room"


def test_of_several_each_is_reported_by_its_name() -> None:
    reported = RunStatus()
    reported.after({"wheels": answer()})
    assert reported.after({"dense": answer(surfels=900)}) == "wheels tracking, dense tracking · 900 surfels"


def test_joined_sensors_are_reported_first() -> None:
    reported = RunStatus()
    reported.after({"wheels": answer(), "joined": answer(surfels=900)})
    assert (
        reported.after({"dense": answer(Status.LOST)}) == "joined tracking · 900 surfels, wheels tracking, dense lost"
    )
