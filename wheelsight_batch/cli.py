"""`wheelsight batch`: several recordings with several configurations, and one table."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.app.cli.console import INPUT_IS_WRONG
from wheelsight.app.cli.options import OUTPUT, option
from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import exit_code

if TYPE_CHECKING:
    pass


_WORSE = 1


def batch(
    recordings: Recordings,
    out: Out,
    config: Configs = None,
    seeds: Seeds = 1,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    baseline: Baseline = None,
    tolerance: Tolerance = "10%",
    cost_tolerance: CostTolerance = None,
) -> None:
    """Run many recordings by several configurations, several seeds each: one table of medians and worst.

    A job is a recording, a configuration and a seed, on one thread of a process of its own. What is done stays in DIR:
    the same command goes on where it was ended. A recording that breaks is a row with its reason; the rest goes on.

    Exit code 0: all is well; 1: figures are worse than the baseline's; 2: something broke.

    [bold]Examples[/bold]

    wheelsight batch data/2026-11-* --out table

    wheelsight batch monday tuesday --config features.yaml --config dense.yaml --seeds 5 --out table

    wheelsight batch data --baseline accepted.csv --tolerance 5% --out table

    wheelsight batch data --scheduler tcp://192.168.1.5:8786 --out table
    """
    from wheelsight.app.cli.console import console, print_note, print_warning
    from wheelsight_batch import PAGE_FILE, TABLE_FILE, compare, named_recordings, plan_of, read_rows
    from wheelsight_batch.progress import batch_table, notes_on, run_plan
    from wheelsight_batch.table import DONE

    allowed = share(tolerance, "--tolerance")
    allowed_cost = None if cost_tolerance is None else share(cost_tolerance, "--cost-tolerance")
    before = None if baseline is None else read_rows(baseline)
    plan = plan_of(named_recordings(recordings), tuple(config or ()), seeds)
    try:
        rows = run_plan(plan, out, jobs or cores(), scheduler, notes_on(plan, seeds))
    except KeyboardInterrupt as interruption:
        print_note(f"interrupted; what is done is kept in {out}, and the same command goes on")
        raise typer.Exit(exit_code()) from interruption
    stdout = console()
    stdout.print(batch_table(rows), soft_wrap=False)
    broken = [row for row in rows if row.status != DONE]
    for row in broken:
        stdout.print(f"{row.recording}, {row.config}: {row.status}: {row.problem}")
    stdout.print(
        f"{len(rows) - len(broken)} of {len(rows)} rows are whole; table: {out / TABLE_FILE}, {out / PAGE_FILE}"
    )
    worse: Sequence[str] = ()
    if before is not None:
        found = compare(rows, before, allowed, allowed_cost)
        worse = found.worse
        if not found.compared:
            fix = "give another --baseline"
            raise ConfigError("the baseline has none of these recordings and configurations", fix=fix)
        for line in found.unmatched:
            print_warning(line)
        for line in worse:
            stdout.print(f"worse: {line}")
        judged = f"{found.compared} rows held against the baseline, {100 * allowed:g} % allowed"
        stdout.print(f"{judged}: {len(worse) or 'none'} of their figures worse")
    if broken or worse:
        raise typer.Exit(INPUT_IS_WRONG if broken else _WORSE)


_RUNS, _BASELINE = "What is run", "Against a baseline"

Recordings = Annotated[
    list[str],
    typer.Argument(
        metavar="RECORDING...",
        help="Recordings, folders that hold some, or patterns such as 'data/2026-*'.",
        show_default=False,
    ),
]
Out = Annotated[Path, option("Folder for the table and what is done; made if need be.", "DIR", False, OUTPUT)]
Configs = Annotated[
    list[Path] | None,
    option("Settings in YAML. May be given again.", "FILE", "the defaults alone", _RUNS, flag="--config"),
]
Seeds = Annotated[int, option("Runs of each; where nothing is random, one is made, not N.", "N", panel=_RUNS, min=1)]
Jobs = Annotated[int | None, option("Processes at once.", "N", "one a core", _RUNS, flag="--jobs", min=1)]
Scheduler = Annotated[
    str | None,
    option(
        "Run on the workers of a Dask scheduler, such as tcp://192.168.1.5:8786.", "ADDRESS", "on this computer", _RUNS
    ),
]
Baseline = Annotated[
    Path | None, option("table.csv of an earlier batch; what is worse is named.", "CSV", "none", _BASELINE)
]
Tolerance = Annotated[
    str, option("By how much errors may grow, and frames with a pose get fewer.", "SHARE", panel=_BASELINE)
]
CostTolerance = Annotated[
    str | None,
    option(
        "By how much time and memory may grow; only where the baseline is of the same computer.",
        "SHARE",
        "not judged",
        _BASELINE,
    ),
]


def share(text: str, option: str) -> float:
    """The value of "10%" or "0.1". Raises ConfigError."""
    try:
        value = float(text.removesuffix("%").strip()) / (100 if text.endswith("%") else 1)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise ConfigError(f"{option} is {text}, not a share from 0 up", fix="such as 10% or 0.1")
    return value


def cores() -> int:
    """Number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
