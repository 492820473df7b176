"""What a drive is to do, one after another, as the options of `wheelsight drive` say it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wheelsight.cli._drive_options import DriveOptions
    from wheelsight.geometry import FloatArray
    from wheelsight.navigation import NavigationResult
    from wheelsight.pipeline.drive_record import DriveRecord
    from wheelsight.pipeline.drives import Drive, Goal, OnStep

    Task = Callable[[Drive, OnStep], NavigationResult]


def tasks_of(options: DriveOptions) -> list[Task]:
    """All but the return. Raises as `goals_of` and `way_of`: before anything moves."""
    from wheelsight.cli._drive_inputs import goals_of, way_of

    way = way_of(options)
    tasks: list[Task] = [_explore] if options.explore else []
    if way is not None:
        tasks.append(partial(_follow, way, f"the end of {options.follow}"))
    return [*tasks, *map(_GoTo, goals_of(options))]


def do_all(drive: Drive, tasks: Sequence[Task], options: DriveOptions, on_step: OnStep) -> None:
    """All tasks, up to the first that fails; then back, where that is asked for.

    Raises what `on_step` raises; MapError, before anything moves, for a goal at which the map has no room.
    """
    from wheelsight.pipeline.drives import Goal

    drive.refuse([task.goal for task in tasks if isinstance(task, _GoTo)])
    for task in tasks:
        if not task(drive, on_step):
            return
    if options.back and drive.start is not None:
        drive.go_to(Goal(drive.start, "the start"), on_step)


def why_no_return(record: DriveRecord, drive: Drive) -> str:
    """Why --back was left out; empty where it was begun. It is the last task, so then all were."""
    if len(record.goals) == record.asked:
        return ""
    if drive.start is None:
        return "--back was left out: it was never known where in the map the robot is, nor where the drive began"
    return "--back was left out: a goal before it was not reached"


def _explore(drive: Drive, on_step: OnStep) -> NavigationResult:
    return drive.explore(on_step)


def _follow(way: FloatArray, name: str, drive: Drive, on_step: OnStep) -> NavigationResult:
    return drive.follow(way, on_step, name)


@dataclass(frozen=True, slots=True)
class _GoTo:
    """The task to drive to a goal."""

    goal: Goal

    def __call__(self, drive: Drive, on_step: OnStep) -> NavigationResult:
        return drive.go_to(self.goal, on_step)
