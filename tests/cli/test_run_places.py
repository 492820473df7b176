from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from area_drive import write_area_drive
from typer.testing import Result

from wheelsight.core.areas import AreaMap, load_areas, save_areas

Command = Callable[..., Result]
BY_PLACES = ("--odometry", "wheels", "--places")


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A sound recording of a drive through three areas; three.places beside it is trained on them."""
    write_area_drive(tmp_path / "drive")
    return tmp_path / "drive"


def test_rectified_wheels_are_summed_up_beside_the_wheels(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = wheelsight("run", drive, *BY_PLACES, tmp_path / "three.places", "--out", out)
    assert result.exit_code == 0, result.output
    first_words = [line.split()[0] for line in result.stdout.splitlines() if line.split()]
    assert first_words.count("wheels") == first_words.count("rectified") == 2
    assert "distance from the truth, nothing aligned" in result.stdout
    assert "The start was taken from the ground truth" in result.stderr
    figures = json.loads((out / "rectified" / "metrics.json").read_text())
    assert figures["rectification"]["way"] == "probabilistic"


def test_every_option_of_places_reaches_its_setting(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    (drive / "areas.yaml").rename(tmp_path / "floor.yaml")
    places = ("--areas", tmp_path / "floor.yaml", "--rectify", "paper", "--start", "-0.5,1,-90")
    paper = ("--odometry-term", "absolute", "--weights", "0.1,0.8,0.1")
    model = tmp_path / "three.places"
    result = wheelsight("run", drive, *BY_PLACES, model, *places, *paper, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    written = (tmp_path / "out" / "config.yaml").read_text()
    assert f"model: {model}\n  areas: {tmp_path / 'floor.yaml'}\n  rectify: paper" in written
    assert "x_m: -0.5\n    y_m: 1.0\n    yaw_deg: -90.0" in written
    assert "odometry_term: absolute" in written
    assert "with_area:\n    - 0.1\n    - 0.8\n    - 0.1" in written


def test_bad_input_is_one_line(refusal: Callable[..., str], drive: Path, tmp_path: Path) -> None:
    out, model = ("--out", tmp_path / "out"), tmp_path / "three.places"
    assert refusal("run", drive, "--odometry", "features", "--places", model, *out).startswith(
        "--places rectifies wheels, and there are none"
    )
    assert "without a model of places" in refusal("run", drive, "--odometry", "wheels", "--rectify", "paper", *out)
    assert refusal("run", drive, *BY_PLACES, tmp_path / "no", *out).startswith(f"{tmp_path / 'no'}: cannot be read")
    save_areas(AreaMap(load_areas(drive / "areas.yaml").areas[:2]), tmp_path / "two.yaml")
    said = refusal("run", drive, *BY_PLACES, model, "--areas", tmp_path / "two.yaml", *out)
    assert said.startswith(f"{model}: the model has an area 'lift' that is not among those given")
    assert "3 numbers: X,Y,YAW_DEG" in refusal("run", drive, *BY_PLACES, model, "--start", "here", *out)
    data = model.read_bytes()
    model.write_bytes(data[: len(data) // 2])
    assert refusal("run", drive, *BY_PLACES, model, *out).startswith(f"{model}: ")
    (drive / "areas.yaml").unlink()
    assert "has no areas.yaml (give --areas FILE)" in refusal("run", drive, *BY_PLACES, model, *out)
    assert not (tmp_path / "out").exists()
