"""The application: its commands, its version, and the handling of errors."""

from __future__ import annotations

import logging
from typing import Annotated, Any

import typer

from wheelsight._version import __version__
from wheelsight.app.cli import assist, drive, evaluate, info, maps, record, run, serve, simulate, wheels
from wheelsight.app.cli.compiling import warm_up_warm_up
from wheelsight.app.cli.console import INPUT_IS_WRONG, CliCommand, Group, prepare_streams, print_error
from wheelsight.app.cli.run_options import config_config
from wheelsight.app.cli.wheels import devices_devices
from wheelsight.core.errors import WheelsightError
from wheelsight.core.runtime import end_by_signals, exit_code, was_asked
from wheelsight_batch.cli import batch
from wheelsight_calibration.cli import calibrate_app
from wheelsight_calibration.cli_camera import board_board
from wheelsight_export.cli import export
from wheelsight_papers.cli import places_app
from wheelsight_ros2.cli import foxglove_layout, urdf

_LOG = logging.getLogger(__name__)


class _Commands(Group):
    """Prints a user's error in one line; any other error is a bug and keeps its traceback."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return commands in the order of the panels; typer puts all groups last."""
        return [name for _, commands in _COMMANDS for _, name, _ in commands]

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except WheelsightError as error:
            _LOG.error("%s", error)
            print_error(str(error))
            raise typer.Exit(INPUT_IS_WRONG) from error
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            print_error("no folder can keep the compiled kernels (set NUMBA_CACHE_DIR to one that you may write to)")
            raise typer.Exit(INPUT_IS_WRONG) from error
        except (KeyboardInterrupt, typer.Abort) as ending:
            if isinstance(ending, typer.Abort) and not was_asked():
                raise  # the answer to a question
            print_error("interrupted")
            raise typer.Exit(exit_code()) from ending


app = typer.Typer(
    cls=_Commands,
    name="wheelsight",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
# Panels of the help in the order in which a newcomer needs them, and a line about each command.
_COMMANDS: tuple[tuple[str, tuple[tuple[Any, str, str], ...]], ...] = (
    (
        "Run and look",
        (
            (info.info, "info", "What is in a recording, and what is wrong with it"),
            (run.run, "run", "Where the robot or its camera went, a map, a report"),
            (evaluate.evaluate, "evaluate", "A trajectory against the truth"),
            (export, "export", "A run or its map for other programs"),
            (simulate.simulate, "simulate", "A drive through a simulated world, with truth"),
        ),
    ),
    (
        "Record",
        (
            (devices_devices, "devices", "Cameras and serial ports that are plugged in"),
            (record.record, "record", "A camera and wheels as a recording"),
            (wheels.wheels_app, "wheels", "A wheel controller: monitor, serve, simulate"),
        ),
    ),
    (
        "Calibrate",
        (
            (calibrate_app, "calibrate", "Camera, wheels, and where the camera sits"),
            (board_board, "board", "A board to calibrate cameras by, for a printer"),
        ),
    ),
    (
        "Maps",
        (
            (maps.maps_app, "map", "A map of a run: info, name, export, merge, ..."),
            (places_app, "places", "Areas of a building: label, train, test, predict"),
        ),
    ),
    (
        "Drive",
        (
            (drive.drive, "drive", "A robot goes to places of a map, or explores"),
            (serve.serve, "serve", "A page to see a robot and lead it"),
            (assist.assist, "assist", "A person drives by a stick, and the robot helps"),
            (foxglove_layout, "foxglove-layout", "Foxglove's panels for a robot that drives"),
        ),
    ),
    ("Many recordings", ((batch, "batch", "Many recordings by several settings, one table"),)),
    (
        "Set up",
        (
            (warm_up_warm_up, "warm-up", "Compile all kernels, once after installation"),
            (config_config, "config", "The settings that a run would go by"),
            (urdf, "urdf", "A robot's calibration from its URDF, and back"),
        ),
    ),
)
for _panel, _commands in _COMMANDS:
    for _command, _name, _summary in _commands:
        if isinstance(_command, typer.Typer):
            app.add_typer(_command, name=_name, short_help=_summary, rich_help_panel=_panel)
        else:
            app.command(_name, cls=CliCommand, short_help=_summary, rich_help_panel=_panel)(_command)


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

    Begin with [bold]wheelsight run sample --out first[/bold], a recording that comes along. Of yours:
    [bold]wheelsight info RECORDING[/bold], then [bold]wheelsight run RECORDING --out DIR[/bold].
    [bold]wheelsight COMMAND --help[/bold] shows examples.
    """


def main() -> None:
    """The entry point of the command `wheelsight`."""
    end_by_signals()
    prepare_streams()
    app()
