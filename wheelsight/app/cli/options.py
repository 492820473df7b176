"""Options that several commands share, the recordings that they open, and checks of output paths."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

if TYPE_CHECKING:
    from wheelsight.config import Config
    from wheelsight.core.calibration import Calibration
    from wheelsight.core.files import StrPath
    from wheelsight.core.settings import LiveCameraSettings
    from wheelsight.io.devices.live_camera import LiveCamera
    from wheelsight.io.recordings import Recording
    from wheelsight_ros2 import Bridge, LinkSettings


# Panels of the help that several commands have.
INPUT, OUTPUT, SETTINGS = "Input", "Output", "Settings"

SET_BY: dict[str, str] = {"known_map.start": "--start"}
"""The option that sets a setting, by its dotted name."""


def option(
    text: str, metavar: str | None = None, shown: str | bool = True, panel: str | None = None, **details: Any
) -> Any:
    """Return a `typer.Option`.

    Args:
        text: its help.
        metavar: what its value is called.
        shown: what the help shows as its default; True: the default itself.
        panel: of the help.
        details: `flag`, and others as of `typer.Option`, such as min and max.
    """
    flags = [details.pop("flag")] if "flag" in details else []
    return typer.Option(*flags, metavar=metavar, help=text, show_default=shown, rich_help_panel=panel, **details)


def option_field(
    text: str,
    metavar: str | None = None,
    shown: str | bool = True,
    panel: str | None = None,
    *,
    default: Any = None,
    setting: str = "",
    **details: Any,
) -> Any:
    """Return a dataclass field that `takes` makes an `option` of, named as the field where `details` have no flag.

    `setting` is the dotted name of the setting of `Config` that it sets.
    """

    def named(flag: str) -> Any:
        how = {"flag": flag, **details}
        if setting:
            return setting_option(setting, how.pop("flag"), text, metavar, shown, panel, **how)
        return option(text, metavar, shown, panel, **how)

    return field(default=default, metadata={"option": named, "setting": setting})


def setting_option(name: str, flag: str, text: str, *how: Any, **details: Any) -> Any:
    """Return an `option` that sets a setting of `Config`, by its dotted name."""
    SET_BY[name] = flag.partition("/")[0]
    return option(text, *how, flag=flag, **details)


RecordingPath = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING",
        help="Folder of the recording, or a ROS bag; [bold]sample[/bold] is one that comes along.",
        show_default=False,
    ),
]
Camera = Annotated[
    str | None,
    setting_option(
        "recording.camera",
        "--camera",
        "Calibration to use: the name of a shipped one, such as freiburg1, or a calibration.yaml.",
        "NAME|FILE",
        "what the recording itself says",
        INPUT,
    ),
]
CalibrationFile = Annotated[
    list[str] | None,
    setting_option(
        "recording.calibration",
        "--calibration",
        "calibration.yaml whose parts (cameras, mount, wheels, gyro) stand in place of the recording's; what it "
        "leaves out stays. May be given again: each is laid over those before.",
        "FILE",
        False,
        INPUT,
    ),
]
DepthFactor = Annotated[
    float | None,
    setting_option(
        "recording.depth_factor",
        "--depth-factor",
        "Depth units a metre in the depth images.",
        shown="as its format says",
        panel=INPUT,
    ),
]
MaxGap = Annotated[
    float | None,
    setting_option(
        "recording.max_gap_s",
        "--max-gap",
        "Largest distance in time of a colour and a depth image.",
        "SECONDS",
        "0.02",
        INPUT,
    ),
]
RateHz = Annotated[
    float | None,
    setting_option(
        "recording.rate_hz",
        "--rate-hz",
        "How many a second the images' stamps count: 30 for numbers of a 30 Hz camera, 1000 for milliseconds.",
        "HZ",
        "stamps are seconds",
        INPUT,
    ),
]
Topics = Annotated[
    list[str] | None,
    setting_option(
        "recording.topics",
        "--topic",
        "Of a bag: which topic is color, depth, color_info, depth_info, wheels, gyro or truth; none leaves one "
        "out. May be given again. Joints, fields, places or frames of wheels: wheels=/joints:left,right, "
        "wheels=/ticks:2,3, wheels=/tf:odom,base_link; a topic each: wheels=/lwheel,/rwheel.",
        "ROLE=TOPIC",
        "by type, frame and name",
        INPUT,
    ),
]
Profile = Annotated[
    str | None,
    setting_option(
        "profile",
        "--profile",
        "Settings for one kind of computer: pi, for a small one. --config and other options win over it; "
        "wheelsight config --profile pi shows them.",
        "NAME",
        "none",
        SETTINGS,
    ),
]


def settings_from(options: Mapping[str, object], file: Path | None = None, *, drop_removed: bool = False) -> Config:
    """The configuration of a file, and over it the options that were given (are not None). Raises ConfigError.

    Args:
        options: values by the dotted names of their settings.
        file: settings in YAML, or None.
        drop_removed: as of `load_config`.
    """
    from wheelsight.config import load_config

    overrides = {name: value for name, value in options.items() if value not in (None, [])}
    return load_config(file, overrides, SET_BY, drop_removed=drop_removed)


def open_source(folder: Path, settings: Config) -> Recording:
    """The recording in a folder, or the sample, read as the settings say. Raises InputError."""
    from wheelsight.app.cli.console import print_note
    from wheelsight.io.recordings import SAMPLE_NAME, open_recording

    if folder == Path(SAMPLE_NAME) and folder.exists():
        print_note(f"{folder} is the one in the current folder, not the recording that comes with wheelsight")

    return open_recording(folder, settings.recording)


Rerun = Annotated[
    str | None,
    option(
        "Show the run in Rerun as it goes: written to a file, or in a viewer that is started here.",
        "FILE.rrd|spawn",
        "not shown",
        OUTPUT,
        flag="--rerun",
    ),
]

_LINKS = "Other programs"
Foxglove = Annotated[
    str | None,
    option(
        "Serve Foxglove at this port, behind a token that is printed with the address; an address other than this "
        "computer's alone only if it is named.",
        "[ADDRESS:]PORT",
        "not served",
        _LINKS,
        flag="--foxglove",
    ),
]
LinkToken = Annotated[
    str | None,
    option("What Foxglove's address must hold; 16 letters and digits at least.", "TEXT", "a new one", _LINKS),
]
Ros2 = Annotated[str | None, option("Be a node of ROS 2, over dds or zenoh.", "NAME", "none", _LINKS, flag="--ros2")]
Domain = Annotated[int, option("Of ROS 2, 0 to 232.", "N", panel=_LINKS, min=0, max=232)]
Namespace = Annotated[str, option("Before all topics of ROS 2, such as /chair.", "NAME", "none", _LINKS)]
Interface = Annotated[
    str | None,
    option(
        "Network of dds, by its name or address, or address of zenoh's router. Each computer there can move the robot.",
        "NAME|ADDRESS",
        "this computer alone",
        _LINKS,
    ),
]


@dataclass(frozen=True)
class LinkOptions:
    """Options of live interfaces."""

    foxglove: Foxglove = None
    link_token: LinkToken = None
    ros2: Ros2 = None
    domain: Domain = 0
    namespace: Namespace = ""
    interface: Interface = None


class _Linked(Protocol):
    """What has the fields of `LinkOptions`."""

    @property
    def foxglove(self) -> str | None: ...
    @property
    def link_token(self) -> str | None: ...
    @property
    def ros2(self) -> str | None: ...
    @property
    def domain(self) -> int: ...
    @property
    def namespace(self) -> str: ...
    @property
    def interface(self) -> str | None: ...


def link_settings(options: _Linked) -> LinkSettings | None:
    """The checked interfaces; None without any. Raises ConfigError."""
    given = (options.foxglove, options.link_token, options.ros2, options.domain, options.namespace, options.interface)
    if not any(one is not None and one != "" and one != 0 for one in given):
        return None
    from wheelsight_ros2 import LinkSettings

    settings = LinkSettings(*given)
    settings.check()
    return settings


@contextmanager
def linked(
    settings: LinkSettings | None,
    calibration: Calibration,
    config: Config,
    robot_s: Callable[[], float],
    on_problem: Callable[[str], None],
    *,
    is_simulated: bool,
) -> Iterator[Bridge | None]:
    """The bridge to other programs for the block; None without any. Raises ConfigError."""
    if settings is None:
        yield None
        return
    from wheelsight_ros2 import open_bridge

    how: dict[str, Any] = {"is_simulated": is_simulated, "robot_s": robot_s, "navigation": config.navigation}
    with open_bridge(settings, calibration, **how, on_problem=on_problem, on_note=typer.echo) as bridge:
        yield bridge


def robot_camera(
    which: str, settings: LiveCameraSettings, files: Sequence[StrPath] = (), known: Calibration | None = None
) -> tuple[LiveCamera, Calibration]:
    """As `open_robot_camera`, also of topics of ROS 2. Raises as that."""
    from wheelsight.io.devices.cameras import LIVE_CAMERAS, open_robot_camera

    if which.partition(":")[0] == "ros2":
        from wheelsight_ros2.sensors import open_ros2_camera

        LIVE_CAMERAS["ros2"] = open_ros2_camera
    return open_robot_camera(which, settings, files, known)


def can_draw() -> bool:
    """Whether a page can be drawn; else it warns that all but the page is written."""
    from wheelsight.app.cli.console import print_warning
    from wheelsight_report import why_no_page

    why = why_no_page()
    if why is not None:
        print_warning(f"no page is drawn: {why}")
    return why is None


def check_out(out: Path, force: bool | None, option: str = "--out") -> None:
    """Check an output before any work. Raises OutputError if it cannot or must not be written.

    `force` is None where the command has none; `option` is what names the file.
    """
    from wheelsight.core.errors import OutputError
    from wheelsight.core.files import check_name, make_output_folder

    check_name(out)
    if out.is_dir():
        raise OutputError("is a folder, not a file", path=out, fix=f"choose another {option}")
    if out.exists() and not force:
        fix = f"choose another {option}" + ("" if force is None else ", or add --force to overwrite")
        raise OutputError("is there already", path=out, fix=fix)
    make_output_folder(out.parent, force=True)


def check_rerun(target: str | None, force: bool | None = None) -> None:
    """Raises ConfigError, before any work, where Rerun is asked for and missing; of a file as `check_out`."""
    from wheelsight.core.runtime import needed

    if target is None:
        return
    needed("rerun")
    from wheelsight_export import is_file

    if is_file(target):
        check_out(Path(target), force, "--rerun")
