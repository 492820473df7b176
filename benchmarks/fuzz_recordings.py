"""Sound recordings in one file or database each, for `benchmarks.fuzz`: ROS bags and a file of an Azure Kinect."""

from __future__ import annotations

import json
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import av
import cv2
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from wheelsight.calibration import Calibration
from wheelsight.events import Event, RgbdFrame, WheelTicks, YawRate
from wheelsight.recordings.rosbag.messages import Messages, nanoseconds
from wheelsight.recordings.rosbag.robot_topics import RobotTopics, Sent
from wheelsight.recordings.rosbag.writing import new_bag

_FRAMES = 3
_LENS = (0.5, 0.5, 0.49, 0.49, 0.1, -0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e-4, -2e-4)


def bag(name: str, robot: Calibration) -> bytes:
    """A robot's drive as `export --bag` writes it: images, ticks, yaw rates and mounts; .mcap or .bag."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        with new_bag(path) as made:
            for one in _sent(made.make, robot):
                made.add(one.topic, one.message, one.stamp_s, is_latched=one.is_latched)
        return path.read_bytes()


def sqlite3_bag(robot: Calibration) -> dict[str, bytes]:
    """The same as a folder with metadata.yaml and an sqlite3 database, as older robots record."""
    make = Messages(is_ros1=False)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
            connections = {}
            for one in _sent(make, robot):
                type_ = one.message.__msgtype__
                if one.topic not in connections:
                    connections[one.topic] = writer.add_connection(one.topic, type_, typestore=make.types)
                writer.write(connections[one.topic], nanoseconds(one.stamp_s), make.bytes_of(one.message))
        return {found.name: found.read_bytes() for found in path.iterdir()}


def azure_kinect() -> bytes:
    """Matroska as k4arecorder writes it: colour as JPEG, depth as it is, and the device's calibration."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.mkv"
        with av.open(str(path), "w", options={"allow_raw_vfw": "1"}) as made:
            made.metadata["K4A_DEPTH_DELAY_NS"] = "0"
            color = made.add_stream("mjpeg", rate=30, width=1280, height=720, pix_fmt="yuvj420p")
            depth = made.add_stream("rawvideo", rate=30, width=320, height=288, pix_fmt="gray16be")
            color.metadata["title"] = "COLOR"
            depth.metadata.update({"title": "DEPTH", "K4A_DEPTH_MODE": "NFOV_2X2BINNED"})
            made.add_attachment("calibration.json", "application/octet-stream", _device().encode())
            picture = cv2.imencode(".jpg", np.full((720, 1280, 3), 90, np.uint8))[1].tobytes()
            distances = np.full((288, 320), 1500, ">u2").tobytes()
            for i in range(_FRAMES):
                for stream, data in ((color, picture), (depth, distances)):
                    packet = av.Packet(data)
                    packet.stream, packet.pts, packet.dts, packet.is_keyframe = stream, 33 * i, 33 * i, True
                    packet.time_base = Fraction(1, 1000)
                    made.mux(packet)
        return path.read_bytes()


def _sent(make: Messages, robot: Calibration) -> Iterator[Sent]:
    topics = RobotTopics(make, robot, "raw")
    yield from topics.mounts(1.0)
    color, depth_m = np.full((12, 16, 3), 90, np.uint8), np.full((12, 16), 2.0, np.float32)
    for i in range(_FRAMES):
        events: tuple[Event, ...] = (
            RgbdFrame(1.0 + i, color, depth_m, i),
            WheelTicks(1.2 + i, 9 * i, i),
            YawRate(1.3 + i, 0),
        )
        for event in events:
            yield from topics.of_event(event)


def _device() -> str:
    """Its calibration: two lenses at one place."""
    model = {"ModelType": "CALIBRATION_LensDistortionModelBrownConrady", "ModelParameters": list(_LENS)}
    still = {"Rotation": np.eye(3).ravel().tolist(), "Translation": [0, 0, 0]}
    cameras = [
        {
            "Intrinsics": model,
            "SensorWidth": width,
            "SensorHeight": height,
            "Location": f"CALIBRATION_CameraLocation{place}",
            "MetricRadius": 1.7,
            "Rt": still,
        }
        for place, width, height in (("D0", 1024, 1024), ("PV0", 4096, 3072))
    ]
    return json.dumps({"CalibrationInformation": {"Cameras": cameras}})
