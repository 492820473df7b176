"""Options of commands that open live interfaces, and a simulated robot that is led through them."""

from __future__ import annotations

import json
import re
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from links.foxglove_client import FoxgloveClient
from pipeline.made import wheel_recording
from running import interrupted
from sessions.kept_views import write_map
from typer.testing import CliRunner

from wheelsight.app.cli import app
from wheelsight.app.cli.drive import check
from wheelsight.app.cli.drive_options import DriveOptions
from wheelsight.core.errors import ConfigError
from wheelsight.io.recordings import write_recording
from wheelsight_export.topics import TOPICS, Flow


def test_the_layout_shows_and_leads_by_topics_that_there_are() -> None:
    done = CliRunner().invoke(app, ["foxglove-layout"])
    assert done.exit_code == 0
    layout = json.loads(done.output)
    named = set(re.findall(r'"(/[a-z_/]+)[".]', done.output))
    assert named <= {topic.name for topic in TOPICS.values() if topic.is_live}
    assert named >= {"/map", "/plan", "/map_points", "/wheelsight/pose", "/cmd_vel", "/wheelsight/stop"}
    assert layout["configById"]["3D!wheelsight"]["publish"]["poseTopic"] == "/goal_pose"
    shared = json.dumps(layout["layout"])
    assert all(panel in shared for panel in layout["configById"])


@pytest.mark.slow
def test_a_run_says_its_address_and_ends_as_without_it(tmp_path: Path) -> None:
    write_recording(tmp_path / "drive", wheel_recording(100))
    asked = ["run", str(tmp_path / "drive"), "--odometry", "wheels", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, [*asked, "--foxglove", "0"])
    assert done.exit_code == 0, done.output
    assert re.search(r"Foxglove: ws://127\.0\.0\.1:\d+/\?token=\w{32,}", done.output)
    assert (tmp_path / "out" / "trajectory.txt").is_file()
    refused = CliRunner().invoke(app, [*asked, "--foxglove", "here"])
    assert refused.exit_code == 2
    assert "--foxglove is 'here'" in refused.output


def test_a_robot_that_others_lead_needs_a_map_and_no_goal(tmp_path: Path) -> None:
    write_map(tmp_path / "home", 3)
    how: dict[str, Any] = {"sim": "flat", "map_": tmp_path / "home"}
    check(DriveOptions(**how, foxglove="0"))
    with pytest.raises(ConfigError, match="there is no goal"):
        check(DriveOptions(**how))
    with pytest.raises(ConfigError, match="there is no map to drive in"):
        check(DriveOptions(sim="flat", foxglove="0"))
    for more in ({"back": True}, {"out": tmp_path / "out"}):
        with pytest.raises(ConfigError, match="that other programs lead"):
            check(DriveOptions(**how, ros2="dds", **more))


def test_each_topic_is_described_once() -> None:
    """Names that a source of bags and interfaces writes itself would be a second list."""
    root = Path(__file__).resolve().parents[2]
    names = "|".join(re.escape(name) for name in TOPICS if name not in ("/tf", "/map"))
    for path in (*(root / "wheelsight_ros2").glob("*.py"), *(root / "wheelsight_export").glob("bag*.py")):
        found = re.findall(rf'"({names})"', path.read_text(encoding="utf-8"))
        assert not found, f"{path.name}: {found}"
    assert {topic.flow for topic in TOPICS.values()} == set(Flow)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["serve", "drive"])
def test_a_simulated_robot_is_led_from_foxglove(tmp_path: Path, command: str) -> None:
    asked = [sys.executable, "-m", "wheelsight", command, "--sim", "studio", "--size", "160x120", "--rate", "5"]
    asked += ["--foxglove", "0", "--set", "page.images_hz=1"]
    if command == "serve":
        asked += ["--port", "0", "--out", str(tmp_path / "maps")]
    else:
        pytest.importorskip("mujoco")
        make = ["simulate", "studio", "--duration", "12", "--rate", "5", "--size", "160x120"]
        assert CliRunner().invoke(app, [*make, "--out", str(tmp_path / "tour")]).exit_code == 0
        made = ["run", str(tmp_path / "tour"), "--map", "surfels", "--out", str(tmp_path / "home")]
        assert CliRunner().invoke(app, made).exit_code == 0
        asked += ["--map", str(tmp_path / "home"), "--known-start", "0,0,0"]
    with interrupted(asked) as output:
        address = ""
        while not address:
            line = output.readline()
            assert line, "it ended"
            address = line.removeprefix("Foxglove: ").strip() if line.startswith("Foxglove: ") else ""
        with FoxgloveClient(address) as client:
            client.subscribe("/odom", "/wheelsight/status", "/scan", "/camera/color/image_raw/compressed", "/map")
            begin = client.last("/odom").pose.pose.position
            client.advertise(1, "/cmd_vel", "geometry_msgs/msg/Twist")
            ends_s, turned = time.monotonic() + 120, 0.0
            while turned < 0.3:
                assert time.monotonic() < ends_s, client.last("/wheelsight/status")
                client.publish(1, {"linear": {"x": 0.0}, "angular": {"z": 0.5}})
                client.read(0.05)
                q = client.last("/odom").pose.pose.orientation
                turned = abs(2 * np.arctan2(q.z, q.w))
            now = client.last("/odom").pose.pose.position
            assert np.hypot(now.x - begin.x, now.y - begin.y) < 0.3
            assert len(client.last("/scan").ranges) > 20
            client.last("/camera/color/image_raw/compressed")
            client.last("/map")
