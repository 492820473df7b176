"""`wheelsight devices`: cameras and serial ports that are plugged in, and what those lack that cannot be used."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from wheelsight.devices.plugged_in import PluggedIn


def devices(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of lines.")] = False,
) -> None:
    """Tell which depth cameras and serial ports are plugged in, how each is used, and what is missing.

    Nothing is opened, so nothing is disturbed that another program uses.

    [bold]Examples[/bold]

    wheelsight devices

    wheelsight devices --json
    """
    from wheelsight.cli._console import print_json
    from wheelsight.devices.plugged_in import plugged_in

    found = plugged_in()
    if as_json:
        print_json([asdict(device) for device in found])
        return
    for kind, none in (("camera", _NO_CAMERA), ("port", _NO_PORT)):
        for line in [_line(device) for device in found if device.kind == kind] or [none]:
            typer.echo(line)


_NO_CAMERA = "no depth camera is seen: plug one in (the cable must carry data; in a container, hand it in)"
_NO_PORT = "no serial port is seen: plug the wheel controller in"


def _line(device: PluggedIn) -> str:
    if device.is_ready:
        return f"{device.name}: ready ({device.use})"
    return f"{device.name}: {device.problem} ({device.fix})"
