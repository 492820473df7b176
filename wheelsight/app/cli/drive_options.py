"""The options of `wheelsight drive`, in the order of its help; `wheelsight serve` shares those of the robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.app.cli.options import OUTPUT, SETTINGS, Profile, option

# The robot


_SIMULATED, _REAL, _EITHER = "A simulated robot", "A real robot", "Either robot"

Sim = Annotated[
    str | None,
    option(
        "Drive in the simulator: a world of wheelsight simulate --list, or a floor plan's file.",
        "WORLD|PLAN",
        False,
        _SIMULATED,
    ),
]
Resolution = Annotated[float | None, option("Metres a pixel of a plan that is a bare image.", "M", False, _SIMULATED)]
Start = Annotated[
    str | None,
    option("Where the robot truly stands at first, in the world.", "X,Y,YAW_DEG", "the world's own", _SIMULATED),
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
    option(
        "Of a simulated robot as for simulate; of a real one the live camera, as for record.",
        "NAME",
        "kinect-v1; any that is plugged in",
        _EITHER,
        flag="--camera",
    ),
]
Size = Annotated[str, typer.Option(metavar="WxH|half|full", help="Size of the images.", rich_help_panel=_SIMULATED)]
Rate = Annotated[float, typer.Option(metavar="HZ", help="Images a second.", rich_help_panel=_SIMULATED)]
RobotPort = Annotated[
    str | None,
    option(
        "Drive the robot whose wheel controller is at a serial port, by a live camera.",
        "PORT",
        False,
        _REAL,
        flag="--robot",
    ),
]
CalibrationFile = Annotated[
    Path | None,
    option(
        "calibration.yaml of the robot: wheels, camera, and where that sits.",
        "FILE",
        False,
        _REAL,
        flag="--calibration",
    ),
]
Baud = Annotated[int, typer.Option(min=1, metavar="RATE", help="Baud rate of the port.", rich_help_panel=_REAL)]
Yes = Annotated[
    bool,
    option(
        "Do not ask whether the floor around the robot is free and somebody is at the stop button: both are so.",
        panel=_REAL,
        flag="--yes",
    ),
]


@dataclass(frozen=True)
class RobotOptions:
    """Options of the robot; in the help they come before other options."""

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


# The drive


_TASK = "Where to"

MapPath = Annotated[Path | None, option("The map, or the run that left it.", "DIR", False, _TASK, flag="--map")]
To = Annotated[
    list[str] | None,
    option(
        "A name of the map (wheelsight map name), an area of it (wheelsight map zone), X,Y,YAW_DEG in it, or X,Y "
        "for any heading. May be given again: one after another.",
        "GOAL",
        False,
        _TASK,
    ),
]
Follow = Annotated[
    Path | None,
    option(
        "Along a way that was driven before: the trajectory.txt of a run or a drive in this map, or its folder. "
        "In place of --to.",
        "FILE",
        False,
        _TASK,
    ),
]
Back = Annotated[
    bool, typer.Option("--back", help="Return to where the drive began, at the end.", rich_help_panel=_TASK)
]
Explore = Annotated[
    bool,
    option(
        "Look at all floor that can be reached, and leave a map of it in the folder of --out.",
        panel=_TASK,
        flag="--explore",
    ),
]
KnownStart = Annotated[
    str | None,
    option(
        "Where the robot stands at first, in the map; as --start of wheelsight run.",
        "X,Y,YAW_DEG",
        "the place is recognised",
        _TASK,
    ),
]
Out = Annotated[
    Path | None, option("Folder for drive.json, trajectory.txt, drive.png and drive.html.", "DIR", "none", OUTPUT)
]
SettingsFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Settings in YAML.", show_default=False, rich_help_panel=SETTINGS),
]
Set = Annotated[
    list[str] | None,
    option(
        "A setting by its dotted name, such as navigation.limits.forward_m_s=0.5; wins over --config. May be "
        "given again.",
        "NAME=VALUE",
        False,
        SETTINGS,
        flag="--set",
    ),
]
Rerun = Annotated[
    str | None,
    option(
        "Show the drive in Rerun as it goes: written to a file, or in a viewer that is started here.",
        "FILE.rrd|spawn",
        "not shown",
        OUTPUT,
        flag="--rerun",
    ),
]
Force = Annotated[
    bool, typer.Option("--force", help="Overwrite results in the folder of --out.", rich_help_panel=OUTPUT)
]


@dataclass(frozen=True)
class SettingsOptions:
    """Options of settings."""

    config: SettingsFile = None
    profile: Profile = None
    set_: Set = None


@dataclass(frozen=True)
class TaskOptions:
    """Options of the task and of its results."""

    map_: MapPath = None
    to: To = None
    follow: Follow = None
    back: Back = False
    explore: Explore = False
    known_start: KnownStart = None
    out: Out = None
    rerun: Rerun = None
    force: Force = False


@dataclass(frozen=True)
class DriveOptions(RobotOptions, SettingsOptions, TaskOptions):
    """All options; fields of the last base come first."""
