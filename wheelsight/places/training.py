"""`train_places` trains a place model and calibrates its probabilities on held-out blocks. `try_places` evaluates a
model on another drive.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Sequence
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

# Training: frames in numbers, a forest grown on them, and its probabilities calibrated on blocks held out.


@dataclass(frozen=True, eq=False)
class DescribedFrames:
    """Frames in numbers, in order of time.

    Attributes:
        features: (N, D).
        stamps_s: (N,).
        has_depth: (N,) whether enough depth was measured for the area to be told.
        frame_size: of the images: height and width of colour, then of depth.
    """

    features: Float32Array
    stamps_s: FloatArray
    has_depth: BoolArray
    frame_size: FrameSize


def describe_all(frames: Iterable[RgbdFrame], describer: Describer) -> DescribedFrames:
    """Frames in numbers, one image in memory at a time.

    Raises:
        PlaceError: no frame at all, or images that change in size.
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
    """Grow a forest, and calibrate its probabilities on blocks that it was not shown.

    Args:
        features: (N, D) frames in order of time, described by `describer`.
        labels: (N,) indices of their areas, -1 for none.
        area_names: (A,) of the areas.
        describer: that `features` come from; saved with the model.
        settings: of the forest.
        frame_size: that frames to be predicted must have (`DescribedFrames.frame_size`); None: any.
        drives: (N,) which drive each frame is of, where there are several: whole drives are then held out.

    Raises:
        PlaceError: fewer than two areas, an area without frames (by name), or arrays that do not belong together.
    """
    settings = settings or ForestSettings()
    described, wanted = np.asarray(features, np.float32), np.asarray(labels)
    _check_training(described, wanted, area_names, describer)
    scale, least, figures = _held_out(described, wanted, len(area_names), settings, drives)
    shown = wanted >= 0
    forest, out_of_bag = grow_forest(described[shown], wanted[shown], len(area_names), settings, out_of_bag=True)
    shares = np.bincount(wanted[shown], minlength=len(area_names)) / np.count_nonzero(shown)
    held_out = HeldOutFigures(**figures, out_of_bag_accuracy=out_of_bag)
    names = tuple(area_names)
    return PlaceModel(forest, names, describer, scale, least, shares, settings, held_out, frame_size)


def _held_out(
    features: Float32Array, labels: IntArray, area_count: int, settings: ForestSettings, drives: ArrayLike | None
) -> tuple[ProbabilityScale, float, dict[str, Any]]:
    """Scale, least confidence and figures by forests that were not shown what they are tried on."""
    numbers = None if drives is None else np.asarray(drives)
    folds = held_out_folds(labels, settings.folds, settings.block_frames, settings.gap_frames, numbers)
    tried, raw, fold_of = _try_out(features, labels, area_count, settings, folds)
    return _calibrate(raw, labels[tried], fold_of, settings)


def _try_out(
    features: Float32Array,
    labels: IntArray,
    area_count: int,
    settings: ForestSettings,
    folds: list[tuple[BoolArray, BoolArray]],
) -> tuple[IntArray, FloatArray, IntArray]:
    """Indices (K,) of the frames held out, the probabilities (K, A) of forests not shown them, and their folds (K,)."""
    tried, raw, fold_of = [], [], []
    for number, (shown, held_out) in enumerate(folds):
        forest, _ = grow_forest(features[shown], labels[shown], area_count, settings)
        tried.append(np.flatnonzero(held_out))
        raw.append(forest.probabilities(features[held_out]))
        fold_of.append(np.full(len(tried[-1]), number))
    return np.concatenate(tried), np.concatenate(raw), np.concatenate(fold_of)


def _calibrate(
    raw: FloatArray, labels: IntArray, fold_of: IntArray, settings: ForestSettings
) -> tuple[ProbabilityScale, float, dict[str, Any]]:
    """Scale and least confidence of all blocks held out, and figures in which no block is scaled by itself."""
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


def _check_training(features: Float32Array, labels: IntArray, names: Sequence[str], describer: Describer) -> None:
    if features.ndim != 2 or features.shape[1] != describer.size:
        raise PlaceError(
            f"features are {features.shape}", fix=f"{describer.kind} tells {describer.size} numbers a frame"
        )
    if labels.shape != (len(features),) or labels.dtype.kind not in "iu":
        raise PlaceError(
            f"{len(features)} frames have labels {labels.shape} of {labels.dtype}", fix="one index a frame"
        )
    if not np.isfinite(features).all():
        raise PlaceError(f"features of frame {int(np.argmin(np.isfinite(features).all(axis=1)))} are not finite")
    if len(names) < 2 or len(set(names)) < len(names):
        raise PlaceError(f"{len(names)} areas cannot be told apart", fix="give at least two, each with its own name")
    if len(labels) and not -1 <= labels.min() <= labels.max() < len(names):
        wrong = int(labels.min() if labels.min() < -1 else labels.max())
        raise PlaceError(f"label {wrong} is no area's", fix=f"0 to {len(names) - 1}, or -1 for none")
    missing = [name for index, name in enumerate(names) if not (labels == index).any()]
    if missing:
        raise PlaceError(f"area {missing[0]!r} has no training frames", fix="drive through it, or leave the area out")


# PlaceTrial: a model's answers on a drive that it was not trained on, beside the truth.


_MISTAKES_KEPT = 6


@dataclass(frozen=True, eq=False)
class Answers:
    """A model's answers on N frames in order of time.

    Attributes:
        stamps_s: (N,).
        probabilities: (N, A).
        named: (N,) index of the area named, -1: unknown.
        has_depth: (N,) whether the frame had depth, without which it is not looked at.
    """

    stamps_s: FloatArray
    probabilities: FloatArray
    named: IntArray
    has_depth: BoolArray

    def __len__(self) -> int:
        return len(self.stamps_s)


@dataclass(frozen=True, eq=False)
class Mistake:
    """A frame that was named wrongly: true and named area by index, how sure the model was, and what it saw."""

    stamp_s: float
    true: int
    named: int
    confidence: float
    color: ByteArray


@dataclass(frozen=True, eq=False)
class PlaceTrial:
    """What a model answers on frames whose areas are known.

    Attributes:
        area_names: (A,).
        answers: on all frames.
        labels: (N,) indices of the true areas, -1: in none, or not known; such frames count nowhere.
        mistakes: frames named wrongly, the surest of each pair of areas, surest first.
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
        """(N,) whether the most probable area is the true one; frames without depth count as wrong."""
        best = self.answers.probabilities.argmax(axis=1)
        right: BoolArray = (best == self.labels) & self.answers.has_depth & self.is_judged
        return right

    @property
    def accuracy(self) -> float:
        """Share of judged frames whose most probable area is the true one."""
        return float(self.is_right[self.is_judged].mean())

    @property
    def answered(self) -> float:
        """Share of judged frames whose area is named."""
        return float((self.answers.named >= 0)[self.is_judged].mean())

    @property
    def answered_accuracy(self) -> float:
        """Share of the judged frames named that are right; NaN where none is."""
        named = self.is_judged & (self.answers.named >= 0)
        return float((self.answers.named == self.labels)[named].mean()) if named.any() else float("nan")

    @property
    def confusion(self) -> IntArray:
        """(A, A + 1) judged frames by true area and most probable area; the last column is of frames without depth."""
        areas = len(self.area_names)
        best = np.where(self.answers.has_depth, self.answers.probabilities.argmax(axis=1), areas)
        counts = np.zeros((areas, areas + 1), np.int64)
        np.add.at(counts, (self.labels[self.is_judged], best[self.is_judged]), 1)
        return counts

    @property
    def curve(self) -> CalibrationCurve:
        """How often answers are right by how sure they are, over judged frames; its error says how far that is off."""
        return calibration_curve(self.answers.probabilities[self.is_judged], self.labels[self.is_judged])


def answer_all(model: PlaceModel, frames: Iterable[RgbdFrame]) -> Answers:
    """A model's answers on frames, one image in memory at a time. Raises PlaceError as `PlaceModel.predict`."""
    return _collect(model, frames, lambda frame, probabilities: None)


def try_places(model: PlaceModel, frames: Iterable[RgbdFrame], label_at: Callable[[float], int]) -> PlaceTrial:
    """A model's answers on frames beside the truth.

    Args:
        model: to be tried.
        frames: in order of time.
        label_at: the index of the true area at a frame's stamp, in the model's order; -1 for none.

    Raises:
        PlaceError: no frame has an area, or images that are not as the model needs them.
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
    """Answers as text: stamp_s, area (empty: unknown), and a column with the probability of each area.

    `read_labels` reads it too, so that a model's answers can be checked by hand and trained on.
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
    rows = list(_rows(model, frames, on_answer))
    if not rows:
        raise PlaceError("there are no frames to look at", fix="give a recording with colour and depth")
    stamps_s, probabilities, named, seen = zip(*rows, strict=True)
    return Answers(np.array(stamps_s), np.array(probabilities), np.array(named, np.int64), np.array(seen))


def _rows(
    model: PlaceModel, frames: Iterable[RgbdFrame], on_answer: Callable[[RgbdFrame, FloatArray], None]
) -> Iterator[tuple[float, FloatArray, int, bool]]:
    for frame in frames:
        match = model.predict(frame)
        has_depth = match.reason is not Unknown.NO_DEPTH
        if has_depth:
            on_answer(frame, match.probabilities)
        yield frame.stamp_s, match.probabilities, -1 if match.area_index is None else match.area_index, has_depth
