"""`wheelsight run`: where the camera went."""

from __future__ import annotations

from wheelsight.cli import _run_options as options
from wheelsight.cli._odometry import ANY, chosen_odometry, names_odometry
from wheelsight.cli._options import (
    STARTS_IN_KNOWN_MAP,
    CalibrationFile,
    Camera,
    DepthFactor,
    MaxGap,
    RateHz,
    RecordingPath,
    Topics,
    open_source,
    settings_from,
)
from wheelsight.cli._run_progress import played
from wheelsight.cli._running import track
from wheelsight.cli._summary import print_summary


def run(
    recording: RecordingPath,
    out: options.Out,
    odometry: options.Odometry = None,
    fusion: options.Fusion = None,
    map_: options.Map = None,
    loops: options.Loops = None,
    map_from: options.MapFrom = None,
    extend: options.Extend = False,
    camera: Camera = None,
    calibration: CalibrationFile = None,
    config: options.SettingsFile = None,
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
    With --map surfels also map.surfels, of which wheelsight export makes points or a mesh, and map/ for the next drive.

    Ctrl-C stops early and keeps what was found until then.

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

    wheelsight run monday --map surfels --loops keyframes --out monday_map

    wheelsight run tuesday --map-from monday_map --out found_again
    """
    of_recording = {"--camera": camera, "--calibration": calibration, "--depth-factor": depth_factor}
    of_recording["--topic"] = topic
    of_features = {"--max-gap": max_gap, "--rate-hz": rate_hz, "--reference": reference, "--seed": seed}
    of_wheels = {"--integration": integration, "--gyro": gyro}
    start_of = "--start" if map_from is None else STARTS_IN_KNOWN_MAP
    of_places = {"--places": places, "--areas": areas, "--rectify": rectify, start_of: start}
    of_paper = {"--odometry-term": odometry_term, "--weights": weights}
    of_all: dict[str, object] = {"--odometry": odometry, "--fusion": fusion, "--map": map_, "--loops": loops}
    of_all |= {"--map-from": None if map_from is None else str(map_from), "--extend": extend or None}
    given: dict[str, object] = {**of_all, **of_recording, **of_features, **of_wheels, **of_places, **of_paper}
    is_named = odometry is not None or names_odometry(config)
    settings = settings_from(given if is_named else {**given, "--odometry": ANY}, config)
    with played(open_source(recording, settings), realtime, wheels_from, baud, settings.realtime) as source:
        if not is_named:
            given["--odometry"] = chosen_odometry(source, settings)
            settings = settings_from(given, config)
        records = track(source, settings, out, force)
    print_summary(records, out)
