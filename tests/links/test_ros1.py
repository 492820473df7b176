"""Debian's ROS 1 reads and plays the bags that are written, and bags of its recorder are read."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pipeline.made import wheel_recording
from room_drive import make_room_drive
from typer.testing import CliRunner

from wheelsight.app.cli import app
from wheelsight.core.messages import WheelSpeeds
from wheelsight.io.recordings import open_recording, write_recording
from wheelsight_export.bag_writing import Messages

PYTHON, PEER = "/usr/bin/python3", Path(__file__).with_name("ros1_peer.py")
LONGEST_S = 60.0


@pytest.fixture(scope="module")
def ros1() -> dict[str, str]:
    """The environment of Debian's ROS 1: its Python sees nothing of ours."""
    if shutil.which("rosbag") is None or shutil.which("rosmaster") is None:
        problem = "Debian's ROS 1 is not installed: apt-get install python3-rosbag python3-rosmaster (.ci/run)"
        if os.environ.get("WHEELSIGHT_REQUIRE_ROS1"):
            pytest.fail(problem)
        pytest.skip(problem)
    left_out = ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONHOME")
    known = {name: value for name, value in os.environ.items() if name not in left_out}
    return {**known, "ROS_IP": "127.0.0.1", "PATH": "/usr/bin:/bin"}


def rosbag(ros1: dict[str, str], *words: str) -> str:
    done = subprocess.run(["rosbag", *words], env=ros1, capture_output=True, text=True, timeout=LONGEST_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def master(ros1: dict[str, str], tmp_path: Path) -> Iterator[dict[str, str]]:
    """The environment of a master on a free port."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    found = {**ros1, "ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_LOG_DIR": str(tmp_path / "log")}
    program = subprocess.Popen(["rosmaster", "--core", "-p", str(port)], env=found, stdout=subprocess.DEVNULL)
    try:
        ends_s = time.monotonic() + LONGEST_S
        while time.monotonic() < ends_s:
            with socket.socket() as asked:
                if asked.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        yield found
    finally:
        program.terminate()
        program.wait()


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A bag of each kind: of a recording with its images in each form, and of a run."""
    folder = tmp_path_factory.mktemp("bags")
    make_room_drive(folder / "drive", mounted=True, with_truth=True)
    found = {}
    for form in ("raw", "png", "jpeg"):
        found[form] = folder / f"{form}.bag"
        asked = ["export", str(folder / "drive"), "--bag", str(found[form]), "--images", form]
        assert CliRunner().invoke(app, asked).exit_code == 0
    write_recording(folder / "wheels", wheel_recording(200))
    asked = ["run", str(folder / "wheels"), "--odometry", "wheels", "--out", str(folder / "run")]
    assert CliRunner().invoke(app, asked).exit_code == 0
    found["run"] = folder / "run.bag"
    assert CliRunner().invoke(app, ["export", str(folder / "run"), "--bag", str(found["run"])]).exit_code == 0
    return found


@pytest.mark.slow
def test_rosbag_reads_each_bag_that_is_written(ros1: dict[str, str], bags: dict[str, Path]) -> None:
    for form, bag in bags.items():
        reported = rosbag(ros1, "info", str(bag))
        listed = dict(re.findall(r"^(?:topics:)?\s+(/\S+)\s+(\d+) msgs?", reported, re.MULTILINE))
        if form != "run":  # its odometry is ours, and is no input
            assert {name: int(count) for name, count in listed.items()} == {
                topic.name: topic.count
                for topic in open_recording(bag).topics  # type: ignore[attr-defined]
            }
        assert len(listed) >= 5
        # Texts of definitions differ by their comments: same sums are the same types.
        checked = rosbag(ros1, "check", str(bag))
        sums = re.findall(r"(?:From|To):\s+\S+ \[(\w+)\]", checked)
        assert sums[::2] == sums[1::2]
        assert "need to be" not in checked
        assert "cannot" not in checked.lower()


@pytest.mark.slow
def test_rosbag_plays_a_run_to_a_subscriber(master: dict[str, str], bags: dict[str, Path]) -> None:
    subscriber = subprocess.Popen([PYTHON, str(PEER), "listen", "12"], env=master, stdout=subprocess.PIPE, text=True)
    assert subscriber.stdout is not None
    try:
        assert subscriber.stdout.readline() == "ready\n"
        rosbag(
            master, "play", "--quiet", "--wait-for-subscribers", "--topics", "/odom", "/tf", "--bags", str(bags["run"])
        )
        found = json.loads(subscriber.stdout.readline())
    finally:
        subscriber.kill()
        subscriber.wait()
        subscriber.stdout.close()
    received = {row[0]: row for row in found["odom"]}
    recorded = odometry_of(bags["run"])
    assert len(received) > 0.9 * len(recorded)
    for stamp_s, x, y, frame, child in received.values():
        at = np.argmin(np.abs(recorded[:, 0] - stamp_s))
        assert (stamp_s, x, y) == pytest.approx(tuple(recorded[at]), abs=1e-6)
        assert (frame, child) == ("odom", "base_link")
    assert ["odom", "base_link"] in found["tf"] or ["base_link"] in found["tf"]


def odometry_of(bag: Path) -> np.ndarray:
    """(N, 3) stamps, x and y of /odom, by rosbags."""
    from rosbags.rosbag1 import Reader

    types, rows = Messages(is_ros1=True).types, []
    with Reader(bag) as reader:
        for _, _, data in reader.messages([one for one in reader.connections if one.topic == "/odom"]):
            message = types.deserialize_ros1(data, "nav_msgs/msg/Odometry")
            stamp, p = message.header.stamp, message.pose.pose.position
            rows.append((stamp.sec + 1e-9 * stamp.nanosec, p.x, p.y))
    return np.array(rows)


@pytest.mark.slow
def test_a_bag_of_the_recorder_is_read(master: dict[str, str], tmp_path: Path) -> None:
    bag = tmp_path / "circle.bag"
    recorder = subprocess.Popen(["rosbag", "record", "-q", "-O", str(bag), "/odom"], env=master)
    try:
        done = subprocess.run([PYTHON, str(PEER), "drive", "4"], env=master, timeout=LONGEST_S, check=False)
        assert done.returncode == 0
    finally:
        recorder.send_signal(signal.SIGINT)
        recorder.wait(LONGEST_S)
    recording = open_recording(bag)
    readings = [event for event in recording.events() if isinstance(event, WheelSpeeds)]
    assert len(readings) > 50
    wheels = recording.calibration.wheels
    assert wheels is not None
    rims = np.array([(one.left_rad_s, one.right_rad_s) for one in readings[2:-2]])
    speeds = rims @ np.diag([wheels.left_radius_m, wheels.right_radius_m])
    assert np.median(speeds.mean(axis=1)) == pytest.approx(0.4, abs=0.02)
    assert np.median(speeds[:, 1] - speeds[:, 0]) / wheels.track_width_m == pytest.approx(0.5, abs=0.03)
