"""The work of `wheelsight batch`: compiles kernels, runs the jobs, shows progress and prints the table."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Generator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from rich.box import SIMPLE_HEAD
from rich.progress import ProgressColumn, Task, TextColumn
from rich.table import Table
from rich.text import Text

from wheelsight.app.cli.compiling import compile_missing
from wheelsight.app.cli.console import print_note
from wheelsight.app.cli.progress import left_text, progress_line, whole
from wheelsight.app.run.kernels import parts_of
from wheelsight.config import Config
from wheelsight_batch import BatchPlan, BatchRow, Done, Job, Outcome, run_batch, run_job, run_on_fleet, run_on_processes
from wheelsight_batch.batches import KeptOutcomes
from wheelsight_batch.table import DONE, FIGURES, shown


def run_plan(
    plan: BatchPlan, out: Path, processes: int, scheduler: str | None, notes: Sequence[str] = ()
) -> Sequence[BatchRow]:
    """Run the jobs that are not done, and return the rows of the table. Notes and progress go to stderr."""
    done = KeptOutcomes(out).found(plan.jobs)  # refuses a folder of something else before anything is compiled
    for note in notes:
        print_note(note)
    if scheduler is None:
        # Once for all jobs: else each process would compile by itself
        left = (Config.model_validate(job.settings) for job in plan.jobs.values() if job.id not in done)
        compile_missing(tuple({part: None for config in left for part in parts_of(config)}))
    with tempfile.TemporaryDirectory(prefix=".scratch-", dir=out) as scratch, BatchProgress() as progress:

        def runner(jobs: Sequence[Job]) -> Generator[Outcome]:
            if scheduler is not None:
                return run_on_fleet(jobs, scheduler, run_job, on_note=progress.warn)
            return run_on_processes(jobs, processes, run_job, Path(scratch), on_death=again)

        def again(job: Job, why: str) -> None:
            progress.warn(f"{_name(job)}: {why}; it is tried again")

        def show(step: Done) -> None:
            progress.show(step)
            if step.job is not None and step.outcome is not None and step.outcome.problem is not None:
                progress.warn(f"{_name(step.job)}: {step.outcome.problem}")

        for case in plan.cases:
            if case.problem is not None:
                progress.warn(f"{case.recording}, {case.config}: {case.problem}")
        return run_batch(plan, out, runner, show)


def notes_on(plan: BatchPlan, seeds: int) -> list[str]:
    """Notes on cases that run once for lack of randomness, and on automatic choices of the odometry."""
    notes = []
    if once := sum(0 < len(case.jobs) < seeds for case in plan.cases):
        notes.append(f"{once} of {len(plan.cases)} rows have nothing random, and are run once")
    if chosen := Counter(case.chosen for case in plan.cases if case.chosen):
        found = ", ".join(f"{name} of {count}" for name, count in chosen.most_common())
        notes.append(f"odometry by what a recording has: {found} (odometry: in a --config chooses otherwise)")
    return notes


def _name(job: Job) -> str:
    return f"{Path(job.recording).name}, seed +{job.seed}"


class _TimeLeftByBytes(ProgressColumn):
    """Estimate of the time left by bytes, since recordings differ in length; it counts down between jobs."""

    def render(self, task: Task) -> Text:
        """The time left, such as "12:30 left"."""
        ends_s = task.fields["ends_s"]
        return Text(left_text(None if ends_s is None else ends_s - time.monotonic()))


class BatchProgress:
    """Jobs, rate, time left and how many are broken, on stderr while its `with` block runs; notes above it."""

    def __init__(self) -> None:
        self._progress = progress_line(
            TextColumn("{task.fields[count]}", table_column=whole()),
            TextColumn("{task.fields[rate]}", table_column=whole()),
            _TimeLeftByBytes(table_column=whole()),
        )
        self._task = self._progress.add_task("batch", total=1, count="", rate="", ends_s=None, status="")
        self._began_s = time.monotonic()
        self._jobs = self._broken = 0

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def show(self, done: Done) -> None:
        """Show the progress at the beginning, and after each job."""
        if done.outcome is None:
            self._began_s = time.monotonic()
        else:
            self._jobs += 1
            self._broken += done.outcome.problem is not None
        passed_s = time.monotonic() - self._began_s
        a_minute = 60 * self._jobs / passed_s if self._jobs and passed_s else None
        share_left = (done.of_weight - done.weight) / done.weight if done.weight else None
        self._progress.update(
            self._task,
            completed=done.jobs,
            total=max(done.of_jobs, 1),
            count=f"{done.jobs}/{done.of_jobs} jobs",
            rate="" if a_minute is None else f"{a_minute:.1f} jobs/min",
            ends_s=None if share_left is None else time.monotonic() + passed_s * share_left,
            status=f"{self._broken} broken" if self._broken else "",
        )

    def warn(self, note: str) -> None:
        """Print a warning above the line of progress."""
        self._progress.console.print(Text.assemble(("warning: ", "yellow"), note))


def batch_table(rows: Sequence[BatchRow]) -> Table:
    """Two lines a row: the recording and medians, below them the configuration and the worst of several seeds."""
    many = any(row.seeds > 1 for row in rows)
    table = Table(
        box=SIMPLE_HEAD,
        caption="upper line: median over seeds; lower line: worst" if many else None,
        caption_justify="left",
        caption_style="",
    )
    table.add_column("recording\nconfig", min_width=12)  # what may be wrapped gives way, and its lines do not wrap
    for figure in FIGURES:
        table.add_column(figure.title.replace(", ", "\n"), justify="right", no_wrap=True)
    table.add_column("status", overflow="fold", min_width=6)
    for row in rows:
        spreads = [(figure, row.figures.get(figure.name)) for figure in FIGURES]
        figures = [
            "–"
            if spread is None
            else shown(figure, spread.median) + (f"\n{shown(figure, spread.worst)}" if row.seeds > 1 else "")
            for figure, spread in spreads
        ]
        style = None if row.status == DONE else "red"
        name = Text(f"{row.recording}\n{row.config}", no_wrap=True, overflow="ellipsis")
        table.add_row(name, *figures, Text(row.status), style=style)
    return table
