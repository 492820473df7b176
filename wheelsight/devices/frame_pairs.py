"""FramePairs: colour and depth that come apart, joined into frames by their stamps."""

from __future__ import annotations

from collections import deque
from typing import Generic, NamedTuple, TypeVar

T = TypeVar("T")

# Of a stream whose partner has stopped.
_MOST_WAITING = 8


class Stamped(NamedTuple, Generic[T]):
    """Anything, and when it was taken."""

    stamp_s: float
    what: T


class FramePairs(Generic[T]):
    """Joins what two streams give, each in order; what finds no partner within `gap_s` seconds is passed over."""

    def __init__(self, gap_s: float) -> None:
        self._gap_s = gap_s
        self._color: deque[Stamped[T]] = deque()
        self._depth: deque[Stamped[T]] = deque()

    def add_color(self, stamp_s: float, image: T) -> tuple[Stamped[T], Stamped[T]] | None:
        """Colour with its depth, where that is there already."""
        _append(self._color, Stamped(stamp_s, image))
        return self._pair()

    def add_depth(self, stamp_s: float, image: T) -> tuple[Stamped[T], Stamped[T]] | None:
        """The colour with this depth, where that is there already."""
        _append(self._depth, Stamped(stamp_s, image))
        return self._pair()

    def _pair(self) -> tuple[Stamped[T], Stamped[T]] | None:
        while self._color and self._depth:
            late_s = self._depth[0].stamp_s - self._color[0].stamp_s
            if abs(late_s) <= self._gap_s:
                return self._color.popleft(), self._depth.popleft()
            (self._color if late_s > 0 else self._depth).popleft()
        return None


def _append(images: deque[Stamped[T]], image: Stamped[T]) -> None:
    """At the end; where its clock was set back, what came before is of another time."""
    if images and image.stamp_s < images[-1].stamp_s:
        images.clear()
    images.append(image)
    while len(images) > _MOST_WAITING:
        images.popleft()
