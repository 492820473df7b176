"""What the words of `wheelsight simulate`'s options mean."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.cli._simulation_options import SimulateOptions
    from wheelsight.simulation import FloorPlan, Robot, SimulationSettings, WheelFaults

_TIMES_FORM = "FROM:TO in seconds, such as 12:15.5"
_START_FORM = "X,Y,YAW_DEG in metres and degrees, such as 4,2.5,90"
_PATCH_FORM = "X,Y,R in metres, such as 4,2.5,0.6"


def settings_from(given: SimulateOptions, plan: FloorPlan | None) -> SimulationSettings:
    """The settings that the options tell. Raises ConfigError naming the option whose words mean nothing."""
    from wheelsight.simulation import SimulationSettings

    building: dict[str, Any] = {"world": given.world} if plan is None else {"plan": plan}
    # What it is called is checked by the settings, which name what there is.
    named: dict[str, Any] = {"realism": given.realism, "base": given.base}
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
        robot=_robot(given),
        faults=_faults(given),
        covered_s=times_of("--cover", given.cover),
    )


def _robot(given: SimulateOptions) -> Robot:
    from wheelsight.simulation import Robot

    told = {"left_radius_m": given.left_radius, "right_radius_m": given.right_radius, "track_width_m": given.track}
    if given.base != "differential" and any(size_m is not None for size_m in told.values()):
        fix = "--left-radius, --right-radius and --track are of two wheels: leave them out"
        raise ConfigError(f"--base {given.base} has no such wheels", fix=fix)
    sizes: dict[str, Any] = {name: size_m for name, size_m in told.items() if size_m is not None}
    return Robot(**sizes, has_gyro=given.gyro)


def _faults(given: SimulateOptions) -> WheelFaults:
    from wheelsight.simulation import Patch, WheelFaults

    return WheelFaults(
        dropouts_s=times_of("--dropout", given.dropout),
        unplugged_s=times_of("--unplug", given.unplug),
        patches=tuple(Patch(*patch) for patch in patches_of("--ice", given.ice)),
        lifted_s=times_of("--lift", given.lift),
    )


def plan_of(given: SimulateOptions) -> FloorPlan | None:
    """The floor plan that the options tell, if any. Raises ConfigError for options that mean nothing together."""
    from wheelsight.simulation import FloorPlan

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
