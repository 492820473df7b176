"""Overlay: the paths of several odometries brought into one world, as far as they can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from wheelsight.geometry import FloatArray, se3
from wheelsight.report import _series as series
from wheelsight.report.figures import estimated_path_m, truth_path_m
from wheelsight.report.record import RunRecord


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """Paths that may be drawn together.

    Attributes:
        paths_m: (N, 3) positions of each odometry by its name, metres, rows of NaN at gaps.
        truth_m: (M, 3) true positions, likewise, or None.
        by: what they were brought together by: each laid upon the "truth" as ATE lays it, or their "start".
        left_out: why an odometry is not among them, by its name.
    """

    paths_m: dict[str, FloatArray]
    truth_m: FloatArray | None
    by: Literal["truth", "start"]
    left_out: dict[str, str]


def overlay_of(records: Sequence[RunRecord]) -> Overlay:
    """The paths of `records` in one world: the truth's where any was evaluated, else one that begins where they do."""
    evaluated = [record for record in records if record.evaluation is not None]
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
    return Overlay(_from_one_start([r for r in records if r.odometry not in left_out]), None, "start", left_out)


def _from_one_start(records: Sequence[RunRecord]) -> dict[str, FloatArray]:
    """Each path (N, 3) seen from its pose at the first moment at which all are known, or else from its first pose."""
    begin_s = max((record.estimate.stamps_s[0] for record in records), default=0.0)
    paths_m = {}
    for record in records:
        T_world_start = record.estimate.at([begin_s])[0]
        if not np.isfinite(T_world_start).all():
            T_world_start = record.estimate.T_world_body[0]
        moved = record.estimate.moved(se3.invert(T_world_start))
        breaks_s = series.poseless_stamps_s(record)
        paths_m[record.odometry] = series.with_gaps(moved.stamps_s, moved.positions_m, breaks_s)[1]
    return paths_m
