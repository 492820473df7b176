"""`train_places` trains a place model and calibrates it on held-out blocks.

`try_places` evaluates a model on another drive.
"""

from __future__ import annotations

import csv
import io
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import PlaceError
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, Int32Array, IntArray
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.runtime import needed
from wheelsight.places.describers import Describer, FrameSize, has_depth, size_error, size_of
from wheelsight.places.model import (
    LEAST_PROBABILITY,
    Forest,
    ForestSettings,
    HeldOutFigures,
    PlaceModel,
    ProbabilityScale,
    Unknown,
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


_NO_CHILD = -1
# Below this product of trees and frames, starting threads takes longer than growing trees.
_WORTH_THREADS = 20_000
_STARTS = ((1.0, 1e-3), (1.0, 0.05), (0.5, 0.05), (2.0, 0.02), (1.0, 0.3))
_THRESHOLDS = np.arange(50, 100) / 100
_FEWEST_ANSWERS = 20


def grow_forest(
    features: Float32Array, labels: IntArray, area_count: int, settings: ForestSettings, out_of_bag: bool = False
) -> tuple[Forest, float]:
    """Return a forest trained on features (N, D) and areas (N,), and its out-of-bag accuracy, or NaN if not requested.

    Each tree is trained on frames drawn with replacement. Splits maximise the information gain, eq. 6 of Trinh et al.,
    over √D features drawn at each node. The out-of-bag accuracy uses, for each frame, the trees trained without it;
    frames in all trees are left out. Similar neighbouring frames make it too optimistic; held-out blocks do not.

    Raises ConfigError if scikit-learn is not installed.
    """
    grown = needed("sklearn.ensemble").RandomForestClassifier(
        settings.trees,
        criterion="entropy",
        max_depth=settings.max_depth,
        min_samples_leaf=settings.min_leaf,
        max_features="sqrt",
        oob_score=out_of_bag,
        random_state=settings.seed,
        n_jobs=-1 if settings.trees * len(features) > _WORTH_THREADS else 1,
    )
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Some inputs do not have OOB scores")
        grown.fit(features, labels)
    accuracy = float("nan")
    if out_of_bag:
        votes = np.nan_to_num(grown.oob_decision_function_)
        is_voted = votes.sum(axis=1) > 0
        named = np.asarray(grown.classes_)[votes.argmax(axis=1)]
        accuracy = float((named == labels)[is_voted].mean()) if is_voted.any() else float("nan")
    return flatten(grown, area_count), accuracy


def flatten(grown: Any, area_count: int) -> Forest:
    """Return the Forest of a fitted RandomForestClassifier; areas without training frames have a share of 0."""
    trees = [estimator.tree_ for estimator in grown.estimators_]
    roots = np.cumsum([0, *(tree.node_count for tree in trees[:-1])]).astype(np.int32)

    def children(name: str) -> Int32Array:
        sides = [getattr(tree, name) for tree in trees]
        moved = [np.where(side < 0, _NO_CHILD, side + root) for side, root in zip(sides, roots, strict=True)]
        return np.concatenate(moved).astype(np.int32)

    counted = np.concatenate([tree.value[:, 0, :] for tree in trees])
    share = np.zeros((len(counted), area_count))
    share[:, np.asarray(grown.classes_)] = counted / counted.sum(axis=1, keepdims=True)
    return Forest(
        roots,
        children("children_left"),
        children("children_right"),
        np.maximum(np.concatenate([tree.feature for tree in trees]), 0).astype(np.int32),
        np.concatenate([tree.threshold for tree in trees]),
        share,
        int(grown.n_features_in_),
    )


def fit_scale(probabilities: FloatArray, labels: IntArray) -> ProbabilityScale:
    """Return the scale with the least log loss on probabilities (N, A) of frames not used in training.

    Args:
        labels: (N,) indices of the true areas.
    """
    from scipy.optimize import minimize

    def scale_of(parameters: FloatArray) -> ProbabilityScale:
        return ProbabilityScale(float(np.exp(parameters[0])), float(1 / (1 + np.exp(-parameters[1]))))

    def loss(parameters: FloatArray) -> float:
        return log_loss(scale_of(parameters).apply(probabilities), labels)

    starts = [np.array([np.log(t), np.log(b / (1 - b))]) for t, b in _STARTS]
    bounds = [(np.log(0.1), np.log(10.0)), (-9.0, 3.0)]
    found = minimize(loss, min(starts, key=loss), method="L-BFGS-B", bounds=bounds)
    return scale_of(min([found.x, *starts], key=loss))


def log_loss(probabilities: FloatArray, labels: IntArray) -> float:
    """Return the mean of -ln p of the true area, over N frames with probabilities (N, A)."""
    true = probabilities[np.arange(len(labels)), labels]
    return float(-np.log(np.maximum(true, LEAST_PROBABILITY)).mean())


@dataclass(frozen=True, eq=False)
class CalibrationCurve:
    """Accuracy by confidence.

    Attributes:
        confidence: (B,) mean of the highest probability in each bin with frames.
        accuracy: (B,) share of these frames whose most probable area is the true one.
        count: (B,) number of frames.
    """

    confidence: FloatArray
    accuracy: FloatArray
    count: IntArray

    @property
    def error(self) -> float:
        """Expected calibration error: mean difference of confidence and accuracy, weighted by frames."""
        return float(np.average(np.abs(self.confidence - self.accuracy), weights=self.count))

    @property
    def is_overconfident(self) -> bool:
        """Whether the mean confidence exceeds the accuracy, over all frames."""
        return bool(np.average(self.confidence - self.accuracy, weights=self.count) > 0)


def calibration_curve(probabilities: ArrayLike, labels: ArrayLike, bins: int = 10) -> CalibrationCurve:
    """Return the curve of N ≥ 1 frames with probabilities (N, A) and true areas (N,), in `bins` bins of equal width."""
    p, true = np.asarray(probabilities, float), np.asarray(labels)
    confidence, is_right = p.max(axis=1), p.argmax(axis=1) == true
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    count = np.bincount(place, minlength=bins)
    sums = (np.bincount(place, weights=values, minlength=bins)[count > 0] for values in (confidence, is_right))
    confidence, accuracy = (values / count[count > 0] for values in sums)
    return CalibrationCurve(confidence, accuracy, count[count > 0])


def least_confidence(probabilities: FloatArray, labels: IntArray, wanted_accuracy: float) -> float:
    """Return the lowest confidence with the wanted accuracy above it; if there is none, the one with the best accuracy.

    It is at least 0.5, so that a named area is more probable than all others together. Confidences that too few frames
    (N, A) reach are left out.
    """
    confidence, is_right = probabilities.max(axis=1), probabilities.argmax(axis=1) == labels
    best, best_accuracy = float(_THRESHOLDS[0]), -1.0
    for threshold in _THRESHOLDS:
        answered = confidence >= threshold
        if np.count_nonzero(answered) < _FEWEST_ANSWERS:
            break
        accuracy = float(is_right[answered].mean())
        if accuracy >= wanted_accuracy:
            return float(threshold)
        if accuracy > best_accuracy:
            best, best_accuracy = float(threshold), accuracy
    return best


def held_out_folds(
    labels: IntArray, folds: int, block_frames: int, gap_frames: int, drives: IntArray | None = None
) -> list[tuple[BoolArray, BoolArray]]:
    """Return training frames (N,) and test frames (N,) of each fold, for N frames in order of time.

    Neighbouring frames are alike, so that a random split would be too optimistic. With several drives, whole drives are
    held out. Otherwise, each area's frames are cut into blocks of about `block_frames`, at least one per fold, and
    assigned to the folds in turn. Up to `gap_frames` on both sides of a held-out block, at most half its length, are
    not used in training. Frames with label -1 are in no fold.
    """
    labelled = labels >= 0
    if drives is not None and len(np.unique(drives)) > 1:
        numbers = np.unique(drives, return_inverse=True)[1] % folds
        return [(labelled & (numbers != k), labelled & (numbers == k)) for k in np.unique(numbers)]
    split = []
    for fold in range(folds):
        tried, beside = np.zeros(len(labels), bool), np.zeros(len(labels), bool)
        for area in np.unique(labels[labelled]):
            frames = np.flatnonzero(labels == area)
            rounds = max(round(len(frames) / (folds * block_frames)), 1)
            for block in np.array_split(frames, folds * rounds)[fold::folds]:
                tried[block] = True
                gap = min(gap_frames, len(block) // 2)
                for side in (block - gap, block + gap):
                    beside[side[(side >= 0) & (side < len(labels))]] = True
        split.append((labelled & ~tried & ~beside, tried))
    return [(trained, tried) for trained, tried in split if tried.any() and trained.any()]
