"""`wheelsight wheels`: monitors and serves the wheel controller at a serial port, or a simulated one. `wheelsight
devices` lists cameras and ports.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.app.cli.console import CliCommand, Group, facts_table
from wheelsight.app.cli.options import option
from wheelsight.core.runtime import until_stopped

if TYPE_CHECKING:
    from wheelsight.core.calibration_parts import Wheels
    from wheelsight.io.devices import LinkReport, LinkStatus


wheels_app = typer.Typer(cls=Group, no_args_is_help=True, rich_markup_mode="rich")

Port = Annotated[str, typer.Argument(metavar="PORT", help="Serial port, such as /dev/ttyUSB0.", show_default=False)]
Baud = Annotated[int, typer.Option(min=1, metavar="RATE", help="Baud rate of the line.")]
Seconds = Annotated[
    float | None, typer.Option(min=0, metavar="SECONDS", help="Stop after so long.", show_default="at Ctrl-C")
]
_TABLES_PER_S = 5
_LINES_PER_S = 1


@wheels_app.callback()
def _about() -> None:
    """The wheel controller on a serial port."""


@wheels_app.command(cls=CliCommand)
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

    from wheelsight.app.cli.console import console
    from wheelsight.io.devices import WheelLink

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
                live.update(facts_table(port, _facts(meter.look(link.report()))), refresh=True)


@wheels_app.command(cls=CliCommand)
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
    from wheelsight.app.cli.console import print_note
    from wheelsight.app.telemetry import Telemetry
    from wheelsight.app.telemetry import serve as send_poses
    from wheelsight.io.devices import TelemetryPipe, WheelLink

    telemetry = Telemetry(_wheels_of(calibration))
    with (
        until_stopped(seconds) as is_over,
        TelemetryPipe(pipe) as lines,
        WheelLink(port, baud, note_status(port)) as link,
    ):
        send_poses(link, telemetry, lines, is_over)
    print_note(f"{lines.sent} lines sent, {lines.dropped} dropped for slow readers")


@wheels_app.command(cls=CliCommand)
def simulate(
    port: Annotated[Path, typer.Argument(metavar="PORT", help="The port to make: a link to a pseudo-terminal.")] = Path(
        "ttyWHEELS"
    ),
    plain: Annotated[
        bool, typer.Option("--plain", help="Print the lines of an Arduino, time,left,right, and take no commands.")
    ] = False,
    motion: Annotated[
        str,
        option(
            "What it does until it is commanded: lap (2 m ahead, about, back, about), turns (each wheel one turn "
            "and back), or none.",
            "NAME",
        ),
    ] = "lap",
    calibration: Annotated[
        Path | None, option("calibration.yaml with its wheels.", "FILE", "the wheelchair of the tutorial")
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
    from wheelsight.app.cli.console import print_note
    from wheelsight.core.calibration_parts import Wheels
    from wheelsight.core.errors import ConfigError
    from wheelsight.io.devices.simulated_controller import Practice, SimulatedController, lap, turns

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
    """A function that prints a new status of the link with its time; the end is not printed."""
    from wheelsight.app.cli.console import print_note
    from wheelsight.io.devices import LinkStatus

    def note(status: LinkStatus) -> None:
        if status is not LinkStatus.CLOSED:
            print_note(f"{time.strftime('%H:%M:%S')} {port}: {status}")

    return note


def _wheels_of(path: Path) -> Wheels:
    from wheelsight.core.calibration import load_calibration
    from wheelsight.core.errors import CalibrationError

    calibration = load_calibration(path)
    wheels = calibration.wheels
    if calibration.holonomic is not None:
        raise CalibrationError(calibration.lacks_two_wheels, path=path, fix="a robot with two driven wheels")
    if wheels is None:
        raise CalibrationError("holds no wheels", path=path, fix="add the field wheels: radii, track, ticks a turn")
    return wheels


def _wait_s(rate_hz: float, seconds: float | None) -> float:
    return min(1 / rate_hz, seconds if seconds else 1 / rate_hz)


_SHORTEST_S = 0.5


@dataclass(frozen=True, slots=True)
class LinkLook:
    """The state of the link, and its rates over the last half second.

    Attributes:
        report: the link's own.
        frames_per_s: good frames; None before there was time for it.
        left, right: speed of each wheel in `unit`.
    """

    report: LinkReport
    frames_per_s: float | None
    left: float | None
    right: float | None
    unit: str


class Meter:
    """Computes rates of a link. Speeds are in m/s if the wheels are known, else in ticks/s."""

    def __init__(self, wheels: Wheels | None) -> None:
        self._scales = (1.0, 1.0) if wheels is None else (wheels.left_m_per_tick, wheels.right_m_per_tick)
        self._unit = "ticks/s" if wheels is None else "m/s"
        self._before: list[tuple[float, LinkReport]] = []

    def look(self, report: LinkReport) -> LinkLook:
        """The state of the link by its current report."""
        now_s = time.monotonic()
        self._before.append((now_s, report))
        while len(self._before) > 2 and self._before[1][0] <= now_s - _SHORTEST_S:
            self._before.pop(0)
        then_s, then = self._before[0]
        frames_per_s = (report.line.frames - then.line.frames) / (now_s - then_s) if now_s > then_s else None
        if then.last is None or report.last is None or report.last.stamp_s <= then.last.stamp_s:
            left, right = None, None
        else:
            passed_s = report.last.stamp_s - then.last.stamp_s
            left_ticks, right_ticks = report.last.left - then.last.left, report.last.right - then.last.right
            left, right = left_ticks * self._scales[0] / passed_s, right_ticks * self._scales[1] / passed_s
        return LinkLook(report, frames_per_s, left, right, self._unit)


def live_line(look: LinkLook) -> str:
    """All facts of the link in one line."""
    return "; ".join(f"{name}: {value}" for name, value in _facts(look))


def _facts(look: LinkLook) -> Iterator[tuple[str, str]]:
    report = look.report
    line, last = report.line, report.last
    yield "status", str(report.status)
    yield "format", str(report.format or "not recognised yet")
    for name, ticks, speed in (("left", last and last.left, look.left), ("right", last and last.right, look.right)):
        moves = "standing still or unknown" if speed is None else f"{speed:+.3f} {look.unit}"
        yield name, "—" if ticks is None else f"{ticks} ticks, {moves}"
    yield "frames", f"{line.frames}, {'—' if look.frames_per_s is None else f'{look.frames_per_s:.1f}'} a second"
    yield "lost", f"{line.lost}; {line.crc_errors} damaged, {line.malformed} garbled, {line.duplicates} repeated"
    if report.other_line:
        yield "other text", report.other_line
    yield "controller", f"{report.restarts} restarts; its clock {report.drift_ppm:+.0f} ppm fast"
    yield "port", f"{line.bytes} bytes, {report.reconnects} times plugged in again"


def devices_devices(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of lines.")] = False,
) -> None:
    """List depth cameras and serial ports that are plugged in, how each is used, and what is missing.

    Nothing is opened, so nothing is disturbed that another program uses.

    [bold]Examples[/bold]

    wheelsight devices
    wheelsight devices --json
    """
    from wheelsight.app.cli.console import print_json
    from wheelsight.io.devices.plugged_in import plugged_in

    found = plugged_in()
    if as_json:
        print_json([asdict(device) for device in found])
        return
    for kind, none in (("camera", _NO_CAMERA), ("port", _NO_PORT)):
        devices = [device for device in found if device.kind == kind]
        for device in devices:
            state = f"ready ({device.use})" if device.is_ready else f"{device.problem} ({device.fix})"
            typer.echo(f"{device.name}: {state}")
        if not devices:
            typer.echo(none)


_NO_CAMERA = "no depth camera is seen: plug one in (the cable must carry data; in a container, hand it in)"
_NO_PORT = "no serial port is seen: plug the wheel controller in"
