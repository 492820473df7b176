"""LayoutDescriber: a frame as what stands where in it: depths, surfaces, light and colour, cell by cell."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from wheelsight.events import RgbdFrame
from wheelsight.geometry import Float32Array
from wheelsight.places import _layout_kernels as kernels
from wheelsight.places.describer import size_of
from wheelsight.settings import CHOSEN, Settings, setting

_OF_COLOR = ("grey", "grey deviation", "grey across", "grey down", "red to green", "yellow to blue")
_OF_DEPTH = ("depth 0.2", "depth 0.5", "depth 0.8", "holes", "normal x", "normal y")
_PROFILE = ("profile 0.5", "profile 0.8")


class LayoutSettings(Settings):
    """How finely a frame is told. All is relative to the image's size, so that resolution matters little."""

    rows: int = setting(4, "of cells", CHOSEN, ge=1, le=16)
    columns: int = setting(6, "of cells", CHOSEN, ge=1, le=16)
    profile: int = setting(16, "upright strips of the middle third whose depth is told", CHOSEN, ge=1, le=64)
    bins: int = setting(40, "of the whole frame's histograms of grey and of depth", CHOSEN, ge=2, le=100)
    sides: int = setting(5, "bins a side of the whole frame's histogram of normals", CHOSEN, ge=2, le=15)
    samples_down: int = setting(120, "rows of the grid at which images are read", CHOSEN, ge=16, le=480)
    samples_across: int = setting(160, "columns of that grid", CHOSEN, ge=16, le=640)
    far_m: float = setting(8.0, "farther depths count as this far", CHOSEN, gt=0, le=100)
    focal_in_widths: float = setting(
        0.9, "the depth camera's focal length in image widths, roughly; it only bends normals", CHOSEN, gt=0, le=100
    )


class LayoutDescriber:
    """Cells with quantiles of depth, holes, normals, grey and colour; a depth profile; histograms of the whole frame.

    Grey is standardised over each frame and colour is told as chromaticity, so that brighter or dimmer light leaves
    it alone. A hole is told as a hole and left out of means and quantiles; what has no depth at all reads 0.
    """

    kind: ClassVar[str] = "layout"

    def __init__(self, settings: LayoutSettings | None = None) -> None:
        self._settings = s = settings or LayoutSettings()
        # The grid's sides are whole multiples of the cells', so that every sample lies in one.
        self._down = max(s.samples_down // s.rows, 2) * s.rows
        self._across = max(s.samples_across // s.columns, 2) * s.columns
        self._profile = min(s.profile, self._across)

    @property
    def names(self) -> tuple[str, ...]:
        """Cell by cell, row by row; then the profile; then the whole frame's histograms."""
        s = self._settings
        cells = [f"cell {row} {column}" for row in range(s.rows) for column in range(s.columns)]
        sides = range(s.sides)
        return (
            *(f"{cell} {what}" for cell in cells for what in _OF_COLOR),
            *(f"{cell} {what}" for cell in cells for what in _OF_DEPTH),
            *(f"{what} {strip}" for strip in range(self._profile) for what in _PROFILE),
            *(f"whole grey {i}" for i in range(s.bins)),
            *(f"whole depth {i}" for i in range(s.bins)),
            *(f"whole normals {down} {across}" for down in sides for across in sides),
        )

    @property
    def size(self) -> int:
        """How many numbers."""
        s = self._settings
        of_cell = kernels.OF_COLOR + kernels.OF_DEPTH
        return s.rows * s.columns * of_cell + 2 * self._profile + 2 * s.bins + s.sides**2

    @property
    def settings(self) -> dict[str, Any]:
        """As plain values, to be saved with a model."""
        return {"kind": self.kind, **self._settings.model_dump(mode="json")}

    def describe(self, frame: RgbdFrame) -> Float32Array:
        """The frame in numbers (D,). Raises PlaceError where its images are not such as RgbdFrame promises."""
        s, (_, _, height, width) = self._settings, size_of(frame)
        color = np.empty((3, self._down, self._across), np.float32)
        depth_m = np.empty((self._down, self._across), np.float32)
        normals = np.empty((2, self._down, self._across), np.float32)
        kernels.sample_color(frame.color, color)
        kernels.sample_depth(frame.depth_m, s.far_m, depth_m)
        kernels.normals_of(depth_m, s.focal_in_widths, height / width, normals)
        of_color, of_depth = (np.empty((s.rows, s.columns, n), np.float32) for n in (len(_OF_COLOR), len(_OF_DEPTH)))
        profile = np.empty((self._profile, len(_PROFILE)), np.float32)
        grey, depth, sides = (np.zeros(shape, np.float32) for shape in (s.bins, s.bins, (s.sides, s.sides)))
        kernels.tell_color(color, of_color)
        kernels.tell_depth(depth_m, normals, s.far_m, of_depth)
        kernels.tell_profile(depth_m, s.far_m, profile)
        kernels.tell_whole(color, depth_m, normals, s.far_m, grey, depth, sides)
        return np.concatenate([part.ravel() for part in (of_color, of_depth, profile, grey, depth, sides)])
