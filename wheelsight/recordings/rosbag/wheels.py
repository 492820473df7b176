"""Speeds of wheels from what a robot's own odometry or joints tell: each holds until the next message."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from wheelsight.calibration import Wheels
from wheelsight.events import WheelSpeeds, WheelTicks
from wheelsight.geometry import se2
from wheelsight.recordings._wheel_recording import speeds_of_wheels
from wheelsight.recordings.rosbag.definitions import are_measured

_WHEEL = re.compile(r"wheel|drive|whl", re.IGNORECASE)
_CASTER = re.compile(r"cast[eo]r|steer|swivel|arm|gripper", re.IGNORECASE)
# left, or l, fl, rl, lf, … as a word of its own
_SIDES = tuple(
    re.compile(rf"{side}|(?:^|[_\-/.])[fbr]?{side[0]}[fbr]?(?:$|[_\-/.\d])", re.IGNORECASE)
    for side in ("left", "right")
)
_WRAP_SLACK = 0.01
_Told = TypeVar("_Told")
_PoseAndTwist = tuple[tuple[float, float, float], tuple[float, float]]
_AnglesAndSpeeds = tuple[list[float], list[float]]


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
        told = [float(angles.get(name, math.nan)) for name in self._names]
        if not are_measured(told):
            self.unusable += 1
            return None
        left, right = (round(angle_rad * self._per_rad) for angle_rad in told)
        return WheelTicks(stamp_s, left, right)

    def end(self) -> None:
        """See `SpeedReader`."""


class _HeldSpeeds(ABC, Generic[_Told]):
    """Speeds from each message until the next, by what both tell.

    Attributes:
        unusable: messages that tell nothing.
    """

    def __init__(self) -> None:
        self.unusable = 0
        self._last: tuple[float, _Told] | None = None

    def add(self, stamp_s: float, message: Any) -> WheelSpeeds | None:
        """See `SpeedReader`; a message that is no newer than the one before is left out."""
        told = self._told(message)
        if told is None or (self._last is not None and stamp_s <= self._last[0]):
            self.unusable += told is None
            return None
        last, self._last = self._last, (stamp_s, told)
        return None if last is None else self._between(*last, told, stamp_s - last[0])

    def end(self) -> WheelSpeeds | None:
        """See `SpeedReader`."""
        return None if self._last is None else self._after(*self._last)

    @abstractmethod
    def _told(self, message: Any) -> _Told | None:
        """What a message tells; None where that is nothing."""

    @abstractmethod
    def _between(self, stamp_s: float, before: _Told, now: _Told, lasted_s: float) -> WheelSpeeds:
        """The speeds that held from the message at a stamp for so long."""

    @abstractmethod
    def _after(self, stamp_s: float, last: _Told) -> WheelSpeeds:
        """The speeds after the last message."""


class OdometrySpeeds(_HeldSpeeds[_PoseAndTwist]):
    """Speeds of nominal wheels that make the increments between an Odometry's poses.

    The increments, not the twists: they lose nothing where messages are far apart or were dropped.
    """

    def __init__(self, wheels: Wheels, by_twist: bool) -> None:
        super().__init__()
        self._wheels, self._by_twist = wheels, by_twist

    def _told(self, message: Any) -> _PoseAndTwist | None:
        return _planar(message)

    def _between(self, stamp_s: float, before: _PoseAndTwist, now: _PoseAndTwist, lasted_s: float) -> WheelSpeeds:
        if self._by_twist:
            return self._after(stamp_s, before)
        T_before_now = se2.compose(se2.invert(se2.from_parts(*before[0])), se2.from_parts(*now[0]))
        ahead_m, _, turn_rad = se2.log(T_before_now).tolist()
        return speeds_of_wheels(self._wheels, stamp_s, ahead_m / lasted_s, turn_rad / lasted_s)

    def _after(self, stamp_s: float, last: _PoseAndTwist) -> WheelSpeeds:
        return speeds_of_wheels(self._wheels, stamp_s, *last[1])


class JointSpeeds(_HeldSpeeds[_AnglesAndSpeeds]):
    """Speeds of the robot's own wheels from the angles of their joints, or from their speeds where no angle is told."""

    def __init__(self, joints: Joints) -> None:
        super().__init__()
        self._joints = joints
        self._farthest_rad = 0.0

    def _between(self, stamp_s: float, before: _AnglesAndSpeeds, now: _AnglesAndSpeeds, lasted_s: float) -> WheelSpeeds:
        if not now[0] or not before[0]:
            return self._speeds(stamp_s, before[1])
        return self._speeds(stamp_s, [self._turned(a, b) / lasted_s for a, b in zip(before[0], now[0], strict=True)])

    def _after(self, stamp_s: float, last: _AnglesAndSpeeds) -> WheelSpeeds:
        return self._speeds(stamp_s, last[1] or [0.0] * len(self._joints.left + self._joints.right))

    def _told(self, message: Any) -> _AnglesAndSpeeds | None:
        """Angles and speeds of the joints, left ones first, each empty where the message has none."""
        places = {name: place for place, name in enumerate(message.name)}
        wanted = [places.get(name) for name in (*self._joints.left, *self._joints.right)]
        if None in wanted:
            return None
        angles, speeds = (
            [float(values[place]) for place in wanted if place is not None] if len(values) == len(places) else []
            for values in (message.position, message.velocity)
        )
        if not (angles or speeds) or not are_measured([*angles, *speeds]):
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


def _planar(message: Any) -> _PoseAndTwist | None:
    """Pose x, y, yaw and twist v, ω of an Odometry; None where they are no numbers, or no rotation."""
    position, q, twist = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
    speeds = (twist.linear.x, twist.angular.z)
    if not are_measured((position.x, position.y, q.w, q.x, q.y, q.z, *speeds)):
        return None
    yaw_rad = math.atan2(2 * (q.w * q.z + q.x * q.y), q.w**2 + q.x**2 - q.y**2 - q.z**2)
    return (position.x, position.y, yaw_rad), speeds
