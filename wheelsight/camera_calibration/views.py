"""What is seen of a board in one view, before anything is calibrated."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wheelsight.geometry import BoolArray, FloatArray, IntArray

SENSORS = ("structured-light", "tof", "stereo")
RAW_DISPARITY = "raw-disparity"


@dataclass(frozen=True, eq=False, slots=True)
class Corners:
    """Corners of a board in an image: their numbers (N,), row by row from 0, and pixels (N, 2)."""

    ids: IntArray
    px: FloatArray

    def only(self, kept: BoolArray) -> Corners:
        """Those of them."""
        return Corners(self.ids[kept], self.px[kept])

    def turned(self, count: int) -> Corners:
        """The same seen as the board that is turned by half."""
        return Corners(count - 1 - self.ids, self.px)


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """One board before the cameras, still.

    Attributes:
        name: for messages.
        color: corners in the colour image.
        infrared: corners in the infrared image, where there is one.
        reading: (H, W) the depth image as it is read, metres along the axis or raw disparities; 0 and NaN: none.
    """

    name: str
    color: Corners
    infrared: Corners | None = None
    reading: NDArray[Any] | None = None


@dataclass(frozen=True, eq=False, slots=True)
class ViewSet:
    """Views of one board by one pair of cameras.

    Attributes:
        views: those in which the board was found.
        color_size, depth_size: width and height of the images; the latter None where there is neither depth nor
            infrared.
        left_out: names of other views, and why.
        is_disparity: whether readings are raw disparities of Kinect v1.
    """

    views: tuple[View, ...]
    color_size: tuple[int, int]
    depth_size: tuple[int, int] | None = None
    left_out: tuple[tuple[str, str], ...] = field(default=())
    is_disparity: bool = False

    @property
    def has_depth(self) -> bool:
        """Whether some view has a depth image."""
        return any(view.reading is not None for view in self.views)

    @property
    def has_infrared(self) -> bool:
        """Whether some view has corners in an infrared image."""
        return any(view.infrared is not None for view in self.views)


@dataclass(frozen=True, eq=False, slots=True)
class DepthCells:
    """Readings of the board's plane in one view: pixels (N, 2) and readings (N,), means of small cells.

    `scatter` (N,) is the standard deviation of a pixel about the plane in each, of inverse depths or raw disparities.
    """

    px: FloatArray
    reading: FloatArray
    scatter: FloatArray

    def only(self, kept: BoolArray | IntArray) -> DepthCells:
        """Those of them."""
        return DepthCells(self.px[kept], self.reading[kept], self.scatter[kept])

    @staticmethod
    def none() -> DepthCells:
        """Of a view that shows no plane."""
        return DepthCells(np.empty((0, 2)), np.empty(0), np.empty(0))
