"""A line of progress for a terminal of 60 columns or more; nothing without a terminal."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Column
from rich.text import Text

from wheelsight.app.cli.console import QUIET, console

# What numbers and status take of a line; the bar has the rest, within these limits.
_BESIDE_BAR, _SHORTEST_BAR, _LONGEST_BAR = 66, 4, 40


class FrameProgress:
    """Shows count, rate, time left and status on stderr while its `with` block runs.

    On a narrow terminal the bar is short and the end of the status is left out, never a number.
    """

    def __init__(self, action: str, frame_count: int | None, unit: str = "frames") -> None:
        self._progress = progress_line(_Count(table_column=whole()), _Rate(unit), _TimeLeft(table_column=whole()))
        self._task = self._progress.add_task(action, total=frame_count, rate="", status="")

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def advance(self, status: str = "") -> None:
        """Count one frame."""
        self._progress.update(self._task, advance=1, status=status)

    def reach(self, done: float, total: float | None, status: str = "", rate: str = "") -> None:
        """Set the count and the total, which may be unknown; `rate` replaces the rate of the count."""
        all_of_it = None if total is None else int(total)
        self._progress.update(self._task, completed=int(done), total=all_of_it, rate=rate, status=status)


def progress_line(*columns: ProgressColumn) -> Progress:
    """A line on stderr: action, bar, some columns, status."""
    stderr = console(stderr=True)
    return Progress(
        TextColumn("{task.description}", table_column=whole()),
        BarColumn(min(_LONGEST_BAR, max(_SHORTEST_BAR, stderr.width - _BESIDE_BAR))),
        *columns,
        TextColumn("{task.fields[status]}", table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
        console=stderr,
        disable=QUIET.on or not stderr.is_terminal,
        expand=True,
        transient=True,
    )


def whole() -> Column:
    """A column that is never cut."""
    return Column(no_wrap=True, overflow="ignore")


def left_text(seconds: float | None) -> str:
    """The time left, such as "12:30 left"; dashes while it is unknown."""
    if seconds is None:
        return "-:-- left"
    left_s = max(round(seconds), 0)
    hours = f"{left_s // 3600}:{left_s // 60 % 60:02d}" if left_s >= 3600 else str(left_s // 60)
    return f"{hours}:{left_s % 60:02d} left"


class _Count(ProgressColumn):
    """The count of the total; the count alone if the total is unknown."""

    def render(self, task: Task) -> Text:
        return Text(f"{int(task.completed)}" if task.total is None else f"{int(task.completed)}/{int(task.total)}")


class _Rate(ProgressColumn):
    """Frames, or another unit, a second, once there are some; nothing without a unit, unless a text is given."""

    def __init__(self, unit: str) -> None:
        super().__init__(whole())
        self._unit = unit

    def render(self, task: Task) -> Text:
        if task.fields["rate"] or task.speed is None or not self._unit:
            return Text(task.fields["rate"])
        return Text(f"{task.speed:.{0 if task.speed >= 10 else 1}f} {self._unit}/s")


class _TimeLeft(ProgressColumn):
    """The time left by the rate; empty without a total."""

    max_refresh = 0.5

    def render(self, task: Task) -> Text:
        return Text("" if task.total is None else left_text(task.time_remaining))
