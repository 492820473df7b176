"""What `wheelsight drive` leaves and says at the end, and what a simulator knows of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from wheelsight.cli._console import print_error, print_note, print_warning
from wheelsight.interrupts import exit_code

if TYPE_CHECKING:
    from wheelsight.pipeline.drive_record import DriveRecord
    from wheelsight.robots import Robot

_FAILED = 1
# Share of periods that may come late before it is said.
_OFTEN = 0.01
# Contacts that a line names.
_NAMED = 5


class Truth:
    """What the simulator knows of a drive."""

    def __init__(self, robot: Robot) -> None:
        from wheelsight.simulation.simulator import Simulator

        assert isinstance(robot, Simulator)
        self._simulator, self._clearance_m = robot, float("inf")

    def look(self) -> None:
        """A period is over."""
        self._clearance_m = min(self._clearance_m, self._simulator.clearance_m())

    @property
    def told(self) -> dict[str, Any]:
        """For the record."""
        contacts = [
            {"stamp_s": one.time_s, "with": one.name, "by_the_robot": bool(one.is_by_robot)}
            for one in self._simulator.contacts
        ]
        return {"clearance_m": round(self._clearance_m, 4), "contacts": contacts}


def write(record: DriveRecord, out: Path) -> None:
    """All files of --out."""
    from wheelsight.cli._outputs import can_draw
    from wheelsight.pipeline.drive_outputs import write_drive
    from wheelsight.report import write_drive_page, write_drive_picture

    write_drive(record, out)
    write_drive_picture(record, out / "drive.png")
    if can_draw():
        write_drive_page(record, out / "drive.html")
    print_note(f"results are in {out}")


def tell(record: DriveRecord, left_out: str = "") -> None:
    """What became of each goal, on stdout, what was not begun, and last what a simulated robot touched.

    Raises Exit where a goal was not reached, or anything was touched.
    """
    for goal in record.goals:
        result = goal.result
        if result.has_arrived:
            change = f"; {result.goal_change}" if result.goal_change else ""
            typer.echo(f"arrived at {goal.name}: {result.way_m:.1f} m in {result.time_s:.0f} s{change}")
        elif not record.is_interrupted:
            print_error(f"{goal.name} was not reached: {result.reason} ({result.detail})")
    _tell_late(record)
    if record.rests_on_start:
        print_warning(
            "nothing of the map was recognised: where the robot was rests on --known-start alone, and may be wrong"
        )
    if record.is_interrupted:
        print_note("interrupted; the robot was stopped first, and stands")
        _tell_contacts(record)
        raise typer.Exit(exit_code())
    if left_out:
        print_error(left_out)
    _tell_contacts(record)
    if record.contacts or not record.has_arrived:
        raise typer.Exit(_FAILED)


def _tell_contacts(record: DriveRecord) -> None:
    """Say what the robot drove against, as the simulator knows."""
    touched = record.contacts
    if touched:
        more = f", and {len(touched) - _NAMED} more" if len(touched) > _NAMED else ""
        times = "once" if len(touched) == 1 else f"{len(touched)} times"
        print_error(f"the robot drove against something {times}: {', '.join(touched[:_NAMED])}{more}")


def _tell_late(record: DriveRecord) -> None:
    """Say where the robot was often led later than it should have been."""
    periods = record.periods
    if periods.late > _OFTEN * periods.count:
        print_note(
            f"{periods.late:,} of {periods.count:,} periods of the control loop took longer than they should, "
            f"{1e3 * periods.longest_s:.0f} ms at most: a faster computer helps, or fewer programs beside it"
        )
