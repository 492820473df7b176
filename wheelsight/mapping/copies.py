"""SurfelCopies: surfels gathered from parts of a map, without a second copy of all of them meanwhile."""

from __future__ import annotations

import numpy as np

from wheelsight.mapping._block_kernels import CONFIDENCE, RADIUS, SurfelArrays
from wheelsight.mapping.values import Surfels


def views_of(part: SurfelArrays) -> Surfels:
    """The same as flat arrays, which are not copied."""
    position, radius_m, normal, confidence = np.split(part.geometry, (3, RADIUS + 1, CONFIDENCE), axis=1)
    color, grey, first_s, last_s = part.look[:, :3], part.look[:, 3], part.seen_s[:, 0], part.seen_s[:, 1]
    told = radius_m[:, 0], color, grey, confidence[:, 0], part.variance, first_s, last_s, part.keyframe
    return Surfels(position, normal, *told)


class SurfelCopies:
    """See the module.

    Args:
        most: how many there may be; room that is not needed is never touched, so that it takes no memory.
    """

    def __init__(self, most: int) -> None:
        threes = [np.empty((most, 3), np.float32) for _ in range(3)]
        ones = [np.empty(most, np.float32) for _ in range(4)]
        position, normal, color = threes
        radius, grey, confidence, variance = ones
        seen = np.empty(most), np.empty(most)
        keyframe = np.empty(most, np.int32)
        self._all = Surfels(position, normal, radius, color, grey, confidence, variance, *seen, keyframe)
        self._filled = 0

    def add(self, part: SurfelArrays) -> None:
        """Put a copy of these behind the others."""
        begin, self._filled = self._filled, self._filled + len(part.geometry)
        views = views_of(part)
        for name in Surfels.__slots__:
            getattr(self._all, name)[begin : self._filled] = getattr(views, name)

    def all(self) -> Surfels:
        """Those that were added, in order."""
        return Surfels(*(getattr(self._all, name)[: self._filled] for name in Surfels.__slots__))
