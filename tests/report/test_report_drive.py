"""The page and the picture of a drive."""

from __future__ import annotations

from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from rehearsed_drive import recorded, rehearsed_drive

from wheelsight.app.run.drive_record import DriveRecord, StopRecord, TimeCause
from wheelsight.app.run.drives import NamedGoal
from wheelsight.mapping import CellKind
from wheelsight_report.drive_files import drive_dict
from wheelsight_report.drive_page import (
    apart,
    drive_picture,
    plan_figure,
    render_drive,
    spent_figure,
    spent_rows,
    time_line_figure,
    verdict,
    walked,
)


@pytest.fixture(scope="module")
def record() -> DriveRecord:
    drive, _, config = rehearsed_drive()
    drive.go_to(NamedGoal.of(np.array([-0.7, -0.4, np.nan]), "<the middle>"), lambda feedback: None)
    found = recorded(drive, config)
    return replace(found, stops=(StopRecord(1.0, 2.5, "something in the way", np.array([-1.0, -0.4, 0.0])),))


def test_the_page_shows_where_it_went_what_held_it_and_what_it_saw(record: DriveRecord) -> None:
    page = render_drive(record)
    assert "To &lt;the middle&gt; in a room" in page
    assert "<the middle>" not in page
    reported = unescape(page)
    for part in ("Arrived", "Where it went", "What it did when", "What it saw", "something in the way", "1.50 s"):
        assert part in reported
    assert page.count("data:image/jpeg;base64,") == len(record.images)
    assert "http://" not in page.split("<script>")[0]


def test_the_verdict_is_of_the_goals(record: DriveRecord) -> None:
    assert verdict(record)[::2] == ("Arrived", "green")
    assert verdict(replace(record, asked=2))[::2] == ("1 of 2 goals reached", "red")
    assert verdict(replace(record, asked=2, is_interrupted=True))[::2] == ("Interrupted", "amber")
    helped = replace(record.goals[0], result=replace(record.goals[0].result, recoveries=2))
    phrase, sentences, tone = verdict(replace(record, goals=(helped,)))
    assert (phrase, tone) == ("Arrived", "amber")
    assert "2 times it had to recover" in sentences


def test_the_plan_shows_all_ways_in_metres(record: DriveRecord) -> None:
    traces = {trace.name: trace for trace in plan_figure(record).data}
    assert traces.keys() == {"planned", "driven", "start", "goal", "held"}
    assert traces["driven"].x[-1] == pytest.approx(-0.7, abs=0.15)
    assert (traces["held"].x, traces["held"].y) == pytest.approx((-1.0, -0.4))
    image = plan_figure(record).layout.images[0]
    assert (image.x, image.sizex) == pytest.approx((-2.55, 5.1))


def test_who_walked_near_it_is_shown_with_how_near(record: DriveRecord) -> None:
    stamps_s = 0.05 * np.arange(20)
    one = np.column_stack([stamps_s, -1.5 + stamps_s, np.full(20, 0.5), 0.9 - 0.5 * stamps_s])
    other = np.column_stack([stamps_s + 10.0, 1.5 - stamps_s, np.full(20, -0.5), np.full(20, 1.2)])
    met = replace(record, people=np.concatenate([one, other]))
    ways = [trace for trace in plan_figure(met).data if trace.name == "somebody walked"]
    assert [trace.showlegend for trace in ways] == [True, False]
    assert [(trace.x[0], trace.x[-1]) for trace in ways] == [(-1.5, pytest.approx(-0.55)), (1.5, pytest.approx(0.55))]
    assert "Nearest person" in (page := unescape(render_drive(met)))
    assert "42.5 cm" in page
    assert "Nearest person" not in render_drive(record)
    assert drive_dict(met)["people"] == {
        "periods": 40,
        "nearest": {"stamp_s": 0.95, "x_m": -0.55, "y_m": 0.5, "away_m": 0.425},
    }
    assert drive_dict(record)["people"] is None
    assert (drive_picture(met) == (86, 180, 233)).all(axis=2).any()


def test_periods_that_came_late_are_counted(record: DriveRecord) -> None:
    count = len(record.rows) - 1
    assert drive_dict(record)["periods"] == {"count": count, "late": 0, "longest_s": 0.05}
    assert "Longest period" not in render_drive(record)
    held_up = record.rows.stamps_s + 0.13 * (np.arange(count + 1) >= count // 2)
    late = replace(record, rows=replace(record.rows, stamps_s=held_up))
    assert drive_dict(late)["periods"] == {"count": count, "late": 1, "longest_s": 0.18}
    page = unescape(render_drive(late))
    assert "Longest period" in page
    assert f"1 period of {count:,} of the control loop took longer" in page


def test_each_period_has_one_cause_and_their_sum_is_the_time(record: DriveRecord) -> None:
    spent_s = drive_dict(record)["spent_s"]
    assert sum(spent_s.values()) == pytest.approx(record.time_s, abs=0.01)
    assert {TimeCause.GAINS_SPEED, TimeCause.BRAKES} <= {TimeCause(cause) for cause in spent_s}
    assert list(spent_s.values()) == sorted(spent_s.values(), reverse=True)
    bars = spent_figure(record).data
    assert [(bar.name, bar.x[0]) for bar in bars] == list(record.spent_s.items())
    assert [row[0] for row in spent_rows(record)[1]] == list(spent_s)
    assert f"% {next(iter(spent_s))}" in unescape(render_drive(record))


def test_two_who_walk_side_by_side_have_a_way_each(record: DriveRecord) -> None:
    both = [(0.05 * n, 0.05 * n, y, 1.0) for n in range(10) for y in (0.0, 0.6)]
    assert sorted({float(y) for way in walked(np.array(both)) for y in way[:, 1]}) == [0.0, 0.6]
    assert [len(np.unique(way[:, 1])) for way in walked(np.array(both))] == [1, 1]


def test_the_time_line_has_each_moment_once(record: DriveRecord) -> None:
    bars = [trace for trace in time_line_figure(record).data if trace.type == "bar"]
    for band in ("navigator", "localization", "monitor"):
        own = [trace for trace in bars if band in trace.y]
        assert sum(float(np.sum(trace.x)) for trace in own) == pytest.approx(record.time_s)
    assert {"driving", "planning"} <= {word for trace in bars for word in trace.customdata}


def test_a_single_strange_reading_does_not_flatten_the_speeds(record: DriveRecord) -> None:
    rows, times = record.rows, 8  # a hundredth of the drive is less than a reading
    forward_m_s = np.tile(rows.forward_m_s, times)
    forward_m_s[len(rows)] = -50.0
    many = replace(
        rows,
        stamps_s=0.05 * np.arange(len(forward_m_s), dtype=float),
        poses=np.tile(rows.poses, (times, 1)),
        forward_m_s=forward_m_s,
        turn_rad_s=np.tile(rows.turn_rad_s, times),
        states=rows.states * times,
        status=rows.status * times,
        monitor=rows.monitor * times,
        reasons=rows.reasons * times,
        causes=rows.causes * times,
    )
    low, high = time_line_figure(replace(record, rows=many)).layout.yaxis2.range
    assert -0.2 < low <= 0
    assert high > 0.9 * rows.forward_m_s.max()


def test_the_picture_has_map_ways_and_marks(record: DriveRecord) -> None:
    image = drive_picture(record)
    bare = drive_picture(replace(record, rows=empty(record), plans=(), stops=(), goals=()))
    assert image.shape[1] == bare.shape[1]
    for colour in ((230, 159, 0), (0, 114, 178), (213, 94, 0), (204, 121, 167), (0, 158, 115)):
        assert (image == colour).all(axis=-1).sum() > 20
        # The legend names nothing that is not there but the line of the way.
        assert colour == (0, 114, 178) or not (bare == colour).all(axis=-1).any()
    assert (record.grid.kind == CellKind.OBSTACLE).any()
    assert (image == (40, 40, 40)).all(axis=-1).sum() > 1000


def empty(record: DriveRecord):
    rows = record.rows
    none = np.empty(0)
    return replace(
        rows,
        stamps_s=none,
        poses=np.empty((0, 3)),
        forward_m_s=none,
        turn_rad_s=none,
        states=(),
        status=(),
        monitor=(),
        reasons=(),
        causes=(),
    )


def test_a_drive_that_never_began_has_a_page(record: DriveRecord) -> None:
    page = render_drive(replace(record, rows=empty(record), plans=(), stops=(), goals=(), images=()))
    assert "0 of 1 goal reached" in unescape(page)
    assert "Nothing held it." in page


def test_poses_so_far_apart() -> None:
    poses = np.column_stack([np.linspace(0, 1, 11), np.zeros(11), np.zeros(11)])
    assert apart(poses, 0.45)[:, 0] == pytest.approx([0.0, 0.5, 1.0, 1.0])
    assert apart(np.empty((0, 3)), 1.0).shape == (0, 3)


def test_an_exploration_is_drawn_without_a_goal(record: DriveRecord) -> None:
    explored = replace(record.goals[0], name="explore", goal=np.full(3, np.nan))
    reported = replace(record, goals=(explored,))
    assert not explored.is_place
    assert drive_picture(reported).shape[2] == 3
    assert "explore" in render_drive(reported)
    assert ">nan" not in render_drive(reported)


def test_loops_are_reported_of_a_drive_that_made_a_map(record: DriveRecord) -> None:
    assert "Loops closed" not in render_drive(record)
    page = render_drive(replace(record, loops=73))
    assert "Loops closed" in page
    assert ">73<" in page
    assert drive_dict(replace(record, loops=73))["loops"] == 73
