"""A second process of Cyclone DDS, with types of its own, takes what the robot sends, and its commands drive it."""

from __future__ import annotations

import json
import queue
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

from wheelsight_ros2 import LinkSettings

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed")
DOMAIN = 77
LONGEST_S = 30.0


class DdsProgram:
    """The other process."""

    def __init__(self, namespace: str = "") -> None:
        command = [sys.executable, str(Path(__file__).with_name("dds_peer.py")), str(DOMAIN), namespace]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.received: dict[str, list[Any]] = {}
        self._lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)

    def say(self, topic: str, **said: Any) -> None:
        assert self.process.stdin is not None
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


@contextmanager
def program(namespace: str = "") -> Iterator[DdsProgram]:
    made = DdsProgram(namespace)
    try:
        yield made
    finally:
        made.process.kill()
        made.process.wait()
        for pipe in (made.process.stdin, made.process.stdout):
            assert pipe is not None
            pipe.close()


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
