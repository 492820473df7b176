"""`python -m benchmarks.first_pose`: a live joined run after `ready`: when it knows its first pose, its slowest frame.

A simulated robot drives through a flat; frames are rendered beforehand at 640×480. A camera and a serial link that are
played then give them in their time to the source that `wheelsight run --live --map surfels --loops keyframes` goes by,
wheels and camera joined, each in a fresh process on two cores, kernels compiled before. "First pose" is the
time from `ready` to the first answer to a frame that has a pose and the status `tracking`; "slowest" the longest time
that a frame took, its wait not counted. What else the machine does makes both longer: the same frame's processor time
shows how much of it was ours.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.measure import keep_to
from benchmarks.run import child_environment
from benchmarks.sequences import PROJECT
from benchmarks.table import Sheet, targets_sheet, write_page
from benchmarks.targets import Target
from wheelsight.app.run import LiveSensors, LiveSource
from wheelsight.app.run.run_record import FrameRecord
from wheelsight.app.run.track import begin_all, follow
from wheelsight.config import load_config
from wheelsight.core.estimates import Status
from wheelsight.core.messages import RgbdFrame, WheelTicks
from wheelsight.io.devices import host_clock
from wheelsight.io.devices.live_camera import CameraReport, CameraStatus, LiveFrame
from wheelsight_sim import SimulatedRecording, SimulationSettings, simulate

FIRST_POSE_S, SLOWEST_MS = 3.0, 100.0
PROFILES: tuple[str, ...] = ("default", "pi")
SETTINGS = {"odometry": "wheels,dense", "map": "surfels", "loops.source": "keyframes"}
SECONDS, RATE_HZ, SEED = 20.0, 15.0, 2
HEADER = (
    "settings",
    "first pose s",
    "frames",
    "dropped",
    "median ms",
    "slowest ms",
    "its CPU ms",
    "which",
    "over 100 ms",
)


@dataclass(frozen=True, slots=True)
class Followed:
    """What one live run was like.

    Attributes:
        first_pose_s: after `ready`; None where there was none.
        frames, dropped: that came, and of them those that were not answered.
        median_ms, slowest_ms: of the time from a frame to its answer.
        slowest_cpu_ms: what the slowest frame took of processor time, all threads.
        slowest_at: how many were answered before the slowest.
        slow: how many took over 100 ms.
    """

    first_pose_s: float | None
    frames: int
    dropped: int
    median_ms: float
    slowest_ms: float
    slowest_cpu_ms: float
    slowest_at: int
    slow: int


class PlayedSensors:
    """A camera and a wheel controller at once, of a recording that begins on command.

    Before that the camera shows the first frame again and again, as of a robot that stands, and the wheels say nothing.
    """

    name, port, warnings = "played camera", "played wheels", ()

    def __init__(self, recording: SimulatedRecording) -> None:
        self._frames = [recording.renderer.frame(index) for index in range(recording.frame_count)]
        self._ticks = list(recording.drive.ticks)
        self._first_s = min(self._frames[0].stamp_s, self._ticks[0].stamp_s)
        self._begin_s: float | None = None
        self._frame = self._tick = 0

    def begin(self) -> None:
        """From now on time runs."""
        self._begin_s = host_clock.now_s()

    @property
    def is_over(self) -> bool:
        """Whether all frames were given."""
        return self._frame == len(self._frames)

    def camera_read(self, timeout_s: float) -> LiveFrame | None:
        """The next frame whose time has come."""
        now_s = host_clock.now_s()
        if self._begin_s is None:
            # Anyone who does not wait empties what has come, and there would always be one more.
            return _live(self._frames[0], now_s, now_s) if timeout_s > 0 else None
        if self.is_over or (stamp_s := self._host_s(self._frames[self._frame].stamp_s)) > now_s:
            return None
        self._frame += 1
        return _live(self._frames[self._frame - 1], stamp_s, now_s)

    def link_read(self, timeout_s: float) -> WheelTicks | None:
        """The next reading whose time has come; waits for it."""
        if self._begin_s is None or self._tick == len(self._ticks):
            return None
        ticks = self._ticks[self._tick]
        wait_s = self._host_s(ticks.stamp_s) - host_clock.now_s()
        if wait_s > timeout_s:
            time.sleep(timeout_s)
            return None
        time.sleep(max(wait_s, 0.0))
        self._tick += 1
        return WheelTicks(self._host_s(ticks.stamp_s), ticks.left, ticks.right)

    def report(self) -> CameraReport:
        """It streams until all was given."""
        status = CameraStatus.ENDED if self.is_over else CameraStatus.STREAMING
        return CameraReport(status, self._begin_s or 0.0, frames=self._frame)

    def _host_s(self, stamp_s: float) -> float:
        return (self._begin_s or 0.0) + stamp_s - self._first_s


@dataclass
class _Part:
    """The camera's or the link's side of `PlayedSensors`."""

    sensors: PlayedSensors
    read: Any

    def __getattr__(self, name: str) -> Any:
        return getattr(self.sensors, name)


def _live(frame: RgbdFrame, stamp_s: float, now_s: float) -> LiveFrame:
    return LiveFrame(RgbdFrame(stamp_s, frame.color, frame.depth_m, frame.index), 0.0, None, now_s, frame.index)


class Watch:
    """Notes when the run was ready, and what each frame's answer was and took."""

    def __init__(self) -> None:
        self.ready_s = self._cpu_s = 0.0
        self.first_pose_s: float | None = None
        self.frame_s: list[float] = []
        self.cpu_s: list[float] = []

    def ready(self) -> None:
        """All is loaded."""
        self.ready_s, self._cpu_s = time.perf_counter(), time.process_time()

    def answer(self, record: FrameRecord) -> None:
        """One frame was answered."""
        now_s, cpu_s = time.perf_counter(), time.process_time()
        self.frame_s.append(record.seconds)
        self.cpu_s.append(cpu_s - self._cpu_s)
        self._cpu_s = cpu_s
        if self.first_pose_s is None and record.status is Status.TRACKING:
            self.first_pose_s = now_s - self.ready_s


def followed(profile: str, seconds: float) -> Followed:
    """One live run in this process."""
    settings = SimulationSettings("flat", size=(640, 480), rate_hz=RATE_HZ, duration_s=seconds, seed=SEED)
    recording = simulate(settings)
    sensors, watch = PlayedSensors(recording), Watch()
    config = load_config(overrides={**SETTINGS, "profile": None if profile == PROFILES[0] else profile})

    def ready() -> None:
        watch.ready()
        sensors.begin()

    camera, link = (_Part(sensors, read) for read in (sensors.camera_read, sensors.link_read))
    live = LiveSensors(recording.calibration, cast(Any, camera), cast(Any, link))
    source = LiveSource(live, _endless, ready)

    tracks = begin_all(source, config, None)
    (joined,) = (track for track in tracks if track.odometry == "joined")

    def look(answers: Any) -> None:
        # Readings are answered too; frames alone are kept.
        if len(joined.frames) > len(watch.frame_s):
            watch.answer(answers[joined.odometry])

    passage = follow(tracks, source, config, look)
    if passage.interruption is not None:
        raise passage.interruption
    frames_ms, (came, dropped) = 1e3 * np.array(watch.frame_s), source.frames_so_far
    slowest = int(np.argmax(frames_ms))
    times = float(np.median(frames_ms)), float(frames_ms[slowest]), 1e3 * watch.cpu_s[slowest]
    slow = int(np.count_nonzero(frames_ms > SLOWEST_MS))
    return Followed(watch.first_pose_s, came, dropped, *times, slowest, slow)


@contextmanager
def _endless() -> Iterator[Any]:
    yield lambda: False


def row(profile: str, one: Followed) -> tuple[str, ...]:
    """Of the table."""
    first = "—" if one.first_pose_s is None else f"{one.first_pose_s:.2f}"
    times = f"{one.median_ms:.1f}", f"{one.slowest_ms:.1f}", f"{one.slowest_cpu_ms:.1f}"
    return profile, first, str(one.frames), str(one.dropped), *times, str(one.slowest_at), str(one.slow)


def judge(found: Sequence[tuple[str, Followed]]) -> list[Target]:
    """What must be reached."""
    targets = []
    for profile, one in found:
        targets.append(Target(f"{profile}: first pose after ready", FIRST_POSE_S, one.first_pose_s, "s", 2))
        targets.append(Target(f"{profile}: the slowest frame after ready", SLOWEST_MS, one.slowest_ms, "ms"))
    return targets


def in_a_fresh_process(profile: str, seconds: float) -> Followed:
    """Kernels are loaded once in a process: the second run in one would find them there.

    Raises RuntimeError with the last line of what went wrong.
    """
    command = [sys.executable, "-m", "benchmarks.first_pose", "--one", profile, "--seconds", str(seconds)]
    ended = subprocess.run(command, cwd=PROJECT, env=child_environment(), capture_output=True, text=True, check=False)
    if ended.returncode:
        raise RuntimeError((ended.stderr.strip().splitlines() or ["ended badly"])[-1])
    return Followed(**json.loads(ended.stdout.splitlines()[-1]))


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.first_pose", description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of the drive")
    parser.add_argument("--one", choices=PROFILES, help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    keep_to(2)
    if arguments.one is not None:
        print(json.dumps(asdict(followed(arguments.one, arguments.seconds))))
        return
    about, console = machine.description(), Console(width=150)
    about["Command"] = f"`python -m benchmarks.first_pose --seconds {arguments.seconds:g}`"
    found = [(profile, in_a_fresh_process(profile, arguments.seconds)) for profile in PROFILES]
    rows = tuple(row(profile, one) for profile, one in found)
    sheets = [Sheet("Live, joined, on two cores", HEADER, rows), targets_sheet(judge(found))]
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_page(arguments.out, "After ready", __doc__ or "", about, sheets)


if __name__ == "__main__":
    main()
