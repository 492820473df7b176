from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from typer.testing import Result

from wheelsight.calibration import Calibration, load_calibration, save_calibration
from wheelsight.trajectory import read_tum

Command = Callable[..., Result]


def test_wheels_are_run_and_summed_up(wheelsight: Command, wheels: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = wheelsight("run", wheels, "--odometry", "wheels", "--out", out)
    assert result.exit_code == 0, result.output
    assert "wheels: T_odom_base" in result.stdout
    assert "200 of 200 with a pose (100 %)" in result.stdout
    assert "time a reading" in result.stdout
    assert result.stdout.splitlines()[-1] == f"report: {out / 'report.html'}"
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["evaluation"]["ate_m"]["rmse"] < 1e-6


def test_a_robot_calibrated_once_serves_its_later_recordings(wheelsight: Command, wheels: Path, tmp_path: Path) -> None:
    robot = load_calibration(wheels / "calibration.yaml").wheels
    assert robot is not None
    better = replace(robot, left_radius_m=0.2, right_radius_m=0.2)
    save_calibration(Calibration(wheels=better), tmp_path / "better.yaml")
    for name, options in (("before", ()), ("after", ("--calibration", tmp_path / "better.yaml"))):
        result = wheelsight("run", wheels, "--odometry", "wheels", *options, "--out", tmp_path / name)
        assert result.exit_code == 0, result.output
    before, after = (read_tum(tmp_path / name / "trajectory.txt").length_m for name in ("before", "after"))
    assert after / before == pytest.approx(0.2 / 0.17, rel=1e-3)
    written = yaml.safe_load((tmp_path / "after" / "config.yaml").read_text())
    assert written["recording"]["calibration"] == str(tmp_path / "better.yaml")


def test_how_wheels_are_integrated_is_an_option(wheelsight: Command, wheels: Path, tmp_path: Path) -> None:
    options = ("--integration", "euler", "--no-gyro")
    result = wheelsight("run", wheels, "--odometry", "wheels", *options, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    written = yaml.safe_load((tmp_path / "out" / "config.yaml").read_text())
    assert written["wheels"] == {"integration": "euler", "gyro": False}


def test_info_tells_of_wheels(wheelsight: Command, wheels: Path) -> None:
    result = wheelsight("info", wheels)
    assert result.exit_code == 0, result.output
    assert "radius 0.17 m left, 0.17 m right, track 0.52 m, 3200 ticks a turn (our robot)" in result.stdout
    assert "200 in 3.98 s, 50.0 Hz" in result.stdout
    assert "Ground truth" in result.stdout
    assert "camera" not in result.stdout
    assert "depth" not in result.stdout
    figures = json.loads(wheelsight("info", wheels, "--json").stdout)
    assert (figures["frames"], figures["wheel_readings"], figures["camera"]) == (0, 200, None)


def test_what_cannot_be_run_is_one_line(refusal: Callable[..., str], wheels: Path, room: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out")
    assert refusal("run", wheels, *out).endswith("has no images (--odometry wheels)")
    assert refusal("run", room, "--odometry", "wheels", *out).endswith("has no wheel readings (--odometry features)")
    assert "no such file" in refusal("run", wheels, "--odometry", "wheels", "--calibration", "none.yaml", *out).lower()
    assert "known: 'arc', 'midpoint' or 'euler'" in refusal("run", wheels, "--integration", "rk4", *out)
    camera_only = load_calibration(room / "calibration.yaml")
    save_calibration(camera_only, wheels / "calibration.yaml")
    assert "has no wheels (give a calibration.yaml" in refusal("run", wheels, "--odometry", "wheels", *out)
    assert not (tmp_path / "out").exists()
