"""`sources_in` finds the topics of a bag that describe the motion of its wheels: odometry, joints, counts, speeds or
tf. Raw readings rank before a filter's output.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice, pairwise
from typing import Any, Literal

import numpy as np

from wheelsight.core.calibration_parts import HolonomicWheels, Wheels
from wheelsight.core.errors import ConfigError, RecordingError
from wheelsight.io.recordings.bags.chunks import TF
from wheelsight.io.recordings.bags.storage import OpenBag, Topic, TransformTopic
from wheelsight.io.recordings.bags.wheel_readings import (
    AllCounts,
    BasePoses,
    CountedTicks,
    CountsApart,
    Joints,
    SpeedReader,
    columns_of,
    corner_joints,
    field_speeds,
    fields_of,
    increment,
    planar_of,
    planar_of_transform,
    pose_speeds,
    twist_of,
    twist_speeds,
    wheel_joints,
)

ODOMETRY, JOINTS = "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"
_TWISTS = ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/TwistWithCovarianceStamped")
_COUNT = re.compile(r"std_msgs/msg/(?P<sign>U?)Int(?P<bits>16|32|64)")
_ARRAY = re.compile(r"std_msgs/msg/(?P<sign>U?)Int(?P<bits>16|32|64)MultiArray")
# Packages whose messages have no fields of a left and a right wheel.
_OF_ROS = re.compile(
    r"(std|sensor|geometry|nav|tf2?|rosgraph|diagnostic|visualization|actionlib|stereo|shape|trajectory|map|bond|"
    r"dynamic_reconfigure|rcl_interfaces|builtin_interfaces|action|lifecycle|statistics|service|theora\w*)_?msgs/|"
    r"(dynamic_reconfigure|bond|tf|rcl_interfaces|builtin_interfaces|roscpp|rosgraph\w*)/"
)
_WHEEL_WORDS = re.compile(r"wheel|controller|diff|base|encoder", re.IGNORECASE)
_NO_WHEELS = re.compile(
    r"visual|vio|vo\b|rtabmap|slam|icp|gps|truth|lidar|laser|camera|t265|mocap|vicon|optitrack", re.I
)
# Outputs of sensor fusion: robot_localization, robot_pose_ekf and others.
_FUSED = re.compile(r"filter|ekf|ukf|fused|fusion|combined|robot_pose|kalman", re.IGNORECASE)
_COMMANDED = re.compile(
    r"cmd|command|request|target|desired|setpoint|goal|teleop|joy|reference|\bset|pwm|duty|current|effort|torque|power|"
    r"gps|gnss|fix|bump|cliff|drop|light|wall|brush|dist_to|error|load|temp|volt",
    re.IGNORECASE,
)
_COUNTED = re.compile(r"enc|tick|count|pulse|wheel|whl|motor|odom", re.IGNORECASE)
_COUNTED_FIELD = re.compile(r"enc|tick|count|pulse", re.IGNORECASE)
_ROLLED_FIELD = re.compile(r"position_?in_?mm|dist\w*_?mm|_mm$", re.IGNORECASE)
_SPEED_FIELD = re.compile(r"vel|speed|omega|rad_?s", re.IGNORECASE)
_MAYBE_WHEELS = re.compile(r"wheel|whl|enc|tick|odom|motor|vel|sensor_?s|state|core", re.IGNORECASE)
_ONE_SIDE = re.compile(r"(^|[/_])l(?=[/_]|wheel|whl|enc|tick|motor|count|$)", re.IGNORECASE)
_ODOM_FRAME, _BASE_FRAME = re.compile(r"(?:.*/)?(odom\w*|wheel_odom)"), re.compile(r"(?:.*/)?base(_footprint|_link)?")
_MOST_SAMPLES, _TF_SAMPLES = 20, 400
# Most messages of tf that are read to count a transform, which takes some tenths of a second.
_MOST_COUNTED = 5000
# Increments that are checked for sideways motion: all of a short bag, else this many in windows spread over it.
_MOST_INCREMENTS, _WINDOWS = 4000, 20
# Sideways errors of a differential drive (slip, a heading from before a turn) stay below this share of its path.
_MOST_SIDEWAYS = 0.05
_LEAST_SIDEWAYS_M = 0.1  # the noise of a robot at rest adds up to less
_LONGEST_LEVER_M = 1.0  # from a drive's axle to the frame of its base

Kind = Literal["odometry", "joints", "twist", "counts", "columns", "fields", "tf"]


@dataclass(frozen=True, slots=True)
class WheelTopic:
    """A topic that describes the motion of the wheels.

    Attributes:
        topic: its name, type and count; of tf, one transform.
        sides: joints, fields or places in an array, of the left and the right wheels.
        right: the right wheel's topic, where each has one.
        bits: of the counter, which wraps around; 0 where it does not.
        unit: of fields: "counts", "mm" rolled, or "rad/s".
        rank: the source with the least is used.
        doubt: a reason against it; empty without one.
        places: joints or indices of an array, in the order of the calibration's wheels.
    """

    topic: Topic
    kind: Kind
    rank: int
    sides: Joints | None = None
    right: str | None = None
    bits: int = 0
    unit: str = ""
    transform: TransformTopic | None = None
    doubt: str = ""
    is_holonomic: bool = False
    places: tuple[str, ...] = ()

    @property
    def needs_sizes(self) -> bool:
        """Whether it gives angles or speeds of wheels, so that a calibration must give their sizes."""
        return self.kind in ("joints", "counts", "columns", "fields")

    @property
    def contents(self) -> str:
        """Its data in a few words, for messages."""
        sides = "" if self.sides is None else f"{'+'.join(self.sides.left)} and {'+'.join(self.sides.right)}"
        sides = ", ".join(self.places) or sides
        return {
            "odometry": "increments of its poses",
            "joints": f"the joints {sides}",
            "twist": "its measured speeds",
            "counts": f"counts of {self.topic.name} and {self.right}",
            "columns": f"counts at the places {sides} of its array, counted from 0",
            "fields": f"{self.unit} of its fields {sides}",
            "tf": "increments of this transform",
        }[self.kind]

    def why_not(self, knows_wheels: bool) -> str:
        """Why it is not used, for messages."""
        if self.needs_sizes and not knows_wheels:
            return f"{self.contents}; their sizes are not known: give a calibration.yaml with wheels by --calibration"
        return self.doubt or self.contents

    def reader(self, wheels: Wheels, nominal: Wheels, by_twist: bool) -> Callable[[], SpeedReader]:
        """A factory of readers.

        Args:
            nominal: wheels for sources that give the motion of the base.
            by_twist: whether to use twists, since poses stay at zero.
        """
        sides = self.sides or Joints((), ())
        if self.kind == "odometry":
            return partial(pose_speeds, nominal, planar_of, by_twist)
        if self.kind == "tf":
            return partial(pose_speeds, nominal, self.planar_of_tf, False)
        if self.kind == "twist":
            return partial(twist_speeds, nominal)
        if self.kind == "counts":
            return partial(CountsApart, self.bits)
        if self.kind == "columns":
            return partial(CountedTicks, columns_of, sides, self.bits)
        if self.unit == "rad/s":
            return partial(field_speeds, fields_of, sides)
        per_number = 1e-3 / wheels.left_m_per_tick if self.unit == "mm" else 1.0
        return partial(CountedTicks, fields_of, sides, self.bits, per_number)

    def holonomic_reader(self, wheels: HolonomicWheels, by_twist: bool) -> Callable[[], SpeedReader]:
        """A factory of readers for a holonomic base.

        Args:
            by_twist: whether to use twists, since poses stay at zero.
        """
        if self.kind == "joints":
            return partial(AllCounts, self.places, 0, wheels.ticks_per_turn)
        if self.kind == "columns":
            return partial(AllCounts, self.places, self.bits)
        pose_of = planar_of if self.kind == "odometry" else self.planar_of_tf
        return partial(BasePoses, None if by_twist or self.kind == "twist" else pose_of)

    def planar_of_tf(self, message: Any) -> Any:
        """Pose and twist of a message of tf; see `planar_of_transform`."""
        stamped = None if self.transform is None else self.transform.found_in(message)
        return None if stamped is None else planar_of_transform(stamped)


def is_fused(source: WheelTopic) -> bool:
    """Whether its name says that it is the output of sensor fusion, which includes a gyroscope."""
    return source.kind in ("odometry", "tf", "twist") and bool(_FUSED.search(source.topic.name))


def sources_in(bag: OpenBag, topics: Sequence[Topic], sides: Joints | None, is_estimated: bool) -> list[WheelTopic]:
    """All sources of wheel motion in a bag, the best first. Reads some first messages, and the last of arrays.

    Args:
        sides: joints that the user chose, or None.
        is_estimated: whether poses, twists and tf are wheelsight's own estimate, and so not used.
    """
    found: list[WheelTopic] = []
    names = {(topic.name, topic.type) for topic in topics}
    for topic in topics:
        with suppress(RecordingError):  # a message that cannot be read
            found += _sources_of(bag, topic, names, sides)
    if is_estimated:
        found = [source for source in found if source.kind not in ("odometry", "tf", "twist")]
    if any(topic.type == ODOMETRY for topic in topics):
        found = [source for source in found if source.kind != "tf"]  # tf repeats the odometry
    return sorted(found, key=lambda source: (source.rank, source.topic.name))


def _sources_of(bag: OpenBag, topic: Topic, names: set[tuple[str, str]], sides: Joints | None) -> Iterator[WheelTopic]:
    """The sources in one topic, given names and types of all. Raises RecordingError where a message cannot be read."""
    if topic.type == ODOMETRY:
        by_name = not _WHEEL_WORDS.search(topic.name)
        rank = 9 if _NO_WHEELS.search(topic.name) else 7 if _FUSED.search(topic.name) else by_name
        yield WheelTopic(topic, "odometry", rank, doubt=_doubt(topic.name))
    elif topic.type == JOINTS:
        joints = sides or _found_joints(bag, topic.name)
        if joints is not None:
            yield WheelTopic(topic, "joints", 2, joints)
    elif topic.type in _TWISTS:
        if not _COMMANDED.search(topic.name) and not _NO_WHEELS.search(topic.name):
            yield WheelTopic(topic, "twist", 7 if _FUSED.search(topic.name) else 5, doubt=_doubt(topic.name))
    elif topic.type in TF:
        yield from _in_tf(bag, topic)
    elif not _OF_ROS.match(topic.type):
        yield from _in_fields(bag, topic, None)
    elif _is_counted(topic.name):
        yield from _counted(bag, topic, names)


def _counted(bag: OpenBag, topic: Topic, names: set[tuple[str, str]]) -> Iterator[WheelTopic]:
    """Counts of two wheels: the right one in a topic of its own, or both in an array."""
    if match := _COUNT.fullmatch(topic.type):
        right = _other_side(topic.name)
        if right is not None and (right, topic.type) in names:
            yield WheelTopic(topic, "counts", 3, right=right, bits=_bits(match))
    elif match := _ARRAY.fullmatch(topic.type):
        places = _places(bag, topic.name)
        if places is not None:
            yield WheelTopic(topic, "columns", 4, places, bits=_bits(match))


def _doubt(name: str) -> str:
    """A reason against a topic, by its name; empty without one."""
    if _NO_WHEELS.search(name):
        return "but its name says it is not theirs"
    if _FUSED.search(name):
        return "but its name says that a filter joined it from several sensors; raw wheels are better"
    return ""


def _is_counted(name: str) -> bool:
    return bool(_COUNTED.search(name)) and not _COMMANDED.search(name) and not re.search(r"vel|speed|rpm", name, re.I)


def _bits(match: re.Match[str]) -> int:
    bits = int(match["bits"])
    return 0 if bits == 64 else bits


def _other_side(name: str) -> str | None:
    """The name with left replaced by right; None where it has no left side."""
    for left, right in (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT")):
        if left in name:
            return name.replace(left, right)
    changed = _ONE_SIDE.sub(lambda match: f"{match[1]}{'R' if match[0].endswith('L') else 'r'}", name)
    return changed if changed != name else None


def _found_joints(bag: OpenBag, topic: str) -> Joints | None:
    """The wheels among the joints of the first messages: arm and base may alternate on one topic. None without any."""
    for message in bag.first(topic, _MOST_SAMPLES):
        joints = wheel_joints(bag.decode(message).name)
        if joints is not None:
            return joints
    return None


def _places(bag: OpenBag, topic: str) -> Joints | None:
    """The indices of an array of two numbers, or of the only two numbers that change over the bag; else None."""
    arrays = [list(bag.decode(message).data) for message in (*bag.first(topic), bag.last(topic))]
    length = len(arrays[0])
    if any(len(array) != length for array in arrays):
        return None
    changing = [str(place) for place in range(length) if arrays[0][place] != arrays[-1][place]]
    pair = ["0", "1"] if length == 2 else changing
    return Joints((pair[0],), (pair[1],)) if len(pair) == 2 else None


def _in_fields(bag: OpenBag, topic: Topic, sides: Joints | None) -> Iterator[WheelTopic]:
    """Fields of a left and a right wheel in a robot-specific message, by name. Raises ConfigError."""
    types = bag.fields(topic.name)
    if sides is not None:
        missing = [name for name in (*sides.left, *sides.right) if name not in types]
        if missing:
            fix = f"it has {', '.join(types) or 'no plain fields'}"
            raise ConfigError(f"--topic wheels={topic.name}: {topic.type} has no field {missing[0]}", fix=fix)
        pairs = [(sides.left[0], sides)]
    else:
        names = [(name, _other_side(name)) for name in types if not _COMMANDED.search(name)]
        pairs = [(name, Joints((name,), (right,))) for name, right in names if right in types and right is not None]
    for name, pair in pairs:
        is_whole = "int" in types[name]
        if is_whole and _COUNTED_FIELD.search(name):
            bits = int(re.sub(r"\D", "", types[name]))
            yield WheelTopic(topic, "fields", 3, pair, bits=0 if bits == 64 else bits, unit="counts")
        elif _ROLLED_FIELD.search(name):
            yield WheelTopic(topic, "fields", 3, pair, unit="mm")
        elif _SPEED_FIELD.search(name) and not is_whole:
            yield WheelTopic(topic, "fields", 4, pair, unit="rad/s")


def _in_tf(bag: OpenBag, topic: Topic) -> Iterator[WheelTopic]:
    """Transforms from an odom frame to a base frame in the first messages."""
    pairs: dict[tuple[str, str], None] = {}
    for message in bag.first(topic.name, _TF_SAMPLES):
        for stamped in bag.decode(message).transforms:
            parent, child = stamped.header.frame_id.lstrip("/"), stamped.child_frame_id.lstrip("/")
            if _ODOM_FRAME.fullmatch(parent) and _BASE_FRAME.fullmatch(child):
                pairs[parent, child] = None
    for parent, child in pairs:
        transform = counted_transform(bag, topic, parent, child)
        if transform.count > 1:
            of = Topic(transform.name, topic.type, transform.count)
            rank = 7 if _FUSED.search(parent) else 4
            yield WheelTopic(of, "tf", rank, transform=transform, doubt=_doubt(parent))


def counted_transform(bag: OpenBag, topic: Topic, parent: str, child: str) -> TransformTopic:
    """A transform of a topic of tf, with its number of messages. Raises ConfigError where there is none."""
    transform = TransformTopic(topic.name, parent, child, topic.count)
    count = 0
    for message in islice(bag.messages([topic.name]), _MOST_COUNTED):
        with suppress(RecordingError):
            count += transform.found_in(bag.decode(message)) is not None
    if not count:
        problem = f"{topic.name} has no transform from {parent} to {child}"
        raise ConfigError(problem, fix="name two frames that follow each other")
    return transform if topic.count > _MOST_COUNTED else TransformTopic(topic.name, parent, child, count)


def chosen_source(bag: OpenBag, name: str, right: str | None, sides: Joints | None) -> WheelTopic:
    """The source that the user chose.

    Raises:
        ConfigError: the topic does not exist, is empty, or has a type without wheel motion.
        RecordingError: the user must say which of its numbers are the wheels'.
    """
    known = {topic.name: topic for topic in bag.topics if topic.count}
    for one in (name, right):
        if one is not None and one not in known:
            names = {source.topic.name for source in sources_in(bag, list(known.values()), None, False)}
            # Joints without the names of wheels can be named by the user.
            names |= {topic.name for topic in known.values() if topic.type in (ODOMETRY, JOINTS, *_TWISTS)}
            readable = ", ".join(sorted(names))
            fix = f"there are: {readable}" if readable else "the bag has none of wheels"
            raise ConfigError(f"--topic wheels={one}: {bag.path.name} has no messages of it", fix=fix)
    topic = known[name]
    if right is not None or _COUNT.fullmatch(topic.type):
        return _chosen_counts(topic, right or _other_side(name), known)
    if topic.type in (ODOMETRY, *_TWISTS):
        return WheelTopic(topic, "odometry" if topic.type == ODOMETRY else "twist", 0)
    if topic.type == JOINTS:
        return WheelTopic(topic, "joints", 0, sides or _joints_in(bag, name))
    if topic.type in TF:
        if sides is None:
            found = next(_in_tf(bag, topic), None)
            return found or _refuse(bag, name, "no transform from odom to base_link", "PARENT,CHILD")
        transform = counted_transform(bag, topic, sides.left[0].lstrip("/"), sides.right[0].lstrip("/"))
        return WheelTopic(Topic(transform.name, topic.type, transform.count), "tf", 0, transform=transform)
    if match := _ARRAY.fullmatch(topic.type):
        _need_places(bag, name, () if sides is None else (*sides.left, *sides.right))
        places = sides or _places(bag, name) or _refuse(bag, name, "not two numbers that change", "0,1")
        return WheelTopic(topic, "columns", 0, places, bits=_bits(match))
    if not _OF_ROS.match(topic.type):
        found = next(_in_fields(bag, topic, sides), None)
        return found or _refuse(bag, name, "no fields that are known for counts or speeds of wheels", "LEFT,RIGHT")
    types = "Odometry, JointState, TwistStamped, Int16, Int32, their MultiArray, TFMessage"
    fix = f"{types}, or a robot's own type with fields of a left and a right wheel are read"
    raise ConfigError(f"--topic wheels={name} is of {topic.type}", fix=fix)


def _chosen_counts(topic: Topic, right: str | None, known: Mapping[str, Topic]) -> WheelTopic:
    """The source of two topics of counts. Raises ConfigError."""
    match = _COUNT.fullmatch(topic.type)
    if right is None or right not in known:
        raise ConfigError(f"--topic wheels={topic.name} counts one wheel", fix=f"wheels={topic.name},RIGHT_TOPIC")
    if match is None or known[right].type != topic.type:
        types = f"{topic.type} and {known[right].type} are no counts of two wheels"
        fix = "two topics of std_msgs Int16, Int32 or Int64"
        raise ConfigError(f"--topic wheels={topic.name},{right}: {types}", fix=fix)
    return WheelTopic(topic, "counts", 0, right=right, bits=_bits(match))


def _need_places(bag: OpenBag, name: str, places: Sequence[str]) -> None:
    """Raise ConfigError for a place that an array does not have."""
    length = len(bag.decode(bag.first(name)[0]).data)
    known = {str(place) for place in range(length)}
    for place in places:
        if place not in known:
            problem = f"--topic wheels={name}: its array has {length} numbers, and no place {place!r}"
            raise ConfigError(problem, fix="places are counted from 0")


def _refuse(bag: OpenBag, name: str, why: str, form: str) -> Any:
    raise RecordingError(f"{name} has {why}", path=bag.path, fix=f"say which: --topic wheels={name}:{form}")


def _joints_in(bag: OpenBag, topic: str) -> Joints:
    joints = _found_joints(bag, topic)
    if joints is None:
        names = dict.fromkeys(name for message in bag.first(topic, _MOST_SAMPLES) for name in bag.decode(message).name)
        problem = f"no two joints of {topic} are called a left and a right wheel: {', '.join(names)}"
        raise RecordingError(problem, path=bag.path, fix=f"say which: --topic wheels={topic}:LEFT,RIGHT")
    return joints


def unread_topics(bag: OpenBag, topics: Sequence[Topic], found: Sequence[WheelTopic]) -> list[str]:
    """Warnings about topics whose names or types suggest wheels, but that cannot be read."""
    read = {name for source in found for name in (source.topic.name, source.right)}
    warnings = []
    for topic in topics:
        if topic.name in read:
            continue
        if topic.type == JOINTS:
            warnings.append(f"{topic.name} is not used: no two of its joints are called a left and a right wheel.")
        elif (
            (topic.type in _TWISTS or re.search(r"std_msgs/msg/(U?Int|Float)", topic.type))
            and re.search(r"wheel|whl|enc|tick|odom", topic.name, re.IGNORECASE)
            and not _COMMANDED.search(topic.name)
        ):
            how = f"--topic wheels={topic.name}:LEFT,RIGHT, or write a wheels.csv of stamp_s,left,right"
            warnings.append(f"{topic.name} may be of wheels, but its numbers are unknown: {how}.")
        elif not _OF_ROS.match(topic.type) and _MAYBE_WHEELS.search(f"{topic.name} {topic.type}"):
            try:
                bag.fields(topic.name)
            except RecordingError as error:
                warnings.append(f"{topic.name} may be of wheels, but {error.problem} ({error.fix}).")
    return warnings


def holonomic_source(
    bag: OpenBag, topics: Sequence[Topic], wheels: HolonomicWheels, named: str | None, places: Sequence[str]
) -> WheelTopic | None:
    """Joints or an array of all wheels of a holonomic base, by the names of its wheels, or as the user chose.

    Raises RecordingError where the user must say which numbers of the chosen topic are the wheels'.
    """
    count = len(wheels.wheel_names)
    for topic in topics if count else ():
        if named is not None and topic.name != named:
            continue
        if topic.type == JOINTS:
            found = tuple(places) or _joints_of_all(bag, topic.name, wheels)
            if len(found) == count:
                return WheelTopic(topic, "joints", 0, is_holonomic=True, places=found)
        elif match := _ARRAY.fullmatch(topic.type):
            first = bag.decode(bag.first(topic.name)[0]).data
            if named is not None:
                _need_places(bag, named, places)
            found = tuple(places) or (tuple(map(str, range(count))) if len(first) == count else ())
            if len(found) == count and (named is not None or _is_counted(topic.name)):
                return WheelTopic(topic, "columns", 0, bits=_bits(match), is_holonomic=True, places=found)
        else:
            continue
        if named is not None:
            names = ",".join(wheels.wheel_names)
            _refuse(bag, topic.name, f"not {count} numbers that are known for the calibration's wheels", names.upper())
    return None


def _joints_of_all(bag: OpenBag, topic: str, wheels: HolonomicWheels) -> tuple[str, ...]:
    """The joints of all wheels of a holonomic base, in their order; empty where not found."""
    for message in bag.first(topic, _MOST_SAMPLES):
        names = bag.decode(message).name
        if set(wheels.wheel_names) <= set(names):
            return wheels.wheel_names
        if wheels.layout == "mecanum" and (found := corner_joints(names)) is not None:
            return found
    return ()


def sideways(bag: OpenBag, source: WheelTopic) -> str | None:
    """How much of an odometry's path is sideways, where it is more than two wheels can roll; else None.

    Sideways motion by turns is excluded: the axle may be before or behind the base frame, and the heading may be that
    before or after a turn.
    """
    steps = _steps(bag, source)
    if len(steps) < 2:
        return None
    ahead_m, across_m, turn_rad = steps.T
    lever_m = float(across_m @ turn_rad / max(turn_rad @ turn_rad, 1e-12))
    if abs(lever_m) <= _LONGEST_LEVER_M:
        across_m = across_m - lever_m * turn_rad
    across_m = np.maximum(np.abs(across_m) - np.abs(ahead_m * turn_rad) / 2, 0)
    sideways_m, way_m = float(across_m.sum()), float(np.hypot(ahead_m, across_m).sum())
    if sideways_m < max(_LEAST_SIDEWAYS_M, _MOST_SIDEWAYS * way_m):
        return None
    share = 100 * sideways_m / way_m
    return f"{sideways_m:.2f} of {way_m:.2f} m that were checked ({share:.0f} %) are sideways"


def _steps(bag: OpenBag, source: WheelTopic) -> np.ndarray:
    """(N, 3) motion ahead, to the left and turning between consecutive messages, of all or in windows."""
    name = source.topic.name
    if source.transform is not None:
        bag.add_transforms([source.transform])
    if source.kind not in ("odometry", "twist", "tf"):
        return np.zeros((0, 3))
    windows: list[tuple[int, int | None]] = [(bag.start_ns, None)]
    most = _MOST_INCREMENTS
    if source.topic.count > _MOST_INCREMENTS:
        begins = np.linspace(bag.start_ns, bag.end_ns, _WINDOWS + 1).astype(np.int64).tolist()
        windows, most = list(pairwise(begins)), _MOST_INCREMENTS // _WINDOWS
    steps: list[tuple[float, float, float]] = []
    for start_ns, stop_ns in windows:
        received: list[tuple[float, Any]] = []
        for message in islice(bag.messages([name], start_ns, stop_ns), most):
            with suppress(RecordingError):
                received.append((message.receipt_s, bag.decode(message)))
        if source.kind == "twist":
            for (a_s, message), (b_s, _) in pairwise(received):
                speeds = twist_of(message)
                if speeds is not None and 0 < b_s - a_s < 1:
                    steps.append((speeds[0] * (b_s - a_s), speeds[1] * (b_s - a_s), speeds[2] * (b_s - a_s)))
            continue
        of = planar_of if source.kind == "odometry" else source.planar_of_tf
        poses = filter(None, (of(message) for _, message in received))
        steps += [increment(before, now) for before, now in pairwise(poses)]
    return np.array(steps).reshape(-1, 3)
