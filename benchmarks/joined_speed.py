"""What joining costs: wheels and camera together at 640×480, beside each of them alone on the same events."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from benchmarks.joined_hour import events_apart
from benchmarks.joined_runs import CAMERA, JOINED, WHEELS, localizer_of
from benchmarks.table import Sheet
from benchmarks.targets import Target
from wheelsight import Localizer
from wheelsight.core.estimates import Status
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight_sim import SimulatedRecording, SimulationSettings, simulate

FRAMES_HZ, OVERHEAD_MS = 30.0, 0.5
_SIZE, _RATE_HZ, _SECONDS, _SEED = (640, 480), 30.0, 21.0, 1
# Kernels are loaded when they are first called, once in a process; that is measured apart.
_WARMING_S = 1.0
# Stages of camera and map; the others are of the localizer around them, or the rest.
_OF_CAMERA = ("extract", "recognise", "prepare", "predict", "align", "keyframe", "fuse")


@dataclass(slots=True)
class Spent:
    """What one localizer took for its events.

    Attributes:
        frames_s, readings_s: of each frame and each wheel reading, seconds.
        aside_s: of these for each frame, what no stage of camera or map took.
        tracked: how many were answered with `tracking`.
    """

    frames_s: list[float] = field(default_factory=list)
    readings_s: list[float] = field(default_factory=list)
    aside_s: list[float] = field(default_factory=list)
    tracked: int = 0

    def answer(self, event: Event, localizer: Localizer) -> None:
        """Time one event."""
        begin_s = time.perf_counter()
        estimate = localizer.process(event)
        spent_s = time.perf_counter() - begin_s
        if isinstance(event, RgbdFrame):
            self.frames_s.append(spent_s)
            stages_s = localizer.stage_seconds
            self.aside_s.append(spent_s - sum(stages_s.get(stage, 0.0) for stage in _OF_CAMERA))
        else:
            self.readings_s.append(spent_s)
        self.tracked += estimate is not None and estimate.status is Status.TRACKING

    @property
    def events(self) -> int:
        """How many there were."""
        return len(self.frames_s) + len(self.readings_s)

    @property
    def seconds(self) -> float:
        """For all of them."""
        return sum(self.frames_s) + sum(self.readings_s)

    @property
    def frames_hz(self) -> float:
        """Frames a second that all the work, wheel readings' too, leaves time for."""
        return len(self.frames_s) / self.seconds


def measure_joined_speed(seconds: float = _SECONDS) -> dict[str, Spent]:
    """Wheels, the camera and both, by name, along one drive; frames are rendered before the clock runs."""
    settings = SimulationSettings("flat", size=_SIZE, rate_hz=_RATE_HZ, duration_s=seconds, seed=_SEED)
    return spent_on(simulate(settings))


def spent_on(recording: SimulatedRecording) -> dict[str, Spent]:
    """What each localizer took for a recording's events after the first second, one event after the other."""
    localizers = {name: localizer_of(name, recording.calibration) for name in (WHEELS, CAMERA, JOINED)}
    spent = {name: Spent() for name in localizers}
    warm_s = float(recording.ground_truth.stamps_s[0]) + _WARMING_S
    for event in events_apart(recording):
        for name, localizer in localizers.items():
            if event.stamp_s < warm_s:
                localizer.process(event)
            else:
                spent[name].answer(event, localizer)
    return spent


def overhead_ms(spent: dict[str, Spent]) -> float:
    """What joining takes of an event, on average.

    Of a frame, what stages of camera and map do not take, beyond the same of the camera alone; of a reading, what
    wheels alone do not take. Not whole frames: the camera alone tracks against its map, which takes longer than
    keyframes do.
    """
    joined = spent[JOINED]
    seconds = sum(joined.aside_s) - sum(spent[CAMERA].aside_s)
    seconds += sum(joined.readings_s) - sum(spent[WHEELS].readings_s)
    return 1e3 * seconds / joined.events


def joined_speed_sheet(spent: dict[str, Spent]) -> Sheet:
    """A row a localizer."""
    rows = tuple(
        (
            name,
            f"{1e3 * np.median(s.frames_s):.2f}",
            f"{1e3 * np.percentile(s.frames_s, 95):.2f}",
            f"{1e3 * np.mean(s.aside_s):.2f}",
            f"{1e3 * np.mean(s.readings_s):.3f}",
            f"{s.frames_hz:.1f}",
            f"{100 * s.tracked / s.events:.1f} %",
        )
        for name, s in spent.items()
    )
    frames, readings = len(spent[JOINED].frames_s), len(spent[JOINED].readings_s)
    title = f"Joined: flat by kinect-v1, {frames:,} frames of 640×480 and {readings:,} wheel readings, two threads"
    heads = (
        "localizer",
        "frame ms",
        "95 % below ms",
        "beside stages ms",
        "reading ms",
        "frames/s with readings",
        "tracking",
    )
    return Sheet(title, heads, rows)


def judge_joined_speed(spent: dict[str, Spent]) -> list[Target]:
    """Frames a second of the joined system, and what joining adds to an event."""
    return [
        Target("joined, 640×480: frames/s", FRAMES_HZ, spent[JOINED].frames_hz, "/s", is_least=True),
        Target("joined, 640×480: time of joining, mean of all events", OVERHEAD_MS, overhead_ms(spent), "ms", 2),
    ]
