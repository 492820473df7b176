"""What `wheelsight run` does once all is known: compile, track, show how far it is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.cli._run_progress import expected, show_progress
from wheelsight.interrupts import exit_code

if TYPE_CHECKING:
    from wheelsight.config import Config
    from wheelsight.pipeline import FrameRecord, RunRecord
    from wheelsight.sources import EventSource
    from wheelsight.viewer import RerunLog


def track(
    source: EventSource, settings: Config, out: Path, force: bool, rerun: str | None = None, told: str = ""
) -> Sequence[RunRecord]:
    """Run, with progress on stderr; Ctrl-C ends it with the exit code of an interruption.

    `rerun` is where Rerun is shown it, if anywhere: a file, or "spawn". `told` is said once nothing can be refused.
    """
    from wheelsight import runs
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.cli._console import print_note
    from wheelsight.cli._outputs import can_draw
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.cli._run_status import RunStatus
    from wheelsight.pipeline.kernels import parts_of

    count, unit = expected(source, settings)
    status, progress = RunStatus(), FrameProgress("tracking", count, unit=unit)
    answered: list[bool] = []

    def show(answers: Mapping[str, FrameRecord]) -> None:
        answered[:] = [True]
        show_progress(progress, source, settings, status.after(answers))

    with _told_where(out, answered), ExitStack() as shown:
        watcher = None if rerun is None else shown.enter_context(_watcher(rerun, source, settings, force))

        def begin() -> None:
            if told:
                print_note(told)
            can_draw()
            compile_missing(parts_of(settings))
            shown.enter_context(progress)

        return runs.run_each(
            source, settings, out, force=force, on_ready=begin, on_code=_note_code, on_event=show, watcher=watcher
        )


def _note_code(done: int, total: int) -> None:
    from wheelsight.cli._console import print_note

    if done == 1:
        print_note(f"making {total:,} keyframes ready to be recognised")


@contextmanager
def _told_where(out: Path, answered: Sequence[bool]) -> Iterator[None]:
    """Ctrl-C ends it with the exit code of an interruption, and says what was found."""
    from wheelsight.cli._console import print_note

    try:
        yield
    except KeyboardInterrupt as interruption:
        found = f"what was found until then is in {out}" if answered else "nothing was found until then"
        print_note(f"interrupted; {found}")
        raise typer.Exit(exit_code()) from interruption


def _watcher(target: str, source: EventSource, settings: Config, force: bool) -> AbstractContextManager[RerunLog]:
    """Raises ConfigError where Rerun is not installed, OutputError where the file must not be written."""
    from wheelsight.cli._outputs import check_rerun
    from wheelsight.viewer import open_rerun

    check_rerun(target, force)
    return open_rerun(target, source.calibration, settings.tracks, settings.viewer)
