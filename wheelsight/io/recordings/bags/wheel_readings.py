"""`SpeedReader`s make wheel readings of the messages of a topic: odometry, joints, counts, speeds or transforms."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import se2
from wheelsight.core.messages import OdometryReading, WheelCounts, WheelReading, WheelSpeeds, WheelTicks
from wheelsight.io.recordings.bags.chunks import are_measured
from wheelsight.io.recordings.wheel_recording import speeds_of_wheels

_WHEEL = re.compile(r"wheel|drive|whl", re.IGNORECASE)
_CASTER = re.compile(r"cast[eo]r|steer|swivel|arm|gripper", re.IGNORECASE)
# left, or l, fl, rl, lf, … as a separate word
_SIDES = tuple(
    re.compile(rf"{side}|(?:^|[_\-/.])[fbr]?{side[0]}[fbr]?(?:$|[_\-/.\d])", re.IGNORECASE)
    for side in ("left", "right")
)
_WRAP_SLACK = 0.01
_MOST_COLUMNS = 64  # of an array of encoders
_Content = TypeVar("_Content")
_PoseAndTwist = tuple[tuple[float, float, float], tuple[float, float]]
_AnglesAndSpeeds = tuple[list[float], list[float]]


@dataclass(frozen=True, slots=True)
class Joints:
    """Names of the joints of the left and the right wheels; several of a side are averaged."""

    left: tuple[str, ...]
    right: tuple[str, ...]


class SpeedReader(ABC):
    """Makes wheel readings of one topic's messages, in order of time.

    Attributes:
        unusable: the number of messages that lack a number, or have invalid ones.
    """

    unusable = 0

    @abstractmethod
    def add(self, stamp_s: float, message: Any) -> WheelReading | None:
        """The speeds between the last message and this one, or the counts of this one; None without any."""

    def end(self) -> WheelSpeeds | None:
        """The speeds after the last message, or None."""
        return None


class JointTicks(SpeedReader):
    """Counts of encoders, from joint angles that were computed from counts."""

    def __init__(self, joints: Joints, ticks_per_turn: float) -> None:
        self._names, self._per_rad = (joints.left[0], joints.right[0]), ticks_per_turn / (2 * math.pi)

    def add(self, stamp_s: float, message: Any) -> WheelTicks | None:
        """See `SpeedReader`."""
        angles = dict(zip(message.name, message.position, strict=False))
        angles_rad = [float(angles.get(name, math.nan)) for name in self._names]
        if not are_measured(angles_rad):
            self.unusable += 1
            return None
        left, right = (round(angle_rad * self._per_rad) for angle_rad in angles_rad)
        return WheelTicks(stamp_s, left, right)


class HeldSpeeds(SpeedReader, Generic[_Content]):
    """Speeds between consecutive messages, from the contents of both.

    Args:
        content_of: gives the content of a message, or None where its numbers are invalid.
        between: gives the speeds between two messages: of the stamp of the first, both contents, and the time between.
        after: gives the speeds after the last message, of its stamp and content.
    """

    def __init__(
        self,
        content_of: Callable[[Any], _Content | None],
        between: Callable[[float, _Content, _Content, float], WheelSpeeds],
        after: Callable[[float, _Content], WheelSpeeds],
    ) -> None:
        self._content_of, self._between, self._after = content_of, between, after
        self._last: tuple[float, _Content] | None = None

    def add(self, stamp_s: float, message: Any) -> WheelSpeeds | None:
        """See `SpeedReader`; a message that is not newer than the last one is ignored."""
        content = self._content_of(message)
        if content is None or (self._last is not None and stamp_s <= self._last[0]):
            self.unusable += content is None
            return None
        last, self._last = self._last, (stamp_s, content)
        return None if last is None else self._between(*last, content, stamp_s - last[0])

    def end(self) -> WheelSpeeds | None:
        """See `SpeedReader`."""
        return None if self._last is None else self._after(*self._last)


def pose_speeds(
    wheels: Wheels, pose_of: Callable[[Any], _PoseAndTwist | None], by_twist: bool
) -> HeldSpeeds[_PoseAndTwist]:
    """Reads speeds of nominal wheels from the increments between poses, or from twists.

    Increments are preferred: they lose no motion where messages are far apart or were dropped.

    Args:
        pose_of: gives pose x, y, yaw and twist v, ω of a message, or None where its numbers are invalid.
        by_twist: whether to use twists, since poses stay at zero; each holds from its message on.
    """

    def between(stamp_s: float, before: _PoseAndTwist, now: _PoseAndTwist, lasted_s: float) -> WheelSpeeds:
        if by_twist:
            return after(stamp_s, before)
        ahead_m, _, turn_rad = increment(before, now)
        return speeds_of_wheels(wheels, stamp_s, ahead_m / lasted_s, turn_rad / lasted_s)

    def after(stamp_s: float, last: _PoseAndTwist) -> WheelSpeeds:
        return speeds_of_wheels(wheels, stamp_s, *last[1])

    return HeldSpeeds(pose_of, between, after)


def twist_speeds(wheels: Wheels) -> HeldSpeeds[tuple[float, float]]:
    """Reads speeds of nominal wheels from measured velocities: the mean of two consecutive messages."""

    def content_of(message: Any) -> tuple[float, float] | None:
        twist = twist_of(message)
        return None if twist is None else (twist[0], twist[2])

    return HeldSpeeds(
        content_of,
        lambda stamp_s, a, b, _: speeds_of_wheels(wheels, stamp_s, (a[0] + b[0]) / 2, (a[1] + b[1]) / 2),
        lambda stamp_s, last: speeds_of_wheels(wheels, stamp_s, *last),
    )


def field_speeds(numbers_of: Callable[[Any], Mapping[str, float]], sides: Joints) -> HeldSpeeds[tuple[float, ...]]:
    """Reads speeds of the robot's own wheels from fields in rad/s.

    Args:
        numbers_of: gives the numbers of a message by name.
        sides: names of the left and the right wheels' numbers.
    """

    def content_of(message: Any) -> tuple[float, ...] | None:
        numbers = numbers_of(message)
        of_sides = [[numbers.get(name, math.nan) for name in side] for side in (sides.left, sides.right)]
        speeds = tuple(sum(side) / len(side) for side in of_sides)
        return speeds if are_measured(speeds) else None

    return HeldSpeeds(
        content_of,
        lambda stamp_s, before, now, _: WheelSpeeds(stamp_s, *((a + b) / 2 for a, b in zip(before, now, strict=True))),
        lambda stamp_s, last: WheelSpeeds(stamp_s, *last),
    )


def joint_speeds(joints: Joints) -> HeldSpeeds[_AnglesAndSpeeds]:
    """Reads speeds of the robot's own wheels from the angles of their joints, or from their speeds without angles."""
    reader, count = JointReader((*joints.left, *joints.right)), len(joints.left)

    def speeds(stamp_s: float, of_joints: Sequence[float]) -> WheelSpeeds:
        left, right = of_joints[:count], of_joints[count:]
        return WheelSpeeds(stamp_s, sum(left) / len(left), sum(right) / len(right))

    def between(stamp_s: float, before: _AnglesAndSpeeds, now: _AnglesAndSpeeds, lasted_s: float) -> WheelSpeeds:
        if not now[0] or not before[0]:
            return speeds(stamp_s, before[1])
        return speeds(stamp_s, [reader.turned(a, b) / lasted_s for a, b in zip(before[0], now[0], strict=True)])

    def after(stamp_s: float, last: _AnglesAndSpeeds) -> WheelSpeeds:
        return speeds(stamp_s, last[1] or [0.0] * len(joints.left + joints.right))

    return HeldSpeeds(reader.read, between, after)


class JointReader:
    """Reads angles and speeds of joints by their names."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._farthest_rad = 0.0

    def read(self, message: Any) -> _AnglesAndSpeeds | None:
        """Angles and speeds of the joints; each may be empty. None where both are, or any number is invalid."""
        places = {name: place for place, name in enumerate(message.name)}
        wanted = [places.get(name) for name in self._names]
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
        """The angle by which a joint turned. Angles that never exceed one turn are taken to wrap around."""
        turned_rad = after_rad - before_rad
        if abs(turned_rad) > math.pi and self._farthest_rad <= 2 * math.pi + _WRAP_SLACK:
            return math.remainder(turned_rad, 2 * math.pi)
        return turned_rad


class CountedTicks(SpeedReader):
    """Counts of encoders, from integers in fields or an array.

    Args:
        numbers_of: gives the numbers of a message by name.
        sides: names of the left and the right wheels' numbers; those of a side are averaged.
        bits: of the counters, whose wrap-around is removed; 0 without wrap-around.
        per_number: the calibration's encoder counts per unit of these numbers.
    """

    def __init__(
        self, numbers_of: Callable[[Any], Mapping[str, float]], sides: Joints, bits: int, per_number: float = 1.0
    ) -> None:
        self._numbers_of, self._sides, self._per_number = numbers_of, sides, per_number
        self._unrolled = {name: _Unrolled(bits) for name in (*sides.left, *sides.right)}
        self._last_s = -math.inf

    def add(self, stamp_s: float, message: Any) -> WheelTicks | None:
        """See `SpeedReader`."""
        numbers = self._numbers_of(message)
        wanted = {name: numbers.get(name, math.nan) for name in self._unrolled}
        if not all(math.isfinite(number) for number in wanted.values()):
            self.unusable += 1
            return None
        if stamp_s <= self._last_s:
            return None
        self._last_s = stamp_s
        counts = {name: self._unrolled[name](number) for name, number in wanted.items()}
        left, right = (
            round(self._per_number * sum(counts[name] for name in side) / len(side))
            for side in (self._sides.left, self._sides.right)
        )
        return WheelTicks(stamp_s, left, right)


class CountsApart(SpeedReader):
    """Counts of encoders with a topic for each wheel. Right counts are interpolated at the stamps of left ones."""

    def __init__(self, bits: int) -> None:
        self._unrolled = _Unrolled(bits), _Unrolled(bits)
        self._left: tuple[float, float] | None = None
        self._right: tuple[tuple[float, float], ...] = ()

    def add(self, stamp_s: float, message: Any) -> WheelTicks | None:
        """A message of the left wheel; see `SpeedReader`."""
        self._left = stamp_s, self._unrolled[0](int(message.data))
        return self._both()

    def add_right(self, stamp_s: float, message: Any) -> WheelTicks | None:
        """Add a message of the right wheel. Returns the counts at the last left message, if that is not newer."""
        self._right = (*self._right[-1:], (stamp_s, self._unrolled[1](int(message.data))))
        return self._both()

    def _both(self) -> WheelTicks | None:
        """The counts of both wheels at the last left message, once right messages enclose it; else None."""
        if self._left is None or not self._right or not self._right[0][0] <= self._left[0] <= self._right[-1][0]:
            return None
        (stamp_s, left), self._left = self._left, None
        (before_s, before), (after_s, after) = self._right[0], self._right[-1]
        share = (stamp_s - before_s) / (after_s - before_s) if after_s > before_s else 1.0
        return WheelTicks(stamp_s, round(left), round(before + share * (after - before)))


class _Unrolled:
    """Removes the wrap-around of counters with `bits` bits."""

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


class BasePoses(SpeedReader):
    """The pose of a holonomic base by its own odometry.

    Args:
        pose_of: gives pose x, y, yaw and twist of a message, or None where its numbers are invalid. Without it, the
            mean twists of consecutive messages are integrated.
    """

    def __init__(self, pose_of: Callable[[Any], _PoseAndTwist | None] | None) -> None:
        self._pose_of = pose_of
        self._T = se2.from_parts(0.0, 0.0, 0.0)
        self._last: tuple[float, tuple[float, float, float]] | None = None

    def add(self, stamp_s: float, message: Any) -> OdometryReading | None:
        """See `SpeedReader`; a message that is not newer than the last one is ignored."""
        known = self._pose_of(message) if self._pose_of is not None else None
        content = twist_of(message) if self._pose_of is None else None if known is None else known[0]
        if content is None or (self._last is not None and stamp_s <= self._last[0]):
            self.unusable += content is None
            return None
        if self._pose_of is None:
            if self._last is not None:
                before_s, before = self._last
                step = [(a + b) / 2 * (stamp_s - before_s) for a, b in zip(before, content, strict=True)]
                self._T = se2.compose(self._T, se2.exp(step))
            x_m, y_m, yaw_rad = (float(part) for part in se2.to_parts(self._T))
        else:
            x_m, y_m, yaw_rad = content
        self._last = stamp_s, content
        return OdometryReading(stamp_s, x_m, y_m, yaw_rad)


class AllCounts(SpeedReader):
    """Counts of all wheels of a holonomic base, from an array, or from angles or speeds of joints.

    Args:
        places: names of joints, or indices of an array, in the order of the calibration's wheels.
        bits: of an array's counters, whose wrap-around is removed; 0 without wrap-around.
        ticks_per_turn: counts per turn for joints; None for an array.
    """

    def __init__(self, places: tuple[str, ...], bits: int = 0, ticks_per_turn: float | None = None) -> None:
        self._places = places
        self._unrolled = [_Unrolled(bits) for _ in places]
        self._joints = None if ticks_per_turn is None else JointReader(places)
        self._per_rad = 0.0 if ticks_per_turn is None else ticks_per_turn / (2 * math.pi)
        self._angles_rad = [0.0] * len(places)
        self._last: tuple[float, _AnglesAndSpeeds] | None = None
        self._last_s = -math.inf

    def add(self, stamp_s: float, message: Any) -> WheelCounts | None:
        """See `SpeedReader`; a message that is not newer than the last one is ignored."""
        if stamp_s <= self._last_s:
            return None
        if self._joints is None:
            numbers = columns_of(message)
            wanted = [numbers.get(place, math.nan) for place in self._places]
            counts = None
            if all(math.isfinite(number) for number in wanted):
                counts = tuple(round(unrolled(n)) for unrolled, n in zip(self._unrolled, wanted, strict=True))
        else:
            counts = self._of_joints(self._joints, stamp_s, message)
        if counts is None:
            self.unusable += 1
            return None
        self._last_s = stamp_s
        return WheelCounts(stamp_s, counts)

    def _of_joints(self, joints: JointReader, stamp_s: float, message: Any) -> tuple[int, ...] | None:
        """Counts from the integrated motion of joints; None where the message is invalid."""
        content = joints.read(message)
        if content is None:
            return None
        angles, speeds = content
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
        self._last = stamp_s, content
        return tuple(round(angle * self._per_rad) for angle in self._angles_rad)


# Front and rear, left and right in a joint's name, as words or letters: fl, rear_left, wheel_lf_joint.
_CORNERS = tuple(
    re.compile(
        rf"({end})[_\-.]?{side}|{side}[_\-.]?({end})|(?:^|[_\-/.])(?:[{letters}]{side[0]}|{side[0]}[{letters}])(?:$|[_\-/.\d])",
        re.IGNORECASE,
    )
    for end, letters in (("front|fore|upper", "fu"), ("rear|back|aft|lower", "rb"))
    for side in ("left", "right")
)


def corner_joints(names: Sequence[str]) -> tuple[str, ...] | None:
    """The joints of four wheels: front left, front right, rear left, rear right; None where not found by name."""
    wheels = [name for name in names if not _CASTER.search(name)]
    found = [[name for name in wheels if corner.search(name)] for corner in _CORNERS]
    if any(len(one) != 1 for one in found):
        return None
    places = tuple(one[0] for one in found)
    return places if len(set(places)) == len(places) else None


def wheel_joints(names: Sequence[str]) -> Joints | None:
    """The joints of left and right wheels, by their names; None where they are not found."""
    wheels = [name for name in names if _WHEEL.search(name) and not _CASTER.search(name)]
    left, right = (tuple(name for name in wheels if side.search(name)) for side in _SIDES)
    if not left or len(left) != len(right) or set(left) & set(right):
        return None
    return Joints(left, right)


def poses_stay_zero(messages: Sequence[Any]) -> bool:
    """Whether poses of an Odometry stay at zero while its twists do not."""
    valid = [found for found in map(planar_of, messages) if found is not None]
    return bool(valid) and not any(any(pose) for pose, _ in valid) and any(any(twist) for _, twist in valid)


def increment(before: _PoseAndTwist, now: _PoseAndTwist) -> tuple[float, float, float]:
    """The motion ahead and to the left, metres, and the turn, radians, between two poses."""
    T_before_now = se2.compose(se2.invert(se2.from_parts(*before[0])), se2.from_parts(*now[0]))
    ahead_m, across_m, turn_rad = se2.log(T_before_now).tolist()
    return ahead_m, across_m, turn_rad


def planar_of(message: Any) -> _PoseAndTwist | None:
    """Pose x, y, yaw and twist v, ω of an Odometry; None where they are invalid."""
    pose, twist = message.pose.pose, message.twist.twist
    return _planar(pose.position, pose.orientation, (twist.linear.x, twist.angular.z))


def planar_of_transform(stamped: Any) -> _PoseAndTwist | None:
    """Pose x, y, yaw of a TransformStamped, with a twist of zero; None where they are invalid."""
    return _planar(stamped.transform.translation, stamped.transform.rotation, (0.0, 0.0))


def twist_of(message: Any) -> tuple[float, float, float] | None:
    """Speeds ahead and to the left, m/s, and yaw rate, rad/s, of an Odometry or TwistStamped; None where invalid."""
    twist = getattr(message.twist, "twist", message.twist)
    speeds = (twist.linear.x, twist.linear.y, twist.angular.z)
    return speeds if are_measured(speeds) else None


def _planar(position: Any, q: Any, speeds: tuple[float, float]) -> _PoseAndTwist | None:
    if not are_measured((position.x, position.y, q.w, q.x, q.y, q.z, *speeds)):
        return None
    yaw_rad = math.atan2(2 * (q.w * q.z + q.x * q.y), q.w**2 + q.x**2 - q.y**2 - q.z**2)
    return (position.x, position.y, yaw_rad), speeds


def columns_of(message: Any) -> dict[str, float]:
    """The numbers of an array by index, "0" first."""
    return {str(place): float(number) for place, number in enumerate(message.data[:_MOST_COLUMNS])}


def fields_of(message: Any) -> dict[str, float]:
    """The scalar numbers of a message by field."""
    plain = {name: getattr(message, name) for name in message.__dataclass_fields__}
    return {name: float(value) for name, value in plain.items() if isinstance(value, int | float)}
