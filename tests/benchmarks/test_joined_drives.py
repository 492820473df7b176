"""Images kept are those rendered; where a corridor is blind; an hour's quarters, counted and judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from narrowing import as_frame

from benchmarks.joined_cases import CASES, Way, drive_of
from benchmarks.joined_hour import Quarter, hour_sheet, judge_hour, memory_mb, quarters_of
from benchmarks.joined_images import kept_events
from benchmarks.joined_runs import JOINED, localizer_of
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame
from wheelsight_sim import SimulatedRecording


@pytest.fixture(scope="module")
def recording() -> SimulatedRecording:
    pytest.importorskip("mujoco")
    from wheelsight_sim import SimulationSettings, simulate

    return simulate(SimulationSettings("flat", size=(64, 48), rate_hz=5, duration_s=2.0, seed=1))


@pytest.mark.slow
def test_images_kept_are_those_rendered(recording: SimulatedRecording, tmp_path: Path) -> None:
    rendered = list(recording.events())
    for _ in range(2):
        kept = list(kept_events(recording, tmp_path))
        assert [type(event) for event in kept] == [type(event) for event in rendered]
        for event, other in zip(kept, rendered, strict=True):
            assert event.stamp_s == other.stamp_s
            if isinstance(event, RgbdFrame):
                frame = as_frame(other)
                assert event.index == frame.index
                np.testing.assert_array_equal(event.color, frame.color)
                np.testing.assert_array_equal(event.depth_m, frame.depth_m)
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.slow
def test_drives_of_a_plan_are_in_its_building_but_for_the_blank_corridor(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    from floor_plans import two_rooms, write_plan

    from wheelsight_sim import FloorPlan

    plan = FloorPlan(write_plan(tmp_path, two_rooms()))
    forward, backward = (drive_of(Way.CLEAN, seed, 2.0, plan) for seed in (1, 3))
    assert forward.world.name == backward.world.name == "house"
    assert (forward.settings.is_reverse, backward.settings.is_reverse) == (False, True)
    assert drive_of(Way.BLANK, 1, 2.0, plan).world.name == "blank"


@pytest.mark.slow
def test_a_corridor_counts_as_blind_only_where_nothing_but_paint_is_in_reach() -> None:
    pytest.importorskip("mujoco")
    from benchmarks.joined_cases import BLANK_M

    recording = drive_of(Way.BLANK, 1)
    case = next(case for case in CASES if case.way is Way.BLANK)
    begin_s, end_s = case.lasts_s(recording)
    stamps_s = np.array([recording.renderer.stamp_s(index) for index in range(recording.frame_count)])
    blind = np.flatnonzero((stamps_s >= begin_s) & (stamps_s <= end_s))
    assert stamps_s[blind[-1]] - stamps_s[blind[0]] > 20
    for index in blind[:: len(blind) // 5]:
        x_m = _seen_x_m(recording, index)
        assert BLANK_M[0] < x_m.min() < x_m.max() < BLANK_M[1]
    seen = [np.count_nonzero(_seen_x_m(recording, blind[-1] + later) > BLANK_M[1]) for later in (20, 40)]
    assert 0 < seen[0] < seen[1]


def _seen_x_m(recording: SimulatedRecording, index: int) -> FloatArray:
    """How far along the corridor the points lie that a frame has depth of."""
    frame, calibration = recording.renderer.frame(int(index)), recording.true_calibration
    rows, columns = np.nonzero(frame.depth_m)
    points = calibration.cameras[1].back_project(np.column_stack([columns, rows]), frame.depth_m[rows, columns])
    T_odom_camera = recording.ground_truth.at([frame.stamp_s])[0] @ calibration.T_base_camera
    return np.asarray(points @ T_odom_camera[0, :3] + T_odom_camera[0, 3])


@pytest.mark.slow
def test_every_quarter_is_measured(recording: SimulatedRecording) -> None:
    quarters = quarters_of(recording, localizer_of(JOINED, recording.calibration, "features"))
    assert len(quarters) == 4
    assert all(q.frame_ms > q.reading_ms > 0 for q in quarters)
    assert 10 < memory_mb() < 1e5


def test_growth_counts_from_the_second_quarter_on() -> None:
    quarters = [Quarter(5.0, 0.1, 300.0, 1.0), Quarter(10.0, 0.2, 400.0, 1.0)]
    quarters += [Quarter(30.0, 0.2, 400.0, 1.0), Quarter(10.5, 0.3, 500.0, 0.5)]
    assert [target.is_met for target in judge_hour(quarters, 60)] == [True, False, False]
    sheet = hour_sheet(quarters, 60)
    assert [len(row) for row in sheet.rows] == [len(sheet.header)] * 4
    assert sheet.rows[3] == ("4.", "10.5 ms", "0.30 ms", "500 MB", "50.0 %")
