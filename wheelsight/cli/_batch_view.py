"""What a terminal sees of a batch: how far it is, and its table."""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from rich.box import SIMPLE_HEAD
from rich.progress import ProgressColumn, Task, TextColumn
from rich.table import Table
from rich.text import Text

from wheelsight.batch import Done, Row
from wheelsight.batch.table import DONE, FIGURES, Figure, shown
from wheelsight.cli._progress import left_text, progress_line, whole


class _TimeLeft(ProgressColumn):
    """By the bytes that are done, which tell long recordings from short ones; it counts down between jobs."""

    def render(self, task: Task) -> Text:
        """Such as "12:30 left"."""
        ends_s = task.fields["ends_s"]
        return Text(left_text(None if ends_s is None else ends_s - time.monotonic()))


class BatchProgress:
    """Jobs, rate, time left and how many are broken, on stderr while its `with` block runs; notes above it."""

    def __init__(self) -> None:
        self._progress = progress_line(
            TextColumn("{task.fields[count]}", table_column=whole()),
            TextColumn("{task.fields[rate]}", table_column=whole()),
            _TimeLeft(table_column=whole()),
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
        """A job more is done, or the batch begins."""
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

    def tell(self, note: str) -> None:
        """A warning, above the line of progress."""
        self._progress.console.print(Text.assemble(("warning: ", "yellow"), note))


def batch_table(rows: Sequence[Row]) -> Table:
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
        figures = [_two_lines(figure, row) for figure in FIGURES]
        style = None if row.status == DONE else "red"
        name = Text(f"{row.recording}\n{row.config}", no_wrap=True, overflow="ellipsis")
        table.add_row(name, *figures, Text(row.status), style=style)
    return table


def _two_lines(figure: Figure, row: Row) -> str:
    spread = row.figures.get(figure.name)
    if spread is None:
        return "–"
    worst = f"\n{shown(figure, spread.worst)}" if row.seeds > 1 else ""
    return f"{shown(figure, spread.median)}{worst}"
