from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from run_example import empty_run, example_run

from wheelsight.app.run import FrameRecord, RunRecord
from wheelsight.core.estimates import Reason, Status
from wheelsight_report import summarise


def _with_statuses(*statuses: str) -> RunRecord:
    """Frames a second apart; "skipped ..." is one that could not be used, and left the state at what follows."""
    frames = tuple(
        FrameRecord(
            i, 10.0 + i, Status(status.split()[1]), Reason.FRAME_UNUSABLE, 0, 0, 0.0, "depth image is truncated"
        )
        if status.startswith("skipped")
        else FrameRecord(i, 10.0 + i, Status(status), None, 0, 0, 0.01)
        for i, status in enumerate(statuses)
    )
    return replace(empty_run(), frames=frames)


def test_the_key_figures_of_a_run() -> None:
    run = example_run(500)
    summary = summarise(run)
    used = [f for f in run.frames if not f.is_skipped]
    assert summary.frames == 500
    assert summary.skipped == 500 - len(used) > 0
    assert summary.posed == len(run.estimate)
    assert summary.pose_share == len(run.estimate) / 500
    assert summary.duration_s == pytest.approx(499 / 30)
    assert summary.frame_period_s == pytest.approx(1 / 30)
    assert summary.length_m == run.estimate.length_m
    assert summary.median_s == np.median([f.seconds for f in used])
    assert summary.frames_per_second == 1 / summary.median_s
    assert summary.longest_s == run.frames[0].seconds
    assert sum(n for _, n in summary.failures) + summary.skipped + summary.posed + 1 == 500  # 1: initialising


@pytest.mark.parametrize(
    ("statuses", "episodes", "lost_s"),
    [
        (("tracking", "tracking"), 0, 0),
        (("tracking", "lost", "lost", "tracking"), 1, 2),
        (("tracking", "lost", "skipped lost", "lost", "tracking"), 1, 3),
        (("tracking", "skipped failing", "tracking"), 0, 0),
        (("tracking", "skipped failing", "skipped lost", "skipped lost", "tracking"), 1, 2),
        (("lost", "tracking", "failing", "lost", "lost"), 2, 2),
        ((), 0, 0),
    ],
)
def test_lost_episodes(statuses: tuple[str, ...], episodes: int, lost_s: float) -> None:
    summary = summarise(_with_statuses(*statuses))
    assert (summary.lost_episodes, summary.lost_s) == (episodes, lost_s)


def test_a_run_without_frames_has_no_times() -> None:
    summary = summarise(_with_statuses())
    assert summary.pose_share == 0
    assert summary.duration_s == 0
    assert math.isnan(summary.median_s)
    assert math.isnan(summary.frames_per_second)
    assert math.isnan(summary.frame_period_s)
