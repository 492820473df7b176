"""One contender over one recording, in a process of its own: `python -m benchmarks.measure …`, started by run.py."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import contenders
from benchmarks.contenders import Tracker
from wheelsight.core.calibration import Calibration
from wheelsight.core.files import write_text
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory, write_tum
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.io.recordings.image_recording import ImageRecording

THREADS = 2
_WARM_UP_FRAMES = 5


class Feed(StrEnum):
    """How frames reach the tracker.

    decoded: all are decoded and prepared before the first is timed, so that nothing else runs.
    streamed: as on a robot, each decoded while its forerunner is tracked; for memory and the sustained rate.
    """

    DECODED = "decoded"
    STREAMED = "streamed"


@dataclass(frozen=True, slots=True)
class Passage:
    """What one pass gave.

    Attributes:
        stamps_s: of all frames handed to the tracker, seconds.
        seconds: for each, spent in `track`; with `streamed`, and waiting for the frame to be decoded.
        peak_memory_mb: of the whole process, megabytes of 10⁶ bytes.
    """

    stamps_s: list[float]
    seconds: list[float]
    peak_memory_mb: float


def measure(
    start: Callable[[Calibration], Tracker], recording: Recording, feed: Feed, limit: int | None = None
) -> tuple[Passage, Trajectory]:
    """Run a fresh tracker over the first `limit` frames; the trajectory is T_odom_camera of frames with a pose."""
    frames = itertools.islice((event for event in recording.events() if isinstance(event, RgbdFrame)), limit)
    tracker = start(recording.calibration)
    if feed is Feed.STREAMED:
        return _timed(tracker, ((frame.stamp_s, frame) for frame in frames), tracker.prepare)
    prepared = [(frame.stamp_s, tracker.prepare(frame)) for frame in frames]
    warm = start(recording.calibration)
    for _, frame in prepared[:_WARM_UP_FRAMES]:
        warm.track(frame)
    return _timed(tracker, iter(prepared), lambda frame: frame)


def _timed(
    tracker: Tracker, frames: Iterator[tuple[float, Any]], prepare: Callable[[Any], Any]
) -> tuple[Passage, Trajectory]:
    """Track all frames; a frame's seconds are those waited for it and those in `track`, not those in `prepare`."""
    passage = Passage([], [], 0.0)
    known_s: list[float] = []
    poses: list[FloatArray] = []
    while True:
        asked = time.perf_counter()
        stamp_s, frame = next(frames, (None, None))
        got = time.perf_counter()
        if stamp_s is None:
            return replace(passage, peak_memory_mb=peak_memory_mb()), _trajectory(known_s, poses)
        prepared = prepare(frame)
        begun = time.perf_counter()
        T_odom_camera = tracker.track(prepared)
        passage.seconds.append(time.perf_counter() - begun + got - asked)
        passage.stamps_s.append(stamp_s)
        if T_odom_camera is not None:
            known_s.append(stamp_s)
            poses.append(np.array(T_odom_camera, float))


def _trajectory(stamps_s: list[float], poses: list[FloatArray]) -> Trajectory:
    """Poses whose rotations are exactly orthonormal; products of hundreds of motions no longer are."""
    T = np.array(poses).reshape(-1, 4, 4)
    return Trajectory(np.array(stamps_s), se3.from_parts(so3.nearest(T[:, :3, :3]), T[:, :3, 3]))


def there_and_back(recording: Recording) -> Recording:
    """The recording's frames, and then the same backwards at their own pace: twice as many, and no truth."""
    assert isinstance(recording, ImageRecording), "frames are read by their number"
    frames = recording.frames
    step_s = frames[-1].stamp_s - frames[-2].stamp_s
    turned_s = 2 * frames[-1].stamp_s + step_s
    back = tuple(replace(frame, stamp_s=turned_s - frame.stamp_s) for frame in reversed(frames))
    return replace(recording, frames=frames + back, ground_truth=None, wheels=(), yaw_rates=())


def peak_memory_mb() -> float:
    """The most memory this process has held so far, megabytes of 10⁶ bytes.

    Linux's VmHWM counts from the start of this program; ru_maxrss would also count the one that started it.
    """
    status = Path("/proc/self/status")
    found = re.search(r"^VmHWM:\s*(\d+) kB", status.read_text(), re.MULTILINE) if status.exists() else None
    if found:
        return int(found[1]) * 1024 / 1e6
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def keep_to(threads: int) -> None:
    """Hold all libraries to so many threads and cores; run.py has set the variables they read when they start."""
    import cv2

    cv2.setNumThreads(threads)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])


def main() -> None:
    """Measure what the command line names; write passage.json and trajectory.txt into its folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("contender")
    parser.add_argument("recording", type=Path)
    parser.add_argument("feed", type=Feed)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--threads", type=int, default=THREADS)
    parser.add_argument("--there-and-back", action="store_true")
    arguments = parser.parse_args()
    keep_to(arguments.threads)
    contender = contenders.named(arguments.contender)
    recording = open_recording(arguments.recording)
    if arguments.there_and_back:
        recording = there_and_back(recording)
    passage, trajectory = measure(contender.start, recording, arguments.feed, arguments.frames)
    write_tum(trajectory, arguments.folder / "trajectory.txt")
    write_text(arguments.folder / "passage.json", json.dumps(asdict(passage)))


if __name__ == "__main__":
    main()
