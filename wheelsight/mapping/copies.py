"""SurfelCopies: surfels gathered from parts of a map, without a second copy of all of them meanwhile."""

from __future__ import annotations

import numpy as np

from wheelsight.mapping._block_kernels import CONFIDENCE, RADIUS, SurfelArrays
from wheelsight.mapping.values import Surfels


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
        into, out = slice(begin, self._filled), self._all
        out.position[into], out.normal[into] = part.geometry[:, :3], part.geometry[:, 4:7]
        out.radius_m[into], out.confidence[into] = part.geometry[:, RADIUS], part.geometry[:, CONFIDENCE]
        out.color[into], out.grey[into] = part.look[:, :3], part.look[:, 3]
        out.variance_m2[into], out.keyframe[into] = part.variance, part.keyframe
        out.first_s[into], out.last_s[into] = part.seen_s[:, 0], part.seen_s[:, 1]

    def all(self) -> Surfels:
        """Those that were added, in order."""
        return Surfels(*(getattr(self._all, name)[: self._filled] for name in Surfels.__slots__))
