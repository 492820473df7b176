"""The files of a drive's results: drive.json, trajectory.txt and config.yaml."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight import __version__
from wheelsight.app.run.drive_record import DriveRecord
from wheelsight.core.files import StrPath, settings_text, write_text
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.trajectory import write_tum

DRIVE_FILE, WAY_FILE, SETTINGS_FILE = "drive.json", "trajectory.txt", "config.yaml"
_PLAN_STEP_M = 0.1


def write_drive(record: DriveRecord, folder: StrPath) -> None:
    """Write drive.json, trajectory.txt and config.yaml into an existing folder. Raises OutputError."""
    folder = Path(folder)
    write_text(folder / SETTINGS_FILE, settings_text(record.config))
    write_tum(record.way, folder / WAY_FILE)
    write_text(folder / DRIVE_FILE, json.dumps(drive_dict(record), indent=2, allow_nan=False) + "\n")


def drive_dict(record: DriveRecord) -> dict[str, Any]:
    """The record as nested values for JSON; unknown values are None."""
    goals = [
        {
            "name": goal.name,
            "goal": _pose(goal.goal),
            "arrived": goal.result.has_arrived,
            "reason": None if goal.result.reason is None else str(goal.result.reason),
            "detail": goal.result.detail,
            "goal_change": goal.result.goal_change or None,
            "end": _pose(goal.end),
            "off_m": _number(goal.off_m),
            "off_deg": _number(goal.off_deg),
            "time_s": round(goal.result.time_s, 3),
            "way_m": round(goal.result.way_m, 3),
            "planned_m": round(goal.result.planned_m, 3),
            "plans": goal.result.plans,
            "recoveries": goal.result.recoveries,
        }
        for goal in record.goals
    ]
    people = None  # closest distance to a walking person and its time
    if len(record.people):
        nearest = zip(("stamp_s", "x_m", "y_m", "away_m"), record.people[record.people[:, 3].argmin()], strict=True)
        periods = len(np.unique(record.people[:, 0]))
        people = {"periods": periods, "nearest": {name: _number(float(value)) for name, value in nearest}}
    plans = [
        {"stamp_s": stamp_s, "poses": [[round(float(value), 3) for value in pose] for pose in _thinned(poses)]}
        for stamp_s, poses in record.plans
    ]
    stops = [
        {"begin_s": stop.begin_s, "end_s": stop.end_s, "reason": stop.reason, "pose": _pose(stop.pose)}
        for stop in record.stops
    ]
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
        "goals": goals,
        "time_s": round(record.time_s, 3),
        "spent_s": {cause: round(seconds, 3) for cause, seconds in record.spent_s.items()},
        "way_m": round(record.way_m, 3),
        "planned_m": round(record.planned_m, 3),
        "clearance_m": _number(record.clearance_m),
        "people": people,
        "periods": {**asdict(record.periods), "longest_s": round(record.periods.longest_s, 3)},
        "stops": stops,
        "transitions": transitions,
        "plans": plans,
        "recognised": record.recognised,
        "warnings": list(record.warnings),
        "truth": record.truth or None,
        "loops": record.loops,
        "navigation": record.config["navigation"],
    }


def _pose(pose: FloatArray | None) -> dict[str, float | None] | None:
    if pose is None:
        return None
    x_m, y_m, yaw = pose.tolist()
    return {"x_m": _number(x_m), "y_m": _number(y_m), "yaw_deg": _number(math.degrees(yaw))}


def _number(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def _thinned(poses: FloatArray) -> FloatArray:
    """Poses of a plan at a minimum distance, with its end and all turns in place."""
    kept = [0]
    for row in range(1, len(poses)):
        way_m = float(np.hypot(*(poses[row] - poses[kept[-1]])[:2]))
        turned = abs(wrap_angle(poses[row, 2] - poses[kept[-1], 2]))
        if way_m >= _PLAN_STEP_M or turned >= 0.3 or row == len(poses) - 1:
            kept.append(row)
    return poses[kept]
