"""An hour of `run --live`: laps of a simulated house, with loops closed and a map built and written.

The drive is simulated and rendered by a process of its own, which hands over one event after the other: what this
process holds is the run's alone. The run is what `wheelsight run --live` does, its records and files included. Frames
come as fast as they are answered, so that an hour of the robot's takes as long as the computer needs for it.
"""

from __future__ import annotations

import multiprocessing
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from benchmarks.joined_hour import events_apart, hour_recording
from benchmarks.measure import keep_to
from benchmarks.table import Sheet
from benchmarks.targets import Target
from wheelsight.app.run import run_each
from wheelsight.app.run.kernels import DrawnDrive, Rehearses
from wheelsight.app.run.run_record import FrameRecord, RealTimeRecord
from wheelsight.app.run.track import RunTrack
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Status
from wheelsight.core.messages import Event, RgbdFrame

SETTINGS = {"odometry": "wheels,dense", "map": "surfels", "loops.source": "keyframes"}
HOUR_MB, SLOWER_PERCENT = 1000.0, 10.0
HEADER = (
    "minute",
    "the process holds",
    "of its own",
    "a frame",
    "a wheel reading",
    "keyframes",
    "surfels in memory",
    "on the disk",
    "tracking",
)


@dataclass(frozen=True, slots=True)
class Minute:
    """A minute of the robot's time.

    Attributes:
        number: from 1 on.
        memory_mb, own_mb: what the process holds at its end, megabytes of 10⁶ bytes; without what is read from files.
        frame_ms, reading_ms: medians of the processor time of all threads from one event to the next.
        keyframes: so far.
        surfels, resting: in memory and on the disk, at its end.
        tracked: share of the frames that were answered with `tracking`.
    """

    number: int
    memory_mb: float
    own_mb: float
    frame_ms: float
    reading_ms: float
    keyframes: int
    surfels: int
    resting: int
    tracked: float

    @property
    def row(self) -> tuple[str, ...]:
        """Of the table."""
        times = f"{self.frame_ms:.1f} ms", f"{self.reading_ms:.2f} ms"
        counts = f"{self.keyframes:,}", f"{self.surfels:,}", f"{self.resting:,}"
        memory = f"{self.memory_mb:.0f} MB", f"{self.own_mb:.0f} MB"
        return f"{self.number}", *memory, *times, *counts, f"{100 * self.tracked:.0f} %"


@dataclass(frozen=True, slots=True)
class Hour:
    """A drive.

    Attributes:
        minutes: those that were driven to their end.
        start_mb: what the process held before the first event, kernels loaded.
        peak_mb: the most that it ever held, when results were written too.
        not_compared: keyframes that the loop thread had no time for.
        loops: that were kept.
    """

    minutes: tuple[Minute, ...]
    start_mb: float
    peak_mb: float
    not_compared: int
    loops: int


Send = Callable[[float, Connection], None]


def send_drive(minutes: float, connection: Connection) -> None:
    """The other process: the calibration, all events of a drive, and None."""
    recording = hour_recording(minutes)
    connection.send(recording.calibration)
    for event in events_apart(recording):
        connection.send(event)
    connection.send(None)


class PipedDrive:
    """Events of another process, as a live source; one is on its way while another is answered.

    Args:
        minutes: of the drive.
        send: what the other process does.

    Attributes:
        start_mb: what this process held when the first event was asked for.
        spent_s: of processor time that each frame (True) and each reading took since the last minute ended.
    """

    name, warnings = "simulated drive", ()

    def __init__(self, minutes: float, send: Send = send_drive) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe(duplex=False)
        self._process = context.Process(target=send, args=(minutes, theirs), daemon=True)
        self._process.start()
        theirs.close()
        self.calibration: Calibration = self._connection.recv()
        self.spent_s: dict[bool, list[float]] = {True: [], False: []}
        self.start_mb = float("nan")
        self._frames = self._readings = 0

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """As they come. Raises EOFError where the other process has died."""
        self.start_mb = memory_of("Rss")
        while (event := self._connection.recv()) is not None:
            is_frame = isinstance(event, RgbdFrame)
            self._frames += is_frame
            self._readings += not is_frame
            begin_s = time.process_time()
            yield event
            self.spent_s[is_frame].append(time.process_time() - begin_s)
        self._process.join()

    def rehearsals(self) -> tuple[Rehearses, ...]:
        """The one of a live source: kernels are loaded before the first event."""
        return (DrawnDrive(self.calibration),)

    def report(self) -> RealTimeRecord:
        """That none was dropped."""
        return RealTimeRecord(0.0, self._frames, 0, 0, self._readings, is_live=True)

    def lately(self) -> None:
        """Nothing: frames come as fast as they are answered."""
        return

    @property
    def frames_so_far(self) -> tuple[int, int]:
        """All, and none dropped."""
        return self._frames, 0

    @property
    def is_missing_wheels(self) -> bool:
        """Never."""
        return False


@dataclass
class MinuteWatcher:
    """A `Watcher` of a run: looks at the end of each minute what the process holds.

    Args:
        source: of the run.
        tell: called with each minute.
        minute_s: how long one is.
    """

    source: PipedDrive
    tell: Callable[[Minute], None]
    minute_s: float = 60.0
    minutes: list[Minute] = field(default_factory=list)
    _begin_s: float | None = None
    _tracked: list[bool] = field(default_factory=list)

    def step(self, event: Event, answers: Mapping[str, FrameRecord], tracks: Sequence[RunTrack]) -> None:
        """After each event that was answered."""
        self._begin_s = event.stamp_s if self._begin_s is None else self._begin_s
        if not isinstance(event, RgbdFrame):
            return
        self._tracked.append(answers["joined"].status is Status.TRACKING)
        if event.stamp_s - self._begin_s < self.minute_s * (len(self.minutes) + 1):
            return
        self.minutes.append(self._minute(next(track for track in tracks if track.odometry == "joined")))
        self.tell(self.minutes[-1])
        self.source.spent_s = {True: [], False: []}
        self._tracked = []

    def finish(self, tracks: Sequence[RunTrack]) -> None:
        """See `Watcher`."""

    def _minute(self, track: RunTrack) -> Minute:
        of_map, store = track.localizer.map, track.localizer.keyframes
        assert of_map is not None
        assert store is not None
        frame_ms, reading_ms = (1e3 * float(np.median(self.source.spent_s[kind])) for kind in (True, False))
        alive = of_map.blocks.alive
        counts = len(store), alive, len(of_map) - alive
        memory = memory_of("Rss"), memory_of("Anonymous")
        return Minute(len(self.minutes) + 1, *memory, frame_ms, reading_ms, *counts, float(np.mean(self._tracked)))


def memory_of(what: str) -> float:
    """What this process holds now, megabytes of 10⁶ bytes, by the system's name for it; nan where it does not say."""
    rollup = Path("/proc/self/smaps_rollup")
    found = re.search(rf"^{what}:\s*(\d+) kB", rollup.read_text(), re.MULTILINE) if rollup.exists() else None
    return int(found[1]) * 1024 / 1e6 if found else float("nan")


def peak_mb() -> float:
    """The most that this process has held so far."""
    status = Path("/proc/self/status")
    found = re.search(r"^VmHWM:\s*(\d+) kB", status.read_text(), re.MULTILINE) if status.exists() else None
    return int(found[1]) * 1024 / 1e6 if found else float("nan")


def drive_hour(minutes: float, tell: Callable[[Minute], None], send: Send = send_drive, minute_s: float = 60.0) -> Hour:
    """Drive in this process; `tell` hears of each minute as it ends."""
    source = PipedDrive(minutes, send)
    watcher = MinuteWatcher(source, tell, minute_s)
    with tempfile.TemporaryDirectory() as out:
        records = run_each(source, load_config(overrides=SETTINGS), out, force=True, watcher=watcher)
    (joined,) = (record for record in records if record.odometry == "joined")
    closed = joined.correction
    unseen, kept = (0, 0) if closed is None else (closed.unseen, len(closed.found.loops.kept))
    return Hour(tuple(watcher.minutes), source.start_mb, peak_mb(), unseen, kept)


def driven_apart(minutes: float) -> Hour:
    """Drive in a process that has done nothing else before."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_drive_and_print, minutes).result()


def _drive_and_print(minutes: float) -> Hour:
    keep_to(2)
    return drive_hour(minutes, lambda minute: print(" · ".join(minute.row), flush=True))


def hour_sheets(hour: Hour) -> list[Sheet]:
    """Minute by minute, and what there is to say of all."""
    rows = (
        ("the process holds before the first event", f"{hour.start_mb:.0f} MB"),
        ("it held at most, when results were written", f"{hour.peak_mb:.0f} MB"),
        ("loops kept", f"{hour.loops:,}"),
        ("keyframes not compared for want of time", f"{hour.not_compared:,}"),
    )
    title = f"Laps of floor4 for {len(hour.minutes)} minutes"
    return [
        Sheet(f"{title}, by minutes", HEADER, tuple(minute.row for minute in hour.minutes)),
        Sheet(f"{title}, in all", ("", "measured"), rows),
    ]


def judge_hour(hour: Hour) -> Iterator[Target]:
    """Memory, and a frame's time from the second quarter, when each place has been seen, to the last."""
    count = len(hour.minutes)
    held_mb = max(minute.memory_mb for minute in hour.minutes)
    yield Target(f"memory in {count} minutes with loops and a map", HOUR_MB, held_mb, "MB", 0)
    yield Target(f"memory in {count} minutes, and when results were written", HOUR_MB, hour.peak_mb, "MB", 0)
    quarter = count // 4
    if quarter:
        early, late = hour.minutes[quarter : 2 * quarter], hour.minutes[-quarter:]
        early_ms, late_ms = (float(np.median([minute.frame_ms for minute in part])) for part in (early, late))
        what = f"time of a frame in {count} minutes, from the second quarter to the last"
        yield Target(what, SLOWER_PERCENT, 100 * (late_ms / early_ms - 1), "%")
