"""What the words of `wheelsight simulate`'s options mean."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.simulation import FloorPlan, SimulationSettings

_TIMES_FORM = "FROM:TO in seconds, such as 12:15.5"
_START_FORM = "X,Y,YAW_DEG in metres and degrees, such as 4,2.5,90"
_PATCH_FORM = "X,Y,R in metres, such as 4,2.5,0.6"


def settings_from(
    given: dict[str, Any],
    *,
    size: str,
    robot: dict[str, Any],
    times: dict[str, list[str] | None],
    ice: list[str] | None,
) -> SimulationSettings:
    """The settings that the options tell. Raises ConfigError naming the option whose words mean nothing."""
    from wheelsight.simulation import Patch, Robot, SimulationSettings, WheelFaults

    faults = WheelFaults(
        dropouts_s=times_of("--dropout", times["--dropout"]),
        unplugged_s=times_of("--unplug", times["--unplug"]),
        patches=tuple(Patch(*patch) for patch in patches_of("--ice", ice)),
        lifted_s=times_of("--lift", times["--lift"]),
    )
    covered_s = times_of("--cover", times["--cover"])
    image_px = size_of(size, given["camera"])
    true_robot = Robot(**{name: value for name, value in robot.items() if value is not None})
    return SimulationSettings(**given, size=image_px, robot=true_robot, faults=faults, covered_s=covered_s)


def plan_of(
    world: str | None,
    path: Path | None,
    *,
    resolution: float | None,
    areas: Path | None,
    start: str | None,
    way: float | None,
) -> FloorPlan | None:
    """The floor plan that the options tell, if any. Raises ConfigError for options that mean nothing together."""
    from wheelsight.simulation import FloorPlan

    if path is None:
        given = {"--resolution": resolution, "--areas": areas, "--start": start, "--way": way}
        for option, value in given.items():
            if value is not None:
                raise ConfigError(f"{option} means nothing without a plan", fix="--plan map.yaml")
        return None
    if world is not None:
        raise ConfigError(f"both the world {world} and a plan are given", fix="leave one of them out")
    pose = None
    if start is not None:
        x_m, y_m, yaw_deg = _numbers("--start", start, ",", 3, _START_FORM)
        pose = x_m, y_m, math.radians(yaw_deg)
    return FloorPlan(path, resolution, areas, pose, way)


def size_of(text: str, camera: str) -> tuple[int, int] | None:
    """Width and height of "320x240", None for "full", half of the camera's for "half". Raises ConfigError."""
    from wheelsight.simulation import camera_model

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
