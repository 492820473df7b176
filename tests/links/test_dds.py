"""A second process of Cyclone DDS, with types of its own, takes what the robot sends, and its commands drive it."""

from __future__ import annotations

import json
import queue
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from links.bridged import linked
from live_page.room_session import ROOM, SIZE_M

from wheelsight.core.errors import ConfigError
from wheelsight_ros2 import LinkSettings

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed")
DOMAIN = 77
LONGEST_S = 30.0


class DdsProgram:
    """The other process."""

    def __init__(self, domain: int, namespace: str, file: str) -> None:
        command = [sys.executable, str(Path(__file__).with_name(file)), str(domain), namespace]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.received: dict[str, list[Any]] = {}
        self.said = 0
        self._lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)

    def say(self, topic: str, **said: Any) -> None:
        assert self.process.stdin is not None
        self.said += 1
        self.process.stdin.write(json.dumps({"topic": topic, **said}) + "\n")
        self.process.stdin.flush()

    def until(self, what: Callable[[], Any], seconds: float = LONGEST_S) -> Any:
        ends_s = time.monotonic() + seconds
        while time.monotonic() < ends_s:
            try:
                found = json.loads(self._lines.get(timeout=0.02))
                self.received.setdefault(found["topic"], []).append(found.get("message"))
            except queue.Empty:
                pass
            if result := what():
                return result
        raise AssertionError(f"it did not come to be: {[*self.received]}")

    def last(self, topic: str) -> Any:
        return self.until(lambda: self.received.get(topic))[-1]

    def state(self) -> dict[str, Any]:
        return dict(json.loads(self.last("wheelsight/status")["data"]))

    def until_refused(self, problem: str) -> None:
        self.until(lambda: problem in self.state()["refused"])


@contextmanager
def program(domain: int = DOMAIN, namespace: str = "", file: str = "dds_peer.py") -> Iterator[DdsProgram]:
    made = DdsProgram(domain, namespace, file)
    try:
        yield made
    finally:
        made.process.kill()
        made.process.wait()
        for pipe in (made.process.stdin, made.process.stdout):
            assert pipe is not None
            pipe.close()


@pytest.mark.slow
def test_another_process_takes_odom_map_and_tf_and_drives_the_robot() -> None:
    with linked(LinkSettings(ros2="dds", domain=DOMAIN)) as served, program() as other:
        grid = other.last("map")  # transient local: it came after the map was sent
        expected = ROOM.grid(*SIZE_M)
        assert (grid["info"]["width"], grid["info"]["height"]) == expected.occupancy.shape[::-1]
        np.testing.assert_array_equal(np.reshape(grid["data"], expected.occupancy.shape), expected.occupancy)
        other.say("cmd_vel", v=0.3, w=0.0, every_s=0.05)
        other.until(lambda: other.last("odom")["pose"]["pose"]["position"]["x"] > 2.5)
        odom = other.last("odom")
        assert (odom["header"]["frame_id"], odom["child_frame_id"]) == ("odom", "base_link")
        assert odom["twist"]["twist"]["linear"]["x"] == pytest.approx(0.3, abs=0.05)
        frames = [(one["header"]["frame_id"], one["child_frame_id"]) for one in other.last("tf")["transforms"]]
        assert frames == [("map", "odom"), ("odom", "base_link")]
        other.say("cmd_vel", ends=True)
        served.until_stands()
        assert served.problems == []


@pytest.mark.slow
def test_a_goal_is_driven_to_and_stop_stops() -> None:
    settings = LinkSettings(ros2="dds", domain=DOMAIN + 1, namespace="/chair")
    with linked(settings) as served, program(DOMAIN + 1, "/chair") as other:
        other.last("odom")
        other.say("goal_pose", x=5.0, y=3.0)
        other.until(lambda: other.state()["state"] == "arrived")
        position = other.last("wheelsight/pose")["pose"]["pose"]["position"]
        assert (position["x"], position["y"]) == pytest.approx((5.0, 3.0), abs=0.2)
        other.say("goal_pose", x=1.5, y=3.0, qz=1.0, qw=0.0)
        other.until(lambda: other.state()["state"] == "driving" and abs(served.robot.base.forward_m_s) > 0.2)
        other.say("wheelsight/stop")
        served.until_stopped()
        served.until_stands()
        assert served.session.switch.reason == "another program pressed stop"
        assert served.problems == []


@pytest.mark.slow
def test_nonsense_is_refused_while_the_robot_goes_on() -> None:
    with linked(LinkSettings(ros2="dds", domain=DOMAIN + 2)) as served, program(DOMAIN + 2) as other:
        other.last("odom")
        other.say("goal_pose", x=5.0, y=3.0)
        other.until(lambda: other.state()["state"] == "driving")
        for topic, said, problem in (
            ("cmd_vel", {"v": "nan", "w": 0.0}, "linear.x is nan"),
            ("goal_pose", {"x": 1.0, "y": 1.0, "sec": 9999}, "s ahead"),
            ("goal_pose", {"x": 1.0, "y": 1.0, "frame": "odom"}, "frame_id is 'odom'"),
            ("goal_pose", {"x": "inf", "y": 1.0}, "position.x is inf"),
            ("initialpose", {"x": 1.0, "y": 1.0, "qw": 0.0}, "no unit quaternion"),
        ):
            other.say(topic, **said)
            other.until_refused(problem)
        other.until(lambda: other.state()["state"] == "arrived")
        assert served.robot.stops_s == []


@pytest.mark.slow
def test_a_flood_that_ends_by_a_kill_leaves_the_robot_standing() -> None:
    with linked(LinkSettings(ros2="dds", domain=DOMAIN + 3)) as served:
        with program(DOMAIN + 3) as other:
            other.last("odom")
            other.say("cmd_vel", v=0.3, w=0.0, every_s=0.0)
            other.until(lambda: served.robot.base.forward_m_s > 0.25)
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            other.until(lambda: other.last("odom")["pose"]["pose"]["position"]["x"] > 3.0)
            assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB
            other.process.kill()
            other.process.wait()
        served.until_stands()
        served.until(lambda reported: reported["state"] == "idle")


@pytest.mark.slow
def test_a_program_that_stands_still_does_not_hold_the_robot_up() -> None:
    """A stopped process acknowledges nothing."""
    with linked(LinkSettings(ros2="dds", domain=DOMAIN + 4)) as served, program(DOMAIN + 4) as other:
        other.last("map")
        other.process.send_signal(signal.SIGSTOP)
        began_s, at_s = time.monotonic(), served.robot.now_s
        while time.monotonic() < began_s + 4:
            time.sleep(0.1)
        assert served.robot.now_s - at_s > 2
        other.process.send_signal(signal.SIGCONT)
        other.received.clear()
        other.last("odom")
        assert served.problems == []


def test_an_interface_that_is_none_is_said() -> None:
    settings = LinkSettings(ros2="dds", domain=DOMAIN + 5, interface="nowhere0")
    with pytest.raises(ConfigError, match="DDS cannot use nowhere0"), linked(settings):
        pass
