"""Frames and features of places that are made up, for tests that need no recording."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from wheelsight.core.messages import RgbdFrame
from wheelsight.places import ForestSettings, HistogramDescriber, HistogramSettings, PlaceModel
from wheelsight_papers import describe_all, train_places

NAMES = ("corridor", "hall", "lift")
QUICK = ForestSettings(trees=8, folds=3, gap_frames=2)
SMALL_HISTOGRAMS = HistogramDescriber(HistogramSettings(bins=16, step_px=1))


def frame_of(area: int, rng: np.random.Generator, stamp_s: float = 0.0, size: tuple[int, int] = (24, 32)) -> RgbdFrame:
    """A wall whose distance and grey tell the area, noisy, with holes."""
    depth_m = (1.0 + 1.5 * area) + 0.3 * rng.standard_normal(size)
    depth_m[rng.random(size) < 0.1] = 0
    grey = np.clip(60 + 50 * area + 20 * rng.standard_normal((*size, 1)), 0, 255)
    color = np.repeat(grey, 3, axis=2).astype(np.uint8)
    return RgbdFrame(stamp_s, color, np.maximum(depth_m, 0).astype(np.float32), round(30 * stamp_s))


def drive_through(
    areas: Sequence[int], each: int, rng: np.random.Generator, size: tuple[int, int] = (24, 32)
) -> tuple[list[RgbdFrame], np.ndarray]:
    """Frames and labels of a drive that spends `each` frames in one area after the other."""
    labels = np.repeat(np.asarray(areas), each)
    return [frame_of(int(area), rng, index / 30, size) for index, area in enumerate(labels)], labels


@cache
def trained() -> PlaceModel:
    """A model of the three areas."""
    frames, labels = drive_through((0, 1, 2), 30, np.random.default_rng(11))
    described = describe_all(frames, SMALL_HISTOGRAMS)
    return train_places(described.features, labels, NAMES, SMALL_HISTOGRAMS, QUICK, frame_size=described.frame_size)


def overlapped(rng: np.random.Generator, frames: int, spread: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    """Features (N, 5) and labels (N,) of three classes that overlap, in runs."""
    labels = np.arange(frames) * 9 // frames % 3
    features = spread * rng.standard_normal((frames, 5))
    features[np.arange(frames), labels] += 2.0
    return features.astype(np.float32), labels
