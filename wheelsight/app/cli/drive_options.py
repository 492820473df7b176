"""The options of `wheelsight drive`, in the order of its help; `wheelsight serve` shares those of the robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol

import typer

from wheelsight.app.cli.options import OUTPUT, SETTINGS, LinkOptions, Profile, option, option_field

_SIMULATED, _REAL, _EITHER = "A simulated robot", "A real robot", "Either robot"

Rate = Annotated[float, typer.Option(metavar="HZ", help="Images a second.", rich_help_panel=_SIMULATED)]


@dataclass(frozen=True)
class RobotOptions:
    """Options of the robot; in the help they come before other options."""

    sim: str | None = option_field(
        "Drive in the simulator: a world of wheelsight simulate --list, or a floor plan's file.",
        "WORLD|PLAN",
        False,
        _SIMULATED,
    )
    resolution: float | None = option_field("Metres a pixel of a plan that is a bare image.", "M", False, _SIMULATED)
    start: str | None = option_field(
        "Where the robot truly stands at first, in the world.", "X,Y,YAW_DEG", "the world's own", _SIMULATED
    )
    seed: int = option_field("Of everything random.", default=0, panel=_SIMULATED)
    day: int = option_field("Another day: other light and people, chairs moved.", "N", default=0, panel=_SIMULATED)
    people: int = option_field("How many people walk about.", "N", default=0, panel=_SIMULATED)
    drive_model: Path | None = option_field(
        "File with the drive_model that its wheels answer by, of calibrate drive.", "FILE", "quick motors", _SIMULATED
    )
    hardware: str | None = option_field(
        "Drive its wheels through the compiled firmware on a simulated chip: atmega8 or stm32.",
        "CHIP",
        "the simulator's own loop",
        _SIMULATED,
    )
    realism: str = option_field("real or ideal, as for simulate.", "NAME", default="real", panel=_SIMULATED)
    camera: str | None = option_field(
        "Of a simulated robot as for simulate; of a real one the live camera, as for record.",
        "NAME",
        "kinect-v1; any that is plugged in",
        _EITHER,
    )
    size: str = option_field("Size of the images.", "WxH|half|full", default="half", panel=_SIMULATED)
    rate: Rate = 10.0
    robot: str | None = option_field(
        "Drive the robot whose wheel controller is at a serial port, by a live camera.", "PORT", False, _REAL
    )
    calibration: Path | None = option_field(
        "calibration.yaml of the robot: wheels, camera, and where that sits.", "FILE", False, _REAL
    )
    baud: int = option_field("Baud rate of the port.", "RATE", default=115200, panel=_REAL, min=1)
    yes: bool = option_field(
        "Do not ask whether the floor around the robot is free and somebody is at the stop button: both are so.",
        default=False,
        panel=_REAL,
    )

    @property
    def is_simulated(self) -> bool:
        """Whether no real robot is named."""
        return self.robot is None


_TASK = "Where to"

MapPath = Annotated[Path | None, option("The map, or the run that left it.", "DIR", False, _TASK, flag="--map")]
KnownStart = Annotated[
    str | None,
    option(
        "Where the robot stands at first, in the map; as --start of wheelsight run.",
        "X,Y,YAW_DEG",
        "the place is recognised",
        _TASK,
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


@dataclass(frozen=True)
class SettingsOptions:
    """Options of settings."""

    config: Path | None = option_field("Settings in YAML.", "FILE", False, SETTINGS)
    profile: Profile = None
    set_: list[str] | None = option_field(
        "A setting by its dotted name, such as navigation.limits.forward_m_s=0.5; wins over --config. May be "
        "given again.",
        "NAME=VALUE",
        False,
        SETTINGS,
    )


@dataclass(frozen=True)
class TaskOptions:
    """Options of the task and of its results."""

    map_: MapPath = None
    to: list[str] | None = option_field(
        "A name of the map (wheelsight map name), an area of it (wheelsight map zone), X,Y,YAW_DEG in it, or X,Y "
        "for any heading. May be given again: one after another.",
        "GOAL",
        False,
        _TASK,
    )
    follow: Path | None = option_field(
        "Along a way that was driven before: the trajectory.txt of a run or a drive in this map, or its folder. "
        "In place of --to.",
        "FILE",
        False,
        _TASK,
    )
    back: bool = option_field("Return to where the drive began, at the end.", default=False, panel=_TASK)
    explore: bool = option_field(
        "Look at all floor that can be reached, and leave a map of it in the folder of --out.",
        default=False,
        panel=_TASK,
    )
    known_start: KnownStart = None
    out: Path | None = option_field(
        "Folder for drive.json, trajectory.txt, drive.png, drive.html, and wheels with commands and readings.",
        "DIR",
        "none",
        OUTPUT,
    )
    rerun: Rerun = None
    force: bool = option_field("Overwrite results in the folder of --out.", default=False, panel=OUTPUT)


@dataclass(frozen=True)
class DriveOptions(LinkOptions, RobotOptions, SettingsOptions, TaskOptions):
    """All options; fields of the last base come first."""


class SessionOptions(Protocol):
    """Options that `drive` without a goal and `serve` share."""

    @property
    def map_(self) -> Path | None:
        """Folder of the map."""

    @property
    def known_start(self) -> str | None:
        """X,Y,YAW_DEG in the map."""

    @property
    def out(self) -> Path | None:
        """Folder of maps that are made."""

    @property
    def rerun(self) -> str | None:
        """File or viewer of Rerun."""

    @property
    def is_simulated(self) -> bool:
        """Whether the robot is simulated."""
