"""Speeds of wheels from what a robot's own odometry or joints tell: each holds until the next message."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from wheelsight.calibration import Wheels
from wheelsight.events import WheelSpeeds, WheelTicks
from wheelsight.geometry import se2
from wheelsight.recordings._wheel_recording import speeds_of_wheels

_WHEEL = re.compile(r"wheel|drive|whl", re.IGNORECASE)
_CASTER = re.compile(r"cast[eo]r|steer|swivel|arm|gripper", re.IGNORECASE)
# left, or l, fl, rl, lf, … as a word of its own
_SIDES = tuple(
    re.compile(rf"{side}|(?:^|[_\-/.])[fbr]?{side[0]}[fbr]?(?:$|[_\-/.\d])", re.IGNORECASE)
    for side in ("left", "right")
)
_WRAP_SLACK = 0.01


@dataclass(frozen=True, slots=True)
class Joints:
    """Names of the joints of the left and the right wheels; several of a side are averaged."""

    left: tuple[str, ...]
    right: tuple[str, ...]


class SpeedReader(Protocol):
    """Makes speeds of one topic's messages, in order of time."""

    unusable: int

    def add(self, stamp_s: float, message: Any) -> WheelSpeeds | WheelTicks | None:
        """The speeds from the message before until this one, or the counts of this one; None where there are none."""

    def end(self) -> WheelSpeeds | None:
        """The speeds of the last message, which hold until nobody knows when."""


class JointTicks:
    """Counts of encoders, of joints whose angles are known to be made of them.

    Attributes:
        unusable: messages that lack one of the joints, or whose numbers are none.
    """

    def __init__(self, joints: Joints, ticks_per_turn: float) -> None:
        self.unusable = 0
        self._names, self._per_rad = (joints.left[0], joints.right[0]), ticks_per_turn / (2 * math.pi)

    def add(self, stamp_s: float, message: Any) -> WheelTicks | None:
        """See `SpeedReader`."""
        angles = dict(zip(message.name, message.position, strict=False))
        told = [float(angles.get(name, math.nan)) * self._per_rad for name in self._names]
        if not all(map(math.isfinite, told)):
            self.unusable += 1
            return None
        return WheelTicks(stamp_s, round(told[0]), round(told[1]))

    def end(self) -> None:
        """See `SpeedReader`."""


class OdometrySpeeds:
    """Speeds of nominal wheels that make the increments between an Odometry's poses.

    The increments, not the twists: they lose nothing where messages are far apart or were dropped.

    Attributes:
        unusable: messages whose numbers are none.
    """

    def __init__(self, wheels: Wheels, by_twist: bool) -> None:
        self.unusable = 0
        self._wheels, self._by_twist = wheels, by_twist
        self._last: tuple[float, tuple[float, float, float], tuple[float, float]] | None = None

    def add(self, stamp_s: float, message: Any) -> WheelSpeeds | None:
        """See `SpeedReader`."""
        told = _planar(message)
        if told is None or (self._last is not None and stamp_s <= self._last[0]):
            self.unusable += told is None
            return None
        last, self._last = self._last, (stamp_s, *told)
        if last is None:
            return None
        if self._by_twist:
            return speeds_of_wheels(self._wheels, last[0], *last[2])
        T_last_now = se2.compose(se2.invert(se2.from_parts(*last[1])), se2.from_parts(*told[0]))
        ahead_m, _, turn_rad = se2.log(T_last_now).tolist()
        lasted_s = stamp_s - last[0]
        return speeds_of_wheels(self._wheels, last[0], ahead_m / lasted_s, turn_rad / lasted_s)

    def end(self) -> WheelSpeeds | None:
        """See `SpeedReader`."""
        return None if self._last is None else speeds_of_wheels(self._wheels, self._last[0], *self._last[2])


class JointSpeeds:
    """Speeds of the robot's own wheels from the angles of their joints, or from their speeds where no angle is told.

    Attributes:
        unusable: messages that lack one of the joints, or whose numbers are none.
    """

    def __init__(self, joints: Joints) -> None:
        self.unusable = 0
        self._joints = joints
        self._last: tuple[float, list[float], list[float]] | None = None
        self._farthest_rad = 0.0

    def add(self, stamp_s: float, message: Any) -> WheelSpeeds | None:
        """See `SpeedReader`."""
        told = self._told(message)
        if told is None or (self._last is not None and stamp_s <= self._last[0]):
            self.unusable += told is None
            return None
        last, self._last = self._last, (stamp_s, *told)
        if last is None:
            return None
        if not told[0] or not last[1]:
            return self._speeds(last[0], last[2])
        lasted_s = stamp_s - last[0]
        return self._speeds(last[0], [self._turned(a, b) / lasted_s for a, b in zip(last[1], told[0], strict=True)])

    def end(self) -> WheelSpeeds | None:
        """See `SpeedReader`."""
        if self._last is None:
            return None
        stamp_s, _, speeds = self._last
        return self._speeds(stamp_s, speeds or [0.0] * len(self._joints.left + self._joints.right))

    def _told(self, message: Any) -> tuple[list[float], list[float]] | None:
        """Angles and speeds of the joints, left ones first, each empty where the message has none."""
        places = {name: place for place, name in enumerate(message.name)}
        wanted = [places.get(name) for name in (*self._joints.left, *self._joints.right)]
        if None in wanted:
            return None
        angles, speeds = (
            [float(values[place]) for place in wanted if place is not None] if len(values) == len(places) else []
            for values in (message.position, message.velocity)
        )
        if not (angles or speeds) or not np.isfinite([*angles, *speeds]).all():
            return None
        self._farthest_rad = max(self._farthest_rad, *map(abs, angles or [0.0]))
        return angles, speeds

    def _turned(self, before_rad: float, after_rad: float) -> float:
        """How far a joint turned; angles that never leave one turn start anew at its end."""
        turned_rad = after_rad - before_rad
        if abs(turned_rad) > math.pi and self._farthest_rad <= 2 * math.pi + _WRAP_SLACK:
            return math.remainder(turned_rad, 2 * math.pi)
        return turned_rad

    def _speeds(self, stamp_s: float, of_joints: Sequence[float]) -> WheelSpeeds:
        count = len(self._joints.left)
        left, right = of_joints[:count], of_joints[count:]
        return WheelSpeeds(stamp_s, sum(left) / len(left), sum(right) / len(right))


def wheel_joints(names: Sequence[str]) -> Joints | None:
    """The joints that are wheels, by their names; None where they do not tell a left and a right one."""
    wheels = [name for name in names if _WHEEL.search(name) and not _CASTER.search(name)]
    left, right = (tuple(name for name in wheels if side.search(name)) for side in _SIDES)
    if not left or len(left) != len(right) or set(left) & set(right):
        return None
    return Joints(left, right)


def told_by_twist(messages: Sequence[Any]) -> bool:
    """Whether poses of an Odometry stay at zero while its twists do not."""
    told = [found for found in map(_planar, messages) if found is not None]
    return bool(told) and not any(any(pose) for pose, _ in told) and any(any(twist) for _, twist in told)


def _planar(message: Any) -> tuple[tuple[float, float, float], tuple[float, float]] | None:
    """Pose x, y, yaw and twist v, ω of an Odometry; None where they are no numbers, or no rotation."""
    position, q, twist = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
    yaw_rad = math.atan2(2 * (q.w * q.z + q.x * q.y), q.w**2 + q.x**2 - q.y**2 - q.z**2)
    pose, speeds = (position.x, position.y, yaw_rad), (twist.linear.x, twist.angular.z)
    if not all(map(math.isfinite, (*pose, *speeds))):
        return None
    return pose, speeds
