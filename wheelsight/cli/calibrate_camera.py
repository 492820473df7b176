"""`wheelsight calibrate camera`: lenses, where the cameras are to each other, and what depth is off by."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._calibration_files import Force, Out
from wheelsight.cli._options import CalibrationFile, settings_from
from wheelsight.cli._run_options import SettingsFile
from wheelsight.errors import ConfigError

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
    typer.Option(
        "--camera",
        metavar="NAME",
        help="Take views from this camera, as wheelsight record names it, until nothing is missing.",
        show_default="none: FOLDER has them",
    ),
]
BoardText = Annotated[
    str,
    typer.Option(
        "--board",
        metavar="BOARD",
        help="9x6:25mm: inner corners and side of a square; charuco:9x6:27mm: squares and "
        "side, then :MARKER:DICTIONARY if need be; ? for an unknown side, which depth then tells.",
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
    from wheelsight.camera_calibration.board import board_from
    from wheelsight.camera_calibration.task import CameraSetup
    from wheelsight.cli._calibrate_live import calibrate_live
    from wheelsight.cli._calibrate_views import CameraTask

    settings = settings_from({}, config)
    setup = CameraSetup(sensor, registered, plate, None, keep_color)
    given = (depth_factor, calibration, settings.camera_calibration, force)
    task = CameraTask(board_from(board), out, setup, *given)
    if camera is None:
        if not folders:
            raise ConfigError("no folder of images is named", fix="FOLDER, or --camera NAME")
        task.by_folders(folders)
        return
    if folders and len(folders) > 1:
        raise ConfigError("--camera takes views into one folder", fix="name one")
    of_camera = settings.camera.model_copy(update={"registered": registered})
    calibrate_live(task, camera, folders[0] if folders else Path("views"), of_camera)
