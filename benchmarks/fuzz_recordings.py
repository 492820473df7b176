"""Sound recordings in one file or database each, for `benchmarks.fuzz`: ROS bags and a file of an Azure Kinect."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from collections.abc import Iterator
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import av
import cv2
import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from wheelsight.core.calibration import Calibration
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks, YawRate
from wheelsight_export.bag_writing import Messages, RobotTopics, Sent, nanoseconds, new_bag

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


def packed_bag(robot: Calibration, way: str) -> bytes:
    """The same in a bag of ROS 1 whose chunks are packed by bz2 or lz4."""
    make = Messages(is_ros1=True)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.bag"
        writer = Writer1(path)
        writer.set_compression(Writer1.CompressionFormat[way.upper()])
        with writer:
            connections = {}
            for one in _sent(make, robot):
                type_ = one.message.__msgtype__
                if one.topic not in connections:
                    connections[one.topic] = writer.add_connection(one.topic, type_, typestore=make.types)
                writer.write(connections[one.topic], nanoseconds(one.stamp_s), make.bytes_of(one.message))
        return path.read_bytes()


def packed_mcap(robot: Calibration, way: str) -> bytes:
    """The same as one MCAP file by mcap's own writer, its chunks packed in a way of its `CompressionType`."""
    make, buffer = Messages(is_ros1=False), BytesIO()
    writer = McapWriter(buffer, compression=CompressionType[way])
    writer.start(profile="ros2")
    channels: dict[str, int] = {}
    for one in _sent(make, robot):
        type_ = one.message.__msgtype__
        if one.topic not in channels:
            definition = make.types.generate_msgdef(type_, ros_version=2)[0].encode()
            schema = writer.register_schema(type_, "ros2msg", definition)
            channels[one.topic] = writer.register_channel(one.topic, "cdr", schema, {"offered_qos_profiles": ""})
        stamp_ns = nanoseconds(one.stamp_s)
        writer.add_message(channels[one.topic], stamp_ns, bytes(make.bytes_of(one.message)), stamp_ns)
    writer.finish()  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def sqlite3_bag(robot: Calibration, mode: str = "") -> dict[str, bytes]:
    """The same as a folder with metadata.yaml and an sqlite3 database, as older robots record.

    `mode` is "message" where each message is packed by zstd, and "file" where the database is.
    """
    return _folder_bag(robot, StoragePlugin.SQLITE3, mode)


def mcap_folder(robot: Calibration) -> dict[str, bytes]:
    """The same as a folder with metadata.yaml and an MCAP file, as `ros2 bag record` writes it."""
    return _folder_bag(robot, StoragePlugin.MCAP, "")


def _folder_bag(robot: Calibration, storage: StoragePlugin, mode: str) -> dict[str, bytes]:
    make = Messages(is_ros1=False)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        writer = Writer2(path, version=9, storage_plugin=storage)
        if mode:
            writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
        with writer:
            connections = {}
            for one in _sent(make, robot):
                type_ = one.message.__msgtype__
                if one.topic not in connections:
                    connections[one.topic] = writer.add_connection(one.topic, type_, typestore=make.types)
                writer.write(connections[one.topic], nanoseconds(one.stamp_s), make.bytes_of(one.message))
        return {found.name: found.read_bytes() for found in path.iterdir()}


def oni_file() -> bytes:
    """Half a second that OpenNI2's recorder makes of the library's own dummy camera."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.oni"
        subprocess.run([sys.executable, "-c", _RECORDED, str(path)], check=True, timeout=60)
        return _with_cropping(path.read_bytes())


# In a program of its own, since the dummy camera survives no closing.
_RECORDED = """
import ctypes as c, os, sys, time
lib = c.CDLL("libOpenNI2.so.0")
device, recorder, streams = c.c_void_p(), c.c_void_p(), [c.c_void_p(), c.c_void_p()]
assert lib.oniInitialize(2002) == lib.oniDeviceOpen(b"Dummy", c.byref(device)) == 0
assert lib.oniCreateRecorder(sys.argv[1].encode(), c.byref(recorder)) == 0
for sensor, stream in zip((2, 3), streams):
    assert lib.oniDeviceCreateStream(device, sensor, c.byref(stream)) == 0
    assert lib.oniRecorderAttachStream(recorder, stream, 0) == 0
for stream in streams:
    assert lib.oniStreamStart(stream) == 0
assert lib.oniRecorderStart(recorder) == 0
time.sleep(0.5)
lib.oniRecorderStop(recorder)
assert lib.oniRecorderDestroy(c.byref(recorder)) == 0
os._exit(0)
"""


def _with_cropping(data: bytes) -> bytes:
    """The file with a cropping that is off in place of the output modes: the player gives no frame without one."""
    passed_over, length = b"xnSupportedMapOutputModes\0", 12
    reported, at = passed_over + struct.pack("<I", length), 0
    while (at := data.find(reported, at)) >= 0:
        begin = at + len(reported)
        data = (
            data[:at]
            + b"xnCropping\0".ljust(len(passed_over), b"\0")
            + data[begin - 4 : begin]
            + bytes(length)
            + (data[begin + length :])
        )
    return data


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
