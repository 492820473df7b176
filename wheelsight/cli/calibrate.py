"""`wheelsight calibrate`: a robot's cameras, its wheels, from a drive or from squares, and where the camera sits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._calibrate_base import base
from wheelsight.cli._calibrate_robot import robot
from wheelsight.cli._calibration_files import Force, Out, kept_in, open_for, page_beside, save_found, wheel_fields
from wheelsight.cli._help import Command, Group
from wheelsight.cli._options import CalibrationFile, RecordingPath, Topics
from wheelsight.cli.calibrate_camera import camera

app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Calibrate a robot: its cameras, its wheels, and where the camera sits.",
)
app.command("camera", cls=Command)(camera)
app.command("base", cls=Command)(base)
app.command("robot", cls=Command)(robot)

Reference = Annotated[
    Path | None,
    typer.Option(
        metavar="TRAJECTORY",
        help="Where it truly went, TUM text, such as visual odometry's; of what body, its '# frames:' line says.",
        show_default="the recording's ground truth",
    ),
]
TrainShare = Annotated[
    float, typer.Option(metavar="SHARE", help="Share of the time to calibrate on; the rest shows what it is worth.")
]
Segment = Annotated[
    float, typer.Option(metavar="METRES", min=0.05, help="Way between two poses of the reference that are compared.")
]
Delay = Annotated[bool, typer.Option("--delay/--no-delay", help="Also find how late the wheels' stamps are.")]
Runs = Annotated[
    list[Path],
    typer.Argument(metavar="RUN...", help="Recordings of one square each, or one table.", show_default=False),
]
Side = Annotated[
    float | None, typer.Option(metavar="METRES", help="Side of the squares.", show_default="a quarter of the way")
]


@app.command("wheels", cls=Command)
def wheels(
    recording: RecordingPath,
    out: Out,
    reference: Reference = None,
    calibration: CalibrationFile = None,
    train_share: TrainShare = 0.5,
    segment: Segment = 1.0,
    delay: Delay = True,
    topic: Topics = None,
    force: Force = False,
) -> None:
    """Fit both radii, the track width and the clocks' delay to a reference trajectory.

    The first part is fitted, the rest shows what the result is worth.
    A TRAJECTORY of wheelsight run, with covariances.csv beside it, is only as long as the camera's calibration has it:
    then σ holds that too.
    FILE gets what was found of the wheels, for wheelsight run --calibration;
    what --calibration told, or FILE itself, of other parts is kept.
    A drive that leaves something open is refused, as a straight one does the track width;
    what to drive instead is said.

    [bold]Examples[/bold]

    wheelsight calibrate wheels my_drive --out wheels.yaml

    wheelsight calibrate wheels my_drive --reference visual/trajectory.txt --calibration nominal.yaml --out wheels.yaml
    """
    from wheelsight.cli._calibration import print_trial, show_steps
    from wheelsight.cli._calibration_history import measured_wheels
    from wheelsight.odometry.wheels.trial import try_calibration
    from wheelsight.pipeline.covariances import COVARIANCES_FILE
    from wheelsight.report.wheel_page import write_wheel_page
    from wheelsight.trajectory import read_tum

    page, kept = page_beside(out, force), kept_in(out, calibration)
    source = open_for(recording, calibration, topic)
    truth = None if reference is None else read_tum(reference, body=source.body)
    by_camera = reference is not None and reference.with_name(COVARIANCES_FILE).is_file()
    options = {"train_share": train_share, "segment_m": segment, "with_delay": delay, "by_camera": by_camera}
    with show_steps() as on_step:
        trial = try_calibration(source, truth, on_step=on_step, **options)  # type: ignore[arg-type]
    against = "its ground truth" if reference is None else reference.name
    found = wheel_fields(trial.fit.wheels, delay="delay_s" in trial.fit.sigmas)
    told = f"wheels fitted on {source.name} to {against}"
    written = save_found(found, kept, source.calibration, told, out, measured_wheels(trial))
    if page is not None:
        write_wheel_page(trial, page)
    print_trial(trial, written, page)


@app.command("umbmark", cls=Command)
def umbmark(
    runs: Runs,
    out: Out,
    calibration: CalibrationFile = None,
    side: Side = None,
    topic: Topics = None,
    force: Force = False,
) -> None:
    """Correct wheel ratio and track width by squares, driven both ways and measured by tape (Borenstein & Feng 1996).

    A RUN is a recording of one square, with true poses at its start and end.
    Or it is a table with columns direction (cw or ccw), x_m and y_m:
    where each run truly ended, less where the robot believed to be, x along the first side, y to the left.
    A table needs --side and --calibration.

    [bold]Examples[/bold]

    wheelsight calibrate umbmark squares/* --out wheels.yaml

    wheelsight calibrate umbmark errors.csv --side 4 --calibration nominal.yaml --out wheels.yaml
    """
    from wheelsight.cli._calibration import print_squares, squares_from_recordings, squares_from_table
    from wheelsight.cli._calibration_history import measured_squares
    from wheelsight.report.wheel_page import write_squares_page

    page, kept = page_beside(out, force), kept_in(out, calibration)
    if len(runs) == 1 and not runs[0].is_dir():
        squares = squares_from_table(runs[0], calibration, side)
    else:
        squares = squares_from_recordings([open_for(run, calibration, topic) for run in runs], side)
    found = wheel_fields(squares.result.wheels, delay=False)
    written = save_found(found, kept, squares.nominal, f"UMBmark, {squares.name}", out, measured_squares(squares))
    if page is not None:
        write_squares_page(squares.result, squares.after_m, squares.name, page)
    print_squares(squares, written, page)
