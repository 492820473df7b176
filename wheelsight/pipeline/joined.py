"""JoinedFacts: what came of joining wheels and a camera, for page, metrics and terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from wheelsight.errors import EvaluationError
from wheelsight.estimates import Status
from wheelsight.evaluation import Consistency, consistency
from wheelsight.pipeline.label_runs import runs
from wheelsight.pipeline.run_record import RunRecord

JOINED = "joined"
_NO_SENSORS = (JOINED, "rectified")
FLAGS = ("slip", "doubtful", "degenerate")
_MOST_OF_THE_TIME = 0.95
_FACTS: WeakKeyDictionary[RunRecord, JoinedFacts] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True, eq=False)
class JoinedFacts:
    """A joined run in numbers. A frame speaks for the time until the next one.

    Attributes:
        seconds: for how long each status held, those that occurred.
        coasting_s: length of each stretch without a camera, seconds.
        flag_shares: share of the time, 0 to 1, in which each flag was up; empty of a filter that knows none.
        poses_at_frames: how many poses of the trajectory answer frames.
        poses_at_readings: how many are at wheel readings alone.
        consistency: the errors beside what was stated of them, or None without truth or covariances.
    """

    seconds: dict[str, float]
    coasting_s: tuple[float, ...]
    flag_shares: dict[str, float]
    poses_at_frames: int
    poses_at_readings: int
    consistency: Consistency | None

    def share_of(self, status: Status) -> float:
        """Share of the time, 0 to 1, in which a status held; 0 without frames."""
        whole_s = sum(self.seconds.values())
        return self.seconds.get(status.value, 0.0) / whole_s if whole_s > 0 else 0.0


@dataclass(frozen=True, slots=True)
class BestAlone:
    """The better of the sensors alone, and the joined ATE (RMSE) over its own: under 1 joining them helped."""

    odometry: str
    ratio: float


def joined_of(records: Sequence[RunRecord]) -> RunRecord | None:
    """The record of joined sensors, or None where none were."""
    return next((record for record in records if record.odometry == JOINED), None)


def facts_of(record: RunRecord) -> JoinedFacts:
    """What came of it; computed once a record, since page, terminal and metrics each ask, and 30 minutes cost 1 s."""
    if record not in _FACTS:
        _FACTS[record] = _facts_of(record)
    return _FACTS[record]


def _facts_of(record: RunRecord) -> JoinedFacts:
    starts_s, ends_s = record.frame_spans_s()
    lasted_s, statuses = ends_s - starts_s, [str(frame.status) for frame in record.frames]
    flags = () if record.config.get("fusion", {}).get("filter") == "ligocki" else FLAGS
    flagged = {flag: np.array([flag in frame.flags for frame in record.frames], bool) for flag in flags}
    whole_s = float(lasted_s.sum())
    coasting = ((i, j) for i, j, status in runs(statuses) if status == Status.COASTING)
    at_frames = int(np.isin(record.estimate.stamps_s, [frame.pose_s for frame in record.frames]).sum())
    return JoinedFacts(
        seconds={
            status.value: float(lasted_s[np.array(statuses) == status].sum()) for status in Status if status in statuses
        },
        coasting_s=tuple(float(ends_s[j - 1] - starts_s[i]) for i, j in coasting),
        flag_shares={flag: float(lasted_s[up].sum()) / whole_s if whole_s else 0.0 for flag, up in flagged.items()},
        poses_at_frames=at_frames,
        poses_at_readings=len(record.estimate) - at_frames,
        consistency=consistency_of(record),
    )


def consistency_of(record: RunRecord) -> Consistency | None:
    """The estimate's errors beside what it stated of them, or None where one of both is missing."""
    if record.ground_truth is None or record.evaluation is None:
        return None
    try:
        return consistency(record.estimate, record.ground_truth)
    except EvaluationError:
        return None


def best_alone_of(records: Sequence[RunRecord]) -> BestAlone | None:
    """Who was nearest to the truth of the sensors that followed nearly as long; None where that cannot be said."""
    joined = joined_of(records)
    if joined is None or joined.evaluation is None:
        return None
    covered = _MOST_OF_THE_TIME * joined.evaluation.truth_time_covered
    rmse_m = {
        record.odometry: record.evaluation.ate.translation.rmse
        for record in records
        if record.evaluation is not None
        and record.odometry not in _NO_SENSORS
        and record.evaluation.truth_time_covered >= covered
    }
    best = min(rmse_m, key=rmse_m.__getitem__, default=None)
    if best is None or not rmse_m[best] > 0:
        return None
    return BestAlone(best, joined.evaluation.ate.translation.rmse / rmse_m[best])
