"""Laps of `floor4` for an hour: whether memory or time per event grow while wheels and camera are joined.

An hour at 5 frames a second is 18,000 frames and 180,000 wheel readings. Most of the time goes into rendering.
"""

from __future__ import annotations

import heapq
import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.joined_cases import SIZE, robot_of
from benchmarks.joined_runs import JOINED, localizer_of
from benchmarks.measure import keep_to
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.core.estimates import Status
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.estimation import Localizer
from wheelsight_sim import SimulatedRecording, SimulationSettings, simulate
from wheelsight_sim.robot import TICK_PERIOD_S

_RATE_HZ, _SEED = 5.0, 1
_LAP_S = 140.0  # or somewhat longer
_QUARTERS = 4
_GROWTH_PERCENT = 10.0


@dataclass(frozen=True, slots=True)
class Quarter:
    """A quarter of the drive.

    Attributes:
        frame_ms, reading_ms: medians of the processor time that an event takes.
        memory_mb: what the process holds at its end, megabytes of 10⁶ bytes.
        tracked: share of the events answered with `tracking`.
    """

    frame_ms: float
    reading_ms: float
    memory_mb: float
    tracked: float


def drive_long(minutes: float, odometry: str = "dense") -> None:
    """Drive, and print what events took and what the process held, by quarters."""
    keep_to(2)
    recording = hour_recording(minutes)
    quarters = quarters_of(recording, localizer_of(JOINED, recording.calibration, odometry))
    console = Console(width=130)
    console.print(hour_sheet(quarters, minutes).to_rich())
    console.print(targets_sheet(judge_hour(quarters, minutes)).to_rich())


def hour_recording(minutes: float) -> SimulatedRecording:
    """Laps of `floor4`."""
    seconds = 60 * minutes
    laps = int(seconds / _LAP_S) + 1
    drive = SimulationSettings("floor4", size=SIZE, rate_hz=_RATE_HZ, laps=laps, duration_s=seconds, seed=_SEED)
    return simulate(replace(drive, robot=robot_of(_SEED), realism="real"))


def quarters_of(recording: SimulatedRecording, localizer: Localizer) -> list[Quarter]:
    """What the localizer's work took; rendering is not counted."""
    borders_s = recording.drive.duration_s * np.arange(1, _QUARTERS + 1) / _QUARTERS
    quarters: list[Quarter] = []
    frames_s: list[float] = []
    readings_s: list[float] = []
    tracked = 0
    total = len(recording.drive.ticks) + recording.frame_count
    for event in track(events_apart(recording), f"driving {recording.drive.duration_s / 60:g} minutes", total):
        begin = time.process_time()
        estimate = localizer.process(event)
        (frames_s if isinstance(event, RgbdFrame) else readings_s).append(time.process_time() - begin)
        tracked += estimate is not None and estimate.status is Status.TRACKING
        if event.stamp_s >= borders_s[len(quarters)] - TICK_PERIOD_S:
            share = tracked / (len(frames_s) + len(readings_s))
            medians = 1e3 * float(np.median(frames_s)), 1e3 * float(np.median(readings_s))
            quarters.append(Quarter(*medians, memory_mb(), share))
            frames_s, readings_s, tracked = [], [], 0
            if len(quarters) == _QUARTERS:
                break
    return quarters


def hour_sheet(quarters: Sequence[Quarter], minutes: float) -> Sheet:
    """A row a quarter."""
    rows = tuple(
        (
            f"{place}.",
            f"{q.frame_ms:.1f} ms",
            f"{q.reading_ms:.2f} ms",
            f"{q.memory_mb:.0f} MB",
            f"{100 * q.tracked:.1f} %",
        )
        for place, q in enumerate(quarters, 1)
    )
    heads = ("a frame", "a wheel reading", "the process holds", "tracking")
    return Sheet(f"Joined, laps of floor4 for {minutes:g} minutes, by quarters", ("quarter", *heads), rows)


def judge_hour(quarters: Sequence[Quarter], minutes: float) -> list[Target]:
    """From the second quarter on, when each place has been seen, nothing may grow."""
    _, early, *_, late = quarters
    what = f"joined, {minutes:g} minutes, from the second quarter to the last"
    return [
        Target(f"{what}: time of a frame", _GROWTH_PERCENT, 100 * (late.frame_ms / early.frame_ms - 1), "%"),
        Target(f"{what}: time of a reading", _GROWTH_PERCENT, 100 * (late.reading_ms / early.reading_ms - 1), "%"),
        Target(f"{what}: memory", _GROWTH_PERCENT, 100 * (late.memory_mb / early.memory_mb - 1), "%"),
    ]


def memory_mb() -> float:
    """What this process holds now, megabytes of 10⁶ bytes; nan where the system does not say."""
    status = Path("/proc/self/status")
    found = re.search(r"^VmRSS:\s*(\d+) kB", status.read_text(), re.MULTILINE) if status.exists() else None
    return int(found[1]) * 1024 / 1e6 if found else float("nan")


def events_apart(recording: SimulatedRecording) -> Iterator[Event]:
    """Frames made one by one, for none to be rendered while another is timed."""
    frames = map(recording.renderer.frame, range(recording.frame_count))
    return heapq.merge(recording.drive.ticks, frames, key=lambda event: event.stamp_s)
