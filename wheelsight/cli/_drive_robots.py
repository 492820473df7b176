"""The robot that `wheelsight drive` leads: in the simulator, or at a serial port."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from wheelsight.cli._console import print_warning
from wheelsight.errors import CalibrationError, ConfigError

if TYPE_CHECKING:
    from wheelsight.calibration import Calibration
    from wheelsight.cli._drive_robot_options import RobotOptions
    from wheelsight.config import Config
    from wheelsight.devices import LinkRobot, WheelLink
    from wheelsight.robots import Robot
    from wheelsight.simulation import FloorPlan

_QUESTION = "Is the floor around the robot free, and is somebody at the stop button?"
# Pairs of the paper's format are recognised within 3 s; who speaks frames is known at the first one.
_HEARD_WITHIN_S, _LOOK_S = 3.5, 0.02
_SIMULATED_CAMERA = "kinect-v1"


@contextmanager
def robot_of(options: RobotOptions, config: Config) -> Iterator[Robot]:
    """The robot, closed at the end; a real one once somebody has said that it may move.

    Raises ConfigError, CalibrationError, DeviceError; Exit where it may not.
    """
    with _simulator(options, config) if options.is_simulated else _linked(options, config) as robot:
        yield robot


def robot_words(options: RobotOptions) -> str:
    """Which robot, for records."""
    if options.robot is not None:
        return f"a robot at {options.robot}"
    people = f", {options.people} people" if options.people else ""
    return f"simulated in {options.sim}, seed {options.seed}, day {options.day}, {options.realism}{people}"


def _simulator(options: RobotOptions, config: Config) -> Robot:
    from wheelsight.cli._simulation_inputs import size_of
    from wheelsight.extras import needed
    from wheelsight.simulation import SimulationSettings
    from wheelsight.simulation.simulator import Simulator

    needed("mujoco")
    assert options.sim is not None
    camera = options.camera or _SIMULATED_CAMERA
    if not 0 <= options.people <= 100:
        raise ConfigError(f"--people is {options.people}", fix="0 to 100")
    plan = _plan_of(options.sim, options.resolution)
    where: dict[str, Any] = {"world": options.sim} if plan is None else {"plan": plan}
    how: dict[str, Any] = {"seed": options.seed, "day": options.day, "passersby": options.people}
    how |= {"realism": options.realism, "rate_hz": options.rate, "camera": camera}
    settings = SimulationSettings(**where, **how, size=size_of(options.size, camera))
    start = _start_of(options.start)
    robot = Simulator(settings, start=start, limits=config.navigation.limits)
    for warning in robot.world.warnings:
        print_warning(warning)
    return robot


def _plan_of(sim: str, resolution: float | None) -> FloorPlan | None:
    """None where a world is named. Raises ConfigError for what is neither."""
    from wheelsight.simulation import FloorPlan, world_names

    if sim in world_names():
        if resolution is not None:
            raise ConfigError("--resolution means nothing without a plan", fix="--sim flat.png --resolution 0.05")
        return None
    if not Path(sim).is_file():
        worlds = ", ".join(world_names())
        raise ConfigError(f"--sim is {sim!r}, no world and no file", fix=f"{worlds}, or the file of a floor plan")
    return FloorPlan(sim, resolution)


def _start_of(text: str | None) -> tuple[float, float, float] | None:
    from wheelsight.cli._map_names import pose_of

    if text is None:
        return None
    x_m, y_m, yaw = pose_of("--start", text).tolist()
    if yaw != yaw:
        raise ConfigError(f"--start is {text!r}", fix="X,Y,YAW_DEG in metres and degrees, such as 3.2,1.5,90")
    return x_m, y_m, yaw


@contextmanager
def _linked(options: RobotOptions, config: Config) -> Iterator[Robot]:
    from wheelsight.devices import LinkRobot, WheelLink
    from wheelsight.devices.robot_camera import ANY, open_robot_camera

    assert options.robot is not None
    assert options.calibration is not None
    with ExitStack() as opened:
        frames, calibration = open_robot_camera(options.camera or ANY, config.camera, [options.calibration])
        opened.callback(frames.close)
        _check_mount(calibration, options.calibration)
        for warning in frames.warnings:
            print_warning(warning)
        link = WheelLink(options.robot, options.baud)
        opened.callback(link.close)
        robot = opened.enter_context(LinkRobot(link, calibration, config.navigation.limits, frames=frames))
        _check_firmware(robot, link)
        # Asked as late as can be: what can go wrong before anything moves has not.
        if not (options.yes or typer.confirm(_QUESTION)):
            typer.echo("nothing moved", err=True)
            raise typer.Exit(1)
        yield robot


def _check_firmware(robot: LinkRobot, link: WheelLink) -> None:
    """Refuse a controller that would stop its motors too late. Raises DeviceError."""
    ends_s = time.monotonic() + _HEARD_WITHIN_S
    while link.report().format is None and time.monotonic() < ends_s:
        time.sleep(_LOOK_S)
    robot.check_firmware()


def _check_mount(calibration: Calibration, path: Path) -> None:
    """Refuse a robot of which nobody knows how it is built. Raises CalibrationError."""
    if calibration.holonomic is not None:
        raise CalibrationError(calibration.lacks_two_wheels, path=path, fix="wheelsight run localizes such a base")
    if calibration.wheels is None:
        raise CalibrationError("has no wheels", path=path, fix="wheelsight calibrate wheels finds their sizes")
    if calibration.T_base_camera is None:
        fix = "wheelsight calibrate base finds where the camera sits"
        raise CalibrationError("has no T_base_camera", path=path, fix=fix)
