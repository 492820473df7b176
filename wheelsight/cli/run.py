"""`wheelsight run`: where the camera went."""

from __future__ import annotations

from wheelsight.cli._live_run import LiveRun
from wheelsight.cli._options import settings_from
from wheelsight.cli._run_options import RunOptions
from wheelsight.cli._running import track
from wheelsight.cli._summary import print_summary
from wheelsight.cli._takes import takes


@takes(RunOptions)
def run(options: RunOptions) -> None:
    """Find where the robot or its camera went: trajectory, status of each frame, metrics and a report go to DIR.

    Without --odometry wheels and camera are joined where the recording has both and it is known where the camera sits;
    else one of them is followed. One line says which, and how to choose otherwise.

    DIR gets trajectory.txt (TUM), status.csv, metrics.json, the resolved config.yaml and report.html.
    Several odometries have a folder each.

    --map surfels adds map/, in which --map-from finds the next drive: until the place is recognised, its poses are
    "initializing". wheelsight export makes points or a mesh of it.
    --loops adds trajectory_corrected.txt, the way as known at its end, and loops_judged.csv.

    Ctrl-C stops early and keeps what was found until then. With --live, a camera and wheels are followed as they are
    just now: "ready" is said once nothing is left to be compiled or loaded, and Ctrl-C ends it.

    [bold]Examples[/bold]

    wheelsight run sample --out first

    wheelsight run my_drive --map surfels --out results

    wheelsight run rgbd_dataset_freiburg1_desk --odometry features --out results

    wheelsight run my_recording --camera my_camera.yaml --config settings.yaml --out results --force

    wheelsight run my_recording --odometry wheels --calibration my_wheels.yaml --out results

    wheelsight run robot.bag --topic wheels=/odom --out results

    wheelsight run my_recording --odometry dense --out results

    wheelsight run my_recording --odometry wheels --places floor.places --out results

    wheelsight run my_recording --odometry wheels --loops matches --out results

    wheelsight run my_drive --realtime --out results

    wheelsight run my_drive --profile pi --out results

    wheelsight run --live --camera any --wheels /dev/ttyUSB0 --calibration robot.yaml --map surfels --out now

    wheelsight run monday --map surfels --loops keyframes --out monday_map

    wheelsight run my_drive --map surfels --rerun run.rrd --out results

    wheelsight run tuesday --map-from monday_map --out found_again
    """
    from wheelsight.pipeline import default_odometry

    asked = LiveRun.of(options)
    asked.check(options.realtime, options.wheels_from)
    settings = settings_from(options.settings(), options.config)
    told = ""
    with asked.source(settings, options.out, options.realtime, options.wheels_from, options.force) as source:
        if not settings.odometry:
            choice = default_odometry(source, settings)
            settings, told = settings.with_odometry(choice.odometry), choice.sentence
        records = track(source, settings, options.out, options.force, options.rerun, told)
    print_summary(records, options.out)
