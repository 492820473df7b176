"""Probabilities that mean what they say: held-out blocks, a scale fitted on them, and when to answer *unknown*."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry import BoolArray, FloatArray, IntArray

_STARTS = ((1.0, 1e-3), (1.0, 0.05), (0.5, 0.05), (2.0, 0.02), (1.0, 0.3))
_THRESHOLDS = np.arange(50, 100) / 100
_FEWEST_ANSWERS = 20
_LEAST_PROBABILITY = 1e-12


@dataclass(frozen=True, slots=True)
class ProbabilityScale:
    """Makes a forest's probabilities those of being right: softmax(log((1 - blend) p + blend / A) / temperature).

    The blend keeps a forest from being certain where all of its few trees agree by chance; the temperature sharpens
    (below 1) or flattens the rest. The order of the areas stays.
    """

    temperature: float = 1.0
    blend: float = 0.0

    def apply(self, probabilities: ArrayLike) -> FloatArray:
        """Scaled probabilities (..., A) of a forest's (..., A)."""
        p = np.asarray(probabilities, float)
        mixed = np.maximum((1 - self.blend) * p + self.blend / p.shape[-1], _LEAST_PROBABILITY)
        powers = (mixed / mixed.max(axis=-1, keepdims=True)) ** (1 / self.temperature)
        scaled: FloatArray = powers / powers.sum(axis=-1, keepdims=True)
        return scaled


def fit_scale(probabilities: FloatArray, labels: IntArray) -> ProbabilityScale:
    """The scale of least log loss on probabilities (N, A) of frames that the forest was not trained on.

    Args:
        probabilities: of the forest.
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
    """Mean of -ln p of the true area, over N frames with probabilities (N, A)."""
    true = probabilities[np.arange(len(labels)), labels]
    return float(-np.log(np.maximum(true, _LEAST_PROBABILITY)).mean())


@dataclass(frozen=True, eq=False)
class CalibrationCurve:
    """How often answers are right, by how sure they are.

    Attributes:
        confidence: (B,) mean of the highest probability in each bin that has frames.
        accuracy: (B,) share of these frames whose most probable area is the true one.
        count: (B,) of frames.
    """

    confidence: FloatArray
    accuracy: FloatArray
    count: IntArray

    @property
    def error(self) -> float:
        """Expected calibration error: mean distance of confidence and accuracy, by frames."""
        return float(np.average(np.abs(self.confidence - self.accuracy), weights=self.count))

    @property
    def is_overconfident(self) -> bool:
        """Whether answers are right less often than they say, over all frames."""
        return bool(np.average(self.confidence - self.accuracy, weights=self.count) > 0)


def calibration_curve(probabilities: ArrayLike, labels: ArrayLike, bins: int = 10) -> CalibrationCurve:
    """The curve of N ≥ 1 frames with probabilities (N, A) and true areas (N,), in `bins` bins of equal width."""
    p, true = np.asarray(probabilities, float), np.asarray(labels)
    confidence, is_right = p.max(axis=1), p.argmax(axis=1) == true
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    count = np.bincount(place, minlength=bins)
    sums = (np.bincount(place, weights=values, minlength=bins)[count > 0] for values in (confidence, is_right))
    confidence, accuracy = (values / count[count > 0] for values in sums)
    return CalibrationCurve(confidence, accuracy, count[count > 0])


def least_confidence(probabilities: FloatArray, labels: IntArray, wanted_accuracy: float) -> float:
    """The lowest confidence from which answers are right as often as wanted; where none is, the one that errs least.

    At least 0.5: what is less probable than all else together is not named. Confidences that too few frames (N, A)
    reach to say anything are left out.
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
    """Which of N frames in order of time to train on (N,) and to try (N,), fold by fold.

    Neighbouring frames are alike, so that a forest tried on frames strewn among its own would seem better than it is.
    With several drives, whole drives are held out. Else each area's frames are cut into blocks of about `block_frames`,
    at least one a fold, which are dealt to the folds in turn; up to `gap_frames` on both sides of a block held out, at
    most half as many as it has, are left out of training. Frames with label -1 are in none.
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
