"""Rows of the tables on a drive's page."""

from __future__ import annotations

import math

from wheelsight.geometry import FloatArray
from wheelsight.pipeline import words
from wheelsight.pipeline.drive_record import DriveRecord

Columns = tuple[tuple[str, ...], list[tuple[str, ...]]]


def goal_rows(record: DriveRecord) -> Columns:
    """Column names with units, and one row a goal."""
    goals = record.goals
    results = [goal.result for goal in goals]
    headings = [words.angle(goal.off_deg) if math.isfinite(goal.off_deg) else "any" for goal in goals]
    return _table(
        ("Goal", [goal.name for goal in goals]),
        ("Asked", [place(goal.goal) if goal.is_place else "–" for goal in goals]),
        (
            "Became of it",
            [r.goal_change or "arrived" if r.has_arrived else f"{r.reason}: {r.detail}" for r in results],
        ),
        words.column("Off", [goal.off_m if goal.is_place else None for goal in goals], "m"),
        ("Heading off", [text if goal.is_place else "–" for goal, text in zip(goals, headings, strict=True)]),
        words.column("Time", [result.time_s for result in results], "s"),
        words.column("Driven", [result.way_m for result in results], "m"),
        words.column("First plan", [result.planned_m for result in results], "m"),
        ("Plans", [str(result.plans) for result in results]),
        ("Recovered", [str(result.recoveries) for result in results]),
    )


def stop_rows(record: DriveRecord) -> Columns:
    """Column names with units, and one row a stop."""
    return _table(
        ("Why", [stop.reason for stop in record.stops]),
        ("After [s]", [f"{stop.begin_s - record.begin_s:.1f}" for stop in record.stops]),
        words.column("For", [stop.end_s - stop.begin_s for stop in record.stops], "s"),
        ("Where", [words.UNKNOWN if stop.pose is None else place(stop.pose) for stop in record.stops]),
    )


def _table(*columns: tuple[str, list[str]]) -> Columns:
    return tuple(head for head, _ in columns), list(zip(*(cells for _, cells in columns), strict=True))


def transition_rows(record: DriveRecord) -> list[list[str]]:
    """One a change of state."""
    return [
        [f"{one.stamp_s - record.begin_s:.1f}", str(one.before), str(one.after), one.why]
        for goal in record.goals
        for one in goal.result.transitions
    ]


def place(pose: FloatArray) -> str:
    """Such as "3.20, 1.50 m, 90°"."""
    yaw = "" if math.isnan(pose[2]) else f", {math.degrees(pose[2]):.0f}°"
    return f"{pose[0]:.2f}, {pose[1]:.2f} m{yaw}"
