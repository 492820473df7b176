"""Each millisecond of a frame is in a named stage, in no more than one."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from grids import mostly_slow
from room_drive import make_room_drive

from wheelsight import Localizer, RgbdFrame, load_config, open_recording
from wheelsight.core import threads
from wheelsight.core.threads import Stopwatch

# The largest share of a frame that is in no stage.
UNNAMED = 0.03
WAYS: dict[str, dict[str, object]] = {
    "features": {"odometry": "features"},
    "dense with a map and loops": {"odometry": "dense", "map": "surfels", "loops": {"source": "keyframes"}},
    "joined": {"odometry": "wheels,dense"},
    "joined with a map and loops": {"odometry": "wheels,dense", "map": "surfels", "loops": {"source": "keyframes"}},
}


@pytest.mark.parametrize("way", mostly_slow(WAYS, ["joined with a map and loops"]))
def test_stages_of_a_frame_sum_up_to_the_whole(way: str, tmp_path: Path) -> None:
    """Of processor time of the thread, which other programs do not change, over all frames but the first ones."""
    make_room_drive(tmp_path / "drive")
    recording, whole_s, named_s = open_recording(tmp_path / "drive"), 0.0, 0.0
    with Localizer(recording.calibration, load_config(overrides=WAYS[way]), waits=True) as localizer:
        for event in recording.events():
            began_s, began_used_s = time.perf_counter(), time.thread_time()
            localizer.process(event)
            used_s, wall_s = time.thread_time() - began_used_s, time.perf_counter() - began_s
            if isinstance(event, RgbdFrame) and event.index > 2:
                whole_s, named_s = whole_s + used_s, named_s + sum(localizer.stage_processor_seconds.values())
                assert sum(localizer.stage_seconds.values()) <= wall_s
    assert (1 - UNNAMED) * whole_s <= named_s <= whole_s


class Clock:
    """Time that passes on command: the thread works for half of it."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def perf_counter(self) -> float:
        return self.now_s

    def thread_time(self) -> float:
        return self.now_s / 2


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(threads, "time", made)
    return made


def test_time_of_a_nested_stage_counts_once(clock: Clock) -> None:
    watch = Stopwatch()
    with watch.stage("outer"):
        clock.now_s += 1.0
        for _ in range(2):
            with watch.stage("inner"):
                clock.now_s += 4.0
        clock.now_s += 2.0
    assert watch.seconds == {"inner": 8.0, "outer": 3.0}
    assert watch.processor_seconds == {"inner": 4.0, "outer": 1.5}


def test_laps_name_what_is_between_stages(clock: Clock) -> None:
    watch = Stopwatch()
    watch.begin_frame()
    clock.now_s += 1.0
    watch.lap("check")
    watch.restart()  # of an odometry within the frame
    with watch.stage("track"):
        clock.now_s += 2.0
    clock.now_s += 4.0
    watch.lap("decide", ends_frame=True)
    assert watch.seconds == {"check": 1.0, "track": 2.0, "decide": 4.0}
    before = watch.seconds
    watch.restart()
    assert watch.seconds == {} != before
