"""A drive through three areas that never happened: wheels alone, and wheels that areas have rectified."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from area_drive import AREAS, area_drive
from run_example import wheel_run

from wheelsight.app.run import AreaObservation, FrameRecord, MapErrors, RectificationRecord, RunRecord
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import evaluate
from wheelsight_papers import labels_on_the_way


def area_runs(way: str = "probabilistic", with_truth: bool = True) -> tuple[RunRecord, RunRecord]:
    """Records of both; the rectified path keeps half a metre off, frames 10 to 12 tell nothing, frame 20 is wrong."""
    truth = area_drive().truth.select(slice(None, None, 5))
    stamps_s = truth.stamps_s
    turned = se3.from_plane(0, 0, 0.1) @ truth.T_frame_body
    wheels = Trajectory(stamps_s, turned, body="base", frame="odom")
    path = Trajectory(stamps_s, se3.from_plane(0.3, 0.4, 0) @ truth.T_frame_body, body="base")
    true_areas = labels_on_the_way(AREAS, truth, stamps_s)
    looks = tuple(
        _look(i, float(s), max(int(a), 0), way) for i, (s, a) in enumerate(zip(stamps_s, true_areas, strict=True))
    )
    found = RectificationRecord(way, AREAS, looks, wheels, "The start is the one that was given: x 0 m.")
    if with_truth:
        apart = [np.hypot(*(p.positions_m - truth.positions_m)[:, :2].T) for p in (wheels, path)]
        found = replace(found, true_areas=true_areas, errors=MapErrors(stamps_s, *apart))
    frames = tuple(FrameRecord(i, float(s), Status.TRACKING, None, 0, 0, 0.001) for i, s in enumerate(stamps_s))
    common: dict[str, Any] = {
        "frames": frames,
        "ground_truth": truth if with_truth else None,
        "recording": "three areas",
    }
    records = [
        replace(wheel_run(len(stamps_s)), odometry="wheels", estimate=wheels, **common),
        replace(
            wheel_run(len(stamps_s)), odometry="rectified", unit="frame", estimate=path, rectification=found, **common
        ),
    ]
    for i, record in enumerate(records):
        evaluation = evaluate(record.estimate, truth, max_gap_s=0.01) if with_truth else None
        records[i] = replace(
            record, evaluation=evaluation, evaluation_problem=None if with_truth else "no ground truth"
        )
    return records[0], records[1]


def _look(index: int, stamp_s: float, area: int, way: str) -> AreaObservation:
    p = np.full(len(AREAS), 0.05)
    p[(area + 1) % len(AREAS) if index == 20 else area] = 0.9
    belief, trust = (p, 0.3 if index < 40 else 0.9) if way == "probabilistic" else (None, float("nan"))
    if 10 <= index <= 12:
        return AreaObservation(stamp_s, belief=belief, trust=trust, note="no measurement: the frame has no depth")
    return AreaObservation(stamp_s, p, area, belief, trust)
