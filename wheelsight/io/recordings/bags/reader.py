"""`BagReader` opens a bag. It determines topics, clocks and the robot: cameras from CameraInfo, mounts from tf,
wheels from odometry, and the gyroscope's vertical from gravity.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration, load_calibration, parse_calibration
from wheelsight.core.calibration_parts import HolonomicWheels
from wheelsight.core.errors import CalibrationError, RecordingError, WheelsightError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.inputs import is_there
from wheelsight.core.messages import SpeedVariances
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings.bags.chunks import TF, are_measured
from wheelsight.io.recordings.bags.images import camera_of
from wheelsight.io.recordings.bags.recording import BagPlan, BagRecording
from wheelsight.io.recordings.bags.stamps import TopicClock, clocks_of
from wheelsight.io.recordings.bags.storage import Message, OpenBag, open_bag, parts_of
from wheelsight.io.recordings.bags.topics import CALIBRATION, TEXT, Choices, ImageTopic, Roles, lacks, roles_of
from wheelsight.io.recordings.bags.wheel_readings import JointTicks, SpeedReader, joint_speeds, poses_stay_zero
from wheelsight.io.recordings.bags.wheel_topics import WheelTopic
from wheelsight.io.recordings.clock_checks import FRAMES, WHEELS, MotionClock, stamp_warnings
from wheelsight.io.recordings.recording import Layout, OpenOptions, RecordedTopic, load_camera
from wheelsight.io.recordings.wheel_recording import need_wheels, shipped_robot

_FIRST_MESSAGES = 5
_FIRST_FRAMES_S = 5.0  # in which a usable frame must be found for the bag to be opened
# Messages of each topic that are read to compare header stamps with receipt times: a second or two, within bounds of
# memory and time.
_HEAD_MESSAGES, _HEAD_BYTES, _HEAD_MOST = 12, 96 << 20, 5000
_STAMPED = ("color", "depth", "wheels", "right wheel", "gyro", "truth")
# Base frames by REP 105, frames on the ground first. The first one that tf connects to the camera is the base.
_BASES = ("base_footprint", "base_link", "base")
# Least z component, in the base frame, of an optical axis that points upwards. Robots do not look at the ceiling, but
# the z axis of a camera's body frame points up.
_LOOKS_UP = 0.8
_G_M_S2 = 9.81
_UP = np.array([0.0, 0.0, 1.0])


class BagReader:
    """ROS 1 `.bag`, ROS 2 `.mcap` and `.db3`, compressed or split, as files or folders; see docs/bags.md."""

    name = "rosbag"
    layout = Layout.FILE
    needs = "a .bag, .mcap or .db3"

    def recognises(self, folder: Path) -> bool:
        """Whether a file has the name of a bag, or a folder holds the parts of one."""
        return bool(parts_of(folder))

    def open(self, folder: Path, options: OpenOptions) -> BagRecording:
        """The bag at a path that was recognised. Reads its index and a few messages.

        Raises:
            RecordingError: the bag is damaged, has no index, or holds neither camera nor wheels.
            CalibrationError: the calibration of its camera or its wheels is unknown.
            ConfigError: a chosen topic does not exist, or rosbags is not installed.
        """
        choices = Choices.of(options.topics)
        with open_bag(folder) as bag:
            # The wheels of the last calibration that has any. Errors are raised where a calibration is used.
            stated = None
            if _is_own(bag):
                with suppress(WheelsightError):
                    stated = _own_calibration(bag).any_wheels
            for path in _calibration_files(bag, options):
                with suppress(WheelsightError):
                    stated = load_calibration(path).any_wheels or stated
            holonomic = stated if isinstance(stated, HolonomicWheels) else None
            roles = roles_of(bag, choices, stated is not None or _is_own(bag), holonomic)
            if roles.color is None and roles.wheels is None:
                raise lacks(roles, bag, folder)
            return _open(bag, roles, options)


def _calibration_files(bag: OpenBag, options: OpenOptions) -> list[StrPath]:
    """The calibration.yaml beside the bag, if there is one, and those of the user."""
    beside = bag.path / "calibration.yaml"
    return [*([beside] if is_there(beside) else []), *options.calibration]


def _is_own(bag: OpenBag) -> bool:
    """Whether wheelsight wrote the bag, which then carries the robot's calibration."""
    return any(topic.name == CALIBRATION and topic.type == TEXT and topic.count for topic in bag.topics)


def _own_calibration(bag: OpenBag) -> Calibration:
    """The calibration in a bag of wheelsight. Raises CalibrationError."""
    return parse_calibration(bag.decode(bag.first(CALIBRATION)[0]).data, bag.path)


def _open(bag: OpenBag, roles: Roles, options: OpenOptions) -> BagRecording:
    """The recording of a bag whose topics are assigned; frames near its beginning are decoded as a check."""
    used = [name for role, name in roles.used.items() if role in _STAMPED]
    lasts = {topic: bag.last(topic) for topic in dict.fromkeys(used)}
    images = [image.name for image in (roles.color, roles.depth) if image is not None]
    lasts_s = {topic: (bag.header(message).stamp_s, message.receipt_s) for topic, message in lasts.items()}
    clocks, of_clocks = clocks_of(_heads(bag, used), lasts_s, images)
    robot = read_robot(bag, roles)
    up, of_gravity = up_of_gyro(bag, roles, robot)
    calibration = _calibrated(bag, roles, robot, options)
    wheels, of_wheels, variances = _wheels(bag, roles, calibration)
    truth, of_truth = _truth(bag, roles, robot, clocks, calibration)
    used_as = {name: " and ".join(r for r, n in roles.used.items() if n == name) for name in roles.used.values()}
    topics = tuple(
        RecordedTopic(topic.name, topic.type, topic.count, used_as.get(topic.name, "")) for topic in bag.topics
    )
    units_m = None if roles.depth is None else depth_units_m(bag, roles.depth.name)
    if units_m is not None and options.depth_factor is None:
        options = options.model_copy(update={"depth_factor": 1 / units_m})

    def recording(clocks: dict[str, TopicClock], of_motions: Sequence[str] = ()) -> BagRecording:
        ends = _ends(bag, roles, clocks, lasts)
        # The first and the last stamp alone: those between are unknown, so a jump cannot be detected.
        of_stamps = stamp_warnings({what: stamps_s[[0, -1]] for what, stamps_s in ends.items()})
        warnings = (*bag.warnings, *roles.warnings, *of_clocks, *of_motions, *robot.warnings, *of_gravity)
        warnings = (*warnings, *of_wheels, *of_truth, *of_stamps)
        plan = BagPlan(roles, clocks, wheels, up, options)
        return BagRecording(bag.path, calibration, plan, topics, ends, warnings, variances, truth)

    opened = recording(clocks)
    if roles.color is None or roles.depth is None:
        return opened
    begins_ns = max(bag.first(image.name)[0].receipt_ns for image in (roles.color, roles.depth))
    opened.try_frames(bag, begins_ns + round(1e9 * _FIRST_FRAMES_S))
    if roles.wheels is None:
        return opened  # the gyroscope is used together with wheels only
    clocks, of_motions = _clocks_by_motion(opened.turns(bag), roles, clocks)
    if not of_motions:
        return opened
    on_one_clock = recording(clocks, of_motions)
    on_one_clock.stamped = opened
    return on_one_clock


def _heads(bag: OpenBag, topics: Sequence[str]) -> dict[str, list[tuple[float, float]]]:
    """Header stamps and receipt times of each topic's first messages, from when all have begun, by receipt."""
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


def _clocks_by_motion(
    turns: MotionClock, roles: Roles, clocks: dict[str, TopicClock]
) -> tuple[dict[str, TopicClock], list[str]]:
    """Clocks of wheels and gyroscope, corrected by the offsets between their turns and the camera's, with warnings."""
    found = {role: turns.offset(sensor) for role, sensor in (("wheels", "wheels"), ("gyro", "gyroscope"))}
    if found["gyro"].offset_s is None:
        found["gyro"] = found["wheels"]  # one computer reads both
    clocks, warnings = dict(clocks), []
    for role, of in (("wheels", "wheels"), ("right wheel", "wheels"), ("gyro", "gyro")):
        topic, offset = roles.used.get(role), found[of]
        if topic is None or roles.color is None or offset.offset_s is None:
            continue
        # A shift from receipt times includes the transport delay; the offset from turns is more accurate.
        by_receipt = clocks[topic].shift_s != clocks[roles.color.name].shift_s
        if not (offset.is_apart or (by_receipt and abs(offset.offset_s) > 3 * offset.sigma_s)):
            continue
        clocks[topic] = TopicClock(clocks[topic].shift_s + offset.offset_s, clocks[topic].by_receipt)
        warnings.append(
            f"{topic}: by the turns that both show, the camera's stamps are {offset}: the clocks are apart. "
            "The difference is removed."
        )
    return clocks, warnings


# The robot: cameras, mounts and wheels


@dataclass(frozen=True, slots=True)
class BagRobot:
    """The robot as its bag describes it.

    Attributes:
        calibration: the known parts, or None where nothing is known; `lacks` then says why.
        base: name of the base frame, or None.
        lacks: why the camera is unknown, where the bag has one.
    """

    calibration: Calibration | None
    base: str | None
    transforms: Transforms
    warnings: tuple[str, ...]
    lacks: CalibrationError | None = None


def read_robot(bag: OpenBag, roles: Roles) -> BagRobot:
    """The robot by CameraInfo, /tf_static, the first messages of /tf, and the type of its wheels' topic."""
    transforms = Transforms()
    parts = {part.name for part in roles.transforms}
    topics = [topic for topic in bag.topics if topic.type in TF and topic.count and topic.name not in parts]
    # Static transforms come first.
    for topic in sorted(topics, key=lambda topic: "static" not in topic.name):
        is_static, messages = "static" in topic.name, bag.first(topic.name, min(topic.count, _TF_MESSAGES))
        if not all(transforms.add(bag.decode(message).transforms, is_static) for message in messages):
            break  # it is full
    warnings = list(transforms.warnings)
    base = _base_frame(bag, roles, transforms)
    cameras, lacks = None, None
    if roles.color is not None and roles.depth is not None:
        try:
            cameras = _cameras(bag, roles, roles.color, roles.depth, transforms, warnings)
        except CalibrationError as error:
            lacks = CalibrationError(error.problem, path=bag.path, fix=error.fix)
    T_base_camera = None if roles.depth is None else _mount(base, camera_frame(roles), transforms, warnings)
    wheels = None
    if roles.source is not None and not roles.needs_sizes:
        wheels = shipped_robot("velocities")
        if roles.source.is_holonomic:
            slip = need_wheels(wheels).slip_m_per_sqrt_m
            nominal = "nominal, a holonomic base whose own odometry is read"
            wheels = Calibration(holonomic=HolonomicWheels("increments", slip_m_per_sqrt_m=slip), source=nominal)
    mount = None if T_base_camera is None else Calibration(T_base_camera=T_base_camera, source="tf")
    known = [part for part in (cameras, wheels, mount) if part is not None]
    calibration = reduce(Calibration.updated_by, known) if known else None
    if calibration is None and lacks is None:
        lacks = lacks_sizes(bag, roles)
    return BagRobot(calibration, base, transforms, tuple(warnings), lacks)


def _base_frame(bag: OpenBag, roles: Roles, transforms: Transforms) -> str | None:
    """The base frame: a usual name that tf connects to the camera, or the child frame of the odometry."""
    moved: list[str] = []
    if roles.source is not None and roles.source.kind == "odometry":
        moved = [str(bag.decode(bag.first(roles.source.topic.name)[0]).child_frame_id).lstrip("/")]
    elif roles.source is not None and roles.source.transform is not None:
        moved = [roles.source.transform.child]
    if roles.depth is None:
        return next(iter([*moved, _BASES[1]]))
    camera = camera_frame(roles)
    names = [_BASES[0], *moved, *_BASES[1:]]
    return next((name for name in names if name and transforms.between(name, camera) is not None), None)


def camera_frame(roles: Roles) -> str:
    """The frame of depth: the colour camera's where depth is registered to colour."""
    assert roles.color is not None
    assert roles.depth is not None
    return roles.color.frame if roles.depth.says_registered else roles.depth.frame


def _cameras(
    bag: OpenBag, roles: Roles, color: ImageTopic, depth: ImageTopic, transforms: Transforms, warnings: list[str]
) -> Calibration:
    """Both cameras and T_color_depth. Raises CalibrationError where one of them is unknown."""
    color_camera = _camera(bag, color, roles.color_info, warnings)
    source = f"CameraInfo of {bag.path.name}"
    if depth.says_registered:
        return Calibration.registered_camera(color_camera, source=source)
    T_color_depth = joined(bag, color.name, depth.name)
    if T_color_depth is not None:
        warnings.append(f"{depth.name} is not registered to {color.name}: they are joined as the RealSense SDK has it.")
        own = _camera(bag, depth, roles.depth_info, warnings)
        return Calibration(color_camera, own, T_color_depth, source=source)
    is_one = depth.frame == color.frame
    depth_camera = color_camera if is_one and roles.depth_info is None else None
    if depth_camera is None:
        depth_camera = _camera(bag, depth, roles.depth_info, warnings)
    # Lens distortion is not compared: the CameraInfo of a registered image may omit it.
    sizes = [(camera.width, camera.height) for camera in (color_camera, depth_camera)]
    if is_one and sizes[0] == sizes[1] and np.allclose(color_camera.K, depth_camera.K, rtol=1e-3, atol=0.1):
        return Calibration.registered_camera(color_camera, source=source)
    # Two cameras that share one frame have no transform between them in tf.
    T_color_depth = None if is_one else transforms.between(color.frame, depth.frame)
    if T_color_depth is None:
        why = "and tf does not join them"
        if is_one:
            why = "both carry one frame with different CameraInfo, so that tf does not join them"
        problem = f"depth ({depth.frame!r}) is not registered to colour ({color.frame!r}), {why}"
        fix = "record /tf_static with a frame for each, or registered depth, or give T_color_depth by --camera"
        raise CalibrationError(problem, path=bag.path, fix=f"{fix}{_realsense_fix(bag, depth)}")
    warnings.append(f"{depth.name} is not registered to {color.name}: they are joined by tf.")
    return Calibration(color_camera, depth_camera, T_color_depth, source=source)


def _camera(bag: OpenBag, image: ImageTopic, info: str | None, warnings: list[str]) -> PinholeCamera:
    """The camera of a topic by its CameraInfo. Raises CalibrationError where there is none, or it is invalid."""
    if info is None:
        problem = f"no CameraInfo describes the camera of {image.name}"
        fix = f"choose one by --topic color_info=…, or give --camera{_realsense_fix(bag, image)}"
        raise CalibrationError(problem, fix=fix)
    try:
        camera, warning = camera_of(bag.decode(bag.first(info)[0]), image.is_rectified)
    except CalibrationError as error:
        raise CalibrationError(f"{image.name} ({info}): {error.problem}", fix=error.fix or "give --camera") from error
    if warning is not None:
        warnings.append(f"{info}: {warning}.")
    return camera


def _realsense_fix(bag: OpenBag, image: ImageTopic) -> str:
    """A further remedy for bags that the RealSense SDK may have recorded: the SDK reads its own calibration."""
    of_sdk = image.name.startswith("/device_") or any(topic.name.startswith("/device_") for topic in bag.topics)
    file = f"realsense:{bag.path.name}" if of_sdk else "realsense:FILE"
    return f"; wheelsight record --camera {file} reads recordings of the RealSense SDK"


def _mount(base: str | None, camera: str, transforms: Transforms, warnings: list[str]) -> FloatArray | None:
    """T_base_camera (4, 4), or None where tf does not connect the two."""
    T = None if base is None else transforms.between(base, camera)
    if T is not None and T[2, 2] > _LOOKS_UP:
        seems = f"{camera!r} seems to be a frame of its body, not an optical one"
        warnings.append(f"By tf the camera looks upwards: {seems}. Its x axis is taken as the viewing direction.")
        ahead = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
        return np.asarray(T @ ahead)
    if T is None:
        moves = ", ".join(f"{parent} to {child}" for parent, child in sorted(transforms.moving))
        why = f"{moves} moves" if moves else f"tf does not join {camera!r} with {' or '.join(_BASES)}"
        warnings.append(f"The camera's mount on the robot is unknown: {why}. wheelsight calibrate base determines it.")
    return T


def lacks_sizes(bag: OpenBag, roles: Roles) -> CalibrationError:
    """The error for wheels of unknown size."""
    named = "" if roles.source is None else f"{roles.source.topic.name} ({roles.source.contents}): "
    problem = f"{named}these give how far wheels turn, but not how large they are"
    fix = "give a calibration.yaml with wheels (radii, track, ticks_per_turn) by --calibration"
    return CalibrationError(problem, path=bag.path, fix=fix)


def _calibrated(bag: OpenBag, roles: Roles, robot: BagRobot, options: OpenOptions) -> Calibration:
    """The robot's calibration. Later sources replace parts of earlier ones.

    The sources are, in this order: the bag's topics, the calibration in a bag of wheelsight, `--camera`, the
    calibration.yaml beside the bag, and the user's calibrations.
    """
    over = _calibration_files(bag, options)
    known, own = robot.calibration, _own_with_used_wheels(bag, roles)
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
    if roles.color is not None and calibration.color is None:
        raise robot.lacks or CalibrationError("the camera's calibration is unknown", path=bag.path, fix="give --camera")
    if roles.needs_sizes and calibration.any_wheels is None:
        raise lacks_sizes(bag, roles)
    return calibration


def _own_with_used_wheels(bag: OpenBag, roles: Roles) -> Calibration | None:
    """The calibration in a bag of wheelsight; with wheels where their joints are used. Raises CalibrationError."""
    if not _is_own(bag):
        return None
    calibration = _own_calibration(bag)
    return calibration if roles.joints is not None else replace(calibration, wheels=None)


def _wheels(
    bag: OpenBag, roles: Roles, calibration: Calibration
) -> tuple[Callable[[], SpeedReader] | None, list[str], SpeedVariances | None]:
    """A factory of readers of the wheels' topic, warnings, and the variances that its first message states."""
    if roles.wheels is None:
        return None, [], None
    if roles.joints is not None:
        names = f"{'+'.join(roles.joints.left)} and {'+'.join(roles.joints.right)}"
        own = _own_with_used_wheels(bag, roles)
        if own is not None and own.wheels is not None and calibration.wheels is not None:
            # A bag of wheelsight stores counts as joint angles.
            is_same = own.wheels.ticks_per_turn == calibration.wheels.ticks_per_turn
            if not len(bag.decode(bag.first(roles.wheels.name)[0]).velocity) and is_same:
                return partial(JointTicks, roles.joints, own.wheels.ticks_per_turn), [], None
        return partial(joint_speeds, roles.joints), [f"{roles.wheels.name}: wheels are the joints {names}."], None
    topic, source = roles.wheels.name, roles.source
    assert source is not None
    if source.is_holonomic:
        return _holonomic_wheels(bag, source, calibration)
    nominal = need_wheels(shipped_robot("velocities"))
    if source.kind != "odometry":
        wheels = need_wheels(calibration) if source.needs_sizes else nominal
        truth = "" if source.needs_sizes else "; it is the robot's own estimate, no truth"
        return source.reader(wheels, nominal, False), [f"{topic}: wheels are known by {source.contents}{truth}."], None
    sampled = [bag.decode(message) for message in (*bag.first(topic, _FIRST_MESSAGES), bag.last(topic))]
    by_twist = poses_stay_zero(sampled)
    how = "speeds, since its poses stay at zero" if by_twist else source.contents
    warnings = [f"{topic}: wheels are known by {how}; it is the robot's own estimate, no truth."]
    stated = np.asarray(sampled[0].twist.covariance, float).reshape(6, 6).diagonal()[[0, 1, 5]]
    variances = None
    if np.isfinite(stated).all() and (stated >= 0).all() and stated[0] > 0 and stated[2] > 0:
        variances = SpeedVariances(np.array([bag.header(bag.first(topic)[0]).stamp_s]), stated[None, :])
    return source.reader(nominal, nominal, by_twist), warnings, variances


def _holonomic_wheels(
    bag: OpenBag, source: WheelTopic, calibration: Calibration
) -> tuple[Callable[[], SpeedReader], list[str], None]:
    """Like `_wheels`, for a holonomic base. Raises CalibrationError where the calibration has two wheels."""
    wheels, topic = calibration.holonomic, source.topic.name
    if wheels is None:
        problem = f"the calibration ({calibration.source}) has two wheels, and {topic} is of a holonomic base"
        raise CalibrationError(problem, path=bag.path, fix="say `kind: holonomic` of its wheels")
    is_posed = source.kind == "odometry"
    messages = (*bag.first(topic, _FIRST_MESSAGES), bag.last(topic)) if is_posed else ()
    by_twist = is_posed and poses_stay_zero([bag.decode(message) for message in messages])
    how = "speeds, since its poses stay at zero" if by_twist else source.contents
    estimate = "" if source.needs_sizes else "; it is the robot's own estimate, no truth"
    warning = f"{topic}: a holonomic base is known by {how}{estimate}."
    return source.holonomic_reader(wheels, by_twist), [warning], None


# The gyroscope's vertical

# Accelerations are averaged over this time: longer than a start or a bump, shorter than a slope.
_GRAVITY_S = 2.0
# The average is gravity where its size is within this share of 9.81 m/s²: robots accelerate by 2 m/s² at most.
_GRAVITY_SHARE = 0.2
# By how much tf and gravity may disagree (20°): slopes are less. Beyond, tf is wrong and gravity is used.
_GRAVITY_APART_RAD = 0.35


def up_of_gyro(bag: OpenBag, roles: Roles, robot: BagRobot) -> tuple[FloatArray, list[str]]:
    """The upward direction (3,) in the gyroscope's frame, and warnings.

    tf gives it where the mount is known, unless gravity disagrees; else the mean acceleration gives it, since an
    accelerometer at rest measures the reaction to gravity.
    """
    if roles.gyro is None:
        return _UP, []
    frame = bag.header(bag.first(roles.gyro)[0]).frame
    T = None if robot.base is None else robot.transforms.between(robot.base, frame)
    by_tf = None if T is None else T[2, :3]
    # The mean acceleration over the first seconds, where its size is that of gravity.
    by_gravity, stop_ns = None, bag.first(roles.gyro)[0].receipt_ns + round(1e9 * _GRAVITY_S)
    read = [bag.decode(message).linear_acceleration for message in bag.messages([roles.gyro], stop_ns=stop_ns)]
    measured = [(a.x, a.y, a.z) for a in read if are_measured((a.x, a.y, a.z))]
    if measured:  # a damaged index may give later receipt times than the messages have
        mean = np.mean(measured, axis=0)
        size = float(np.linalg.norm(mean))
        by_gravity = np.asarray(mean / size) if abs(size - _G_M_S2) <= _GRAVITY_SHARE * _G_M_S2 else None
    if by_tf is None and by_gravity is None:
        return _UP, [f"{roles.gyro}: neither tf nor gravity shows which way is up; its z axis is used."]
    if by_gravity is None or (by_tf is not None and _between_rad(by_tf, by_gravity) <= _GRAVITY_APART_RAD):
        assert by_tf is not None
        return by_tf, []
    if by_tf is None:
        tilt = np.degrees(_between_rad(_UP, by_gravity))
        how = "which is its z axis" if tilt < np.degrees(_GRAVITY_APART_RAD) else f"{tilt:.0f}° off its z axis"
        return by_gravity, [f"{roles.gyro}: its mount is not in tf; up is where gravity says, {how}."]
    apart = np.degrees(_between_rad(by_tf, by_gravity))
    warning = f"{roles.gyro}: tf and gravity disagree by {apart:.0f}° on which way is up; gravity is used."
    return by_gravity, [warning]


def _between_rad(a: FloatArray, b: FloatArray) -> float:
    return float(np.arccos(np.clip(a @ b, -1, 1)))


def _truth(
    bag: OpenBag, roles: Roles, robot: BagRobot, clocks: Mapping[str, TopicClock], calibration: Calibration
) -> tuple[Trajectory | None, list[str]]:
    """The true poses of the topic that the user chose, with warnings. Raises RecordingError where it has no pose."""
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
        decoded = bag.decode(message)
        stamped: Any = decoded if part is None else part.found_in(decoded)
        child = str(getattr(stamped, "child_frame_id", "")).lstrip("/")
        if hasattr(stamped, "transform"):
            pose = motion_of(stamped.transform.translation, stamped.transform.rotation)
        else:
            posed = getattr(stamped.pose, "pose", stamped.pose)
            pose = motion_of(posed.position, posed.orientation)
        if pose is None or (stamps_s and stamp_s <= stamps_s[-1]):
            unusable += 1
            continue
        stamps_s.append(stamp_s)
        poses.append(pose)
    if not poses:
        raise RecordingError(f"{name} holds no pose", path=bag.path, fix="choose another --topic truth=…")
    warnings = [f"{name}: {unusable:,} messages hold no pose, or came twice, and were left out."] if unusable else []
    body, frame = "base", robot.base
    if roles.color is not None and calibration.T_base_camera is None:
        body, frame = "camera", camera_frame(roles)
    T_child_body = robot.transforms.between(child, frame) if child and frame else None
    if T_child_body is None and child != frame:
        of = f"of {child!r}, which tf does not join with it" if child else "without a child frame"
        warnings.append(f"{name}: its poses, {of}, are used as those of the {body}.")
    T = np.stack(poses) if T_child_body is None else se3.compose(np.stack(poses), T_child_body)
    return Trajectory(np.array(stamps_s), T, body=body), warnings


# Largest deviation of a quaternion's norm from 1.
_LONGEST_QUATERNION_OFF = 0.1
# A humanoid has 200 frames. 400 messages of up to 200 transforms each are read.
_MOST_FRAMES, _MOST_READ, _MOST_WARNINGS = 1000, 100_000, 20
# Messages of /tf that are read for mounts: 4 to 8 s of a robot. A mount does not appear later.
_TF_MESSAGES = 400
# By how much two transforms of one mount may differ; beyond, it moves, or tf contradicts itself.
_TF_APART_M, _TF_APART_RAD = 0.002, 0.002


class Transforms:
    """The tree of frames of a bag, from /tf_static and /tf. Of contradicting transforms, the first is used.

    Attributes:
        warnings: one sentence for each contradiction.
        moving: (parent, child) of transforms that change.
    """

    def __init__(self) -> None:
        self.warnings: list[str] = []
        self.moving: set[tuple[str, str]] = set()
        self._T: dict[tuple[str, str], FloatArray] = {}
        self._static: set[tuple[str, str]] = set()
        self._parents: dict[str, str] = {}
        self._left = _MOST_READ

    def __bool__(self) -> bool:
        return bool(self._T)

    def add(self, transforms: Sequence[Any], is_static: bool) -> bool:
        """Add the transforms of a TFMessage. Returns whether there is room for more."""
        self._left -= len(transforms)
        if self._left < 0 or len(self._T) > _MOST_FRAMES:
            self._warn(f"tf has more than {_MOST_FRAMES:,} frames or {_MOST_READ:,} transforms; others are left out.")
            return False
        for stamped in transforms:
            if len(self._T) > _MOST_FRAMES:
                return False
            pair = parent, child = stamped.header.frame_id.lstrip("/"), stamped.child_frame_id.lstrip("/")
            T = motion_of(stamped.transform.translation, stamped.transform.rotation)
            if T is None:
                self._warn(f"tf: the transform from {parent} to {child} is no rigid motion; it is left out.")
            elif pair not in self._T:
                first = self._parents.setdefault(child, parent)
                if first != parent:
                    self._warn(f"tf contradicts itself: {child} has the parents {first} and {parent}; {first} is used.")
                self._T[pair] = T
            else:
                apart = se3.compose(se3.invert(self._T[pair]), T)
                is_moved = np.linalg.norm(apart[:3, 3]) > _TF_APART_M or so3.angle(apart[:3, :3]) > _TF_APART_RAD
                if is_moved and (is_static or pair in self._static):
                    between = f"two static transforms lead from {parent} to {child}"
                    self._warn(f"tf contradicts itself: {between}; the first is used.")
                elif is_moved:
                    self.moving.add(pair)
            if is_static:
                self._static.add(pair)
        return True

    def between(self, a: str, b: str) -> FloatArray | None:
        """T_a_b (4, 4); None where no chain of constant transforms connects the two frames."""
        reached, todo = {a: np.eye(4)}, [a]
        while todo:
            frame = todo.pop()
            for (parent, child), T in self._T.items():
                if (parent, child) in self.moving:
                    continue
                if parent == frame and child not in reached:
                    reached[child] = se3.compose(reached[frame], T)
                    todo.append(child)
                elif child == frame and parent not in reached:
                    reached[parent] = se3.compose(reached[frame], se3.invert(T))
                    todo.append(parent)
        return reached.get(b)

    def _warn(self, sentence: str) -> None:
        if sentence not in self.warnings and len(self.warnings) < _MOST_WARNINGS:
            self.warnings.append(sentence)


def motion_of(t: Any, q: Any) -> FloatArray | None:
    """T (4, 4) of a message's translation and quaternion, or None where they are not finite or not a rotation."""
    if not are_measured((t.x, t.y, t.z, q.x, q.y, q.z, q.w)):
        return None
    quaternion = np.array([q.x, q.y, q.z, q.w])
    if abs(np.linalg.norm(quaternion) - 1) > _LONGEST_QUATERNION_OFF:
        return None
    return se3.from_quaternion([t.x, t.y, t.z], quaternion / np.linalg.norm(quaternion))


# Bags of the RealSense SDK
#
# A stream's topics begin with its name, such as /device_0/sensor_1/Color_0: image/data, info/camera_info, and tf/0, the
# transform into its frame from that of stream group 0. In newer versions an image whose frame is "1" ends with four
# bytes more: metres per unit of depth.

_IMAGE = re.compile(r"(/device_\d+/sensor_\d+/\w+_\d+)/image/data")
_TRANSFORM = "geometry_msgs/msg/Transform"
# Valid metres per unit: from a tenth of a micrometre to a metre.
_LEAST_UNIT_M, _LARGEST_UNIT_M = 1e-7, 1.0


def depth_units_m(bag: OpenBag, topic: str) -> float | None:
    """Metres per unit of depth, from a topic's first image; None where the SDK did not write it, or no valid unit."""
    if not (bag.is_ros1 and _IMAGE.fullmatch(topic)):
        return None
    data = bag.first(topic)[0].data
    units_m = float(struct.unpack("<f", data[-4:])[0]) if bag.has_units(topic, data) else 0.0
    return units_m if _LEAST_UNIT_M <= units_m <= _LARGEST_UNIT_M else None


def joined(bag: OpenBag, color: str, depth: str) -> FloatArray | None:
    """T_color_depth (4, 4) of two image topics; None where the SDK wrote neither them nor transforms."""
    into: list[dict[str, FloatArray]] = []
    for name in (color, depth):
        stream = _IMAGE.fullmatch(name)
        if stream is None:
            return None
        begin, found = f"{stream[1]}/tf/", {}
        for topic in bag.topics:
            if topic.name.startswith(begin) and topic.type == _TRANSFORM and topic.count:
                message = bag.decode(bag.first(topic.name)[0])
                T_stream_group = motion_of(message.translation, message.rotation)
                if T_stream_group is not None:
                    found[topic.name.removeprefix(begin)] = T_stream_group
        into.append(found)
    groups = sorted(into[0].keys() & into[1].keys())
    return se3.compose(into[0][groups[0]], se3.invert(into[1][groups[0]])) if groups else None
