from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from run_example import START_S, empty_run, example_run

from wheelsight.estimates import Reason, Status
from wheelsight.pipeline import FrameRecord, RealTimeRecord, RunRecord
from wheelsight.pipeline.verdict import judge, notes
from wheelsight.recordings import AssociationReport
from wheelsight.report import summarise


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


@pytest.mark.parametrize(
    ("run", "phrase", "tone"),
    [
        (example_run(500), "Followed, with gaps", "fair"),
        (empty_run(), "No pose was found", "poor"),
        (example_run(1), "A single frame, so nothing to follow", "fair"),
    ],
)
def test_the_verdict_goes_by_tracking(run: RunRecord, phrase: str, tone: str) -> None:
    verdict = judge(run, summarise(run))
    assert (verdict.phrase, verdict.tone) == (phrase, tone)


def test_the_verdict_on_a_run_without_gaps() -> None:
    run = example_run(60, with_truth=False)
    posed = tuple(f for f in run.frames if f.stamp_s in run.estimate.stamps_s)
    run = replace(run, frames=posed)
    verdict = judge(run, summarise(run))
    assert (verdict.phrase, verdict.tone) == ("Followed in every frame", "good")
    assert "never lost" in verdict.sentences[0]


def test_the_verdict_says_how_far_off_and_how_quick() -> None:
    run = example_run(500)
    assert run.evaluation is not None
    ate = run.evaluation.ate.translation
    text = " ".join(judge(run, summarise(run)).sentences)
    assert f"{100 * ate.rmse:.2f} cm (RMSE) and by {100 * ate.max:.2f} cm at worst" in text
    assert f"{len(run.estimate)} of 500 frames" in text
    assert "lost once, for 1.63 s" in text
    assert "times as fast as the camera" in text
    slow = replace(run, frames=tuple(replace(f, seconds=0.1) for f in run.frames))
    assert "the camera delivers 3.0 in that time" in " ".join(judge(slow, summarise(slow)).sentences)


def test_without_an_evaluation_the_verdict_says_why() -> None:
    run = example_run(60, with_truth=False)
    assert "cannot be said: there is no ground truth." in judge(run, summarise(run)).sentences[1]
    run = replace(run, evaluation_problem="they share 0.1 s.")
    assert "cannot be said: they share 0.1 s." in judge(run, summarise(run)).sentences[1]


def test_notes_tell_all_that_was_left_out() -> None:
    run = example_run(500)
    found = notes(run, summarise(run))
    assert found[0] == run.warnings[0]
    assert "2 frames could not be used: depth image is truncated (2)." in found
    assert any("60 used frames gave no pose: too few matches (49), too few inliers (11)." in note for note in found)
    assert "12 of 512 colour images and 3 of 503 depth images found no partner within 20 ms and were left out." in found


def test_notes_tell_what_the_truth_does_not_cover() -> None:
    run = example_run(300)
    assert run.evaluation is not None
    half = replace(run, estimate=run.estimate, evaluation=replace(run.evaluation, pairs=100, scale=1.25))
    text = " ".join(notes(half, summarise(half)))
    assert f"Only 100 of {len(run.estimate)} poses have a true pose" in text
    assert "multiplied by 1.25000" in text


def test_a_clean_run_needs_no_note() -> None:
    run = _with_statuses("tracking", "tracking")
    run = replace(run, association=AssociationReport(2, 2, 2, 0.02))
    assert notes(run, summarise(run)) == []


def test_many_reasons_are_summed_up() -> None:
    frames = tuple(
        FrameRecord(i, START_S + i, Status.TRACKING, Reason.FRAME_UNUSABLE, 0, 0, 0.0, f"image {i} is missing")
        for i in range(50)
    )
    run = replace(empty_run(), frames=frames)
    assert "other reasons (42)" in notes(run, summarise(run))[0]


def test_how_it_went_in_real_time_is_a_note() -> None:
    live = RealTimeRecord(20.0, 600, 12, 3, 1000, 0.031, 0.052)
    run = replace(_with_statuses("tracking", "tracking"), association=AssociationReport(2, 2, 2, 0.02), realtime=live)
    (note,) = notes(run, summarise(run))
    assert note.startswith("Played in real time: 29.4 frames/s answered, 12 of 600 frames dropped (2.0 %)")
