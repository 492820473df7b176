"""What the words of `wheelsight drive`'s and `serve`'s options mean."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.cli._drive_options import DriveOptions, SettingsOptions
    from wheelsight.cli._drive_robot_options import RobotOptions
    from wheelsight.config import Config
    from wheelsight.geometry import FloatArray
    from wheelsight.pipeline.drives import Goal
    from wheelsight.slam.sessions import MapFolder

_CALLED = {"profile": "--profile", "known_map.path": "--map", "known_map.start": "--known-start"}


def check(options: DriveOptions) -> None:
    """Raises ConfigError for options that mean nothing together."""
    _check_one(options)
    _check_task(options)
    _check_options(options)


def check_robot(options: RobotOptions) -> None:
    """The same of those that name a robot."""
    _check_one(options)
    _check_options(options)


def _check_one(options: RobotOptions) -> None:
    if (options.sim is None) == options.is_simulated:
        problem = "no robot is named" if options.is_simulated else "a robot is either simulated or real"
        raise ConfigError(problem, fix="one of --sim WORLD and --robot PORT")


def _check_options(options: RobotOptions) -> None:
    if options.is_simulated and (options.calibration is not None or options.yes):
        option = "--yes" if options.calibration is None else "--calibration"
        raise ConfigError(f"{option} is of a real robot", fix="--robot PORT, or leave it out")
    if not options.is_simulated:
        if options.calibration is None:
            raise ConfigError("--robot needs to know how the robot is built", fix="--calibration FILE")
        if options.start is not None:
            raise ConfigError("--start is of a simulated robot", fix="--known-start X,Y,YAW_DEG")


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
    elif options.follow is None and not options.to:
        raise ConfigError("there is no goal", fix="--to NAME, or --to X,Y,YAW_DEG; or --follow FILE")


def drive_settings(options: DriveOptions) -> Config:
    """The configuration of the drive. Raises ConfigError."""
    path = None if options.map_ is None else str(options.map_)
    given = {"known_map.path": path, "known_map.start": options.known_start}
    return settings_of(options, {**given, "loops.source": "keyframes"} if options.explore else given)


def settings_of(options: SettingsOptions, given: Mapping[str, str | None]) -> Config:
    """The configuration that options tell, and over its file what else is given and not None. Raises ConfigError.

    Without a name for it, the odometry is the one that `Localizer`, `run` and `wheelsight run` choose: a robot without
    wheels or without a mounted camera is refused. Dense odometry keeps up beside control: on two cores 14.3 to 14.5 of
    15 frames a second were localized beside a control loop at 20 Hz (`python -m benchmarks.navigation_speed`).
    """
    from wheelsight.config import load_config
    from wheelsight.localizer.choice import odometry_of_robot

    changes = dict(_setting(text) for text in options.set_ or ())
    given = {**given, "profile": options.profile}
    overrides = {name: value for name, value in given.items() if value is not None} | changes
    config = load_config(options.config, overrides, called=_CALLED | {name: f"--set {name}" for name in changes})
    return config if config.odometry else config.with_odometry(odometry_of_robot(config))


def goals_of(options: DriveOptions) -> list[Goal]:
    """All of --to. Raises ConfigError, MapError: before anything moves."""
    from wheelsight.cli._map_goals import poses_of
    from wheelsight.pipeline.drives import Goal

    if options.map_ is None:
        return []
    words = options.to or ()
    with _opened(options.map_) as folder:
        poses = poses_of(words, folder) if words else []
    return [Goal.of(pose, "" if "," in word else word) for word, pose in zip(words, poses, strict=True)]


def way_of(options: DriveOptions) -> FloatArray | None:
    """(N, 3) of --follow; None without it. Raises as `read_way`, and MapError: before anything moves."""
    from wheelsight.cli._console import print_warning
    from wheelsight.pipeline.recorded_ways import read_way

    if options.map_ is None or options.follow is None:
        return None
    with _opened(options.map_) as folder:
        return read_way(options.follow, folder.calibration, print_warning)


def _opened(path: Path) -> closing[MapFolder]:
    """A map of --map. Raises MapError."""
    from wheelsight.slam.sessions import MapFolder, find_map

    return closing(MapFolder.open(find_map(path)))


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
