"""Faults of cameras, stamps and surroundings, applied to any stream of events within given times."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import count

import cv2
import numpy as np

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import ByteArray, Float32Array
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelTicks

_STREAM = 0xCA3
_BLACK_LEVEL, _BLACK_NOISE = 2.0, 1.5
_GAMMA = 2.2
# Of light in a room; a Kinect's colour camera shows little but noise then, in levels.
_DARK_LIGHT, _DARK_NOISE = 0.004, 3.0
# Of what comes from a pane, seen from aslant; of infrared light that comes back from it.
_REFLECTED, _PANE_SHOWS = 0.25, 0.15
_DEPTH_NOISE_PER_M, _COLOR_NOISE = 1.4e-3, 2.0
_FRAMES = (RgbdFrame, SkippedFrame)
_SHARES = ("share", "blobs", "speckle")


@dataclass(frozen=True, kw_only=True)
class CameraFault:
    """A fault of what is taken from `begin_s` on and before `end_s`: it changes frames, drops them or their stamps.

    What is random depends on `seed` and the frame's index alone, so that a fault has the same effect on a frame
    wherever a stream begins. Raises ConfigError for a time or a share that is none.
    """

    begin_s: float = 0.0
    end_s: float = math.inf
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.begin_s < self.end_s:
            raise ConfigError(f"a fault from {self.begin_s} to {self.end_s} s never acts", fix="give growing times")
        for name in _SHARES:
            if not 0 <= getattr(self, name, 0.0) <= 1:
                raise ConfigError(f"{name} is {getattr(self, name)}", fix="a share from 0 to 1")

    def acts_at(self, stamp_s: float) -> bool:
        """Whether the fault acts at a time."""
        return self.begin_s <= stamp_s < self.end_s

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events with this fault, in order of time."""
        for event in events:
            if isinstance(event, RgbdFrame) and self.acts_at(event.stamp_s):
                yield self.changed(event, np.random.default_rng([self.seed, _STREAM, event.index]))
            else:
                yield event

    def changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        """A frame with this fault, where it changes frames one by one; `rng` is the frame's own."""
        raise NotImplementedError


def events_with(faults: Iterable[CameraFault], events: Iterable[Event]) -> Iterator[Event]:
    """Events with all faults, applied in the given order."""
    for fault in faults:
        events = fault.apply(events)
    yield from events


@dataclass(frozen=True, kw_only=True)
class LightsOff(CameraFault):
    """The light goes out: colour is black but for the sensor's noise; depth, which brings its own light, goes on."""

    def changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        """The frame, dark."""
        return replace(frame, color=_black(frame.color, rng))


@dataclass(frozen=True, kw_only=True)
class Covered(CameraFault):
    """Something lies on the camera: colour is black, and depth is empty or shows the cover.

    Attributes:
        cover_m: how far away depth takes the cover to be; 0 for a camera that measures nothing so near.
    """

    cover_m: float = 0.0

    def changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        """The frame, with the cover."""
        depth_m = np.full_like(frame.depth_m, self.cover_m)
        return replace(frame, color=_black(frame.color, rng), depth_m=depth_m)


@dataclass(frozen=True, kw_only=True)
class DepthHoles(CameraFault):
    """Depth is missing in blobs that come and go, as on glass and in sunlight, and in single pixels everywhere.

    Attributes:
        blobs: share of the image that blobs take.
        speckle: share of the pixels left that is missing too.
        blob_share: size of a blob as a share of the image's height.
        holds_frames: how many frames see the same blobs.
    """

    blobs: float = 0.4
    speckle: float = 0.1
    blob_share: float = 0.15
    holds_frames: int = 15

    def changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        """The frame, with holes in its depth."""
        lasting = np.random.default_rng([self.seed, _STREAM, 1, frame.index // self.holds_frames])
        # Where smoothed noise is highest: that share of the image exactly.
        shape = frame.depth_m.shape
        cells = max(2, round(1 / self.blob_share))
        coarse = lasting.standard_normal((cells, max(2, round(cells * shape[1] / shape[0]))))
        smooth = cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
        missing = np.asarray(smooth > np.quantile(smooth, 1 - self.blobs))
        missing |= rng.random(frame.depth_m.shape) < self.speckle
        return replace(frame, depth_m=np.where(missing, np.float32(0), frame.depth_m))


@dataclass(frozen=True, kw_only=True)
class ExposureSteps(CameraFault):
    """The exposure jumps: light times a gain drawn at regular times, clipped where it exceeds what a byte holds.

    Attributes:
        period_s: between jumps.
        stops: largest gain in powers of two, either way.
    """

    period_s: float = 0.5
    stops: float = 1.5

    def gain_at(self, stamp_s: float) -> float:
        """The gain at a time."""
        if not self.acts_at(stamp_s):
            return 1.0
        step = math.floor((stamp_s - self.begin_s) / self.period_s)
        rng = np.random.default_rng([self.seed, _STREAM, 2, step])
        return math.exp2(rng.uniform(-self.stops, self.stops))

    def changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        """The frame, brighter or darker."""
        # Bytes stand for light to the power of 1/2.2, so that a gain of light is its power of bytes.
        gain = self.gain_at(frame.stamp_s) ** (1 / _GAMMA)
        return replace(frame, color=_bytes(frame.color * np.float32(gain)))


@dataclass(frozen=True, kw_only=True)
class CableOut(CameraFault):
    """No frame comes at all."""

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events without the frames of that time."""
        return (event for event in events if not (isinstance(event, _FRAMES) and self.acts_at(event.stamp_s)))


@dataclass(frozen=True, kw_only=True)
class FramesDropped(CameraFault):
    """A share of the frames is lost, each by chance.

    Attributes:
        share: of the frames, 0 to 1.
    """

    share: float = 0.2

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events without the frames lost."""
        for event in events:
            is_lost = (
                isinstance(event, _FRAMES)
                and self.acts_at(event.stamp_s)
                and np.random.default_rng([self.seed, _STREAM, 3, event.index]).random() < self.share
            )
            if not is_lost:
                yield event


@dataclass(frozen=True, kw_only=True)
class LowRate(CameraFault):
    """Frames come at a lower rate: of those in each period the first.

    Attributes:
        rate_hz: frames a second, at most.
    """

    rate_hz: float = 5.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ConfigError(f"a rate of {self.rate_hz} frames a second is none", fix="above 0")

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events without the frames between."""
        last = -math.inf
        for event in events:
            if isinstance(event, _FRAMES) and self.acts_at(event.stamp_s):
                # Stamps are rounded to the microsecond: a frame just before its period belongs to it.
                period = math.floor(event.stamp_s * self.rate_hz + 1e-3)
                if period == last:
                    continue
                last = period
            yield event


@dataclass(frozen=True, kw_only=True)
class LateClock(CameraFault):
    """The camera's clock is late or early: frames are stamped so much after their true time.

    Events come in order of their stamps, as from a recording; frames therefore change places with wheel readings.

    Attributes:
        late_s: stamp minus true time; negative for a clock that is early.
    """

    late_s: float = 0.03

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events with changed stamps of frames."""
        waiting: list[tuple[float, int, Event]] = []
        order = count()
        for event in events:
            true_s, stamped = event.stamp_s, event
            if isinstance(event, _FRAMES) and self.acts_at(true_s):
                stamped = replace(event, stamp_s=true_s + self.late_s)
            heapq.heappush(waiting, (stamped.stamp_s, next(order), stamped))
            # Nothing that is still to come will be stamped earlier than this.
            while waiting and waiting[0][0] <= true_s + min(self.late_s, 0.0):
                yield heapq.heappop(waiting)[2]
        while waiting:
            yield heapq.heappop(waiting)[2]


@dataclass(frozen=True, kw_only=True)
class StuckImage(CameraFault):
    """The same image comes again and again, with new stamps: a driver that hangs."""

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events; frames of that time show what the last one before it showed, or else the first of them."""
        shown: RgbdFrame | None = None
        for event in events:
            if not isinstance(event, RgbdFrame):
                yield event
                continue
            if shown is None or not self.acts_at(event.stamp_s):
                shown = event
            yield replace(event, color=shown.color, depth_m=shown.depth_m)


def _black(color: ByteArray, rng: np.random.Generator) -> ByteArray:
    return _bytes(_BLACK_LEVEL + _BLACK_NOISE * rng.standard_normal(color.shape, np.float32))


def _bytes(levels: Float32Array) -> ByteArray:
    return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)


@dataclass(frozen=True, kw_only=True)
class GlassWall(CameraFault):
    """A pane: colour shows what is behind, and a reflection; most depth is missing, the rest is of what is behind.

    It fills the right part of the view, whatever the camera's way: worse than a real pane, which stands still.

    Attributes:
        share: of the view's width.
    """

    share: float = 0.4

    def columns(self, frame: RgbdFrame) -> slice:
        """Where the pane is in an image."""
        width = frame.color.shape[1]
        return slice(width - round(self.share * width), width)

    def changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        """The frame, with the pane before it."""
        columns = self.columns(frame)
        color, depth_m = frame.color.astype(np.float32), frame.depth_m.copy()
        color[:, columns] += _REFLECTED * (frame.color[:, ::-1][:, columns] - color[:, columns])
        is_missing = rng.random(depth_m[:, columns].shape) > _PANE_SHOWS
        depth_m[:, columns][is_missing] = 0
        return replace(frame, color=_bytes(color), depth_m=depth_m)


@dataclass(frozen=True, kw_only=True)
class Mirror(GlassWall):
    """Colour and depth of the view's other side, turned left to right: what moves there moves the other way."""

    def changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        """The frame, with the mirror in it."""
        columns = self.columns(frame)
        color, depth_m = frame.color.copy(), frame.depth_m.copy()
        color[:, columns], depth_m[:, columns] = frame.color[:, ::-1][:, columns], frame.depth_m[:, ::-1][:, columns]
        return replace(frame, color=color, depth_m=depth_m)


@dataclass(frozen=True, kw_only=True)
class DirectSun(CameraFault):
    """The sun shines in: a patch is white and without depth, and the exposure, ruled by it, darkens the rest.

    Attributes:
        radius_share: of the patch, as a share of the image's width.
        darkens: by how much light elsewhere is divided.
        period_s: how long the patch takes from the left of the view to its right.
    """

    radius_share: float = 0.25
    darkens: float = 3.0
    period_s: float = 3.0

    def changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        """The frame, with the sun in it."""
        shape = frame.depth_m.shape
        rows, columns = np.ogrid[: shape[0], : shape[1]]
        x = shape[1] * ((frame.stamp_s - self.begin_s) / self.period_s % 1.0)
        is_white = np.asarray((columns - x) ** 2 + (rows - shape[0] / 2) ** 2 < (self.radius_share * shape[1]) ** 2)
        color = frame.color * np.float32(self.darkens ** (-1 / _GAMMA))
        color[is_white] = 255
        return replace(frame, color=_bytes(color), depth_m=np.where(is_white, np.float32(0), frame.depth_m))


@dataclass(frozen=True, kw_only=True)
class DarkRoom(CameraFault):
    """Hardly any light: colour is a few levels and the sensor's noise; depth, which brings its own light, goes on."""

    def changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        """The frame, dark."""
        color = frame.color * np.float32(_DARK_LIGHT ** (1 / _GAMMA))
        return replace(frame, color=_bytes(color + _DARK_NOISE * rng.standard_normal(color.shape, np.float32)))


@dataclass(frozen=True, kw_only=True)
class StillView(CameraFault):
    """The view stands still though the robot moves, as in an elevator; each image is new, with a noise of its own."""

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events; frames of that time show what the first of them showed."""
        shown: RgbdFrame | None = None
        for event in events:
            if not (isinstance(event, RgbdFrame) and self.acts_at(event.stamp_s)):
                yield event
                continue
            shown = event if shown is None else shown
            rng = np.random.default_rng([self.seed, 0x57, event.index])
            # The same view with other noise: a Kinect's of depth, some levels of colour.
            noisy = shown.color + _COLOR_NOISE * rng.standard_normal(shown.color.shape, np.float32)
            off_m = _DEPTH_NOISE_PER_M * shown.depth_m**2 * rng.standard_normal(shown.depth_m.shape, np.float32)
            depth_m = np.asarray(np.where(shown.depth_m > 0, np.maximum(shown.depth_m + off_m, 0.05), 0), np.float32)
            yield replace(event, color=_bytes(noisy), depth_m=depth_m)


@dataclass(frozen=True, kw_only=True)
class WheelsStand(CameraFault):
    """The wheels do not turn though the robot moves, as when it is carried: counts go on from where they stood."""

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events; what is counted in that time is taken from all counts from then on."""
        last = WheelTicks(0.0, 0, 0)
        left = right = 0
        for event in events:
            if not isinstance(event, WheelTicks):
                yield event
                continue
            if self.acts_at(event.stamp_s):
                left, right = left + event.left - last.left, right + event.right - last.right
            last = event
            yield replace(event, left=event.left - left, right=event.right - right)


@dataclass(frozen=True, kw_only=True)
class Silence(CameraFault):
    """Nothing comes at all, of no sensor: a bus that hangs."""

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events without all those of that time."""
        return (event for event in events if not self.acts_at(event.stamp_s))
