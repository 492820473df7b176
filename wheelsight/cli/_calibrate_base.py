"""`wheelsight calibrate base`: where the camera sits on its robot, and how late its clock is."""

from __future__ import annotations

from wheelsight.cli._calibration_files import Force, Out, kept_in, open_for, page_beside, save_found
from wheelsight.cli._options import CalibrationFile, RateHz, RecordingPath, Topics, settings_from
from wheelsight.cli._run_options import SettingsFile


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
    FILE gets T_base_camera and the wheels' delay; of wheels it keeps what --calibration, or FILE itself, told.
    A drive that hides some is refused, and what to drive is said: a minute or two, straight and with turns both ways.
    Of --config the section extrinsics counts.

    [bold]Examples[/bold]

    wheelsight calibrate base my_drive --out base.yaml

    wheelsight calibrate base my_drive --calibration wheels.yaml --out robot.yaml
    """
    from wheelsight.cli._calibration import print_mount
    from wheelsight.cli._calibration_history import measured_mount
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.odometry.extrinsics import calibrate_base
    from wheelsight.report.base_page import write_base_page

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
