"""`record --bag`: what is in the file however it ends, and what is refused."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from bag_contents import on_topic, whole_messages_in
from hand_fed_camera import CALIBRATION, live_frame
from typer.testing import Result

from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError, OutputError, RecordingError
from wheelsight.core.messages import AngularVelocity, RgbdFrame, WheelTicks
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.recordings import open_recording
from wheelsight_export import bag_writing as writing
from wheelsight_export.bag_writing import LiveBag

Command = Callable[..., Result]
Refusal = Callable[..., str]
ROBOT = Wheels(0.17, 0.17, 0.6, 3200.0)


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    save_calibration(Calibration(wheels=ROBOT, source="our robot"), tmp_path / "robot.yaml")
    return tmp_path / "robot.yaml"


def events_in(bag: Path) -> tuple[list[RgbdFrame], list[WheelTicks]]:
    events = list(open_recording(bag).events())
    frames = [event for event in events if isinstance(event, RgbdFrame)]
    return frames, [event for event in events if isinstance(event, WheelTicks)]


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGKILL])
def test_whatever_ends_it_leaves_all_but_the_last_second(
    film: Path, robot: Path, tmp_path: Path, by: signal.Signals
) -> None:
    bag = tmp_path / "corridor.mcap"
    with SimulatedController(tmp_path) as controller:
        controller.speeds = (60, 50)
        words = ["--bag", bag, "--camera", f"recording:{film}", "--wheels", controller.port, "--calibration", robot]
        command = [sys.executable, "-m", "wheelsight", "record", *map(str, words)]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        ends_s = time.monotonic() + 120
        while not bag.exists() or whole_messages_in(bag) < 150:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < ends_s, "it did not come"
            time.sleep(0.05)
        ended_s = time.time()
        process.send_signal(by)
        _, reported = process.communicate(timeout=60)
    assert "Traceback" not in reported
    frames, ticks = events_in(bag)
    assert len(frames) > 5
    assert len(ticks) > 20
    assert ended_s - frames[-1].stamp_s < 1.0
    assert ended_s - ticks[-1].stamp_s < 1.0
    assert all(one.stamp_s < other.stamp_s for one, other in pairwise(frames))
    for before, after in pairwise(ticks):
        periods = (after.left - before.left) / 60
        assert periods == (after.right - before.right) / 50 == int(periods) >= 1
    warnings = " ".join(open_recording(bag).warnings)
    assert ("has no end, as where its recorder was killed" in warnings) == (by is signal.SIGKILL)
    assert open_recording(bag).calibration.wheels == load_calibration(robot).wheels
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(f".{bag.name}")]
    if by is signal.SIGINT:
        assert process.returncode == 0
        assert f"{len(frames)} frames and " in reported
        assert len(on_topic(bag, "/joint_states")) == len(ticks)


def test_a_silent_sensor_does_not_hold_back_what_it_said(tmp_path: Path) -> None:
    bag = LiveBag(tmp_path / "a.mcap", Calibration(wheels=ROBOT), "png", flush_s=0.05)
    try:
        for number in range(5):
            bag.add(WheelTicks(100.0 + 0.02 * number, number, number))
        ends_s = time.monotonic() + 30
        while whole_messages_in(tmp_path / "a.mcap") < 6:  # the calibration is one
            assert time.monotonic() < ends_s, "it did not come"
            time.sleep(0.02)
    finally:
        bag.close()
    assert bag.readings == 5
    assert len(on_topic(tmp_path / "a.mcap", "/joint_states")) == 5


def test_a_frame_that_is_listed_late_is_received_late_and_comes_in_order(tmp_path: Path) -> None:
    calibration = replace(CALIBRATION, wheels=ROBOT)
    bag = LiveBag(tmp_path / "a.mcap", calibration, "png", flush_s=10.0)
    frame = live_frame(0, 100.0).frame
    bag.check(frame)
    encoded = bag.write_frame(frame)
    for number in range(20):
        bag.add(WheelTicks(100.0 + 0.02 * number, number, number))
    bag.list_frame(encoded)
    bag.close()
    stamps_s = [event.stamp_s for event in open_recording(tmp_path / "a.mcap").events()]
    assert stamps_s == sorted(stamps_s)
    assert len(stamps_s) == 21


def test_a_cameras_gyroscope_shows_how_the_base_turns_once_it_is_known_how_it_sits(tmp_path: Path) -> None:
    T_base_camera = np.array([[0.0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])
    bag = LiveBag(tmp_path / "a.mcap", Calibration(wheels=ROBOT, T_base_camera=T_base_camera), "png", flush_s=10.0)
    bag.add_angular_velocity(AngularVelocity(100.0, 0.1, -0.4, 0.2))
    bag.close()
    (turning,) = on_topic(tmp_path / "a.mcap", "/imu/data")
    assert turning.angular_velocity.z == pytest.approx(0.4)
    blind = LiveBag(tmp_path / "b.mcap", Calibration(wheels=ROBOT), "png", flush_s=10.0)
    with pytest.raises(RecordingError, match="the camera's mount is unknown"):
        blind.add_angular_velocity(AngularVelocity(100.0, 0.1, -0.4, 0.2))
    blind.close()


def test_what_cannot_be_read_again_is_refused(tmp_path: Path) -> None:
    bag = LiveBag(tmp_path / "a.mcap", Calibration(wheels=ROBOT), "png", flush_s=10.0)
    bag.add(WheelTicks(100.0, 0, 0))
    with pytest.raises(RecordingError, match="does not come after"):
        bag.add(WheelTicks(100.0, 1, 1))
    bag.close()
    assert len(on_topic(tmp_path / "a.mcap", "/joint_states")) == 1
    with pytest.raises(CalibrationError, match="is missing"):
        LiveBag(tmp_path / "b.mcap", None, "png", flush_s=1.0)
    assert not (tmp_path / "b.mcap").exists()


def test_a_disk_that_fills_up_keeps_what_was_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = LiveBag(tmp_path / "a.mcap", Calibration(wheels=ROBOT), "png", flush_s=0.02)
    bag.add(WheelTicks(100.0, 0, 0))
    ends_s = time.monotonic() + 30
    while whole_messages_in(tmp_path / "a.mcap") < 2:
        assert time.monotonic() < ends_s, "it did not come"

    def full(self: writing.BagFile) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(writing.BagFile, "flush", full)
    reported: list[OutputError] = []
    for number in range(1, 200):
        try:
            bag.add(WheelTicks(100.0 + 0.02 * number, number, number))
        except OutputError as error:
            reported.append(error)
        time.sleep(0.005)
    assert "no space left" in reported[-1].problem
    bag.close()
    assert whole_messages_in(tmp_path / "a.mcap") >= 2
    assert {path.name for path in tmp_path.iterdir()} == {"a.mcap"}


def test_what_a_bag_cannot_be_is_refused_before_a_sensor_is_touched(refusal: Refusal, tmp_path: Path) -> None:
    camera = ("--camera", "recording:nowhere")
    assert "--out or --bag is needed" in refusal("record", *camera)
    both = refusal("record", *camera, "--out", tmp_path / "a", "--bag", tmp_path / "a.mcap")
    assert "--out and --bag are two recordings" in both
    assert "a ROS 1 bag is not readable without its index" in refusal("record", *camera, "--bag", tmp_path / "a.bag")
    assert "a bag cannot be resumed" in refusal("record", *camera, "--bag", tmp_path / "a.mcap", "--resume")
    assert "--infrared is not kept" in refusal("record", *camera, "--bag", tmp_path / "a.mcap", "--infrared")
    (tmp_path / "a.mcap").write_text("mine")
    assert "is there already" in refusal("record", *camera, "--bag", tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_text() == "mine"
    assert not (tmp_path / "a").exists()
