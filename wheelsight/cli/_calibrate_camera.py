"""`wheelsight calibrate camera`: lenses, where the cameras are to each other, and what depth is off by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.cli._calibration_files import Force, Out, kept_in, page_beside, save_found
from wheelsight.cli._options import CalibrationFile, settings_from
from wheelsight.cli._run_options import SettingsFile

if TYPE_CHECKING:
    from wheelsight.camera_calibration.result import CameraCalibration
    from wheelsight.camera_calibration.task import CameraSetup

_MOST_LEFT_OUT = 12

Folders = Annotated[
    list[Path], typer.Argument(metavar="FOLDER...", help="Folders of images of a board.", show_default=False)
]
BoardText = Annotated[
    str,
    typer.Option(
        "--board",
        metavar="BOARD",
        help="9x6:25mm: inner corners and side of a square; charuco:9x6:27mm[:MARKER[:DICTIONARY]]: squares, side; "
        "? for an unknown side, which depth then tells.",
        show_default=False,
    ),
]
Sensor = Annotated[
    str,
    typer.Option(
        metavar="KIND",
        help="How depth is measured: structured-light (Kinect v1, Xtion), tof (Kinect v2, Azure) or stereo "
        "(RealSense D400). Kinect v1's raw disparities are recognised by themselves.",
    ),
]
Registered = Annotated[bool, typer.Option("--registered", help="Depth images have colour's pixels.")]
Plate = Annotated[
    bool, typer.Option("--plate", help="The board is on a larger flat plate: depth counts all over that.")
]
KeepColor = Annotated[bool, typer.Option("--keep-color", help="Keep the colour lens that --calibration tells.")]
DepthUnits = Annotated[float, typer.Option("--depth-factor", min=1e-3, help="Units of depth images a metre.")]


def camera(
    folders: Folders,
    board: BoardText,
    out: Out,
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
    With infrared images (the projector covered) the cameras are known to a millimetre; without, by planes alone.
    Views that do not determine it are refused, and what is missing is said.
    FILE gets color, depth, T_color_depth, depth_noise and depth_error; its other parts stay.
    Of --config the section camera_calibration counts.

    [bold]Examples[/bold]

    wheelsight calibrate camera views --board 9x6:25mm --sensor stereo --out robot.yaml

    wheelsight calibrate camera views --board charuco:11x8:33mm --plate --out robot.yaml --force
    """
    from wheelsight.camera_calibration.task import CameraSetup

    setup = CameraSetup(sensor, registered, plate, None, keep_color)
    calibrate_views(folders, board, out, setup, depth_factor, calibration, config, force=force)


def calibrate_views(
    folders: list[Path],
    board: str,
    out: Path,
    setup: CameraSetup,
    depth_factor: float,
    calibration: list[str] | None,
    config: Path | None,
    *,
    force: bool,
) -> None:
    """Read views, calibrate by them, and write FILE and its page."""
    from wheelsight.calibration import Calibration, load_calibration
    from wheelsight.camera_calibration.board import board_from
    from wheelsight.camera_calibration.calibrate import calibrate_camera
    from wheelsight.camera_calibration.fields import camera_fields, measured
    from wheelsight.camera_calibration.folders import find_view_files, read_views
    from wheelsight.cli._calibration import show_steps
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.report.camera_page import write_camera_page

    settings = settings_from({}, config).camera_calibration
    wanted, page, kept = board_from(board), page_beside(out, force), kept_in(out, calibration)
    setup = replace(setup, nominal=load_calibration(*calibration) if calibration else None)
    with FrameProgress("searching boards", len(find_view_files(folders))) as progress:
        seen = read_views(folders, wanted, settings.detection, depth_factor, progress.advance)
    with show_steps() as on_step:
        found = calibrate_camera(seen, wanted, setup, settings, on_step)
    source = f"cameras calibrated by {len(found.views)} views of {found.board}"
    document = camera_fields(found, setup.nominal)
    written = save_found(document, kept, Calibration(), source, out, measured("camera", found))
    if page is not None:
        write_camera_page(found, page)
    _print(found, written, page)


def _print(found: CameraCalibration, written: str, page: Path | None) -> None:
    from wheelsight.cli._calibration import print_end, table
    from wheelsight.cli._console import console, print_warning
    from wheelsight.report.camera_tables import HEAD, distance_rows, lens_rows

    stdout = console()
    for name, reason in found.left_out[:_MOST_LEFT_OUT]:
        print_warning(f"{name} is left out: {reason}")
    if len(found.left_out) > _MOST_LEFT_OUT:
        print_warning(f"and {len(found.left_out) - _MOST_LEFT_OUT} more")
    stdout.print(table(f"cameras, by {len(found.views)} views of {found.board}", HEAD, lens_rows(found)))
    if len(found.depth_residuals.off_m):
        head = ("distance", "off before", "off after", "scatter", "σ of depth")
        stdout.print(table("depth on the boards' planes", head, distance_rows(found)))
    print_end(found.warnings, written, page)
