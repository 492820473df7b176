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
from rich.text import Text

from wheelsight.cli._console import console


class _Rate(ProgressColumn):
    """Frames, or another unit, a second, once there are some; nothing without a unit."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self._unit = unit

    def render(self, task: Task) -> Text:
        return Text("" if task.speed is None or not self._unit else f"{task.speed:.0f} {self._unit}/s")


class FrameProgress:
    """Shows frame, rate, status and time left on stderr while its `with` block runs; `status` until the first frame."""

    def __init__(self, action: str, frame_count: int | None, status: str = "", unit: str = "frames") -> None:
        stderr = console(stderr=True)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _Rate(unit),
            TextColumn("{task.fields[status]}"),
            TimeRemainingColumn(compact=True),
            console=stderr,
            disable=not stderr.is_terminal,
            transient=True,
        )
        self._task = self._progress.add_task(action, total=frame_count, status=status)

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
