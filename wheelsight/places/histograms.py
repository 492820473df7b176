"""HistogramDescriber: a frame as its grey and depth histograms (Trinh et al., section III)."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import model_validator

from wheelsight.events import RgbdFrame
from wheelsight.geometry import Float32Array
from wheelsight.places import _kernels as kernels
from wheelsight.places.describer import size_of
from wheelsight.settings import CHOSEN, Settings, setting


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
        kernels.count_frame(*images, self._bin_of_grey, settings.near_m, settings.far_m, grey, depth)
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
