"""`wheelsight drive`: a robot drives to places of a map. Parses the options, opens the robot, runs the tasks and prints
the results.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import typer

from wheelsight.app.cli.console import CountedLines, print_error, print_note, print_warning, takes
from wheelsight.app.cli.drive_options import DriveOptions
from wheelsight.core.errors import CalibrationError, ConfigError, DeviceError, MapError
from wheelsight.core.runtime import exit_code, until_stopped

if TYPE_CHECKING:
    from wheelsight.app.cli.drive_options import RobotOptions, SessionOptions, SettingsOptions
    from wheelsight.app.cli.drive_view import DriveWatch
    from wheelsight.app.page import DriveMaps, Session, Watch
    from wheelsight.app.run.drive_record import DriveRecord
    from wheelsight.app.run.drives import GoalDrive, NamedGoal, OnStep
    from wheelsight.config import Config
    from wheelsight.core.geometry import FloatArray
    from wheelsight.core.robots import Robot
    from wheelsight.navigation import Feedback, NavigationResult
    from wheelsight.slam.maps import MapFolder
    from wheelsight_export import DriveLog
    from wheelsight_ros2 import Bridge, LinkSettings
    from wheelsight_sim import SimulationSettings


@takes(DriveOptions)
def drive(options: DriveOptions) -> None:
    """Drive to places of a known map, or explore: simulated, or with a robot on a serial port.

    The robot finds itself in the map, plans, drives around what is in its way, and stops where it must; docs/safety.md
    says what stops it and what does not. A terminal shows plan, state, speed and why it does what it does; else a line
    a second is printed. Ctrl-C stops the robot first.

    --robot asks once before anything moves. It needs a live camera (wheelsight devices), whose own calibration is laid
    under --calibration.

    With --foxglove or --ros2 and without a goal, other programs lead the robot in the map, until Ctrl-C.

    Exit code 0: arrived; 1: not, and why is said; 2: what was handed in is wrong; 130: interrupted.

    [bold]Examples[/bold]

    wheelsight drive --sim flat --explore --out home
    wheelsight drive --sim flat --map home --to kitchen --out drive
    wheelsight drive --sim flat --map home --to kitchen --rerun drive.rrd
    wheelsight drive --sim flat --day 1 --map home --to 3.2,1.5,90 --to desk --back
    wheelsight drive --sim flat --map home --follow drive/trajectory.txt --back
    wheelsight drive --robot /dev/ttyUSB0 --camera any --calibration robot.yaml --map home --to kitchen
    wheelsight drive --sim flat --map home --known-start 0,0,0 --to kitchen --set navigation.limits.forward_m_s=0.5
    wheelsight drive --sim flat --map home --foxglove 8766 --ros2 dds
    wheelsight drive --sim flat --hardware atmega8 --map home --to kitchen
    """
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.cli.options import check_rerun, link_settings
    from wheelsight.core.files import make_output_folder, refuse_full

    check(options)
    links, config, goals, way = link_settings(options), drive_settings(options), goals_of(options), way_of(options)
    if options.out is not None and not options.force:
        refuse_full(options.out)  # before the long work; made once there is a robot
    check_rerun(options.rerun, options.force)
    compile_missing(kernels_of(options))
    with robot_of(options, config) as robot:
        if links is not None and is_led(options):
            be_led(robot, options, config, links)
            return
        if options.out is not None:
            make_output_folder(options.out, options.force)
        record, left_out = _driven(robot, config, goals, way, options, links)
    if options.out is not None:
        write(record, options.out)
    print_results(record, left_out)


class _StopSignal(Exception):  # noqa: N818 - it is no error
    """A signal that ends the program."""


def kernels_of(options: RobotOptions) -> tuple[str, ...]:
    """The parts whose kernels localization in a map, and a drive in it, call."""
    parts = ("wheels", "dense", "joined", "loops", "navigation")
    return (*parts, "simulation") if options.is_simulated else parts


def is_led(options: DriveOptions) -> bool:
    """Whether other programs give the goals."""
    return not (options.to or options.follow or options.explore) and bool(options.foxglove or options.ros2)


def be_led(robot: Robot, options: DriveOptions, config: Config, links: LinkSettings) -> None:
    """Drive in a known map as other programs ask, without a page, until Ctrl-C. Raises as `drive`."""
    maps = maps_of(options, config)
    with (
        CountedLines(print_warning) as lines,
        session_of(robot, maps, options, config, links, lines) as session,
    ):
        with until_stopped() as is_over:
            wait_for_end(session, is_over)
        print_note("stopped; ending")


@contextmanager
def session_of(
    robot: Robot,
    maps: DriveMaps,
    options: SessionOptions,
    config: Config,
    links: LinkSettings | None,
    lines: CountedLines,
) -> Iterator[Session]:
    """A session that Rerun shows and other programs lead, where options ask for them."""
    from wheelsight.app.cli.options import linked
    from wheelsight.app.page import Session
    from wheelsight_export import open_drive_log

    rerun, on_problem = options.rerun, partial(lines.add, is_problem=True)
    with (
        nullcontext() if rerun is None else open_drive_log(rerun, robot.calibration, config.viewer) as log,
        linked(
            links, robot.calibration, config, lambda: robot.now_s, lines.add, is_simulated=options.is_simulated
        ) as bridge,
        Session(
            robot,
            maps,
            config.page,
            paces=options.is_simulated,
            on_problem=on_problem,
            watch=watch_of(log, bridge),
        ) as session,
    ):
        if bridge is not None:
            bridge.lead(session)
        yield session


def wait_for_end(session: Session, is_over: Callable[[], bool]) -> None:
    """Wait for the end of the program, and stop the robot before slow work, as closing pages and writing a map."""
    waiting = threading.Event()
    while not is_over():
        waiting.wait(_WAIT_S)
    session.stop("the program ends")


def watch_of(log: DriveLog | None, bridge: Bridge | None) -> Watch | None:
    """One listener of those that there are."""
    if log is None or bridge is None:
        return log or bridge
    from wheelsight_ros2 import Watches

    return Watches(log, bridge)


def maps_of(options: SessionOptions, config: Config) -> DriveMaps:
    """The maps to drive in. Raises ConfigError, MapError."""
    from wheelsight.app.page import DriveMaps
    from wheelsight.config import StartSettings

    start = None
    if options.known_start is not None:
        if options.map_ is None:
            raise ConfigError("--known-start is of a map", fix="--map DIR")
        x_m, y_m, yaw = start_of("--known-start", options.known_start)
        start = StartSettings(x_m=x_m, y_m=y_m, yaw_deg=math.degrees(yaw))
    return DriveMaps(config, options.map_, start, options.out, in_step=options.is_simulated)


def _driven(
    robot: Robot,
    config: Config,
    goals: Sequence[NamedGoal],
    way: FloatArray | None,
    options: DriveOptions,
    links: LinkSettings | None,
) -> tuple[DriveRecord, str]:
    """The record of the drive, and a sentence on tasks that were not begun; "" if there are none."""
    from wheelsight.app.cli.drive_view import watching
    from wheelsight.app.cli.options import linked
    from wheelsight.app.run.drives import loops_of, wheels_recorded
    from wheelsight.slam.maps import MAP_FOLDER

    # What is said while the map is read would run into a screen that is drawn already.
    with (
        CountedLines(print_warning) as lines,
        linked(
            links,
            robot.calibration,
            config,
            lambda: robot.now_s,
            lines.add,
            is_simulated=options.is_simulated,
        ) as bridge,
        watching(options.rerun, robot, config, bridge) as watch,
        nullcontext(robot)
        if options.out is None
        else wheels_recorded(robot, options.out, config.navigation.limits) as recorded,
        _begun(recorded, config, watch, options) as drive,
        watch.view,
    ):
        truth, is_interrupted = Truth(robot) if options.is_simulated else None, False
        with until_stopped() as is_over:

            def step(feedback: Feedback) -> None:
                if truth is not None:
                    truth.update()
                watch.step(feedback, drive.navigator)
                if is_over():
                    raise _StopSignal

            try:
                _do_all(drive, goals, way, options, step, partial(_are_wheels_fine, watch))
            except _StopSignal:
                is_interrupted = True
            except DeviceError:
                # The signal may have ended the process that localizes, too.
                if not is_over():
                    raise
                is_interrupted = True
        facts = truth.to_dict() if truth else {}
        asked = len(goals) + (way is not None) + options.explore + options.back
        record = drive.record(asked, robot_words(options), config, facts, is_interrupted=is_interrupted)
    if options.explore and options.out:
        # The last of them are closed once the drive is over.
        record = replace(record, loops=loops_of(options.out / MAP_FOLDER))
    if not options.back or len(record.goals) == record.asked:
        return record, ""
    # The return is the last task.
    if drive.start is None:
        why = "it was never known where in the map the robot is, nor where the drive began"
    else:
        why = "a goal before it was not reached"
    return record, f"--back was left out: {why}"


@contextmanager
def _begun(robot: Robot, config: Config, watch: DriveWatch, options: DriveOptions) -> Iterator[GoalDrive]:
    """A drive or an exploration, ready to start. The user has confirmed that the floor around the start is free."""
    from wheelsight.app.run.drives import drive_in_map, exploring
    from wheelsight.slam.maps import MAP_FOLDER, discard_map

    def code(done: int, total: int) -> None:
        if done == 1:
            print_note(f"reading {total:,} keyframes of the map")

    how: dict[str, Any] = {"in_step": options.is_simulated, "trusts_floor": True}
    how |= {"on_transition": watch.note, "on_events": watch.on_events}
    if options.explore:
        assert options.out is not None
        discard_map(options.out / MAP_FOLDER)
        with exploring(robot, config, options.out / MAP_FOLDER, **how) as drive:
            yield drive
    else:
        with drive_in_map(robot, config, on_keyframe=code, **how) as drive:
            yield drive


def _are_wheels_fine(watch: DriveWatch) -> bool:
    """Ask whether the wheels are in order, as they did not follow their commands; False where no person can answer."""
    if not sys.stdin.isatty():
        return False
    with watch.view.paused():
        return typer.confirm("The wheels did not follow their commands. Are they in order, and may the robot go on?")


def _do_all(
    drive: GoalDrive,
    goals: Sequence[NamedGoal],
    way: FloatArray | None,
    options: DriveOptions,
    on_step: OnStep,
    are_wheels_fine: Callable[[], bool],
) -> None:
    """Run all tasks up to the first that fails; then drive back, if requested.

    A task that failed as the wheels did not follow their commands is run again, if `are_wheels_fine`.

    Raises errors of `on_step`; and MapError, before anything moves, for a goal without free floor in the map.
    """
    from wheelsight.app.run.drives import NamedGoal
    from wheelsight.navigation import NavigationReason

    drive.refuse(goals)

    def run(task: Callable[[], NavigationResult]) -> bool:
        while not (result := task()):
            if result.reason is not NavigationReason.DISOBEYS or not are_wheels_fine():
                return False
            drive.clear_fault()
        return True

    tasks: list[Callable[[], NavigationResult]] = [partial(drive.explore, on_step)] if options.explore else []
    if way is not None:
        tasks.append(partial(drive.follow, way, on_step, f"the end of {options.follow}"))
    tasks += [partial(drive.go_to, goal, on_step) for goal in goals]
    if all(map(run, tasks)) and options.back and drive.start is not None:
        run(partial(drive.go_to, NamedGoal(drive.start, "the start"), on_step))


_FAILED = 1
# Share of periods that may come late before it is said.
_OFTEN = 0.01
# Contacts that a line names.
_NAMED = 5


class Truth:
    """True figures of a simulated drive."""

    def __init__(self, robot: Robot) -> None:
        from wheelsight_sim.simulator import Simulator

        assert isinstance(robot, Simulator)
        self._simulator, self._clearance_m = robot, float("inf")

    def update(self) -> None:
        """Measure the clearance after a period."""
        self._clearance_m = min(self._clearance_m, self._simulator.clearance_m())

    def to_dict(self) -> dict[str, Any]:
        """Contacts and least clearance, for `DriveRecord.truth`."""
        contacts = [
            {"stamp_s": one.time_s, "with": one.name, "by_the_robot": bool(one.is_by_robot)}
            for one in self._simulator.contacts
        ]
        return {"clearance_m": round(self._clearance_m, 4), "contacts": contacts}


def write(record: DriveRecord, out: Path) -> None:
    """Write all files of --out."""
    from wheelsight.app.cli.options import can_draw
    from wheelsight_report import write_drive, write_drive_page, write_drive_picture

    write_drive(record, out)
    write_drive_picture(record, out / "drive.png")
    if can_draw():
        write_drive_page(record, out / "drive.html")
    print_note(f"results are in {out}")


def print_results(record: DriveRecord, left_out: str = "") -> None:
    """Print the result of each goal, tasks that were left out, and contacts of a simulated robot.

    Raises Exit where a goal was not reached, or anything was touched.
    """
    from wheelsight.app.run import words

    for goal in record.goals:
        result = goal.result
        if result.has_arrived:
            change = f"; {result.goal_change}" if result.goal_change else ""
            typer.echo(f"arrived at {goal.name}: {result.way_m:.1f} m in {result.time_s:.0f} s{change}")
        elif not record.is_interrupted:
            print_error(f"{goal.name} was not reached: {result.reason} ({result.detail})")
    mean_m_s = words.number(record.way_m / max(record.time_s, 1e-9), 2)
    typer.echo(f"{mean_m_s} m/s in the mean; the robot's time: {record.spent_words or 'none'}")
    # Late control periods
    periods = record.periods
    if periods.late > _OFTEN * periods.count:
        print_note(
            f"{periods.late:,} of {periods.count:,} periods of the control loop took longer than they should, "
            f"{1e3 * periods.longest_s:.0f} ms at most: a faster computer helps, or fewer programs beside it"
        )
    if record.rests_on_start:
        print_warning(
            "nothing of the map was recognised: where the robot was rests on --known-start alone, and may be wrong"
        )
    if record.is_interrupted:
        print_note("interrupted; the robot was stopped first, and stands")
    elif left_out:
        print_error(left_out)
    if touched := record.contacts:
        more = f", and {len(touched) - _NAMED} more" if len(touched) > _NAMED else ""
        print_error(
            f"the robot drove against something {words.times(len(touched))}: {', '.join(touched[:_NAMED])}{more}"
        )
    if record.is_interrupted or touched or not record.has_arrived:
        raise typer.Exit(exit_code() if record.is_interrupted else _FAILED)


_CALLED = {"profile": "--profile", "known_map.path": "--map", "known_map.start": "--known-start"}


def check(options: DriveOptions) -> None:
    """Check the options. Raises ConfigError for invalid combinations."""
    check_robot(options, partial(_check_task, options))


def _check_task(options: DriveOptions) -> None:
    if options.explore:
        if options.map_ is not None or options.to:
            raise ConfigError("--explore begins without a map and goals", fix="no --map and no --to; those come next")
        if options.follow is not None:
            raise ConfigError("--explore finds its own way", fix="leave out --explore or --follow")
        if options.out is None:
            raise ConfigError("--explore leaves a map", fix="--out DIR")
    elif options.map_ is None:
        raise ConfigError("there is no map to drive in", fix="--map DIR, of a run with --map surfels; or --explore")
    elif options.follow is not None and options.to:
        raise ConfigError("--follow ends where its way does", fix="leave out --follow or --to")
    elif is_led(options):
        if options.back or options.out is not None:
            problem = "a robot that other programs lead has no way back, and leaves no record"
            raise ConfigError(problem, fix="leave out --back and --out; wheelsight record records, Foxglove too")
    elif options.follow is None and not options.to:
        raise ConfigError("there is no goal", fix="--to NAME, or --to X,Y,YAW_DEG; or --follow FILE")


def check_robot(options: RobotOptions, check_task: Callable[[], None] = lambda: None) -> None:
    """Check options that name a robot; `check_task` is called once there is one robot. Raises ConfigError."""
    if (options.sim is None) == options.is_simulated:
        problem = "no robot is named" if options.is_simulated else "a robot is either simulated or real"
        raise ConfigError(problem, fix="one of --sim WORLD and --robot PORT")
    check_task()
    if options.is_simulated and (options.calibration is not None or options.yes):
        option = "--yes" if options.calibration is None else "--calibration"
        raise ConfigError(f"{option} is of a real robot", fix="--robot PORT, or leave it out")
    if not options.is_simulated:
        if options.calibration is None:
            raise ConfigError("--robot needs to know how the robot is built", fix="--calibration FILE")
        if options.start is not None:
            raise ConfigError("--start is of a simulated robot", fix="--known-start X,Y,YAW_DEG")
        if options.drive_model is not None:
            raise ConfigError(
                "--drive-model is of a simulated robot", fix="put drive_model into the --calibration file"
            )
        if options.hardware is not None:
            raise ConfigError("--hardware is of a simulated robot", fix="leave it out: --robot drives the real chip")
        return
    if options.hardware is not None:
        _hardware().check_board(options.hardware)
    _simulated(options)  # before kernels are compiled, which takes minutes


def drive_settings(options: DriveOptions) -> Config:
    """The configuration of the drive. Raises ConfigError."""
    path = None if options.map_ is None else str(options.map_)
    given = {"known_map.path": path, "known_map.start": options.known_start}
    return settings_of(options, {**given, "loops.source": "keyframes"} if options.explore else given)


def settings_of(options: SettingsOptions, given: Mapping[str, str | None]) -> Config:
    """The configuration of the options. Given values that are not None override its file. Raises ConfigError.

    Without a name for it, the odometry is the one that `Localizer`, `run` and `wheelsight run` choose: a robot without
    wheels or without a mounted camera is refused. Dense odometry keeps up beside control: on two cores 14.3 to 14.5 of
    15 frames a second were localized beside a control loop at 20 Hz (`python -m benchmarks.navigation_speed`).
    """
    import yaml

    from wheelsight.config import load_config
    from wheelsight.estimation.odometry_choice import odometry_of_robot

    changes = {}
    for text in options.set_ or ():
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise ConfigError(f"--set is {text!r}", fix="NAME=VALUE, such as navigation.limits.forward_m_s=0.5")
        try:
            changes[name.strip()] = yaml.safe_load(value)
        except yaml.YAMLError:
            changes[name.strip()] = value
    given = {**given, "profile": options.profile}
    overrides = {name: value for name, value in given.items() if value is not None} | changes
    config = load_config(options.config, overrides, called=_CALLED | {name: f"--set {name}" for name in changes})
    return config if config.odometry else config.with_odometry(odometry_of_robot(config))


def goals_of(options: DriveOptions) -> list[NamedGoal]:
    """The goals of --to. Raises ConfigError, MapError."""
    from wheelsight.app.run.drives import NamedGoal

    if options.map_ is None:
        return []
    words = options.to or ()
    with _opened(options.map_) as folder:
        poses = poses_of(words, folder) if words else []
    return [NamedGoal.of(pose, "" if "," in word else word) for word, pose in zip(words, poses, strict=True)]


def way_of(options: DriveOptions) -> FloatArray | None:
    """(N, 3) of --follow; None without it. Raises as `read_way`, and MapError."""
    from wheelsight.app.cli.console import print_warning
    from wheelsight.app.run.drives import read_way

    if options.map_ is None or options.follow is None:
        return None
    with _opened(options.map_) as folder:
        return read_way(options.follow, folder.calibration, print_warning)


def _opened(path: Path) -> closing[MapFolder]:
    """The open map of --map. Raises MapError."""
    from wheelsight.slam.maps import MapFolder, find_map

    return closing(MapFolder.open(find_map(path)))


_QUESTION = "Is the floor around the robot free, and is somebody at the stop button?"
# The paper's format is recognised within 3 s, the framed protocol at its first frame.
_HEARD_WITHIN_S, _LOOK_S, _WAIT_S = 3.5, 0.02, 0.1
_SIMULATED_CAMERA = "kinect-v1"


@contextmanager
def robot_of(options: RobotOptions, config: Config) -> Iterator[Robot]:
    """The robot, closed at the end; a real one after the user has confirmed that it may move.

    Raises ConfigError, CalibrationError, DeviceError; Exit where it may not.
    """
    with _simulator(options, config) if options.is_simulated else _linked(options, config) as robot:
        yield robot


def robot_words(options: RobotOptions) -> str:
    """Description of the robot, for records."""
    if options.robot is not None:
        return f"a robot at {options.robot}"
    people = f", {options.people} people" if options.people else ""
    hardware = f", through the firmware of the {options.hardware}" if options.hardware else ""
    return f"simulated in {options.sim}, seed {options.seed}, day {options.day}, {options.realism}{people}{hardware}"


def _simulator(options: RobotOptions, config: Config) -> Robot:
    from wheelsight.core.calibration import load_calibration
    from wheelsight_sim.simulator import Simulator

    settings, start = _simulated(options)
    drive = None
    if (path := options.drive_model) is not None and (drive := load_calibration(path).drive_model) is None:
        raise CalibrationError("has no drive_model", path=path, fix="wheelsight calibrate drive RECORDING --out FILE")
    # The identified robot may be another one: only its answers to commands count here.
    drive = None if drive is None else replace(drive, track_width_m=0.0)
    how: dict[str, Any] = {"start": start, "limits": config.navigation.limits, "drive": drive}
    if options.hardware is None:
        robot = Simulator(settings, **how)
    else:
        robot = _hardware().HardwareRobot(options.hardware, settings, **how)
    for warning in robot.world.warnings:
        print_warning(warning)
    return robot


def _hardware() -> ModuleType:
    """The module of robots with the firmware in their loop. Raises ConfigError without the firmware's folder."""
    try:
        from firmware.simulation import hardware_robot
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("firmware"):
            raise
        raise ConfigError(
            "--hardware needs the firmware's sources, which are not installed with wheelsight",
            fix="git clone wheelsight, and in its folder: python -m wheelsight drive",
        ) from error
    return hardware_robot


def _simulated(options: RobotOptions) -> tuple[SimulationSettings, tuple[float, float, float] | None]:
    """The settings of the simulation, and where the robot starts. Raises ConfigError."""
    from wheelsight.app.cli.simulate import size_of
    from wheelsight.core.runtime import needed
    from wheelsight_sim import FloorPlan, SimulationSettings, world_names

    needed("mujoco")
    assert options.sim is not None
    camera = options.camera or _SIMULATED_CAMERA
    if not 0 <= options.people <= 100:
        raise ConfigError(f"--people is {options.people}", fix="0 to 100")
    # A world by its name, else the file of a floor plan
    sim = options.sim
    if sim not in world_names():
        if not Path(sim).is_file():
            worlds = ", ".join(world_names())
            raise ConfigError(f"--sim is {sim!r}, no world and no file", fix=f"{worlds}, or the file of a floor plan")
        where: dict[str, Any] = {"plan": FloorPlan(sim, options.resolution)}
    elif options.resolution is not None:
        raise ConfigError("--resolution means nothing without a plan", fix="--sim flat.png --resolution 0.05")
    else:
        where = {"world": sim}
    how: dict[str, Any] = {"seed": options.seed, "day": options.day, "passersby": options.people}
    how |= {"realism": options.realism, "rate_hz": options.rate, "camera": camera}
    settings = SimulationSettings(**where, **how, size=size_of(options.size, camera))
    return settings, None if options.start is None else start_of("--start", options.start)


def start_of(option: str, text: str) -> tuple[float, float, float]:
    """x, y and yaw of a start, metres and radians. Raises ConfigError naming the option."""
    from wheelsight.app.cli.map_contents import pose_of

    x_m, y_m, yaw = pose_of(option, text).tolist()
    if math.isnan(yaw):
        raise ConfigError(f"{option} is {text!r}", fix="X,Y,YAW_DEG in metres and degrees, such as 3.2,1.5,90")
    return x_m, y_m, yaw


@contextmanager
def _linked(options: RobotOptions, config: Config) -> Iterator[Robot]:
    from wheelsight.app.cli.options import robot_camera
    from wheelsight.io.devices import LinkRobot, WheelLink
    from wheelsight.io.devices.cameras import ANY

    assert options.robot is not None
    assert options.calibration is not None
    with ExitStack() as opened:
        frames, calibration = robot_camera(options.camera or ANY, config.camera, [options.calibration])
        opened.callback(frames.close)
        # Refuse a calibration without the robot's geometry
        if calibration.holonomic is not None:
            raise CalibrationError(
                calibration.lacks_two_wheels, path=options.calibration, fix="wheelsight run localizes such a base"
            )
        if calibration.wheels is None:
            raise CalibrationError(
                "has no wheels", path=options.calibration, fix="wheelsight calibrate wheels finds their sizes"
            )
        if calibration.T_base_camera is None:
            fix = "wheelsight calibrate base finds where the camera sits"
            raise CalibrationError("has no T_base_camera", path=options.calibration, fix=fix)
        for warning in frames.warnings:
            print_warning(warning)
        link = WheelLink(options.robot, options.baud)
        opened.callback(link.close)
        robot = opened.enter_context(LinkRobot(link, calibration, config.navigation.limits, frames=frames))
        # The firmware must stop the motors in time.
        ends_s = time.monotonic() + _HEARD_WITHIN_S
        while link.report().format is None and time.monotonic() < ends_s:
            time.sleep(_LOOK_S)
        robot.check_firmware()
        # Asked as late as can be: what can go wrong before anything moves has not.
        if not (options.yes or typer.confirm(_QUESTION)):
            typer.echo("nothing moved", err=True)
            raise typer.Exit(1)
        yield robot


def poses_of(words: Sequence[str], folder: MapFolder) -> list[FloatArray]:
    """Poses (3,) of goals: names of places, names of areas, or coordinates.

    A yaw of NaN is any heading. A name that a place and an area have is the place's; of an area it is where there is
    most room.

    Raises:
        ConfigError: coordinates that are none.
        MapError: an unknown name (with the nearest name and all names), or an area without free floor.
    """
    import numpy as np

    from wheelsight.app.cli.map_contents import grid_of, names_of, pose_of
    from wheelsight.mapping import roomiest_place
    from wheelsight.mapping.named_poses import unknown_name
    from wheelsight.slam.maps.contents import current_edits

    names, edits = names_of(folder), current_edits(folder)
    areas = {area.name: area for area in edits.areas}
    # Made once, and only where an area is asked for: it takes seconds.
    grid = cache(partial(grid_of, folder))
    poses = []
    for word in words:
        if word in names.names:
            poses.append(names.named(word).pose_now(folder.store.T_map_keyframe))
        elif word in areas:
            area = areas[word]
            at = roomiest_place(grid(), area.polygon_now(folder.store.T_map_keyframe))
            if at is None:
                fix = (
                    f"wheelsight map zone MAP --area '{area.name}' X,Y X,Y X,Y redraws it; "
                    "wheelsight map export MAP --picture plan.png shows where the map has free floor"
                )
                raise MapError(f"no free floor of the map lies in the area {area.name!r}", path=folder.path, fix=fix)
            poses.append(np.array([*at, np.nan]))
        elif "," in word:
            poses.append(pose_of("--to", word))
        else:
            raise unknown_name(word, {*names.names, *edits.area_names})
    return poses
