"""`wheelsight calibrate camera`: intrinsics, the transform between the cameras, and the error of depth. `wheelsight
board` draws the board.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.app.cli.console import console, print_note, print_warning
from wheelsight.app.cli.options import CalibrationFile, option, settings_from
from wheelsight.app.cli.run_options import SettingsFile
from wheelsight.core.errors import CalibrationError, ConfigError
from wheelsight.core.runtime import exit_code, until_stopped
from wheelsight_calibration.cli_options import Force, Out, kept_in, page_beside, save_found

if TYPE_CHECKING:
    from wheelsight.core.settings import LiveCameraSettings
    from wheelsight.core.settings.calibration import CameraCalibrationSettings
    from wheelsight.io.devices.live_camera import LiveCamera
    from wheelsight_calibration.board import Board
    from wheelsight_calibration.camera_model import CameraSetup
    from wheelsight_calibration.live_views import ViewTaker


Folders = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="FOLDER...",
        help="Folders of images of a board; with --camera, the one into which views go.",
        show_default="with --camera: views",
    ),
]
LiveCameraName = Annotated[
    str | None,
    option(
        "Take views from this camera, as wheelsight record names it, until nothing is missing.",
        "NAME",
        "none: FOLDER has them",
        flag="--camera",
    ),
]
BoardText = Annotated[
    str,
    option(
        "9x6:25mm: inner corners and side of a square; charuco:9x6:27mm: squares and "
        "side, then :MARKER:DICTIONARY if need be; ? for an unknown side, which depth then gives.",
        "BOARD",
        False,
        flag="--board",
    ),
]
Sensor = Annotated[
    str,
    option(
        "How depth is measured: structured-light (Kinect v1, Xtion), tof (Kinect v2, Azure) or stereo "
        "(RealSense D400). Kinect v1's raw disparities are recognised by themselves.",
        "KIND",
    ),
]
Registered = Annotated[bool, typer.Option("--registered", help="Depth images have colour's pixels.")]
Plate = Annotated[
    bool, typer.Option("--plate", help="The board is on a larger flat plate: depth counts all over that.")
]
KeepColor = Annotated[bool, typer.Option("--keep-color", help="Keep the colour lens of --calibration.")]
DepthUnits = Annotated[float, typer.Option("--depth-factor", min=1e-3, help="Units of depth images a metre.")]


def camera(
    board: BoardText,
    out: Out,
    folders: Folders = None,
    camera: LiveCameraName = None,
    sensor: Sensor = "structured-light",
    registered: Registered = False,
    plate: Plate = False,
    keep_color: KeepColor = False,
    depth_factor: DepthUnits = 1000.0,
    calibration: CalibrationFile = None,
    config: SettingsFile = None,
    force: Force = False,
) -> None:
    """Calibrate a depth camera by views of a board: both lenses, where they are, and depth's error by distance.

    A view is a colour image, and of the same moment a depth image, an infrared image, or both:
    VIEW-color.png, VIEW-depth.png, VIEW-ir.png, or folders color, depth and ir. Board and camera stand still.
    wheelsight board prints one. Take 20 to 40 views: near and far, tilted each way, in every corner of the image.
    With --camera it takes them by itself: it says which view is missing, takes each that stands still and is new,
    and ends once they determine the calibration. Ctrl-C keeps the views, and the same command goes on with them.
    With infrared images (the projector covered) the cameras are known to a millimetre; without, by planes alone.
    Views that do not determine it are refused, and what is missing is said.
    FILE gets color, depth, T_color_depth, depth_noise and depth_error; its other parts stay.
    Of --config the section camera_calibration counts, and with --camera also camera.

    [bold]Examples[/bold]

    wheelsight calibrate camera views --board 9x6:25mm --sensor stereo --out robot.yaml

    wheelsight calibrate camera --camera any --board 9x6:25mm --sensor stereo --out robot.yaml

    wheelsight calibrate camera views --board charuco:11x8:33mm --plate --out robot.yaml --force
    """
    from wheelsight.core.calibration import load_calibration
    from wheelsight_calibration.board import board_from
    from wheelsight_calibration.camera_model import CameraSetup

    settings = settings_from({}, config)
    setup = CameraSetup(sensor, registered, plate, None, keep_color)
    given = (depth_factor, calibration, settings.camera_calibration, force)
    task = CameraTask(board_from(board), out, setup, *given)
    if camera is None:
        if not folders:
            raise ConfigError("no folder of images is named", fix="FOLDER, or --camera NAME")
        nominal = load_calibration(*calibration) if calibration else None
        replace(task, setup=replace(setup, nominal=nominal)).calibrate(folders)
        return
    if folders and len(folders) > 1:
        raise ConfigError("--camera takes views into one folder", fix="name one")
    of_camera = settings.camera.model_copy(update={"registered": registered})
    calibrate_live(task, camera, folders[0] if folders else Path("views"), of_camera)


_MOST_LEFT_OUT = 12


@dataclass(frozen=True, slots=True)
class CameraTask:
    """The options of a camera calibration."""

    board: Board
    out: Path
    setup: CameraSetup
    depth_factor: float
    calibration: list[str] | None
    settings: CameraCalibrationSettings
    force: bool

    def calibrate(self, folders: Sequence[Path]) -> None:
        """Read views, calibrate by them, and write FILE and its page.

        Raises RecordingError, and CalibrationError where the views do not determine it.
        """
        from wheelsight.app.cli.console import rows_table
        from wheelsight.app.cli.progress import FrameProgress
        from wheelsight.core.calibration import Calibration
        from wheelsight_calibration.camera_page import DISTANCE_HEAD, HEAD, distance_rows, lens_rows, write_camera_page
        from wheelsight_calibration.cameras import calibrate_camera, camera_fields, measured
        from wheelsight_calibration.cli_results import print_end, show_steps
        from wheelsight_calibration.views import find_view_files, read_views

        page, kept = page_beside(self.out, self.force), kept_in(self.out, self.calibration)
        with FrameProgress("searching boards", len(find_view_files(folders))) as progress:
            seen = read_views(folders, self.board, self.depth_factor, progress.advance)
        with show_steps() as on_step:
            found = calibrate_camera(seen, self.board, self.setup, self.settings, on_step)
        source = f"cameras calibrated by {len(found.views)} views of {found.board}"
        document = camera_fields(found, self.setup.nominal)
        written = save_found(document, kept, Calibration(), source, self.out, measured("camera", found))
        if page is not None:
            write_camera_page(found, page)
        stdout = console()
        for name, reason in found.left_out[:_MOST_LEFT_OUT]:
            print_warning(f"{name} is left out: {reason}")
        if len(found.left_out) > _MOST_LEFT_OUT:
            print_warning(f"and {len(found.left_out) - _MOST_LEFT_OUT} more")
        stdout.print(rows_table(f"cameras, by {len(found.views)} views of {found.board}", HEAD, lens_rows(found)))
        if len(found.depth_residuals.off_m):
            stdout.print(rows_table("depth on the boards' planes", DISTANCE_HEAD, distance_rows(found)))
        print_end(found.warnings, written, page)


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
    from wheelsight.core.calibration import load_calibration
    from wheelsight.io.devices import open_live_camera
    from wheelsight.io.devices.cameras import ANY
    from wheelsight_calibration.live_views import ViewTaker
    from wheelsight_calibration.views import read_views

    page_beside(task.out, task.force)  # outputs are checked before any work
    kept_in(task.out, task.calibration)
    is_begun = any(folder.glob("*-color.png"))
    seen = [view.color for view in read_views([folder], task.board).views] if is_begun else []
    with until_stopped() as is_over, open_live_camera(None if which == ANY else which, settings) as camera:
        for warning in camera.warnings:
            print_warning(warning)
        own = camera.calibration  # overridden by `--calibration`
        nominal = load_calibration(*task.calibration, under=own) if task.calibration else own
        task = replace(task, setup=replace(task.setup, nominal=nominal, is_registered=own.is_registered))
        taker = ViewTaker(task.board, nominal.cameras[0], task.settings.coach, seen)
        print_note(f"{_counted(len(taker.seen))} in {folder}; {taker.advice}; Ctrl-C ends it and keeps them")
        while True:
            why = _take_views(camera, taker, folder, task.depth_factor, is_over)
            if why is _Why.STOPPED:
                print_note(f"{_counted(len(taker.seen))} in {folder}; the same command goes on with them")
                raise typer.Exit(exit_code())
            if not taker.seen:
                problem = f"no view of the board {task.board} came from {camera.name}"
                raise CalibrationError(problem, fix="check --board, light and focus; hold still for half a second")
            try:
                task.calibrate([folder])
                return
            except CalibrationError as error:
                if why is _Why.ENDED:  # no more views can come
                    raise
                print_note(f"not yet: {error}")
            taker.ask_more()


def _take_views(
    camera: LiveCamera, taker: ViewTaker, folder: Path, depth_factor: float, is_over: Callable[[], bool]
) -> _Why:
    """Take views until none is missing, the camera ends, or the user stops. Prints each view once it is on disk."""
    from wheelsight.io.devices import CameraStatus
    from wheelsight_calibration.live_views import save_view

    with camera_progress() as (show, note):
        while not is_over():
            if taker.has_enough():
                return _Why.ENOUGH
            # The newest frame: the search for a board is slower than the camera.
            live = camera.read(_WAIT_S)
            while live is not None and (later := camera.read(0)) is not None:
                live = later
            if live is None:
                if camera.report().status in (CameraStatus.ENDED, CameraStatus.CLOSED):
                    return _Why.ENDED
                show(str(camera.report().status))
                continue
            reason = taker.add(live.frame)
            if reason:
                show(f"{len(taker.seen)} views · {taker.advice} · {reason}")
                continue
            name = save_view(folder, live.frame, live.infrared, depth_factor)
            note(f"view {name} taken; {taker.advice}")
    return _Why.STOPPED


@contextmanager
def camera_progress() -> Iterator[tuple[Callable[[str], None], Callable[[str], None]]]:
    """Functions that show the current state on a terminal, and that print a lasting line above it."""
    stderr = console(stderr=True)
    if not stderr.is_terminal:
        yield lambda _: None, print_note
        return
    with stderr.status("") as line:
        yield lambda text: line.update(text[: stderr.width - 2]), stderr.print


def _counted(views: int) -> str:
    return f"{views} view{'' if views == 1 else 's'} {'is' if views == 1 else 'are'}"


def board_board(
    out: Annotated[Path, typer.Option(metavar="FILE", help="FILE.pdf or FILE.svg to write.", show_default=False)],
    board: Annotated[
        str,
        option(
            "9x6:25mm: inner corners and side of a square; charuco:9x6:28mm: squares and side, "
            "then :MARKER:DICTIONARY if need be.",
            "BOARD",
        ),
    ] = "9x6:25mm",
    paper: Annotated[str, typer.Option(metavar="PAPER", help="A4, A3, A2 or Letter.")] = "A4",
    force: Annotated[bool, typer.Option("--force", help="Overwrite FILE.")] = False,
) -> None:
    """Draw a checkerboard or a ChArUco board in true size, for wheelsight calibrate camera.

    Print it without scaling, measure the line below it, and glue it to something flat: glass, or a board of wood.
    Depth is measured on what it is glued to as well: let that be larger than the paper, and matt.

    [bold]Examples[/bold]

    wheelsight board --out board.pdf

    wheelsight board --board charuco:11x8:33mm --paper A3 --out charuco.pdf
    """
    from wheelsight.app.cli.options import check_out
    from wheelsight.core.errors import OutputError
    from wheelsight.core.files import write_bytes
    from wheelsight_calibration.board import as_pdf, as_svg, board_from, draw_board

    kind = out.suffix.lower()
    if kind not in (".pdf", ".svg"):
        raise OutputError("is neither a .pdf nor a .svg", path=out, fix="end --out with .pdf")
    check_out(out, force)
    wanted = board_from(board)
    sheet = draw_board(wanted, paper)
    write_bytes(out, as_pdf(sheet) if kind == ".pdf" else as_svg(sheet).encode())
    console().print(f"board: {out}", markup=False)
    console().print(f"then: wheelsight calibrate camera VIEWS --board {wanted} --out robot.yaml", markup=False)
