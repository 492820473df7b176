"""`wheelsight simulate`: records a wheelchair's simulated drive with ground truth. Holds its options and their
parser.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wheelsight.app.cli.console import takes
from wheelsight.app.cli.options import OUTPUT, option_field
from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import exit_code

if TYPE_CHECKING:
    from wheelsight_sim import FloorPlan, SimulationSettings


_WORLD, _PLAN = "The world", "A building of your own"
_DRIVE, _CAMERA, _ROBOT, _FAULTS = "The drive", "The camera", "The true robot", "Faults"


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """Options of `simulate`."""

    world: Annotated[
        str | None, typer.Argument(metavar="WORLD", help="What to drive through; see --list.", show_default=False)
    ] = None
    out: Path | None = option_field("Folder of the recording; made if need be.", "DIR", False, OUTPUT)
    force: bool = option_field("Overwrite a recording in DIR.", default=False, panel=OUTPUT)
    show_list: bool = option_field("Show all worlds and cameras, and exit.", default=False, panel=_WORLD, flag="--list")
    seed: int = option_field("Of everything random; the same seed makes the same bytes.", default=0, panel=_WORLD)
    day: int = option_field(
        "Another day in the same building: other light, people, noise; chairs moved.", "N", default=0, panel=_WORLD
    )
    passers_by: int = option_field("How many people walk about.", "N", default=0, panel=_WORLD)
    doors: int = option_field("How many doors open and shut meanwhile.", "N", default=0, panel=_WORLD)
    laps: int = option_field("How often the world's route is driven.", default=1, panel=_DRIVE)
    speed: float = option_field("Speed on straights, up to 1.2 m/s.", "M/S", default=0.8, panel=_DRIVE)
    duration: float | None = option_field("Stop after so long.", "SECONDS", "the whole route", _DRIVE)
    reverse: bool = option_field("Drive the route from its end to its start.", default=False, panel=_DRIVE)
    stop_and_turn: bool = option_field(
        "Stop at each waypoint and turn on the spot, as UMBmark asks.", default=False, panel=_DRIVE
    )
    drive: Path | None = option_field("Velocities to drive in place of the route.", "CSV", False, _DRIVE)
    camera: str = option_field("Which camera to carry; see --list.", "NAME", default="kinect-v1", panel=_CAMERA)
    size: str = option_field(
        "Size of the images in pixels, or by the camera's own.", "WxH|half|full", default="half", panel=_CAMERA
    )
    rate: float | None = option_field("Images a second.", "HZ", "the camera's own", _CAMERA)
    realism: str = option_field(
        "`real`: all that real sensors do; `ideal`: nothing but their noise, for closed forms.",
        "NAME",
        default="real",
        panel=_CAMERA,
    )
    motion_blur: bool = option_field("Smear colour by the motion during exposure.", default=False, panel=_CAMERA)
    plan: Path | None = option_field(
        "Floor plan to drive through in place of WORLD: of ROS map_server, or an image with --resolution.",
        "FILE",
        False,
        _PLAN,
    )
    resolution: float | None = option_field("Metres a pixel of a bare image.", "M", False, _PLAN)
    areas: Path | None = option_field(
        "The plan's rooms, one colour each or parted by lines; they become areas.yaml.", "IMAGE", False, _PLAN
    )
    start: str | None = option_field(
        "Where in the plan the base begins.", "X,Y,YAW_DEG", "a roomy place, by --seed", _PLAN
    )
    way: float | None = option_field(
        "How long the tour is, about.", "METRES", "up to 100, or as --duration takes", _PLAN
    )
    base: str = option_field(
        "`differential`: a wheelchair; `mecanum`, `omni-3`, `omni-4`, `increments`: a base that drives sideways.",
        "KIND",
        default="differential",
        panel=_ROBOT,
    )
    left_radius: float | None = option_field("Of the left wheel.", "M", "0.17", _ROBOT)
    right_radius: float | None = option_field("Of the right wheel.", "M", "0.17", _ROBOT)
    track: float | None = option_field("Distance between the wheels.", "M", "0.52", _ROBOT)
    no_slip: bool = option_field("Let wheels never slip.", default=False, panel=_ROBOT)
    gyro: bool = option_field("Carry a gyroscope; DIR gets gyro.csv.", default=False, panel=_ROBOT)
    dropout: list[str] | None = option_field("Seconds without wheel readings.", "FROM:TO", panel=_FAULTS)
    unplug: list[str] | None = option_field("Seconds whose pulses are lost.", "FROM:TO", panel=_FAULTS)
    ice: list[str] | None = option_field("A round patch of ice, in metres.", "X,Y,R", panel=_FAULTS)
    lift: list[str] | None = option_field("Seconds with the left wheel in the air.", "FROM:TO", panel=_FAULTS)
    cover: list[str] | None = option_field("Seconds with something lying on the camera.", "FROM:TO", panel=_FAULTS)


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
        from wheelsight.app.cli.console import console, facts_table
        from wheelsight_sim import build_world, camera_model, camera_names, world_names

        stdout = console()
        stdout.print(facts_table("Worlds", ((name, build_world(name).description) for name in world_names())), "")
        stdout.print(facts_table("Cameras", ((name, camera_model(name).description) for name in camera_names())))
        return
    plan = plan_of(options)
    is_named = options.world is not None or plan is not None
    if not is_named or options.out is None:
        missing = "--out DIR" if is_named else "a WORLD"
        raise ConfigError(f"{missing} is missing", fix="wheelsight simulate floor4 --out DIR, or --list")
    _simulate(settings_from(options, plan), options.out, options.force)


def _simulate(settings: SimulationSettings, out: Path, force: bool) -> None:
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.cli.console import print_note, print_warning
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.core.files import new_output_folder
    from wheelsight.core.runtime import needed
    from wheelsight_sim import simulate as simulate_drive
    from wheelsight_sim import write_simulation

    needed("mujoco")
    with new_output_folder(out, force):  # refused before the long work
        refused = out.with_name(f"{out.name}-refused.png")
        with FrameProgress("driving", None, unit="simulated s") as progress:
            recording = simulate_drive(settings, progress.reach, refused=refused)
        for warning in recording.warnings:
            print_warning(warning)
        compile_missing(("simulation",))  # after the drive, which may be refused and needs none
        try:
            # What new_output_folder has seen is the user's own wish, or empty.
            with FrameProgress("rendering", recording.frame_count) as rendering:
                writer = write_simulation(recording, out, force=True, on_frame=lambda frame: rendering.advance())
        except KeyboardInterrupt as interruption:
            # Number of frames before the interruption
            path = out / "depth.txt"
            lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
            frames = sum(not line.startswith("#") for line in lines)
            print_note(f"interrupted; {out} holds the drive up to there, {frames} frames" if frames else "interrupted")
            raise typer.Exit(exit_code()) from interruption
    print_note(f"{writer.frames} frames and {writer.readings} wheel readings are in {out}; plan: {out / 'plan.png'}")


_TIMES_FORM = "FROM:TO in seconds, such as 12:15.5"
_START_FORM = "X,Y,YAW_DEG in metres and degrees, such as 4,2.5,90"
_PATCH_FORM = "X,Y,R in metres, such as 4,2.5,0.6"


def settings_from(given: SimulateOptions, plan: FloorPlan | None) -> SimulationSettings:
    """The settings of the options. Raises ConfigError naming an invalid option."""
    from wheelsight_sim import SimulationSettings

    building: dict[str, Any] = {"world": given.world} if plan is None else {"plan": plan}
    # What it is called is checked by the settings, which name what there is.
    named: dict[str, Any] = {"realism": given.realism, "base": given.base}
    from wheelsight_sim import RobotModel

    given_m = {"left_radius_m": given.left_radius, "right_radius_m": given.right_radius, "track_width_m": given.track}
    if given.base != "differential" and any(size_m is not None for size_m in given_m.values()):
        fix = "--left-radius, --right-radius and --track are of two wheels: leave them out"
        raise ConfigError(f"--base {given.base} has no such wheels", fix=fix)
    sizes: dict[str, Any] = {name: size_m for name, size_m in given_m.items() if size_m is not None}
    from wheelsight_sim import Patch, WheelFaults

    return SimulationSettings(
        **building,
        **named,
        camera=given.camera,
        laps=given.laps,
        seed=given.seed,
        day=given.day,
        speed_m_s=given.speed,
        duration_s=given.duration,
        rate_hz=given.rate,
        is_reverse=given.reverse,
        velocities=given.drive,
        stops_to_turn=given.stop_and_turn,
        doors=given.doors,
        passersby=given.passers_by,
        has_motion_blur=given.motion_blur,
        has_slip=not given.no_slip,
        size=size_of(given.size, given.camera),
        robot=RobotModel(**sizes, has_gyro=given.gyro),
        faults=WheelFaults(
            dropouts_s=times_of("--dropout", given.dropout),
            unplugged_s=times_of("--unplug", given.unplug),
            patches=tuple(Patch(*patch) for patch in patches_of("--ice", given.ice)),
            lifted_s=times_of("--lift", given.lift),
        ),
        covered_s=times_of("--cover", given.cover),
    )


def plan_of(given: SimulateOptions) -> FloorPlan | None:
    """The floor plan of the options, if any. Raises ConfigError for invalid combinations."""
    from wheelsight_sim import FloorPlan

    if given.plan is None:
        of_plan = ("--resolution", given.resolution), ("--areas", given.areas), ("--start", given.start)
        for option, value in (*of_plan, ("--way", given.way)):
            if value is not None:
                raise ConfigError(f"{option} means nothing without a plan", fix="--plan map.yaml")
        return None
    if given.world is not None:
        raise ConfigError(f"both the world {given.world} and a plan are given", fix="leave one of them out")
    pose = None
    if given.start is not None:
        x_m, y_m, yaw_deg = _numbers("--start", given.start, ",", 3, _START_FORM)
        pose = x_m, y_m, math.radians(yaw_deg)
    return FloorPlan(given.plan, given.resolution, given.areas, pose, given.way)


def size_of(text: str, camera: str) -> tuple[int, int] | None:
    """Width and height of "320x240", None for "full", half of the camera's for "half". Raises ConfigError."""
    from wheelsight_sim import camera_model

    if text == "full":
        return None
    if text == "half":
        whole = camera_model(camera).camera
        return whole.width // 2, whole.height // 2
    width, _, height = text.lower().replace("×", "x").partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ConfigError(f"--size is {text!r}", fix="write it as 320x240, half or full")
    return int(width), int(height)


def times_of(option: str, texts: list[str] | None) -> tuple[tuple[float, float], ...]:
    """(from, to) in seconds of each "12:15.5". Raises ConfigError naming the option."""
    times = tuple(_numbers(option, text, ":", 2, _TIMES_FORM) for text in texts or ())
    for (start_s, end_s), text in zip(times, texts or (), strict=True):
        if not 0 <= start_s < end_s:
            raise ConfigError(f"{option} is {text!r}", fix=f"{_TIMES_FORM}; the second after the first")
    return tuple((start_s, end_s) for start_s, end_s in times)


def patches_of(option: str, texts: list[str] | None) -> tuple[tuple[float, float, float], ...]:
    """(x, y, radius) in metres of each "4,2.5,0.6". Raises ConfigError naming the option."""
    patches = tuple(_numbers(option, text, ",", 3, _PATCH_FORM) for text in texts or ())
    for (_, _, radius_m), text in zip(patches, texts or (), strict=True):
        if radius_m <= 0:
            raise ConfigError(f"{option} is {text!r}", fix="the radius must be over 0")
    return tuple((x_m, y_m, radius_m) for x_m, y_m, radius_m in patches)


def _numbers(option: str, text: str, between: str, count: int, form: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in text.split(between))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{option} is {text!r}", fix=form)
    return numbers
