"""A drive that is played there and back, and what is counted of control periods."""

from __future__ import annotations

import time
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest

from benchmarks import navigation_speed
from benchmarks.navigation_speed import Quarter, judge
from benchmarks.played_drive import PlayedDrive, PlayedRobot, played_of
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.messages import STOP, Event, RgbdFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory

CAMERA = PinholeCamera(4, 3, 4.0, 4.0, 1.5, 1.0)


@pytest.fixture
def drive(tmp_path: Path) -> PlayedDrive:
    """A second of a straight way at 1 m/s, with ten readings and five frames."""
    events: list[Event] = []
    for k in range(10):
        events.append(WheelTicks(0.1 * k, 10 * k, 11 * k))
        if k % 2 == 0:
            color, depth_m = np.full((3, 4, 3), k, np.uint8), np.full((3, 4), k, np.float32)
            np.savez(tmp_path / f"{k}.npz", color=color, depth_m=depth_m)
            events.append(RgbdFrame(0.1 * k + 0.01, color[:0], depth_m[:0], k))
    way_s = np.linspace(0, 1, 11)
    way = np.column_stack([way_s, 0 * way_s, 0 * way_s])
    return PlayedDrive(tmp_path, tuple(events), 1.0, way, way_s, Calibration.registered_camera(CAMERA))


def test_it_is_played_there_and_back_without_a_jump(drive: PlayedDrive) -> None:
    events = list(islice(drive.there_and_back(), 45))
    stamps_s = [event.stamp_s for event in events]
    assert stamps_s == sorted(stamps_s)
    ticks = [event for event in events if isinstance(event, WheelTicks)]
    assert {abs(b.left - a.left) for a, b in pairwise(ticks)} <= {0, 10}
    assert max(tick.left for tick in ticks) == 90
    assert ticks[20].left == 0
    assert ticks[20].stamp_s == pytest.approx(2.0)
    frames = [event for event in events if isinstance(event, RgbdFrame)]
    assert [int(frame.color[0, 0, 0]) for frame in frames[:10]] == [0, 2, 4, 6, 8, 8, 6, 4, 2, 0]
    assert (frames[1].depth_m == 2).all()


def test_what_was_rendered_is_taken_again(tmp_path: Path, drive: PlayedDrive) -> None:
    frames = [(5.0 + event.stamp_s, event.index) for event in drive.events if isinstance(event, RgbdFrame)]
    ticks = [(5.0 + event.stamp_s, event.left, event.right) for event in drive.events if isinstance(event, WheelTicks)]
    np.savez(tmp_path / "events.npz", frames=np.array(frames), ticks=np.array(ticks))
    T = np.array([se3.from_plane(2.0 + x, 3.0, 0.0) for x in drive.way_s])
    again = played_of(Trajectory(5.0 + drive.way_s, T, body="base"), drive.calibration, tmp_path)
    assert [event.stamp_s for event in again.events] == pytest.approx([event.stamp_s for event in drive.events])
    assert list(map(type, again.events)) == list(map(type, drive.events))
    np.testing.assert_allclose(again.way, drive.way, atol=1e-12)
    assert again.seconds == pytest.approx(1.0)


def test_the_way_ahead_ends_where_it_turns(drive: PlayedDrive) -> None:
    assert drive.way_ahead(0.25)[[0, -1], 0].tolist() == pytest.approx([0.3, 1.0])
    assert drive.way_ahead(1.25)[[0, -1], 0].tolist() == pytest.approx([0.7, 0.0])
    assert [drive.is_back(now_s) for now_s in (0.5, 1.5, 2.5)] == [False, True, False]


def test_periods_last_as_long_as_they_should_and_tell_what_was_worked(drive: PlayedDrive) -> None:
    with PlayedRobot(drive) as robot:
        robot.begin()
        heard = []
        for k in range(12):
            heard += robot.step(STOP)
            if k == 5:
                time.sleep(0.12)
        assert robot.now_s > 12 * 0.05
    worked_s = robot.timing.worked_s
    assert max(worked_s) == worked_s[6]
    assert worked_s[6] > 0.12
    assert np.median(worked_s) < 0.05
    stamps_s = [event.stamp_s for event in heard]
    assert stamps_s == sorted(stamps_s)
    assert max(stamps_s) <= robot.now_s
    assert len(stamps_s) >= 8


def test_targets_weigh_periods_and_compare_quarters() -> None:
    first = Quarter(100, 1.0, 10.0, 20.0, 30.0, 8.0, 0.9, 15.0, 1.0, 500.0)
    last = Quarter(300, 0.96, 12.0, 20.0, 60.0, 8.0, 0.9, 14.0, 1.0, 520.0)
    within, frames, slower, grown = judge([first, last])
    assert within.measured == pytest.approx(97.0)
    assert frames.measured == pytest.approx(14.5)
    assert slower.measured == pytest.approx(20.0)
    assert grown.measured == pytest.approx(4.0)
    assert not within.is_met
    assert grown.is_met
    assert navigation_speed.sheets_of([first, last])[0].rows[1][2] == "96.00 %"


def test_a_process_holds_something() -> None:
    assert 10 < navigation_speed.held_mb() < 100_000
