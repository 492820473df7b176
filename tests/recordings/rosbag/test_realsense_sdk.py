"""Bags as the RealSense SDK records them: its own topics, transforms, units of depth, and names of lens models."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from rosbags.rosbag1 import Writer
from written_bags import ROS1, Messages, color_image, stamp_ns

from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import OpenOptions, open_recording
from wheelsight.io.recordings.bags.images import camera_of

SENSORS = {"color": "/device_0/sensor_1/Color_0", "depth": "/device_0/sensor_0/Depth_0"}
T_COLOR_DEPTH = se3.exp([0.015, -0.0002, 0.0004, 0.003, -0.002, 0.001])
T_DEPTH_GROUP = se3.exp([-0.05, 0.001, 0.002, 0.02, 0.01, -0.03])
UNITS_M = 0.00025
D_COLOR = (-0.056, 0.067, 0.0003, 0.0006, -0.021)


def transform(T: FloatArray) -> Any:
    vector, turn = so3.log(T[:3, :3]), ROS1.types["geometry_msgs/msg/Quaternion"]
    angle = float(np.linalg.norm(vector))
    x, y, z = (np.sin(angle / 2) / max(angle, 1e-12) * vector).tolist()
    moved = ROS1.types["geometry_msgs/msg/Vector3"](*T[:3, 3].tolist())
    return ROS1.types["geometry_msgs/msg/Transform"](moved, turn(x, y, z, float(np.cos(angle / 2))))


def sdk_bag(path: Path, *, version: str = "1", with_tf: bool = True) -> Path:
    """Ten frames at 30 Hz: receipt counts from the start of the recording, headers by the camera's clock."""
    make = Messages(True)
    depth = np.full((48, 64), 8000, np.uint16)  # 2 m in units of 0.25 mm
    with Writer(path) as writer:
        connections: dict[str, Any] = {}

        def write(at_s: float, topic: str, message: Any, more: bytes = b"") -> None:
            type_ = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_, typestore=ROS1)
            writer.write(connections[topic], round(1e9 * at_s), bytes(ROS1.serialize_ros1(message, type_)) + more)

        model = "Inverse Brown Conrady"
        write(0.0, f"{SENSORS['color']}/info/camera_info", make.info("", model, D_COLOR, P=np.zeros(12)))
        write(0.0, f"{SENSORS['depth']}/info/camera_info", make.info("", "Brown Conrady", [0.0] * 5, fx=40.0))
        if with_tf:
            write(0.0, f"{SENSORS['color']}/tf/0", transform(T_COLOR_DEPTH @ T_DEPTH_GROUP))
            write(0.0, f"{SENSORS['depth']}/tf/0", transform(T_DEPTH_GROUP))
        units = struct.pack("<f", UNITS_M) if version == "1" else b""
        for number in range(10):
            at_s = 0.1 + number / 30
            color = make.image(at_s, version, "rgb8", color_image(number))
            write(at_s + 0.002, f"{SENSORS['color']}/image/data", color, struct.pack("<f", 0) if units else b"")
            write(at_s + 0.001, f"{SENSORS['depth']}/image/data", make.image(at_s, version, "mono16", depth), units)
    return path


def test_streams_are_joined_as_the_sdk_has_it(tmp_path: Path) -> None:
    recording = open_recording(sdk_bag(tmp_path / "sdk.bag"))
    calibration = recording.calibration
    assert calibration.T_color_depth is not None
    np.testing.assert_allclose(calibration.T_color_depth, T_COLOR_DEPTH, atol=1e-9)
    assert calibration.depth is not None
    assert calibration.depth.fx == pytest.approx(40.0)
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    assert len(frames) == 10
    np.testing.assert_allclose([frame.depth_m.max() for frame in frames], 2.0, rtol=1e-6)
    first_s = stamp_ns(0.1) * 1e-9
    np.testing.assert_allclose([frame.stamp_s - first_s for frame in frames], np.arange(10) / 30, atol=2e-6)
    assert any("joined as the RealSense SDK has it" in warning for warning in recording.warnings)


def test_units_that_a_user_states_count(tmp_path: Path) -> None:
    recording = open_recording(sdk_bag(tmp_path / "sdk.bag"), OpenOptions(depth_factor=8000.0))
    first = next(event for event in recording.events() if isinstance(event, RgbdFrame))
    assert first.depth_m.max() == pytest.approx(1.0)


def test_older_bags_have_millimetres(tmp_path: Path) -> None:
    recording = open_recording(sdk_bag(tmp_path / "old.bag", version="0"))
    first = next(event for event in recording.events() if isinstance(event, RgbdFrame))
    assert first.depth_m.max() == pytest.approx(8.0)
    np.testing.assert_allclose(not_none(recording.calibration.T_color_depth), T_COLOR_DEPTH, atol=1e-9)


def test_without_transforms_it_is_said_what_reads_them(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"--camera realsense:bare\.bag"):
        open_recording(sdk_bag(tmp_path / "bare.bag", with_tf=False))


def test_an_inverse_lens_is_found_again() -> None:
    """The SDK's coefficients lead from the image to the ray, Brown's from the ray to the image."""
    info = Messages(True).info("", "Inverse Brown Conrady", D_COLOR, fx=600.0, width=640, height=480)
    camera, sentence = camera_of(info, False)
    assert sentence is None
    u, v = np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7))
    px = np.stack([u, v], axis=-1)
    seen = (px - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    by_sdk = PinholeCamera(640, 480, 1.0 * 600, 600.0, camera.cx, camera.cy, D_COLOR).denormalise(seen)
    rays = (by_sdk - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    np.testing.assert_allclose(camera.denormalise(rays), px, atol=0.5)
