"""Loop closing of a run: by the localizer during the run, or by matches from outside after it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wheelsight.app.run import words
from wheelsight.config import Config
from wheelsight.core.errors import ArgumentError, ConfigError
from wheelsight.core.messages import Match, SpeedVariances
from wheelsight.core.robots import EventSource
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.evaluation import Evaluation
from wheelsight.io.recordings import MATCHES_FILE, HasMatches, Recording, matches_of, read_matches
from wheelsight.slam.loop_closing import Correction, correct, corrected_by
from wheelsight.slam.settings import FROM_KEYFRAMES, FROM_MATCHES, FROM_NOWHERE
from wheelsight.wheels import WheelOdometry

_CHOICES = f"{FROM_KEYFRAMES}, {FROM_MATCHES}, {FROM_NOWHERE}"
CORRECTED_FILE, JUDGED_FILE = "trajectory_corrected.txt", "loops_judged.csv"


@dataclass(frozen=True, slots=True, eq=False)
class MatchesOfRun:
    """Matches from outside that a run evaluates.

    Attributes:
        matches: as read.
        stated: the recording's variances of its wheel odometry, or None.
        warnings: of the files.
        are_seen: whether the localizer closes loops itself; then there are no matches.
    """

    matches: tuple[Match, ...]
    stated: SpeedVariances | None
    warnings: tuple[str, ...]
    are_seen: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class CorrectionRecord:
    """The loops of one track.

    Attributes:
        found: the corrected trajectory, and the verdict on each match.
        stamps_s: (K,) stamps of the keyframes of this drive.
        matches: number of matches.
        seconds: time for the correction.
        evaluation: of the corrected trajectory, or None without truth.
        refused: number of similar keyframes that were rejected as loops, by reason.
        unseen: number of keyframes that were not compared for lack of time.
        is_joined: whether the end of the drive has a known place in its own map.
    """

    found: Correction
    stamps_s: Any
    matches: int
    seconds: float
    evaluation: Evaluation | None
    refused: Mapping[str, int] = field(default_factory=dict)
    unseen: int = 0
    is_joined: bool = True

    def to_dict(self) -> dict[str, Any]:
        """For metrics.json."""
        loops = self.found.loops
        return {
            "matches": self.matches,
            "kept": len(loops.kept),
            "refused": len(loops.refused),
            "refused_by": loops.refusals,
            "not_judged": dict(self.found.unused),
            "not_verified": dict(self.refused),
            "not_compared": self.unseen,
            "joined": self.is_joined,
            "reviews": loops.reviews,
            "overturned": loops.overturned,
            "keyframes": len(self.found.rows),
            "seconds": self.seconds,
            "evaluation": None if self.evaluation is None else self.evaluation.to_dict(),
        }

    @property
    def sentence(self) -> str:
        """The number of kept and refused loops."""
        loops = self.found.loops
        unused = "".join(f", {count:,} not judged ({why})" for why, count in self.found.unused.items())
        unused += f", {self.unseen:,} keyframes not compared for want of time" if self.unseen else ""
        return f"{self.matches:,} matches: {len(loops.kept):,} kept, {len(loops.refused):,} refused{unused}"


def matches_of_run(source: EventSource, config: Config) -> MatchesOfRun | None:
    """The matches that a run evaluates, or None. Raises ConfigError where there are none, RecordingError."""
    asked = config.loops.source
    if asked == FROM_NOWHERE:
        return None
    stated = source.speed_variances if isinstance(source, HasMatches) else None
    if asked == FROM_KEYFRAMES:
        # The localizer closes loops; the run evaluates them at its end.
        if set(config.odometry) <= {"wheels"}:
            raise ConfigError("--loops keyframes needs a camera", fix="--odometry dense, or --loops matches")
        return MatchesOfRun((), None, (), are_seen=True)
    if asked != FROM_MATCHES:
        if not Path(asked).exists():
            raise ConfigError(f"--loops {asked}: there is no such file", fix=f"{_CHOICES}, or a file that is there")
        matches, warnings = read_matches(Path(asked))
    elif isinstance(source, Recording):
        matches, warnings = matches_of(source)
    else:
        raise ConfigError("a live source has no matches", fix="--loops FILE, or none")
    if not matches:
        raise ConfigError("the recording has no matches", fix=f"write {MATCHES_FILE} into its folder, or no --loops")
    return MatchesOfRun(tuple(matches), stated, tuple(warnings))


def correction_of(
    given: MatchesOfRun, localizer: Localizer, lived: Trajectory, judge: Callable[[Trajectory], Evaluation | None]
) -> tuple[CorrectionRecord | None, tuple[str, ...]]:
    """The correction of a track's trajectory by loops, or None; and warnings."""
    if not given.are_seen:
        # Matches from outside
        is_wheels = isinstance(localizer.odometry, WheelOdometry)
        began = time.perf_counter()
        try:
            corrected = correct(lived, given.matches, stated=given.stated if is_wheels else None)
        except ArgumentError as error:
            return None, (*given.warnings, f"Loops were not closed: {error}.")
        took_s = time.perf_counter() - began
        record = CorrectionRecord(
            corrected, lived.stamps_s[corrected.rows], len(given.matches), took_s, judge(corrected.corrected)
        )
        return record, given.warnings
    if localizer.loops is None:
        return None, ()
    started = time.perf_counter()
    closed = localizer.loops.finish()
    if not (len(lived) and len(closed.stamps_s)):
        return None, ("Loops were not closed: no keyframe has a pose.",)
    if closed.known and not closed.is_in_map.any():
        return None, ()
    found = corrected_by(closed, lived)
    seconds, count = time.perf_counter() - started, len(closed.loops.decisions)
    judged = judge(found.corrected), closed.refused, closed.unseen, bool(closed.known) or closed.is_joined
    return CorrectionRecord(found, closed.stamps_s, count, seconds, *judged), ()


def judged_csv(record: CorrectionRecord) -> str:
    """One row for each match; a keyframe of a known map has a number and no stamp."""
    head = ["stamp_a_s", "stamp_b_s", "kept", "chi2", "limit", "cluster", "keyframe_a", "keyframe_b"]
    rows: list[list[object]] = []
    first_new = len(record.found.T_map_keyframe) - len(record.stamps_s)
    for one in record.found.loops.decisions:
        ends = (one.loop.first, one.loop.second)
        stamps = (words.stamp(record.stamps_s[at - first_new]) if at >= first_new else "" for at in ends)
        rows.append([*stamps, int(one.is_kept), f"{one.chi2:.3f}", f"{one.limit:.3f}", one.cluster, *ends])
    return words.csv_text(head, rows)
