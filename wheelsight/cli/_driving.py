"""What `wheelsight drive` does once all is known: compile, drive, show, write."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from wheelsight.cli._console import print_note
from wheelsight.cli._drive_inputs import check, drive_settings
from wheelsight.cli._drive_results import Truth, tell, write
from wheelsight.cli._drive_robots import robot_of, robot_words
from wheelsight.cli._drive_tasks import do_all, tasks_of, why_no_return
from wheelsight.errors import DeviceError
from wheelsight.interrupts import until_stopped

if TYPE_CHECKING:
    from wheelsight.cli._drive_options import DriveOptions
    from wheelsight.cli._drive_tasks import Task
    from wheelsight.cli._drive_watch import DriveWatch
    from wheelsight.config import Config
    from wheelsight.navigation import Feedback
    from wheelsight.pipeline.drive_record import DriveRecord
    from wheelsight.pipeline.drives import Drive, OnStep
    from wheelsight.robots import Robot

# Kernels that localization in a known map, and a drive in it, call.
_PARTS = ("wheels", "dense", "joined", "loops", "navigation")


class _ToldToStop(Exception):  # noqa: N818 - it is no error
    """One of the signals that end a program."""


def drive_there(options: DriveOptions) -> None:
    """Drive to all goals; Exit with 1 where one was not reached, with 130, 143 or 129 where a signal stopped it.

    Raises what was handed in wrong, before anything moves.
    """
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.cli._outputs import check_rerun
    from wheelsight.files import make_output_folder, refuse_full

    check(options)
    config = drive_settings(options)
    tasks = tasks_of(options)
    if options.out is not None and not options.force:
        refuse_full(options.out)  # before the long work; made once there is a robot
    check_rerun(options.rerun, options.force)
    compile_missing((*_PARTS, *(("simulation",) if options.is_simulated else ())))
    with robot_of(options, config) as robot:
        if options.out is not None:
            make_output_folder(options.out, options.force)
        record, left_out = _driven(robot, config, tasks, options)
    if options.out is not None:
        write(record, options.out)
    tell(record, left_out)


def _driven(robot: Robot, config: Config, tasks: Sequence[Task], options: DriveOptions) -> tuple[DriveRecord, str]:
    """What became of it, and in a sentence what was not begun; empty where everything was."""
    from wheelsight.cli._drive_watch import watching
    from wheelsight.pipeline.exploring import loops_of
    from wheelsight.slam.sessions import MAP_FOLDER

    # What is said while the map is read would run into a screen that is drawn already.
    with (
        watching(options.rerun, robot, config) as watch,
        _begun(robot, config, watch, options) as drive,
        watch.view,
    ):
        truth = Truth(robot) if options.is_simulated else None
        is_interrupted = _through(drive, tasks, options, _on_step(drive, watch, truth))
        told, asked = truth.told if truth else {}, len(tasks) + options.back
        record = drive.record(asked, robot_words(options), config, told, is_interrupted=is_interrupted)
    if options.explore and options.out:
        # The last of them are closed once the drive is over.
        record = replace(record, loops=loops_of(options.out / MAP_FOLDER))
    return record, why_no_return(record, drive) if options.back else ""


@contextmanager
def _begun(robot: Robot, config: Config, watch: DriveWatch, options: DriveOptions) -> Iterator[Drive]:
    """Whoever is asked about a real robot's floor has looked at it; a simulated one begins on free floor."""
    from wheelsight.pipeline.drives import drive_in_map
    from wheelsight.pipeline.exploring import exploring
    from wheelsight.slam.sessions import MAP_FOLDER, discard_map

    def code(done: int, total: int) -> None:
        if done == 1:
            print_note(f"reading {total:,} keyframes of the map")

    how: dict[str, Any] = {"in_step": options.is_simulated, "trusts_floor": True}
    how |= {"on_transition": watch.note, "on_events": watch.hear}
    if options.explore:
        assert options.out is not None
        discard_map(options.out / MAP_FOLDER)
        with exploring(robot, config, options.out / MAP_FOLDER, **how) as drive:
            yield drive
    else:
        with drive_in_map(robot, config, on_keyframe=code, **how) as drive:
            yield drive


def _through(drive: Drive, tasks: Sequence[Task], options: DriveOptions, on_step: OnStep) -> bool:
    """Through all tasks, up to the first that fails, then back; whether somebody stopped it."""
    with until_stopped() as is_over:

        def step(feedback: Feedback) -> None:
            on_step(feedback)
            if is_over():
                raise _ToldToStop

        try:
            do_all(drive, tasks, options, step)
        except _ToldToStop:
            return True
        except DeviceError:
            # The signal may have ended the process that localizes, too.
            if not is_over():
                raise
            return True
    return False


def _on_step(drive: Drive, watch: DriveWatch, truth: Truth | None) -> OnStep:
    def step(feedback: Feedback) -> None:
        if truth is not None:
            truth.look()
        watch.step(feedback, drive.navigator)

    return step
