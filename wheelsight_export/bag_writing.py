"""Bags written by rosbags: `LiveBag` records live sensors into MCAP, `new_bag` writes a whole bag. `RobotTopics`
turns events into topics, `Messages` numbers into messages.
"""

from __future__ import annotations

import math
import os
import shutil
import struct
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import cv2
import numpy as np
import yaml

from wheelsight.core.calibration import Calibration, calibration_fields
from wheelsight.core.checks import check_event, check_images
from wheelsight.core.depth_errors import DepthError
from wheelsight.core.errors import ArgumentError, CalibrationError, ConfigError, OutputError, RecordingError
from wheelsight.core.files import StrPath, check_name, output_error
from wheelsight.core.geometry import ByteArray, FloatArray, PinholeCamera, se3, so3
from wheelsight.core.geometry.arrays import UInt16Array
from wheelsight.core.messages import (
    AngularVelocity,
    Event,
    HolonomicReading,
    OdometryReading,
    RgbdFrame,
    SkippedFrame,
    WheelSpeeds,
    WheelTicks,
    YawRate,
)
from wheelsight.core.runtime import needed
from wheelsight.core.stamps import StampCheck
from wheelsight.io.recordings.bags.topics import CALIBRATION, WHEEL_ODOMETRY
from wheelsight.io.recordings.images import FAST_PNG, JPEG_QUALITY
from wheelsight.io.recordings.native import FrameClock
from wheelsight_export.topics import (
    BASE,
    COLOR,
    COLOR_FRAME,
    DEPTH,
    DEPTH_FRAME,
    IMU,
    JOINT_STATES,
    LINK,
    REGISTERED,
    TF_STATIC,
)

THREAD = "wheelsight-bag"


@dataclass(frozen=True, slots=True, eq=False)
class EncodedFrame:
    """The messages of a frame, before they are written.

    Attributes:
        stamp_s: of the frame.
        messages: topic, type and bytes of each.
        size_bytes: of all messages.
    """

    stamp_s: float
    messages: tuple[tuple[str, str, bytes], ...]
    size_bytes: int


class LiveBag:
    """Writes events of live sensors into an MCAP file. Where the program dies, at most `flush_s` seconds are lost.

    Several threads may call `write_frame` at once, and another one `add`.

    Args:
        path: of the file, which must not exist.
        calibration: of the robot; the bag stores it.
        images: the encoding of images; see `RobotTopics`.
        flush_s: seconds between flushes to the system.

    Attributes:
        folder: of the file.
        frames, readings: the numbers so far.

    Raises:
        CalibrationError: there is none; readers of ticks need it.
        ConfigError: rosbags is not installed, or the name does not end in .mcap.
        OutputError: the file cannot be created.
    """

    def __init__(self, path: StrPath, calibration: Calibration | None, images: ImageForm, flush_s: float) -> None:
        self._path = Path(path)
        if calibration is None:
            raise CalibrationError("is missing", path=self._path, fix="give the robot's by --calibration")
        self.folder = self._path.parent
        self.frames = self.readings = 0
        self._calibration = calibration
        self._stamps, self._last_stamp_s = StampCheck(), dict[str, float]()
        self._received_s = -np.inf
        self._opened = ExitStack()
        self._bag = self._opened.enter_context(growing_bag(self._path))
        self._robot = RobotTopics(self._bag.make, calibration, images)
        self._lock, self._is_over = threading.Lock(), threading.Event()
        self._problem: OutputError | None = None

        def flush() -> None:
            """The thread: flush at intervals."""
            while not self._is_over.wait(flush_s):
                with suppress(OutputError), self._lock, self._guarded():
                    self._bag.flush()

        self._thread = threading.Thread(target=flush, name=THREAD, daemon=True)
        self._thread.start()

    @property
    def last_stamp_s(self) -> float:
        """The newest of all sensors; -∞ before the first."""
        return max(self._last_stamp_s.values(), default=-np.inf)

    def check(self, event: Event) -> None:
        """Raise ArgumentError or RecordingError where the event cannot be stored without loss."""
        check_event(event, finite=True)
        if isinstance(event, RgbdFrame):
            check_images(event, self._calibration)
        self._stamps.check(event)
        name = type(event).__name__
        before_s = self._last_stamp_s.get(name, -np.inf)
        if not before_s < event.stamp_s:
            raise RecordingError(f"stamp {event.stamp_s:.6f} does not come after {before_s:.6f}", path=self._path)
        self._last_stamp_s[name] = event.stamp_s

    def add(self, event: Event) -> None:
        """Write one event. Skipped frames are ignored. Raises as `check`, and OutputError."""
        if isinstance(event, SkippedFrame):
            return
        self.check(event)
        if isinstance(event, RgbdFrame):
            self.list_frame(self.write_frame(event))
            return
        self._write([self._encoded(sent) for sent in self._robot.of_event(event)], event.stamp_s)
        self.readings += isinstance(event, WheelTicks)

    def add_angular_velocity(self, turn: AngularVelocity) -> None:
        """Write a reading of the camera's gyroscope as the base's yaw rate. Raises as `add`."""
        T_base_camera = self._calibration.T_base_camera
        if T_base_camera is None:
            problem = "its gyroscope does not give the base's yaw rate: the camera's mount is unknown"
            raise RecordingError(problem, path=self._path, fix="wheelsight calibrate base finds T_base_camera")
        self.add(turn.yaw_rate(np.asarray(T_base_camera)))

    def write_frame(self, frame: RgbdFrame, infrared: UInt16Array | None = None) -> EncodedFrame:
        """Encode the images of a checked frame, without infrared."""
        messages = tuple(self._encoded(sent) for sent in self._robot.of_frame(frame))
        return EncodedFrame(frame.stamp_s, messages, sum(len(data) for _, _, data in messages))

    def list_frame(self, written: EncodedFrame, clock: FrameClock | None = None) -> None:
        """Append the images of a frame. Its clock is not stored. Raises OutputError."""
        self._write(written.messages, written.stamp_s)
        self.frames += 1

    def close(self) -> None:
        """Add the index, without which reading is slower, and close the file. Raises OutputError."""
        self._is_over.set()
        self._thread.join()
        opened, cause = self._opened.pop_all(), None if self._problem is None else self._problem.__cause__
        if cause is None:
            opened.close()
            return
        with suppress(OutputError):  # raised when it happened
            opened.__exit__(type(cause), cause, cause.__traceback__)

    def _encoded(self, sent: Sent) -> tuple[str, str, bytes]:
        return sent.topic, sent.message.__msgtype__, self._bag.make.bytes_of(sent.message)

    def _write(self, messages: Iterable[tuple[str, str, bytes]], stamp_s: float) -> None:
        """Append messages. Their receipt follows the order of writing, in which a file without an index is read."""
        with self._lock, self._guarded():
            if self._received_s == -np.inf:
                self._received_s = stamp_s
                for sent in self._robot.mounts(stamp_s):
                    self._bag.add_bytes(*self._encoded(sent), stamp_s, is_latched=True)
            self._received_s = max(self._received_s, stamp_s)
            for topic, type_, data in messages:
                self._bag.add_bytes(topic, type_, data, self._received_s)

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Raise an OSError of the block as OutputError, also in all later blocks: the file may end in half a record."""
        if self._problem is not None:
            raise self._problem
        try:
            yield
        except OSError as error:
            problem = output_error(error, self._path)
            problem.__cause__ = error
            self._problem = problem
            raise problem from error


WRITTEN = (".mcap", ".bag")
_FOREVER = (9223372036, 854775807)  # rmw's "infinite", in seconds and nanoseconds


class BagFile:
    """A bag that is open to be written.

    Attributes:
        make: makes its messages.
        count: the number of messages so far.
        size_bytes: of these messages.
    """

    def __init__(self, writer: Any, make: Messages) -> None:
        self.make, self.count, self.size_bytes = make, 0, 0
        self._writer = writer
        self._connections: dict[str, Any] = {}

    def add(self, topic: str, message: Any, stamp_s: float, *, is_latched: bool = False) -> None:
        """Append a message, received at `stamp_s`. Later subscribers get a latched message too.

        Raises OSError where it cannot be written.
        """
        self.add_bytes(topic, message.__msgtype__, self.make.bytes_of(message), stamp_s, is_latched=is_latched)

    def add_bytes(self, topic: str, type_: str, data: bytes, stamp_s: float, *, is_latched: bool = False) -> None:
        """Like `add`, for a serialized message."""
        connection = self._connections.get(topic)
        if connection is None:
            how: dict[str, Any] = {}
            if is_latched and self.make.is_ros1:
                how["latching"] = 1
            elif is_latched:
                ros = needed("rosbags.interfaces")
                forever = ros.QosTime(*_FOREVER)
                keeps = (ros.QosHistory.KEEP_LAST, 1, ros.QosReliability.RELIABLE, ros.QosDurability.TRANSIENT_LOCAL)
                lives = (forever, forever, ros.QosLiveliness.AUTOMATIC, forever, False)
                how["offered_qos_profiles"] = [ros.Qos(*keeps, *lives)]
            connection = self._connections[topic] = self._writer.add_connection(
                topic, type_, typestore=self.make.types, **how
            )
        self._writer.write(connection, nanoseconds(stamp_s), data)
        self.count += 1
        self.size_bytes += len(data)

    def flush(self) -> None:
        """Write all added messages to the system, so that they survive the end of this program. MCAP only.

        Readers find them without the index at the end of the file.
        """
        storage = self._writer.storage
        if storage.chunk.msgs:
            storage.close_chunk()
        storage.bio.flush()


@contextmanager
def new_bag(path: StrPath) -> Iterator[BagFile]:
    """A new bag for the block: MCAP of ROS 2, or a .bag of ROS 1, by its suffix.

    The file exists once the block ends without an error; otherwise nothing remains.

    Raises:
        ConfigError: the suffix is unknown, or rosbags is not installed.
        OutputError: it cannot be written, or the disk is full.
    """
    path = Path(path)
    check_bag_name(path)
    try:
        with TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent, ignore_cleanup_errors=True) as temporary:
            folder = Path(temporary)
            made = folder / f"bag{path.suffix.lower()}"
            with _writer(made, folder) as writer:
                yield BagFile(writer, Messages(made.suffix == ".bag"))
            written = made if made.is_file() else folder / "bag" / "bag.mcap"
            with written.open("rb") as stream:
                os.fsync(stream.fileno())
            written.replace(path)
    except OSError as error:
        raise output_error(error, path) from error


@contextmanager
def growing_bag(path: StrPath) -> Iterator[BagFile]:
    """A new MCAP file of ROS 2 that exists from the beginning; see `BagFile.flush`.

    Flushed messages survive any end of the program. The end of the block adds the index. Raises as `new_bag`.
    """
    path = Path(path)
    check_growing_name(path)
    try:
        with TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent, ignore_cleanup_errors=True) as temporary:
            folder = Path(temporary)
            writer = _writer(folder / "bag.mcap", folder)
            writer.open()
            written = folder / "bag" / "bag.mcap"
            with suppress(PermissionError):  # Windows moves closed files only
                written.replace(path)
                shutil.rmtree(folder)  # so that it does not remain where the program is killed
            try:
                yield BagFile(writer, Messages(is_ros1=False))
            except OSError:  # no reader gets past half a record: write nothing after it
                with suppress(Exception):
                    writer.abort()
                raise
            finally:
                written.parent.mkdir(parents=True, exist_ok=True)  # for metadata.yaml, which is discarded
                if writer.storage is not None:
                    writer.close()
                if written.is_file():
                    written.replace(path)
    except OSError as error:
        raise output_error(error, path) from error


def check_bag_name(path: Path) -> None:
    """Raise ConfigError or OutputError for a name that is not valid for a bag."""
    if path.suffix.lower() not in WRITTEN:
        raise ConfigError(
            f"{str(path)!r} does not end in .mcap or .bag", fix="MCAP for ROS 2 and Foxglove, .bag for ROS 1"
        )
    check_name(path)


def check_growing_name(path: Path) -> None:
    """Raise as `check_bag_name`, and ConfigError for a format that needs its index."""
    check_bag_name(path)
    if path.suffix.lower() != ".mcap":
        raise ConfigError(
            f"{str(path)!r} cannot grow: a ROS 1 bag is not readable without its index", fix="name it .mcap"
        )


def _writer(made: Path, folder: Path) -> Any:
    """The rosbags writer for a suffix, not open yet."""
    if made.suffix == ".bag":
        return needed("rosbags.rosbag1").Writer(made)
    rosbag2 = needed("rosbags.rosbag2")
    return rosbag2.Writer(folder / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)


ImageForm = Literal["raw", "png", "jpeg"]
JOINTS = ("left_wheel_joint", "right_wheel_joint")
# From an optical frame (x right, y down, z forward) to a link frame of REP 103 (x forward, y left, z up).
T_LINK_OPTICAL: FloatArray = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
T_LINK_OPTICAL.setflags(write=False)
# Header of compressed_depth_image_transport: the format, always 1, and two parameters that integer depth ignores.
_COMPRESSED_DEPTH = struct.pack("<iff", 1, 0.0, 0.0)
_MILLIMETRES, _DEEPEST = 1000.0, np.iinfo(np.uint16).max


@dataclass(frozen=True, slots=True, eq=False)
class Sent:
    """A message with its topic and time of receipt.

    Attributes:
        stamp_s: time of receipt, seconds.
        topic: its name.
        message: the message.
        is_latched: whether later subscribers get it too.
    """

    stamp_s: float
    topic: str
    message: Any
    is_latched: bool = False


class RobotTopics:
    """Messages of one robot's sensors.

    Args:
        make: makes messages.
        calibration: of the robot; None where it is unknown, without images and joints.
        images: the encoding of images; None for no images. "raw" stores colour and depth without loss; "png" stores
            colour without loss and depth in millimetres; "jpeg" stores colour with quality 95 and depth in millimetres.
    """

    def __init__(self, make: Messages, calibration: Calibration | None, images: ImageForm | None) -> None:
        self.make, self._calibration, self._images = make, calibration, images
        self._angles_rad = [0.0, 0.0]
        self._last: WheelSpeeds | None = None

    def mounts(self, stamp_s: float) -> Iterator[Sent]:
        """/tf_static, and the calibration as text, since no ROS message has fields for wheels and noise."""
        calibration = self._calibration
        if calibration is None:
            return
        joined = mounts_of(calibration)
        if joined:
            yield Sent(stamp_s, TF_STATIC, self.make.transforms(stamp_s, joined), is_latched=True)
        # Depth is written as it was corrected when it was read; it must not be corrected again.
        fields = calibration_fields(replace(calibration, depth_error=DepthError()))
        text = yaml.safe_dump(fields, sort_keys=False, default_flow_style=None, width=100)
        yield Sent(stamp_s, CALIBRATION, self.make.text(text), is_latched=True)

    def of_event(self, event: Event) -> Iterator[Sent]:
        """The messages of an event; none where the calibration lacks what they need."""
        if isinstance(event, RgbdFrame):
            yield from self.of_frame(event)
        elif isinstance(event, YawRate):
            turning = self.make.turning(event.stamp_s, BASE, event.yaw_rate_rad_s)
            yield Sent(event.stamp_s, IMU, turning)
        elif isinstance(event, HolonomicReading):
            yield from self._of_holonomic(event)
        elif isinstance(event, WheelTicks | WheelSpeeds):
            yield from self._of_wheels(event)

    def of_frame(self, frame: RgbdFrame) -> Iterator[Sent]:
        """Both images and CameraInfo of both; depth with the stamp that it was taken at. Raises RecordingError."""
        calibration = self._calibration
        if self._images is None or calibration is None or calibration.color is None:
            return
        is_registered, at_s = calibration.is_registered, frame.stamp_s
        depth_topic, depth_frame = (REGISTERED, COLOR_FRAME) if is_registered else (DEPTH, DEPTH_FRAME)
        late_s = at_s + frame.depth_late_s
        color_camera, depth_camera = calibration.cameras
        yield Sent(at_s, f"{COLOR}/camera_info", self.make.camera(at_s, COLOR_FRAME, color_camera))
        yield Sent(late_s, f"{depth_topic}/camera_info", self.make.camera(late_s, depth_frame, depth_camera))
        if self._images == "raw":
            depth_m = np.where(frame.depth_m > 0, frame.depth_m, np.float32(np.nan))  # REP 118
            color = self.make.image(at_s, COLOR_FRAME, "rgb8", frame.color)
            depth = self.make.image(late_s, depth_frame, "32FC1", depth_m.astype("<f4"))
            yield Sent(at_s, f"{COLOR}/image_raw", color)
            yield Sent(late_s, f"{depth_topic}/image_raw", depth)
            return
        form, flags = ".png", FAST_PNG
        if self._images == "jpeg":
            form, flags = ".jpg", (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
        data = _encoded(form, cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR), flags)
        color = self.make.compressed(at_s, COLOR_FRAME, f"rgb8; {self._images} compressed bgr8", data)
        mm = np.rint(_MILLIMETRES * frame.depth_m)
        data = _encoded(".png", np.where(mm > _DEEPEST, 0, mm).astype(np.uint16), FAST_PNG)
        data = np.concatenate([np.frombuffer(_COMPRESSED_DEPTH, np.uint8), data])
        depth = self.make.compressed(late_s, depth_frame, "16UC1; compressedDepth png", data)
        yield Sent(at_s, f"{COLOR}/image_raw/compressed", color)
        yield Sent(late_s, f"{depth_topic}/image_raw/compressedDepth", depth)

    def _of_wheels(self, event: WheelTicks | WheelSpeeds) -> Iterator[Sent]:
        """JointState: the angles of ticks, or speeds and their integral. A speed holds until the next one."""
        if self._calibration is None or self._calibration.wheels is None:
            return
        speeds: list[float] = []
        if isinstance(event, WheelTicks):
            a_tick = 2 * math.pi / self._calibration.wheels.ticks_per_turn
            self._angles_rad = [event.left * a_tick, event.right * a_tick]
        else:
            if self._last is not None:
                lasted_s = event.stamp_s - self._last.stamp_s
                turned = (self._last.left_rad_s * lasted_s, self._last.right_rad_s * lasted_s)
                self._angles_rad = [angle + more for angle, more in zip(self._angles_rad, turned, strict=True)]
            self._last = event
            speeds = [event.left_rad_s, event.right_rad_s]
        joints = self.make.joints(event.stamp_s, JOINTS, self._angles_rad, speeds)
        yield Sent(event.stamp_s, JOINT_STATES, joints)

    def _of_holonomic(self, event: HolonomicReading) -> Iterator[Sent]:
        """JointState of all wheels, or the pose by the base's own odometry."""
        wheels = None if self._calibration is None else self._calibration.holonomic
        if isinstance(event, OdometryReading):
            T = se3.from_plane(event.x_m, event.y_m, event.yaw_rad)
            message = self.make.odometry(event.stamp_s, ("wheel_odom", BASE), T, np.zeros(6), None)
            yield Sent(event.stamp_s, WHEEL_ODOMETRY, message)
        elif wheels is not None and wheels.ticks_per_turn is not None:
            angles = [2 * math.pi / wheels.ticks_per_turn * count for count in event.counts]
            yield Sent(event.stamp_s, JOINT_STATES, self.make.joints(event.stamp_s, wheels.wheel_names, angles, []))


def mounts_of(calibration: Calibration) -> list[tuple[str, str, FloatArray]]:
    """Parent, child and T_parent_child of a robot's static frames, named as in REP 103 and by drivers.

    `camera_link` is at the depth camera, x forward; it is the parent of the optical frames.
    """
    if calibration.color is None:
        return []
    joined: list[tuple[str, str, FloatArray]] = []
    if calibration.T_base_camera is not None:
        joined.append((BASE, LINK, se3.compose(calibration.T_base_camera, se3.invert(T_LINK_OPTICAL))))
    joined.append((LINK, DEPTH_FRAME, T_LINK_OPTICAL))
    T_link_color = se3.compose(T_LINK_OPTICAL, se3.invert(calibration.T_color_camera))
    joined.append((LINK, COLOR_FRAME, T_link_color))
    return joined


def _encoded(kind: str, image: np.ndarray, flags: tuple[int, ...]) -> ByteArray:
    is_encoded, code = cv2.imencode(kind, image, flags)
    if not is_encoded:
        raise RecordingError(f"the image cannot be encoded as {kind[1:].upper()}")
    return np.asarray(code, np.uint8).ravel()


_TF = "tf2_msgs/msg/TFMessage"
# sensor_msgs/PointField
_FLOAT32, _POINT_STEP = 7, 16
# visualization_msgs/Marker: types and an action; height of a person's cylinder and width of a loop's line.
_CYLINDER, _LINE_LIST, _DELETE_ALL = 3, 5, 3
_PERSON_M, _LOOP_M = 1.7, 0.03
# Least and largest range of a scan, in which depth cameras show obstacles.
_SCAN_M = (0.1, 10.0)
# The latest time: seconds have 32 bits, unsigned in ROS 1 and signed in ROS 2.
_LAST_S = {True: 2**32 - 1, False: 2**31 - 1}


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One line of a DiagnosticArray.

    Attributes:
        level: 0 OK, 1 a warning, 2 an error.
        name: of the component.
        message: in a few words.
        values: names and values that explain it.
    """

    level: int
    name: str
    message: str
    values: tuple[tuple[str, str], ...] = ()


@cache
def _types(is_ros1: bool) -> Any:
    """The type store, which compiles each type once."""
    typesys = needed("rosbags.typesys")
    types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_ros1 else typesys.Stores.ROS2_JAZZY)
    if is_ros1:  # its package tf2_msgs is not in the store
        definition = "geometry_msgs/TransformStamped[] transforms"
        types.register(typesys.get_types_from_msg(definition, _TF))
    return types


class Messages:
    """Makes messages of ROS 1 (Noetic) or ROS 2 (Jazzy); those types are the same in all releases since.

    Raises ConfigError where rosbags is not installed.
    """

    def __init__(self, is_ros1: bool) -> None:
        needed("rosbags.typesys")
        self.is_ros1 = is_ros1
        self.types = _types(is_ros1)

    def bytes_of(self, message: Any) -> bytes:
        """The serialized message."""
        write = self.types.serialize_ros1 if self.is_ros1 else self.types.serialize_cdr
        return bytes(write(message, message.__msgtype__))

    def time(self, stamp_s: float) -> Any:
        """Time. Raises ArgumentError for a time that ROS cannot represent."""
        ns = nanoseconds(stamp_s)
        if not 0 <= ns // 10**9 <= _LAST_S[self.is_ros1]:
            fix = "stamps are seconds since 1970, or since the recording began"
            raise ArgumentError(f"{stamp_s:.3f} s is not a time of ROS", fix=fix)
        return self._make("builtin_interfaces/msg/Time", ns // 10**9, ns % 10**9)

    def header(self, stamp_s: float, frame: str) -> Any:
        """Header. The sequence number of ROS 1 is 0, since its recorder does not keep it either."""
        return self._make("std_msgs/msg/Header", *((0,) if self.is_ros1 else ()), self.time(stamp_s), frame)

    def transforms(self, stamp_s: float, joined: Iterable[tuple[str, str, FloatArray]]) -> Any:
        """TFMessage of parent, child and T_parent_child (4, 4)."""
        stamped = [
            self._make(
                "geometry_msgs/msg/TransformStamped",
                self.header(stamp_s, parent),
                child,
                self._make("geometry_msgs/msg/Transform", self._vector(T[:3, 3]), self._quaternion(T)),
            )
            for parent, child, T in joined
        ]
        return self._make(_TF, stamped)

    def odometry(
        self, stamp_s: float, frames: tuple[str, str], T: FloatArray, twist: FloatArray, covariance: FloatArray | None
    ) -> Any:
        """Odometry.

        Args:
            stamp_s: seconds.
            frames: the parent and the child.
            T: (4, 4) T_parent_child.
            twist: (6,) v and ω of the child in its own axes.
            covariance: (6, 6) of the pose in the convention of ROS; None writes zeros.
        """
        known = np.zeros(36) if covariance is None else _flat(covariance)
        posed = self._make("geometry_msgs/msg/PoseWithCovariance", self.pose(T), known)
        moving = self._make("geometry_msgs/msg/Twist", self._vector(twist[:3]), self._vector(twist[3:]))
        turned = self._make("geometry_msgs/msg/TwistWithCovariance", moving, np.zeros(36))
        return self._make("nav_msgs/msg/Odometry", self.header(stamp_s, frames[0]), frames[1], posed, turned)

    def path(self, stamp_s: float, frame: str, stamps_s: FloatArray, T: FloatArray) -> Any:
        """Path of poses (N, 4, 4) at stamps (N,)."""
        poses = [
            self._make("geometry_msgs/msg/PoseStamped", self.header(float(at_s), frame), self.pose(pose))
            for at_s, pose in zip(stamps_s, T, strict=True)
        ]
        return self._make("nav_msgs/msg/Path", self.header(stamp_s, frame), poses)

    def diagnostics(self, stamp_s: float, diagnoses: Sequence[Diagnosis]) -> Any:
        """DiagnosticArray."""
        pair = self.types.types["diagnostic_msgs/msg/KeyValue"]
        status = [
            self._make(
                "diagnostic_msgs/msg/DiagnosticStatus",
                one.level,
                one.name,
                one.message,
                "",
                [pair(name, value) for name, value in one.values],
            )
            for one in diagnoses
        ]
        return self._make("diagnostic_msgs/msg/DiagnosticArray", self.header(stamp_s, ""), status)

    def occupancy(self, stamp_s: float, frame: str, cells: np.ndarray, resolution_m: float, T: FloatArray) -> Any:
        """OccupancyGrid of cells (H, W) int8, row 0 at the least y, and T (4, 4) of the corner of cell (0, 0)."""
        height, width = cells.shape
        about = (self.time(stamp_s), resolution_m, width, height, self.pose(T))
        info = self._make("nav_msgs/msg/MapMetaData", *about)
        return self._make("nav_msgs/msg/OccupancyGrid", self.header(stamp_s, frame), info, cells.ravel())

    def points(self, stamp_s: float, frame: str, p: FloatArray, colors: ByteArray) -> Any:
        """PointCloud2 of points (N, 3) in metres and their colours (N, 3), packed in `rgb` as in PCL."""
        table = np.zeros(len(p), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
        for axis in range(3):
            table["xyz"[axis]] = p[:, axis]
        red, green, blue = colors.astype(np.uint32).T
        table["rgb"] = red << 16 | green << 8 | blue
        fields = [
            self._make("sensor_msgs/msg/PointField", name, 4 * place, _FLOAT32, 1)
            for place, name in enumerate(table.dtype.names or ())
        ]
        rows = (1, len(p), fields, False, _POINT_STEP, _POINT_STEP * len(p), table.view(np.uint8), True)
        return self._make("sensor_msgs/msg/PointCloud2", self.header(stamp_s, frame), *rows)

    def image(self, stamp_s: float, frame: str, encoding: str, pixels: np.ndarray) -> Any:
        """Image of an array (H, W) or (H, W, channels), little-endian."""
        height, width = pixels.shape[:2]
        data = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
        about = (height, width, encoding, 0, data.size // height, data)
        return self._make("sensor_msgs/msg/Image", self.header(stamp_s, frame), *about)

    def compressed(self, stamp_s: float, frame: str, format_: str, data: ByteArray) -> Any:
        """CompressedImage of encoded bytes."""
        return self._make("sensor_msgs/msg/CompressedImage", self.header(stamp_s, frame), format_, data)

    def camera(self, stamp_s: float, frame: str, camera: PinholeCamera) -> Any:
        """CameraInfo of an image that was not rectified."""
        P = np.column_stack([camera.K, np.zeros(3)])
        region = self._make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        sizes = (self.header(stamp_s, frame), camera.height, camera.width, "plumb_bob")
        matrices = (np.array(camera.distortion), _flat(camera.K), np.eye(3).ravel(), _flat(P))
        return self._make("sensor_msgs/msg/CameraInfo", *sizes, *matrices, 0, 0, region)

    def joints(self, stamp_s: float, names: Sequence[str], angles_rad: Sequence[float], rad_s: Sequence[float]) -> Any:
        """JointState."""
        values = (np.array(angles_rad, float), np.array(rad_s, float), np.zeros(0))
        return self._make("sensor_msgs/msg/JointState", self.header(stamp_s, ""), list(names), *values)

    def turning(self, stamp_s: float, frame: str, yaw_rate_rad_s: float) -> Any:
        """Imu with a rate about z; orientation and acceleration are marked as unknown."""
        unknown = np.array([-1.0, *np.zeros(8)])
        still = self._make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        measured = (self._vector(np.array([0, 0, yaw_rate_rad_s])), np.zeros(9), self._vector(np.zeros(3)), unknown)
        return self._make("sensor_msgs/msg/Imu", self.header(stamp_s, frame), still, unknown, *measured)

    def clock(self, stamp_s: float) -> Any:
        """Clock of simulated time."""
        return self._make("rosgraph_msgs/msg/Clock", self.time(stamp_s))

    def posed(self, stamp_s: float, frame: str, T: FloatArray, covariance: FloatArray | None) -> Any:
        """PoseWithCovarianceStamped of T (4, 4), covariance (6, 6) in the convention of ROS; None writes zeros."""
        known = np.zeros(36) if covariance is None else _flat(covariance)
        pose = self._make("geometry_msgs/msg/PoseWithCovariance", self.pose(T), known)
        return self._make("geometry_msgs/msg/PoseWithCovarianceStamped", self.header(stamp_s, frame), pose)

    def scan(self, stamp_s: float, frame: str, first_rad: float, step_rad: float, ranges_m: FloatArray) -> Any:
        """LaserScan of ranges (N,): infinity where nothing is near, NaN where nothing was seen."""
        count = len(ranges_m)
        angles = (first_rad, first_rad + (count - 1) * step_rad, step_rad, 0.0, 0.0, *_SCAN_M)
        ranges, none = ranges_m.astype(np.float32), np.zeros(0, np.float32)
        return self._make("sensor_msgs/msg/LaserScan", self.header(stamp_s, frame), *angles, ranges, none)

    def markers(self, stamp_s: float, frame: str, discs: FloatArray, lines: FloatArray) -> Any:
        """MarkerArray: cylinders of x, y, radius (N, 3), and lines (M, 2, 3). It replaces all that was shown."""
        none, green, orange = (
            self._make("std_msgs/msg/ColorRGBA", *(part / 255 for part in colour))
            for colour in ((0, 0, 0, 0), (0, 158, 115, 255), (230, 159, 0, 200))
        )
        forever = self._make("builtin_interfaces/msg/Duration", 0, 0)
        mesh = self._make("visualization_msgs/msg/MeshFile", "", np.zeros(0, np.uint8))
        texture = self.compressed(0.0, "", "", np.zeros(0, np.uint8))

        def marker(space: str, number: int, how: tuple[int, int], T: FloatArray, size: FloatArray, look: Any) -> Any:
            color, points = look
            about = (self.header(stamp_s, frame), space, number, *how, self.pose(T), self._vector(size))
            rest: tuple[Any, ...] = (color, forever, False, points, [], "", texture, [], "", "", mesh, False)
            return self._make("visualization_msgs/msg/Marker", *about, *rest)

        made = [marker("", 0, (0, _DELETE_ALL), np.eye(4), np.zeros(3), (none, []))]
        for number, (x, y, radius_m) in enumerate(discs.tolist()):
            T = np.array(se3.from_plane(x, y, 0.0))
            T[2, 3] = _PERSON_M / 2
            size = np.array([2 * radius_m, 2 * radius_m, _PERSON_M])
            made.append(marker("people", number, (_CYLINDER, 0), T, size, (orange, [])))
        if len(lines):
            ends = [self._make("geometry_msgs/msg/Point", *end) for end in lines.reshape(-1, 3).tolist()]
            width = np.array([_LOOP_M, 0, 0])
            made.append(marker("loops", 0, (_LINE_LIST, 0), np.eye(4), width, (green, ends)))
        return self._make("visualization_msgs/msg/MarkerArray", made)

    def text(self, text: str) -> Any:
        """String."""
        return self._make("std_msgs/msg/String", text)

    def pose(self, T: FloatArray) -> Any:
        """Pose of a motion (4, 4)."""
        point = self._make("geometry_msgs/msg/Point", *T[:3, 3].tolist())
        return self._make("geometry_msgs/msg/Pose", point, self._quaternion(T))

    def _quaternion(self, T: FloatArray) -> Any:
        return self._make("geometry_msgs/msg/Quaternion", *so3.to_quaternion(T[:3, :3]).tolist())

    def _vector(self, of: FloatArray) -> Any:
        return self._make("geometry_msgs/msg/Vector3", *np.asarray(of, float).tolist())

    def _make(self, type_: str, *values: Any) -> Any:
        return self.types.types[type_](*values)


def nanoseconds(stamp_s: float) -> int:
    """Nanoseconds of a time. Seconds are converted separately, so that the same float reads back."""
    seconds = math.floor(stamp_s)
    return seconds * 10**9 + round(1e9 * (stamp_s - seconds))


def _flat(matrix: FloatArray) -> FloatArray:
    return np.ascontiguousarray(matrix, float).ravel()
