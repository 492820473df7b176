"""`wheelsight warm-up`: all kernels compiled, so that nothing waits for them."""

from __future__ import annotations


def warm_up() -> None:
    """Compile all that runs, simulations and maps need, once after installation or an update.

    Without it, the first run does this for what it needs.
    What is compiled is kept on the disk, beside the package or where NUMBA_CACHE_DIR says.

    [bold]Examples[/bold]

    wheelsight warm-up
    """
    from wheelsight.cli._compiling import compile_ahead
    from wheelsight.cli._console import console
    from wheelsight.pipeline.kernels import usable_parts

    if not compile_ahead(usable_parts()):
        console().print("all kernels are compiled")
