"""Views of a board taken from a live camera, until they determine its calibration or somebody presses Ctrl-C."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.cli._console import console, print_note, print_warning
from wheelsight.errors import CalibrationError
from wheelsight.interrupts import exit_code, until_stopped

if TYPE_CHECKING:
    from wheelsight.camera_calibration.live_views import ViewTaker
    from wheelsight.camera_calibration.views import Corners
    from wheelsight.cli._calibrate_views import CameraTask
    from wheelsight.devices.live_camera import LiveCamera, LiveFrame
    from wheelsight.settings import LiveCameraSettings

_WAIT_S = 0.2


class _Why(Enum):
    """Why no more views are taken."""

    ENOUGH, ENDED, STOPPED = auto(), auto(), auto()


def calibrate_live(task: CameraTask, which: str, folder: Path, settings: LiveCameraSettings) -> None:
    """Take views into a folder, go on with those that are there, and calibrate once nothing is missing.

    Raises:
        InputError: the camera, the folder or FILE cannot be used; views of a camera that ended do not determine it.
        Exit: after Ctrl-C; the views stay.
    """
    from wheelsight.camera_calibration.live_views import ViewTaker
    from wheelsight.devices import open_live_camera
    from wheelsight.devices.robot_camera import ANY

    task.check()
    seen = _seen_in(folder, task)
    with until_stopped() as is_over, open_live_camera(None if which == ANY else which, settings) as camera:
        for warning in camera.warnings:
            print_warning(warning)
        task = _of(task, camera)
        assert task.setup.nominal is not None
        taker = ViewTaker(task.board, task.setup.nominal.cameras[0], task.settings, seen)
        print_note(f"{_counted(len(taker.seen))} in {folder}; {taker.advice}; Ctrl-C ends it and keeps them")
        while True:
            why = _take_views(camera, taker, folder, task.depth_factor, is_over)
            if why is _Why.STOPPED:
                print_note(f"{_counted(len(taker.seen))} in {folder}; the same command goes on with them")
                raise typer.Exit(exit_code())
            if not taker.seen:
                problem = f"no view of the board {task.board} came from {camera.name}"
                raise CalibrationError(problem, fix="check --board, light and focus; hold still for half a second")
            if _is_calibrated(task, folder, is_last=why is _Why.ENDED):
                return
            taker.ask_more()


def _is_calibrated(task: CameraTask, folder: Path, *, is_last: bool) -> bool:
    """Whether the views determine it; what is missing is told. Raises CalibrationError where no more can come."""
    try:
        task.calibrate([folder])
    except CalibrationError as error:
        if is_last:
            raise
        print_note(f"not yet: {error}")
        return False
    return True


def _of(task: CameraTask, camera: LiveCamera) -> CameraTask:
    """The task with what the camera tells of itself, under what `--calibration` says. Raises CalibrationError."""
    from wheelsight.calibration import load_calibration

    nominal = camera.calibration
    if task.calibration:
        nominal = load_calibration(*task.calibration, under=nominal)
    setup = replace(task.setup, nominal=nominal, is_registered=camera.calibration.is_registered)
    return replace(task, setup=setup)


def _seen_in(folder: Path, task: CameraTask) -> list[Corners]:
    """Of views that are there from before. Raises RecordingError where the folder's show another board."""
    from wheelsight.camera_calibration.folders import read_views

    if not any(folder.glob("*-color.png")):
        return []
    return [view.color for view in read_views([folder], task.board, task.settings.detection).views]


def _take_views(
    camera: LiveCamera, taker: ViewTaker, folder: Path, depth_factor: float, is_over: Callable[[], bool]
) -> _Why:
    """Until nothing is missing, the camera has ended, or it is over; each view is on the disk once it is told."""
    from wheelsight.camera_calibration.live_views import save_view

    with _shown() as (show, tell):
        while not is_over():
            if taker.has_enough():
                return _Why.ENOUGH
            live = _newest(camera)
            if live is None:
                if _has_ended(camera):
                    return _Why.ENDED
                show(str(camera.report().status))
                continue
            reason = taker.look(live.frame)
            if reason:
                show(f"{len(taker.seen)} views · {taker.advice} · {reason}")
                continue
            name = save_view(folder, live.frame, live.infrared, depth_factor)
            tell(f"view {name} taken; {taker.advice}")
    return _Why.STOPPED


def _newest(camera: LiveCamera) -> LiveFrame | None:
    """The newest frame; a board is searched for more slowly than frames come."""
    newest = camera.read(_WAIT_S)
    while newest is not None and (later := camera.read(0)) is not None:
        newest = later
    return newest


def _has_ended(camera: LiveCamera) -> bool:
    from wheelsight.devices import CameraStatus

    return camera.report().status in (CameraStatus.ENDED, CameraStatus.CLOSED)


@contextmanager
def _shown() -> Iterator[tuple[Callable[[str], None], Callable[[str], None]]]:
    """What says how it is just now, where a terminal watches, and what says a thing that stays, above that."""
    stderr = console(stderr=True)
    if not stderr.is_terminal:
        yield lambda _: None, print_note
        return
    with stderr.status("") as line:
        yield lambda text: line.update(text[: stderr.width - 2]), stderr.print


def _counted(views: int) -> str:
    return f"{views} view{'' if views == 1 else 's'} {'is' if views == 1 else 'are'}"
