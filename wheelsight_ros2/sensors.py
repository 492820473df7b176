"""Ros2Sensors: camera and wheels whose drivers are nodes of ROS 2, over DDS, as live sensors.

The first seconds of the topics become a bag, which is opened as any other: topics are chosen, stamps judged, and
cameras, mounts and wheels found by the code of bags. Later messages pass through the same recording.
"""

from __future__ import annotations

import os
import queue
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.errors import CalibrationError, ConfigError, DeviceError, WheelsightError
from wheelsight.core.files import StrPath
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelReading, YawRate
from wheelsight.core.runtime import needed
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.core.threads import Closing
from wheelsight.io.devices import host_clock
from wheelsight.io.devices.live_camera import CameraReport, CameraStatus, LiveFrame
from wheelsight.io.recordings import OpenOptions
from wheelsight.io.recordings.bags.reader import BagReader
from wheelsight.io.recordings.bags.recording import BagRecording
from wheelsight.io.recordings.bags.storage import COMPRESSED, IMAGE, Message, open_bag
from wheelsight_export.bag_writing import Messages
from wheelsight_ros2.dds import DdsListener

PREFIX = "ros2"
_INFO = "sensor_msgs/msg/CameraInfo"
_TF = "tf2_msgs/msg/TFMessage"
# Types that the code of bags uses. String is left out: a bag with a calibration of ours would count as one of ours.
_TYPES = (
    *(IMAGE, COMPRESSED, _INFO, _TF, "nav_msgs/msg/Odometry"),
    *(f"sensor_msgs/msg/{name}" for name in ("JointState", "Imu")),
    *(f"geometry_msgs/msg/{name}" for name in ("TwistStamped", "TwistWithCovarianceStamped")),
    *(
        f"std_msgs/msg/{sign}Int{bits}{many}"
        for sign in ("", "U")
        for bits in (16, 32, 64)
        for many in ("", "MultiArray")
    ),
)
# How long topics are followed before they are judged, once all sensors have begun; and how long they may take to begin.
_JUDGED_S, _BEGIN_S = 3.0, 20.0
_MOST_BYTES = 384 << 20
# Messages that wait to be read: a second of a camera, some of wheels.
_MOST_IMAGES, _MOST_READINGS, _MOST_FRAMES = 60, 2000, 4
# Stamps so far from this computer's clock are of another clock, such as a simulated one.
_APART_S = 2.0
_STALLS_S, _RATE_OVER = 1.0, 30


class Ros2Camera(Closing):
    """A `LiveCamera` of topics. Its stamps are those of the headers."""

    def __init__(self, name: str, calibration: Calibration, warnings: tuple[str, ...], settings: LiveCameraSettings):
        self.name, self.calibration, self.warnings = name, calibration, warnings
        self._settings, self._changed = settings, threading.Condition()
        self._kept: deque[LiveFrame | SkippedFrame] = deque()
        self._arrivals: deque[float] = deque(maxlen=_RATE_OVER)
        self._report = CameraReport(CameraStatus.STARTING, host_clock.now_s())
        self.on_close: Callable[[], None] = lambda: None

    def read(self, timeout_s: float) -> LiveFrame | None:
        """See `LiveCamera`."""
        ends_s = time.monotonic() + timeout_s
        with self._changed:
            while True:
                now_s = host_clock.now_s()
                while self._kept:
                    live = self._kept.popleft()
                    if isinstance(live, SkippedFrame):
                        continue
                    if live.age_s(now_s) <= self._settings.oldest_s:
                        return live
                    self._report = replace(self._report, stale=self._report.stale + 1)
                left_s = ends_s - time.monotonic()
                if left_s <= 0 or self._report.status is CameraStatus.CLOSED:
                    return None
                self._changed.wait(left_s)

    def take(self) -> list[RgbdFrame | SkippedFrame]:
        """See `LiveCamera`."""
        with self._changed:
            found = [live.frame if isinstance(live, LiveFrame) else live for live in self._kept]
            self._kept.clear()
            return found

    def report(self) -> CameraReport:
        """See `LiveCamera`."""
        with self._changed:
            span_s = self._arrivals[-1] - self._arrivals[0] if len(self._arrivals) > 1 else 0.0
            report = replace(self._report, rate_hz=(len(self._arrivals) - 1) / span_s if span_s > 0 else 0.0)
            is_silent = self._arrivals and host_clock.now_s() - self._arrivals[-1] > _STALLS_S
            if is_silent and report.status is CameraStatus.STREAMING:
                report = replace(report, status=CameraStatus.STALLED, since_s=self._arrivals[-1])
            return report

    def close(self) -> None:
        """See `LiveCamera`."""
        self.on_close()
        with self._changed:
            self._kept.clear()
            self._report = replace(self._report, status=CameraStatus.CLOSED, since_s=host_clock.now_s())
            self._changed.notify_all()

    def give(self, frame: RgbdFrame | SkippedFrame, device_s: float) -> None:
        """Keep a frame for `read`, and drop the oldest where too many are kept."""
        arrived_s = host_clock.now_s()
        with self._changed:
            report = self._report
            if isinstance(frame, SkippedFrame):
                self._kept.append(frame)
                self._report = replace(report, refused=report.refused + 1, detail=frame.reason)
            else:
                if report.status is CameraStatus.STARTING:
                    report = replace(report, status=CameraStatus.STREAMING, since_s=arrived_s)
                self._kept.append(LiveFrame(frame, 0.0, device_s, arrived_s, None))
                self._arrivals.append(arrived_s)
                self._report = replace(report, frames=report.frames + 1, last_stamp_s=frame.stamp_s)
            while len(self._kept) > self._settings.kept_frames:
                is_frame = isinstance(self._kept.popleft(), LiveFrame)
                self._report = replace(self._report, host_drops=self._report.host_drops + is_frame)
            self._changed.notify_all()


class Ros2Wheels:
    """A `ReadingLink` of topics: readings of wheels and gyroscope."""

    def __init__(self, port: str) -> None:
        self.port = port
        self._readings: queue.Queue[WheelReading | YawRate] = queue.Queue(_MOST_READINGS)

    def read(self, timeout_s: float) -> WheelReading | YawRate | None:
        """See `ReadingLink`."""
        try:
            return self._readings.get(timeout=timeout_s) if timeout_s > 0 else self._readings.get_nowait()
        except queue.Empty:
            return None

    def give(self, reading: WheelReading | YawRate) -> None:
        """Keep a reading; the oldest goes where nothing reads them."""
        if self._readings.full():
            with suppress(queue.Empty):
                self._readings.get_nowait()
        self._readings.put_nowait(reading)


@dataclass(frozen=True, slots=True)
class Ros2Request:
    """What is asked of the network.

    Attributes:
        camera: prefix of the camera's topics, such as /camera; "" for any; None without a camera.
        wheels: the wheels' topic, as `--topic wheels=…` names it; "" for any; None without wheels.
        topics: further choices, as `--topic` has them.
        files: calibrations of the robot.
    """

    camera: str | None
    wheels: str | None
    topics: tuple[str, ...] = ()
    files: tuple[StrPath, ...] = ()

    def __post_init__(self) -> None:
        for option, name in (("--camera", self.camera), ("--wheels", self.wheels)):
            if name and not name.startswith("/"):
                raise ConfigError(f"{option} ros2:{name} is no topic", fix="such as ros2:/camera or ros2:/odom")

    def choices(self) -> tuple[str, ...]:
        """The choices of topics for a bag."""
        roles = {text.partition("=")[0] for text in self.topics}
        found = list(self.topics)
        if self.camera is None:
            found += ["color=none", "depth=none"]
        if self.wheels is None:
            found += [f"{role}=none" for role in ("wheels", "gyro") if role not in roles]
        elif self.wheels:
            found.append(f"wheels={self.wheels}")
        return tuple(found)

    def takes(self, topic: str, type_: str) -> bool:
        """Whether a topic is followed before topics are chosen."""
        if type_ in (IMAGE, COMPRESSED, _INFO):
            named = any(text.partition("=")[2] == topic for text in self.topics)
            return self.camera is not None and (named or topic.startswith(self.camera.rstrip("/") + "/"))
        return type_ in _TYPES


class Ros2Sensors(Closing):
    """Sensors of a robot whose drivers are nodes of ROS 2. `domain` and network are those of ROS 2's own variables.

    Args:
        request: what is asked for.
        settings: of the camera.

    Attributes:
        calibration: of the robot, by its topics and the files of the request.
        camera: None without one.
        link: the wheels; None without any.
        warnings: of opening, as for a bag.

    Raises:
        DeviceError: the topics do not begin, or hold nothing to localize by.
        ConfigError: a chosen topic does not exist, or the network cannot be used.
        CalibrationError: camera or wheels are unknown.
    """

    def __init__(self, request: Ros2Request, settings: LiveCameraSettings) -> None:
        self._request, self._opened = request, ExitStack()
        self._is_over = threading.Event()
        self._queues: dict[str, queue.Queue[Message | None]] = {}
        self._lock, self._came = threading.Lock(), list[tuple[Message, str]]()
        try:
            self._listener = DdsListener(_domain(), request.takes, self._receive)
            self._opened.callback(self._listener.close)
            folder = Path(self._opened.enter_context(tempfile.TemporaryDirectory(prefix="wheelsight-ros2-")))
            self._recording, self._ahead_s = self._judged(folder)
            self._bag = self._opened.enter_context(open_bag(self._recording.path))
            self._open_sensors(settings)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End all; may be called twice."""
        self._is_over.set()
        for waiting in self._queues.values():
            with suppress(queue.Full):
                waiting.put_nowait(None)
        self._opened.close()

    def _receive(self, topic: str, type_: str, receipt_ns: int, data: bytes) -> None:
        """Called in the listener's thread."""
        message = Message(topic, receipt_ns, data)
        with self._lock:
            waiting = self._queues.get(topic)
            if waiting is None:
                self._came.append((message, type_))
                return
        if waiting.full():  # its reader is too slow: the oldest go
            with suppress(queue.Empty):
                waiting.get_nowait()
        waiting.put_nowait(message)

    def _judged(self, folder: Path) -> tuple[BagRecording, float]:
        """The bag of the first seconds; and how far the host's clock is ahead of the stamps, 0 for one clock."""
        self._wait_for_beginning()
        with self._lock:
            came, self._came = self._came, []
        self._listener.pause()
        _write(came, folder)
        options: dict[str, Any] = {"topics": self._request.choices(), "calibration": self._request.files}
        try:
            recording = BagReader().open(folder / "bag", OpenOptions(**options))
        except (ConfigError, CalibrationError):
            raise
        except WheelsightError as error:
            raise DeviceError(f"the topics of ROS 2: {error}", fix=getattr(error, "fix", None)) from error
        used = {topic.name for topic in recording.topics if topic.used_as and "info" not in topic.used_as}
        ends = recording.end_stamps()
        late_s = [came[-1][0].receipt_s - float(stamps_s[-1]) for stamps_s in ends.values()]
        apart_s = min(late_s, default=0.0)
        self._used = used
        return recording, apart_s if abs(apart_s) > _APART_S else 0.0

    def _wait_for_beginning(self) -> None:
        """Wait until every sensor has come for a while. Raises DeviceError."""
        began_s, all_there_s = time.monotonic(), None
        while all_there_s is None or time.monotonic() < all_there_s + _JUDGED_S:
            time.sleep(0.05)
            with self._lock:
                types = Counter(type_ for _, type_ in self._came)
                topics = {message.topic for message, _ in self._came}
                size = sum(len(message.data) for message, _ in self._came)
            lacks = self._lacking(types, topics)
            if not lacks:
                all_there_s = all_there_s or time.monotonic()
            elif time.monotonic() > began_s + _BEGIN_S:
                there = ", ".join(sorted(self._listener.seen)) or "none"
                fix = "begin the drivers; ROS_DOMAIN_ID and CYCLONEDDS_URI must be those of them"
                raise DeviceError(f"no {lacks} came in {_BEGIN_S:g} s; topics of domain {_domain()}: {there}", fix=fix)
            if size > _MOST_BYTES:
                break

    def _lacking(self, types: Mapping[str, int], topics: set[str]) -> str:
        """What has not begun yet; "" if all has."""
        request = self._request
        if request.camera is not None and not (types.get(IMAGE) or types.get(COMPRESSED)):
            return f"images of topics under {request.camera or '/'}"
        has_file = any(path for path in request.files)
        if request.camera is not None and not types.get(_INFO) and not has_file:
            return f"CameraInfo under {request.camera or '/'}"
        named = (request.wheels or "").partition(":")[0].partition(",")[0]
        if named and named not in topics:
            return f"message of {named}"
        return ""

    def _open_sensors(self, settings: LiveCameraSettings) -> None:
        recording, warnings = self._recording, list(self._recording.warnings)
        if self._ahead_s:
            warnings.append(
                f"Stamps are of another clock, {self._ahead_s:.1f} s from this computer's: that is removed."
            )
        self.calibration, self.warnings = recording.calibration, tuple(warnings)
        used = {topic.used_as: topic.name for topic in recording.topics if topic.used_as}
        images = {name for role, name in used.items() if role in ("color", "depth")}
        readings = self._used - images
        self.camera: Ros2Camera | None = None
        self.link: Ros2Wheels | None = None
        threads: list[tuple[set[str], Callable[[Event], None], bool]] = []
        if images:
            name = f"the topics {' and '.join(sorted(images))} of ROS 2"
            self.camera = Ros2Camera(name, self.calibration, self.warnings, settings)
            threads.append((images, self._give_frame, True))
        if self._request.wheels is not None and readings:
            self.link = Ros2Wheels(f"ros2:{used.get('wheels', '')}")
            threads.append((readings, self._give_reading, False))
        for topics, give, of_images in threads:
            waiting: queue.Queue[Message | None] = queue.Queue(_MOST_IMAGES if of_images else _MOST_READINGS)
            for topic in topics:
                # A transform of tf is a topic of its own in the bag.
                self._queues[topic.partition(":")[0]] = waiting
            thread = threading.Thread(target=self._follow, args=(waiting, give, of_images), daemon=True)
            thread.start()
            self._opened.callback(thread.join, 5.0)
        self._listener.keep(set(self._queues))

    def _follow(self, waiting: queue.Queue[Message | None], give: Callable[[Event], None], images: bool) -> None:
        """A thread: messages become events."""

        def come(topics: Sequence[str]) -> Iterator[Message]:
            while not self._is_over.is_set() and (message := waiting.get()) is not None:
                yield from self._bag.served(message, topics)

        for event in self._recording.live(self._bag, come, images=images):
            give(event)

    def _give_frame(self, event: Event) -> None:
        if self.camera is not None and isinstance(event, RgbdFrame | SkippedFrame):
            self.camera.give(replace(event, stamp_s=event.stamp_s + self._ahead_s), event.stamp_s)

    def _give_reading(self, event: Event) -> None:
        if self.link is not None and isinstance(event, WheelReading | YawRate):
            self.link.give(replace(event, stamp_s=event.stamp_s + self._ahead_s))


def open_ros2_sensors(
    camera: str | None, wheels: str, settings: LiveCameraSettings, files: Sequence[StrPath]
) -> Ros2Sensors:
    """The sensors of `--camera` and `--wheels ros2:…`. Raises as `Ros2Sensors`."""
    if camera is not None and not camera.startswith(f"{PREFIX}:"):
        fix = (
            "--camera ros2:/camera: only stamps of one clock can be judged together; or record both by ros2 bag record"
        )
        raise ConfigError(f"wheels of ROS 2 do not go with --camera {camera}", fix=fix)
    prefix = None if camera is None else camera.partition(":")[2]
    request = Ros2Request(prefix, wheels.partition(":")[2], settings.topics, tuple(files))
    return Ros2Sensors(request, settings)


def open_ros2_camera(where: str | None, settings: LiveCameraSettings, calibration: Calibration | None) -> Ros2Camera:
    """A camera alone, an opener of `LIVE_CAMERAS`: `ros2:/camera`. Raises as `Ros2Sensors`."""
    if where is None:
        raise DeviceError("no topics are named", fix="--camera ros2:/camera")
    with tempfile.TemporaryDirectory(prefix="wheelsight-ros2-") as folder:
        files: tuple[StrPath, ...] = ()
        if calibration is not None:
            files = (Path(folder) / "camera.yaml",)
            save_calibration(calibration, files[0])
        sensors = Ros2Sensors(Ros2Request(where, None, settings.topics, files), settings)
    if sensors.camera is None:
        sensors.close()
        raise DeviceError(f"topics under {where} have no colour with depth", fix="--topic color=… depth=…")
    sensors.camera.on_close = sensors.close
    return sensors.camera


def _domain() -> int:
    """ROS_DOMAIN_ID, 0 without it. Raises ConfigError."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal():
        raise ConfigError(f"ROS_DOMAIN_ID is {text!r}", fix="a number from 0 to 232")
    return int(text)


def _write(came: Sequence[tuple[Message, str]], folder: Path) -> None:
    """Write messages as a bag, `folder/bag`."""
    rosbag2, types = needed("rosbags.rosbag2"), Messages(is_ros1=False).types
    with rosbag2.Writer(folder / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for message, type_ in came:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(message.topic, type_, typestore=types)
            writer.write(connections[message.topic], message.receipt_ns, message.data)
