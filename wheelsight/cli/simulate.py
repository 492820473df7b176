"""`wheelsight simulate`: a wheelchair's drive through a world, as a recording with truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.cli import _simulation_options as options
from wheelsight.cli._console import INTERRUPTED
from wheelsight.cli._simulation_inputs import plan_of, settings_from
from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.recordings import RecordingWriter
    from wheelsight.simulation import SimulatedRecording, SimulationSettings


def simulate(
    world: options.World = None,
    out: options.Out = None,
    plan: options.Plan = None,
    resolution: options.Resolution = None,
    areas: options.AreasImage = None,
    start: options.Start = None,
    way: options.WayLength = None,
    laps: options.Laps = 1,
    camera: options.Camera = "kinect-v1",
    size: options.Size = "half",
    rate: options.Rate = None,
    seed: options.Seed = 0,
    day: options.Day = 0,
    speed: options.Speed = 0.8,
    duration: options.Duration = None,
    reverse: options.Reverse = False,
    drive: options.DriveFile = None,
    stop_and_turn: options.StopAndTurn = False,
    passers_by: options.PassersBy = 0,
    doors: options.Doors = 0,
    realism: options.Realism = "real",
    motion_blur: options.MotionBlur = False,
    gyro: options.Gyro = False,
    left_radius: options.LeftRadius = None,
    right_radius: options.RightRadius = None,
    track: options.Track = None,
    no_slip: options.NoSlip = False,
    dropout: options.Dropout = None,
    unplug: options.Unplug = None,
    ice: options.Ice = None,
    lift: options.Lift = None,
    cover: options.Cover = None,
    show_list: options.ShowList = False,
    force: options.Force = False,
) -> None:
    """Drive a wheelchair with a depth camera through a simulated world: a recording with truth goes to DIR.

    DIR gets what any recording has (images, wheels.csv, calibration.yaml with what a user would measure), and beside it
    the truth: of base and camera, of the area at each frame (labels.csv), and of the robot (truth/); plan.png shows
    world, areas and track. Ctrl-C stops early and leaves a valid, shorter recording.

    [bold]Examples[/bold]

    wheelsight simulate floor4 --out floor

    wheelsight simulate floor4 --laps 2 --camera kinect-v1 --seed 7 --out two_laps

    wheelsight simulate square --stop-and-turn --right-radius 0.1717 --track 0.53 --out square

    wheelsight simulate flat --lift 12:15 --cover 20:25 --out mishaps

    wheelsight simulate --plan office.yaml --duration 60 --out office

    wheelsight simulate --plan flat.png --resolution 0.05 --areas rooms.png --way 40 --start 3,2.5,90 --out flat

    wheelsight simulate --list
    """
    if show_list:
        _print_list()
        return
    building = plan_of(world, plan, resolution=resolution, areas=areas, start=start, way=way)
    if (world is None and building is None) or out is None:
        missing = "--out DIR" if out is None and (world or building) else "a WORLD"
        raise ConfigError(f"{missing} is missing", fix="wheelsight simulate floor4 --out DIR, or --list")
    settings = settings_from(
        ({"world": world} if building is None else {"plan": building})
        | {"camera": camera, "laps": laps, "seed": seed, "day": day, "speed_m_s": speed, "duration_s": duration}
        | {"rate_hz": rate, "is_reverse": reverse, "velocities": drive, "stops_to_turn": stop_and_turn, "doors": doors}
        | {"passersby": passers_by, "has_motion_blur": motion_blur, "has_slip": not no_slip, "realism": realism},
        size=size,
        robot={"left_radius_m": left_radius, "right_radius_m": right_radius, "track_width_m": track, "has_gyro": gyro},
        times={"--dropout": dropout, "--unplug": unplug, "--lift": lift, "--cover": cover},
        ice=ice,
    )
    _simulate(settings, out, force)


def _simulate(settings: SimulationSettings, out: Path, force: bool) -> None:
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.cli._console import print_note, print_warning
    from wheelsight.extras import needed
    from wheelsight.files import new_output_folder

    needed("mujoco")
    with new_output_folder(out, force):  # refused before the long work
        recording = _drive(settings, out)
        for warning in recording.warnings:
            print_warning(warning)
        compile_missing(("simulation",))  # after the drive, which may be refused and needs none
        try:
            writer = _render(recording, out)
        except KeyboardInterrupt as interruption:
            frames = _frames_listed(out)
            print_note(f"interrupted; {out} holds the drive up to there, {frames} frames" if frames else "interrupted")
            raise typer.Exit(INTERRUPTED) from interruption
    print_note(f"{writer.frames} frames and {writer.readings} wheel readings are in {out}; plan: {out / 'plan.png'}")


def _drive(settings: SimulationSettings, out: Path) -> SimulatedRecording:
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.simulation import simulate as simulate_drive

    with FrameProgress("driving", None, unit="simulated s") as progress:
        return simulate_drive(settings, progress.reach, refused=out.with_name(f"{out.name}-refused.png"))


def _render(recording: SimulatedRecording, out: Path) -> RecordingWriter:
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.simulation import write_simulation

    # What new_output_folder has seen is the user's own wish, or empty.
    with FrameProgress("rendering", recording.frame_count) as progress:
        return write_simulation(recording, out, force=True, on_frame=lambda frame: progress.advance())


def _frames_listed(folder: Path) -> int:
    """How many frames a recording that broke off holds."""
    path = folder / "depth.txt"
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    return sum(not line.startswith("#") for line in lines)


def _print_list() -> None:
    from wheelsight.cli._console import console, facts_table
    from wheelsight.simulation import build_world, camera_model, camera_names, world_names

    stdout = console()
    stdout.print(facts_table("Worlds", ((name, build_world(name).description) for name in world_names())), "")
    stdout.print(facts_table("Cameras", ((name, camera_model(name).description) for name in camera_names())))
