"""What goes wrong with a camera: faults laid over any stream of events, where they act told with them.

Each fault is a function from events to events: frames change, go missing or are stamped anew; wheel readings pass
untouched. What is random about a frame follows from the fault's seed and the frame's index alone, so that the same
fault does the same to a frame wherever a stream begins. `events_with` lays several over one another.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import count
from typing import Protocol

import cv2
import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.events import Event, RgbdFrame, SkippedFrame
from wheelsight.geometry import BoolArray, ByteArray, Float32Array

_STREAM = 0xCA3
_BLACK_LEVEL, _BLACK_NOISE = 2.0, 1.5
_GAMMA = 2.2


class CameraFault(Protocol):
    """A fault, and when it acts."""

    @property
    def begin_s(self) -> float:
        """True time of the first moment at which it acts."""
        ...

    @property
    def end_s(self) -> float:
        """True time from which on it no longer acts; infinite for a fault that stays."""
        ...

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events in order of time, as they come with this fault."""
        ...


def events_with(faults: Iterable[CameraFault], events: Iterable[Event]) -> Iterator[Event]:
    """Events with all faults, the first given acting first."""
    for fault in faults:
        events = fault.apply(events)
    yield from events


@dataclass(frozen=True, kw_only=True)
class _Interval:
    """Acts on what was taken from `begin_s` on and before `end_s`. Raises ConfigError for a time that is none."""

    begin_s: float = 0.0
    end_s: float = math.inf

    def __post_init__(self) -> None:
        if not self.begin_s < self.end_s:
            raise ConfigError(f"a fault from {self.begin_s} to {self.end_s} s never acts", fix="give growing times")

    def acts_at(self, stamp_s: float) -> bool:
        """Whether the fault acts at a time."""
        return self.begin_s <= stamp_s < self.end_s


@dataclass(frozen=True, kw_only=True)
class _ImageFault(_Interval):
    """Changes images one by one.

    Attributes:
        seed: of what is random about it.
    """

    seed: int = 0

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events, images changed where the fault acts."""
        for event in events:
            if isinstance(event, RgbdFrame) and self.acts_at(event.stamp_s):
                yield self._changed(event, np.random.default_rng([self.seed, _STREAM, event.index]))
            else:
                yield event

    def _changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class LightsOff(_ImageFault):
    """The light goes out: colour is black but for the sensor's noise; depth, which brings its own light, goes on."""

    def _changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        return replace(frame, color=_black(frame.color, rng))


@dataclass(frozen=True, kw_only=True)
class Covered(_ImageFault):
    """Something lies on the camera: colour is black, and depth is empty or shows the cover.

    Attributes:
        cover_m: how far away depth takes the cover to be; 0 for a camera that measures nothing so near.
    """

    cover_m: float = 0.0

    def _changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        depth_m = np.full_like(frame.depth_m, self.cover_m)
        return replace(frame, color=_black(frame.color, rng), depth_m=depth_m)


@dataclass(frozen=True, kw_only=True)
class DepthHoles(_ImageFault):
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

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_share("blobs", self.blobs)
        _check_share("speckle", self.speckle)

    def _changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        lasting = np.random.default_rng([self.seed, _STREAM, 1, frame.index // self.holds_frames])
        missing = self._in_blob(frame.depth_m.shape, lasting)
        missing |= rng.random(frame.depth_m.shape) < self.speckle
        return replace(frame, depth_m=np.where(missing, np.float32(0), frame.depth_m))

    def _in_blob(self, shape: tuple[int, ...], rng: np.random.Generator) -> BoolArray:
        """Where smoothed noise is highest: that share of the image exactly."""
        cells = max(2, round(1 / self.blob_share))
        coarse = rng.standard_normal((cells, max(2, round(cells * shape[1] / shape[0]))))
        smooth = cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
        return np.asarray(smooth > np.quantile(smooth, 1 - self.blobs))


@dataclass(frozen=True, kw_only=True)
class ExposureSteps(_ImageFault):
    """The exposure jumps: light times a gain drawn anew every so often, clipped where it exceeds what a byte holds.

    Attributes:
        period_s: between jumps.
        stops: largest gain in powers of two, either way.
    """

    period_s: float = 0.5
    stops: float = 1.5

    def gain_at(self, stamp_s: float) -> float:
        """By which light is multiplied at a time."""
        if not self.acts_at(stamp_s):
            return 1.0
        step = math.floor((stamp_s - self.begin_s) / self.period_s)
        rng = np.random.default_rng([self.seed, _STREAM, 2, step])
        return math.exp2(rng.uniform(-self.stops, self.stops))

    def _changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        # Bytes stand for light to the power of 1/2.2, so that a gain of light is its power of bytes.
        gain = self.gain_at(frame.stamp_s) ** (1 / _GAMMA)
        return replace(frame, color=_bytes(frame.color * np.float32(gain)))


@dataclass(frozen=True, kw_only=True)
class CableOut(_Interval):
    """No frame comes at all."""

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events without the frames of that time."""
        return (event for event in events if not (_is_frame(event) and self.acts_at(event.stamp_s)))


@dataclass(frozen=True, kw_only=True)
class FramesDropped(_Interval):
    """A share of the frames is lost, each by chance.

    Attributes:
        share: of the frames, 0 to 1.
        seed: of the chance.
    """

    share: float = 0.2
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_share("share", self.share)

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events without the frames lost."""
        return (event for event in events if not self._is_lost(event))

    def _is_lost(self, event: Event) -> bool:
        if not (isinstance(event, RgbdFrame | SkippedFrame) and self.acts_at(event.stamp_s)):
            return False
        return bool(np.random.default_rng([self.seed, _STREAM, 3, event.index]).random() < self.share)


@dataclass(frozen=True, kw_only=True)
class LowRate(_Interval):
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
            if _is_frame(event) and self.acts_at(event.stamp_s):
                # Stamps are rounded to the microsecond: a frame just before its period belongs to it.
                period = math.floor(event.stamp_s * self.rate_hz + 1e-3)
                if period == last:
                    continue
                last = period
            yield event


@dataclass(frozen=True, kw_only=True)
class LateClock(_Interval):
    """The camera's clock is late or early: frames are stamped so much after their true time.

    Events come in order of their stamps, as from a recording; frames therefore change places with wheel readings.

    Attributes:
        late_s: stamp minus true time; negative for a clock that is early.
    """

    late_s: float = 0.03

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events, frames stamped anew."""
        waiting: list[tuple[float, int, Event]] = []
        order = count()
        for event in events:
            true_s, told = event.stamp_s, event
            if isinstance(event, RgbdFrame | SkippedFrame) and self.acts_at(true_s):
                told = replace(event, stamp_s=true_s + self.late_s)
            heapq.heappush(waiting, (told.stamp_s, next(order), told))
            # Nothing that is still to come will be stamped earlier than this.
            while waiting and waiting[0][0] <= true_s + min(self.late_s, 0.0):
                yield heapq.heappop(waiting)[2]
        while waiting:
            yield heapq.heappop(waiting)[2]


@dataclass(frozen=True, kw_only=True)
class StuckImage(_Interval):
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


def _is_frame(event: Event) -> bool:
    return isinstance(event, RgbdFrame | SkippedFrame)


def _black(color: ByteArray, rng: np.random.Generator) -> ByteArray:
    return _bytes(_BLACK_LEVEL + _BLACK_NOISE * rng.standard_normal(color.shape, np.float32))


def _bytes(levels: Float32Array) -> ByteArray:
    return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)


def _check_share(name: str, value: float) -> None:
    if not 0 <= value <= 1:
        raise ConfigError(f"{name} is {value}", fix="a share from 0 to 1")
