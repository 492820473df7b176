"""The application: its commands, its version, and what becomes of errors."""

from __future__ import annotations

from typing import Annotated, Any

import typer
import typer.core

from wheelsight._version import __version__
from wheelsight.cli import (
    batch,
    board,
    calibrate,
    config,
    devices,
    drive,
    evaluate,
    export,
    info,
    maps,
    places,
    record,
    run,
    serve,
    simulate,
    warm_up,
    wheels,
)
from wheelsight.cli._console import INPUT_IS_WRONG, INTERRUPTED, print_error, speak_any_encoding
from wheelsight.errors import WheelsightError


class _Commands(typer.core.TyperGroup):
    """Tells a user's errors in one line; anything else is a bug and keeps its traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except WheelsightError as error:
            print_error(str(error))
            raise typer.Exit(INPUT_IS_WRONG) from error
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            print_error("no folder can keep the compiled kernels (set NUMBA_CACHE_DIR to one that you may write to)")
            raise typer.Exit(INPUT_IS_WRONG) from error
        except KeyboardInterrupt as interruption:
            print_error("interrupted")
            raise typer.Exit(INTERRUPTED) from interruption


app = typer.Typer(
    cls=_Commands,
    name="wheelsight",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("info")(info.info)
app.command("run")(run.run)
app.command("batch")(batch.batch)
app.command("evaluate")(evaluate.evaluate)
app.command("export")(export.export)
app.command("record")(record.record)
app.command("devices")(devices.devices)
app.command("drive")(drive.drive)
app.command("serve")(serve.serve)
app.command("simulate")(simulate.simulate)
app.command("warm-up")(warm_up.warm_up)
app.command("config")(config.config)
app.command("board")(board.board)
app.add_typer(calibrate.app, name="calibrate")
app.add_typer(wheels.app, name="wheels")
app.add_typer(places.app, name="places")
app.add_typer(maps.app, name="map")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"wheelsight {__version__}")
        raise typer.Exit


@app.callback()
def _about(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Where a wheeled robot is and what its place looks like, from its wheels and a depth camera.

    Begin with [bold]wheelsight info RECORDING[/bold], then [bold]wheelsight run RECORDING --out DIR[/bold].
    """


def main() -> None:
    """The entry point of the command `wheelsight`."""
    speak_any_encoding()
    app()
