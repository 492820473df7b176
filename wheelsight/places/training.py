"""`train_places` trains a place model and calibrates it on held-out blocks.

`try_places` evaluates a model on another drive.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import PlaceError
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from wheelsight.core.messages import RgbdFrame
from wheelsight.places.describers import Describer, FrameSize, has_depth, size_error, size_of
from wheelsight.places.model import (
    CalibrationCurve,
    ForestSettings,
    HeldOutFigures,
    PlaceModel,
    ProbabilityScale,
    Unknown,
    calibration_curve,
    fit_scale,
    grow_forest,
    held_out_folds,
    least_confidence,
    log_loss,
)


@dataclass(frozen=True, eq=False)
class DescribedFrames:
    """Features of frames, in order of time.

    Attributes:
        features: (N, D).
        stamps_s: (N,).
        has_depth: (N,) whether there is enough depth to classify the area.
        frame_size: height and width of colour, then of depth.
    """

    features: Float32Array
    stamps_s: FloatArray
    has_depth: BoolArray
    frame_size: FrameSize


def describe_all(frames: Iterable[RgbdFrame], describer: Describer) -> DescribedFrames:
    """Return the features of frames, with one image in memory at a time.

    Raises:
        PlaceError: there are no frames, or the images change in size.
    """
    size: FrameSize | None = None
    features, stamps_s, seen = [], [], []
    for frame in frames:
        found = size_of(frame)
        size = size or found
        if found != size:
            raise size_error(frame, found, size, "those before were")
        features.append(describer.describe(frame))
        stamps_s.append(frame.stamp_s)
        seen.append(has_depth(frame))
    if size is None:
        raise PlaceError("there are no frames to describe", fix="give a recording with colour and depth")
    return DescribedFrames(np.array(features), np.array(stamps_s), np.array(seen), size)


def train_places(
    features: ArrayLike,
    labels: ArrayLike,
    area_names: Sequence[str],
    describer: Describer,
    settings: ForestSettings | None = None,
    *,
    frame_size: FrameSize | None = None,
    drives: ArrayLike | None = None,
) -> PlaceModel:
    """Return a model trained on features, with probabilities calibrated on held-out blocks.

    Args:
        features: (N, D) of frames in order of time, by `describer`.
        labels: (N,) indices of their areas, -1 for none.
        area_names: (A,) names of the areas.
        describer: describer of the features; saved with the model.
        settings: settings of the forest.
        frame_size: required image size in prediction (`DescribedFrames.frame_size`); None: any.
        drives: (N,) drive of each frame, if there are several: whole drives are then held out.

    Raises:
        PlaceError: there are fewer than two areas, an area has no frames, or the arrays do not match.
    """
    settings = settings or ForestSettings()
    described, wanted = np.asarray(features, np.float32), np.asarray(labels)
    _check_training(described, wanted, area_names, describer)
    numbers = None if drives is None else np.asarray(drives)
    folds = held_out_folds(wanted, settings.folds, settings.block_frames, settings.gap_frames, numbers)
    tried, raw, fold_of = [], [], []
    for number, (trained, held) in enumerate(folds):
        of_fold, _ = grow_forest(described[trained], wanted[trained], len(area_names), settings)
        tried.append(np.flatnonzero(held))
        raw.append(of_fold.probabilities(described[held]))
        fold_of.append(np.full(len(tried[-1]), number))
    labels_tried = wanted[np.concatenate(tried)]
    scale, least, figures = _calibrate(np.concatenate(raw), labels_tried, np.concatenate(fold_of), settings)
    shown = wanted >= 0
    forest, out_of_bag = grow_forest(described[shown], wanted[shown], len(area_names), settings, out_of_bag=True)
    shares = np.bincount(wanted[shown], minlength=len(area_names)) / np.count_nonzero(shown)
    held_out = HeldOutFigures(**figures, out_of_bag_accuracy=out_of_bag)
    names = tuple(area_names)
    return PlaceModel(forest, names, describer, scale, least, shares, settings, held_out, frame_size)


def _check_training(features: Float32Array, labels: IntArray, names: Sequence[str], describer: Describer) -> None:
    if features.ndim != 2 or features.shape[1] != describer.size:
        raise PlaceError(
            f"features are {features.shape}", fix=f"{describer.kind} gives {describer.size} numbers per frame"
        )
    if labels.shape != (len(features),) or labels.dtype.kind not in "iu":
        raise PlaceError(
            f"{len(features)} frames have labels {labels.shape} of {labels.dtype}", fix="one index a frame"
        )
    if not np.isfinite(features).all():
        raise PlaceError(f"features of frame {int(np.argmin(np.isfinite(features).all(axis=1)))} are not finite")
    if len(names) < 2 or len(set(names)) < len(names):
        raise PlaceError(f"{len(names)} areas cannot be distinguished", fix="give at least two, each with its own name")
    if len(labels) and not -1 <= labels.min() <= labels.max() < len(names):
        wrong = int(labels.min() if labels.min() < -1 else labels.max())
        raise PlaceError(f"label {wrong} is not an area index", fix=f"0 to {len(names) - 1}, or -1 for none")
    missing = [name for index, name in enumerate(names) if not (labels == index).any()]
    if missing:
        raise PlaceError(f"area {missing[0]!r} has no training frames", fix="drive through it, or leave the area out")


def _calibrate(
    raw: FloatArray, labels: IntArray, fold_of: IntArray, settings: ForestSettings
) -> tuple[ProbabilityScale, float, dict[str, Any]]:
    """Return scale and least confidence by all held-out blocks, and figures with each block scaled by the others."""
    scale = fit_scale(raw, labels)
    honest = np.empty_like(raw)
    for fold in np.unique(fold_of):
        of_fold = fold_of == fold
        others = fit_scale(raw[~of_fold], labels[~of_fold]) if (~of_fold).any() else scale
        honest[of_fold] = others.apply(raw[of_fold])
    least = least_confidence(honest, labels, settings.wanted_accuracy)
    answered, is_right = honest.max(axis=1) >= least, honest.argmax(axis=1) == labels
    return (
        scale,
        least,
        {
            "accuracy": float(is_right.mean()),
            "log_loss": log_loss(honest, labels),
            "calibration_error": calibration_curve(honest, labels).error,
            "raw_log_loss": log_loss(raw, labels),
            "raw_calibration_error": calibration_curve(raw, labels).error,
            "area_accuracy": tuple(_share(is_right[labels == area]) for area in range(raw.shape[1])),
            "answered": float(answered.mean()),
            "answered_accuracy": _share(is_right[answered]),
        },
    )


def _share(is_right: BoolArray) -> float:
    return float(is_right.mean()) if len(is_right) else float("nan")


_MISTAKES_KEPT = 6


@dataclass(frozen=True, eq=False)
class Answers:
    """A model's answers on N frames in order of time.

    Attributes:
        stamps_s: (N,).
        probabilities: (N, A).
        named: (N,) index of the named area, -1 if unknown.
        has_depth: (N,) whether the frame has depth; without it, it is not classified.
    """

    stamps_s: FloatArray
    probabilities: FloatArray
    named: IntArray
    has_depth: BoolArray

    def __len__(self) -> int:
        return len(self.stamps_s)


@dataclass(frozen=True, eq=False)
class Mistake:
    """A misclassified frame: true and named area by index, confidence, and the image."""

    stamp_s: float
    true: int
    named: int
    confidence: float
    color: ByteArray


@dataclass(frozen=True, eq=False)
class PlaceTrial:
    """A model's answers on frames of known areas.

    Attributes:
        area_names: (A,).
        answers: answers on all frames.
        labels: (N,) indices of the true areas, -1 for none or unknown; such frames are not counted.
        mistakes: misclassified frames, the most confident one of each pair of areas, in that order.
    """

    area_names: tuple[str, ...]
    answers: Answers
    labels: IntArray
    mistakes: tuple[Mistake, ...] = ()

    @property
    def is_judged(self) -> BoolArray:
        """(N,) which frames have a true area."""
        return self.labels >= 0

    @property
    def is_right(self) -> BoolArray:
        """(N,) whether the most probable area is the true one; False for frames without depth."""
        best = self.answers.probabilities.argmax(axis=1)
        right: BoolArray = (best == self.labels) & self.answers.has_depth & self.is_judged
        return right

    @property
    def accuracy(self) -> float:
        """Share of judged frames whose most probable area is the true one."""
        return float(self.is_right[self.is_judged].mean())

    @property
    def answered(self) -> float:
        """Share of judged frames with a named area."""
        return float((self.answers.named >= 0)[self.is_judged].mean())

    @property
    def answered_accuracy(self) -> float:
        """Share of judged frames with a named area that are right; NaN if there are none."""
        named = self.is_judged & (self.answers.named >= 0)
        return float((self.answers.named == self.labels)[named].mean()) if named.any() else float("nan")

    @property
    def confusion(self) -> IntArray:
        """(A, A + 1) judged frames by true and most probable area; the last column has frames without depth."""
        areas = len(self.area_names)
        best = np.where(self.answers.has_depth, self.answers.probabilities.argmax(axis=1), areas)
        counts = np.zeros((areas, areas + 1), np.int64)
        np.add.at(counts, (self.labels[self.is_judged], best[self.is_judged]), 1)
        return counts

    @property
    def curve(self) -> CalibrationCurve:
        """Accuracy by confidence, over judged frames."""
        return calibration_curve(self.answers.probabilities[self.is_judged], self.labels[self.is_judged])


def answer_all(model: PlaceModel, frames: Iterable[RgbdFrame]) -> Answers:
    """Return a model's answers on frames, with one image in memory at a time. Raises PlaceError as
    `PlaceModel.predict`.
    """
    return _collect(model, frames, lambda frame, probabilities: None)


def try_places(model: PlaceModel, frames: Iterable[RgbdFrame], label_at: Callable[[float], int]) -> PlaceTrial:
    """Return a model's answers on frames with the true areas.

    Args:
        model: model to evaluate.
        frames: frames in order of time.
        label_at: returns the index of the true area at a stamp, in the model's order; -1 for none.

    Raises:
        PlaceError: no frame has an area, or the images do not suit the model.
    """
    surest: dict[tuple[int, int], Mistake] = {}

    def keep_mistake(frame: RgbdFrame, probabilities: FloatArray) -> None:
        true, best = label_at(frame.stamp_s), int(probabilities.argmax())
        confidence = float(probabilities[best])
        before = surest.get((true, best))
        if true >= 0 and best != true and (before is None or before.confidence < confidence):
            surest[true, best] = Mistake(frame.stamp_s, true, best, confidence, frame.color)

    answers = _collect(model, frames, keep_mistake)
    labels = np.array([label_at(stamp_s) for stamp_s in answers.stamps_s.tolist()], np.int64)
    if not (labels >= 0).any():
        raise PlaceError("no frame has an area, so that nothing can be judged", fix="check the labels")
    kept = sorted(surest.values(), key=lambda mistake: -mistake.confidence)[:_MISTAKES_KEPT]
    return PlaceTrial(model.area_names, answers, labels, tuple(kept))


def predictions_csv(answers: Answers, names: Sequence[str]) -> str:
    """Return answers as CSV: stamp_s, area (empty if unknown), and a column with the probability of each area.

    `read_labels` accepts it too, so that answers can be corrected by hand and used for training.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["stamp_s", "area", *(f"p({name})" for name in names)])
    for stamp_s, named, row in zip(answers.stamps_s, answers.named.tolist(), answers.probabilities, strict=True):
        table.writerow([f"{stamp_s:.6f}", names[named] if named >= 0 else "", *(f"{p:.4f}" for p in row)])
    return text.getvalue()


def _collect(
    model: PlaceModel, frames: Iterable[RgbdFrame], on_answer: Callable[[RgbdFrame, FloatArray], None]
) -> Answers:
    rows = []
    for frame in frames:
        match = model.predict(frame)
        has_depth = match.reason is not Unknown.NO_DEPTH
        if has_depth:
            on_answer(frame, match.probabilities)
        named = -1 if match.area_index is None else match.area_index
        rows.append((frame.stamp_s, match.probabilities, named, has_depth))
    if not rows:
        raise PlaceError("there are no frames to look at", fix="give a recording with colour and depth")
    stamps_s, probabilities, areas, seen = zip(*rows, strict=True)
    return Answers(np.array(stamps_s), np.array(probabilities), np.array(areas, np.int64), np.array(seen))
