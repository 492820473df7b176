"""What `wheelsight drive` does once all is known: compile, drive, show, write."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from wheelsight.cli._console import INTERRUPTED, print_error, print_note
from wheelsight.cli._drive_inputs import Asked, Real, Simulated, check, goals_of, robot_of, robot_words, settings_of
from wheelsight.cli._signals import until_stopped

if TYPE_CHECKING:
    from wheelsight.cli._drive_view import DriveView
    from wheelsight.config import Config
    from wheelsight.navigation import Feedback
    from wheelsight.pipeline.drive_record import DriveRecord
    from wheelsight.pipeline.drives import Drive, Goal
    from wheelsight.robots import Robot

_FAILED = 1
# Kernels that localization in a known map, and a drive in it, call.
_PARTS = ("wheels", "dense", "joined", "loops", "navigation")


class _ToldToStop(Exception):  # noqa: N818 - it is no error
    """Ctrl-C, or SIGTERM."""


def drive_there(asked: Asked, simulated: Simulated, real: Real) -> None:
    """Drive to all goals; Exit with 1 where one was not reached, with 130 where somebody stopped it.

    Raises what was handed in wrong, before anything moves.
    """
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.files import make_output_folder

    check(asked, simulated, real)
    config = settings_of(asked)
    goals = goals_of(asked)
    if asked.out is not None:
        make_output_folder(asked.out, asked.force)
    compile_missing((*_PARTS, *(("simulation",) if real.port is None else ())))
    with robot_of(simulated, real, config) as robot:
        words = robot_words(simulated, real)
        record = _driven(robot, config, goals, asked, words, is_simulated=real.port is None)
    if asked.out is not None:
        _write(record, asked.out)
    _tell(record)


def _driven(
    robot: Robot, config: Config, goals: Sequence[Goal], asked: Asked, words: str, *, is_simulated: bool
) -> DriveRecord:
    from wheelsight.cli._drive_view import DriveView
    from wheelsight.pipeline.drives import footprint_of

    with DriveView(footprint_of(config)) as view, _in_map(robot, config, view, in_step=is_simulated) as drive:
        truth = _Truth(robot) if is_simulated else None
        is_interrupted = _through(drive, goals, asked.back, _on_step(drive, view, truth))
        told = truth.told if truth else {}
        return drive.record(len(goals) + asked.back, words, config, told, is_interrupted=is_interrupted)


@contextmanager
def _in_map(robot: Robot, config: Config, view: DriveView, *, in_step: bool) -> Iterator[Drive]:
    """Whoever is asked about a real robot's floor has looked at it; a simulated one begins on free floor."""
    from wheelsight.pipeline.drives import drive_in_map

    def code(done: int, total: int) -> None:
        if done == 1:
            print_note(f"reading {total:,} keyframes of the map")

    how: dict[str, Any] = {"in_step": in_step, "trusts_floor": True, "on_keyframe": code}
    with drive_in_map(robot, config, on_transition=view.note, **how) as drive:
        yield drive


def _through(drive: Drive, goals: Sequence[Goal], back: bool, on_step: Callable[[Feedback], None]) -> bool:
    """Through all goals, up to the first that is not reached; whether somebody stopped it."""
    from wheelsight.pipeline.drives import Goal

    with until_stopped() as is_over:

        def step(feedback: Feedback) -> None:
            on_step(feedback)
            if is_over():
                raise _ToldToStop

        try:
            for goal in goals:
                if not drive.go_to(goal, step):
                    return False
            if back and drive.start is not None:
                drive.go_to(Goal(drive.start, "the start"), step)
        except _ToldToStop:
            return True
    return False


def _on_step(drive: Drive, view: DriveView, truth: _Truth | None) -> Callable[[Feedback], None]:
    def step(feedback: Feedback) -> None:
        if truth is not None:
            truth.look()
        view.show(feedback, drive.navigator)

    return step


class _Truth:
    """What the simulator knows of a drive."""

    def __init__(self, robot: Robot) -> None:
        from wheelsight.simulation.simulator import Simulator

        assert isinstance(robot, Simulator)
        self._simulator, self._clearance_m = robot, float("inf")

    def look(self) -> None:
        self._clearance_m = min(self._clearance_m, self._simulator.clearance_m())

    @property
    def told(self) -> dict[str, Any]:
        contacts = [
            {"stamp_s": one.time_s, "with": one.name, "by_the_robot": bool(one.is_by_robot)}
            for one in self._simulator.contacts
        ]
        return {"clearance_m": round(self._clearance_m, 4), "contacts": contacts}


def _write(record: DriveRecord, out: Path) -> None:
    from wheelsight.cli._outputs import can_draw
    from wheelsight.pipeline.drive_outputs import write_drive
    from wheelsight.report.drive_page import write_drive_page, write_drive_picture

    write_drive(record, out)
    write_drive_picture(record, out / "drive.png")
    if can_draw():
        write_drive_page(record, out / "drive.html")
    print_note(f"results are in {out}")


def _tell(record: DriveRecord) -> None:
    """What became of each goal, on stdout; raises Exit where any was not reached."""
    for goal in record.goals:
        result = goal.result
        if result.has_arrived:
            change = f"; {result.goal_change}" if result.goal_change else ""
            typer.echo(f"arrived at {goal.name}: {result.way_m:.1f} m in {result.time_s:.0f} s{change}")
        elif not record.is_interrupted:
            print_error(f"{goal.name} was not reached: {result.reason} ({result.detail})")
    if record.is_interrupted:
        print_note("interrupted; the robot was stopped first, and stands")
        raise typer.Exit(INTERRUPTED)
    if not record.has_arrived:
        raise typer.Exit(_FAILED)
