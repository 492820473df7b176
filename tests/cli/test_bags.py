"""Bags at the command line: what is in them, which topics are used, and a run by their wheels."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result
from written_bags import COLOR, DEPTH, camera_drive, circle, odometry_drive, robot_drive, write_bag

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.trajectory import read_tum
from wheelsight.io.recordings import open_recording

Command = Callable[..., Result]


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    return write_bag(tmp_path / "robot.bag", robot_drive())


def test_info_lists_topics_and_what_each_is_used_as(wheelsight: Command, robot: Path) -> None:
    result = wheelsight("info", robot)
    assert result.exit_code == 0, result.output
    topics = result.stdout.partition("Topics")[2].splitlines()
    reported = {line.split()[0]: " ".join(line.split()[1:]) for line in topics if line.startswith("/")}
    assert reported[COLOR] == "6 × Image, used as color"
    assert reported[DEPTH] == "6 × Image, used as depth"
    assert reported["/camera/color/camera_info"] == "6 × CameraInfo, used as color_info"
    assert reported["/odom"] == "60 × Odometry, used as wheels"
    assert reported["/imu"] == "60 × Imu, used as gyro"
    assert reported["/joint_states"] == "60 × JointState"
    assert "6 colour, 6 depth, 0 and 0 without a partner" in result.stdout
    assert "wheels are known by increments of its poses" in result.stderr


def test_json_lists_them_too(wheelsight: Command, robot: Path) -> None:
    figures = json.loads(wheelsight("info", robot, "--json", "--topic", "gyro=none").stdout)
    used = {topic["name"]: topic["used_as"] for topic in figures["topics"]}
    assert used["/odom"] == "wheels"
    assert used["/imu"] == ""
    assert (figures["frames"], figures["wheel_readings"], figures["yaw_readings"]) == (6, 60, 0)


def test_a_run_by_the_wheels_of_a_bag_ends_where_its_odometry_does(wheelsight: Command, tmp_path: Path) -> None:
    bag, out = write_bag(tmp_path / "drive", odometry_drive()), tmp_path / "out"
    result = wheelsight("run", bag, "--odometry", "wheels", "--out", out)
    assert result.exit_code == 0, result.output
    assert "no ground truth" in result.stdout
    found = read_tum(out / "trajectory.txt")
    assert found.positions_m[-1][:2] == pytest.approx(circle(2.95)[:2], abs=1e-5)
    assert "topics" in (out / "config.yaml").read_text()


def test_a_topic_that_is_not_there_ends_with_2_and_one_line(wheelsight: Command, robot: Path) -> None:
    result = wheelsight("info", robot, "--topic", "wheels=/nowhere")
    assert result.exit_code == 2
    assert "--topic wheels=/nowhere: robot.bag has no messages of it (there are: /joint_states, /odom)" in result.stderr


def test_a_bag_with_nothing_to_go_by_lists_what_it_has(wheelsight: Command, tmp_path: Path) -> None:
    result = wheelsight("info", write_bag(tmp_path / "drive", camera_drive().without(DEPTH)))
    assert result.exit_code == 2
    assert "holds nothing to localize by" in result.stderr
    assert "/tf_static (TFMessage, 1)" in result.stderr


ROLE = ("--topic", "wheels=/nowhere")


@pytest.mark.parametrize(
    "words",
    [
        ("calibrate", "wheels", "BAG", "--out", "w.yaml"),
        ("calibrate", "umbmark", "BAG", "BAG", "--out", "w.yaml"),
        ("calibrate", "base", "BAG", "--out", "b.yaml"),
        ("calibrate", "robot", "CALIBRATION", "--check", "BAG"),
        ("places", "label", "BAG", "--out", "labels.html"),
        ("places", "train", "BAG", "--out", "p.places"),
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_other_commands_take_topics_too(
    words: tuple[str, ...], wheelsight: Command, robot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    save_calibration(Calibration(wheels=Wheels(0.17, 0.17, 0.52, 3200.0)), tmp_path / "robot.yaml")
    given = {"BAG": str(robot), "CALIBRATION": "robot.yaml"}
    result = wheelsight(*(given.get(word, word) for word in words), *ROLE)
    assert result.exit_code == 2, result.output
    assert "--topic wheels=/nowhere: robot.bag has no messages of it" in result.stderr


def test_a_bag_is_recorded_as_a_camera_is_by_the_topics_that_are_named(wheelsight: Command, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "film", camera_drive())
    words = ("record", "--camera", f"recording:{bag}", "--out", tmp_path / "out")
    nowhere = wheelsight(*words, "--topic", "color=/nowhere")
    assert nowhere.exit_code == 2
    assert "--topic color=/nowhere" in nowhere.stderr
    result = wheelsight(*words, "--topic", f"color={COLOR}", "--topic", f"depth={DEPTH}", "--seconds", 5)
    assert result.exit_code == 0, result.output
    assert open_recording(tmp_path / "out").frame_count >= 3
    refused = wheelsight("record", "--camera", "realsense", "--topic", "gyro=none", "--out", tmp_path / "other")
    assert refused.exit_code == 2
    assert "--topic is of a bag" in refused.stderr
