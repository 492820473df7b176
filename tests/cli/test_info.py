from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result

Command = Callable[..., Result]


def test_it_shows_what_is_in_a_recording(wheelsight: Command, room: Path) -> None:
    result = wheelsight("info", room)
    assert result.exit_code == 0
    lines = {line[:16].strip(): line[16:].strip() for line in result.stdout.splitlines()}
    assert "10 in 0.30 s, 30.0 Hz" in result.stdout
    assert "320 × 240, f 262, 260 px (synthetic room)" in result.stdout
    assert "10 colour, 10 depth, 0 and 0 without a partner; at most 2.0 ms apart" in result.stdout
    assert "none over three periods" in result.stdout
    assert "100 % of pixels" in result.stdout
    assert "registered, by the calibration; the images agree" in result.stdout
    assert "Ground truth" in lines
    assert result.stderr == ""
    assert "\x1b" not in result.output


def test_json_holds_the_same(wheelsight: Command, room: Path) -> None:
    figures = json.loads(wheelsight("info", room, "--json").stdout)
    assert figures["frames"] == 10
    assert figures["valid_depth_share"] == 1
    assert figures["ground_truth"]["duration_s"] == pytest.approx(0.3, abs=1e-3)
    assert figures["warnings"] == []


def test_a_damaged_image_is_counted_and_named(wheelsight: Command, room: Path) -> None:
    path = sorted((room / "depth").iterdir())[4]
    path.write_bytes(path.read_bytes()[:2000])
    result = wheelsight("info", room)
    assert result.exit_code == 0
    assert "1 × depth image is cut off" in result.stdout


def test_a_depth_scale_that_is_probably_wrong_is_warned_of(wheelsight: Command, room: Path) -> None:
    result = wheelsight("info", room, "--depth-factor", "80000")
    assert result.exit_code == 0
    assert result.stderr.startswith("warning: Most depth lies outside the 0.3 to 10 m")
    assert "See --depth-factor." in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.data
def test_the_kitchen_is_said_to_be_unregistered(wheelsight: Command, data_folder: Path) -> None:
    result = wheelsight("info", data_folder / "rgbd" / "red_kitchen")
    assert result.exit_code == 0
    assert (
        "not registered; the calibration joins them; in the middle of the image colour lies 8 px left" in result.stdout
    )
    assert "500 in 16.63 s, 30.0 Hz" in result.stdout


def test_one_frame_has_no_rate(wheelsight: Command, room: Path) -> None:
    for name in ("rgb.txt", "depth.txt"):
        lines = (room / name).read_text().splitlines()
        (room / name).write_text("\n".join([line for line in lines if not line.startswith("#")][:1]) + "\n")
    result = wheelsight("info", room)
    assert result.exit_code == 0
    assert "1 in 0.00 s" in result.stdout
    assert "nan" not in result.output


def test_the_sample_comes_along(wheelsight: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = wheelsight("info", "sample")
    assert result.exit_code == 0, result.output
    assert "151 in 38.50 s" in result.stdout
    assert result.stderr == ""


def test_a_folder_named_sample_wins_with_a_note(
    wheelsight: Command, wheels: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    wheels.rename(tmp_path / "sample")
    result = wheelsight("info", "sample")
    assert result.exit_code == 0, result.output
    assert "151 in" not in result.stdout
    assert result.stderr.splitlines()[0] == (
        "sample is the one in the current folder, not the recording that comes with wheelsight"
    )
