"""`python -m benchmarks.joined`: wheels and camera joined, against each alone and the paper's filter, with faults.

Error is that of the base's position, RMSE over a localizer's answers, with its first pose laid upon the truth and no
further alignment: a best fit would hide what the heading lost. The better sensor of a drive is wheels alone or the
camera alone (dense odometry with its map), whichever has the smaller error there; a camera that has no pose for over a
tenth of the drive is none.

The right status of the joined estimate, reported at wheel readings and frames:

- camera covered: `coasting`, from 0.5 s after it is covered until it is not; `tracking` again within 2 s after.
- corridor: `degenerate` or `coasting`, while nothing but plain walls, floor and ceiling are within the depth camera's
  reach (10 m).
- lifted wheel, ice: `slip` or `doubtful`, while a wheel's rim runs more than 5 cm/s faster or slower than the ground
  under it, or the base slides sideways as fast, from 0.5 s after that has begun.
- people: `tracking`, or `coasting` where they hide what does not move; never `slip`, since no wheel slips.
- all others: `tracking`, the whole drive.

A position is within 3σ where its error (3,) is no less likely than one of 3σ is in one dimension.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.joined_cases import (
    CASES,
    DURATION_S,
    RATE_HZ,
    SIZE,
    Case,
    Way,
    drive_of,
)
from benchmarks.joined_figures import BACK_S, JoinedFigures, figures_of
from benchmarks.joined_hour import drive_long
from benchmarks.joined_images import kept_events
from benchmarks.joined_kept import KeptFigures
from benchmarks.joined_runs import CAMERA, JOINED, PAPER, WHEELS, run_all
from benchmarks.table import Sheet, shown, targets_sheet
from benchmarks.targets import Target
from wheelsight.core.files import write_text
from wheelsight.core.messages import Event
from wheelsight_sim import FloorPlan, SimulatedRecording
from wheelsight_sim.faults import events_with

SEEDS = 10
_ORDINARY, _FAULT, _TOLD, _END_PERCENT = 0.5, 1.2, 95.0, 0.5


def measure_joined(
    cases: Sequence[Case] = CASES,
    seeds: Sequence[int] = range(1, SEEDS + 1),
    duration_s: float = DURATION_S,
    odometry: str = "dense",
    images: Path | None = None,
    on_figures: Callable[[JoinedFigures], None] | None = None,
    keep: Path | None = None,
    plan: FloorPlan | None = None,
) -> list[JoinedFigures]:
    """Every case on the drives of all seeds; takes hours, and 250 MB for the images of a drive that cases share.

    Args:
        cases, seeds: what is measured.
        duration_s: of a drive, but for the one through the corridor and the long one.
        odometry: the camera's, "dense" (with a map) or "features".
        images: a folder that keeps images for another time, or None.
        on_figures: is reported each result as it comes.
        keep: a folder that keeps results; what it has is not measured again.
        plan: a building to drive in, in place of `floor4` and `flat`.
    """
    building = {} if plan is None else {"plan": plan.name}
    kept = KeptFigures(keep, {"duration_s": duration_s, "odometry": odometry, **building})
    figures = [found for seed in seeds for case in cases if (found := kept.of(case, seed)) is not None]
    known = {(found.case, found.seed) for found in figures}
    for seed in seeds:
        wanted = sorted((case for case in cases if (case, seed) not in known), key=lambda case: case.way.value)
        for way, group in groupby(wanted, key=lambda case: case.way):
            for found in _measure_drive(drive_of(way, seed, duration_s, plan), list(group), seed, odometry, images):
                figures.append(found)
                kept.keep(found)
                if on_figures is not None:
                    on_figures(found)
    return figures


def _measure_drive(
    recording: SimulatedRecording, cases: Sequence[Case], seed: int, odometry: str, images: Path | None
) -> Iterator[JoinedFigures]:
    wheels = recording.true_calibration.wheels
    assert wheels is not None
    rendered = list(recording.events()) if len(cases) > 1 and images is None else None
    for case in cases:
        events: Iterable[Event] = rendered or recording.events()
        if images is not None:
            events = kept_events(recording, images)
        faulty = events_with(case.camera_faults(recording), events)
        answers = run_all(faulty, case.calibration(recording), odometry)
        yield figures_of(case, seed, answers, recording.drive, wheels, case.lasts_s(recording))


def joined_sheet(figures: Sequence[JoinedFigures]) -> Sheet:
    """A row a case: medians over the drives, and in brackets the worst of them."""
    seeds = len({f.seed for f in figures})
    title = f"Wheels and camera joined, {_drives(seeds)} a case, {SIZE[0]}×{SIZE[1]} at {RATE_HZ:g} Hz: median (worst)"
    heads = ("wheels m", "camera m", "camera's poses", "paper's m", "joined m", "to the better", "at the end")
    rows = tuple(_row(case, _of(case, figures), seeds) for case in _cases(figures))
    return Sheet(title, ("case", *heads, "right status", "within 3σ", "back after", "slip detected, none"), rows)


def _row(case: Case, figures: Sequence[JoinedFigures], seeds: int) -> tuple[str, ...]:
    def median(name: str) -> str:
        return f"{np.median([f.accuracy[name].rmse_m for f in figures]):.3f}"

    ratios = [f.ratio for f in figures]
    ends = [100 * f.accuracy[JOINED].end_share for f in figures]
    backs = [f.back_s for f in figures if f.back_s is not None]
    fewer = f" ({_drives(len(figures))})" if len(figures) < seeds else ""
    return (
        case.name + fewer,
        median(WHEELS),
        median(CAMERA),
        f"{100 * np.median([f.accuracy[CAMERA].coverage for f in figures]):.0f} %",
        median(PAPER),
        median(JOINED),
        f"{np.median(ratios):.2f} ({max(ratios):.2f})",
        f"{np.median(ends):.2f} % ({max(ends):.2f})",
        _share([f.right for f in figures]),
        _share([f.within for f in figures]),
        f"{np.median(backs):.1f} s ({max(backs):.1f})" if backs else "—",
        f"{100 * np.mean([f.false_slip for f in figures]):.1f} %",
    )


def _drives(count: int) -> str:
    return f"{count} drive{'s' * (count != 1)}"


def judge_joined(figures: Sequence[JoinedFigures]) -> list[Target]:
    """Errors of ordinary drives by the median, those with faults by the worst; shares over all drives together."""
    return [target for case in _cases(figures) for target in _targets(case, _of(case, figures))]


def _targets(case: Case, figures: Sequence[JoinedFigures]) -> Iterator[Target]:
    ratios, name = [f.ratio for f in figures], f"joined, {case.name}"
    if case.way is Way.LONG:
        ends = [100 * f.accuracy[JOINED].end_share for f in figures]
        yield Target(f"{name}: error at the end, of the way, worst", _END_PERCENT, max(ends), "%", 2)
    if case.is_ordinary:
        yield Target(f"{name}: error to the better sensor's", _ORDINARY, float(np.median(ratios)), "", 2)
    else:
        yield Target(f"{name}: error to the better sensor's, worst", _FAULT, max(ratios), "", 2)
    backs = [f.back_s for f in figures if f.back_s is not None]
    if backs:
        yield Target(f"{name}: tracking again after", BACK_S, max(backs), "s", 1)
    yield Target(f"{name}: right status", _TOLD, _percent([f.right for f in figures]), "%", 1, is_least=True)
    yield Target(f"{name}: within 3σ", _TOLD, _percent([f.within for f in figures]), "%", 1, is_least=True)


def _cases(figures: Sequence[JoinedFigures]) -> list[Case]:
    measured = {f.case.name for f in figures}
    return [case for case in CASES if case.name in measured]


def _of(case: Case, figures: Sequence[JoinedFigures]) -> list[JoinedFigures]:
    return [f for f in figures if f.case.name == case.name]


def _percent(counts: Sequence[tuple[int, int]]) -> float | None:
    """Of all counted together; None where there are none."""
    asked = sum(count for count, _ in counts)
    return 100 * sum(right for _, right in counts) / asked if asked else None


def _share(counts: Sequence[tuple[int, int]]) -> str:
    """Of all counted together, and the worst."""
    percent = _percent(counts)
    if percent is None:
        return "—"
    return f"{percent:.1f} % ({min(100 * right / asked for asked, right in counts if asked):.0f})"


def reported(figures: JoinedFigures) -> str:
    """One result in a line."""
    errors = ", ".join(f"{name} {accuracy.rmse_m:.3f}" for name, accuracy in figures.accuracy.items())
    coverage = 100 * figures.accuracy[CAMERA].coverage
    return (
        f"{figures.case.name}, seed {figures.seed}: {errors} m (camera's poses {coverage:.0f} %), "
        f"{figures.ratio:.2f} of the better, end {100 * figures.accuracy[JOINED].end_share:.2f} %, "
        f"status {_share([figures.right])}, 3σ {_share([figures.within])}, "
        f"back {figures.back_s}, false slip {100 * figures.false_slip:.1f} %"
    )


def _named(words: Sequence[str]) -> list[Case]:
    """Cases of these names, or whose names hold one that is no case's whole name."""
    names = {case.name for case in CASES}
    return [
        case for case in CASES if any(word == case.name or (word not in names and word in case.name) for word in words)
    ]


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.joined", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, default=SEEDS, help="how many drives a case")
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="of the first drive")
    parser.add_argument("--cases", help="names of cases with commas; a part of a name will do")
    parser.add_argument("--duration", type=float, default=DURATION_S, metavar="S", help="of a drive")
    parser.add_argument("--odometry", choices=("dense", "features"), default="dense")
    parser.add_argument("--images", type=Path, metavar="DIR", help="keeps rendered images, 0.5 MB each, for next time")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keeps results; those kept are not measured again")
    parser.add_argument("--plan", type=Path, metavar="MAP.YAML|IMAGE", help="drive in this building instead")
    parser.add_argument("--resolution", type=float, metavar="M", help="metres a pixel of a plan that is an image")
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw one drive with faults instead")
    parser.add_argument("--hour", type=float, nargs="?", const=60.0, metavar="MINUTES", help="drive so long instead")
    parser.add_argument("--out", type=Path, help="Markdown file for the tables")
    return parser.parse_args()


def main() -> None:
    """Measure, print, and keep if asked to."""
    arguments = _parse()
    if arguments.picture is not None:
        from benchmarks.joined_picture import draw_joined

        draw_joined(arguments.picture, arguments.odometry, arguments.images)
        return
    if arguments.hour is not None:
        drive_long(arguments.hour, arguments.odometry)
        return
    cases = _named(arguments.cases.split(",")) if arguments.cases else CASES
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    given = (cases, seeds, arguments.duration, arguments.odometry, arguments.images)
    tell = partial(print, file=sys.stderr, flush=True)
    plan = None if arguments.plan is None else FloorPlan(arguments.plan, arguments.resolution)
    figures = measure_joined(*given, lambda found: tell(reported(found)), arguments.keep, plan)
    sheets = joined_sheet(figures), targets_sheet(judge_joined(figures))
    console = Console(width=None if sys.stdout.isatty() else 180)
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_text(arguments.out, _document(sheets, _command(arguments)))


def _command(arguments: argparse.Namespace) -> str:
    """The command that repeats this run, without this machine's paths."""
    words = ["python -m benchmarks.joined"]
    words += [f"--seeds {arguments.seeds}"] if arguments.seeds != SEEDS else []
    words += [f"--first {arguments.first}"] if arguments.first != 1 else []
    words += [f'--cases "{arguments.cases}"'] if arguments.cases else []
    words += [f"--duration {arguments.duration:g}"] if arguments.duration != DURATION_S else []
    words += [f"--plan {arguments.plan.name}"] if arguments.plan is not None else []
    words += [f"--resolution {arguments.resolution:g}"] if arguments.resolution is not None else []
    words += [f"--odometry {arguments.odometry}"] if arguments.odometry != "dense" else []
    return " ".join([*words, f"--out {shown(arguments.out)}"])


def _document(sheets: Sequence[Sheet], command: str) -> str:
    about = machine.description()
    lines = (f"- {name}: {about[name]}" for name in ("Date", "System", "Versions"))
    written = f"Written by `{command}`; how it measures: [Benchmarks](../benchmarks.md)."
    body = [*lines, "", *(sheet.to_markdown() for sheet in sheets)]
    return "\n".join(["# Wheels and camera joined", "", written, "", *body])


if __name__ == "__main__":
    main()
