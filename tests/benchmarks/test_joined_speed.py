"""What joining costs is what it takes beyond wheels and camera alone."""

from __future__ import annotations

import pytest

from benchmarks.joined_runs import CAMERA, JOINED, WHEELS
from benchmarks.joined_speed import Spent, joined_speed_sheet, judge_joined_speed, overhead_ms, spent_on


def made(frame_ms: float, reading_ms: float, aside_ms: float = 0.0) -> Spent:
    return Spent([frame_ms / 1e3] * 10, [reading_ms / 1e3] * 90, [aside_ms / 1e3] * 10, tracked=100)


def test_what_joining_takes_is_shared_by_all_events() -> None:
    spent = {WHEELS: made(0.0, 0.1), CAMERA: made(30.0, 0.0, 0.5), JOINED: made(22.0, 0.3, 2.0)}
    assert overhead_ms(spent) == pytest.approx((10 * (2.0 - 0.5) + 90 * 0.2) / 100)
    assert spent[JOINED].frames_hz == pytest.approx(10 / (10 * 0.022 + 90 * 0.0003))
    assert [target.is_met for target in judge_joined_speed(spent)] == [True, True]
    spent[JOINED] = made(36.0, 0.3, 4.0)
    assert [target.is_met for target in judge_joined_speed(spent)] == [False, False]
    sheet = joined_speed_sheet(spent)
    assert {len(row) for row in sheet.rows} == {len(sheet.header)}


@pytest.mark.slow
def test_every_localizer_is_timed_by_the_same_events_once_it_is_warm() -> None:
    pytest.importorskip("mujoco")
    from wheelsight_sim import SimulationSettings, simulate

    recording = simulate(SimulationSettings("flat", size=(160, 120), rate_hz=5, duration_s=3.0, seed=1))
    spent = spent_on(recording)
    assert list(spent) == [WHEELS, CAMERA, JOINED]
    assert {(len(s.frames_s), len(s.readings_s)) for s in spent.values()} == {
        (len(spent[JOINED].frames_s), len(spent[JOINED].readings_s))
    }
    assert 0 < len(spent[JOINED].frames_s) < recording.frame_count
    assert all(seconds > 0 for s in spent.values() for seconds in (*s.frames_s, *s.readings_s))
