"""`Recording`, the interface of every format, with `OpenOptions`, `RecordingSettings` and `BagSettings`. Readers
choose the calibration and the body of the ground truth here.
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

# By what a bag's messages are put in order, and when what they say of themselves is not believed.


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


# Recording: what every source of recorded events offers, whatever its format.


@dataclass(frozen=True, slots=True)
class AssociationReport:
    """How colour images found their depth images: counts, and the largest gap kept."""

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
        """Frames that are lost because their images found no partner: of the sensor that gave fewer images."""
        return max(min(self.color_images, self.depth_images) - self.pairs, 0)


@runtime_checkable
class Recording(EventSource, Protocol):
    """A finished recording: a source that ends, and knows its counts and the true trajectory if it has one."""

    @property
    def path(self) -> Path:
        """The folder it was read from."""

    @property
    def format(self) -> str:
        """The reader's name in the registry."""

    @property
    def body(self) -> str:
        """The frame its trajectory describes: "base" where the calibration says T_base_camera, else "camera"."""

    @property
    def frame_count(self) -> int:
        """How many RGB-D frames `events()` will yield, skipped ones included."""

    @property
    def wheel_count(self) -> int:
        """How many wheel readings `events()` will yield."""

    @property
    def association(self) -> AssociationReport:
        """How colour and depth were paired."""

    @property
    def ground_truth(self) -> Trajectory | None:
        """T_frame_body of `body`, or None."""

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """The events in order of time, from the start at each call; images are decoded as they are asked for.

        Without `images` frames are left out, and none is decoded.
        """


@dataclass(frozen=True, slots=True, eq=False)
class ListedFrame:
    """A frame that is known of, but not decoded yet.

    Attributes:
        stamp_s: its time.
        next_stamp_s: that of the frame after it; infinite for the last.
        read: decodes it.
    """

    stamp_s: float
    next_stamp_s: float
    read: Callable[[], RgbdFrame | SkippedFrame]


@runtime_checkable
class ListsFrames(Protocol):
    """A recording that knows of its frames before it decodes them, so that some need not be decoded at all."""

    def listed(self) -> Iterator[Event | ListedFrame]:
        """What `events()` yields, in the same order, with frames that are still to be decoded."""


@runtime_checkable
class GivesMatches(Protocol):
    """A recording that tells where somebody took two places for one, and what its odometry says of its own errors."""

    @property
    def matches(self) -> Sequence[Match]:
        """In any order; maybe none."""

    @property
    def speed_variances(self) -> SpeedVariances | None:
        """As stated, or None."""


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic of a bag.

    Attributes:
        name: such as /camera/color/image_raw.
        type: such as sensor_msgs/msg/Image.
        count: how many messages there are.
        used_as: color, depth, color_info, depth_info, wheels or gyro; empty where it is not used.
    """

    name: str
    type: str
    count: int
    used_as: str = ""


class LeftOut(str):
    """A sentence among the warnings of a recording that says how much of it was left out, and why.

    Attributes:
        gone, of: so many lines or messages, of how many.
        reason: what they are, and why they were left out.
    """

    gone: int
    of: int
    reason: str

    def __new__(cls, text: str, gone: int, of: int, reason: str) -> LeftOut:
        """The sentence `text`."""
        made = super().__new__(cls, text)
        made.gone, made.of, made.reason = gone, of, reason
        return made

    def __getnewargs__(self) -> tuple[str, int, int, str]:  # type: ignore[override]
        """For copies and other processes."""
        return str(self), self.gone, self.of, self.reason


def left_out_of(warnings: Iterable[str]) -> dict[str, tuple[int, int]]:
    """How many lines or messages of a recording were left out, and of how many, by reason."""
    return {told.reason: (told.gone, told.of) for told in warnings if isinstance(told, LeftOut)}


@runtime_checkable
class ListsTopics(Protocol):
    """A recording made of topics, of which it uses some."""

    @property
    def topics(self) -> Sequence[RecordedTopic]:
        """All of them, in order of name."""


@runtime_checkable
class TellsWheelFaults(Protocol):
    """A recording that may know why poses by its wheels are wrong."""

    @property
    def wheel_faults(self) -> Sequence[str]:
        """One sentence each, also in `warnings`; none where nothing is known to be wrong."""


@runtime_checkable
class TellsEnds(Protocol):
    """A recording too long to be listed before it is read; it knows when its streams begin and end."""

    def end_stamps(self) -> Mapping[str, FloatArray]:
        """Some first stamps (N,), and the last one, of frames and of wheels, by the names of `recordings.clocks`."""


@dataclass(frozen=True, slots=True)
class OpenOptions:
    """What a user may say about a recording that its files do not.

    Attributes:
        camera: name of a shipped calibration (see `camera_names()`), or a calibration.yaml; None to go by the files.
        max_gap_s: largest distance in time between a colour and a depth image of one frame.
        depth_factor: depth units a metre, where it differs from the format's own.
        calibration: a calibration.yaml, or several; what each tells of any part of the robot stands in place of what
            the recording, and those before it, say.
        rate_hz: how many a second the stamps of images count: the camera's rate, where they are numbers of frames;
            1000, where they are milliseconds. None where they are seconds.
        topics: which topics of a bag are what, each as "color=/camera/color/image_raw"; see docs/bags.md.
        bag: how messages of bags are put in order, and when their stamps are believed.

    Raises:
        ConfigError: a gap that is not finite and from 0 up, or a factor or rate that is not positive.
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
        """What is laid over the recording's calibration, one after the other."""
        if self.calibration is None:
            return ()
        return (self.calibration,) if isinstance(self.calibration, str | PathLike) else tuple(self.calibration)


class Layout(StrEnum):
    """By what a format is told from others, in words for a user whose folder is of none."""

    LISTS = "lists of images"
    NUMBERED = "numbered images"
    WHEELS = "tables of wheels"
    FILE = "one file"


class Reader(Protocol):
    """Reads one format of recording."""

    @property
    def name(self) -> str:
        """What the format is called."""

    @property
    def layout(self) -> Layout:
        """What its recordings are made of."""

    @property
    def needs(self) -> str:
        """What a folder of this format holds, in a few words, for a user whose folder is none."""

    def recognises(self, folder: Path) -> bool:
        """Whether an existing folder looks like this format, by names of files alone."""

    def open(self, folder: Path, options: OpenOptions) -> Recording:
        """The recording in a folder that was recognised. Raises InputError where it cannot be read."""


# RecordingSettings: what a user says about a recording, as `Config` holds it.


def _listed(files: Any) -> Any:
    """One file, or none, as a list of them."""
    return (() if files is None else files) if not isinstance(files, str) else (files,)


def _unlisted(files: tuple[str, ...]) -> str | list[str] | None:
    return list(files) if len(files) > 1 else next(iter(files), None)


class RecordingSettings(Settings):
    """What a user says about a recording that its files do not."""

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
        """The same, as `open_recording` takes it."""
        of_images = (self.camera, self.max_gap_s, self.depth_factor, self.calibration, self.rate_hz)
        return OpenOptions(*of_images, self.topics, self.bag)


# Calibrations that come with the package, by name; none is ever chosen silently.


_FOLDER = Path(__file__).parent / "cameras"


def camera_names() -> list[str]:
    """Names of the calibrations that come with the package, sorted."""
    return sorted(path.stem for path in _FOLDER.glob("*.yaml"))


def load_camera(name: StrPath) -> Calibration:
    """A calibration that comes with the package, by its name, or any calibration.yaml, by its path.

    Raises:
        CalibrationError: neither a known name nor a file, or a file that is no calibration.
    """
    if name in camera_names():
        return load_calibration(_FOLDER / f"{name}.yaml")
    if is_there(Path(name)):
        return load_calibration(Path(name))
    raise CalibrationError(f"no camera is called {str(name)!r} and no such file exists", fix=camera_choices())


def camera_choices() -> str:
    """What a user may answer when asked for the camera."""
    return f"say which with --camera: {', '.join(camera_names())}, or a calibration.yaml"


def choose_calibration(folder: Path, options: OpenOptions, otherwise: Callable[[], Calibration]) -> Calibration:
    """The calibration the user names, else the folder's calibration.yaml, else what its format knows.

    Over it goes what `options.calibrations` tell of any part of the robot; where nothing else is known, they serve.
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


# The same trajectory told of the robot's base or of its camera.


def express_for(body: str, trajectory: Trajectory, calibration: Calibration) -> Trajectory:
    """T_frame_body for `body`, "base" or "camera", of a trajectory that describes either.

    Covariances stay as they are: they perturb from the left, in the map, whatever the body.

    Raises:
        CalibrationError: the two differ and the calibration has no T_base_camera to join them.
    """
    if trajectory.body == body:
        return trajectory
    T_base_camera = calibration.T_base_camera
    if T_base_camera is None or {trajectory.body, body} != {"base", "camera"}:
        raise CalibrationError(
            f"a trajectory of {trajectory.body!r} cannot be told for {body!r}", fix="give T_base_camera"
        )
    T_old_new = T_base_camera if body == "camera" else se3.invert(T_base_camera)
    T_frame_body = se3.compose(trajectory.T_frame_body, T_old_new)
    return Trajectory(trajectory.stamps_s, T_frame_body, trajectory.covariances, body, trajectory.frame)
