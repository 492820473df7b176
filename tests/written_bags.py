"""Bags for tests, written by rosbags' own writers in each format: a small drive with colour, depth, wheels and more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from wheelsight.core.geometry import ByteArray

WIDTH, HEIGHT, FOCAL_PX = 64, 48, 52.0
START_S = 1_700_000_000.0
FRAMES = 6
COLOR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
OPTICAL, DEPTH_OPTICAL = "camera_color_optical_frame", "camera_depth_optical_frame"

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))


def stamp_ns(seconds: float) -> int:
    """Nanoseconds since 1970 of seconds since the drive began, exact to a microsecond."""
    return round(1e6 * START_S) * 1000 + round(1e6 * seconds) * 1000


class Messages:
    """Messages of ROS 1 or ROS 2 from plain numbers."""

    def __init__(self, is_ros1: bool) -> None:
        self.is_ros1 = is_ros1
        self.store = ROS1 if is_ros1 else ROS2
        self.types = self.store.types

    def header(self, seconds: float | None, frame: str) -> Any:
        """A header; None for no stamp."""
        ns = 0 if seconds is None else stamp_ns(seconds)
        stamp = self.types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        of_ros1 = (0,) if self.is_ros1 else ()
        return self.types["std_msgs/msg/Header"](*of_ros1, stamp, frame)

    def image(self, seconds: float | None, frame: str, encoding: str, pixels: np.ndarray, step: int = 0) -> Any:
        """An Image of an array (H, W) or (H, W, channels), its rows filled up to `step` bytes."""
        height, width = pixels.shape[:2]
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1)
        rows = np.pad(rows, ((0, 0), (0, max(0, step - rows.shape[1]))), constant_values=255)
        header = self.header(seconds, frame)
        return self.types["sensor_msgs/msg/Image"](header, height, width, encoding, 0, rows.shape[1], rows.reshape(-1))

    def compressed(self, seconds: float, frame: str, format_: str, data: bytes) -> Any:
        """A CompressedImage of encoded bytes."""
        header = self.header(seconds, frame)
        return self.types["sensor_msgs/msg/CompressedImage"](header, format_, np.frombuffer(data, np.uint8))

    def info(self, frame: str, model: str = "plumb_bob", D: Sequence[float] = (), **others: Any) -> Any:
        """A CameraInfo of the drive's camera; `others`: fx, width, height, binning, roi, P."""
        fx, width, height = (others.get(name, value) for name, value in _CAMERA.items())
        K = np.array([fx, 0, (width - 1) / 2, 0, fx, (height - 1) / 2, 0, 0, 1.0])
        P = np.asarray(others.get("P", np.insert(K, [3, 6, 9], 0.0)), float)
        region = self.types["sensor_msgs/msg/RegionOfInterest"](*others.get("roi", (0, 0, 0, 0)), False)
        binning = others.get("binning", 0)
        sizes = (self.header(0.0, frame), height, width, model)
        matrices = (np.array(D, float), K, np.eye(3).ravel(), P)
        return self.types["sensor_msgs/msg/CameraInfo"](*sizes, *matrices, binning, binning, region)

    def odometry(self, seconds: float, pose: Sequence[float], twist: Sequence[float], child: str = "base_link") -> Any:
        """An Odometry of a pose x, y, yaw and a twist v, ω, with variances of these."""
        types, (x, y, yaw), (v, w) = self.types, pose, twist
        position = types["geometry_msgs/msg/Point"](float(x), float(y), 0.0)
        turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        vector = types["geometry_msgs/msg/Vector3"]
        speeds = types["geometry_msgs/msg/Twist"](vector(float(v), 0.0, 0.0), vector(0.0, 0.0, float(w)))
        covariance = np.diag([1e-3, 1e-3, 0, 0, 0, 0.03]).ravel()
        posed = types["geometry_msgs/msg/PoseWithCovariance"](
            types["geometry_msgs/msg/Pose"](position, turn), covariance
        )
        moving = types["geometry_msgs/msg/TwistWithCovariance"](speeds, covariance)
        return types["nav_msgs/msg/Odometry"](self.header(seconds, "odom"), child, posed, moving)

    def joints(
        self, seconds: float, names: Sequence[str], angles: Sequence[float], speeds: Sequence[float] = ()
    ) -> Any:
        """A JointState."""
        values = (np.array(angles, float), np.array(speeds, float), np.zeros(0))
        return self.types["sensor_msgs/msg/JointState"](self.header(seconds, ""), list(names), *values)

    def imu(self, seconds: float, frame: str, rate: Sequence[float], acceleration: Sequence[float]) -> Any:
        """An Imu."""
        vector, nothing = self.types["geometry_msgs/msg/Vector3"], np.zeros(9)
        turn = self.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        felt = (vector(*map(float, rate)), nothing, vector(*map(float, acceleration)), nothing)
        return self.types["sensor_msgs/msg/Imu"](self.header(seconds, frame), turn, nothing, *felt)

    def counts(self, bits: int, *numbers: int) -> Any:
        """An Int16 or Int32 of one number, or an array of several."""
        if len(numbers) == 1:
            return self.types[f"std_msgs/msg/Int{bits}"](numbers[0])
        layout = self.types["std_msgs/msg/MultiArrayLayout"]([], 0)
        return self.types[f"std_msgs/msg/Int{bits}MultiArray"](layout, np.array(numbers, f"int{bits}"))

    def twist(self, seconds: float, v: float, w: float, across: float = 0.0) -> Any:
        """A TwistStamped."""
        vector = self.types["geometry_msgs/msg/Vector3"]
        twist = self.types["geometry_msgs/msg/Twist"](vector(v, across, 0.0), vector(0.0, 0.0, w))
        return self.types["geometry_msgs/msg/TwistStamped"](self.header(seconds, "base_link"), twist)

    def defined(self, seconds: float, type_: str, fields: str, *values: Any) -> Any:
        """A message of a robot's own, of a header and such fields as "int32 left", one a line."""
        if type_ not in self.types:
            self.store.register(get_types_from_msg(f"std_msgs/Header header\n{fields}", type_))
        return self.types[type_](self.header(seconds, "base_link"), *values)

    def posed(self, seconds: float, type_: str, pose: Sequence[float], child: str = "") -> Any:
        """A PoseStamped, PoseWithCovarianceStamped, TransformStamped or Odometry of x, y, yaw."""
        if type_ == "Odometry":
            return self.odometry(seconds, pose, (0.0, 0.0), child)
        types, (x, y, yaw) = self.types, pose
        turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        header = self.header(seconds, "world")
        if type_ == "TransformStamped":
            moved = types["geometry_msgs/msg/Vector3"](float(x), float(y), 0.0)
            motion = types["geometry_msgs/msg/Transform"](moved, turn)
            return types["geometry_msgs/msg/TransformStamped"](header, child, motion)
        whole = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](float(x), float(y), 0.0), turn)
        if type_ == "PoseWithCovarianceStamped":
            whole = types["geometry_msgs/msg/PoseWithCovariance"](whole, np.zeros(36))
        return types[f"geometry_msgs/msg/{type_}"](header, whole)

    def moving_tf(self, seconds: float, parent: str, child: str, pose: Sequence[float]) -> Any:
        """A TFMessage of x, y, yaw at a time."""
        stamped = self.posed(seconds, "TransformStamped", pose, child)
        stamped.header.frame_id = parent
        return self.types["tf2_msgs/msg/TFMessage"]([stamped])

    def tf(self, *transforms: tuple[str, str, Sequence[float], Sequence[float]]) -> Any:
        """A TFMessage of parent, child, translation and quaternion x, y, z, w."""
        vector, types = self.types["geometry_msgs/msg/Vector3"], self.types
        stamped = []
        for parent, child, t, q in transforms:
            turn = types["geometry_msgs/msg/Quaternion"](*map(float, q))
            motion = types["geometry_msgs/msg/Transform"](vector(*map(float, t)), turn)
            stamped.append(types["geometry_msgs/msg/TransformStamped"](self.header(0.0, parent), child, motion))
        return types["tf2_msgs/msg/TFMessage"](stamped)


_CAMERA = {"fx": FOCAL_PX, "width": WIDTH, "height": HEIGHT}
LOOKS_AHEAD = (-0.5, 0.5, -0.5, 0.5)  # an optical frame's quaternion on a robot that it looks ahead of


@dataclass
class Drive:
    """What a bag is made of: messages by topic, each with the seconds at which it was received.

    Attributes:
        is_ros1: which ROS the messages are of.
        messages: (seconds, topic, message), in any order.
    """

    is_ros1: bool = False
    messages: list[tuple[float, str, Any]] = field(default_factory=list)

    @property
    def make(self) -> Messages:
        return Messages(self.is_ros1)

    def add(self, seconds: float, topic: str, message: Any) -> Drive:
        """The same drive with one more message."""
        self.messages.append((seconds, topic, message))
        return self

    def without(self, *topics: str) -> Drive:
        """A drive that lacks some topics."""
        return Drive(self.is_ros1, [item for item in self.messages if item[1] not in topics])


def color_image(number: int) -> ByteArray:
    """(H, W, 3) with texture, of its own each."""
    return np.random.default_rng(number).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)


def depth_mm(number: int) -> np.ndarray:
    """(H, W) uint16: a slope from 1 to 2 m, a hole in it, of its own each."""
    depth = np.add.outer(np.arange(HEIGHT) * 10, np.arange(WIDTH) * 8) + 1000 + number
    depth[:5, :5] = 0
    return depth.astype(np.uint16)


def camera_drive(is_ros1: bool = False, frames: int = FRAMES, late_s: float = 0.05) -> Drive:
    """Colour and registered depth at 30 Hz, CameraInfo, the mount in /tf_static; images received `late_s` late."""
    drive = Drive(is_ros1)
    make = drive.make
    static = [
        ("base_link", "camera_link", (0.1, 0.0, 0.4), (0, 0, 0, 1)),
        ("camera_link", OPTICAL, (0, 0, 0), LOOKS_AHEAD),
    ]
    drive.add(0.0, "/tf_static", make.tf(*static))
    for number in range(frames):
        taken_s = 0.1 + number / 30
        drive.add(taken_s + late_s, COLOR, make.image(taken_s, OPTICAL, "rgb8", color_image(number)))
        drive.add(taken_s + late_s + 0.002, DEPTH, make.image(taken_s + 0.001, OPTICAL, "16UC1", depth_mm(number)))
        drive.add(taken_s + late_s, "/camera/color/camera_info", make.info(OPTICAL))
    return drive


def circle(seconds: float, v: float = 0.5, w: float = 0.3) -> tuple[float, float, float]:
    """x, y, yaw after so long on a circle."""
    return v / w * np.sin(w * seconds), v / w * (1 - np.cos(w * seconds)), w * seconds


def odometry_drive(is_ros1: bool = False, seconds: float = 3.0, rate_hz: float = 20.0) -> Drive:
    """A robot's odometry on a circle."""
    drive = Drive(is_ros1)
    for at_s in np.arange(0, seconds, 1 / rate_hz).tolist():
        drive.add(at_s + 0.001, "/odom", drive.make.odometry(at_s, circle(at_s), (0.5, 0.3)))
    return drive


def robot_drive() -> Drive:
    """A robot of ROS 1 with camera, odometry, joints of wheels and an IMU."""
    drive = odometry_drive(is_ros1=True)
    drive.messages += camera_drive(is_ros1=True).messages
    for at_s in np.arange(0, 3, 0.05).tolist():
        drive.add(at_s, "/joint_states", drive.make.joints(at_s, ["motor_a", "motor_b"], [2.2 * at_s, 2.8 * at_s]))
        drive.add(at_s, "/imu", drive.make.imu(at_s, "base_link", (0, 0, 0.3), (0, 0, 9.81)))
    return drive


def write_bag(path: Path, drive: Drive, **how: Any) -> Path:
    """Write a drive: of ROS 1 as a .bag at `path`, of ROS 2 as a folder there.

    Args:
        path: where.
        drive: what.
        how: `compression` of ROS 1, "bz2" or "lz4"; of ROS 2 `storage`, "sqlite3" or "mcap", and `mode`, "message",
            "file" or "storage".
    """
    typed = {topic: message.__msgtype__ for _, topic, message in drive.messages}
    ordered = sorted(drive.messages, key=lambda item: item[0])
    if drive.is_ros1:
        writer1 = Writer1(path)
        if "compression" in how:
            writer1.set_compression(Writer1.CompressionFormat[how["compression"].upper()])
        with writer1:
            to1 = {topic: writer1.add_connection(topic, type_, typestore=ROS1) for topic, type_ in typed.items()}
            for at_s, topic, message in ordered:
                writer1.write(to1[topic], stamp_ns(at_s), ROS1.serialize_ros1(message, typed[topic]))
        return path
    writer2 = Writer2(path, version=9, storage_plugin=StoragePlugin[how.get("storage", "mcap").upper()])
    if "mode" in how:
        writer2.set_compression(CompressionMode[how["mode"].upper()], CompressionFormat.ZSTD)
    with writer2:
        to2 = {topic: writer2.add_connection(topic, type_, typestore=ROS2) for topic, type_ in typed.items()}
        for at_s, topic, message in ordered:
            writer2.write(to2[topic], stamp_ns(at_s), ROS2.serialize_cdr(message, typed[topic]))
    return path


def png(pixels: np.ndarray) -> bytes:
    """An image as PNG."""
    return bytes(cv2.imencode(".png", pixels)[1].tobytes())


def halves(drive: Drive) -> Iterator[Drive]:
    """A drive in two parts, as a recorder splits it by size."""
    ordered = sorted(drive.messages, key=lambda item: item[0])
    for part in (ordered[: len(ordered) // 2], ordered[len(ordered) // 2 :]):
        yield Drive(drive.is_ros1, part)
