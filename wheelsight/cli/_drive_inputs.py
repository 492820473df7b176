"""What the words of `wheelsight drive`'s options mean, and the robot that they name."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.config import Config
    from wheelsight.pipeline.drives import Goal
    from wheelsight.robots import Robot
    from wheelsight.simulation import FloorPlan

_CALLED = {"known_map.path": "--map", "known_map.start": "--known-start"}
QUESTION = "Is the floor around the robot free, and is somebody at the stop button?"


@dataclass(frozen=True, slots=True)
class Asked:
    """The options of every drive."""

    map_path: Path | None
    to: tuple[str, ...]
    back: bool
    known_start: str | None
    out: Path | None
    force: bool
    config: Path | None
    settings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Simulated:
    """Those of a simulated robot."""

    sim: str | None
    resolution: float | None
    start: str | None
    seed: int
    day: int
    people: int
    realism: str
    camera: str
    size: str
    rate: float


@dataclass(frozen=True, slots=True)
class Real:
    """Those of a real one."""

    port: str | None
    calibration: Path | None
    baud: int
    yes: bool


def check(asked: Asked, simulated: Simulated, real: Real) -> None:
    """Raises ConfigError for options that mean nothing together."""
    if (simulated.sim is None) == (real.port is None):
        problem = "no robot is named" if real.port is None else "a robot is either simulated or real"
        raise ConfigError(problem, fix="one of --sim WORLD and --robot PORT")
    if asked.map_path is None:
        raise ConfigError("there is no map to drive in", fix="--map DIR, of a run with --map surfels")
    if not asked.to:
        raise ConfigError("there is no goal", fix="--to NAME, or --to X,Y,YAW_DEG")
    if real.port is None and (real.calibration is not None or real.yes):
        option = "--yes" if real.calibration is None else "--calibration"
        raise ConfigError(f"{option} is of a real robot", fix="--robot PORT, or leave it out")
    if real.port is not None:
        if real.calibration is None:
            raise ConfigError("--robot needs to know how the robot is built", fix="--calibration FILE")
        if simulated.start is not None:
            raise ConfigError("--start is of a simulated robot", fix="--known-start X,Y,YAW_DEG")


def settings_of(asked: Asked) -> Config:
    """The configuration of the drive. Raises ConfigError."""
    from wheelsight.config import is_named, load_config

    changes = dict(_setting(text) for text in asked.settings)
    given: dict[str, Any] = {"known_map.path": str(asked.map_path), "known_map.start": asked.known_start}
    if not is_named("odometry", asked.config):
        given["odometry"] = "wheels,dense"
    overrides = {name: value for name, value in given.items() if value is not None} | changes
    return load_config(asked.config, overrides, called=_CALLED | {name: f"--set {name}" for name in changes})


def goals_of(asked: Asked) -> list[Goal]:
    """All of --to. Raises ConfigError, MapError: before anything moves."""
    from wheelsight.cli._map_names import goal_of
    from wheelsight.pipeline.drives import Goal
    from wheelsight.slam.sessions import MapFolder, find_map

    assert asked.map_path is not None
    folder = MapFolder.open(find_map(asked.map_path))
    try:
        return [Goal.of(goal_of(word, folder), "" if "," in word else word) for word in asked.to]
    finally:
        folder.close()


@contextmanager
def robot_of(simulated: Simulated, real: Real, config: Config) -> Iterator[Robot]:
    """The robot, closed at the end; a real one once somebody has said that it may move.

    Raises ConfigError, CalibrationError, DeviceError; Exit where it may not.
    """
    made = _simulator(simulated, config) if real.port is None else _linked(real, config)
    with made() as robot:
        yield robot


def robot_words(simulated: Simulated, real: Real) -> str:
    """Which robot, for records."""
    if real.port is not None:
        return f"a robot at {real.port}"
    people = f", {simulated.people} people" if simulated.people else ""
    return f"simulated in {simulated.sim}, seed {simulated.seed}, day {simulated.day}, {simulated.realism}{people}"


def _setting(text: str) -> tuple[str, Any]:
    """A name and its value, which is written as in YAML. Raises ConfigError."""
    import yaml

    name, equals, value = text.partition("=")
    try:
        found = yaml.safe_load(value)
    except yaml.YAMLError:
        found = value
    if not equals or not name.strip():
        raise ConfigError(f"--set is {text!r}", fix="NAME=VALUE, such as navigation.limits.forward_m_s=0.5")
    return name.strip(), found


def _simulator(simulated: Simulated, config: Config) -> Callable[[], Robot]:
    from wheelsight.cli._simulation_inputs import size_of
    from wheelsight.extras import needed
    from wheelsight.simulation import SimulationSettings
    from wheelsight.simulation.simulator import Simulator

    needed("mujoco")
    assert simulated.sim is not None
    if not 0 <= simulated.people <= 100:
        raise ConfigError(f"--people is {simulated.people}", fix="0 to 100")
    plan = _plan_of(simulated.sim, simulated.resolution)
    where: dict[str, Any] = {"world": simulated.sim} if plan is None else {"plan": plan}
    how: dict[str, Any] = {"seed": simulated.seed, "day": simulated.day, "passersby": simulated.people}
    how |= {"realism": simulated.realism, "rate_hz": simulated.rate, "camera": simulated.camera}
    settings = SimulationSettings(**where, **how, size=size_of(simulated.size, simulated.camera))
    start = _start_of(simulated.start)
    return lambda: Simulator(settings, start=start, limits=config.navigation.limits)


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


def _linked(real: Real, config: Config) -> Callable[[], Robot]:
    from wheelsight.calibration import load_calibration
    from wheelsight.devices import LinkRobot, WheelLink
    from wheelsight.devices.cameras import open_live_camera

    assert real.port is not None
    assert real.calibration is not None
    calibration, frames = load_calibration(real.calibration), open_live_camera()
    try:
        link = WheelLink(real.port, real.baud)
    except BaseException:
        frames.close()
        raise
    # Asked as late as can be: what can go wrong before anything moves has not.
    if not (real.yes or typer.confirm(QUESTION)):
        link.close()
        frames.close()
        typer.echo("nothing moved", err=True)
        raise typer.Exit(1)
    return lambda: LinkRobot(link, calibration, config.navigation.limits, frames=frames)
