"""`wheelsight simulate`: a wheelchair's drive through a world, as a recording with truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.cli._simulation_inputs import plan_of, settings_from
from wheelsight.cli._simulation_options import SimulateOptions
from wheelsight.cli._takes import takes
from wheelsight.errors import ConfigError
from wheelsight.interrupts import exit_code

if TYPE_CHECKING:
    from wheelsight.recordings import RecordingWriter
    from wheelsight.simulation import SimulatedRecording, SimulationSettings


@takes(SimulateOptions)
def simulate(options: SimulateOptions) -> None:
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
    if options.show_list:
        _print_list()
        return
    plan = plan_of(options)
    is_named = options.world is not None or plan is not None
    if not is_named or options.out is None:
        missing = "--out DIR" if is_named else "a WORLD"
        raise ConfigError(f"{missing} is missing", fix="wheelsight simulate floor4 --out DIR, or --list")
    _simulate(settings_from(options, plan), options.out, options.force)


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
            raise typer.Exit(exit_code()) from interruption
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
