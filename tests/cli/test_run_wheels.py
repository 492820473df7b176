from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import Result

from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.trajectory import read_tum

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


def test_wheels_without_images_are_followed_alone_and_it_is_said(
    wheelsight: Command, wheels: Path, tmp_path: Path
) -> None:
    result = wheelsight("run", wheels, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert result.stderr == "the wheels alone are followed (--odometry wheels)\n"
    assert yaml.safe_load((tmp_path / "out" / "config.yaml").read_text())["odometry"] == "wheels"
    reported = wheelsight("run", wheels, "--odometry", "wheels", "--out", tmp_path / "named")
    assert reported.stderr == ""
    assert (tmp_path / "named" / "trajectory.txt").read_bytes() == (tmp_path / "out" / "trajectory.txt").read_bytes()


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
    assert (written["wheels"]["integration"], written["wheels"]["gyro"]) == ("euler", False)


def test_info_shows_wheels(wheelsight: Command, wheels: Path) -> None:
    result = wheelsight("info", wheels)
    assert result.exit_code == 0, result.output
    assert "radius 0.17 m left, 0.17 m right, track 0.52 m, 3200 ticks a turn (our robot)" in result.stdout
    assert "200 in 3.98 s, 50.0 Hz" in result.stdout
    assert "Ground truth" in result.stdout
    assert "camera" not in result.stdout
    assert "depth" not in result.stdout
    figures = json.loads(wheelsight("info", wheels, "--json").stdout)
    assert (figures["frames"], figures["wheel_readings"], figures["camera"]) == (0, 200, None)


def turning_folder(folder: Path, factor: float, late_s: float = 0.0) -> Path:
    """Wheels that turn to and fro for 20 s, and a gyroscope of which the rates and stamps are those, changed."""
    folder.mkdir()
    robot = Wheels(0.17, 0.17, 0.52, 3200.0)
    save_calibration(Calibration(wheels=robot, source="our robot"), folder / "calibration.yaml")
    rng, yaw = np.random.default_rng(1), 0.8 * np.sin(0.02 * np.arange(1000) / 1.5)
    ticks = np.floor(yaw * robot.track_width_m / 2 / robot.left_m_per_tick).astype(int)
    rows = [f"{0.02 * i:.2f},{900 * i // 20 - turned},{900 * i // 20 + turned}" for i, turned in enumerate(ticks)]
    (folder / "wheels.csv").write_text("\n".join(["stamp_s,left,right", *rows]) + "\n")
    rates = factor * (np.gradient(yaw, 0.02) + rng.normal(0, 0.007, 1000))
    rows = [f"{0.02 * i + late_s:.3f},{rate:.6f}" for i, rate in enumerate(rates)]
    (folder / "gyro.csv").write_text("\n".join(["stamp_s,yaw_rate_rad_s", *rows]) + "\n")
    return folder


@pytest.mark.parametrize(
    ("factor", "late_s", "said"),
    [(-1.0, 0.0, "turns the other way"), (57.3, 0.0, "degrees instead of radians?"), (1.0, 1.6e9, "")],
)
def test_a_gyroscope_that_contradicts_the_wheels_is_warned_of(
    wheelsight: Command, tmp_path: Path, factor: float, late_s: float, said: str
) -> None:
    recording = turning_folder(tmp_path / "recording", factor, late_s)
    reported = wheelsight("info", recording)
    run = wheelsight("run", recording, "--odometry", "wheels", "--out", tmp_path / "out")
    without = wheelsight("run", recording, "--odometry", "wheels", "--no-gyro", "--out", tmp_path / "without")
    assert (reported.exit_code, run.exit_code, without.exit_code) == (0, 0, 0), run.output
    for result in (reported, run):
        (warning,) = [line for line in result.stderr.splitlines() if line.startswith("warning:")]
        assert warning.startswith("warning: The gyroscope is left out: ")
        assert (
            said or ("do not overlap" if result is reported else "is 1.600e+09 s ahead of that of the wheels")
        ) in warning
    (warning,) = [line for line in reported.stderr.splitlines() if line.startswith("warning:")]
    assert json.loads(wheelsight("info", recording, "--json").stdout)["warnings"] == [warning.removeprefix("warning: ")]
    assert "left out" not in without.output
    assert (tmp_path / "out" / "trajectory.txt").read_bytes() == (tmp_path / "without" / "trajectory.txt").read_bytes()


def test_a_gyroscope_that_agrees_is_not_spoken_of(wheelsight: Command, tmp_path: Path) -> None:
    recording = turning_folder(tmp_path / "recording", 1.0)
    for command in (("info", recording), ("run", recording, "--odometry", "wheels", "--out", tmp_path / "out")):
        result = wheelsight(*command)
        assert result.exit_code == 0, result.output
        assert "left out" not in result.output


def test_what_cannot_be_run_is_one_line(refusal: Callable[..., str], wheels: Path, room: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out")
    assert refusal("run", wheels, "--odometry", "dense", *out).endswith("has no images (--odometry wheels)")
    assert refusal("run", wheels, "--map", "surfels", *out).endswith("has no images for --map (leave it out)")
    assert refusal("run", room, "--odometry", "wheels", *out).endswith("has no wheel readings (--odometry features)")
    assert "no such file" in refusal("run", wheels, "--odometry", "wheels", "--calibration", "none.yaml", *out).lower()
    assert "known: 'arc', 'midpoint' or 'euler'" in refusal("run", wheels, "--integration", "rk4", *out)
    camera_only = load_calibration(room / "calibration.yaml")
    save_calibration(camera_only, wheels / "calibration.yaml")
    assert "has no wheels (give a calibration.yaml" in refusal("run", wheels, "--odometry", "wheels", *out)
    assert not (tmp_path / "out").exists()
