"""A session in a room, or the drawn room with a camera, with a bridge to other programs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from live_page.room_session import Served, room_session

from benchmarks.plain_rooms import CALIBRATION
from wheelsight_ros2 import Bridge, LinkSettings, open_bridge

TOKEN = "0123456789abcdefTOKEN"
PLACE = {"position": {"x": 5.0, "y": 3.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
HEADER = {"frame_id": "map", "stamp": {"sec": 0, "nanosec": 0}}
GOAL = {"header": HEADER, "pose": PLACE}


@dataclass
class Linked(Served):
    """A session with a bridge.

    Attributes:
        notes, problems: lines that were reported.
    """

    bridge: Bridge | None = None
    notes: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @property
    def address(self) -> str:
        (note,) = (note for note in self.notes if note.startswith("Foxglove: "))
        return note.removeprefix("Foxglove: ")

    def until_stands(self, seconds: float = 20.0) -> float:
        """How long it takes until the command is a stop, and the wheels stand."""
        began_s = time.monotonic()
        while not (self.robot.commands[-1].is_stop and self.stands):
            assert time.monotonic() < began_s + seconds
            time.sleep(0.005)
        return time.monotonic() - began_s


@contextmanager
def linked(settings: LinkSettings, **how: Any) -> Iterator[Linked]:
    """In real time."""
    settings.check()
    notes, problems = list[str](), list[str]()
    bridges = list[Bridge]()
    how_linked: Any = {"is_simulated": True, "on_problem": problems.append, "on_note": notes.append}
    with (
        open_bridge(settings, CALIBRATION, robot_s=lambda: bridges[0].stamp_s, **how_linked) as bridge,
        room_session(watch=bridge, **how) as served,
    ):
        bridges.append(bridge)
        bridge.lead(served.session)
        yield Linked(served.session, served.robot, served.maps, bridge, notes, problems)
