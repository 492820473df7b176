"""Opens a bag: who is who, how the robot is built, which clocks are believed; by its index and first messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.calibration import Calibration, HolonomicWheels, Wheels, load_calibration, parse_calibration
from wheelsight.errors import CalibrationError, RecordingError, WheelsightError
from wheelsight.geometry import FloatArray, se3
from wheelsight.inputs import is_there
from wheelsight.matches import SpeedVariances
from wheelsight.recordings._cameras import load_camera
from wheelsight.recordings._wheel_recording import need_wheels, shipped_robot
from wheelsight.recordings.clocks import FRAMES, WHEELS, stamp_warnings
from wheelsight.recordings.motion_clocks import MotionClock
from wheelsight.recordings.protocol import Layout, OpenOptions, RecordedTopic
from wheelsight.recordings.rosbag.files import parts_of
from wheelsight.recordings.rosbag.gravity import up_of_gyro
from wheelsight.recordings.rosbag.realsense_sdk import depth_units_m
from wheelsight.recordings.rosbag.recording import BagPlan, BagRecording
from wheelsight.recordings.rosbag.robot import Robot, camera_frame, lacks_sizes, read_robot
from wheelsight.recordings.rosbag.stamps import TopicClock, clocks_of
from wheelsight.recordings.rosbag.storage import Message, OpenBag, TransformTopic, open_bag
from wheelsight.recordings.rosbag.topics import CALIBRATION, TEXT, Choices, Roles, lacks, roles_of
from wheelsight.recordings.rosbag.transforms import motion_of
from wheelsight.recordings.rosbag.wheel_topics import WheelSource
from wheelsight.recordings.rosbag.wheels import JointSpeeds, JointTicks, SpeedReader, told_by_twist
from wheelsight.trajectory import Trajectory

_FIRST_MESSAGES = 5
# Of each topic, to compare its headers with others': a second or two, in so much memory and time at most.
_HEAD_MESSAGES, _HEAD_BYTES, _HEAD_MOST = 12, 96 << 20, 5000
_STAMPED = ("color", "depth", "wheels", "right wheel", "gyro", "truth")


class BagReader:
    """ROS 1 `.bag`, ROS 2 `.mcap` and `.db3`, compressed or split, as files or folders; see docs/bags.md."""

    name = "rosbag"
    layout = Layout.FILE
    needs = "a .bag, .mcap or .db3"

    def recognises(self, folder: Path) -> bool:
        """Whether a file is called as bags are, or a folder holds the parts of one."""
        return bool(parts_of(folder))

    def open(self, folder: Path, options: OpenOptions) -> BagRecording:
        """The bag at a path that was recognised; its index and a few messages are read.

        Raises:
            RecordingError: it is damaged, has no index, or holds nothing to localize by.
            CalibrationError: nothing says what its camera or its wheels are like.
            ConfigError: a topic that was chosen is not there, or rosbags is not installed.
        """
        choices = Choices.of(options.topics)
        with open_bag(folder) as bag:
            stated = _stated_wheels(bag, options)
            holonomic = stated if isinstance(stated, HolonomicWheels) else None
            roles = roles_of(bag, choices, stated is not None or _is_own(bag), holonomic)
            if roles.color is None and roles.wheels is None:
                raise lacks(roles, bag, folder)
            return _open(bag, roles, options)


def _open(bag: OpenBag, roles: Roles, options: OpenOptions) -> BagRecording:
    settings = options.bag
    used = [name for role, name in roles.used.items() if role in _STAMPED]
    lasts = {topic: bag.last(topic) for topic in dict.fromkeys(used)}
    images = [image.name for image in (roles.color, roles.depth) if image is not None]
    lasts_s = {topic: (bag.header(message).stamp_s, message.receipt_s) for topic, message in lasts.items()}
    clocks, warnings = clocks_of(_heads(bag, used), lasts_s, images, settings.most_apart_s)
    robot = read_robot(bag, roles, settings)
    up, of_gravity = up_of_gyro(bag, roles, robot, settings)
    calibration = _calibrated(bag, roles, robot, options)
    wheels, of_wheels, variances = _wheels(bag, roles, calibration)
    truth, of_truth = _truth(bag, roles, robot, clocks, calibration)
    topics = _used_topics(bag, roles)
    units_m = None if roles.depth is None else depth_units_m(bag, roles.depth.name)
    if units_m is not None and options.depth_factor is None:
        options = replace(options, depth_factor=1 / units_m)

    def recording(clocks: dict[str, TopicClock], of_motions: Sequence[str] = ()) -> BagRecording:
        ends = _ends(bag, roles, clocks, lasts)
        told = (*bag.warnings, *roles.warnings, *warnings, *of_motions, *robot.warnings, *of_gravity, *of_wheels)
        told = (*told, *of_truth, *stamp_warnings(_outer(ends)))
        plan = BagPlan(roles, clocks, wheels, up, options)
        return BagRecording(bag.path, calibration, plan, topics, ends, told, variances, truth)

    found = recording(clocks)
    if roles.color is None or roles.depth is None:
        return found
    begins_ns = max(bag.first(image.name)[0].receipt_ns for image in (roles.color, roles.depth))
    found.try_frames(bag, begins_ns + round(1e9 * settings.first_frames_s))
    if roles.wheels is None:
        return found  # a gyroscope counts beside wheels alone
    clocks, of_motions = _by_motions(found.turns(bag), roles, clocks)
    return recording(clocks, of_motions) if of_motions else found


def _used_topics(bag: OpenBag, roles: Roles) -> tuple[RecordedTopic, ...]:
    used_as = {name: " and ".join(r for r, n in roles.used.items() if n == name) for name in roles.used.values()}
    return tuple(
        RecordedTopic(topic.name, topic.type, topic.count, used_as.get(topic.name, "")) for topic in bag.topics
    )


def _by_motions(
    turns: MotionClock, roles: Roles, clocks: dict[str, TopicClock]
) -> tuple[dict[str, TopicClock], list[str]]:
    """Clocks of wheels and gyroscope that go with the camera's turns, and what was decided; as before where none."""
    found = {role: turns.offset(sensor) for role, sensor in (("wheels", "wheels"), ("gyro", "gyroscope"))}
    if found["gyro"].offset_s is None:
        found["gyro"] = found["wheels"]  # one computer reads both
    clocks, told = dict(clocks), []
    for role, of in (("wheels", "wheels"), ("right wheel", "wheels"), ("gyro", "gyro")):
        topic, offset = roles.used.get(role), found[of]
        if topic is None or roles.color is None or offset.offset_s is None:
            continue
        # What receipt has taken out it knows but to within its delay: turns know better.
        by_receipt = clocks[topic].shift_s != clocks[roles.color.name].shift_s
        if not (offset.is_apart or (by_receipt and abs(offset.offset_s) > 3 * offset.sigma_s)):
            continue
        clocks[topic] = TopicClock(clocks[topic].shift_s + offset.offset_s, clocks[topic].by_receipt)
        told.append(
            f"{topic}: by the turns that both show, the camera's stamps are {offset}: the clocks are apart. "
            "The difference is taken out."
        )
    return clocks, told


def _calibrated(bag: OpenBag, roles: Roles, robot: Robot, options: OpenOptions) -> Calibration:
    """The robot as the bag tells it, under what the user says of it, and what a calibration.yaml beside it says."""
    path = bag.path
    beside = path / "calibration.yaml"
    over = [*([beside] if is_there(beside) else []), *options.calibrations]
    known, own = robot.calibration, _own(bag, roles)
    if own is not None:
        known = own if known is None else known.updated_by(own)
    if options.camera is not None:
        camera = load_camera(options.camera)
        known = camera if known is None else known.updated_by(camera)
    if known is None and not over:
        assert robot.lacks is not None
        raise robot.lacks
    calibration = load_calibration(*over, under=known) if over else known
    assert calibration is not None
    if robot.needs_cameras and calibration.color is None:
        raise robot.lacks or CalibrationError("nothing tells what the camera is like", path=path, fix="give --camera")
    if robot.needs_wheels and calibration.any_wheels is None:
        raise lacks_sizes(bag, roles)
    return calibration


def _is_own(bag: OpenBag) -> bool:
    """Whether the bag is one of wheelsight's own, which carries the robot's calibration."""
    return any(topic.name == CALIBRATION and topic.type == TEXT and topic.count for topic in bag.topics)


def _stated_wheels(bag: OpenBag, options: OpenOptions) -> Wheels | HolonomicWheels | None:
    """The wheels that a calibration states, the last one; what is wrong with one is said when it is used."""
    stated = None
    if _is_own(bag):
        with suppress(WheelsightError):
            stated = parse_calibration(bag.decode(bag.first(CALIBRATION)[0]).data, bag.path).any_wheels
    beside = bag.path / "calibration.yaml"
    for path in (*([beside] if is_there(beside) else []), *options.calibrations):
        with suppress(WheelsightError):
            stated = load_calibration(path).any_wheels or stated
    return stated


def _own(bag: OpenBag, roles: Roles) -> Calibration | None:
    """What a bag of our own carries as text; its wheels where their joints are used. Raises CalibrationError."""
    if not _is_own(bag):
        return None
    told = parse_calibration(bag.decode(bag.first(CALIBRATION)[0]).data, bag.path)
    return told if roles.joints is not None else replace(told, wheels=None)


def _wheels(
    bag: OpenBag, roles: Roles, calibration: Calibration
) -> tuple[Callable[[], SpeedReader] | None, list[str], SpeedVariances | None]:
    """What makes a reader of the wheels' topic, sentences on it, and what it states of its own errors."""
    if roles.wheels is None:
        return None, [], None
    if roles.joints is not None:
        names = f"{'+'.join(roles.joints.left)} and {'+'.join(roles.joints.right)}"
        ticks_per_turn = _ticks_per_turn(bag, roles, calibration)
        if ticks_per_turn is not None:
            return partial(JointTicks, roles.joints, ticks_per_turn), [], None
        return partial(JointSpeeds, roles.joints), [f"{roles.wheels.name}: wheels are the joints {names}."], None
    topic, source = roles.wheels.name, roles.source
    assert source is not None
    if source.is_holonomic:
        return _of_holonomic(bag, source, calibration)
    nominal = need_wheels(shipped_robot("velocities"))
    if source.kind != "odometry":
        wheels = need_wheels(calibration) if source.needs_sizes else nominal
        truth = "" if source.needs_sizes else "; it is the robot's own estimate, no truth"
        return source.reader(wheels, nominal, False), [f"{topic}: wheels are known by {source.tells}{truth}."], None
    sampled = [bag.decode(message) for message in (*bag.first(topic, _FIRST_MESSAGES), bag.last(topic))]
    by_twist = told_by_twist(sampled)
    how = "speeds, since its poses stay at zero" if by_twist else source.tells
    told = [f"{topic}: wheels are known by {how}; it is the robot's own estimate, no truth."]
    return source.reader(nominal, nominal, by_twist), told, _variances(bag, topic, sampled[0])


def _of_holonomic(
    bag: OpenBag, source: WheelSource, calibration: Calibration
) -> tuple[Callable[[], SpeedReader], list[str], None]:
    """As `_wheels`, of a holonomic base. Raises CalibrationError where the calibration has two wheels."""
    wheels, topic = calibration.holonomic, source.topic.name
    if wheels is None:
        problem = f"the calibration ({calibration.source}) has two wheels, and {topic} is of a holonomic base"
        raise CalibrationError(problem, path=bag.path, fix="say `kind: holonomic` of its wheels")
    is_posed = source.kind == "odometry"
    messages = (*bag.first(topic, _FIRST_MESSAGES), bag.last(topic)) if is_posed else ()
    by_twist = is_posed and told_by_twist([bag.decode(message) for message in messages])
    how = "speeds, since its poses stay at zero" if by_twist else source.tells
    estimate = "" if source.needs_sizes else "; it is the robot's own estimate, no truth"
    told = f"{topic}: a holonomic base is known by {how}{estimate}."
    return source.holonomic_reader(wheels, by_twist), [told], None


def _truth(
    bag: OpenBag, roles: Roles, robot: Robot, clocks: Mapping[str, TopicClock], calibration: Calibration
) -> tuple[Trajectory | None, list[str]]:
    """The true poses of the topic that a user named, and sentences on them. Raises RecordingError where it has none."""
    name = roles.truth
    if name is None:
        return None, []
    part = next((one for one in roles.transforms if one.name == name), None)
    clock, settled, unusable = clocks[name].restarted(), list[tuple[float, Message]](), 0
    for message in bag.messages([name]):
        try:
            settled += clock.add(bag.header(message).stamp_s, message)
        except RecordingError:  # one damaged message
            unusable += 1
    stamps_s, poses, child = list[float](), list[FloatArray](), ""
    for stamp_s, message in sorted([*settled, *clock.end()], key=lambda item: item[0]):
        found, child = _pose_of(bag.decode(message), part)
        if found is None or (stamps_s and stamp_s <= stamps_s[-1]):
            unusable += 1
            continue
        stamps_s.append(stamp_s)
        poses.append(found)
    if not poses:
        raise RecordingError(f"{name} holds no pose", path=bag.path, fix="choose another --topic truth=…")
    warnings = [f"{name}: {unusable:,} messages hold no pose, or came twice, and were left out."] if unusable else []
    body, frame = "base", robot.base
    if roles.color is not None and calibration.T_base_camera is None:
        body, frame = "camera", camera_frame(roles)
    T_child_body = robot.transforms.between(child, frame) if child and frame else None
    if T_child_body is None and child != frame:
        of = f"of {child!r}, which tf does not join with it" if child else "without a name of what they are of"
        warnings.append(f"{name}: its poses, {of}, are taken for those of the {body}.")
    T = np.stack(poses) if T_child_body is None else se3.compose(np.stack(poses), T_child_body)
    return Trajectory(np.array(stamps_s), T, body=body), warnings


def _pose_of(message: Any, part: TransformTopic | None) -> tuple[FloatArray | None, str]:
    """A pose (4, 4), None where its numbers are none, and the frame that it is of, empty where that is not said."""
    stamped: Any = message if part is None else part.found_in(message)
    child = str(getattr(stamped, "child_frame_id", "")).lstrip("/")
    if hasattr(stamped, "transform"):
        return motion_of(stamped.transform.translation, stamped.transform.rotation), child
    pose = getattr(stamped.pose, "pose", stamped.pose)
    return motion_of(pose.position, pose.orientation), child


def _ticks_per_turn(bag: OpenBag, roles: Roles, calibration: Calibration) -> float | None:
    """Of the encoders whose counts a bag of our own tells as angles, without speeds; else None."""
    own = _own(bag, roles)
    if own is None or own.wheels is None or calibration.wheels is None or roles.wheels is None:
        return None
    has_speeds = len(bag.decode(bag.first(roles.wheels.name)[0]).velocity) > 0
    is_same = own.wheels.ticks_per_turn == calibration.wheels.ticks_per_turn
    return own.wheels.ticks_per_turn if is_same and not has_speeds else None


def _variances(bag: OpenBag, topic: str, first: Any) -> SpeedVariances | None:
    """Those of the first message's twist, where they are stated."""
    stated = np.asarray(first.twist.covariance, float).reshape(6, 6).diagonal()[[0, 1, 5]]
    if not (np.isfinite(stated).all() and (stated >= 0).all() and stated[0] > 0 and stated[2] > 0):
        return None
    stamp_s = bag.header(bag.first(topic)[0]).stamp_s
    return SpeedVariances(np.array([stamp_s]), stated[None, :])


def _heads(bag: OpenBag, topics: Sequence[str]) -> dict[str, list[tuple[float, float]]]:
    """Header and receipt of the first messages of each topic, from when all have begun, in order of receipt."""
    begins = {topic: bag.first(topic)[0] for topic in topics}
    stamps_s: dict[str, list[tuple[float, float]]] = {topic: [] for topic in topics}
    size = 0
    start_ns = max(message.receipt_ns for message in begins.values())
    for number, message in enumerate(bag.messages(topics, start_ns)):
        size += len(message.data)
        with suppress(RecordingError):  # one damaged message; a pass counts it
            stamps_s[message.topic].append((bag.header(message).stamp_s, message.receipt_s))
        fewest = min(len(found) for found in stamps_s.values())
        if fewest >= _HEAD_MESSAGES or size > _HEAD_BYTES or number > _HEAD_MOST:
            break
    for topic, found in stamps_s.items():
        if not found:  # it ended before another one began
            first = [(bag.header(message).stamp_s, message.receipt_s) for message in bag.first(topic, _FIRST_MESSAGES)]
            found.extend(first)
    return stamps_s


def _ends(
    bag: OpenBag, roles: Roles, clocks: dict[str, TopicClock], lasts: Mapping[str, Message]
) -> dict[str, FloatArray]:
    """Stamps of the first messages and of the last one, of camera and wheels."""
    names = {FRAMES: None if roles.color is None else roles.color.name}
    names[WHEELS] = None if roles.wheels is None else roles.wheels.name
    ends = {}
    for what, topic in names.items():
        if topic is None:
            continue
        begin, end = clocks[topic].restarted(), clocks[topic].restarted()
        first = bag.first(topic, _FIRST_MESSAGES)
        stamps_s = [stamp_s for message in first for stamp_s, _ in begin.add(bag.header(message).stamp_s, message)]
        stamps_s += [stamp_s for stamp_s, _ in (*begin.end(), *end.add(bag.header(lasts[topic]).stamp_s, lasts[topic]))]
        stamps_s += [stamp_s for stamp_s, _ in end.end()]
        ends[what] = np.array(stamps_s)
    return ends


def _outer(ends: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """The first and the last alone: between them nothing is known yet, and no leap can be told."""
    return {name: stamps_s[[0, -1]] for name, stamps_s in ends.items()}
