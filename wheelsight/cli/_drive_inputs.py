"""What the words of `wheelsight drive`'s options mean."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.config import Config
    from wheelsight.pipeline.drives import Goal

_CALLED = {"profile": "--profile", "known_map.path": "--map", "known_map.start": "--known-start"}


@dataclass(frozen=True, slots=True)
class Asked:
    """The options of every drive."""

    map_path: Path | None
    to: tuple[str, ...]
    back: bool
    explore: bool
    known_start: str | None
    out: Path | None
    force: bool
    config: Path | None
    profile: str | None
    settings: tuple[str, ...]
    rerun: str | None = None


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
    camera: str


def check(asked: Asked, simulated: Simulated, real: Real) -> None:
    """Raises ConfigError for options that mean nothing together."""
    _check_one(simulated, real)
    _check_task(asked)
    _check_options(simulated, real)


def check_robot(simulated: Simulated, real: Real) -> None:
    """The same of those that name a robot."""
    _check_one(simulated, real)
    _check_options(simulated, real)


def _check_one(simulated: Simulated, real: Real) -> None:
    if (simulated.sim is None) == (real.port is None):
        problem = "no robot is named" if real.port is None else "a robot is either simulated or real"
        raise ConfigError(problem, fix="one of --sim WORLD and --robot PORT")


def _check_options(simulated: Simulated, real: Real) -> None:
    if real.port is None and (real.calibration is not None or real.yes):
        option = "--yes" if real.calibration is None else "--calibration"
        raise ConfigError(f"{option} is of a real robot", fix="--robot PORT, or leave it out")
    if real.port is not None:
        if real.calibration is None:
            raise ConfigError("--robot needs to know how the robot is built", fix="--calibration FILE")
        if simulated.start is not None:
            raise ConfigError("--start is of a simulated robot", fix="--known-start X,Y,YAW_DEG")


def _check_task(asked: Asked) -> None:
    if asked.explore:
        if asked.map_path is not None or asked.to:
            raise ConfigError("--explore begins without a map and goals", fix="no --map and no --to; those come next")
        if asked.out is None:
            raise ConfigError("--explore leaves a map", fix="--out DIR")
    elif asked.map_path is None:
        raise ConfigError("there is no map to drive in", fix="--map DIR, of a run with --map surfels; or --explore")
    elif not asked.to:
        raise ConfigError("there is no goal", fix="--to NAME, or --to X,Y,YAW_DEG")


def settings_of(asked: Asked) -> Config:
    """The configuration of the drive. Raises ConfigError."""
    from wheelsight.config import is_named, load_config

    changes = dict(_setting(text) for text in asked.settings)
    path = None if asked.map_path is None else str(asked.map_path)
    given: dict[str, Any] = {"known_map.path": path, "known_map.start": asked.known_start, "profile": asked.profile}
    if asked.explore:
        given["loops.source"] = "keyframes"
    if not is_named("odometry", asked.config):
        given["odometry"] = "wheels,dense"
    overrides = {name: value for name, value in given.items() if value is not None} | changes
    return load_config(asked.config, overrides, called=_CALLED | {name: f"--set {name}" for name in changes})


def goals_of(asked: Asked) -> list[Goal]:
    """All of --to. Raises ConfigError, MapError: before anything moves."""
    from wheelsight.cli._map_names import goal_of
    from wheelsight.pipeline.drives import Goal
    from wheelsight.slam.sessions import MapFolder, find_map

    if asked.map_path is None:
        return []
    folder = MapFolder.open(find_map(asked.map_path))
    try:
        return [Goal.of(goal_of(word, folder), "" if "," in word else word) for word in asked.to]
    finally:
        folder.close()


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
