"""`python -m benchmarks.clocks`: wheels, camera and both while something is wrong with stamps.

A position's error is its distance from the truth, in a world that begins where the drive does; nothing is aligned. The
better sensor is wheels alone or the camera alone (dense odometry), whichever has the smaller RMSE on that drive; one
without a pose at over a tenth of the frames is none. Joined may be off by 1.2 times the better one's RMSE and 5 mm.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.clock_rows import DRIVE, ROWS, Row, drive_of
from benchmarks.clock_runs import COVERAGE, PLUS_M, TIMES, ClockFigures, Errors, measure_drive
from benchmarks.joined_runs import CAMERA, JOINED, WHEELS
from benchmarks.table import Sheet, shown
from wheelsight.core.files import write_text
from wheelsight_sim import SimulationSettings

SEEDS = 10
_MADE = (
    "A drive is what `wheelsight simulate flat --rate 10 --duration 25 --size 320x240 --seed N` writes. Errors are "
    "RMSE of the base's position in mm from where the drive began, nothing aligned: the median over the drives, and in "
    "brackets the worst. `posed` and `sure and wrong` (`tracking`, yet outside 3σ in the plane: 2 degrees of freedom, "
    f"99.73 %) are of joined, over all drives together. `of allowed` is the worst joined error by {TIMES:g} times the "
    f"better sensor's and {1000 * PLUS_M:g} mm; a sensor counts where it has a pose at {100 * COVERAGE:.0f} % of the "
    "frames. Where wheels are in another epoch joined refuses the camera by name and is judged at readings."
)


def measure_clocks(
    rows: Sequence[Row],
    seeds: Sequence[int],
    images: Path,
    on_figures: Callable[[ClockFigures], None],
    keep: Path | None = None,
    settings: SimulationSettings = DRIVE,
) -> list[ClockFigures]:
    """Every row on the drives of all seeds; about three minutes a seed.

    Args:
        rows, seeds: what is measured.
        images: a folder of drives; what is missing is put there, 41 MB each.
        on_figures: is reported each result as it comes.
        keep: a folder that keeps results; what it has is not measured again.
        settings: of a drive.
    """
    figures: list[ClockFigures] = []

    def take(found: ClockFigures) -> None:
        figures.append(found)
        on_figures(found)
        if keep is not None:
            write_text(_kept(keep, found.row, found.seed), json.dumps(asdict(found), indent=1))

    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        figures += [_read(path) for seed in seeds for row in rows if (path := _kept(keep, row.name, seed)).exists()]
    known = {(found.row, found.seed) for found in figures}
    for seed in seeds:
        wanted = [row for row in rows if (row.name, seed) not in known]
        if wanted:
            measure_drive(drive_of(seed, images, settings), wanted, seed, take)
    return figures


def _kept(folder: Path, row: str, seed: int) -> Path:
    return folder / f"{re.sub('[^a-z0-9+−]+', '-', row.lower())}-{seed}.json"


def _read(path: Path) -> ClockFigures:
    record = json.loads(path.read_text())
    return ClockFigures(
        record["row"], record["seed"], {name: Errors(**errors) for name, errors in record["errors"].items()}
    )


def clocks_sheet(figures: Sequence[ClockFigures]) -> Sheet:
    """A line a row: medians over the drives, and in brackets the worst of them."""
    seeds = sorted({f.seed for f in figures})
    title = f"Faults of stamps, {len(seeds)} drive{'s' * (len(seeds) != 1)} a row: median (worst)"
    heads = ("camera mm", "camera posed", "wheels mm", "joined mm", "of allowed", "posed", "sure and wrong")
    names = [row.name for row in ROWS if any(f.row == row.name for f in figures)]
    rows = tuple(_line(name, [f for f in figures if f.row == name]) for name in names)
    return Sheet(title, ("row", *heads, "tracebacks", "met"), rows)


def _line(name: str, figures: Sequence[ClockFigures]) -> tuple[str, ...]:
    joined = [f.errors[JOINED] for f in figures]
    return (
        name,
        _errors(figures, CAMERA),
        _percent([f.errors[CAMERA] for f in figures]),
        _errors(figures, WHEELS),
        _errors(figures, JOINED),
        _number(max(f.ratio for f in figures), 2),
        _percent(joined),
        str(sum(e.wrong for e in joined)),
        str(sum(len(f.problems) for f in figures)),
        f"{sum(f.is_met for f in figures)} of {len(figures)}",
    )


def _errors(figures: Sequence[ClockFigures], name: str) -> str:
    errors_mm = [1000 * f.errors[name].rmse_m for f in figures]
    return f"{_number(float(np.median(errors_mm)), 1)} ({_number(max(errors_mm), 1)})"


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else "—"


def _percent(errors: Sequence[Errors]) -> str:
    """Of frames with a pose; equal drives have equally many."""
    return f"{100 * np.mean([e.posed for e in errors]):.1f} %"


def reported(figures: ClockFigures) -> str:
    """One result in a line."""
    errors = ", ".join(
        f"{name} {_number(1000 * e.rmse_m, 1)} mm ({100 * e.posed:.0f} % posed, {e.wrong} sure and wrong)"
        for name, e in figures.errors.items()
    )
    problems = "".join(f"; {problem}" for problem in figures.problems)
    return f"{figures.row}, seed {figures.seed}: {errors}, {_number(figures.ratio, 2)} of allowed{problems}"


def _named(words: Sequence[str]) -> list[Row]:
    """Rows of these names, or whose names hold one that is no row's whole name."""
    names = {row.name for row in ROWS}
    return [row for row in ROWS if any(word == row.name or (word not in names and word in row.name) for word in words)]


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.clocks", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, default=SEEDS, help="how many drives a row")
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="of the first drive")
    parser.add_argument("--rows", metavar="NAMES", help="names of rows with commas; a part of a name will do")
    parser.add_argument("--images", type=Path, metavar="DIR", help="keeps drives, 41 MB each, for next time")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keeps results; those kept are not measured again")
    parser.add_argument("--out", type=Path, help="Markdown file for the table")
    return parser.parse_args()


def main() -> None:
    """Measure, print, and keep if asked to."""
    arguments = _parse()
    rows = _named(arguments.rows.split(",")) if arguments.rows else ROWS
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    with TemporaryDirectory() as made:
        images = arguments.images or Path(made)
        figures = measure_clocks(rows, seeds, images, _tell, arguments.keep)
    sheet = clocks_sheet(figures)
    Console(width=None if sys.stdout.isatty() else 180).print(sheet.to_rich())
    if arguments.out is not None:
        write_text(arguments.out, _document(sheet, _command(arguments)))


def _tell(figures: ClockFigures) -> None:
    print(reported(figures), file=sys.stderr, flush=True)


def _command(arguments: argparse.Namespace) -> str:
    """The command that repeats this run, without this machine's paths."""
    words = ["python -m benchmarks.clocks"]
    words += [f"--seeds {arguments.seeds}"] if arguments.seeds != SEEDS else []
    words += [f"--first {arguments.first}"] if arguments.first != 1 else []
    words += [f'--rows "{arguments.rows}"'] if arguments.rows else []
    return " ".join([*words, f"--out {shown(arguments.out)}"])


def _document(sheet: Sheet, command: str) -> str:
    about = machine.description()
    lines = (f"- {name}: {about[name]}" for name in ("Date", "System", "Versions"))
    written = f"Written by `{command}`; how it measures: [Benchmarks](../benchmarks.md)."
    return "\n".join(["# Faults of stamps", "", written, "", *lines, "", _MADE, "", sheet.to_markdown()])


if __name__ == "__main__":
    main()
