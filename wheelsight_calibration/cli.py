"""`wheelsight calibrate`: cameras, wheels and mount of a robot, from a drive or from squares."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wheelsight.app.cli.console import CliCommand, Group
from wheelsight.app.cli.options import CalibrationFile, RateHz, RecordingPath, Topics, option, settings_from
from wheelsight.app.cli.run_options import SettingsFile
from wheelsight.core.errors import ConfigError
from wheelsight_calibration.cli_camera import camera
from wheelsight_calibration.cli_options import Force, Out, kept_in, open_for, page_beside, save_found, wheel_fields


def base(
    recording: RecordingPath,
    out: Out,
    calibration: CalibrationFile = None,
    rate_hz: RateHz = None,
    topic: Topics = None,
    config: SettingsFile = None,
    force: Force = False,
) -> None:
    """Find where the camera sits on the robot and how late the wheels' stamps are, from an ordinary drive.

    Roll, pitch and height come from the floor seen in depth; yaw, x, y and the delay from the motions of both sensors.
    FILE gets T_base_camera and the wheels' delay; it keeps the wheels of --calibration, or of FILE itself.
    A drive that hides some is refused, and what to drive is said: a minute or two, straight and with turns both ways.
    Of --config the section extrinsics counts.

    [bold]Examples[/bold]

    wheelsight calibrate base my_drive --out base.yaml

    wheelsight calibrate base my_drive --calibration wheels.yaml --out robot.yaml
    """
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight_calibration.base import calibrate_base
    from wheelsight_calibration.camera_page import write_base_page
    from wheelsight_calibration.cli_results import measured_mount, print_mount

    settings, page, kept = settings_from({}, config), page_beside(out, force), kept_in(out, calibration)
    compile_missing(("wheels", "dense"))
    source = open_for(recording, calibration, topic, rate_hz)
    with FrameProgress("watching", source.frame_count) as progress:
        found = calibrate_base(source, progress.advance, settings.extrinsics)
    parts = {"T_base_camera": found.T_base_camera.tolist(), "wheels": {"delay_s": found.wheels.delay_s}}
    measured = f"mount found on {source.name}", out, measured_mount(found)
    written = save_found(parts, kept, source.calibration, *measured)
    if page is not None:
        write_base_page(found, page)
    print_mount(found, written, page)


Robot = Annotated[
    Path, typer.Argument(metavar="FILE", help="The robot's calibration.yaml, there or not yet.", show_default=False)
]
Check = Annotated[
    Path | None,
    option("A drive that ends where it began, heading as at its start: checks all of FILE on it.", "RECORDING", False),
]


From = Annotated[
    Path | None,
    option(
        "Calibrate it by the map of an ordinary drive: a map, or a run or drive that left one.",
        "MAP",
        False,
        flag="--from",
    ),
]
FromWheels = Annotated[
    Path | None, option("With --from: the recording of that drive, with its wheels.", "RECORDING", "beside the map")
]
FromOut = Annotated[
    Path | None, option("With --from: the calibration.yaml to write, with a page beside it.", "FILE", "FILE")
]
Sensor = Annotated[
    str | None,
    option("With --from: structured-light, tof or stereo.", "NAME", "by the calibration's depth noise"),
]


def robot(
    file: Robot,
    check: Check = None,
    topic: Topics = None,
    source: From = None,
    wheels: FromWheels = None,
    out: FromOut = None,
    sensor: Sensor = None,
    force: Force = False,
) -> None:
    """Lead through the calibration of a robot, or calibrate it by the map of an ordinary drive, without a board.

    Without --from it says what FILE has, what is missing, and what to do next: the camera by a board, the wheels by a
    drive, the mount by a drive, then a loop to check them on; and the drive, for a robot that drives by itself.
    Each step writes its part into FILE and keeps the others.

    --from estimates depth, lens, mount, wheels, their delay and the gyroscope together from one drive's map, checks
    them on pairs of views that it did not use, and says what the drive did not show.
    A FILE that is there already is written with --force, or beside it with --out.

    [bold]Examples[/bold]

    wheelsight calibrate robot robot.yaml

    wheelsight calibrate robot robot.yaml --from home

    wheelsight calibrate robot robot.yaml --from results --wheels my_drive --out calibrated.yaml

    wheelsight calibrate robot robot.yaml --check loop
    """
    if source is not None:
        from wheelsight.app.cli.compiling import compile_missing
        from wheelsight_calibration.cli_self import calibrate_from

        compile_missing(("wheels",))
        calibrate_from(file, source, wheels=wheels, out=out, force=force, sensor=sensor)
        return
    if wheels is not None or out is not None or sensor is not None or force:
        raise ConfigError("--wheels, --out, --sensor and --force belong to --from", fix="add --from MAP")
    _show_steps(file, check, topic)


def _show_steps(file: Path, check: Path | None, topic: list[str] | None) -> None:
    from wheelsight.app.cli.console import console, print_warning, rows_table
    from wheelsight.core.inputs import is_there
    from wheelsight_calibration.cli_results import HEAD, history_rows, loop_check, steps_of

    stdout = console()
    steps, history = steps_of(file)
    rows = [(step.name, step.state, step.values) for step in steps]
    stdout.print(rows_table(str(file) if is_there(file) else f"{file} (not there yet)", ("", "", "what"), rows))
    if history:
        stdout.print(rows_table("measured so far", HEAD, history_rows(history)))
    missing = next((step for step in steps if not step.is_done), None)
    # The drive is for a robot that drives by itself, and comes after the loop.
    is_measured = missing is None or missing.name == "drive"
    if check is not None:
        lines, is_good = loop_check(check, file, topic)
        stdout.print("\n".join(lines), markup=False)
        if not is_good:
            print_warning("the loop does not close as a calibrated robot's does; what to do is said above")
    elif is_measured:
        stdout.print(
            f"next: a loop. Drive 20 m or more and end where you began: wheelsight calibrate robot {file} --check LOOP",
            markup=False,
        )
    if missing is not None:
        word = "before it drives by itself" if is_measured else "next"
        stdout.print(f"{word}: {missing.name}. {missing.how}", markup=False)
        for command in missing.commands:
            stdout.print(f"  {command}", markup=False)


calibrate_app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Calibrate a robot: its cameras, its wheels, and where the camera sits.",
)
calibrate_app.command("camera", cls=CliCommand)(camera)
calibrate_app.command("base", cls=CliCommand)(base)
calibrate_app.command("robot", cls=CliCommand)(robot)

Drives = Annotated[
    list[Path],
    typer.Argument(
        metavar="RECORDING...",
        help="Recordings with commands.csv, or tables of commands and speeds.",
        show_default=False,
    ),
]


@calibrate_app.command("drive", cls=CliCommand)
def drive(recordings: Drives, out: Out, calibration: CalibrationFile = None, force: Force = False) -> None:
    """Identify how the wheels answer commands: dead time, time constants, gain and dead zone, of an ordinary drive.

    A RECORDING has wheels.csv and commands.csv, as wheelsight drive --out leaves them.
    Or it is a table, or a folder of tables, of one robot:
    stamp_s, left_m_s and right_m_s of the rims, and joystick, or joystick_forward and joystick_turn,
    or forward_m_s and turn_rad_s.
    FILE gets drive_model, which the collision monitor uses; other parts of --calibration, or of FILE itself, are kept.
    What the drive did not show is named, and what to drive for it.

    [bold]Examples[/bold]

    wheelsight calibrate drive first_drive --calibration robot.yaml --out robot.yaml --force

    wheelsight calibrate drive straight.csv turning.csv --out robot.yaml
    """
    from wheelsight.core.calibration import Calibration, load_calibration
    from wheelsight.core.drive_model import drive_model_fields
    from wheelsight_calibration.drive_fit import fit_drive
    from wheelsight_calibration.drive_log import log_of_recording, logs_of_tables, recording_in
    from wheelsight_calibration.drive_page import measured_drive, print_drive, write_drive_model_page

    page, kept = page_beside(out, force), kept_in(out, calibration)
    nominal, logs = load_calibration(*calibration) if calibration else Calibration(), []
    for path in recordings:
        folder = recording_in(path)
        if folder is None:
            logs += logs_of_tables(path, nominal.wheels.track_width_m if nominal.wheels else 0.0)
        else:
            source = open_for(folder, calibration, None)
            nominal = source.calibration
            logs.append(log_of_recording(source))
    found = fit_drive(logs)
    title = f"drive identified on {', '.join(found.names)}"
    parts = {"drive_model": drive_model_fields(found.model)}
    written = save_found(parts, kept, nominal, title, out, measured_drive(found))
    if page is not None:
        write_drive_model_page(found, page)
    print_drive(found, written, page)


Reference = Annotated[
    Path | None,
    option(
        "Where it truly went, TUM text, such as visual odometry's; of what body, its '# frames:' line says.",
        "TRAJECTORY",
        "the recording's ground truth",
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


@calibrate_app.command("wheels", cls=CliCommand)
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
    other parts of --calibration, or of FILE itself, are kept.
    A drive that leaves something open is refused, as a straight one does the track width;
    what to drive instead is said.

    [bold]Examples[/bold]

    wheelsight calibrate wheels my_drive --out wheels.yaml

    wheelsight calibrate wheels my_drive --reference visual/trajectory.txt --calibration nominal.yaml --out wheels.yaml
    """
    from wheelsight.app.run.runs import COVARIANCES_FILE
    from wheelsight.core.trajectory import read_tum
    from wheelsight_calibration.cli_results import measured_wheels, print_trial, show_steps
    from wheelsight_calibration.wheel_page import write_wheel_page
    from wheelsight_calibration.wheels import try_calibration

    page, kept = page_beside(out, force), kept_in(out, calibration)
    source = open_for(recording, calibration, topic)
    truth = None if reference is None else read_tum(reference, body=source.body)
    by_camera = reference is not None and reference.with_name(COVARIANCES_FILE).is_file()
    options = {"train_share": train_share, "segment_m": segment, "with_delay": delay, "by_camera": by_camera}
    with show_steps() as on_step:
        trial = try_calibration(source, truth, on_step=on_step, **options)  # type: ignore[arg-type]
    against = "its ground truth" if reference is None else reference.name
    found = wheel_fields(trial.fit.wheels, delay="delay_s" in trial.fit.sigmas)
    title = f"wheels fitted on {source.name} to {against}"
    written = save_found(found, kept, source.calibration, title, out, measured_wheels(trial))
    if page is not None:
        write_wheel_page(trial, page)
    print_trial(trial, written, page)


@calibrate_app.command("umbmark", cls=CliCommand)
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
    from wheelsight_calibration.cli_results import (
        measured_squares,
        print_squares,
        squares_from_recordings,
        squares_from_table,
    )
    from wheelsight_calibration.wheel_page import write_squares_page

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
