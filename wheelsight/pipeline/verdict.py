"""The run in words: whether to trust it, and what a reader should know before doing so."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from wheelsight.pipeline import words
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.pipeline.summary import Summary

Tone = Literal["good", "fair", "poor"]

_ALMOST_ALL = 0.95
_MOST_REASONS = 8
_MOST_LINES = 3


@dataclass(frozen=True, slots=True)
class Verdict:
    """A run in a phrase, the sentences that bear it out, and how it sounds; `chief` are those that stand at the top."""

    phrase: str
    sentences: tuple[str, ...]
    tone: Tone
    chief: tuple[str, ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """Three at most, for the top of a page."""
        return (self.chief or self.sentences)[:_MOST_LINES]


def judge(record: RunRecord, summary: Summary) -> Verdict:
    """What `record` shows, in words. Only tracking is judged; how much error is too much is the reader's to say."""
    phrase, tone = tracking_phrase(summary)
    tracked = _tracking_sentence(summary, by_camera=summary.unit == "frame" and record.rectification is None)
    sentences = (tracked, accuracy_sentence(record, summary), speed_sentence(summary))
    return Verdict(phrase, tuple(filter(None, sentences)), tone)


def notes(record: RunRecord, summary: Summary) -> list[str]:
    """What was dropped, skipped, not covered or doubtful, one sentence each."""
    found = [*record.warnings]
    if summary.skipped:
        found.append(f"{words.count(summary.skipped, summary.unit)} could not be used: {_counted(summary.skips)}.")
    if summary.failures:
        failed = sum(n for _, n in summary.failures)
        which, why = words.count(failed, f"used {summary.unit}"), _counted(summary.failures)
        found.append(
            f"{which} told nothing that was believed, and the wheels led there: {why}."
            if record.is_joined
            else f"{which} gave no pose: {why}."
        )
    if summary.failures and record.unit == "reading":
        found.append(
            "After a reading without a pose the path goes on from where it was: what lies between is not known."
        )
    if record.realtime is not None:
        found.append(f"{record.realtime.sentence[0].upper()}{record.realtime.sentence[1:]}.")
    found += _association_notes(record)
    found += _evaluation_notes(record, summary)
    return found


def tracking_phrase(summary: Summary) -> tuple[str, Tone]:
    """How much of the run has a pose, and how that sounds."""
    share = summary.pose_share
    if not summary.posed:
        return "No pose was found", "poor"
    if summary.frames == 1:
        return f"A single {summary.unit}, so nothing to follow", "fair"
    if share == 1:
        return f"Followed in every {summary.unit}", "good"
    if share >= _ALMOST_ALL and not summary.lost_episodes:
        return "Followed almost throughout", "good"
    if share >= 0.5:
        return "Followed, with gaps", "fair"
    return "Without a pose most of the time", "poor"


def _tracking_sentence(summary: Summary, by_camera: bool) -> str:
    if not summary.frames:
        return f"The recording holds no {summary.unit}s."
    share = words.percent(summary.pose_share)
    text = f"{summary.posed:,} of {words.count(summary.frames, summary.unit)} ({share}) have a pose"
    if not by_camera:
        return text + "."
    if not summary.lost_episodes:
        return text + ("; the camera was never lost." if summary.posed else ".")
    times = "once" if summary.lost_episodes == 1 else f"{summary.lost_episodes} times"
    return text + f"; the camera was lost {times}, for {words.duration(summary.lost_s)} in all."


def accuracy_sentence(record: RunRecord, summary: Summary) -> str:
    """How far the path is off, or why that cannot be said; nothing without a pose."""
    if not summary.posed:
        return ""
    if record.evaluation is None:
        why = record.evaluation_problem or "there is no ground truth"
        return f"How accurate the path is cannot be said: {why.rstrip('.')}."
    error = record.evaluation.ate.translation
    text = f"Laid upon the ground truth, the path errs by {words.length(error.rmse)} (RMSE) "
    text += f"and by {words.length(error.max)} at worst"
    if summary.length_m > 0:
        text += f", on {words.length(summary.length_m)} travelled"
    return text + "."


def speed_sentence(summary: Summary) -> str:
    """Whether it keeps up with its sensor; nothing where no time is known."""
    if not summary.median_s > 0:
        return ""
    text = f"A {summary.unit} takes {words.duration(summary.median_s)} at the median"
    source = "camera delivers" if summary.unit == "frame" else "wheels deliver"
    ratio = summary.frame_period_s / summary.median_s
    if not ratio > 0:
        return text + "."
    if ratio >= 1:
        return f"{text}, {words.number(ratio, 2)} times as fast as the {source} them."
    return f"{text}; the {source} {words.number(1 / ratio, 2)} in that time."


def _counted(reasons: tuple[tuple[str, int], ...]) -> str:
    text = ", ".join(f"{why} ({n:,})" for why, n in reasons[:_MOST_REASONS])
    left = sum(n for _, n in reasons[_MOST_REASONS:])
    return f"{text}, other reasons ({left:,})" if left else text


def _association_notes(record: RunRecord) -> list[str]:
    pairing = record.association
    if pairing is None or not (pairing.dropped_color or pairing.dropped_depth):
        return []
    return [
        f"{pairing.dropped_color:,} of {words.count(pairing.color_images, 'colour image')} and "
        f"{pairing.dropped_depth:,} of {words.count(pairing.depth_images, 'depth image')} found no partner within "
        f"{1e3 * pairing.max_gap_s:g} ms and were left out."
    ]


def _evaluation_notes(record: RunRecord, summary: Summary) -> list[str]:
    if record.evaluation is None:
        return []
    evaluation = record.evaluation
    found = []
    if evaluation.pairs < summary.posed:
        found.append(
            f"Only {evaluation.pairs:,} of {words.count(summary.posed, 'pose')} have a true pose beside them; "
            "errors speak of these alone."
        )
    if evaluation.scale is not None:
        found.append(f"Positions were multiplied by {evaluation.scale:.5f} to fit the ground truth.")
    return found
