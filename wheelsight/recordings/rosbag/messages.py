"""Messages of ROS 1 and ROS 2 from plain numbers, and their bytes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from wheelsight.errors import ArgumentError
from wheelsight.extras import needed
from wheelsight.geometry import ByteArray, FloatArray, PinholeCamera, so3

_TF = "tf2_msgs/msg/TFMessage"
# sensor_msgs/PointField
_FLOAT32, _POINT_STEP = 7, 16
# Of each ROS time: ROS 1 counts its seconds in 32 bits without a sign, ROS 2 with one.
_LAST_S = {True: 2**32 - 1, False: 2**31 - 1}


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One line of a DiagnosticArray.

    Attributes:
        level: 0 all is well, 1 a warning, 2 an error.
        name: of what is diagnosed.
        message: in a few words.
        values: names and values that explain it.
    """

    level: int
    name: str
    message: str
    values: tuple[tuple[str, str], ...] = ()


@cache
def _types(is_ros1: bool) -> Any:
    """A store of them, which makes a program for each type once."""
    typesys = needed("rosbags.typesys")
    types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_ros1 else typesys.Stores.ROS2_JAZZY)
    if is_ros1:  # which has it in a package of its own
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
        """A message as it is sent."""
        write = self.types.serialize_ros1 if self.is_ros1 else self.types.serialize_cdr
        return bytes(write(message, message.__msgtype__))

    def time(self, stamp_s: float) -> Any:
        """Raises ArgumentError for a time that ROS cannot say."""
        ns = nanoseconds(stamp_s)
        if not 0 <= ns // 10**9 <= _LAST_S[self.is_ros1]:
            fix = "stamps are seconds since 1970, or since the recording began"
            raise ArgumentError(f"{stamp_s:.3f} s is no time that ROS can tell", fix=fix)
        return self._make("builtin_interfaces/msg/Time", ns // 10**9, ns % 10**9)

    def header(self, stamp_s: float, frame: str) -> Any:
        """With no number of the message: ROS 1's own recorder does not keep that either."""
        return self._make("std_msgs/msg/Header", *((0,) if self.is_ros1 else ()), self.time(stamp_s), frame)

    def transforms(self, stamp_s: float, joined: Iterable[tuple[str, str, FloatArray]]) -> Any:
        """TFMessage of parent, child and T_parent_child (4, 4)."""
        stamped = [
            self._make("geometry_msgs/msg/TransformStamped", self.header(stamp_s, parent), child, self._transform(T))
            for parent, child, T in joined
        ]
        return self._make(_TF, stamped)

    def odometry(
        self,
        stamp_s: float,
        frames: tuple[str, str],
        T: FloatArray,
        twist: FloatArray,
        covariance: FloatArray | None,
    ) -> Any:
        """Odometry.

        Args:
            stamp_s: seconds.
            frames: the parent and the child.
            T: (4, 4) T_parent_child.
            twist: (6,) v and ω of the child in its own axes.
            covariance: (6, 6) of the pose as ROS has it; None where it is not known: zeros.
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

    def diagnostics(self, stamp_s: float, told: Sequence[Diagnosis]) -> Any:
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
            for one in told
        ]
        return self._make("diagnostic_msgs/msg/DiagnosticArray", self.header(stamp_s, ""), status)

    def occupancy(self, stamp_s: float, frame: str, cells: np.ndarray, resolution_m: float, T: FloatArray) -> Any:
        """OccupancyGrid of cells (H, W) int8, row 0 the least y, and T (4, 4) of the corner of cell (0, 0)."""
        height, width = cells.shape
        about = (self.time(stamp_s), resolution_m, width, height, self.pose(T))
        info = self._make("nav_msgs/msg/MapMetaData", *about)
        return self._make("nav_msgs/msg/OccupancyGrid", self.header(stamp_s, frame), info, cells.ravel())

    def points(self, stamp_s: float, frame: str, p: FloatArray, colors: ByteArray) -> Any:
        """PointCloud2 of points (N, 3) in metres and their colours (N, 3), packed in `rgb` as PCL has it."""
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
        """Imu of a rate about z alone: it says that it knows neither orientation nor acceleration."""
        unknown = np.array([-1.0, *np.zeros(8)])
        still = self._make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        felt = (self._vector(np.array([0, 0, yaw_rate_rad_s])), np.zeros(9), self._vector(np.zeros(3)), unknown)
        return self._make("sensor_msgs/msg/Imu", self.header(stamp_s, frame), still, unknown, *felt)

    def text(self, text: str) -> Any:
        """String."""
        return self._make("std_msgs/msg/String", text)

    def pose(self, T: FloatArray) -> Any:
        """Pose of a motion (4, 4)."""
        point = self._make("geometry_msgs/msg/Point", *T[:3, 3].tolist())
        return self._make("geometry_msgs/msg/Pose", point, self._quaternion(T))

    def _transform(self, T: FloatArray) -> Any:
        return self._make("geometry_msgs/msg/Transform", self._vector(T[:3, 3]), self._quaternion(T))

    def _quaternion(self, T: FloatArray) -> Any:
        return self._make("geometry_msgs/msg/Quaternion", *so3.to_quaternion(T[:3, :3]).tolist())

    def _vector(self, of: FloatArray) -> Any:
        return self._make("geometry_msgs/msg/Vector3", *np.asarray(of, float).tolist())

    def _make(self, type_: str, *values: Any) -> Any:
        return self.types.types[type_](*values)


def nanoseconds(stamp_s: float) -> int:
    """Nanoseconds of a time; seconds apart from the rest, so that the same float comes back."""
    seconds = math.floor(stamp_s)
    return seconds * 10**9 + round(1e9 * (stamp_s - seconds))


def _flat(matrix: FloatArray) -> FloatArray:
    return np.ascontiguousarray(matrix, float).ravel()
