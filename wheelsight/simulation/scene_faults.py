"""What a place does to a camera, and a person to a robot: glass, mirrors, sun, the dark, a view that stands, silence.

Faults as those of `camera_faults`. They are put on images as they come, so that they know no walls: glass and mirror
fill a part of the view for as long as they act, whatever the camera's way. What they show is worse than a real pane,
whose mirror image is a room that stands still.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.events import Event, RgbdFrame, WheelTicks
from wheelsight.geometry import BoolArray, ByteArray, Float32Array
from wheelsight.simulation.camera_faults import _bytes, _check_share, _ImageFault, _Interval

_GAMMA = 2.2
# Of light in a room; a Kinect's colour camera shows little but noise then, in levels.
_DARK_LIGHT, _DARK_NOISE = 0.004, 3.0
# Of what comes from a pane, seen from aslant; of infrared light that comes back from it.
_REFLECTED, _PANE_SHOWS = 0.25, 0.15
_DEPTH_NOISE_PER_M, _COLOR_NOISE = 1.4e-3, 2.0


@dataclass(frozen=True, kw_only=True)
class _PartOfView(_ImageFault):
    """Changes the right part of each image.

    Attributes:
        share: of the view's width.
    """

    share: float = 0.4

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_share("share", self.share)

    def _columns(self, width: int) -> slice:
        return slice(width - round(self.share * width), width)


@dataclass(frozen=True, kw_only=True)
class GlassWall(_PartOfView):
    """A pane: colour shows what is behind, and a reflection; most depth is missing, the rest is of what is behind."""

    def _changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        columns = self._columns(frame.color.shape[1])
        color, depth_m = frame.color.astype(np.float32), frame.depth_m.copy()
        color[:, columns] += _REFLECTED * (frame.color[:, ::-1][:, columns] - color[:, columns])
        is_missing = rng.random(depth_m[:, columns].shape) > _PANE_SHOWS
        depth_m[:, columns][is_missing] = 0
        return replace(frame, color=_bytes(color), depth_m=depth_m)


@dataclass(frozen=True, kw_only=True)
class Mirror(_PartOfView):
    """Colour and depth of the view's other side, turned left to right: what moves there moves the other way."""

    def _changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        columns = self._columns(frame.color.shape[1])
        color, depth_m = frame.color.copy(), frame.depth_m.copy()
        color[:, columns], depth_m[:, columns] = frame.color[:, ::-1][:, columns], frame.depth_m[:, ::-1][:, columns]
        return replace(frame, color=color, depth_m=depth_m)


@dataclass(frozen=True, kw_only=True)
class DirectSun(_ImageFault):
    """The sun shines in: a patch is white and without depth, and the exposure, ruled by it, darkens the rest.

    Attributes:
        radius_share: of the patch, as a share of the image's width.
        darkens: by how much light elsewhere is divided.
        period_s: how long the patch takes from the left of the view to its right.
    """

    radius_share: float = 0.25
    darkens: float = 3.0
    period_s: float = 3.0

    def _changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        is_white = self._patch(frame.depth_m.shape, frame.stamp_s)
        color = frame.color * np.float32(self.darkens ** (-1 / _GAMMA))
        color[is_white] = 255
        return replace(frame, color=_bytes(color), depth_m=np.where(is_white, np.float32(0), frame.depth_m))

    def _patch(self, shape: tuple[int, ...], stamp_s: float) -> BoolArray:
        rows, columns = np.ogrid[: shape[0], : shape[1]]
        x = shape[1] * ((stamp_s - self.begin_s) / self.period_s % 1.0)
        return np.asarray((columns - x) ** 2 + (rows - shape[0] / 2) ** 2 < (self.radius_share * shape[1]) ** 2)


@dataclass(frozen=True, kw_only=True)
class DarkRoom(_ImageFault):
    """Hardly any light: colour is a few levels and the sensor's noise; depth, which brings its own light, goes on."""

    def _changed(self, frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
        color = frame.color * np.float32(_DARK_LIGHT ** (1 / _GAMMA))
        return replace(frame, color=_bytes(color + _DARK_NOISE * rng.standard_normal(color.shape, np.float32)))


@dataclass(frozen=True, kw_only=True)
class StillView(_Interval):
    """The view stands still though the robot moves, as in an elevator; each image is new, with a noise of its own.

    Attributes:
        seed: of the noise.
    """

    seed: int = 0

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events; frames of that time show what the first of them showed."""
        shown: RgbdFrame | None = None
        for event in events:
            if not (isinstance(event, RgbdFrame) and self.acts_at(event.stamp_s)):
                yield event
                continue
            shown = event if shown is None else shown
            rng = np.random.default_rng([self.seed, 0x57, event.index])
            color, depth_m = _measured_again(shown.color, shown.depth_m, rng)
            yield replace(event, color=color, depth_m=depth_m)


@dataclass(frozen=True, kw_only=True)
class WheelsStand(_Interval):
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
class Silence(_Interval):
    """Nothing comes at all, of no sensor: a bus that hangs."""

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events without all those of that time."""
        return (event for event in events if not self.acts_at(event.stamp_s))


def _measured_again(
    color: ByteArray, depth_m: Float32Array, rng: np.random.Generator
) -> tuple[ByteArray, Float32Array]:
    """The same view with other noise: a Kinect's of depth, some levels of colour."""
    noisy = color + _COLOR_NOISE * rng.standard_normal(color.shape, np.float32)
    off_m = _DEPTH_NOISE_PER_M * depth_m**2 * rng.standard_normal(depth_m.shape, np.float32)
    return _bytes(noisy), np.asarray(np.where(depth_m > 0, np.maximum(depth_m + off_m, 0.05), 0), np.float32)
