"""`Recording`, the interface of every format, `Reader`, which opens one, and `OpenOptions`.
Readers choose the calibration and the body of the ground truth here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from os import PathLike, fspath
from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

from pydantic import BeforeValidator, PlainSerializer, ValidationError

from wheelsight.core.calibration import Calibration, load_calibration
from wheelsight.core.errors import CalibrationError, ConfigError, RecordingError
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
        next_stamp_s: the time of the next frame; infinite for the last.
    """

    stamp_s: float
    next_stamp_s: float
    read: Callable[[], RgbdFrame | SkippedFrame]


def frame_or_reason(read: Callable[[], RgbdFrame], stamp_s: float, index: int) -> RgbdFrame | SkippedFrame:
    """The decoded frame, or why it cannot be used."""
    try:
        return read()
    except RecordingError as error:
        return SkippedFrame(stamp_s, error.problem, index)


@runtime_checkable
class ListsFrames(Protocol):
    """A recording that lists frames before it decodes them, so that a caller can skip some."""

    def listed(self) -> Iterator[Event | ListedFrame]:
        """The items of `events()` in the same order, with undecoded frames."""


@runtime_checkable
class HasClocksOfItsOwn(Protocol):
    """A recording whose stamps are on one clock, though its sensors had several."""

    def as_stamped(self) -> Recording:
        """The recording with the stamps of each sensor's own clock, as calibration of a delay needs them."""


@runtime_checkable
class HasMatches(Protocol):
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
class HasWheelFaults(Protocol):
    """A recording that can report why poses by its wheels are wrong."""

    @property
    def wheel_faults(self) -> Sequence[str]:
        """One sentence for each known fault, also in `warnings`."""


@runtime_checkable
class HasEndStamps(Protocol):
    """A recording that is too long to list before it is read, but has the end stamps of its streams."""

    def end_stamps(self) -> Mapping[str, FloatArray]:
        """The first few stamps (N,) and the last one of each stream, keyed by `clock_checks.FRAMES` and `WHEELS`."""


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


def _as_texts(given: Any) -> Any:
    """A path or several as a tuple of text, as a setting takes it."""
    if given is None:
        return ()
    given = (given,) if isinstance(given, str | PathLike) else given
    return tuple(map(_as_text, given)) if isinstance(given, list | tuple) else given


def _as_text(path: Any) -> Any:
    return fspath(path) if isinstance(path, PathLike) else path


_Texts = Annotated[
    tuple[str, ...],
    BeforeValidator(_as_texts),
    PlainSerializer(lambda texts: list(texts) if len(texts) > 1 else next(iter(texts), None)),
]


class OpenOptions(Settings):
    """Information about a recording that its files do not contain: the options of `open_recording`.

    Raises ConfigError where the gap is negative or not finite, or a factor or rate is not positive.
    """

    camera: Annotated[str | None, BeforeValidator(_as_text)] = setting(
        None, "a shipped calibration (`camera_names()`), or a calibration.yaml; None: the recording's own", ASKED
    )
    max_gap_s: float = setting(
        0.02, "largest time difference between the colour and the depth image of a frame", CHOSEN, ge=0, le=3600
    )
    depth_factor: float | None = setting(
        None, "depth units per metre, where they differ from the format's own", ASKED, gt=0, le=1e6
    )
    calibration: _Texts = setting(
        (),
        "a calibration.yaml, or several; each replaces the parts that it contains in those before it and in the "
        "recording's calibration",
        ASKED,
    )
    rate_hz: float | None = setting(
        None,
        "units per second of the images' stamps: the camera's rate, where stamps are frame numbers; 1000, where they "
        "are milliseconds",
        ASKED,
        gt=0,
        le=1e9,
    )
    topics: _Texts = setting(
        (), "roles of a bag's topics, each as color=/camera/color/image_raw; see docs/bags.md", ASKED
    )

    def __init__(self, **options: Any) -> None:
        try:
            super().__init__(**options)
        except ValidationError as invalid:
            first = invalid.errors(include_url=False)[0]
            name = ".".join(map(str, first["loc"]))
            raise ConfigError(f"{name} is {first['input']!r}: {first['msg']}") from invalid

    # pydantic does not call this __init__ for the section of a `Config`, whose errors name file and line.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]


# Calibrations that come with the package. Only the user chooses one.
_FOLDER = Path(__file__).parent / "cameras"


def camera_names() -> list[str]:
    """Names of the calibrations that come with the package, sorted."""
    return sorted(path.stem for path in _FOLDER.glob("*.yaml"))


def load_camera(name: StrPath) -> Calibration:
    """A calibration that comes with the package, by its name, or any calibration.yaml, by its path.

    Raises CalibrationError where the name is neither known nor a file, or the file is not a calibration.
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

    `options.calibration` replace parts of it, or serve alone where there is none.

    Args:
        otherwise: gives the format's calibration, or raises CalibrationError where it has none.
    """
    over, own = options.calibration, folder / "calibration.yaml"
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

    Raises CalibrationError where the bodies differ and the calibration has no T_base_camera.
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
