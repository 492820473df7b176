"""`wheelsight run`: where the camera went."""

from __future__ import annotations

from wheelsight.cli import _run_options as options
from wheelsight.cli._live_run import LiveRun
from wheelsight.cli._odometry import ANY, chosen_odometry, names_odometry
from wheelsight.cli._options import (
    STARTS_IN_KNOWN_MAP,
    CalibrationFile,
    DepthFactor,
    MaxGap,
    Profile,
    RateHz,
    Rerun,
    Topics,
    settings_from,
)
from wheelsight.cli._running import track
from wheelsight.cli._summary import print_summary


def run(
    out: options.Out,
    recording: options.LiveRecording = None,
    odometry: options.Odometry = None,
    fusion: options.Fusion = None,
    map_: options.Map = None,
    loops: options.Loops = None,
    map_from: options.MapFrom = None,
    extend: options.Extend = False,
    camera: options.LiveCamera = None,
    calibration: CalibrationFile = None,
    config: options.SettingsFile = None,
    profile: Profile = None,
    depth_factor: DepthFactor = None,
    max_gap: MaxGap = None,
    rate_hz: RateHz = None,
    topic: Topics = None,
    reference: options.Reference = None,
    integration: options.Integration = None,
    gyro: options.Gyro = None,
    places: options.Model = None,
    rectify: options.Rectify = None,
    areas: options.Areas = None,
    start: options.Start = None,
    odometry_term: options.OdometryTerm = None,
    weights: options.Weights = None,
    realtime: options.RealTime = False,
    wheels_from: options.WheelsFrom = None,
    baud: options.Baud = None,
    live: options.Live = False,
    wheels: options.Wheels = None,
    seconds: options.Seconds = None,
    record: options.Record = None,
    rerun: Rerun = None,
    seed: options.Seed = None,
    force: options.Force = False,
) -> None:
    """Find where the robot or its camera went: trajectory, status of each frame, metrics and a report go to DIR.

    Without --odometry wheels and camera are joined where the recording has both and it is known where the camera sits;
    else it is said what is not used, and why.

    DIR gets trajectory.txt (TUM), status.csv, metrics.json, the resolved config.yaml and report.html.
    With several odometries each has a folder of its name, and report.html and metrics.json join them; so have, with
    --places, the wheels alone and the wheels that areas have rectified.
    With --loops also trajectory_corrected.txt, the way as known at its end, and loops_judged.csv.
    With --map-from the way is in that map, once the place is recognised; until then each pose is "initializing".
    With --map surfels also map/ for the next drive; wheelsight export makes points or a mesh of it.

    Ctrl-C stops early and keeps what was found until then. With --live, a camera and wheels are followed as they are
    just now: "ready" is said once nothing is left to be compiled or loaded, and Ctrl-C ends it.

    [bold]Examples[/bold]

    wheelsight run my_drive --map surfels --out results

    wheelsight run rgbd_dataset_freiburg1_desk --odometry features --out results

    wheelsight run my_recording --camera my_camera.yaml --config settings.yaml --out results --force

    wheelsight run my_recording --odometry wheels --calibration my_wheels.yaml --out results

    wheelsight run my_recording --odometry wheels,features --out results

    wheelsight run robot.bag --topic wheels=/odom --odometry wheels --out results

    wheelsight run my_recording --odometry dense --map surfels --out results

    wheelsight run my_recording --odometry wheels --places floor.places --out results

    wheelsight run my_recording --odometry wheels --loops matches --out results

    wheelsight run my_recording --odometry wheels,dense --realtime --out results

    wheelsight run my_drive --profile pi --out results

    wheelsight run --live --camera any --wheels /dev/ttyUSB0 --calibration robot.yaml --map surfels --out now

    wheelsight run monday --map surfels --loops keyframes --out monday_map

    wheelsight run my_drive --map surfels --rerun run.rrd --out results

    wheelsight run tuesday --map-from monday_map --out found_again
    """
    asked = LiveRun(live, recording, camera, wheels, seconds, record, tuple(calibration or ()), baud)
    asked.check(realtime, wheels_from)
    of_recording = {"--camera": None if live else camera, "--calibration": calibration, "--depth-factor": depth_factor}
    of_recording["--topic"] = topic
    of_features = {"--max-gap": max_gap, "--rate-hz": rate_hz, "--reference": reference, "--seed": seed}
    of_wheels = {"--integration": integration, "--gyro": gyro}
    start_of = "--start" if map_from is None else STARTS_IN_KNOWN_MAP
    of_places = {"--places": places, "--areas": areas, "--rectify": rectify, start_of: start}
    of_paper = {"--odometry-term": odometry_term, "--weights": weights}
    of_all: dict[str, object] = {
        "--profile": profile,
        "--odometry": odometry,
        "--fusion": fusion,
        "--map": map_,
        "--loops": loops,
    }
    of_all |= {"--map-from": None if map_from is None else str(map_from), "--extend": extend or None}
    given: dict[str, object] = {**of_all, **of_recording, **of_features, **of_wheels, **of_places, **of_paper}
    is_named = odometry is not None or names_odometry(config)
    settings = settings_from(given if is_named else {**given, "--odometry": ANY}, config)
    with asked.source(settings, out, realtime, wheels_from, force) as source:
        if not is_named:
            given["--odometry"] = chosen_odometry(source, settings)
            settings = settings_from(given, config)
        records = track(source, settings, out, force, rerun)
    print_summary(records, out)
