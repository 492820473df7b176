"""`Recording`, the interface of every format, `Reader`, which opens one, and the options and settings of opening.
Readers choose the calibration and the body of the ground truth here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

from pydantic import BeforeValidator, PlainSerializer

from wheelsight.core.calibration import Calibration, load_calibration
from wheelsight.core.errors import CalibrationError, ConfigError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.inputs import is_there
from wheelsight.core.messages import Event, Match, RgbdFrame, SkippedFrame, SpeedVariances
from wheelsight.core.robots import EventSource
from wheelsight.core.settings import ASKED, CHOSEN, Settings, setting
from wheelsight.core.trajectory import Trajectory


@runtime_checkable
class Recording(EventSource, Protocol):
    """A finished recording: an `EventSource` that ends, with its counts and ground truth."""

    @property
    def path(self) -> Path:
        """The folder or file of the recording."""

    @property
    def format(self) -> str:
        """The reader's name in the registry."""

    @property
    def body(self) -> str:
        """The frame its trajectory describes: "base" where the calibration has T_base_camera, else "camera"."""

    @property
    def frame_count(self) -> int:
        """The number of RGB-D frames that `events()` yields, skipped ones included."""

    @property
    def wheel_count(self) -> int:
        """The number of wheel readings that `events()` yields."""

    @property
    def association(self) -> AssociationReport:
        """How colour and depth were paired."""

    @property
    def ground_truth(self) -> Trajectory | None:
        """T_frame_body of `body`, or None."""

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """The events in order of time, from the start at each call. Images are decoded during iteration.

        Without `images`, frames are left out and no image is decoded.
        """


@dataclass(frozen=True, slots=True)
class AssociationReport:
    """How colour images were paired with depth images: counts and gaps.

    Attributes:
        max_gap_s: the largest gap that is allowed.
        largest_gap_s: the largest gap of a pair.
    """

    color_images: int
    depth_images: int
    pairs: int
    max_gap_s: float
    largest_gap_s: float = 0.0

    @property
    def dropped_color(self) -> int:
        """Colour images without a depth image near enough."""
        return self.color_images - self.pairs

    @property
    def dropped_depth(self) -> int:
        """Depth images without a colour image near enough."""
        return self.depth_images - self.pairs

    @property
    def unpaired(self) -> int:
        """Frames lost because their images have no partner, by the sensor with fewer images."""
        return max(min(self.color_images, self.depth_images) - self.pairs, 0)


@dataclass(frozen=True, slots=True, eq=False)
class ListedFrame:
    """A frame that is not decoded yet.

    Attributes:
        stamp_s: its time.
        next_stamp_s: the time of the next frame; infinite for the last.
        read: decodes it.
    """

    stamp_s: float
    next_stamp_s: float
    read: Callable[[], RgbdFrame | SkippedFrame]


@runtime_checkable
class ListsFrames(Protocol):
    """A recording that lists frames before it decodes them, so that a caller can skip some."""

    def listed(self) -> Iterator[Event | ListedFrame]:
        """The items of `events()` in the same order, with undecoded frames."""


@runtime_checkable
class GivesMatches(Protocol):
    """A recording with matches of places from an external source, or with variances of its odometry's speeds."""

    @property
    def matches(self) -> Sequence[Match]:
        """Matches in any order; may be empty."""

    @property
    def speed_variances(self) -> SpeedVariances | None:
        """The variances that the recording states, or None."""


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic of a bag.

    Attributes:
        name: such as /camera/color/image_raw.
        type: such as sensor_msgs/msg/Image.
        count: the number of messages.
        used_as: color, depth, color_info, depth_info, wheels or gyro; empty where it is not used.
    """

    name: str
    type: str
    count: int
    used_as: str = ""


class LeftOut(str):
    """A warning that says how many lines or messages of a recording were left out, and why.

    Attributes:
        gone, of: the number that were left out, and the number of all.
        reason: what they are, and why they were left out.
    """

    gone: int
    of: int
    reason: str

    def __new__(cls, text: str, gone: int, of: int, reason: str) -> LeftOut:
        """The warning with the sentence `text`."""
        made = super().__new__(cls, text)
        made.gone, made.of, made.reason = gone, of, reason
        return made

    def __getnewargs__(self) -> tuple[str, int, int, str]:  # type: ignore[override]
        """Arguments for `copy` and `pickle`."""
        return str(self), self.gone, self.of, self.reason


def left_out_of(warnings: Iterable[str]) -> dict[str, tuple[int, int]]:
    """The numbers of lines or messages that were left out, and of all, by reason."""
    return {warning.reason: (warning.gone, warning.of) for warning in warnings if isinstance(warning, LeftOut)}


@runtime_checkable
class ListsTopics(Protocol):
    """A recording made of topics, some of them used."""

    @property
    def topics(self) -> Sequence[RecordedTopic]:
        """All topics, in order of name."""


@runtime_checkable
class TellsWheelFaults(Protocol):
    """A recording that can report why poses by its wheels are wrong."""

    @property
    def wheel_faults(self) -> Sequence[str]:
        """One sentence for each known fault, also in `warnings`."""


@runtime_checkable
class TellsEnds(Protocol):
    """A recording that is too long to list before it is read, but has the end stamps of its streams."""

    def end_stamps(self) -> Mapping[str, FloatArray]:
        """The first few stamps (N,) and the last one of each stream, keyed by `clock_checks.FRAMES` and `WHEELS`."""


class BagSettings(Settings):
    """Thresholds of the reader of bags; see docs/bags.md."""

    order_s: float = setting(
        0.5,
        "how long a message waits for older ones of its own topic, by the time of receipt, seconds; it waits longer "
        "until the other topics' stamps have come as far. What is later still is left out and counted",
        CHOSEN,
        gt=0,
        le=10,
    )
    slowest_wheels_s: float = setting(
        5.0,
        "how long frames wait for the wheels' next reading, at most, by stamps, seconds: an increment is known only "
        "once the next reading comes",
        CHOSEN,
        ge=0,
        le=60,
    )
    most_apart_s: float = setting(
        10.0,
        "how far all headers may be from the time of receipt, seconds; beyond, it is said that a replay was recorded, "
        "or that receipt is not believed",
        CHOSEN,
        gt=0,
        le=1e6,
    )
    gravity_s: float = setting(
        2.0,
        "over how many first seconds accelerations are averaged, to know which way is up for the gyroscope: longer "
        "than a start or a bump, shorter than a slope",
        CHOSEN,
        gt=0,
        le=60,
    )
    gravity_share: float = setting(
        0.2,
        "the share by which that average may differ from 9.81 m/s² and be gravity: robots speed up by 2 m/s² at most",
        "2 / 9.81",
        gt=0,
        lt=1,
    )
    gravity_apart_rad: float = setting(
        0.35,
        "how far tf and gravity may disagree on the gyroscope's axis, radians (20°): slopes are less; beyond, tf is "
        "wrong and gravity is believed",
        CHOSEN,
        gt=0,
        le=1.6,
    )
    tf_messages: int = setting(
        400,
        "how many messages of /tf are read for mounts, 4 to 8 s of a robot's: nobody mounts a camera later",
        CHOSEN,
        ge=1,
        le=100_000,
    )
    tf_apart_m: float = setting(
        0.002,
        "by how much two transforms of one mount may differ, metres; beyond, it moves, or tf contradicts itself",
        CHOSEN,
        gt=0,
        le=1,
    )
    tf_apart_rad: float = setting(0.002, "likewise, of their rotations, radians", CHOSEN, gt=0, le=1)
    lens_px: float = setting(
        0.5,
        "how far five coefficients may miss a lens that is described by more, pixels, worst over the image; beyond, it "
        "is said",
        CHOSEN,
        gt=0,
        le=100,
    )
    first_frames_s: float = setting(
        5.0,
        "in how many first seconds of camera images a usable frame must be found for the bag to be opened",
        CHOSEN,
        gt=0,
        le=600,
    )


class Layout(StrEnum):
    """The kind of files of a format, in words for error messages."""

    LISTS = "lists of images"
    NUMBERED = "numbered images"
    WHEELS = "tables of wheels"
    FILE = "one file"


class Reader(Protocol):
    """Reads one format of recording."""

    @property
    def name(self) -> str:
        """Name of the format."""

    @property
    def layout(self) -> Layout:
        """The kind of files of its recordings."""

    @property
    def needs(self) -> str:
        """The files of a folder of this format, in a few words, for error messages."""

    def recognises(self, folder: Path) -> bool:
        """Whether an existing folder has this format, judged by file names only."""

    def open(self, folder: Path, options: OpenOptions) -> Recording:
        """The recording in a recognised folder. Raises InputError where it cannot be read."""


@dataclass(frozen=True, slots=True)
class OpenOptions:
    """Options of `open_recording`: information that the files do not contain.

    Attributes:
        camera: name of a shipped calibration (see `camera_names()`), or a calibration.yaml; None to use the files.
        max_gap_s: largest time difference between the colour and the depth image of a frame.
        depth_factor: depth units per metre, where they differ from the format's own.
        calibration: a calibration.yaml, or several. Each replaces the parts of the recording's calibration, and of
            those before it, that it contains.
        rate_hz: units per second of the images' stamps: the camera's rate, where stamps are frame numbers; 1000, where
            they are milliseconds. None where they are seconds.
        topics: roles of a bag's topics, each as "color=/camera/color/image_raw"; see docs/bags.md.
        bag: how bags are read.

    Raises:
        ConfigError: the gap is negative or not finite, or a factor or rate is not positive.
    """

    camera: StrPath | None = None
    max_gap_s: float = 0.02
    depth_factor: float | None = None
    calibration: StrPath | Sequence[StrPath] | None = None
    rate_hz: float | None = None
    topics: Sequence[str] = ()
    bag: BagSettings = field(default_factory=BagSettings)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.max_gap_s) and self.max_gap_s >= 0):
            raise ConfigError(f"--max-gap is {self.max_gap_s}, not a number of seconds from 0 up")
        if self.depth_factor is not None and not (math.isfinite(self.depth_factor) and self.depth_factor > 0):
            raise ConfigError(f"--depth-factor is {self.depth_factor}, not a positive number", fix="1000: millimetres")
        if self.rate_hz is not None and not (math.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ConfigError(
                f"--rate-hz is {self.rate_hz}, not a positive number", fix="30: numbers of a 30 Hz camera"
            )

    @property
    def calibrations(self) -> tuple[StrPath, ...]:
        """The calibrations that replace parts of the recording's, in this order."""
        if self.calibration is None:
            return ()
        return (self.calibration,) if isinstance(self.calibration, str | PathLike) else tuple(self.calibration)


def _listed(files: Any) -> Any:
    """The input of a setting that takes one text, several, or none, as a sequence."""
    return (() if files is None else files) if not isinstance(files, str) else (files,)


def _unlisted(files: tuple[str, ...]) -> str | list[str] | None:
    return list(files) if len(files) > 1 else next(iter(files), None)


class RecordingSettings(Settings):
    """Information about a recording that its files do not contain, as `Config` holds it; see `OpenOptions`."""

    camera: str | None = setting(None, "name of a shipped calibration, or a calibration.yaml", ASKED)
    max_gap_s: float = setting(
        0.02, "largest distance in time between colour and depth of one frame", CHOSEN, ge=0, le=3600
    )
    depth_factor: float | None = setting(None, "depth units a metre, if not the usual", ASKED, gt=0, le=1e6)
    calibration: Annotated[tuple[str, ...], BeforeValidator(_listed), PlainSerializer(_unlisted)] = setting(
        (), "a calibration.yaml, or several, laid over the recording's: what a later one tells wins", ASKED
    )
    rate_hz: float | None = setting(
        None,
        "how many a second the images' stamps count, if they are numbers of frames or no seconds",
        ASKED,
        gt=0,
        le=1e9,
    )

    topics: Annotated[tuple[str, ...], BeforeValidator(_listed), PlainSerializer(_unlisted)] = setting(
        (), "which topics of a bag are what, such as color=/camera/color/image_raw", ASKED
    )
    bag: BagSettings = setting(BagSettings(), "how bags are read", ASKED)

    def open_options(self) -> OpenOptions:
        """The options for `open_recording`."""
        of_images = (self.camera, self.max_gap_s, self.depth_factor, self.calibration, self.rate_hz)
        return OpenOptions(*of_images, self.topics, self.bag)


# Calibrations that come with the package. Only the user chooses one.
_FOLDER = Path(__file__).parent / "cameras"


def camera_names() -> list[str]:
    """Names of the calibrations that come with the package, sorted."""
    return sorted(path.stem for path in _FOLDER.glob("*.yaml"))


def load_camera(name: StrPath) -> Calibration:
    """A calibration that comes with the package, by its name, or any calibration.yaml, by its path.

    Raises:
        CalibrationError: the name is neither known nor a file, or the file is not a calibration.
    """
    if name in camera_names():
        return load_calibration(_FOLDER / f"{name}.yaml")
    if is_there(Path(name)):
        return load_calibration(Path(name))
    raise CalibrationError(f"no camera is called {str(name)!r} and no such file exists", fix=camera_choices())


def camera_choices() -> str:
    """The fix of an error about an unknown camera: how to choose one."""
    return f"say which with --camera: {', '.join(camera_names())}, or a calibration.yaml"


def choose_calibration(folder: Path, options: OpenOptions, otherwise: Callable[[], Calibration]) -> Calibration:
    """The calibration that the user chose, else the folder's calibration.yaml, else that of the format.

    `options.calibrations` replace parts of it, or serve alone where there is none.

    Args:
        folder: of the recording.
        options: of the user.
        otherwise: gives the format's calibration, or raises CalibrationError where it has none.
    """
    over, own = options.calibrations, folder / "calibration.yaml"
    if options.camera is not None:
        return load_calibration(*over, under=load_camera(options.camera))
    if is_there(own):
        return load_calibration(own, *over)
    try:
        known = otherwise()
    except CalibrationError:
        if not over:
            raise
        return load_calibration(*over)
    return load_calibration(*over, under=known)


def express_for(body: str, trajectory: Trajectory, calibration: Calibration) -> Trajectory:
    """The trajectory T_frame_body of `body`, "base" or "camera", given that of either.

    Covariances do not change: they are left perturbations in the map frame, for either body.

    Raises:
        CalibrationError: the bodies differ and the calibration has no T_base_camera.
    """
    if trajectory.body == body:
        return trajectory
    T_base_camera = calibration.T_base_camera
    if T_base_camera is None or {trajectory.body, body} != {"base", "camera"}:
        raise CalibrationError(
            f"a trajectory of {trajectory.body!r} cannot be converted to {body!r}", fix="give T_base_camera"
        )
    T_old_new = T_base_camera if body == "camera" else se3.invert(T_base_camera)
    T_frame_body = se3.compose(trajectory.T_frame_body, T_old_new)
    return Trajectory(trajectory.stamps_s, T_frame_body, trajectory.covariances, body, trajectory.frame)
