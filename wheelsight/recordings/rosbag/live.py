"""LiveBag: what live sensors say, into an MCAP file that a kill cuts off but does not spoil."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.checks import check_event, check_images
from wheelsight.errors import CalibrationError, OutputError, RecordingError
from wheelsight.events import AngularVelocity, Event, RgbdFrame, SkippedFrame, WheelTicks
from wheelsight.files import StrPath, output_error
from wheelsight.geometry.arrays import UInt16Array
from wheelsight.recordings.frame_clocks import FrameClock
from wheelsight.recordings.rosbag.robot_topics import ImageForm, RobotTopics, Sent
from wheelsight.recordings.rosbag.writing import growing_bag
from wheelsight.stamps import StampCheck

THREAD = "wheelsight-bag"


@dataclass(frozen=True, slots=True, eq=False)
class EncodedFrame:
    """A frame as messages that are not in the bag yet.

    Attributes:
        stamp_s: of the frame.
        messages: topic, type and bytes.
        size_bytes: of all.
    """

    stamp_s: float
    messages: tuple[tuple[str, str, bytes], ...]
    size_bytes: int


class LiveBag:
    """Writes events into an MCAP file as they come. What is older than `flush_s` outlives the program.

    Several threads may `write_frame` at once; another may `add` readings meanwhile.

    Args:
        path: of the file, which must not be there.
        calibration: of the robot; it is kept in the bag.
        images: how images are kept; see `RobotTopics`.
        flush_s: seconds between two times that all is handed to the system.

    Attributes:
        folder: where the file lies.
        frames, readings: how many it has by now.

    Raises:
        CalibrationError: there is none: of ticks alone no reader knows what a turn is.
        ConfigError: rosbags is not installed, or the name does not end in .mcap.
        OutputError: the file cannot be made.
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
        self._flush_s = flush_s
        self._thread = threading.Thread(target=self._flush, name=THREAD, daemon=True)
        self._thread.start()

    @property
    def last_stamp_s(self) -> float:
        """The newest of all sensors; -∞ before the first."""
        return max(self._last_stamp_s.values(), default=-np.inf)

    def check(self, event: Event) -> None:
        """Refuse what cannot be read again. Raises ArgumentError, RecordingError."""
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
        """Write one event; skipped frames leave no trace. Raises as `check`, and OutputError."""
        if isinstance(event, SkippedFrame):
            return
        self.check(event)
        if isinstance(event, RgbdFrame):
            self.list_frame(self.write_frame(event))
            return
        self._write([self._encoded(sent) for sent in self._robot.of_event(event)], event.stamp_s)
        self.readings += isinstance(event, WheelTicks)

    def add_angular_velocity(self, turn: AngularVelocity) -> None:
        """Write what the camera's gyroscope tells of the base, as its yaw rate. Raises as `add`."""
        T_base_camera = self._calibration.T_base_camera
        if T_base_camera is None:
            problem = "its gyroscope tells nothing of the base while nobody knows where the camera sits"
            raise RecordingError(problem, path=self._path, fix="wheelsight calibrate base finds T_base_camera")
        self.add(turn.yaw_rate(np.asarray(T_base_camera)))

    def write_frame(self, frame: RgbdFrame, infrared: UInt16Array | None = None) -> EncodedFrame:
        """Encode the images of a frame that was checked; infrared is left out."""
        messages = tuple(self._encoded(sent) for sent in self._robot.of_frame(frame))
        return EncodedFrame(frame.stamp_s, messages, sum(len(data) for _, _, data in messages))

    def list_frame(self, written: EncodedFrame, clock: FrameClock | None = None) -> None:
        """Append the images of a frame; a bag has no room for its clock. Raises OutputError."""
        self._write(written.messages, written.stamp_s)
        self.frames += 1

    def close(self) -> None:
        """Add the index; without it the file is read all the same, only slower. Raises OutputError."""
        self._is_over.set()
        self._thread.join()
        opened, cause = self._opened.pop_all(), None if self._problem is None else self._problem.__cause__
        if cause is None:
            opened.close()
            return
        with suppress(OutputError):  # it was told when it happened
            opened.__exit__(type(cause), cause, cause.__traceback__)

    def _encoded(self, sent: Sent) -> tuple[str, str, bytes]:
        return sent.topic, sent.message.__msgtype__, self._bag.make.bytes_of(sent.message)

    def _write(self, messages: Iterable[tuple[str, str, bytes]], stamp_s: float) -> None:
        """Append messages, received in the order of writing: a file without an index is read in that alone."""
        with self._lock, self._told():
            if self._received_s == -np.inf:
                self._received_s = stamp_s
                for sent in self._robot.mounts(stamp_s):
                    self._bag.add_bytes(*self._encoded(sent), stamp_s, is_latched=True)
            self._received_s = max(self._received_s, stamp_s)
            for topic, type_, data in messages:
                self._bag.add_bytes(topic, type_, data, self._received_s)

    def _flush(self) -> None:
        """The thread: hand all to the system now and again."""
        while not self._is_over.wait(self._flush_s):
            with suppress(OutputError), self._lock, self._told():
                self._bag.flush()

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Once the disk is full nothing more is written: half a record would spoil what comes after."""
        if self._problem is not None:
            raise self._problem
        try:
            yield
        except OSError as error:
            problem = output_error(error, self._path)
            problem.__cause__ = error
            self._problem = problem
            raise problem from error
