"""What closing loops costs while driving: how it is measured, and what it is held against."""

from __future__ import annotations

import time

import numpy as np
import pytest

from benchmarks.live import WITH, WITHOUT, Drive, judge, sheets_of, timed
from benchmarks.live_hour import Hour, Minute
from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import KeyframeId


class _Moves:
    """Moves keyframes at odd stamps, which takes 20 ms."""

    def move_keyframes(self, stamp_s: float, keyframe: KeyframeId | None) -> FloatArray | None:
        if int(stamp_s) % 2 == 0:
            return None
        time.sleep(0.02)
        return np.eye(4) * stamp_s


def test_only_frames_that_move_keyframes_are_closures() -> None:
    loops = _Moves()
    closures = timed(loops)
    answers = [loops.move_keyframes(float(stamp), None) for stamp in range(5)]
    assert [answer is None for answer in answers] == [True, False, True, False, True]
    assert answers[3] is not None
    np.testing.assert_array_equal(answers[3], np.eye(4) * 3)
    assert len(closures) == 2
    assert all(seconds >= 0.02 for seconds in closures)


def _drive(loops: str, ms: float, closures_ms: tuple[float, ...] = ()) -> Drive:
    frames = np.full(100, ms / 1e3)
    frames[-10:] *= 2
    return Drive("desk", loops, frames, tuple(one / 1e3 for one in closures_ms), 3)


def test_loops_are_held_against_the_same_drive_without() -> None:
    drives = [_drive(WITHOUT, 10.0), _drive(WITH, 10.5, (3.0, 51.0))]
    hour = Hour(
        tuple(Minute(n, 900.0 + 30 * n, 800.0, 10.0, 0.1, 7, 8, 9, 1.0) for n in range(1, 5)), 200.0, 1100.0, 1, 2
    )
    median, p95, closure, memory, written, slower = judge(drives, hour)
    assert median.measured == pytest.approx(5.0)
    assert p95.measured == pytest.approx(5.0)
    assert closure.measured == pytest.approx(51.0)
    assert [one.is_met for one in (median, p95, closure)] == [True, True, False]
    assert [one.is_met for one in (memory, written, slower)] == [False, False, True]
    assert drives[1].row == ("desk", "with", "100", "10.5", "21.0", "2", "51.0", "3")
    assert [sheet.title for sheet in sheets_of(drives, None)] == ["Frames at their own pace", "Targets"]
