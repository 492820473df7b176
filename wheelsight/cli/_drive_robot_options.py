"""Options of `wheelsight drive` and `serve`: which robot, simulated or real."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

_SIMULATED, _REAL, _EITHER = "A simulated robot", "A real robot", "Either robot"

Sim = Annotated[
    str | None,
    typer.Option(
        metavar="WORLD|PLAN",
        help="Drive in the simulator: a world of wheelsight simulate --list, or a floor plan's file.",
        show_default=False,
        rich_help_panel=_SIMULATED,
    ),
]
Resolution = Annotated[
    float | None,
    typer.Option(
        metavar="M",
        help="Metres a pixel of a plan that is a bare image.",
        show_default=False,
        rich_help_panel=_SIMULATED,
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,YAW_DEG",
        help="Where the robot truly stands at first, in the world.",
        show_default="the world's own",
        rich_help_panel=_SIMULATED,
    ),
]
Seed = Annotated[int, typer.Option(help="Of everything random.", rich_help_panel=_SIMULATED)]
Day = Annotated[
    int,
    typer.Option(metavar="N", help="Another day: other light and people, chairs moved.", rich_help_panel=_SIMULATED),
]
People = Annotated[
    int, typer.Option("--people", metavar="N", help="How many people walk about.", rich_help_panel=_SIMULATED)
]
Realism = Annotated[
    str, typer.Option(metavar="NAME", help="real or ideal, as for simulate.", rich_help_panel=_SIMULATED)
]
CameraName = Annotated[
    str | None,
    typer.Option(
        "--camera",
        metavar="NAME",
        help="Of a simulated robot as for simulate; of a real one the live camera, as for record.",
        show_default="kinect-v1; any that is plugged in",
        rich_help_panel=_EITHER,
    ),
]
Size = Annotated[str, typer.Option(metavar="WxH|half|full", help="Size of the images.", rich_help_panel=_SIMULATED)]
Rate = Annotated[float, typer.Option(metavar="HZ", help="Images a second.", rich_help_panel=_SIMULATED)]
RobotPort = Annotated[
    str | None,
    typer.Option(
        "--robot",
        metavar="PORT",
        help="Drive the robot whose wheel controller is at a serial port, by a live camera.",
        show_default=False,
        rich_help_panel=_REAL,
    ),
]
CalibrationFile = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="FILE",
        help="calibration.yaml of the robot: wheels, camera, and where that sits.",
        show_default=False,
        rich_help_panel=_REAL,
    ),
]
Baud = Annotated[int, typer.Option(min=1, metavar="RATE", help="Baud rate of the port.", rich_help_panel=_REAL)]
Yes = Annotated[
    bool,
    typer.Option(
        "--yes",
        help="Do not ask whether the floor around the robot is free and somebody is at the stop button: both are so.",
        rich_help_panel=_REAL,
    ),
]


@dataclass(frozen=True)
class RobotOptions:
    """What a user typed of the robot; a base of commands' options, after which others come in the help."""

    sim: Sim = None
    resolution: Resolution = None
    start: Start = None
    seed: Seed = 0
    day: Day = 0
    people: People = 0
    realism: Realism = "real"
    camera: CameraName = None
    size: Size = "half"
    rate: Rate = 10.0
    robot: RobotPort = None
    calibration: CalibrationFile = None
    baud: Baud = 115200
    yes: Yes = False

    @property
    def is_simulated(self) -> bool:
        """Whether no real robot is named."""
        return self.robot is None
