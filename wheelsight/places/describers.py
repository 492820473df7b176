"""A `Describer` turns a frame into a feature vector: `HistogramDescriber` by histograms, `LayoutDescriber` by cells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self, TypeAlias

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
    describe_color,
    describe_depth,
    describe_profile,
    describe_whole,
    normals_of,
    sample_color,
    sample_depth,
)

FrameSize = tuple[int, int, int, int]
_LEAST_DEPTH_SHARE = 0.01


def size_of(frame: RgbdFrame) -> FrameSize:
    """Return height and width of the colour image, then of the depth image.

    Raises PlaceError if the images' shape or type is not as RgbdFrame requires.
    """
    color, depth_m = frame.color, frame.depth_m
    if color.ndim != 3 or color.shape[2] != 3 or color.dtype != np.uint8 or not color.size:
        raise _frame_error(frame, f"colour is {color.shape} of {color.dtype}", "a place needs (H, W, 3) of uint8")
    if depth_m.ndim != 2 or depth_m.dtype != np.float32 or not depth_m.size:
        raise _frame_error(frame, f"depth is {depth_m.shape} of {depth_m.dtype}", "a place needs (H, W) of float32")
    return *color.shape[:2], *depth_m.shape


def has_depth(frame: RgbdFrame) -> bool:
    """Return whether there is enough depth to classify the area; checks every eighth row and column."""
    sparse = frame.depth_m[::8, ::8]
    return bool(np.count_nonzero(sparse > 0) >= _LEAST_DEPTH_SHARE * sparse.size)


def size_error(frame: RgbdFrame, size: FrameSize, wanted: FrameSize, whose: str) -> PlaceError:
    """Return the error of a frame with another size than `wanted`; `whose` names what has that size."""

    def words(s: FrameSize) -> str:
        return f"{s[1]}x{s[0]} with depth {s[3]}x{s[2]}"

    problem = f"frame {frame.index} at {frame.stamp_s:.3f} s is {words(size)}; {whose} {words(wanted)}"
    return PlaceError(problem, fix="use one camera at one resolution, or train a model for this one")


def _frame_error(frame: RgbdFrame, problem: str, fix: str) -> PlaceError:
    return PlaceError(f"frame {frame.index} at {frame.stamp_s:.3f} s: {problem}", fix=fix)


def describer_from(settings: Mapping[str, Any]) -> Describer:
    """Return the describer with these `settings`.

    Raises PlaceError if the kind is unknown, or a setting is unknown or impossible.
    """
    others = {name: value for name, value in settings.items() if name != "kind"}
    whose, fix = "description settings: ", "train the model again"
    if settings.get("kind") == HistogramDescriber.kind:
        return HistogramDescriber(checked_settings(HistogramSettings, others, PlaceError, whose, fix))
    if settings.get("kind") == LayoutDescriber.kind:
        return LayoutDescriber(checked_settings(LayoutSettings, others, PlaceError, whose, fix))
    fix = f"known: {HistogramDescriber.kind}, {LayoutDescriber.kind}"
    raise PlaceError(f"no description is called {settings.get('kind')!r}", fix=fix)


class HistogramSettings(Settings):
    """How pixels are counted; the paper gives the number of bins, and leaves the rest open."""

    bins: int = setting(100, "number of bins of each histogram", "Trinh", ge=2, le=256)
    near_m: float = setting(
        0.0, "begin of the first bin of depth; nearer depths are counted in it", CHOSEN, ge=0, le=100
    )
    far_m: float = setting(8.0, "end of the last bin of depth; farther depths are counted in it", CHOSEN, gt=0, le=100)
    missing: Literal["first_bin", "own_bin", "ignored"] = setting(
        "first_bin", "where pixels without depth are counted; own_bin adds a feature", CHOSEN
    )
    scale: Literal["share", "counts", "cumulative"] = setting(
        "share", "shares of all pixels of a histogram, plain counts, or cumulative shares", CHOSEN
    )
    step_px: int = setting(2, "every how many columns and rows a pixel is counted", CHOSEN, gt=0, le=16)

    @model_validator(mode="after")
    def _range_is_not_empty(self) -> Self:
        if self.near_m >= self.far_m:
            raise ValueError(f"depth range {self.near_m} to {self.far_m} m is empty")
        return self


class HistogramDescriber:
    """Histograms of grey and of depth (Trinh et al., section III): 200 features with the default settings.

    Grey is that of Rec. 601, 0 to 255 over all bins. NaN, infinite and negative depths count as missing.
    """

    kind: ClassVar[str] = "histograms"

    def __init__(self, settings: HistogramSettings | None = None) -> None:
        self._settings = settings or HistogramSettings()
        self._bin_of_grey = np.arange(256) * self._settings.bins // 256

    @property
    def names(self) -> tuple[str, ...]:
        """Names such as grey 0, grey 1, …, depth 0, depth 1, … and, with an own bin, depth missing."""
        numbers = range(self._settings.bins)
        missing = ("depth missing",) if self._settings.missing == "own_bin" else ()
        return (*(f"grey {i}" for i in numbers), *(f"depth {i}" for i in numbers), *missing)

    @property
    def size(self) -> int:
        """Number of features."""
        return 2 * self._settings.bins + (self._settings.missing == "own_bin")

    @property
    def settings(self) -> dict[str, Any]:
        """Plain values saved with a model; `describer_from` makes the describer from them."""
        return {"kind": self.kind, **self._settings.model_dump(mode="json")}

    def describe(self, frame: RgbdFrame) -> Float32Array:
        """Return the histograms (D,). Raises PlaceError if the images are not as RgbdFrame requires."""
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


_OF_COLOR = ("grey", "grey deviation", "grey across", "grey down", "red to green", "yellow to blue")
_OF_DEPTH = ("depth 0.2", "depth 0.5", "depth 0.8", "holes", "normal x", "normal y")
_PROFILE = ("profile 0.5", "profile 0.8")


class LayoutSettings(Settings):
    """Resolution of the description. All is relative to the image's size, so that resolution matters little."""

    rows: int = setting(4, "rows of cells", CHOSEN, ge=1, le=16)
    columns: int = setting(6, "columns of cells", CHOSEN, ge=1, le=16)
    profile: int = setting(16, "vertical strips of the middle third in the depth profile", CHOSEN, ge=1, le=64)
    bins: int = setting(40, "bins of the whole frame's histograms of grey and of depth", CHOSEN, ge=2, le=100)
    sides: int = setting(5, "bins per side of the whole frame's histogram of normals", CHOSEN, ge=2, le=15)
    samples_down: int = setting(120, "rows of the sampling grid", CHOSEN, ge=16, le=480)
    samples_across: int = setting(160, "columns of the sampling grid", CHOSEN, ge=16, le=640)
    far_m: float = setting(8.0, "farther depths are clipped to this", CHOSEN, gt=0, le=100)
    focal_in_widths: float = setting(
        0.9, "approximate focal length of the depth camera in image widths, used for normals", CHOSEN, gt=0, le=100
    )


class LayoutDescriber:
    """Cells with quantiles of depth, holes, normals, grey and colour; a depth profile; histograms of the whole frame.

    Grey is standardised over each frame, and colour is chromaticity, so that brightness has no effect. Holes are
    counted, and left out of means and quantiles; features without any depth are 0.
    """

    kind: ClassVar[str] = "layout"

    def __init__(self, settings: LayoutSettings | None = None) -> None:
        self._settings = s = settings or LayoutSettings()
        # The sides of the grid are multiples of the cells', so that every sample lies in one cell.
        self._down = max(s.samples_down // s.rows, 2) * s.rows
        self._across = max(s.samples_across // s.columns, 2) * s.columns
        self._profile = min(s.profile, self._across)

    @property
    def names(self) -> tuple[str, ...]:
        """Names by cell, row by row; then of the profile; then of the whole frame's histograms."""
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
        """Number of features."""
        s = self._settings
        of_cell = OF_COLOR + OF_DEPTH
        return s.rows * s.columns * of_cell + 2 * self._profile + 2 * s.bins + s.sides**2

    @property
    def settings(self) -> dict[str, Any]:
        """Plain values saved with a model."""
        return {"kind": self.kind, **self._settings.model_dump(mode="json")}

    def describe(self, frame: RgbdFrame) -> Float32Array:
        """Return the features (D,). Raises PlaceError if the images are not as RgbdFrame requires."""
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
        describe_color(color, of_color)
        describe_depth(depth_m, normals, s.far_m, of_depth)
        describe_profile(depth_m, s.far_m, profile)
        describe_whole(color, depth_m, normals, s.far_m, grey, depth, sides)
        return np.concatenate([part.ravel() for part in (of_color, of_depth, profile, grey, depth, sides)])


Describer: TypeAlias = HistogramDescriber | LayoutDescriber
"""Turns a frame into D features, without state between frames."""
