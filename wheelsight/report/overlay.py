"""Overlay: the paths of several odometries brought into one frame, as far as they can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from wheelsight.errors import EvaluationError
from wheelsight.evaluation import start_alignment
from wheelsight.geometry import FloatArray, se3
from wheelsight.pipeline.joined import joined_of
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report import _series as series
from wheelsight.report.figures import estimated_path_m, truth_path_m
from wheelsight.trajectory import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """Paths that may be drawn together.

    Attributes:
        paths_m: (N, 3) positions of each odometry by its name, metres, rows of NaN at gaps.
        truth_m: (M, 3) true positions, likewise, or None.
        by: what they were brought together by: each laid upon the "truth" as ATE lays it, or by its first pose upon
            the "true start", or their "start".
        left_out: why an odometry is not among them, by its name.
        trajectories: the same estimates in the same frame, with their covariances, of those that have some.
    """

    paths_m: dict[str, FloatArray]
    truth_m: FloatArray | None
    by: Literal["truth", "true start", "start"]
    left_out: dict[str, str]
    trajectories: dict[str, Trajectory] = field(default_factory=dict)


def overlay_of(records: Sequence[RunRecord]) -> Overlay:
    """The paths of `records` in one frame: the truth's where any was evaluated, else one that begins where they do.

    With joined sensors all begin at the true start: what these state of their errors grows from there.
    """
    evaluated = [record for record in records if record.evaluation is not None]
    if evaluated and joined_of(evaluated) is not None:
        left_out = {r.odometry: r.evaluation_problem or "" for r in records if r.evaluation is None}
        moved = {record.odometry: _from_the_true_start(record) for record in evaluated}
        return _overlay(evaluated, moved, truth_path_m(evaluated[0]), "true start", left_out)
    if evaluated:
        left_out = {r.odometry: r.evaluation_problem or "" for r in records if r.evaluation is None}
        paths_m = {record.odometry: estimated_path_m(record) for record in evaluated}
        return Overlay(paths_m, truth_path_m(evaluated[0]), "truth", left_out)
    body = "base" if any(record.estimate.body == "base" for record in records) else "camera"
    left_out = {}
    for record in records:
        if not len(record.estimate):
            left_out[record.odometry] = "no pose was found"
        elif record.estimate.body != body:
            left_out[record.odometry] = f"it tells of the {record.estimate.body}, the others of the {body}"
    drawn = [record for record in records if record.odometry not in left_out]
    return _overlay(drawn, _from_one_start(drawn), None, "start", left_out)


def _overlay(
    records: Sequence[RunRecord],
    moved: dict[str, Trajectory],
    truth_m: FloatArray | None,
    by: Literal["true start", "start"],
    left_out: dict[str, str],
) -> Overlay:
    paths_m = {}
    for record in records:
        stamps_s, positions_m = moved[record.odometry].stamps_s, moved[record.odometry].positions_m
        paths_m[record.odometry] = series.with_gaps(stamps_s, positions_m, series.poseless_stamps_s(record))[1]
    stated = {name: trajectory for name, trajectory in moved.items() if trajectory.covariances is not None}
    return Overlay(paths_m, truth_m, by, left_out, stated)


def _from_the_true_start(record: RunRecord) -> Trajectory:
    """The estimate laid upon the truth by its first pose; as ATE lays it where the truth has too wide gaps for that."""
    assert record.ground_truth is not None
    assert record.evaluation is not None
    try:
        return record.estimate.moved(start_alignment(record.estimate, record.ground_truth))
    except EvaluationError:
        return record.evaluation.ate.aligned


def _from_one_start(records: Sequence[RunRecord]) -> dict[str, Trajectory]:
    """Each estimate seen from its pose at the first moment at which all are known, or else from its first pose."""
    begin_s = max((record.estimate.stamps_s[0] for record in records), default=0.0)
    moved = {}
    for record in records:
        T_odom_start = record.estimate.at([begin_s])[0]
        if not np.isfinite(T_odom_start).all():
            T_odom_start = record.estimate.T_frame_body[0]
        moved[record.odometry] = record.estimate.moved(se3.invert(T_odom_start))
    return moved
