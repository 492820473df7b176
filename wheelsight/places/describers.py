"""A `Describer` turns a frame into a feature vector: `HistogramDescriber` by histograms, `LayoutDescriber` by cells
of a grid.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Protocol, Self

import numpy as np
from pydantic import model_validator

from wheelsight.core.errors import PlaceError
from wheelsight.core.geometry import Float32Array
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.settings import CHOSEN, Settings, setting
from wheelsight.core.settings.base import checked_settings
from wheelsight.places.describer_kernels import (
    OF_COLOR,
    OF_DEPTH,
    count_frame,
    normals_of,
    sample_color,
    sample_depth,
    tell_color,
    tell_depth,
    tell_profile,
    tell_whole,
)

# Describer: what turns a frame into the numbers that a forest splits on.


FrameSize = tuple[int, int, int, int]
_LEAST_DEPTH_SHARE = 0.01


class Describer(Protocol):
    """Turns a frame into D numbers, always the same way: it has settings, but keeps nothing between frames."""

    @property
    def kind(self) -> str:
        """What saved models call it."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers, in their order."""

    @property
    def size(self) -> int:
        """How many numbers: D."""

    @property
    def settings(self) -> dict[str, Any]:
        """As plain values, to be saved with a model; `describer_from` makes the describer again from them."""

    def describe(self, frame: RgbdFrame) -> Float32Array:
        """The frame in numbers (D,). Raises PlaceError where its images are not such as RgbdFrame promises."""


def size_of(frame: RgbdFrame) -> FrameSize:
    """Height and width of the colour image, then of the depth image.

    Raises:
        PlaceError: the images' shape or type is not what RgbdFrame promises.
    """
    color, depth_m = frame.color, frame.depth_m
    if color.ndim != 3 or color.shape[2] != 3 or color.dtype != np.uint8 or not color.size:
        raise _frame_error(frame, f"colour is {color.shape} of {color.dtype}", "a place needs (H, W, 3) of uint8")
    if depth_m.ndim != 2 or depth_m.dtype != np.float32 or not depth_m.size:
        raise _frame_error(frame, f"depth is {depth_m.shape} of {depth_m.dtype}", "a place needs (H, W) of float32")
    return *color.shape[:2], *depth_m.shape


def has_depth(frame: RgbdFrame) -> bool:
    """Whether enough depth was measured for the area to be told; looks at every eighth row and column."""
    sparse = frame.depth_m[::8, ::8]
    return bool(np.count_nonzero(sparse > 0) >= _LEAST_DEPTH_SHARE * sparse.size)


def size_error(frame: RgbdFrame, size: FrameSize, wanted: FrameSize, whose: str) -> PlaceError:
    """What to raise of a frame whose `size` is not the one `whose` is `wanted`."""

    def words(s: FrameSize) -> str:
        return f"{s[1]}x{s[0]} with depth {s[3]}x{s[2]}"

    problem = f"frame {frame.index} at {frame.stamp_s:.3f} s is {words(size)}; {whose} {words(wanted)}"
    return PlaceError(problem, fix="use one camera at one resolution, or train a model for this one")


def _frame_error(frame: RgbdFrame, problem: str, fix: str) -> PlaceError:
    return PlaceError(f"frame {frame.index} at {frame.stamp_s:.3f} s: {problem}", fix=fix)


# The describers there are, by what saved models call them.


def describer_from(settings: Mapping[str, Any]) -> Describer:
    """The describer that has these `settings`.

    Raises:
        PlaceError: its kind is not known, or a setting is unknown or impossible.
    """
    others = {name: value for name, value in settings.items() if name != "kind"}
    whose, fix = "description settings: ", "train the model again"
    if settings.get("kind") == HistogramDescriber.kind:
        return HistogramDescriber(checked_settings(HistogramSettings, others, PlaceError, whose, fix))
    if settings.get("kind") == LayoutDescriber.kind:
        return LayoutDescriber(checked_settings(LayoutSettings, others, PlaceError, whose, fix))
    fix = f"known: {HistogramDescriber.kind}, {LayoutDescriber.kind}"
    raise PlaceError(f"no description is called {settings.get('kind')!r}", fix=fix)


# HistogramDescriber: a frame as its grey and depth histograms (Trinh et al., section III).


class HistogramSettings(Settings):
    """How images are counted; the paper gives the number of bins and leaves the rest open."""

    bins: int = setting(100, "of each histogram", "Trinh", ge=2, le=256)
    near_m: float = setting(
        0.0, "where the first bin of depth begins; nearer depths fall into it", CHOSEN, ge=0, le=100
    )
    far_m: float = setting(8.0, "where the last bin of depth ends; farther depths fall into it", CHOSEN, gt=0, le=100)
    missing: Literal["first_bin", "own_bin", "ignored"] = setting(
        "first_bin", "where pixels without depth count; an own bin adds a number, and all leave it as it is", CHOSEN
    )
    scale: Literal["share", "counts", "cumulative"] = setting(
        "share", "of all pixels of a histogram, plain counts, or shares summed from the first bin on", CHOSEN
    )
    step_px: int = setting(2, "every how many columns and rows a pixel is counted", CHOSEN, gt=0, le=16)

    @model_validator(mode="after")
    def _range_is_not_empty(self) -> Self:
        if self.near_m >= self.far_m:
            raise ValueError(f"depth range {self.near_m} to {self.far_m} m is empty")
        return self


class HistogramDescriber:
    """Histograms of grey and of depth, side by side: 200 numbers with the default settings.

    Grey is Rec. 601's, 0 to 255 over all bins. NaN, infinite and negative depths count as missing.
    """

    kind: ClassVar[str] = "histograms"

    def __init__(self, settings: HistogramSettings | None = None) -> None:
        self._settings = settings or HistogramSettings()
        self._bin_of_grey = np.arange(256) * self._settings.bins // 256

    @property
    def names(self) -> tuple[str, ...]:
        """As grey 0, grey 1, …, depth 0, depth 1, … and, where it has its own bin, depth missing."""
        numbers = range(self._settings.bins)
        missing = ("depth missing",) if self._settings.missing == "own_bin" else ()
        return (*(f"grey {i}" for i in numbers), *(f"depth {i}" for i in numbers), *missing)

    @property
    def size(self) -> int:
        """How many numbers."""
        return 2 * self._settings.bins + (self._settings.missing == "own_bin")

    @property
    def settings(self) -> dict[str, Any]:
        """As plain values, to be saved with a model."""
        return {"kind": self.kind, **self._settings.model_dump(mode="json")}

    def describe(self, frame: RgbdFrame) -> Float32Array:
        """The frame's histograms (D,). Raises PlaceError where its images are not such as RgbdFrame promises."""
        size_of(frame)
        settings = self._settings
        grey, depth = np.zeros(settings.bins, np.int64), np.zeros(settings.bins + 1, np.int64)
        images = (frame.color, frame.depth_m, settings.step_px)
        count_frame(*images, self._bin_of_grey, settings.near_m, settings.far_m, grey, depth)
        if settings.missing == "first_bin":
            depth[0] += depth[-1]
        if settings.missing != "own_bin":
            depth = depth[:-1]
        return np.concatenate([self._scaled(grey), self._scaled(depth)])

    def _scaled(self, counts: Any) -> Float32Array:
        if self._settings.scale == "counts":
            return np.asarray(counts, np.float32)
        shares = np.asarray(counts / max(int(counts.sum()), 1), np.float32)
        return np.cumsum(shares, dtype=np.float32) if self._settings.scale == "cumulative" else shares


# LayoutDescriber: a frame as what stands where in it: depths, surfaces, light and colour, cell by cell.


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
        of_cell = OF_COLOR + OF_DEPTH
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
        sample_color(frame.color, color)
        sample_depth(frame.depth_m, s.far_m, depth_m)
        normals_of(depth_m, s.focal_in_widths, height / width, normals)
        of_color, of_depth = (np.empty((s.rows, s.columns, n), np.float32) for n in (len(_OF_COLOR), len(_OF_DEPTH)))
        profile = np.empty((self._profile, len(_PROFILE)), np.float32)
        grey, depth, sides = (np.zeros(shape, np.float32) for shape in (s.bins, s.bins, (s.sides, s.sides)))
        tell_color(color, of_color)
        tell_depth(depth_m, normals, s.far_m, of_depth)
        tell_profile(depth_m, s.far_m, profile)
        tell_whole(color, depth_m, normals, s.far_m, grey, depth, sides)
        return np.concatenate([part.ravel() for part in (of_color, of_depth, profile, grey, depth, sides)])
