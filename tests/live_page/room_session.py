"""A session of a robot in a room, without camera images to render: pages can do all with it, in real time or faster."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from navigation.rooms import StandInLocalization

from benchmarks.plain_rooms import RoomRobot, Walls, walls_about
from wheelsight.app.page import Driven, Session, Watch
from wheelsight.core.errors import MapError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import STOP, Event, VelocityCommand
from wheelsight.core.robots import Robot
from wheelsight.core.settings import LivePageSettings
from wheelsight.navigation import KnownFloor, NavigationSettings, Navigator, Transition

SIZE_M, BEGIN = (8.0, 6.0), (1.5, 3.0, 0.0)
ROOM = Walls.of(*walls_about(*SIZE_M))
GOAL = {"type": "goal", "x_m": 5.0, "y_m": 3.0, "yaw_rad": 0.0}
LONGEST_S = 60.0


class ObedientRobot(RoomRobot):
    """Stands after `stop` until it is commanded to stand, as `Robot` asks; it can hang.

    Attributes:
        stops_s: by `time.monotonic`, when it was stopped.
        commands: that it obeyed, the last ones.
    """

    def __init__(self) -> None:
        super().__init__(ROOM, BEGIN)
        self.stops_s: list[float] = []
        self.commands: list[VelocityCommand] = []
        self.goes_on = threading.Event()
        self.goes_on.set()

    def step(self, command: VelocityCommand) -> list[Event]:
        self.goes_on.wait(LONGEST_S)
        if command == STOP:
            self.stop_reason = ""
        obeyed = STOP if self.stop_reason else command
        self.commands = [*self.commands[-50:], obeyed]
        return super().step(obeyed)

    def __enter__(self) -> ObedientRobot:
        return self

    def stop(self) -> None:
        self.stops_s.append(time.monotonic())
        super().stop()


class RoomPlaces:
    """Kept in memory."""

    def __init__(self) -> None:
        self.named: dict[str, FloatArray] = {}

    def where(self) -> Mapping[str, FloatArray]:
        return self.named

    def name(self, name: str, pose: FloatArray) -> None:
        if "," in name:
            raise MapError(f"{name!r} is no name for a place")
        self.named = {**self.named, name: pose}


@dataclass
class RoomMaps:
    """The room under several names; "broken" cannot be opened, and one is closed wrongly where that is asked for."""

    robot: ObedientRobot
    first: str = "today"
    closes_wrongly: bool = False
    opened_with: list[tuple[str, FloatArray | None]] = field(default_factory=list)
    places: dict[str, RoomPlaces] = field(default_factory=dict)

    def names(self) -> tuple[str, ...]:
        return ("today", "yesterday", "broken", "new")

    def last_saved(self) -> str:
        return "yesterday"

    @contextmanager
    def opened(
        self, name: str, robot: Robot, pose: FloatArray | None, on_transition: Callable[[Transition], None]
    ) -> Iterator[Driven]:
        self.opened_with.append((name, pose))
        if name == "broken":
            raise MapError("is damaged")
        settings, floor = NavigationSettings(controller="pure_pursuit"), KnownFloor(ROOM.grid(*SIZE_M))
        localization = StandInLocalization(self.robot)
        navigator = Navigator(robot, localization, floor, settings, trusts_floor=True, on_transition=on_transition)
        yield Driven(navigator, self.places.setdefault(name, RoomPlaces()), is_new=name == "new")
        if self.closes_wrongly:
            self.closes_wrongly = False
            raise TypeError("a list where an array was needed")


@dataclass
class Served:
    """A session and what it is of."""

    session: Session
    robot: ObedientRobot
    maps: RoomMaps

    def until(self, what: Callable[[dict[str, Any]], bool], seconds: float = LONGEST_S) -> dict[str, Any]:
        """What is reported once something is so; fails where it does not come to be."""
        ends_s = time.monotonic() + seconds
        while time.monotonic() < ends_s:
            reported = json.loads(self.session.latest.text)
            if what(reported):
                return reported
            time.sleep(0.01)
        raise AssertionError(f"it did not come to be: {reported}")

    def until_stopped(self) -> None:
        """Waits for the thread that stops the robot."""
        ends_s = time.monotonic() + LONGEST_S
        while not self.robot.stops_s:
            assert time.monotonic() < ends_s
            time.sleep(0.002)

    @property
    def stands(self) -> bool:
        return self.robot.base.stands


SETTINGS = LivePageSettings()
# A busy machine holds threads up for longer than a page bears.
BUSY_S = 4.0


@contextmanager
def room_session(
    first: str = "today",
    *,
    paces: bool = True,
    watch: Watch | None = None,
    on_problem: Callable[[str], None] = lambda line: None,
    **settings: Any,
) -> Iterator[Served]:
    """One that drives; in real time, or as fast as it can."""
    robot = ObedientRobot()
    maps = RoomMaps(robot, first)
    with Session(robot, maps, replaced(settings), paces=paces, on_problem=on_problem, watch=watch) as session:
        session.silent_s = BUSY_S
        served = Served(session, robot, maps)
        served.until(lambda reported: reported["phase"] in ("driving", "choose"))
        try:
            yield served
        finally:
            robot.goes_on.set()


def replaced(settings: dict[str, Any]) -> LivePageSettings:
    return SETTINGS.model_copy(update=settings)


def is_near(reported: dict[str, Any], x_m: float, y_m: float) -> bool:
    return reported["pose"] is not None and bool(np.hypot(reported["pose"][0] - x_m, reported["pose"][1] - y_m) < 0.2)
