"""What `wheelsight batch` does once all is known: compile, run, show how far it is."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Generator, Sequence
from pathlib import Path

from wheelsight.batch import (
    BatchSettings,
    Done,
    Job,
    Outcome,
    Plan,
    Row,
    run_batch,
    run_job,
    run_on_fleet,
    run_on_processes,
)
from wheelsight.batch.kept import KeptOutcomes
from wheelsight.cli._batch_view import BatchProgress
from wheelsight.cli._compiling import compile_missing
from wheelsight.cli._console import print_note
from wheelsight.config import Config
from wheelsight.pipeline.kernels import parts_of


def run_plan(
    plan: Plan, out: Path, processes: int, scheduler: str | None, settings: BatchSettings, notes: Sequence[str] = ()
) -> Sequence[Row]:
    """Rows of the table, with progress on stderr, after some notes; what is done already is not run again."""
    done = KeptOutcomes(out).found(plan.jobs)  # refuses a folder of something else before anything is compiled
    for note in notes:
        print_note(note)
    if scheduler is None:
        _compile([job for job in plan.jobs.values() if job.id not in done])
    with tempfile.TemporaryDirectory(prefix=".scratch-", dir=out) as scratch, BatchProgress() as progress:

        def runner(jobs: Sequence[Job]) -> Generator[Outcome]:
            if scheduler is not None:
                return run_on_fleet(jobs, scheduler, run_job, connect_s=settings.connect_s, on_note=progress.tell)
            tries = settings.tries
            return run_on_processes(jobs, processes, run_job, Path(scratch), tries=tries, on_death=again)

        def again(job: Job, why: str) -> None:
            progress.tell(f"{_name(job)}: {why}; it is tried again")

        def show(step: Done) -> None:
            progress.show(step)
            if step.job is not None and step.outcome is not None and step.outcome.problem is not None:
                progress.tell(f"{_name(step.job)}: {step.outcome.problem}")

        for case in plan.cases:
            if case.problem is not None:
                progress.tell(f"{case.recording}, {case.config}: {case.problem}")
        return run_batch(plan, out, runner, show)


def told_of(plan: Plan, seeds: int) -> list[str]:
    """What is run otherwise than a user may expect, and which odometry it is where no configuration names one."""
    told = []
    if once := sum(0 < len(case.jobs) < seeds for case in plan.cases):
        told.append(f"{once} of {len(plan.cases)} rows have nothing random, and are run once")
    if chosen := Counter(case.chosen for case in plan.cases if case.chosen):
        found = ", ".join(f"{name} of {count}" for name, count in chosen.most_common())
        told.append(f"odometry by what a recording has: {found} (odometry: in a --config chooses otherwise)")
    return told


def _compile(jobs: Sequence[Job]) -> None:
    """What all of them need, once: else each process would compile it by itself."""
    parts = {part: None for job in jobs for part in parts_of(Config.model_validate(job.settings))}
    if parts:
        compile_missing(tuple(parts))


def _name(job: Job) -> str:
    return f"{Path(job.recording).name}, seed +{job.seed}"
