"""Rows of the tables on a drive's page."""

from __future__ import annotations

import math

from wheelsight.geometry import FloatArray
from wheelsight.pipeline import words
from wheelsight.pipeline.drive_record import DriveRecord

GOALS_HEAD = (
    "Goal",
    "Asked",
    "Became of it",
    "Off",
    "Heading off",
    "Time",
    "Driven",
    "First plan",
    "Plans",
    "Recovered",
)
STOPS_HEAD = ("Why", "Seconds", "For", "Where")


def goal_rows(record: DriveRecord) -> list[list[str]]:
    """One a goal."""
    rows = []
    for goal in record.goals:
        result = goal.result
        became = result.goal_change or "arrived" if result.has_arrived else f"{result.reason}: {result.detail}"
        heading = words.angle(goal.off_deg) if math.isfinite(goal.off_deg) else "any"
        numbers = (words.duration(result.time_s), words.length(result.way_m), words.length(result.planned_m))
        counts = (str(result.plans), str(result.recoveries))
        where = place(goal.goal) if goal.is_place else "—"
        off = words.length(goal.off_m) if goal.is_place else "—"
        rows.append([goal.name, where, became, off, heading if goal.is_place else "—", *numbers, *counts])
    return rows


def stop_rows(record: DriveRecord) -> list[list[str]]:
    """One a stop."""
    return [
        [
            stop.reason,
            f"{stop.begin_s - record.begin_s:.1f}",
            words.duration(stop.end_s - stop.begin_s),
            words.UNKNOWN if stop.pose is None else place(stop.pose),
        ]
        for stop in record.stops
    ]


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
