"""A drive rendered beforehand, played there and back in real time as a robot that does not mind what it is reported."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import Event, RgbdFrame, VelocityCommand, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.navigation import planar_pose
from wheelsight_sim import SimulatedRecording
from wheelsight_sim.simulator import PERIOD_S

_AHEAD = 8


@dataclass(frozen=True, eq=False)
class PlayedDrive:
    """On disk, so that memory holds a few frames of it.

    Attributes:
        folder: of images, one file each.
        events: in order from 0 s on; frames without their images.
        seconds: how long it is.
        way: (N, 3) x, y, yaw of the base from where it began, all `way_s`.
        way_s: (N,) seconds.
        calibration: of the robot.
    """

    folder: Path
    events: tuple[Event, ...]
    seconds: float
    way: FloatArray
    way_s: FloatArray
    calibration: Calibration

    def there_and_back(self) -> Iterator[Event]:
        """For ever, with images: wheels count back on the way back, and frames come at their own pace."""
        lap = 0
        while True:
            begin_s = 2 * self.seconds * lap
            for event in self.events:
                yield self._shown(event, begin_s + event.stamp_s, lap)
            for event in reversed(self.events):
                yield self._shown(event, begin_s + 2 * self.seconds - event.stamp_s, lap)
            lap += 1

    def is_back(self, now_s: float) -> bool:
        """Whether it is on its way back then."""
        return now_s % (2 * self.seconds) >= self.seconds

    def way_ahead(self, now_s: float) -> FloatArray:
        """(N, 3) from then on to where it turns."""
        phase_s = now_s % (2 * self.seconds)
        if self.is_back(now_s):
            return self.way[self.way_s <= 2 * self.seconds - phase_s][::-1]
        return self.way[self.way_s >= phase_s]

    def _shown(self, event: Event, stamp_s: float, lap: int) -> Event:
        if not isinstance(event, RgbdFrame):
            return replace(event, stamp_s=stamp_s)
        images = np.load(self.folder / f"{event.index}.npz")
        return RgbdFrame(stamp_s, images["color"], images["depth_m"], lap * len(self.events) + event.index)


def rendered(recording: SimulatedRecording, folder: Path) -> PlayedDrive:
    """Render a recording into a folder, if it is not there already."""
    index = folder / "events.npz"
    if not index.exists():
        folder.mkdir(parents=True, exist_ok=True)
        events = [
            _put_aside(event, folder) for event in recording.events() if isinstance(event, RgbdFrame | WheelTicks)
        ]
        frames = [(event.stamp_s, event.index) for event in events if isinstance(event, RgbdFrame)]
        ticks = [(event.stamp_s, event.left, event.right) for event in events if isinstance(event, WheelTicks)]
        # Last, so that what was broken off is rendered again.
        np.savez(index, frames=np.array(frames), ticks=np.array(ticks))
    return played_of(recording.ground_truth, recording.calibration, folder)


def _put_aside(event: RgbdFrame | WheelTicks, folder: Path) -> RgbdFrame | WheelTicks:
    """Without its images, which are written."""
    if isinstance(event, WheelTicks):
        return event
    np.savez(folder / f"{event.index}.npz", color=event.color, depth_m=event.depth_m)
    return replace(event, color=event.color[:0], depth_m=event.depth_m[:0])


def played_of(truth: Trajectory, calibration: Calibration, folder: Path) -> PlayedDrive:
    """What was rendered before, from the truth's begin on."""
    begin_s = float(truth.stamps_s[0])
    with np.load(folder / "events.npz") as kept:
        frames, ticks = kept["frames"], kept["ticks"]
    nothing, black = np.zeros((0, 0), np.float32), np.zeros((0, 0, 3), np.uint8)
    events: list[Event] = [RgbdFrame(stamp_s - begin_s, black, nothing, int(number)) for stamp_s, number in frames]
    events += [WheelTicks(stamp_s - begin_s, int(left), int(right)) for stamp_s, left, right in ticks]
    ordered = sorted((event for event in events if event.stamp_s >= 0), key=lambda event: event.stamp_s)
    way = np.array([planar_pose(T) for T in np.linalg.inv(truth.T_frame_body[0]) @ truth.T_frame_body])
    way_s = np.asarray(truth.stamps_s) - begin_s
    # No event lies beyond where it turns.
    seconds = max(float(way_s[-1]), ordered[-1].stamp_s)
    return PlayedDrive(folder, tuple(ordered), seconds, way, way_s, calibration)


@dataclass
class Timing:
    """Of control periods.

    Attributes:
        worked_s: what each took from its sensors' readings to its command.
        processor_s: of that, what this thread reckoned, which other work on the machine does not make longer.
        late_s: how much later than due each began.
    """

    worked_s: list[float] = field(default_factory=list)
    processor_s: list[float] = field(default_factory=list)
    late_s: list[float] = field(default_factory=list)


class PlayedRobot:
    """A `Robot`: each step waits for the end of its period, and answers what was played meanwhile.

    Attributes:
        timing: of all periods so far.
    """

    stop_reason = ""

    def __init__(self, drive: PlayedDrive) -> None:
        self.calibration, self.timing = drive.calibration, Timing()
        self._read: queue.Queue[Event] = queue.Queue(_AHEAD * 4)
        self._next: Event | None = None
        self._is_closed = threading.Event()
        self._reader = threading.Thread(target=self._run, args=(drive,), name="played", daemon=True)
        self._reader.start()
        self.begin()

    @property
    def now_s(self) -> float:
        """As `Robot` has it."""
        return time.monotonic() - self._begin_s

    def begin(self) -> None:
        """Time begins now."""
        self._begin_s = self._released_s = self._due_s = time.monotonic()
        self._reckoned_s = time.thread_time()

    def step(self, command: VelocityCommand) -> list[Event]:
        """As `Robot` has it; a period that took too long is followed by the next at once."""
        asked_s = time.monotonic()
        self.timing.worked_s.append(asked_s - self._released_s)
        self.timing.processor_s.append(time.thread_time() - self._reckoned_s)
        self._due_s = max(self._due_s + PERIOD_S, asked_s)
        time.sleep(max(self._due_s - asked_s, 0.0))
        self._released_s = time.monotonic()
        self.timing.late_s.append(self._released_s - self._due_s)
        self._reckoned_s = time.thread_time()
        return self._until(self.now_s)

    def stop(self) -> None:
        """As `Robot` has it; it does not mind."""

    def close(self) -> None:
        """End the thread that reads."""
        self._is_closed.set()
        self._reader.join()

    def __enter__(self) -> PlayedRobot:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _until(self, now_s: float) -> list[Event]:
        found: list[Event] = []
        while True:
            if self._next is None:
                try:
                    self._next = self._read.get_nowait()
                except queue.Empty:
                    return found
            if self._next.stamp_s > now_s:
                return found
            found.append(self._next)
            self._next = None

    def _run(self, drive: PlayedDrive) -> None:
        for event in drive.there_and_back():
            while not self._is_closed.is_set():
                try:
                    self._read.put(event, timeout=0.1)
                    break
                except queue.Full:
                    continue
            if self._is_closed.is_set():
                return
