"""`wheelsight warm-up`, and the progress of compiling that the other commands show."""

from __future__ import annotations

import time
from collections.abc import Sequence

import typer

from wheelsight.app.cli.console import console, print_note, print_warning
from wheelsight.core.runtime import exit_code

_SURE_S = 15.0  # some kernels have been compiled by then
_MUCH_LONGER = 1.4


def compile_ahead(parts: Sequence[str]) -> int:
    """Compile missing kernels of these parts after a note. Returns their number.

    Raises:
        Exit: Ctrl-C.
        OutputError: it cannot be done.
    """
    from wheelsight.app.cli.progress import left_text
    from wheelsight.app.run.kernels import CompileEstimate, compile_kernels, missing_parts

    missing = missing_parts(parts)
    if not missing:
        return 0
    estimate = CompileEstimate(missing)
    whose = "as measured here before" if estimate.is_measured else "more on a slow or busy computer"
    print_note(f"compiling kernels, once after installation: about {_about(estimate.total_s)}, {whose}")
    try:
        stderr, began_s = console(stderr=True), time.monotonic()
        found, said_s = [0], [estimate.total_s]

        def show(part: str, kernels: int) -> None:
            found[0] = kernels
            passed_s = time.monotonic() - began_s
            made, of, left_s = estimate.update(part, kernels, passed_s)
            at = f"{part} {missing.index(part) + 1}/{len(missing)}"
            count = f"kernel {made}/{of}" if made <= of else f"kernel {made}"
            spinner.update(f"{at}, {count}, {passed_s // 60:.0f}:{passed_s % 60:02.0f}, about {left_text(left_s)}")
            if passed_s > _SURE_S and passed_s + left_s > _MUCH_LONGER * said_s[0]:
                said_s[0] = passed_s + left_s
                print_note(f"this computer compiles more slowly than was said: about {_about(left_s)} more")

        with stderr.status("starting") as spinner:
            compile_kernels(missing, show)
        kernels, seconds = found[0], time.monotonic() - began_s
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
    """Compile ahead for a command. On failure it warns, and the kernels compile during the work."""
    from wheelsight.core.errors import OutputError

    try:
        compile_ahead(parts)
    except OutputError as error:
        print_warning(str(error))


def _about(seconds: float) -> str:
    if seconds < 50:
        return f"{10 * max(1, round(seconds / 10))} seconds"
    minutes = round(seconds / 60)
    return "a minute" if minutes == 1 else f"{minutes} minutes"


# wheelsight warm-up


def warm_up_warm_up() -> None:
    """Compile all that runs, simulations and maps need, once after installation or an update.

    Without it, the first run does this for what it needs.
    What is compiled is kept on the disk, beside the package or where NUMBA_CACHE_DIR says.

    [bold]Examples[/bold]

    wheelsight warm-up
    """
    from wheelsight.app.run.kernels import usable_parts

    if not compile_ahead(usable_parts()):
        console().print("all kernels are compiled")
