"""What a robot's sensors say, as topics of a bag: images, CameraInfo, wheels, gyroscope, and where they are mounted."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
import yaml

from wheelsight.calibration import Calibration, calibration_fields
from wheelsight.depth_error import DepthError
from wheelsight.errors import RecordingError
from wheelsight.events import (
    Event,
    HolonomicReading,
    OdometryReading,
    RgbdFrame,
    WheelSpeeds,
    WheelTicks,
    YawRate,
)
from wheelsight.geometry import ByteArray, Float32Array, FloatArray, se3
from wheelsight.recordings.image_files import FAST_PNG, JPEG_QUALITY
from wheelsight.recordings.rosbag.messages import Messages
from wheelsight.recordings.rosbag.topics import CALIBRATION, WHEEL_ODOMETRY

ImageForm = Literal["raw", "png", "jpeg"]
BASE, LINK = "base_link", "camera_link"
COLOR_FRAME, DEPTH_FRAME = "camera_color_optical_frame", "camera_depth_optical_frame"
JOINTS = ("left_wheel_joint", "right_wheel_joint")
TF_STATIC, JOINT_STATES, IMU = "/tf_static", "/joint_states", "/imu/data"
_COLOR, _DEPTH, _REGISTERED = "/camera/color", "/camera/depth", "/camera/aligned_depth_to_color"
# REP 103: x forward, y left, z up of what an optical frame (x right, y down, z forward) looks ahead of.
T_LINK_OPTICAL: FloatArray = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
T_LINK_OPTICAL.setflags(write=False)
# compressed_depth_image_transport: which way, 1 for its only one, and two numbers that whole numbers need not.
_COMPRESSED_DEPTH = struct.pack("<iff", 1, 0.0, 0.0)
_MILLIMETRES, _DEEPEST = 1000.0, np.iinfo(np.uint16).max


@dataclass(frozen=True, slots=True, eq=False)
class Sent:
    """A message on its way into a bag.

    Attributes:
        stamp_s: when it was received, seconds.
        topic: its name.
        message: itself.
        is_latched: whether who listens later gets it too.
    """

    stamp_s: float
    topic: str
    message: Any
    is_latched: bool = False


class RobotTopics:
    """Messages of one robot's sensors.

    Args:
        make: what makes messages.
        calibration: of the robot, or None where it is not known: then there are no images and no joints.
        images: how images are written; None for none. "raw" keeps colour and depth exactly, "png" keeps colour exactly
            and depth in millimetres, "jpeg" likewise with colour of quality 95.
    """

    def __init__(self, make: Messages, calibration: Calibration | None, images: ImageForm | None) -> None:
        self.make, self._calibration, self._images = make, calibration, images
        self._angles_rad = [0.0, 0.0]
        self._last: WheelSpeeds | None = None

    def mounts(self, stamp_s: float) -> Iterator[Sent]:
        """/tf_static, and the calibration as text: messages of ROS have no room for wheels and noise."""
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
        """What one event comes to; nothing where the calibration does not tell what it needs."""
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
        depth_topic, depth_frame = (_REGISTERED, COLOR_FRAME) if is_registered else (_DEPTH, DEPTH_FRAME)
        late_s = at_s + frame.depth_late_s
        color_camera, depth_camera = calibration.cameras
        yield Sent(at_s, f"{_COLOR}/camera_info", self.make.camera(at_s, COLOR_FRAME, color_camera))
        yield Sent(late_s, f"{depth_topic}/camera_info", self.make.camera(late_s, depth_frame, depth_camera))
        if self._images == "raw":
            depth_m = np.where(frame.depth_m > 0, frame.depth_m, np.float32(np.nan))  # REP 118
            color = self.make.image(at_s, COLOR_FRAME, "rgb8", frame.color)
            depth = self.make.image(late_s, depth_frame, "32FC1", depth_m.astype("<f4"))
            yield Sent(at_s, f"{_COLOR}/image_raw", color)
            yield Sent(late_s, f"{depth_topic}/image_raw", depth)
            return
        format_ = f"rgb8; {self._images} compressed bgr8"
        color = self.make.compressed(at_s, COLOR_FRAME, format_, _coded(frame.color, self._images))
        depth = self.make.compressed(late_s, depth_frame, "16UC1; compressedDepth png", _coded_depth(frame.depth_m))
        yield Sent(at_s, f"{_COLOR}/image_raw/compressed", color)
        yield Sent(late_s, f"{depth_topic}/image_raw/compressedDepth", depth)

    def _of_wheels(self, event: WheelTicks | WheelSpeeds) -> Iterator[Sent]:
        """JointState: angles of ticks; of speeds, which hold until the next ones, themselves and what they sum to."""
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
            told = self.make.odometry(event.stamp_s, ("wheel_odom", BASE), T, np.zeros(6), None)
            yield Sent(event.stamp_s, WHEEL_ODOMETRY, told)
        elif wheels is not None and wheels.ticks_per_turn is not None:
            angles = [2 * math.pi / wheels.ticks_per_turn * count for count in event.counts]
            yield Sent(event.stamp_s, JOINT_STATES, self.make.joints(event.stamp_s, wheels.wheel_names, angles, []))


def mounts_of(calibration: Calibration) -> list[tuple[str, str, FloatArray]]:
    """Parent, child and T_parent_child of the frames that stand still on a robot, named as REP 103 and drivers do.

    `camera_link` lies where depth is measured, x forward; optical frames hang on it.
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


def _coded(color: ByteArray, form: str) -> ByteArray:
    flags = FAST_PNG if form == "png" else (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
    return _encoded(".png" if form == "png" else ".jpg", cv2.cvtColor(color, cv2.COLOR_RGB2BGR), flags)


def _coded_depth(depth_m: Float32Array) -> ByteArray:
    """Millimetres as compressedDepth; what 16 bits cannot hold is not measured."""
    mm = np.rint(_MILLIMETRES * depth_m)
    code = _encoded(".png", np.where(mm > _DEEPEST, 0, mm).astype(np.uint16), FAST_PNG)
    return np.concatenate([np.frombuffer(_COMPRESSED_DEPTH, np.uint8), code])


def _encoded(kind: str, image: np.ndarray, flags: tuple[int, ...]) -> ByteArray:
    is_encoded, code = cv2.imencode(kind, image, flags)
    if not is_encoded:
        raise RecordingError(f"the image cannot be encoded as {kind[1:].upper()}")
    return np.asarray(code, np.uint8).ravel()
