"""What goes into a surfel map and comes out of it: surfels, views, and what was done."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from wheelsight.geometry import Float32Array, FloatArray, Int32Array
from wheelsight.views import PredictedView

# In which positions and normals are, and that files say.
FRAME = "map"


@dataclass(frozen=True, slots=True)
class FusedFrame:
    """What fusing one frame did.

    Attributes:
        matched: surfels that pixels were averaged into.
        added: new surfels.
        removed: that were in free space, never became stable, or left their block.
        merged: duplicates that became one with another.
        dropped: given up for want of room, and new ones that found none.
    """

    matched: int
    added: int
    removed: int
    merged: int
    dropped: int


@dataclass(frozen=True, slots=True)
class MapStatus:
    """How a map stands.

    Attributes:
        surfels: all; stable: those sure to be there; active: those seen within the window of time.
        dropped: how many were given up so far for want of room.
        memory_bytes: of all arrays.
        resting: how many of all are on the disk, since they are far from the camera.
    """

    surfels: int
    stable: int
    active: int
    dropped: int
    memory_bytes: int
    resting: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Surfels:
    """Surfels as flat arrays, copied out of a map.

    Attributes:
        position: (n, 3) float32 in metres, in the map frame.
        normal: (n, 3) float32, of length 1, towards where they were seen from.
        radius_m: (n,) float32.
        color: (n, 3) float32 red, green, blue from 0 to 255; -1 where unknown.
        grey: (n,) float32 from 0 to 255; -1 where unknown.
        confidence: (n,) float32, how many frames saw it, up to 100.
        variance_m2: (n,) float32 of the position along the normal.
        first_s, last_s: (n,) when first and last seen.
        keyframe: (n,) int32 number of that which each hangs on, -1 for none.
    """

    position: Float32Array
    normal: Float32Array
    radius_m: Float32Array
    color: Float32Array
    grey: Float32Array
    confidence: Float32Array
    variance_m2: Float32Array
    first_s: FloatArray
    last_s: FloatArray
    keyframe: Int32Array


Parts = Callable[[], Iterable[Surfels]]
"""Gives the surfels of a map, a part after the other, as often as it is called: all at once they are a second map."""


@dataclass(frozen=True, slots=True, eq=False)
class ColoredView(PredictedView):
    """A predicted view with `color` (h, w, 3) float32 from 0 to 255; grey where only that is known, else -1."""

    color: Float32Array
