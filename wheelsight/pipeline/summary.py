"""What a run comes to in a few numbers: the key figures of the report, and the words they deserve."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from wheelsight.estimates import Status
from wheelsight.pipeline.label_runs import runs
from wheelsight.pipeline.run_record import FrameRecord, RunRecord

SKIPPED = "skipped"
# What is compiled or loaded once makes a first frame slower by so many times than the usual one. Fewer frames than
# these do not tell what is usual.
_COLD_TIMES, _LEAST_FRAMES = 10.0, 10


@dataclass(frozen=True, slots=True)
class Summary:
    """The key figures of a run.

    Attributes:
        frames: how many were listed; an image listed again under another stamp is none, but stands among the skips.
        skipped: how many of them could not be used.
        posed: how many have a pose in the trajectory.
        duration_s: from the first frame to the last.
        frame_period_s: median time between frames, NaN with fewer than two.
        length_m: distance travelled by the estimate.
        lost_episodes: how often the camera was lost.
        lost_s: for how long in all.
        failures: (why, count) of the frames that were used but gave no pose, most frequent first.
        skips: (why, count) of the frames that could not be used, most frequent first.
        median_s: time a used frame took; NaN when none was used.
        p95_s: the time within which 95 % of them were done.
        longest_s: the longest time.
        unit: "frame", or "reading" where frames are wheel readings.
    """

    frames: int
    skipped: int
    posed: int
    duration_s: float
    frame_period_s: float
    length_m: float
    lost_episodes: int
    lost_s: float
    failures: tuple[tuple[str, int], ...]
    skips: tuple[tuple[str, int], ...]
    median_s: float
    p95_s: float
    longest_s: float
    unit: str = "frame"

    @property
    def pose_share(self) -> float:
        """Share of all listed frames that have a pose; 0 without frames."""
        return self.posed / self.frames if self.frames else 0.0

    @property
    def frames_per_second(self) -> float:
        """Frames a second at the median time a frame."""
        return 1 / self.median_s if self.median_s > 0 else float("nan")


def summarise(record: RunRecord) -> Summary:
    """The key figures of `record`."""
    frames = [frame for frame in record.frames if not frame.is_repeat]
    stamps_s = np.array([frame.stamp_s for frame in frames])
    seconds = np.array([frame.seconds for frame in frames if not frame.is_skipped and np.isfinite(frame.seconds)])
    lost = lost_spans_s(record)
    used = [frame for frame in frames if not frame.is_skipped]
    skips = Counter(frame.why for frame in record.frames if frame.is_skipped)
    failures = Counter(frame.why for frame in used if frame.reason is not None)
    return Summary(
        frames=len(frames),
        skipped=len(record.frames) - len(used),
        posed=record.posed,
        duration_s=float(np.ptp(stamps_s)) if len(frames) else 0.0,
        frame_period_s=float(np.median(np.diff(stamps_s))) if len(frames) > 1 else float("nan"),
        length_m=record.estimate.length_m,
        lost_episodes=len(lost),
        lost_s=sum(end - start for start, end in lost),
        failures=tuple(failures.most_common()),
        skips=tuple(skips.most_common()),
        median_s=_percentile(seconds, 50),
        p95_s=_percentile(seconds, 95),
        longest_s=_percentile(seconds, 100),
        unit=record.unit,
    )


def cold_frames(record: RunRecord) -> tuple[FrameRecord, ...]:
    """The first frames, where kernels were still compiled or loaded: those far slower than a usual one."""
    used = [frame for frame in record.frames if not frame.is_skipped and np.isfinite(frame.seconds)]
    if len(used) < _LEAST_FRAMES:
        return ()
    limit_s = _COLD_TIMES * float(np.median([frame.seconds for frame in used]))
    return tuple(takewhile(lambda frame: frame.seconds > limit_s, used))


def lost_spans_s(record: RunRecord) -> list[tuple[float, float]]:
    """When the camera was lost: (first lost stamp, the next one that was not), whether frames were usable or not."""
    frames = record.frames
    lost = [(i, j) for i, j, status in runs([str(frame.status) for frame in frames]) if status == Status.LOST]
    return [(frames[i].stamp_s, frames[min(j, len(frames) - 1)].stamp_s) for i, j in lost]


def _percentile(values: np.ndarray, percent: float) -> float:
    return float(np.percentile(values, percent)) if len(values) else float("nan")
