"""`python -m benchmarks.bad_input`: what trackers make of a camera that fails, and of views that are hard to track."""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from rich.console import Console
from scipy.stats import chi2

from benchmarks.bad_drives import DRIVES, BadDrive, Case
from benchmarks.table import Sheet
from benchmarks.targets import Target
from wheelsight.config import Config, load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import BoolArray, FloatArray, se3, so3
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import express_for
from wheelsight_sim import RealismName, realism_names
from wheelsight_sim.faults import events_with

MAPPER, JOINED = "surfels", "wheels, dense"
WRONG_M, WRONG_RAD = 0.10, np.deg2rad(5.0)
# The square of a distance in standard deviations that three dimensions exceed as rarely as one exceeds 3 σ.
_THREE_SIGMA = float(chi2.ppf(chi2.cdf(9.0, 1), 3))


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a tracker said to one frame, and whether a map learned from that frame."""

    estimate: Estimate
    was_fused: bool = False


@dataclass(frozen=True, slots=True)
class BadInputFigures:
    """How one tracker fared in one case.

    Attributes:
        case, tracker: names.
        frames: that it was given; with_pose: that got one.
        rmse_m, worst_m: distance from the truth of poses given, laid upon it at the first; nan without any.
        statuses: how many frames of the fault's time got which status, by its name.
        wrong: frames further than 10 cm or 5° off what has happened since the fault began, or since the last good
            frame before it; all of them were called tracking.
        back_s: from the fault's end to the next pose, seconds; None where there is none or the fault never ends.
        fused_wrong: frames that a map learned from at a wrong pose.
        fused_failed: frames that a map learned from though tracking had failed.
        within: share of the poses that lie within three of their standard deviations, position alone.
    """

    case: str
    tracker: str
    frames: int
    with_pose: int
    rmse_m: float
    worst_m: float
    statuses: tuple[tuple[str, int], ...]
    wrong: int
    back_s: float | None
    fused_wrong: int
    fused_failed: int
    within: float


Track = Callable[[Event], "Answer | None"]
"""What answers frames, and hears all other events."""


def trackers() -> dict[str, Callable[[Calibration], Track]]:
    """Each by its name: given a calibration, what answers frames, as a camera alone, or joined with wheels."""
    by_name: dict[str, dict[str, object]] = {
        "features": {"odometry": "features"},
        "dense": {"odometry": "dense"},
        MAPPER: {"odometry": "dense", "map": "surfels"},
        JOINED: {"odometry": "wheels,dense"},
    }
    return {name: partial(_tracker, load_config(overrides=settings)) for name, settings in by_name.items()}


def _tracker(config: Config, calibration: Calibration) -> Track:
    T_base_camera = calibration.T_base_camera if len(config.odometry) > 1 else None
    localizer = Localizer(replace(calibration, T_base_camera=T_base_camera), config)

    def answer(event: Event) -> Answer | None:
        fused = _fused(localizer)
        estimate = localizer.process(event)
        if estimate is None or not isinstance(event, RgbdFrame):
            return None
        if T_base_camera is not None and estimate.T_odom_body is not None:
            estimate = replace(estimate, T_odom_body=estimate.T_odom_body @ T_base_camera)
        return Answer(estimate, _fused(localizer) > fused)

    return answer


def _fused(localizer: Localizer) -> int:
    return 0 if localizer.map is None else localizer.map.frames


def measure_bad_input(
    drives: Sequence[BadDrive] = DRIVES,
    on_figures: Callable[[BadInputFigures], None] | None = None,
    *,
    realism: RealismName = "real",
    names: Sequence[str] = (),
) -> list[BadInputFigures]:
    """Every tracker in every case; each drive is rendered once and held in memory, about 250 MB.

    Takes some minutes; `on_figures` is reported each result as it comes.

    Args:
        realism: of the simulator.
        names: only cases whose names hold one of these; of none, all.
    """
    figures = []
    for drive in drives:
        for found in _measure_drive(drive, realism, names):
            figures.append(found)
            if on_figures is not None:
                on_figures(found)
    return figures


def _measure_drive(drive: BadDrive, realism: RealismName, names: Sequence[str]) -> Iterator[BadInputFigures]:
    recording = drive.record(realism)
    cases = [case for case in drive.cases(recording) if not names or any(name in case.name for name in names)]
    if not cases:
        return  # rendering takes half a minute
    events, calibration = list(recording.events()), recording.calibration
    truth = express_for("camera", recording.ground_truth, recording.true_calibration)
    for case in cases:
        for name, start in trackers().items():
            yield measure_case(case, name, start(calibration), events, truth)


def measure_case(case: Case, tracker: str, track: Track, events: Sequence[Event], truth: Trajectory) -> BadInputFigures:
    """One tracker over a drive's events as the case spoils them; truth is T_odom_camera."""
    reported = map(track, events_with(case.faults, events))
    answers = [answer for answer in reported if answer is not None]
    posed = [answer for answer in answers if answer.estimate.T_odom_body is not None]
    # With jitter, a frame's stamp may lie beyond the drive's last instant, of which nothing is known.
    is_known = np.isfinite(truth.at([answer.estimate.stamp_s for answer in posed])).all(axis=(1, 2))
    posed = [posed[index] for index in np.flatnonzero(is_known)]
    stamps_s = np.array([answer.estimate.stamp_s for answer in posed])
    T = np.array([answer.estimate.T_filter_body for answer in posed]).reshape(-1, 4, 4)
    T_true = truth.at(stamps_s)
    covariances = np.array([answer.estimate.filter_covariance for answer in posed]).reshape(-1, 6, 6)
    is_sure = np.array([_is_sure(answer.estimate) for answer in posed], bool)
    wrong = _wrong(T, T_true, stamps_s, case.begin_s) & is_sure
    off_m = np.linalg.norm(_laid_upon(T, T_true, 0)[:, :3, 3] - T_true[:, :3, 3], axis=1)
    fused = np.array([answer.was_fused for answer in posed], bool)
    return BadInputFigures(
        case.name,
        tracker,
        len(answers),
        len(posed),
        float(np.sqrt(np.mean(off_m**2))) if len(posed) else math.nan,
        float(off_m.max(initial=0.0)) if len(posed) else math.nan,
        _statuses(answers, case),
        int(wrong.sum()),
        _back_s(stamps_s, case),
        int((wrong & fused).sum()),
        sum(answer.was_fused and answer.estimate.status is not Status.TRACKING for answer in answers),
        float(np.mean(_within(T, T_true, covariances))) if len(posed) else math.nan,
    )


def _is_sure(estimate: Estimate) -> bool:
    """Whether a pose is given as good: joined, there is one at most times, and what is wrong with it is reported."""
    return estimate.status is Status.TRACKING and not getattr(estimate, "doubtful", False)


def _laid_upon(T: FloatArray, T_true: FloatArray, index: int) -> FloatArray:
    """Poses (N, 4, 4) moved so that the one of that index is the true one."""
    return np.asarray(se3.compose(T_true[index] @ se3.invert(T[index]), T)) if len(T) else T


def _wrong(T: FloatArray, T_true: FloatArray, stamps_s: FloatArray, begin_s: float) -> BoolArray:
    """Which poses (N,) are off by more than the limits, once the last one before the fault is laid on its truth."""
    laid = _laid_upon(T, T_true, max(int(np.searchsorted(stamps_s, begin_s)) - 1, 0))
    off_m = np.linalg.norm(laid[:, :3, 3] - T_true[:, :3, 3], axis=1)
    off_rad = so3.angle(np.swapaxes(T_true[:, :3, :3], 1, 2) @ laid[:, :3, :3])
    return np.asarray((stamps_s >= begin_s) & ((off_m > WRONG_M) | (off_rad > WRONG_RAD)))


def _within(T: FloatArray, T_true: FloatArray, covariances: FloatArray) -> BoolArray:
    """Which positions (N,) lie within three standard deviations, in the world that the first pose began."""
    laid = _laid_upon(T_true, T, 0)
    P = se3.position_covariance(T, covariances) + 1e-12 * np.eye(3)
    off_m = laid[:, :3, 3] - T[:, :3, 3]
    return np.asarray(np.einsum("ni,nij,nj->n", off_m, np.linalg.inv(P), off_m) <= _THREE_SIGMA)


def _statuses(answers: Sequence[Answer], case: Case) -> tuple[tuple[str, int], ...]:
    reported = [a.estimate.status.value for a in answers if case.begin_s <= a.estimate.stamp_s < case.end_s]
    return tuple(Counter(reported).most_common())


def _back_s(stamps_s: FloatArray, case: Case) -> float | None:
    """From the end of the fault to the first pose after it."""
    after = stamps_s[stamps_s >= case.end_s]
    return float(after[0] - case.end_s) if len(after) else None


def bad_input_sheet(figures: Sequence[BadInputFigures]) -> Sheet:
    """A row for each case and tracker."""
    heads = ("case", "tracker", "poses", "RMSE, m", "worst, m", "while it lasts", "wrong, unsaid", "back after")
    rows = tuple(
        (
            f.case,
            f.tracker,
            f"{f.with_pose} of {f.frames}",
            f"{f.rmse_m:.3f}",
            f"{f.worst_m:.3f}",
            ", ".join(f"{count} {status}" for status, count in f.statuses) or "no frames",
            str(f.wrong),
            "—" if f.back_s is None else f"{f.back_s:.2f} s",
            str(f.fused_wrong) if f.tracker == MAPPER else "—",
            f"{100 * f.within:.0f} %",
        )
        for f in figures
    )
    return Sheet("Bad input, simulated", (*heads, "fused wrong", "in 3 σ"), rows)


def judge_bad_input(figures: Sequence[BadInputFigures]) -> list[Target]:
    """No failure may go unsaid, and none may reach the map. Features are there for comparison."""
    targets = [
        Target(f"{f.case}: {f.tracker}, wrong poses called tracking", 0, f.wrong, "frames", 0)
        for f in figures
        if f.tracker != "features"
    ]
    failed = sum(f.fused_failed for f in figures)
    return [*targets, Target("bad input: frames fused though tracking had failed", 0, failed, "frames", 0)]


def main() -> None:
    """Measure all cases; print the table and the verdicts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bad_input", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="print the table as Markdown, to keep")
    parser.add_argument("--cases", nargs="+", default=(), metavar="NAME", help="only cases with one of these names")
    parser.add_argument("--realism", choices=realism_names(), default="real", help="of the simulator")
    arguments = parser.parse_args()
    figures = measure_bad_input(
        on_figures=lambda f: print(f"{f.case}: {f.tracker}", file=sys.stderr),
        realism=arguments.realism,
        names=arguments.cases,
    )
    sheet = bad_input_sheet(figures)
    if arguments.markdown:
        print(sheet.to_markdown())
    else:
        Console(width=None if sys.stdout.isatty() else 180).print(sheet.to_rich())
    for target in judge_bad_input(figures):
        print(f"{target.what}: {target.verdict}")


if __name__ == "__main__":
    main()
