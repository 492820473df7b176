"""A batch in a few verbs: what is done already, run the rest, keep each, make the table."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from wheelsight.batch.jobs import Job, Plan
from wheelsight.batch.kept import KeptOutcomes
from wheelsight.batch.outcome import Outcome
from wheelsight.batch.table import Row, csv_text, markdown_text, rows_of
from wheelsight.files import StrPath, write_text

TABLE_FILE, PAGE_FILE = "table.csv", "table.md"


class Done(NamedTuple):
    """A step of a batch.

    Attributes:
        jobs, of_jobs: how many are done, those of an earlier call among them, and of how many.
        weight, of_weight: bytes of recordings that this call is done with, and has to do in all.
        outcome, job: what was just done, or None at the beginning.
    """

    jobs: int
    of_jobs: int
    weight: int
    of_weight: int
    outcome: Outcome | None
    job: Job | None


def run_batch(
    plan: Plan,
    out: StrPath,
    runner: Callable[[Sequence[Job]], Generator[Outcome]],
    on_done: Callable[[Done], None] = lambda done: None,
) -> tuple[Row, ...]:
    """Run what is not done yet, keep each outcome at once, and write table.csv and table.md at the end.

    Whatever ends it, what was done stays in `out`, and the next call goes on with the rest.

    Args:
        plan: rows and jobs.
        out: folder of the batch; made if need be.
        runner: gives outcomes of jobs as they come, such as `run_on_processes`.
        on_done: told once before the first job, and after each.

    Raises:
        OutputError: `out` holds something else, or cannot be written.
    """
    kept = KeptOutcomes(out)
    outcomes = kept.found(plan.jobs)
    todo = [job for job in plan.jobs.values() if job.id not in outcomes]
    weight, count = sum(job.weight for job in todo), len(outcomes)
    left = weight
    on_done(Done(count, len(plan.jobs), 0, weight, None, None))
    with closing(runner(todo)) as answers:  # an exception here ends its processes, too
        for outcome in answers:
            job = plan.jobs[outcome.job]
            kept.keep(outcome, job)
            outcomes[job.id] = outcome
            left, count = left - job.weight, count + 1
            on_done(Done(count, len(plan.jobs), weight - left, weight, outcome, job))
    rows = rows_of(plan.cases, outcomes)
    write_text(Path(out) / TABLE_FILE, csv_text(rows))
    write_text(Path(out) / PAGE_FILE, markdown_text(rows))
    return rows
