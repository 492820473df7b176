"""Camera and wheels of drivers that are other programs, over DDS: frames and readings come as they were sent."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from room_drive import make_room_drive
from typer.testing import CliRunner

from wheelsight.app.cli import app
from wheelsight.app.cli.options import robot_camera
from wheelsight.app.run import LiveSensors, LiveSource
from wheelsight.core.errors import ConfigError, DeviceError
from wheelsight.core.messages import RgbdFrame, WheelReading
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices import host_clock
from wheelsight.io.devices.live_camera import CameraStatus
from wheelsight.io.recordings import open_recording
from wheelsight_export.bag_writing import Messages
from wheelsight_export.topics import JOINT_STATES, TOPICS
from wheelsight_ros2 import sensors
from wheelsight_ros2.dds import DdsListener, DdsPeer
from wheelsight_ros2.sensors import Ros2Request, Ros2Sensors, open_ros2_sensors

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed")
DOMAIN = 97


@contextmanager
def drivers(domain: int, bag: Path, monkeypatch: pytest.MonkeyPatch, *shifts: str) -> Iterator[subprocess.Popen[str]]:
    """The drivers' program, and ROS 2's variable for what follows them."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    command = [sys.executable, str(Path(__file__).with_name("ros2_driver.py")), str(domain), str(bag), *shifts]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert program.stdout is not None
        assert json.loads(program.stdout.readline())["topic"] == "ready"
        yield program
    finally:
        program.kill()
        program.wait()
        assert program.stdout is not None
        program.stdout.close()


@pytest.fixture(scope="module")
def room_bag(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A drive with camera and wheels, and its bag."""
    folder = tmp_path_factory.mktemp("room")
    make_room_drive(folder / "drive", mounted=True, with_truth=False)
    done = CliRunner().invoke(
        app, ["export", str(folder / "drive"), "--bag", str(folder / "room.mcap"), "--images", "raw"]
    )
    assert done.exit_code == 0, done.output
    return folder / "drive", folder / "room.mcap"


def index_of(frame: RgbdFrame, recorded: list[RgbdFrame]) -> int:
    """The recorded frame with these very images."""
    for number, one in enumerate(recorded):
        if np.array_equal(one.color, frame.color) and np.allclose(one.depth_m, frame.depth_m, atol=1e-6):
            return number
    raise AssertionError("no recorded frame has these images")


@pytest.mark.slow
@pytest.mark.data
def test_frames_of_a_real_camera_come_as_they_were_recorded(
    data_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = data_folder / "rgbd" / "freiburg1_rpy_part"
    bag = tmp_path / "desk.mcap"
    done = CliRunner().invoke(app, ["export", str(source), "--bag", str(bag), "--images", "raw"])
    assert done.exit_code == 0, done.output
    recording, settings = open_recording(bag), LiveCameraSettings(oldest_s=5.0)
    recorded = [event for event in recording.events() if isinstance(event, RgbdFrame)][:42]
    with (
        drivers(DOMAIN, bag, monkeypatch),
        robot_camera("ros2:/camera", settings)[0] as camera,
    ):
        assert camera.calibration.color == recording.calibration.color
        frames = [live.frame for _ in range(12) if (live := camera.read(10.0)) is not None]
        assert camera.report().status is CameraStatus.STREAMING
        assert abs(frames[-1].stamp_s - host_clock.now_s()) < 10
    assert len(frames) == 12
    stamps_s = [frame.stamp_s for frame in frames]
    assert stamps_s == sorted(stamps_s)
    assert len({index_of(frame, recorded) for frame in frames}) > 3
    assert camera.read(0.0) is None, "it is closed"


@pytest.mark.slow
def test_camera_and_wheels_have_one_clock(room_bag: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    drive, bag = room_bag
    recording = open_recording(drive)
    recorded = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    wheels = "ros2:/joint_states"
    files = (drive / "calibration.yaml",)
    with (
        drivers(DOMAIN + 1, bag, monkeypatch),
        open_ros2_sensors("ros2:/camera", wheels, LiveCameraSettings(oldest_s=5.0), files) as found,
    ):
        assert found.camera is not None
        assert found.link is not None
        calibration = found.calibration
        assert calibration.T_base_camera is not None
        assert recording.calibration.T_base_camera is not None
        np.testing.assert_allclose(calibration.T_base_camera, recording.calibration.T_base_camera, atol=1e-6)
        events, ends_s = [], time.monotonic() + 40
        source = LiveSource(LiveSensors(calibration, found.camera, found.link))
        for event in source.events():
            events.append(event)
            frames = [one for one in events if isinstance(one, RgbdFrame)]
            if len(frames) >= 10 or time.monotonic() > ends_s:
                break
    readings = [one for one in events if isinstance(one, WheelReading)]
    assert len(frames) == 10
    assert len(readings) > 20
    for frame in frames:
        index_of(frame, recorded)
        near_s = min(abs(one.stamp_s - frame.stamp_s) for one in readings)
        assert near_s < 0.5
    stamps_s = [one.stamp_s for one in readings]
    assert stamps_s == sorted(stamps_s)


@pytest.mark.slow
def test_a_clock_that_is_apart_is_found_as_in_a_bag(
    room_bag: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    drive, bag = room_bag
    request = Ros2Request("/camera", "/joint_states", (), (drive / "calibration.yaml",))
    with (
        drivers(DOMAIN + 2, bag, monkeypatch, "/joint_states=-4"),
        Ros2Sensors(request, LiveCameraSettings(oldest_s=5.0)) as found,
    ):
        assert any("/joint_states" in text and re.search(r"3\.9\d|4\.0", text) for text in found.warnings), (
            found.warnings
        )
        assert found.link is not None
        reading = found.link.read(5.0)
        assert reading is not None
        assert abs(host_clock.now_s() - reading.stamp_s) < 1.5


@pytest.mark.slow
def test_topics_of_this_program_are_no_input(room_bag: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """A run publishes /joint_states and /odom itself, beside those of the drivers."""
    came: list[bytes] = []

    def note(topic: str, type_: str, receipt_ns: int, data: bytes) -> None:
        came.append(data)

    make, domain = Messages(is_ros1=False), DOMAIN + 5
    own = make.joints(1.0, ["ours"], [0.0], [0.0])
    listener = DdsListener(domain, lambda topic, type_: topic == JOINT_STATES, note)
    peer = DdsPeer(domain, "", None, lambda *_: None)
    try:
        with drivers(domain, room_bag[1], monkeypatch):
            ends_s = time.monotonic() + 30
            while len(came) < 40 and time.monotonic() < ends_s:
                peer.send(TOPICS[JOINT_STATES], make.bytes_of(own), 0)
                time.sleep(0.02)
    finally:
        listener.close()
        peer.close()
    assert len(came) >= 40
    assert not any(b"ours" in data for data in came)
    assert JOINT_STATES in listener.seen


@pytest.mark.slow
@pytest.mark.data
def test_a_run_follows_the_odometry_of_a_real_robot(
    data_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = data_folder / "bags" / "jackal_61s.bag"
    names = [topic.name for topic in open_recording(bag).topics if topic.type == "nav_msgs/msg/Odometry"]  # type: ignore[attr-defined]
    with drivers(DOMAIN + 3, bag, monkeypatch):
        asked = ["run", "--live", "--wheels", f"ros2:{names[0]}", "--odometry", "wheels", "--seconds", "6"]
        done = CliRunner().invoke(app, [*asked, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    rows = np.loadtxt(tmp_path / "out" / "trajectory.txt")
    assert len(rows) > 100
    assert rows[-1, 0] - rows[0, 0] == pytest.approx(6, abs=1.5)
    speeds = np.hypot(*np.diff(rows[:, 1:3], axis=0).T) / np.diff(rows[:, 0])
    assert 0.2 < np.median(speeds) < 2.5


def test_what_is_no_topic_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = LiveCameraSettings()
    with pytest.raises(ConfigError, match="is no topic"):
        open_ros2_sensors(None, "ros2:odom", settings, ())
    with pytest.raises(ConfigError, match="do not go with --camera realsense"):
        open_ros2_sensors("realsense", "ros2:/odom", settings, ())
    with pytest.raises(DeviceError, match="no topics are named"):
        robot_camera("ros2", settings)
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    with pytest.raises(ConfigError, match="ROS_DOMAIN_ID is 'many'"):
        open_ros2_sensors(None, "ros2:/odom", settings, ())


def test_topics_that_do_not_begin_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN + 4))
    monkeypatch.setattr(sensors, "_BEGIN_S", 0.3)
    with pytest.raises(DeviceError, match=r"no message of /odom came in 0\.3 s; topics of domain 101: none"):
        open_ros2_sensors(None, "ros2:/odom", LiveCameraSettings(), ())
