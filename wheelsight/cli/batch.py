"""`wheelsight batch`: many recordings by several configurations, one table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.cli._batch_options import (
    Baseline,
    Configs,
    CostTolerance,
    Jobs,
    Out,
    Recordings,
    Scheduler,
    Seeds,
    Tolerance,
    cores,
    share,
)
from wheelsight.cli._console import INPUT_IS_WRONG
from wheelsight.interrupts import exit_code

if TYPE_CHECKING:
    from wheelsight.batch import BatchSettings, Row

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
    from wheelsight.batch import BatchSettings, named_recordings, plan_of, read_rows
    from wheelsight.cli._batch_run import run_plan, told_of
    from wheelsight.cli._console import print_note

    settings = BatchSettings()
    allowed = share(tolerance, "--tolerance")
    allowed_cost = None if cost_tolerance is None else share(cost_tolerance, "--cost-tolerance")
    before = None if baseline is None else read_rows(baseline)
    plan = plan_of(named_recordings(recordings), tuple(config or ()), seeds, settings)
    try:
        rows = run_plan(plan, out, jobs or cores(), scheduler, settings, told_of(plan, seeds))
    except KeyboardInterrupt as interruption:
        print_note(f"interrupted; what is done is kept in {out}, and the same command goes on")
        raise typer.Exit(exit_code()) from interruption
    is_broken = _print(rows, out)
    is_worse = before is not None and _is_worse(rows, before, allowed, allowed_cost, settings)
    if is_broken or is_worse:
        raise typer.Exit(INPUT_IS_WRONG if is_broken else _WORSE)


def _print(rows: Sequence[Row], out: Path) -> bool:
    """The table and where it is; whether anything is broken."""
    from wheelsight.batch import PAGE_FILE, TABLE_FILE
    from wheelsight.batch.table import DONE
    from wheelsight.cli._batch_view import batch_table
    from wheelsight.cli._console import console

    stdout = console()
    stdout.print(batch_table(rows), soft_wrap=False)
    broken = [row for row in rows if row.status != DONE]
    for row in broken:
        stdout.print(f"{row.recording}, {row.config}: {row.status}: {row.problem}")
    stdout.print(
        f"{len(rows) - len(broken)} of {len(rows)} rows are whole; table: {out / TABLE_FILE}, {out / PAGE_FILE}"
    )
    return bool(broken)


def _is_worse(
    rows: Sequence[Row],
    before: Sequence[Row],
    tolerance: float,
    cost_tolerance: float | None,
    settings: BatchSettings,
) -> bool:
    """Name what is worse than the baseline. Raises ConfigError where nothing can be compared."""
    from wheelsight.batch import compare
    from wheelsight.cli._console import console, print_warning
    from wheelsight.errors import ConfigError

    found = compare(rows, before, tolerance, cost_tolerance, settings)
    if not found.compared:
        raise ConfigError("the baseline has none of these recordings and configurations", fix="give another --baseline")
    for line in found.unmatched:
        print_warning(line)
    stdout = console()
    for line in found.worse:
        stdout.print(f"worse: {line}")
    judged = f"{found.compared} rows held against the baseline, {100 * tolerance:g} % allowed"
    stdout.print(f"{judged}: {len(found.worse) or 'none'} of their figures worse")
    return bool(found.worse)
