"""ContactSheet: a recording as thumbnails along time, each with the area that is proposed for its part of the drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, runtime_checkable

import cv2
import numpy as np

from wheelsight.areas import AreaMap
from wheelsight.errors import PlaceError, RecordingError
from wheelsight.events import RgbdFrame
from wheelsight.geometry import ByteArray, FloatArray, IntArray
from wheelsight.places.dataset import LabelSource, stamps_of
from wheelsight.recordings import Recording

_WIDTH_PX = 240
_MOST_UNASKED = 600


@runtime_checkable
class _Files(Protocol):
    """A recording of which any frame can be read alone."""

    def read_frame(self, index: int) -> RgbdFrame: ...


@dataclass(frozen=True, eq=False)
class ContactSheet:
    """N thumbnails of a recording, in order of time.

    Attributes:
        name: of the recording.
        frame_count: how many frames it lists.
        every_s: seconds between thumbnails, about.
        pictures: (N) images (h, w, 3) uint8, red green blue.
        stamps_s: (N,).
        borders_s: (N + 1,) where each thumbnail's part of the drive begins, and the last one's ends: halfway between
            thumbnails or, where the proposed area changes once between them, between the two frames where it does.
        labels: (N,) index of the area proposed for each, -1: none.
        names: of the areas.
        areas: their polygons, or None.
        xy_m: (N, 2) where the robot was, NaN where that is not known.
    """

    name: str
    frame_count: int
    every_s: float
    pictures: tuple[ByteArray, ...]
    stamps_s: FloatArray
    borders_s: FloatArray
    labels: IntArray
    names: tuple[str, ...]
    areas: AreaMap | None
    xy_m: FloatArray


def make_sheet(
    recording: Recording,
    source: LabelSource,
    every_s: float | None = None,
    on_picture: Callable[[], None] = lambda: None,
) -> ContactSheet:
    """Thumbnails of a recording and what `source` says of them.

    Args:
        recording: with frames.
        source: of the proposed areas.
        every_s: seconds between thumbnails; None: one, or more where that would make over 600 of them.
        on_picture: called after each thumbnail.

    Raises:
        PlaceError: a recording without usable frames.
        AreaError: labels that do not belong to it.
    """
    stamps_s = np.array(stamps_of(recording), float)
    if not len(stamps_s):
        raise PlaceError(f"{recording.name} has no frames", fix="give a recording with colour and depth")
    every_s = every_s or max(1.0, float(stamps_s[-1] - stamps_s[0]) / _MOST_UNASKED)
    of_frames = source.of_frames(stamps_s.tolist(), source.names)
    kept = [(frame.index, _shrunk(frame.color)) for frame in _pictured(recording, stamps_s, every_s, on_picture)]
    if not kept:
        raise PlaceError(f"{recording.name} has no usable frames", fix="wheelsight info tells why")
    indices = np.array([index for index, _ in kept])
    return ContactSheet(
        recording.name,
        len(stamps_s),
        every_s,
        tuple(picture for _, picture in kept),
        stamps_s[indices],
        _borders(stamps_s, of_frames, indices),
        of_frames[indices],
        source.names,
        source.areas,
        _positions(source, stamps_s[indices]),
    )


def chosen_frames(stamps_s: FloatArray, every_s: float) -> list[int]:
    """Indices of frames about `every_s` apart: the one nearest to the middle of each such part of the drive."""
    parts = max(round((stamps_s[-1] - stamps_s[0]) / every_s), 1)
    middles_s = stamps_s[0] + (np.arange(parts) + 0.5) * every_s
    after = np.searchsorted(stamps_s, middles_s).clip(0, len(stamps_s) - 1)
    before = (after - 1).clip(0)
    nearer = np.abs(stamps_s[before] - middles_s) < np.abs(stamps_s[after] - middles_s)
    return sorted(set(np.where(nearer, before, after).tolist()))


def _pictured(
    recording: Recording, stamps_s: FloatArray, every_s: float, on_picture: Callable[[], None]
) -> Iterator[RgbdFrame]:
    """The chosen frames that can be used."""
    chosen = chosen_frames(stamps_s, every_s)
    for frame in _read(recording, chosen):
        on_picture()
        yield frame


def _read(recording: Recording, chosen: Sequence[int]) -> Iterator[RgbdFrame]:
    if not isinstance(recording, _Files):
        wanted = set(chosen)
        yield from (e for e in recording.events() if isinstance(e, RgbdFrame) and e.index in wanted)
        return
    for index in chosen:
        try:
            yield recording.read_frame(index)
        except RecordingError:
            continue  # its neighbours stand for it


def _borders(stamps_s: FloatArray, labels: IntArray, indices: IntArray) -> FloatArray:
    def between(left: int, right: int) -> float:
        changes = np.flatnonzero(np.diff(labels[left : right + 1])) + left
        if len(changes) != 1:
            return float(stamps_s[left] + stamps_s[right]) / 2
        return float(stamps_s[changes[0]] + stamps_s[changes[0] + 1]) / 2

    inner = [between(left, right) for left, right in pairwise(indices.tolist())]
    return np.array([stamps_s[0], *inner, stamps_s[-1]])


def _positions(source: LabelSource, stamps_s: FloatArray) -> FloatArray:
    if source.trajectory is None or source.areas is None:
        return np.full((len(stamps_s), 2), np.nan)
    return source.trajectory.at(stamps_s)[:, :2, 3]


def _shrunk(color: ByteArray) -> ByteArray:
    scale = min(_WIDTH_PX / color.shape[1], 1.0)
    size = (max(round(color.shape[1] * scale), 1), max(round(color.shape[0] * scale), 1))
    return np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
