"""The command of docs/ros2.md for Nav2, typed beside drivers that are another program, with small names and times."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from links.test_dds import program
from links.test_sensors import drivers
from room_drive import make_room_drive
from typer.testing import CliRunner

from wheelsight.app.cli import app

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed")
DOMAIN = 107
PAGE = Path(__file__).resolve().parents[2] / "docs" / "ros2.md"


@pytest.mark.slow
def test_localization_in_a_map_gives_transforms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    section = PAGE.read_text(encoding="utf-8").partition("**As localization.**")[2].partition("**As all")[0]
    typed = re.findall(r"^\$ wheelsight (.*)$", section, re.MULTILINE)
    assert len(typed) == 2
    make_room_drive(tmp_path / "drive", mounted=True, with_truth=False)
    bag = tmp_path / "room.mcap"
    made = CliRunner().invoke(app, ["export", str(tmp_path / "drive"), "--bag", str(bag), "--images", "raw"])
    assert made.exit_code == 0, made.output
    monkeypatch.chdir(tmp_path)
    # The map of the first command, from the same drive recorded: a live run takes a minute to be ready.
    made = CliRunner().invoke(app, ["run", "drive", "--map", "surfels", "--out", "home"])
    assert made.exit_code == 0, made.output
    # The bag has joints of wheels, whose sizes are in the calibration.
    line = typed[1].replace("/wheel/odom", "/joint_states")
    line += f" --seconds 5 --domain {DOMAIN} --calibration drive/calibration.yaml"
    with drivers(DOMAIN, bag, monkeypatch), program(DOMAIN) as other:
        done = CliRunner().invoke(app, shlex.split(line))
        assert done.exit_code == 0, done.output
        pairs = {
            (one["header"]["frame_id"], one["child_frame_id"])
            for message in [other.last("tf"), *other.received["tf"]]
            for one in message["transforms"]
        }
    assert ("odom", "base_link") in pairs
    assert any((tmp_path / "today").rglob("trajectory.txt"))
