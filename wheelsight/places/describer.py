"""Describer: what turns a frame into the numbers that a forest splits on."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from wheelsight.errors import PlaceError
from wheelsight.events import RgbdFrame
from wheelsight.geometry import Float32Array

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
