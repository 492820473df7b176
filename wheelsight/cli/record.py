"""`wheelsight record`: keep what the robot's sensors say."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._options import OUTPUT, Topics
from wheelsight.cli.wheels import Baud, Seconds
from wheelsight.interrupts import until_stopped

_SENSORS = "Sensors"

CameraKind = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Camera: its kind, or kind:serial number; any for the first that is plugged in; recording:DIR plays one.",
        show_default="none",
        rich_help_panel=_SENSORS,
    ),
]
WheelsPort = Annotated[
    str | None,
    typer.Option(
        metavar="PORT",
        help="Serial port of the wheel controller.",
        show_default="none",
        rich_help_panel=_SENSORS,
    ),
]
Calibrations = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE",
        help="calibration.yaml to put into the recording, over what the camera says of itself. May be given again.",
        show_default="none",
        rich_help_panel=_SENSORS,
    ),
]
Infrared = Annotated[
    bool,
    typer.Option("--infrared", help="Infrared images too, where the camera has them.", rich_help_panel=_SENSORS),
]
Out = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Folder of the recording; made.", show_default=False, rich_help_panel=OUTPUT),
]
Bag = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Write a bag of ROS 2, .mcap, in place of a folder.",
        show_default=False,
        rich_help_panel=OUTPUT,
    ),
]
Color = Annotated[
    str,
    typer.Option(metavar="png|jpeg", help="How colour is kept: exactly, or small.", rich_help_panel=OUTPUT),
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with the recording in DIR.", rich_help_panel=OUTPUT)]
Force = Annotated[bool, typer.Option("--force", help="Overwrite a recording in DIR.", rich_help_panel=OUTPUT)]
SettingsFile = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Settings in YAML: camera and recorder.", show_default=False)
]


def record(
    out: Out = None,
    bag: Bag = None,
    color: Color = "png",
    resume: Resume = False,
    force: Force = False,
    camera: CameraKind = None,
    wheels: WheelsPort = None,
    baud: Baud = 115200,
    calibration: Calibrations = None,
    infrared: Infrared = False,
    topic: Topics = None,
    seconds: Seconds = None,
    config: SettingsFile = None,
) -> None:
    """Record a camera, wheels, or both until Ctrl-C, SIGTERM or SIGHUP, which `wheelsight run DIR` reads.

    Everything is on its way to the disk within a second, so whatever ends the recording leaves a valid one; --resume
    goes on with it. A camera or port that vanishes is waited for, and the other sensor goes on. Frames for which the
    disk is too slow are dropped, counted and told. A recording without calibration.yaml is run with --calibration.

    [bold]Examples[/bold]

    wheelsight record --camera any --wheels /dev/ttyUSB0 --out corridor --calibration robot.yaml

    wheelsight record --camera realsense --color jpeg --out corridor

    wheelsight record --camera any --wheels /dev/ttyUSB0 --out corridor --resume

    wheelsight record --wheels /dev/ttyUSB0 --out square --seconds 60

    wheelsight record --camera any --wheels /dev/ttyUSB0 --calibration robot.yaml --bag corridor.mcap
    """
    from wheelsight.cli._record_view import shown_looks
    from wheelsight.cli._recording import Sensors, opened_recording
    from wheelsight.cli._recording_place import place_of

    asked = Sensors(camera, wheels, tuple(calibration or ()), infrared, baud, config, tuple(topic or ()))
    with (
        until_stopped() as is_over,
        opened_recording(asked, place_of(out, bag), color, force=force, resume=resume) as session,
        shown_looks(seconds) as show,
    ):
        session.run(is_over, show, seconds)
