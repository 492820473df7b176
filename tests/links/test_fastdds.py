"""A program of another DDS, eProsima's, takes what the robot sends, and its commands drive it."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from links.bridged import linked
from live_page.room_session import ROOM, SIZE_M

from wheelsight_ros2 import LinkSettings

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed")
SOURCES, DOMAIN = Path(__file__).with_name("fastdds"), 71


@pytest.fixture(scope="module")
def peer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program, built with types by Fast DDS's own generator."""
    header = Path("/usr/include/fastdds/dds/domain/DomainParticipant.hpp")
    if shutil.which("fastddsgen") is None or shutil.which("g++") is None or not header.is_file():
        problem = "Fast DDS is not installed: apt-get install g++ libfastrtps-dev fastddsgen default-jre-headless"
        if os.environ.get("WHEELSIGHT_REQUIRE_FASTDDS"):
            pytest.fail(problem)
        pytest.skip(problem)
    folder = tmp_path_factory.mktemp("fastdds")
    for name in ("ros.idl", "peer.cpp"):
        shutil.copy(SOURCES / name, folder / name)
    how = {"cwd": folder, "check": True, "stdout": subprocess.DEVNULL}
    subprocess.run(["fastddsgen", "-replace", "-d", ".", "ros.idl"], **how)  # type: ignore[call-overload]
    parts = ["peer.cpp", "ros.cxx", "rosPubSubTypes.cxx"]
    command = ["g++", "-O0", "-std=c++17", "-I.", "-o", "peer", *parts, "-lfastrtps", "-lfastcdr"]
    subprocess.run(command, **how)  # type: ignore[call-overload]
    return folder / "peer"


@pytest.mark.slow
def test_fast_dds_takes_odom_map_and_tf_and_drives_the_robot(peer: Path) -> None:
    with linked(LinkSettings(ros2="dds", domain=DOMAIN)) as served:
        done = subprocess.run([str(peer), str(DOMAIN)], capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        said = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()}
        expected = ROOM.grid(*SIZE_M).occupancy
        height, width = expected.shape
        assert [int(one) for one in said["map"]] == [width, height, int((expected == 100).sum())]
        assert said["tf"] == ["map", "odom", "odom", "base_link"]
        x, frame, child, speed = said["odom"]
        assert float(x) > 2.5
        assert (frame, child) == ("odom", "base_link")
        assert float(speed) == pytest.approx(0.3, abs=0.05)
        assert served.robot.base.pose[0] > 2.5
        served.until_stands()  # its program has ended
        assert served.problems == []
