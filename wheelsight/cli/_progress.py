"""A progress bar for passes over frames; silent where no terminal watches."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Column
from rich.text import Text

from wheelsight.cli._console import console

# What numbers and status take of a line; the bar has the rest, within these limits.
_BESIDE_BAR, _SHORTEST_BAR, _LONGEST_BAR = 68, 10, 40


class _Rate(ProgressColumn):
    """Frames, or another unit, a second, once there are some; nothing without a unit."""

    def __init__(self, unit: str) -> None:
        super().__init__(_whole())
        self._unit = unit

    def render(self, task: Task) -> Text:
        return Text("" if task.speed is None or not self._unit else f"{task.speed:.0f} {self._unit}/s")


class FrameProgress:
    """Shows frames, rate, time left and status on stderr while its `with` block runs.

    On a narrow terminal the end of the status is left out, never a number.
    """

    def __init__(self, action: str, frame_count: int | None, unit: str = "frames") -> None:
        stderr = console(stderr=True)
        self._progress = Progress(
            TextColumn("{task.description}", table_column=_whole()),
            BarColumn(min(_LONGEST_BAR, max(_SHORTEST_BAR, stderr.width - _BESIDE_BAR))),
            MofNCompleteColumn(table_column=_whole()),
            _Rate(unit),
            TimeRemainingColumn(compact=True, table_column=_whole()),
            TextColumn("{task.fields[status]}", table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
            console=stderr,
            disable=not stderr.is_terminal,
            expand=True,
            transient=True,
        )
        self._task = self._progress.add_task(action, total=frame_count, status="")

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def advance(self, status: str = "") -> None:
        """One frame more."""
        self._progress.update(self._task, advance=1, status=status)

    def reach(self, done: float, total: float | None, status: str = "") -> None:
        """So much is done by now, of a total that is only now known, or not yet."""
        all_of_it = None if total is None else int(total)
        self._progress.update(self._task, completed=int(done), total=all_of_it, status=status)


def _whole() -> Column:
    """A column that is never cut."""
    return Column(no_wrap=True, overflow="ignore")
