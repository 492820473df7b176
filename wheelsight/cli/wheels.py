"""`wheelsight wheels`: the wheel controller on a serial port, to look at, to serve, and a simulated one to practise."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.cli._help import Command, Group
from wheelsight.interrupts import until_stopped

if TYPE_CHECKING:
    from wheelsight.calibration import Wheels
    from wheelsight.devices import LinkStatus

app = typer.Typer(cls=Group, no_args_is_help=True, rich_markup_mode="rich")

Port = Annotated[str, typer.Argument(metavar="PORT", help="Serial port, such as /dev/ttyUSB0.", show_default=False)]
Baud = Annotated[int, typer.Option(min=1, metavar="RATE", help="Baud rate of the line.")]
Seconds = Annotated[
    float | None, typer.Option(min=0, metavar="SECONDS", help="Stop after so long.", show_default="at Ctrl-C")
]
_TABLES_PER_S = 5
_LINES_PER_S = 1


@app.callback()
def _about() -> None:
    """The wheel controller on a serial port."""


@app.command(cls=Command)
def monitor(
    port: Port,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="calibration.yaml with wheels, for speeds in m/s.", show_default=False),
    ] = None,
    baud: Baud = 115200,
    seconds: Seconds = None,
) -> None:
    """Watch a controller live: counts, speeds, frame rate, losses, its clock, and how the line is doing.

    It only listens. Where no terminal watches, it prints a line a second.

    [bold]Examples[/bold]

    wheelsight wheels monitor /dev/ttyUSB0

    wheelsight wheels monitor /dev/ttyUSB0 --calibration robot.yaml --baud 57600
    """
    from rich.live import Live

    from wheelsight.cli._console import console
    from wheelsight.cli._monitor import Meter, live_line, live_table
    from wheelsight.devices import WheelLink

    wheels = None if calibration is None else _wheels_of(calibration)
    stdout = console()
    with until_stopped(seconds) as is_over, WheelLink(port, baud) as link:
        meter = Meter(wheels)
        if not stdout.is_terminal:
            while not is_over():
                time.sleep(_wait_s(_LINES_PER_S, seconds))
                stdout.print(live_line(meter.look(link.report())), markup=False)
            return
        with Live(console=stdout, auto_refresh=False) as live:
            while not is_over():
                time.sleep(1 / _TABLES_PER_S)
                live.update(live_table(port, meter.look(link.report())), refresh=True)


@app.command(cls=Command)
def serve(
    port: Port,
    pipe: Annotated[Path, typer.Option(metavar="PATH", help="Named pipe to write to; made.", show_default=False)],
    calibration: Annotated[
        Path, typer.Option(metavar="FILE", help="calibration.yaml with wheels.", show_default=False)
    ],
    baud: Baud = 115200,
    seconds: Seconds = None,
) -> None:
    """Serve the dead-reckoned pose to other programs: one JSON object a line in a named pipe.

    Readers may come and go, and be slow. SIGTERM or Ctrl-C ends it and removes the pipe.

    [bold]Examples[/bold]

    wheelsight wheels serve /dev/ttyUSB0 --pipe /run/robot/wheels --calibration robot.yaml

    jq -c '[.x_m, .y_m, .yaw_rad]' /run/robot/wheels
    """
    from wheelsight.cli._console import print_note
    from wheelsight.devices import TelemetryPipe, WheelLink
    from wheelsight.telemetry import Telemetry
    from wheelsight.telemetry import serve as tell

    telemetry = Telemetry(_wheels_of(calibration))
    with (
        until_stopped(seconds) as is_over,
        TelemetryPipe(pipe) as telling,
        WheelLink(port, baud, note_status(port)) as link,
    ):
        tell(link, telemetry, telling, is_over)
    print_note(f"{telling.sent} lines sent, {telling.dropped} dropped for slow readers")


@app.command(cls=Command)
def simulate(
    port: Annotated[Path, typer.Argument(metavar="PORT", help="The port to make: a link to a pseudo-terminal.")] = Path(
        "ttyWHEELS"
    ),
    plain: Annotated[
        bool, typer.Option("--plain", help="Print the lines of an Arduino, time,left,right, and take no commands.")
    ] = False,
    motion: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="What it does until it is commanded: lap (2 m ahead, about, back, about), turns (each wheel one turn "
            "and back), or none.",
        ),
    ] = "lap",
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="calibration.yaml with its wheels.", show_default="the wheelchair of the tutorial"
        ),
    ] = None,
    seconds: Seconds = None,
) -> None:
    """Simulate a wheel controller on a port of its own, to practise without hardware, until Ctrl-C.

    It speaks the real protocol: monitor, record, run --live and drive take it for a controller. It moves by
    itself, again and again, until a program drives it.

    [bold]Examples[/bold]

    wheelsight wheels simulate

    wheelsight wheels simulate ttyARDUINO --plain --motion turns
    """
    from wheelsight.calibration import Wheels
    from wheelsight.cli._console import print_note
    from wheelsight.devices.simulated_controller import Practice, SimulatedController, lap, turns
    from wheelsight.errors import ConfigError

    if motion not in ("lap", "turns", "none"):
        raise ConfigError(f"--motion is {motion!r}", fix="lap, turns or none")
    wheels = Wheels(0.17, 0.17, 0.52, 3200.0) if calibration is None else _wheels_of(calibration)
    legs = lap(wheels) if motion == "lap" else turns(wheels) if motion == "turns" else ()
    with (
        until_stopped(seconds) as is_over,
        SimulatedController(port.parent, port.name, is_plain=plain, motors=Practice(wheels, legs)),
    ):
        what = "plain text" if plain else "the framed protocol"
        print_note(f"{port}: a simulated controller, {what}, until Ctrl-C; in another terminal:")
        print_note(f"wheelsight wheels monitor {port}")
        while not is_over():
            time.sleep(_wait_s(_TABLES_PER_S, seconds))


def note_status(port: str) -> Callable[[LinkStatus], None]:
    """What to do with a new status of the link: say it on stderr, with the time; its end goes without saying."""
    from wheelsight.cli._console import print_note
    from wheelsight.devices import LinkStatus

    def note(status: LinkStatus) -> None:
        if status is not LinkStatus.CLOSED:
            print_note(f"{time.strftime('%H:%M:%S')} {port}: {status}")

    return note


def _wheels_of(path: Path) -> Wheels:
    from wheelsight.calibration import load_calibration
    from wheelsight.errors import CalibrationError

    calibration = load_calibration(path)
    wheels = calibration.wheels
    if calibration.holonomic is not None:
        raise CalibrationError(calibration.lacks_two_wheels, path=path, fix="a robot with two driven wheels")
    if wheels is None:
        raise CalibrationError("holds no wheels", path=path, fix="add the field wheels: radii, track, ticks a turn")
    return wheels


def _wait_s(rate_hz: float, seconds: float | None) -> float:
    return min(1 / rate_hz, seconds if seconds else 1 / rate_hz)
