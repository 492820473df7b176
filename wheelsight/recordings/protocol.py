"""Recording: what every source of recorded events offers, whatever its format."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from os import PathLike
from pathlib import Path
from typing import Protocol, runtime_checkable

from wheelsight.errors import ConfigError
from wheelsight.events import Event, RgbdFrame, SkippedFrame
from wheelsight.files import StrPath
from wheelsight.geometry import FloatArray
from wheelsight.matches import Match, SpeedVariances
from wheelsight.recordings.rosbag.settings import BagSettings
from wheelsight.sources import EventSource
from wheelsight.trajectory import Trajectory


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
