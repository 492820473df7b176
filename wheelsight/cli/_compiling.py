"""Compiling ahead, as the commands show it: one line that says how long, and on a terminal how far it is."""

from __future__ import annotations

import time
from collections.abc import Sequence

import typer

from wheelsight.cli._console import console, print_note, print_warning
from wheelsight.interrupts import exit_code


def compile_ahead(parts: Sequence[str]) -> int:
    """Compile what these parts lack, and say so before; how many kernels that were.

    Raises:
        Exit: Ctrl-C.
        OutputError: it cannot be done.
    """
    from wheelsight.pipeline.kernels import SECONDS, missing_parts

    missing = missing_parts(parts)
    if not missing:
        return 0
    print_note(f"compiling kernels, once after installation: about {_about(sum(SECONDS[part] for part in missing))}")
    try:
        kernels, seconds = _watched(missing)
    except KeyboardInterrupt as interruption:
        print_note("interrupted while compiling; what is compiled stays, and nothing was run")
        raise typer.Exit(exit_code()) from interruption
    # Each run compiles on the way what it calls, and notes no part as whole.
    print_note(
        f"compiled {kernels} kernel{'s' * (kernels > 1)} in {seconds:.0f} s"
        if kernels
        else "all of them were compiled already"
    )
    return kernels


def compile_missing(parts: Sequence[str]) -> None:
    """The same for a command that goes on all the same: what cannot be compiled ahead is compiled on the way."""
    from wheelsight.errors import OutputError

    try:
        compile_ahead(parts)
    except OutputError as error:
        print_warning(str(error))


def _watched(missing: Sequence[str]) -> tuple[int, float]:
    """How many kernels were compiled, and how long it took; a terminal sees the part, the count and the time."""
    from wheelsight.pipeline.kernels import compile_kernels

    stderr, began_s, found = console(stderr=True), time.monotonic(), [0]

    def show(part: str, kernels: int) -> None:
        found[0] = kernels
        passed_s = time.monotonic() - began_s
        at = f"{part} ({missing.index(part) + 1} of {len(missing)})"
        spinner.update(f"{at}, {kernels} kernels, {passed_s // 60:.0f}:{passed_s % 60:02.0f}")

    with stderr.status("starting") as spinner:
        compile_kernels(missing, show)
    return found[0], time.monotonic() - began_s


def _about(seconds: float) -> str:
    if seconds < 50:
        return f"{10 * max(1, round(seconds / 10))} seconds"
    minutes = round(seconds / 60)
    return "a minute" if minutes == 1 else f"{minutes} minutes"
