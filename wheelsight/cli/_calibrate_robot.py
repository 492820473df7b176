"""`wheelsight calibrate robot`: what of a robot is calibrated, what is missing, and the next command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._options import Topics

Robot = Annotated[
    Path, typer.Argument(metavar="FILE", help="The robot's calibration.yaml, there or not yet.", show_default=False)
]
Check = Annotated[
    Path | None,
    typer.Option(
        metavar="RECORDING",
        help="A drive that ends where it began, heading as at its start: checks all of FILE on it.",
        show_default=False,
    ),
]


def robot(file: Robot, check: Check = None, topic: Topics = None) -> None:
    """Lead through the calibration of a robot: what FILE has, what is missing, and what to do next.

    In order: the camera by a board, the wheels by a drive, the mount by a drive, then a loop to check them on.
    Each step writes its part into FILE and keeps the others.

    [bold]Examples[/bold]

    wheelsight calibrate robot robot.yaml

    wheelsight calibrate robot robot.yaml --check loop
    """
    from wheelsight.cli._calibration import table
    from wheelsight.cli._calibration_history import HEAD, history_rows
    from wheelsight.cli._console import console, print_warning
    from wheelsight.cli._robot_steps import loop_check, steps_of
    from wheelsight.inputs import is_there

    stdout = console()
    steps, history = steps_of(file)
    rows = [(step.name, step.state, step.told) for step in steps]
    stdout.print(table(str(file) if is_there(file) else f"{file} (not there yet)", ("", "", "what"), rows))
    if history:
        stdout.print(table("measured so far", HEAD, history_rows(history)))
    missing = next((step for step in steps if not step.is_done), None)
    if missing is not None:
        stdout.print(f"next: {missing.name}. {missing.how}", markup=False)
        for command in missing.commands:
            stdout.print(f"  {command}", markup=False)
    if check is not None:
        lines, is_good = loop_check(check, file, topic)
        stdout.print("\n".join(lines), markup=False)
        if not is_good:
            print_warning("the loop does not close as a calibrated robot's does; what to do is said above")
    elif missing is None:
        stdout.print(
            f"next: a loop. Drive 20 m or more and end where you began: wheelsight calibrate robot {file} --check LOOP",
            markup=False,
        )
