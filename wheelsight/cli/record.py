"""`wheelsight record`: keep what the robot's sensors say."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._signals import until_stopped
from wheelsight.cli.wheels import Baud, Seconds, note_status

_LONGEST_WAIT_S = 0.1


def record(
    wheels: Annotated[
        str, typer.Option(metavar="PORT", help="Serial port of the wheel controller.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the recording; made.", show_default=False)],
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="calibration.yaml to put into the recording.", show_default="none"),
    ] = None,
    baud: Baud = 115200,
    seconds: Seconds = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a recording in DIR.")] = False,
) -> None:
    """Record wheel ticks until Ctrl-C: DIR gets wheels.csv, which `wheelsight run DIR` reads.

    Every reading is on its way to the disk at once, so whatever ends the recording leaves a valid one. When the port
    vanishes, recording waits for it. A recording without calibration.yaml is run with --calibration.

    [bold]Examples[/bold]

    wheelsight record --wheels /dev/ttyUSB0 --out corridor --calibration robot.yaml

    wheelsight record --wheels /dev/ttyUSB0 --out square --seconds 60
    """
    from wheelsight.calibration import load_calibration
    from wheelsight.cli._console import print_note
    from wheelsight.devices import WheelLink
    from wheelsight.files import new_output_folder
    from wheelsight.recordings import RecordingWriter

    known = None if calibration is None else load_calibration(calibration)
    with (
        new_output_folder(out, force),  # refused before the port is touched
        until_stopped(seconds) as is_over,
        WheelLink(wheels, baud, note_status(wheels)) as link,
        RecordingWriter(out, known, force) as writer,
    ):
        while not is_over():
            if (ticks := link.read(_LONGEST_WAIT_S)) is not None:
                writer.add(ticks)
    print_note(f"{writer.readings} wheel readings are in {out}")
