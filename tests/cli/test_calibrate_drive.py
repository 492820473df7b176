"""`wheelsight calibrate drive`: from commands and wheel readings to the drive model of a robot's file."""

from __future__ import annotations

from pathlib import Path
from typing import Self

import numpy as np
import pytest
from driven_logs import CHAIR, TURNS, driven, speeds_after, steps
from narrowing import not_none

from wheelsight.app.run.drives import WHEELS_FOLDER, wheels_recorded
from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.drive_model import DriveAxis
from wheelsight.core.messages import STOP, Event, VelocityCommand, WheelTicks
from wheelsight.core.robots import RobotLimits
from wheelsight.io.recordings import RecordingWriter

WHEELS = Wheels(left_radius_m=0.17, right_radius_m=0.17, track_width_m=0.6, ticks_per_turn=3200)
OBEYS = DriveAxis(dead_time_s=0.25, rise_s=0.3, fall_s=0.4, largest_command=(0.8, 0.8))


@pytest.fixture
def table(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A table as a logger writes it, every 50 ms, with turns and the way straight on by two sticks."""
    log = driven(rng, turns=TURNS, seconds=50.0)
    held = np.searchsorted(log.commands_s, log.stamps_s, side="right") - 1
    rows = np.column_stack([log.stamps_s, log.forward[held], log.turn[held], log.left_m_s, log.right_m_s])
    header = "stamp_s,joystick_forward,joystick_turn,left_m_s,right_m_s"
    np.savetxt(path := tmp_path / "sticks.csv", rows, delimiter=",", header=header, comments="", fmt="%.6f")
    return path


@pytest.fixture
def recording(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A recording of velocity commands, straight on alone, and of ticks."""
    stamps_s = np.arange(0.0, 40.0, 0.02)
    commands = steps(rng, 0.8, 40.0)
    way_m = np.cumsum(speeds_after(OBEYS, commands, stamps_s)) * 0.02
    ticks = np.rint(way_m / WHEELS.left_m_per_tick).astype(int)
    with RecordingWriter(tmp_path / "driven", Calibration(wheels=WHEELS)) as writer:
        for stamp_s, command in commands.tolist():
            writer.add_command(100.0 + stamp_s, VelocityCommand(command, 0.0))
        for stamp_s, count in zip(stamps_s.tolist(), ticks.tolist(), strict=True):
            writer.add(WheelTicks(100.0 + stamp_s, count, count))
    return tmp_path / "driven"


@pytest.mark.slow
def test_a_table_gives_a_model_and_a_page(wheelsight, table, tmp_path):
    out = tmp_path / "robot.yaml"
    save_calibration(Calibration(wheels=WHEELS), out)
    result = wheelsight("calibrate", "drive", table, "--calibration", out, "--out", out, "--force")
    assert result.exit_code == 0, result.output
    for word in ("dead time", "time constant, slowing down", "way to a stand from 1 m/s", "kept in it: wheels"):
        assert word in result.stdout
    found = load_calibration(out)
    model = not_none(found.drive_model)
    assert found.wheels == WHEELS
    assert model.command == "joystick"
    assert model.track_width_m == pytest.approx(0.6)
    # A row shows a command up to its period late.
    assert not_none(model.straight).dead_time_s == pytest.approx(CHAIR.dead_time_s, abs=0.05)
    assert not_none(model.turn).fall_s == pytest.approx(TURNS.fall_s, rel=0.3)
    assert "Measured and predicted" in out.with_suffix(".html").read_text(encoding="utf-8")
    listed = wheelsight("calibrate", "robot", out)
    assert "drive_model: dead time" in listed.stdout


def test_a_recording_gives_a_model(wheelsight, recording, tmp_path):
    out = tmp_path / "robot.yaml"
    result = wheelsight("calibrate", "drive", recording, "--out", out)
    assert result.exit_code == 0, result.output
    model = not_none(load_calibration(out).drive_model)
    straight = not_none(model.straight)
    assert model.command == "velocity"
    assert model.turn is None
    assert straight.dead_time_s == pytest.approx(OBEYS.dead_time_s, abs=0.02)
    assert straight.fall_s == pytest.approx(OBEYS.fall_s, rel=0.1)
    assert straight.speed_m_s(0.5) == pytest.approx(0.5, abs=0.02)
    assert "not shown: turns" in result.output.replace("\n", " ")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("stamp_s,left_m_s,right_m_s\n0,0,0\n1,0,0\n", "joystick"),
        ("stamp_s,joystick,left_m_s,right_m_s\n0,0,0,x\n1,0,0,0\n", ":2:"),
        ("stamp_s,joystick,left_m_s,right_m_s\n0,1,0,0\n1,1,0,0\n2,0,0,0\n", "no wheel moves"),
        ("", "has no column"),
    ],
)
def test_a_bad_table_is_refused_in_a_line(refusal, tmp_path, text, words):
    path = tmp_path / "log.csv"
    path.write_text(text)
    assert words in refusal("calibrate", "drive", path, "--out", tmp_path / "out.yaml")
    assert not (tmp_path / "out.yaml").exists()


def test_a_recording_without_commands_is_refused(refusal, tmp_path):
    with RecordingWriter(tmp_path / "driven", Calibration(wheels=WHEELS)) as writer:
        for stamp in range(3):
            writer.add(WheelTicks(float(stamp), stamp, stamp))
    line = refusal("calibrate", "drive", tmp_path / "driven", "--out", tmp_path / "out.yaml")
    assert "commands.csv" in line


def test_a_model_of_another_robot_is_refused(refusal, wheelsight, recording, tmp_path):
    out = tmp_path / "robot.yaml"
    assert wheelsight("calibrate", "drive", recording, "--out", out).exit_code == 0
    save_calibration(Calibration(wheels=Wheels(0.1, 0.1, 0.3, 1000)), tmp_path / "small.yaml")
    files = (tmp_path / "small.yaml", out, tmp_path / "small.yaml")
    options = [word for file in files for word in ("--calibration", file)]
    line = refusal("run", recording, "--odometry", "wheels", *options, "--out", tmp_path / "run")
    assert "track width" in line
    assert "calibrate drive" in line


QUICK = RobotLimits(acceleration_m_s2=3.0, braking_m_s2=5.0, turn_acceleration_rad_s2=10.0, jerk_m_s3=50.0)


class Standing:
    """A robot that returns ticks of its commands' sizes."""

    calibration = Calibration(wheels=WHEELS)
    stop_reason = ""

    def __init__(self) -> None:
        self.now_s = 7.0
        self.count = 0

    def step(self, command: VelocityCommand) -> list[Event]:
        self.now_s += 0.05
        self.count += round(100 * command.forward_m_s)
        return [WheelTicks(self.now_s, self.count, self.count)]

    def stop(self) -> None: ...

    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...


def test_a_drive_leaves_its_commands(tmp_path):
    """Changes of the command as the robot limits it, with the time at which it got them."""
    asked = [STOP, STOP, *[VelocityCommand(0.5, 0.1)] * 8, *[STOP] * 8]
    with wheels_recorded(Standing(), tmp_path, QUICK) as robot:
        for command in asked:
            robot.step(command)
    lines = (tmp_path / WHEELS_FOLDER / "commands.csv").read_text().splitlines()
    assert lines[0] == "stamp_s,forward_m_s,turn_rad_s"
    found = np.array([line.split(",") for line in lines[1:]], float)
    np.testing.assert_allclose(found[0], [7.0, 0, 0])
    np.testing.assert_allclose(found[1, [0, 2]], [7.1, 0.1])
    assert found[:, 1].max() == pytest.approx(0.5)
    # Faster than its limits is no command; the last one is a stop.
    assert np.diff(found[:, 1]).max() <= 0.03 + 1e-9
    assert np.diff(found[:, 1]).min() == pytest.approx(-0.05)
    np.testing.assert_allclose(found[-1, 1:], 0)
    assert len((tmp_path / WHEELS_FOLDER / "wheels.csv").read_text().splitlines()) == 19
