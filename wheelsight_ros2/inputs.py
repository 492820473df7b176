"""Inputs from other programs: checks each message, and makes it a task of a session. `Stick` holds velocity commands.

A velocity command takes the same way as any other: velocity ramp, collision monitor, stop switch.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from wheelsight.app.page.session import DriveByHand, GoToPose, SetPose, Task
from wheelsight.core.errors import ArgumentError
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight_export.topics import (
    CLICKED_TOPIC,
    GOAL_TOPIC,
    INITIAL_TOPIC,
    MAP,
    NAVIGATE_ACTION,
    STOP_TOPIC,
    TOPICS,
    VELOCITY_TOPIC,
    Flow,
)

# A velocity command holds for this long without another one.
TIMEOUT_S = 0.25
# Without commands but zeros for this long, driving by hand ends. A stick that was pushed while the robot was stopped,
# or got another task, must be at rest for as long, or send a zero, before it moves the robot again.
_REST_S = 1.0
# A stamp may be so far from now; 0 is no stamp. Messages are older where a queue was full.
_OLD_S = 5.0
_FARTHEST_M = 1e4
_LONGEST = 120  # characters of a refusal
_NOT_LED = "no robot is led here (wheelsight serve, or drive without --to, takes goals)"
INPUTS = {name: topic for name, topic in TOPICS.items() if topic.flow in (Flow.INPUT, Flow.COMMAND)}


class Led(Protocol):
    """What inputs lead: a `Session`."""

    @property
    def begun(self) -> Task | None:
        """The task that the navigator has."""

    def ask(self, task: Task) -> str:
        """Queue a task. Returns the reason if it is refused, else ""."""

    def stop(self, reason: str) -> None:
        """Stop the robot now."""


class Stick:
    """The newest velocity command of any peer. Several threads may use it.

    Args:
        now_s: the clock.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s, self._lock = now_s, threading.Lock()
        self._command, self._pushed_s = STOP, -math.inf
        self._moved_s = self._followed_s = -math.inf
        self._is_rested = True

    def push(self, command: VelocityCommand) -> bool:
        """Keep a command. Returns whether driving by hand must begin for it."""
        with self._lock:
            now_s = self._now_s()
            if command.is_stop or now_s - self._pushed_s > _REST_S:
                self._is_rested = True
            self._command, self._pushed_s = command, now_s
            if command.is_stop:
                return False
            self._moved_s = now_s
            begins = self._is_rested and now_s - self._followed_s > TIMEOUT_S
            self._is_rested = False
            return begins

    def commands(self) -> VelocityCommand | None:
        """The command of now: a stop `TIMEOUT_S` after the last one, None once nothing has moved it for a second."""
        with self._lock:
            now_s = self._now_s()
            if now_s - self._moved_s > _REST_S:
                self._followed_s = -math.inf
                return None
            self._followed_s = now_s
            return self._command if now_s - self._pushed_s <= TIMEOUT_S else STOP


class Inputs:
    """Takes messages of all peers; several threads may call `receive`.

    Args:
        robot_s: the time of stamps now, seconds.
        on_refusal: called with one line about each refused message.

    Attributes:
        stick: the velocity commands.
        refused: the last refusal; "" without any.
        counts: how often each topic was refused.
        led: what is led; None for nothing.
    """

    def __init__(self, robot_s: Callable[[], float], on_refusal: Callable[[str], None] = lambda line: None) -> None:
        self._robot_s, self._on_refusal = robot_s, on_refusal
        self.stick, self.refused, self.counts = Stick(), "", Counter[str]()
        self.led: Led | None = None

    def lead(self, led: Led) -> None:
        """Pass messages on from now on."""
        self.led = led

    def receive(self, topic: str, message: Any) -> None:
        """Take a message: an object with the fields of the topic's type. A refusal is counted and reported."""
        try:
            self._do(topic, message)
        except ArgumentError as error:
            self.refuse(topic, str(error))

    def refuse(self, topic: str, why: str) -> None:
        """Count and report a refused message."""
        if topic in INPUTS or topic == NAVIGATE_ACTION:
            self.counts[topic] += 1
        self.refused = f"{topic[:_LONGEST]}: {why[:_LONGEST]}"
        self._on_refusal(f"refused {self.refused}")

    def goal_of(self, message: Any) -> GoToPose:
        """The goal of a PoseStamped. Raises ArgumentError."""
        self._check_header(message)
        x_m, y_m, yaw_rad = pose_of(message, "pose")
        return GoToPose(type="goal", x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)

    def pass_on(self, task: Task) -> str:
        """Ask for a task. Returns the reason if it is refused, else ""."""
        return _NOT_LED if self.led is None else self.led.ask(task)

    def _do(self, topic: str, message: Any) -> None:
        if self.led is None:
            raise ArgumentError(_NOT_LED)
        if topic == STOP_TOPIC:
            self.led.stop("another program pressed stop")
            return
        if topic == VELOCITY_TOPIC:
            command = VelocityCommand(number(message, "linear.x"), number(message, "angular.z"))
            if self.stick.push(command):
                self._ask(DriveByHand(self.stick.commands))
            return
        if topic == GOAL_TOPIC:
            self._ask(self.goal_of(message))
            return
        self._check_header(message)
        if topic == CLICKED_TOPIC:
            x_m, y_m = (_coordinate(message, f"point.{axis}") for axis in "xy")
            self._ask(GoToPose(type="goal", x_m=x_m, y_m=y_m))
        elif topic == INITIAL_TOPIC:
            self._ask(SetPose(np.array(pose_of(message, "pose.pose"))))
        else:
            raise ArgumentError("is no input", fix=", ".join(INPUTS))

    def _ask(self, task: Task) -> None:
        if why := self.pass_on(task):
            raise ArgumentError(why)

    def _check_header(self, message: Any) -> None:
        frame = field(message, "header.frame_id")
        if frame not in (MAP, f"/{MAP}"):
            raise ArgumentError(f"header.frame_id is {str(frame)[:40]!r}", fix=f"a pose in {MAP}")
        stamp_s = number(message, "header.stamp.sec") + 1e-9 * number(message, "header.stamp.nanosec")
        off_s = self._robot_s() - stamp_s
        if stamp_s != 0 and abs(off_s) > _OLD_S:
            words = f"{off_s:.1f} s old" if off_s > 0 else f"{-off_s:.1f} s ahead"
            raise ArgumentError(f"header.stamp is {words}", fix="synchronize the clocks; 0 is no stamp")


def field(message: Any, path: str) -> Any:
    """A field by its dotted path. Raises ArgumentError without it."""
    found = message
    for name in path.split("."):
        # JSON leaves nanoseconds their name of ROS 1.
        name = "nsec" if name == "nanosec" and not hasattr(found, name) else name
        if not hasattr(found, name):
            raise ArgumentError(f"{path} is missing")
        found = getattr(found, name)
    return found


def number(message: Any, path: str) -> float:
    """A finite number. Raises ArgumentError for anything else."""
    value = field(message, path)
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not math.isfinite(value):
        raise ArgumentError(f"{path} is {str(value)[:20]}", fix="a finite number")
    return float(value)


def _coordinate(message: Any, path: str) -> float:
    value = number(message, path)
    if abs(value) > _FARTHEST_M:
        raise ArgumentError(f"{path} is {value:g}", fix=f"at most {_FARTHEST_M:g} m")
    return value


def pose_of(message: Any, path: str) -> tuple[float, float, float]:
    """x, y and yaw of a Pose. Raises ArgumentError, also for a quaternion that is none or not upright."""
    x_m, y_m = (_coordinate(message, f"{path}.position.{axis}") for axis in "xy")
    x, y, z, w = (number(message, f"{path}.orientation.{axis}") for axis in "xyzw")
    if abs(math.hypot(x, y, z, w) - 1) > 0.01:
        raise ArgumentError(f"{path}.orientation is no unit quaternion", fix="x, y, z, w of norm 1; w = 1 is no turn")
    if math.hypot(x, y) > 0.1:
        raise ArgumentError(f"{path}.orientation is tilted", fix="a turn about z alone")
    return x_m, y_m, math.atan2(2 * w * z, 1 - 2 * z * z)
