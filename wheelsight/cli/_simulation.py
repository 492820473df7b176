"""The options of `wheelsight simulate`, and what their words mean."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.simulation import SimulationSettings

_ROBOT, _FAULTS = "The true robot", "Faults"
_TIMES_FORM = "FROM:TO in seconds, such as 12:15.5"
_PATCH_FORM = "X,Y,R in metres, such as 4,2.5,0.6"

World = Annotated[
    str | None, typer.Argument(metavar="WORLD", help="What to drive through; see --list.", show_default=False)
]
Out = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder of the recording; made if need be.", show_default=False)
]
ShowList = Annotated[bool, typer.Option("--list", help="Show all worlds and cameras, and exit.")]
Laps = Annotated[int, typer.Option(help="How often the world's route is driven.")]
Camera = Annotated[str, typer.Option(metavar="NAME", help="Which camera to carry; see --list.")]
Size = Annotated[
    str, typer.Option(metavar="WxH|half|full", help="Size of the images in pixels, or by the camera's own.")
]
Rate = Annotated[float | None, typer.Option(metavar="HZ", help="Images a second.", show_default="the camera's own")]
Seed = Annotated[int, typer.Option(help="Of everything random; the same seed makes the same bytes.")]
Speed = Annotated[float, typer.Option(metavar="M/S", help="Speed on straights, up to 1.2 m/s.")]
Duration = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="Stop after so long.", show_default="the whole route")
]
Reverse = Annotated[bool, typer.Option("--reverse", help="Drive the route from its end to its start.")]
DriveFile = Annotated[
    Path | None,
    typer.Option("--drive", metavar="CSV", help="Velocities to drive in place of the route.", show_default=False),
]
StopAndTurn = Annotated[
    bool, typer.Option("--stop-and-turn", help="Stop at each waypoint and turn on the spot, as UMBmark asks.")
]
PassersBy = Annotated[int, typer.Option("--passers-by", metavar="N", help="How many people walk about.")]
MotionBlur = Annotated[bool, typer.Option("--motion-blur", help="Smear colour by the motion during exposure.")]
Gyro = Annotated[bool, typer.Option("--gyro", help="Carry a gyroscope; DIR gets gyro.csv.")]
LeftRadius = Annotated[
    float | None,
    typer.Option(metavar="M", help="Of the left wheel.", show_default="0.17", rich_help_panel=_ROBOT),
]
RightRadius = Annotated[
    float | None,
    typer.Option(metavar="M", help="Of the right wheel.", show_default="0.17", rich_help_panel=_ROBOT),
]
Track = Annotated[
    float | None,
    typer.Option(metavar="M", help="Distance between the wheels.", show_default="0.52", rich_help_panel=_ROBOT),
]
NoSlip = Annotated[bool, typer.Option("--no-slip", help="Let wheels never slip.", rich_help_panel=_ROBOT)]
Dropout = Annotated[
    list[str] | None,
    typer.Option(metavar="FROM:TO", help="Seconds without wheel readings.", rich_help_panel=_FAULTS),
]
Unplug = Annotated[
    list[str] | None,
    typer.Option(metavar="FROM:TO", help="Seconds whose pulses are lost.", rich_help_panel=_FAULTS),
]
Ice = Annotated[
    list[str] | None,
    typer.Option(metavar="X,Y,R", help="A round patch of ice, in metres.", rich_help_panel=_FAULTS),
]
Lift = Annotated[
    list[str] | None,
    typer.Option(metavar="FROM:TO", help="Seconds with the left wheel in the air.", rich_help_panel=_FAULTS),
]
Cover = Annotated[
    list[str] | None,
    typer.Option(metavar="FROM:TO", help="Seconds with something lying on the camera.", rich_help_panel=_FAULTS),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite a recording in DIR.")]


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
    true_robot = Robot(**{name: value for name, value in robot.items() if value is not None})
    return SimulationSettings(**given, size=size_of(size, given["camera"]), robot=true_robot, faults=faults)


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


def frames_listed(folder: Path) -> int:
    """How many frames a recording that broke off holds."""
    path = folder / "depth.txt"
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    return sum(not line.startswith("#") for line in lines)


def _numbers(option: str, text: str, between: str, count: int, form: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in text.split(between))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{option} is {text!r}", fix=form)
    return numbers
