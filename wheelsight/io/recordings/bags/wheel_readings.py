"""Speeds of wheels from what a robot's own odometry or joints tell: each holds until the next message."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import se2
from wheelsight.core.messages import OdometryReading, WheelCounts, WheelReading, WheelSpeeds, WheelTicks
from wheelsight.io.recordings.bags.chunks import are_measured
from wheelsight.io.recordings.wheel_recording import speeds_of_wheels

_WHEEL = re.compile(r"wheel|drive|whl", re.IGNORECASE)
_CASTER = re.compile(r"cast[eo]r|steer|swivel|arm|gripper", re.IGNORECASE)
# left, or l, fl, rl, lf, … as a word of its own
_SIDES = tuple(
    re.compile(rf"{side}|(?:^|[_\-/.])[fbr]?{side[0]}[fbr]?(?:$|[_\-/.\d])", re.IGNORECASE)
    for side in ("left", "right")
)
_WRAP_SLACK = 0.01
_MOST_COLUMNS = 64  # of an array of encoders
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

    def add(self, stamp_s: float, message: Any) -> WheelReading | None:
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


class PoseSpeeds(_HeldSpeeds[_PoseAndTwist]):
    """Speeds of nominal wheels that make the increments between poses, or by twists.

    Increments rather than twists: they lose nothing where messages are far apart or were dropped.

    Args:
        wheels: nominal ones.
        told_of: pose x, y, yaw and twist v, ω of a message, or None where its numbers are none.
        by_twist: whether poses say nothing: each twist then holds from its message on.
    """

    def __init__(self, wheels: Wheels, told_of: Callable[[Any], _PoseAndTwist | None], by_twist: bool) -> None:
        super().__init__()
        self._wheels, self._told_of, self._by_twist = wheels, told_of, by_twist

    def _told(self, message: Any) -> _PoseAndTwist | None:
        return self._told_of(message)

    def _between(self, stamp_s: float, before: _PoseAndTwist, now: _PoseAndTwist, lasted_s: float) -> WheelSpeeds:
        if self._by_twist:
            return self._after(stamp_s, before)
        ahead_m, _, turn_rad = increment(before, now)
        return speeds_of_wheels(self._wheels, stamp_s, ahead_m / lasted_s, turn_rad / lasted_s)

    def _after(self, stamp_s: float, last: _PoseAndTwist) -> WheelSpeeds:
        return speeds_of_wheels(self._wheels, stamp_s, *last[1])


class CountedTicks:
    """Counts of encoders that messages hold as whole numbers, by field or by place in an array.

    Args:
        numbers_of: the numbers of a message by name.
        sides: which of them are the left and the right wheels'; of several of a side the mean is taken.
        bits: after how many bits the numbers begin anew, which is undone; 0 for never.
        per_number: counts of the calibration's encoder that one of these numbers is.

    Attributes:
        unusable: messages that lack one of the numbers.
    """

    def __init__(
        self, numbers_of: Callable[[Any], Mapping[str, float]], sides: Joints, bits: int, per_number: float = 1.0
    ) -> None:
        self.unusable = 0
        self._numbers_of, self._sides, self._per_number = numbers_of, sides, per_number
        self._unrolled = {name: _Unrolled(bits) for name in (*sides.left, *sides.right)}
        self._last_s = -math.inf

    def add(self, stamp_s: float, message: Any) -> WheelTicks | None:
        """See `SpeedReader`."""
        numbers = self._numbers_of(message)
        told = {name: numbers.get(name, math.nan) for name in self._unrolled}
        if not all(math.isfinite(number) for number in told.values()):
            self.unusable += 1
            return None
        if stamp_s <= self._last_s:
            return None
        self._last_s = stamp_s
        counts = {name: self._unrolled[name](number) for name, number in told.items()}
        left, right = (
            round(self._per_number * sum(counts[name] for name in side) / len(side))
            for side in (self._sides.left, self._sides.right)
        )
        return WheelTicks(stamp_s, left, right)

    def end(self) -> WheelSpeeds | None:
        """See `SpeedReader`."""
        return None


class CountsApart:
    """Counts of encoders of which each wheel has a topic of its own; the right ones are interpolated at the left ones.

    Attributes:
        unusable: always 0.
    """

    def __init__(self, bits: int) -> None:
        self.unusable = 0
        self._unrolled = _Unrolled(bits), _Unrolled(bits)
        self._left: tuple[float, float] | None = None
        self._right: tuple[tuple[float, float], ...] = ()

    def add(self, stamp_s: float, message: Any) -> WheelTicks | None:
        """A message of the left wheel; see `SpeedReader`."""
        self._left = stamp_s, self._unrolled[0](int(message.data))
        return self._both()

    def add_right(self, stamp_s: float, message: Any) -> WheelTicks | None:
        """A message of the right wheel: the counts of the last message of the left one, where it was not newer."""
        self._right = (*self._right[-1:], (stamp_s, self._unrolled[1](int(message.data))))
        return self._both()

    def end(self) -> WheelSpeeds | None:
        """See `SpeedReader`."""
        return None

    def _both(self) -> WheelTicks | None:
        if self._left is None or not self._right or not self._right[0][0] <= self._left[0] <= self._right[-1][0]:
            return None
        (stamp_s, left), self._left = self._left, None
        (before_s, before), (after_s, after) = self._right[0], self._right[-1]
        share = (stamp_s - before_s) / (after_s - before_s) if after_s > before_s else 1.0
        return WheelTicks(stamp_s, round(left), round(before + share * (after - before)))


class _Unrolled:
    """Undoes that numbers of so many bits begin anew."""

    def __init__(self, bits: int) -> None:
        self._span = 1 << bits if bits else 0
        self._last: float | None = None
        self._added = 0

    def __call__(self, number: float) -> float:
        if self._last is not None and self._span:
            step = number - self._last
            self._added -= self._span * round(step / self._span)
        self._last = number
        return number + self._added


class ToldSpeeds(_HeldSpeeds[tuple[float, ...]]):
    """Speeds of the robot's own wheels that messages hold as fields, rad/s.

    Args:
        numbers_of: the numbers of a message by name.
        sides: which of them are the left and the right wheels'.
    """

    def __init__(self, numbers_of: Callable[[Any], Mapping[str, float]], sides: Joints) -> None:
        super().__init__()
        self._numbers_of, self._sides = numbers_of, sides

    def _told(self, message: Any) -> tuple[float, ...] | None:
        numbers = self._numbers_of(message)
        sides = [[numbers.get(name, math.nan) for name in side] for side in (self._sides.left, self._sides.right)]
        told = tuple(sum(side) / len(side) for side in sides)
        return told if are_measured(told) else None

    def _between(
        self, stamp_s: float, before: tuple[float, ...], now: tuple[float, ...], lasted_s: float
    ) -> WheelSpeeds:
        return WheelSpeeds(stamp_s, *((a + b) / 2 for a, b in zip(before, now, strict=True)))

    def _after(self, stamp_s: float, last: tuple[float, ...]) -> WheelSpeeds:
        return WheelSpeeds(stamp_s, *last)


class TwistSpeeds(_HeldSpeeds[tuple[float, float]]):
    """Speeds of nominal wheels that make measured velocities: between two messages, their mean."""

    def __init__(self, wheels: Wheels) -> None:
        super().__init__()
        self._wheels = wheels

    def _told(self, message: Any) -> tuple[float, float] | None:
        told = twist_of(message)
        return None if told is None else (told[0], told[2])

    def _between(
        self, stamp_s: float, before: tuple[float, float], now: tuple[float, float], lasted_s: float
    ) -> WheelSpeeds:
        return speeds_of_wheels(self._wheels, stamp_s, (before[0] + now[0]) / 2, (before[1] + now[1]) / 2)

    def _after(self, stamp_s: float, last: tuple[float, float]) -> WheelSpeeds:
        return speeds_of_wheels(self._wheels, stamp_s, *last)


class JointSpeeds(_HeldSpeeds[_AnglesAndSpeeds]):
    """Speeds of the robot's own wheels from the angles of their joints, or from their speeds where no angle is told."""

    def __init__(self, joints: Joints) -> None:
        super().__init__()
        self._joints = joints
        self._farthest_rad = 0.0

    def _between(self, stamp_s: float, before: _AnglesAndSpeeds, now: _AnglesAndSpeeds, lasted_s: float) -> WheelSpeeds:
        if not now[0] or not before[0]:
            return self._speeds(stamp_s, before[1])
        return self._speeds(stamp_s, [self.turned(a, b) / lasted_s for a, b in zip(before[0], now[0], strict=True)])

    def _after(self, stamp_s: float, last: _AnglesAndSpeeds) -> WheelSpeeds:
        return self._speeds(stamp_s, last[1] or [0.0] * len(self._joints.left + self._joints.right))

    def _told(self, message: Any) -> _AnglesAndSpeeds | None:
        return self.read(message)

    def read(self, message: Any) -> _AnglesAndSpeeds | None:
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

    def turned(self, before_rad: float, after_rad: float) -> float:
        """How far a joint turned; angles that never leave one turn start anew at its end."""
        turned_rad = after_rad - before_rad
        if abs(turned_rad) > math.pi and self._farthest_rad <= 2 * math.pi + _WRAP_SLACK:
            return math.remainder(turned_rad, 2 * math.pi)
        return turned_rad

    def _speeds(self, stamp_s: float, of_joints: Sequence[float]) -> WheelSpeeds:
        count = len(self._joints.left)
        left, right = of_joints[:count], of_joints[count:]
        return WheelSpeeds(stamp_s, sum(left) / len(left), sum(right) / len(right))


class BasePoses:
    """The pose of a holonomic base by its own odometry.

    Args:
        told_of: pose x, y, yaw and twist of a message, or None where its numbers are none; without it, the speeds
            ahead, to the left and turning of messages are summed up, each pair of messages by their mean.

    Attributes:
        unusable: messages that hold no numbers.
    """

    def __init__(self, told_of: Callable[[Any], _PoseAndTwist | None] | None) -> None:
        self.unusable, self._told_of = 0, told_of
        self._T = se2.from_parts(0.0, 0.0, 0.0)
        self._last: tuple[float, tuple[float, float, float]] | None = None

    def add(self, stamp_s: float, message: Any) -> OdometryReading | None:
        """See `SpeedReader`; a message that is no newer than the one before is left out."""
        known = self._told_of(message) if self._told_of is not None else None
        told = twist_of(message) if self._told_of is None else None if known is None else known[0]
        if told is None or (self._last is not None and stamp_s <= self._last[0]):
            self.unusable += told is None
            return None
        if self._told_of is None:
            if self._last is not None:
                before_s, before = self._last
                step = [(a + b) / 2 * (stamp_s - before_s) for a, b in zip(before, told, strict=True)]
                self._T = se2.compose(self._T, se2.exp(step))
            x_m, y_m, yaw_rad = (float(part) for part in se2.to_parts(self._T))
        else:
            x_m, y_m, yaw_rad = told
        self._last = stamp_s, told
        return OdometryReading(stamp_s, x_m, y_m, yaw_rad)

    def end(self) -> None:
        """See `SpeedReader`."""


class AllCounts:
    """Counts of all wheels of a holonomic base, of an array, or of the angles or speeds of joints.

    Args:
        places: names of joints, or places in an array, in the order of the calibration's wheels.
        bits: of an array, after how many bits its numbers begin anew, which is undone; 0 for never.
        ticks_per_turn: counts a turn, of joints; None of an array.

    Attributes:
        unusable: messages that lack one of them.
    """

    def __init__(self, places: tuple[str, ...], bits: int = 0, ticks_per_turn: float | None = None) -> None:
        self.unusable, self._places = 0, places
        self._unrolled = [_Unrolled(bits) for _ in places]
        self._joints = None if ticks_per_turn is None else JointSpeeds(Joints(places, ()))
        self._per_rad = 0.0 if ticks_per_turn is None else ticks_per_turn / (2 * math.pi)
        self._angles_rad = [0.0] * len(places)
        self._last: tuple[float, _AnglesAndSpeeds] | None = None
        self._last_s = -math.inf

    def add(self, stamp_s: float, message: Any) -> WheelCounts | None:
        """See `SpeedReader`; a message that is no newer than the one before is left out."""
        if stamp_s <= self._last_s:
            return None
        counts = self._of_array(message) if self._joints is None else self._of_joints(self._joints, stamp_s, message)
        if counts is None:
            self.unusable += 1
            return None
        self._last_s = stamp_s
        return WheelCounts(stamp_s, counts)

    def end(self) -> None:
        """See `SpeedReader`."""

    def _of_array(self, message: Any) -> tuple[int, ...] | None:
        numbers = columns_of(message)
        told = [numbers.get(place, math.nan) for place in self._places]
        if not all(math.isfinite(number) for number in told):
            return None
        return tuple(round(unrolled(number)) for unrolled, number in zip(self._unrolled, told, strict=True))

    def _of_joints(self, joints: JointSpeeds, stamp_s: float, message: Any) -> tuple[int, ...] | None:
        told = joints.read(message)
        if told is None:
            return None
        angles, speeds = told
        if self._last is None:
            self._angles_rad = list(angles) or self._angles_rad
        else:
            before_s, (angles_before, speeds_before) = self._last
            if angles and angles_before:
                turned = [joints.turned(a, b) for a, b in zip(angles_before, angles, strict=True)]
            else:
                pairs = zip(speeds_before or speeds, speeds or speeds_before, strict=True)
                turned = [(a + b) / 2 * (stamp_s - before_s) for a, b in pairs]
            self._angles_rad = [angle + more for angle, more in zip(self._angles_rad, turned, strict=True)]
        self._last = stamp_s, told
        return tuple(round(angle * self._per_rad) for angle in self._angles_rad)


# Front and rear, left and right, as words of a joint's name, or by their letters: fl, rear_left, wheel_lf_joint.
_CORNERS = tuple(
    re.compile(
        rf"({end})[_\-.]?{side}|{side}[_\-.]?({end})|(?:^|[_\-/.])(?:[{letters}]{side[0]}|{side[0]}[{letters}])(?:$|[_\-/.\d])",
        re.IGNORECASE,
    )
    for end, letters in (("front|fore|upper", "fu"), ("rear|back|aft|lower", "rb"))
    for side in ("left", "right")
)


def corner_joints(names: Sequence[str]) -> tuple[str, ...] | None:
    """Of four wheels at the corners of a base: front left, front right, rear left, rear right; None where unknown."""
    wheels = [name for name in names if not _CASTER.search(name)]
    found = [[name for name in wheels if corner.search(name)] for corner in _CORNERS]
    if any(len(one) != 1 for one in found):
        return None
    places = tuple(one[0] for one in found)
    return places if len(set(places)) == len(places) else None


def wheel_joints(names: Sequence[str]) -> Joints | None:
    """The joints that are wheels, by their names; None where they do not tell a left and a right one."""
    wheels = [name for name in names if _WHEEL.search(name) and not _CASTER.search(name)]
    left, right = (tuple(name for name in wheels if side.search(name)) for side in _SIDES)
    if not left or len(left) != len(right) or set(left) & set(right):
        return None
    return Joints(left, right)


def told_by_twist(messages: Sequence[Any]) -> bool:
    """Whether poses of an Odometry stay at zero while its twists do not."""
    told = [found for found in map(planar_of, messages) if found is not None]
    return bool(told) and not any(any(pose) for pose, _ in told) and any(any(twist) for _, twist in told)


def increment(before: _PoseAndTwist, now: _PoseAndTwist) -> tuple[float, float, float]:
    """Way ahead and across, metres, and turn, radians, between two poses."""
    T_before_now = se2.compose(se2.invert(se2.from_parts(*before[0])), se2.from_parts(*now[0]))
    ahead_m, across_m, turn_rad = se2.log(T_before_now).tolist()
    return ahead_m, across_m, turn_rad


def planar_of(message: Any) -> _PoseAndTwist | None:
    """Pose x, y, yaw and twist v, ω of an Odometry; None where they are no numbers, or no rotation."""
    pose, twist = message.pose.pose, message.twist.twist
    return _planar(pose.position, pose.orientation, (twist.linear.x, twist.angular.z))


def planar_of_transform(stamped: Any) -> _PoseAndTwist | None:
    """Pose x, y, yaw of a TransformStamped, at rest after the last one; None where they are no numbers."""
    return _planar(stamped.transform.translation, stamped.transform.rotation, (0.0, 0.0))


def twist_of(message: Any) -> tuple[float, float, float] | None:
    """Speeds ahead and to the left, m/s, and turning, rad/s, of an Odometry, TwistStamped or one with covariance."""
    twist = getattr(message.twist, "twist", message.twist)
    told = (twist.linear.x, twist.linear.y, twist.angular.z)
    return told if are_measured(told) else None


def _planar(position: Any, q: Any, speeds: tuple[float, float]) -> _PoseAndTwist | None:
    if not are_measured((position.x, position.y, q.w, q.x, q.y, q.z, *speeds)):
        return None
    yaw_rad = math.atan2(2 * (q.w * q.z + q.x * q.y), q.w**2 + q.x**2 - q.y**2 - q.z**2)
    return (position.x, position.y, yaw_rad), speeds


def columns_of(message: Any) -> dict[str, float]:
    """The numbers of an array by their places, "0" first."""
    return {str(place): float(number) for place, number in enumerate(message.data[:_MOST_COLUMNS])}


def fields_of(message: Any) -> dict[str, float]:
    """The plain numbers of a message by their fields."""
    plain = {name: getattr(message, name) for name in message.__dataclass_fields__}
    return {name: float(value) for name, value in plain.items() if isinstance(value, int | float)}
