"""The files that a drive leaves: what became of it as JSON, its way, and its settings."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight._version import __version__
from wheelsight.files import StrPath, settings_text, write_text
from wheelsight.geometry import FloatArray
from wheelsight.geometry.se2 import wrap_angle
from wheelsight.pipeline.drive_record import DriveRecord, GoalRecord, PeriodLengths, StopRecord
from wheelsight.trajectory import write_tum

DRIVE_FILE, WAY_FILE, SETTINGS_FILE = "drive.json", "trajectory.txt", "config.yaml"
_PLAN_STEP_M = 0.1


def write_drive(record: DriveRecord, folder: StrPath) -> None:
    """drive.json, trajectory.txt and config.yaml in a folder that is there. Raises OutputError."""
    folder = Path(folder)
    write_text(folder / SETTINGS_FILE, settings_text(record.config))
    write_tum(record.way, folder / WAY_FILE)
    write_text(folder / DRIVE_FILE, json.dumps(drive_dict(record), indent=2, allow_nan=False) + "\n")


def drive_dict(record: DriveRecord) -> dict[str, Any]:
    """The same as plain nested values, for JSON: what is not known is None."""
    plans = [{"stamp_s": stamp_s, "poses": _poses(_thinned(poses))} for stamp_s, poses in record.plans]
    transitions = [
        {"stamp_s": one.stamp_s, "before": str(one.before), "after": str(one.after), "why": one.why}
        for goal in record.goals
        for one in goal.result.transitions
    ]
    return {
        "wheelsight": __version__,
        "finished_at": record.finished_at.isoformat(timespec="seconds"),
        "map": record.map_name,
        "robot": record.robot,
        "has_arrived": record.has_arrived,
        "interrupted": record.is_interrupted,
        "goals_asked": record.asked,
        "goals": [_goal(goal) for goal in record.goals],
        "time_s": round(record.time_s, 3),
        "way_m": round(record.way_m, 3),
        "planned_m": round(record.planned_m, 3),
        "clearance_m": _number(record.clearance_m),
        "people": _people(record.people),
        "periods": _periods(record.periods),
        "stops": [_stop(stop) for stop in record.stops],
        "transitions": transitions,
        "plans": plans,
        "recognised": record.recognised,
        "truth": record.truth or None,
        "loops": record.loops,
        "navigation": record.config["navigation"],
    }


def _goal(goal: GoalRecord) -> dict[str, Any]:
    result = goal.result
    return {
        "name": goal.name,
        "goal": _pose(goal.goal),
        "arrived": result.has_arrived,
        "reason": None if result.reason is None else str(result.reason),
        "detail": result.detail,
        "goal_change": result.goal_change or None,
        "end": None if goal.end is None else _pose(goal.end),
        "off_m": _number(goal.off_m),
        "off_deg": _number(goal.off_deg),
        "time_s": round(result.time_s, 3),
        "way_m": round(result.way_m, 3),
        "planned_m": round(result.planned_m, 3),
        "plans": result.plans,
        "recoveries": result.recoveries,
    }


def _people(people: FloatArray) -> dict[str, Any] | None:
    """When somebody was known to walk near the robot, and how near; None where nobody was."""
    if not len(people):
        return None
    stamp_s, x_m, y_m, away_m = people[people[:, 3].argmin()].tolist()
    nearest = {"stamp_s": _number(stamp_s), "x_m": _number(x_m), "y_m": _number(y_m), "away_m": _number(away_m)}
    return {"periods": len(np.unique(people[:, 0])), "nearest": nearest}


def _periods(periods: PeriodLengths) -> dict[str, Any]:
    return {"count": periods.count, "late": periods.late, "longest_s": round(periods.longest_s, 3)}


def _stop(stop: StopRecord) -> dict[str, Any]:
    where = None if stop.pose is None else _pose(stop.pose)
    return {"begin_s": stop.begin_s, "end_s": stop.end_s, "reason": stop.reason, "pose": where}


def _pose(pose: FloatArray) -> dict[str, float | None]:
    x_m, y_m, yaw = pose.tolist()
    return {"x_m": _number(x_m), "y_m": _number(y_m), "yaw_deg": _number(math.degrees(yaw))}


def _number(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def _poses(poses: FloatArray) -> list[list[float]]:
    """x, y in metres and yaw in radians."""
    return [[round(float(value), 3) for value in pose] for pose in poses]


def _thinned(poses: FloatArray) -> FloatArray:
    """Poses of a plan, so far apart, with its end and all turns in place."""
    kept = [0]
    for row in range(1, len(poses)):
        way_m = float(np.hypot(*(poses[row] - poses[kept[-1]])[:2]))
        turned = abs(wrap_angle(poses[row, 2] - poses[kept[-1], 2]))
        if way_m >= _PLAN_STEP_M or turned >= 0.3 or row == len(poses) - 1:
            kept.append(row)
    return poses[kept]
