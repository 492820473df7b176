"""A contact sheet and a trial with known answers, for tests of their pages."""

from __future__ import annotations

import numpy as np

from wheelsight.core.areas import Area, AreaMap
from wheelsight.places import Forest, ForestSettings, HistogramDescriber, HistogramSettings, PlaceModel
from wheelsight.places.model import HeldOutFigures, ProbabilityScale
from wheelsight_papers import Answers, ContactSheet, Mistake, PlaceTrial

NAMES = ("1", "<lift> & co", "hall")


def example_sheet(count: int = 12, names: tuple[str, ...] = NAMES, *, with_areas: bool = True) -> ContactSheet:
    """Thumbnails a second apart from stamp 100.5 on; the first two areas are proposed for four each."""
    labels = np.where(np.arange(count) < 4, 0, np.where(np.arange(count) < 8, 1, -1))
    shades = [np.full((30, 40, 3), 20 * index % 256, np.uint8) for index in range(count)]
    areas = AreaMap(tuple(_square(name, index) for index, name in enumerate(names))) if with_areas else None
    return ContactSheet(
        "Küche <1>",
        10 * count,
        1.0,
        tuple(shades),
        100.5 + np.arange(float(count)),
        100.0 + np.arange(count + 1.0),
        labels if names else np.full(count, -1),
        names,
        areas,
        np.stack([np.arange(count) / 2, np.zeros(count)], axis=-1) if with_areas else np.full((count, 2), np.nan),
    )


def example_trial(count: int = 90, *, blind: bool = False, perfect: bool = False) -> PlaceTrial:
    """A third of the frames in each area; of the last area every third is taken for the first one."""
    labels = np.arange(count) * 3 // count
    best = labels.copy()
    if not perfect:
        best[(labels == 2) & (np.arange(count) % 3 == 0)] = 0
    confidence = np.linspace(0.5, 0.98, count)
    probabilities = np.tile(((1 - confidence) / 2)[:, None], (1, 3))
    probabilities[np.arange(count), best] = confidence
    has_depth = np.ones(count, bool)
    has_depth[:3] = not blind
    named = np.where((confidence > 0.6) & has_depth, best, -1)
    answers = Answers(5 + np.arange(count) / 5, probabilities, named, has_depth)
    picture = np.full((30, 40, 3), 90, np.uint8)
    mistakes = () if perfect else (Mistake(20.0, 2, 0, 0.9, picture),)
    return PlaceTrial(NAMES, answers, labels, mistakes)


def example_model() -> PlaceModel:
    """A forest of one leaf: the pages only tell of it."""
    none = np.array([-1], np.int32)
    describer = HistogramDescriber(HistogramSettings(bins=2))
    zero = np.zeros(1, np.int32)
    forest = Forest(zero, none, none, zero, np.zeros(1), np.full((1, 3), 1 / 3), describer.size)
    figures = HeldOutFigures(0.91, 0.2, 0.02, 0.3, 0.1, 0.9, 0.95, 0.97, (0.9, 0.9, 0.93))
    settings = ForestSettings(trees=1)
    return PlaceModel(forest, NAMES, describer, ProbabilityScale(), 0.6, np.full(3, 1 / 3), settings, figures)


def _square(name: str, index: int) -> Area:
    left = 2.0 * index
    return Area(name, np.array([[left, -1], [left + 2, -1], [left + 2, 1], [left, 1]]), x_m=left + 1)
