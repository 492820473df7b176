"""What a model of places is worth, as rows of text: for the page and for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wheelsight.pipeline import words
from wheelsight.places import CalibrationCurve, LabelledDrive, PlaceModel, PlaceTrial

AREA_HEAD = ("area", "frames", "right", "named", "right where named", "precision", "mostly taken for")
TRAINING_HEAD = ("area", "frames", "held-out accuracy")
CURVE_HEAD = ("says", "is right", "frames")


def training_rows(model: PlaceModel, drives: Sequence[LabelledDrive]) -> list[tuple[str, ...]]:
    """One row an area, as TRAINING_HEAD names the columns."""
    labels = np.concatenate([drive.labels for drive in drives])
    counts = np.bincount(labels[labels >= 0], minlength=len(model.area_names)).tolist()
    shares = model.figures.area_accuracy
    return [
        (name, f"{count:,}", words.percent(share))
        for name, count, share in zip(model.area_names, counts, shares, strict=True)
    ]


def training_facts(model: PlaceModel) -> list[tuple[str, str]]:
    """What held-out frames say of a model as a whole."""
    figures = model.figures
    before = f"{figures.raw_calibration_error:.3f} before its probabilities were scaled"
    named = f"{words.percent(figures.answered)} of frames, {words.percent(figures.answered_accuracy)} of them rightly"
    return [
        ("out-of-bag accuracy", f"{words.percent(figures.out_of_bag_accuracy)}; neighbouring frames flatter it"),
        ("held-out accuracy", words.percent(figures.accuracy)),
        ("calibration error", f"{figures.calibration_error:.3f}; {before}"),
        ("names an area from", f"a probability of {model.least_confidence:.2f}: {named}"),
    ]


def area_rows(trial: PlaceTrial) -> list[tuple[str, ...]]:
    """One row an area, as AREA_HEAD names the columns."""
    return [_area_row(trial, index) for index in range(len(trial.area_names))]


def confusion_rows(trial: PlaceTrial) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows: frames by true area (rows) and most probable area (columns); "·" for none."""
    counts = trial.confusion
    blind = bool(counts[:, -1].any())
    shown = counts if blind else counts[:, :-1]
    head = ("true area", *trial.area_names, *(("no depth",) if blind else ()))
    cells = [tuple(f"{count:,}" if count else "·" for count in row) for row in shown.tolist()]
    return head, [(name, *row) for name, row in zip(trial.area_names, cells, strict=True)]


def curve_rows(curve: CalibrationCurve) -> list[tuple[str, ...]]:
    """One row for each bin of confidence that has frames."""
    bins = zip(curve.confidence.tolist(), curve.accuracy.tolist(), curve.count.tolist(), strict=True)
    return [(words.percent(said), words.percent(right), f"{count:,}") for said, right, count in bins]


def _area_row(trial: PlaceTrial, index: int) -> tuple[str, ...]:
    true, named = trial.labels == index, trial.answers.named
    taken = trial.confusion[index, :-1].copy()
    precision = _share(int(taken[index]), int(trial.confusion[:, index].sum()))
    right = _share(int(taken[index]), int(true.sum()))
    taken[index] = 0
    other = int(taken.argmax())
    mistaken = f"{trial.area_names[other]} ({int(taken[other]):,})" if taken[other] else ""
    answered = true & (named >= 0)
    return (
        trial.area_names[index],
        f"{int(true.sum()):,}",
        words.percent(right),
        words.percent(_share(int(answered.sum()), int(true.sum()))),
        words.percent(_share(int((answered & (named == index)).sum()), int(answered.sum()))),
        words.percent(precision),
        mistaken,
    )


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
