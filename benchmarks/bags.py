"""How fast bags are read and written: frames a second of 640×480 colour and depth; and how long an hour takes to open.

`python -m benchmarks.bags [--frames 150] [--minutes 60] [--only raw|hour|written]`; in a temporary folder, of 0.5 GB.
Needs the extra `bags`. Figures are of processor time, on one core: other programs on the machine do not change them.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.runtime import needed
from wheelsight.io.recordings import open_recording
from wheelsight_export.bag_writing import ImageForm, RobotTopics, new_bag

FRAMES_PER_S, WRITTEN_PER_S, OPEN_S = 150.0, 100.0, 2.0
_WIDTH, _HEIGHT, _FRAME_HZ, _WHEELS_HZ = 640, 480, 30, 50
_START_NS = 1_700_000_000 * 10**9
_COLOR, _DEPTH, _INFO, _ODOM = "/camera/color", "/camera/aligned_depth_to_color", "/camera/color/camera_info", "/odom"
_HOUR, _RAW, _WRITTEN = "hour", "raw", "written"
# What our own writer makes: file's ending, how images are kept, and whether the target is asked of it.
OWN: tuple[tuple[str, ImageForm, bool], ...] = (
    (".mcap", "raw", True),
    (".bag", "raw", True),
    (".mcap", "png", False),
    (".mcap", "jpeg", False),
)


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of bag: its file's ending, whether images are compressed, and how they are called."""

    name: str
    suffix: str
    is_packed: bool = False


KINDS = (
    Kind("ROS 1, raw images", ".bag"),
    Kind("ROS 2 MCAP, raw images", ".mcap"),
    Kind("ROS 2 sqlite3, raw images", ".db3"),
    Kind("ROS 2 MCAP, JPEG and PNG", ".mcap", is_packed=True),
)


class _Store:
    """Makes and serializes messages of ROS 1 or 2."""

    def __init__(self, is_ros1: bool) -> None:
        typesys = needed("rosbags.typesys")
        self.is_ros1 = is_ros1
        self.types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_ros1 else typesys.Stores.ROS2_JAZZY)

    def make(self, type_: str, *values: Any) -> Any:
        return self.types.types[type_](*values)

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
        return self.make("std_msgs/msg/Header", *((0,) if self.is_ros1 else ()), stamp, frame)

    def bytes_of(self, message: Any) -> bytes:
        write = self.types.serialize_ros1 if self.is_ros1 else self.types.serialize_cdr
        return bytes(write(message, message.__msgtype__))


def _images(width: int, height: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Colour that compresses as pictures of rooms do, and depth in millimetres: a smooth picture with noise."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (height // 16, width // 16, 3)).astype(np.uint8)
    smooth = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    noisy = np.clip(smooth + rng.normal(0, 3, smooth.shape), 0, 255).astype(np.uint8)
    depth = 1000 + 4 * np.arange(width)[None, :] + rng.normal(0, 2, (height, width))
    return noisy, depth.astype(np.uint16)


def _image_messages(store: _Store, kind: Kind, width: int, height: int) -> Callable[[int], Iterator[tuple[str, Any]]]:
    """What makes both images of a stamp."""
    color, depth = _images(width, height)
    packed_color = cv2.imencode(".jpg", color)[1].ravel()
    packed_depth = np.concatenate([np.zeros(12, np.uint8), cv2.imencode(".png", depth)[1].ravel()])

    def raw(header: Any, encoding: str, pixels: np.ndarray[Any, Any]) -> Any:
        rows = pixels.view(np.uint8).reshape(height, -1)
        shape = (height, width, encoding, 0, rows.shape[1])
        return store.make("sensor_msgs/msg/Image", header, *shape, rows.ravel())

    def packed(header: Any, format_: str, data: np.ndarray[Any, Any]) -> Any:
        return store.make("sensor_msgs/msg/CompressedImage", header, format_, data)

    def both(stamp_ns: int) -> Iterator[tuple[str, Any]]:
        header = store.header(stamp_ns, "camera")
        if kind.is_packed:
            yield f"{_COLOR}/image_raw/compressed", packed(header, "rgb8; jpeg compressed bgr8", packed_color)
            yield f"{_DEPTH}/image_raw/compressedDepth", packed(header, "16UC1; compressedDepth png", packed_depth)
        else:
            yield f"{_COLOR}/image_raw", raw(header, "rgb8", color)
            yield f"{_DEPTH}/image_raw", raw(header, "16UC1", depth)

    return both


def _info(store: _Store, width: int, height: int) -> Any:
    K = np.array([0.8 * width, 0, width / 2, 0, 0.8 * width, height / 2, 0, 0, 1])
    region = store.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    sizes = (store.header(_START_NS, "camera"), height, width, "plumb_bob")
    matrices = (np.zeros(5), K, np.eye(3).ravel(), np.zeros(12))
    return store.make("sensor_msgs/msg/CameraInfo", *sizes, *matrices, 0, 0, region)


def _odometry(store: _Store, stamp_ns: int) -> Any:
    make, at_m = store.make, 0.5e-9 * (stamp_ns - _START_NS)
    vector = make("geometry_msgs/msg/Vector3", 0.5, 0.0, 0.0), make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    turn = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", at_m, 0.0, 0.0), turn)
    posed = make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
    moving = make("geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", *vector), np.zeros(36))
    return make("nav_msgs/msg/Odometry", store.header(stamp_ns, "odom"), "base_link", posed, moving)


def write(folder: Path, kind: Kind, frames: int, size: tuple[int, int], one_a_chunk: bool = False) -> Path:
    """A bag of camera and odometry; small images one in each chunk, as large ones are, where that is asked for."""
    store = _Store(kind.suffix == ".bag")
    both = _image_messages(store, kind, *size)
    step_ns = 10**9 // _FRAME_HZ
    wheels_ns = 10**9 // _WHEELS_HZ
    with _writer(folder, kind, one_a_chunk) as writer:
        add = _adder(writer, store)
        add(_INFO, _info(store, *size), _START_NS)
        due_ns = _START_NS
        for stamp_ns in range(_START_NS, _START_NS + frames * step_ns, step_ns):
            for topic, message in both(stamp_ns):
                add(topic, message, stamp_ns)
            while due_ns < stamp_ns + step_ns:
                add(_ODOM, _odometry(store, due_ns), max(due_ns, stamp_ns))
                due_ns += wheels_ns
    return folder if kind.suffix != ".bag" else folder.with_suffix(".bag")


def _writer(folder: Path, kind: Kind, one_a_chunk: bool) -> Any:
    if kind.suffix == ".bag":
        writer = needed("rosbags.rosbag1").Writer(folder.with_suffix(".bag"))
        if one_a_chunk:
            writer.chunk_threshold = 1500  # less than the smaller image; readings go along with images
        return writer
    rosbag2 = needed("rosbags.rosbag2")
    plugin = rosbag2.StoragePlugin.MCAP if kind.suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
    return rosbag2.Writer(folder, version=9, storage_plugin=plugin)


def _adder(writer: Any, store: _Store) -> Callable[[str, Any, int], None]:
    connections: dict[str, Any] = {}

    def add(topic: str, message: Any, receipt_ns: int) -> None:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store.types)
        writer.write(connections[topic], receipt_ns, store.bytes_of(message))

    return add


def read_rate(path: Path, frames: int) -> float:
    """Frames a second of processor time, of a whole pass; the bag was opened before."""
    recording = open_recording(path)
    begin_s = time.process_time()
    read = sum(1 for event in recording.events() if type(event).__name__ == "RgbdFrame")
    spent_s = time.process_time() - begin_s
    assert read == frames, f"{read} of {frames} frames were read"
    return frames / spent_s


def write_rate(path: Path, images: ImageForm, frames: int) -> float:
    """Frames a second of processor time that become messages and a file on the disk."""
    color, units = _images(_WIDTH, _HEIGHT)
    depth_m = (units / 1000).astype(np.float32)
    camera = PinholeCamera(_WIDTH, _HEIGHT, 0.8 * _WIDTH, 0.8 * _WIDTH, _WIDTH / 2, _HEIGHT / 2)
    begin_s = time.process_time()
    with new_bag(path) as bag:
        robot = RobotTopics(bag.make, Calibration.registered_camera(camera), images)
        for number in range(frames):
            frame = RgbdFrame(number / _FRAME_HZ, color, depth_m, number)
            for sent in robot.of_frame(frame):
                bag.add(sent.topic, sent.message, sent.stamp_s)
    return frames / (time.process_time() - begin_s)


def opening_s(path: Path) -> float:
    """Processor time to open a bag, the second time, so that nothing is imported meanwhile."""
    open_recording(path)
    begin_s = time.process_time()
    open_recording(path)
    return time.process_time() - begin_s


def main(words: Sequence[str] | None = None) -> int:
    """Measure, print, and answer 0 where all targets are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--only", choices=(_RAW, _HOUR, _WRITTEN))
    arguments = parser.parse_args(words)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    table = Table("bag", "measured", "target")
    is_met = True
    with tempfile.TemporaryDirectory() as folder:
        if arguments.only in (None, _RAW):
            is_met &= _measure_reading(Path(folder), arguments.frames, table)
        if arguments.only in (None, _WRITTEN):
            is_met &= _measure_writing(Path(folder), arguments.frames, table)
        if arguments.only in (None, _HOUR):
            is_met &= _measure_opening(Path(folder), arguments.minutes, table)
    Console(width=100).print(table)
    return 0 if is_met else 1


def _measure_reading(folder: Path, frames: int, table: Table) -> bool:
    is_met = True
    for number, kind in enumerate(KINDS):
        rate = read_rate(write(folder / f"frames{number}", kind, frames, (_WIDTH, _HEIGHT)), frames)
        is_met &= kind.is_packed or rate >= FRAMES_PER_S
        table.add_row(kind.name, f"{rate:.0f} frames/s", "none" if kind.is_packed else f"{FRAMES_PER_S:.0f}")
    return is_met


def _measure_writing(folder: Path, frames: int, table: Table) -> bool:
    is_met = True
    for suffix, images, is_asked in OWN:
        rate = write_rate(folder / f"written{suffix}", images, frames)
        is_met &= not is_asked or rate >= WRITTEN_PER_S
        name = f"{'ROS 1' if suffix == '.bag' else 'ROS 2 MCAP'}, {images} images, written"
        table.add_row(name, f"{rate:.0f} frames/s", f"{WRITTEN_PER_S:.0f}" if is_asked else "none")
    return is_met


def _measure_opening(folder: Path, minutes: float, table: Table) -> bool:
    is_met = True
    for number, kind in enumerate(KINDS[:3]):
        path = write(folder / f"hour{number}", kind, round(60 * minutes * _FRAME_HZ), (32, 32), one_a_chunk=True)
        spent_s = opening_s(path)
        is_met &= spent_s <= OPEN_S
        table.add_row(f"{kind.name}, {minutes:g} minutes", f"opens in {spent_s:.2f} s", f"{OPEN_S:g}")
    return is_met


if __name__ == "__main__":
    sys.exit(main())
