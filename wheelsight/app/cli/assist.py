"""`wheelsight assist`: a person drives by a stick, and the robot helps."""

from __future__ import annotations

import json
import time
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.app.cli.console import print_note, takes
from wheelsight.app.cli.drive import check_robot, robot_of, robot_words, settings_of
from wheelsight.app.cli.drive_options import Rate, RobotOptions, SettingsOptions
from wheelsight.app.cli.options import OUTPUT, option_field
from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import until_stopped

if TYPE_CHECKING:
    from wheelsight.core.robots import Robot
    from wheelsight.io.devices.sticks import StickSource
    from wheelsight.navigation.shared_control import Assist

_HELP = "The stick and the help"


@dataclass(frozen=True)
class StickOptions:
    """Options of the stick and of the help."""

    stick: str = option_field(
        "A joystick such as /dev/input/js0: its left stick drives, its first button, held, gives full control. Or a "
        "text file with SECONDS FORWARD LEFT in each line, shares from -1 to 1.",
        "DEVICE|FILE",
        default="/dev/input/js0",
        panel=_HELP,
    )
    level: str = option_field(
        "off, stop, slow or steer. Each helps more than the one before.", "NAME", default="steer", panel=_HELP
    )
    out: Path | None = option_field(
        "Folder for assist.json, and for wheels with commands and readings.", "DIR", "none", OUTPUT
    )
    force: bool = option_field("Overwrite results in the folder of --out.", default=False, panel=OUTPUT)


@dataclass(frozen=True)
class AssistOptions(RobotOptions, SettingsOptions, StickOptions):
    """All options; fields of the last base come first."""

    rate: Rate = 10.0


@takes(AssistOptions)
def assist(options: AssistOptions) -> None:
    """Drive a robot by a stick with its help: it slows, stops, and steers toward a free way. It needs no map.

    The help never goes faster than the stick, never drives with the stick released, and never backward by itself. Each
    change of what it does is printed, with the reason. docs/assist.md has the levels and the override.

    Ctrl-C stops the robot. Exit code 0: the stick's file is over, or Ctrl-C; 1: the joystick is gone; 2: wrong
    options.

    [bold]Examples[/bold]

    wheelsight assist --robot /dev/ttyUSB0 --camera any --calibration robot.yaml
    wheelsight assist --robot /dev/ttyUSB0 --camera any --calibration robot.yaml --level slow
    wheelsight assist --sim flat --stick /dev/input/js0
    wheelsight assist --sim studio --stick positions.txt --out assisted
    """
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.run.drives import wheels_recorded
    from wheelsight.core.files import make_output_folder, refuse_full, write_text
    from wheelsight.io.devices.sticks import Joystick, StickLog
    from wheelsight.navigation.shared_control import Assist, AssistLevel

    check_robot(options)
    if options.level not in set(AssistLevel):
        raise ConfigError(f"--level {options.level}", fix="one of off, stop, slow and steer")
    config, is_device = settings_of(options, {}), options.stick.startswith("/dev/")
    if options.out is not None and not options.force:
        refuse_full(options.out)
    with Joystick(options.stick) if is_device else StickLog(options.stick) as stick:
        compile_missing(("wheels", "navigation", *(("simulation",) if options.is_simulated else ())))
        if options.out is not None:
            make_output_folder(options.out, options.force)
        with (
            robot_of(options, config) as robot,
            nullcontext(robot)
            if options.out is None
            else wheels_recorded(robot, options.out, config.navigation.limits) as recorded,
        ):
            helped = Assist(recorded, config.navigation, AssistLevel(options.level))
            is_gone = _drive(recorded, helped, stick, is_paced=options.is_simulated and is_device)
    found = {"robot": robot_words(options), "level": options.level, **helped.record.to_dict()}
    if options.out is not None:
        write_text(options.out / "assist.json", json.dumps(found, indent=2) + "\n")
    shares = [f"{name.replace('_', ' ')} {100 * found[name]:.0f} %" for name in _SHARES]
    print_note(f"Of {helped.record.periods} periods with the stick moved: {', '.join(shares)}.")
    if is_gone and is_device:
        print_note("The joystick is gone; the robot stands.")
        raise typer.Exit(1)


_SHARES = ("changed_share", "stopped_share", "contradicted_share")


def _drive(robot: Robot, helped: Assist, stick: StickSource, *, is_paced: bool) -> bool:
    """Drive until the stick is gone, which it returns as True, or a signal comes; the robot stands then."""
    from wheelsight.core.messages import StickPosition
    from wheelsight.navigation.controllers import stands

    said, begun_s, first_s = "", time.monotonic(), robot.now_s
    with until_stopped() as is_over:
        while True:
            position = None if is_over() else stick.read(robot.now_s)
            helped.move(position or StickPosition(robot.now_s))
            feedback = helped.step()
            if feedback.words != said:
                said = feedback.words
                print_note(f"{robot.now_s - first_s:7.1f} s  {said or 'as the stick asks'}")
            if position is None and feedback.command.is_stop and stands(*helped.speed):
                return not is_over()
            if is_paced:
                time.sleep(max(robot.now_s - first_s - (time.monotonic() - begun_s), 0.0))
