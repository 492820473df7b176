"""Training: frames in numbers, a forest grown on them, and its probabilities calibrated on blocks held out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import PlaceError
from wheelsight.events import RgbdFrame
from wheelsight.geometry import BoolArray, Float32Array, FloatArray, IntArray
from wheelsight.places.calibration import (
    ProbabilityScale,
    calibration_curve,
    fit_scale,
    held_out_folds,
    least_confidence,
    log_loss,
)
from wheelsight.places.describer import Describer, FrameSize, has_depth, size_error, size_of
from wheelsight.places.forest import ForestSettings, grow_forest
from wheelsight.places.model import HeldOutFigures, PlaceModel


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
