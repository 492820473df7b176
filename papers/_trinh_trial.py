"""Forests, both ways of rectifying and their errors, for `trinh_rectification.py`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np
from _trinh_drives import HISTOGRAMS, LAYOUT, DescribedDrive

from wheelsight.core.areas import AreaMap
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import FloatArray, IntArray
from wheelsight.core.messages import WheelTicks
from wheelsight.estimation import AreaRectifier, OdometryTerm, Weights
from wheelsight.places import Describer, ForestSettings, PlaceModel
from wheelsight.wheels import WheelOdometry
from wheelsight_papers import PaperRectifier, TrainingDrive, calibration_curve, fit_weights, grow_forest, train_places

ODOMETRY_TERMS: tuple[OdometryTerm, ...] = get_args(OdometryTerm)
DESCRIBERS: dict[str, Describer] = {"histograms": HISTOGRAMS, "layout": LAYOUT}
# The filter is told of the wheels so often, which is often enough for its turns to be short.
_READINGS_A_STEP = 5


@dataclass(frozen=True)
class Errors:
    """Distances from the truth over all frames of some drives, metres; of forests, how they answered.

    Attributes:
        mean_m: the mean distance, which the paper calls RMSE.
        rms_m: the root of the mean of squares.
        accuracy: share of frames whose most probable area is the true one; NaN without a forest.
        calibration_error: expected; NaN likewise.
        weights: of eq. 5: alpha, beta, gamma where told, beta where not; empty elsewhere.
    """

    mean_m: float
    rms_m: float
    accuracy: float = float("nan")
    calibration_error: float = float("nan")
    weights: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Trial:
    """What one set of training and test drives gave.

    Attributes:
        errors: by name of the method.
        unrectified_training_m: mean distance of the wheels alone on the training drives.
        tracks: by method, (N, 2) metres on the first test drive.
    """

    errors: dict[str, Errors]
    unrectified_training_m: float
    tracks: dict[str, FloatArray] = field(default_factory=dict)


def run_trial(
    areas: AreaMap,
    wheels: Wheels,
    training: Sequence[DescribedDrive],
    test: Sequence[DescribedDrive],
    *,
    most_trees: int = 6,
    full_trees: int = 64,
    terms: Sequence[OdometryTerm] = ODOMETRY_TERMS,
    seed: int = 0,
) -> Trial:
    """All methods: wheels alone, eq. 5 with 1 to `most_trees` trees, the probabilistic way.

    The forests and the weights of eq. 5 see training drives only.
    """
    found: dict[str, list[FloatArray]] = {"wheels": [drive.odometry(wheels) for drive in test]}
    answered: dict[str, Any] = {}
    for trees in range(1, most_trees + 1):
        settings = ForestSettings(trees=trees, seed=seed)
        model = train(areas, training, "histograms", settings)
        told = held_out_answers(areas, training, settings)
        for term in terms:
            weights = weights_of(areas, wheels, training, told, term)
            name = f"eq. 5, {term}, {trees}"
            found[name] = [rectified_by_paper(areas, wheels, drive, model, weights, term) for drive in test]
            answered[name] = (*answers_of(model, "histograms", test), _plain(weights))
        if trees == most_trees:
            name = f"probabilistic, histograms, {trees}"
            found[name] = [rectified_by_probability(areas, wheels, drive, model, "histograms") for drive in test]
            answered[name] = (*answers_of(model, "histograms", test), ())
    for description in DESCRIBERS:
        model = train(areas, training, description, ForestSettings(trees=full_trees, seed=seed))
        name = f"probabilistic, {description}, {full_trees}"
        found[name] = [rectified_by_probability(areas, wheels, drive, model, description) for drive in test]
        answered[name] = (*answers_of(model, description, test), ())
    errors = {name: Errors(*distances(tracks, test), *answered.get(name, ())) for name, tracks in found.items()}
    alone_m, _ = distances([drive.odometry(wheels) for drive in training], training)
    return Trial(errors, alone_m, {name: tracks[0] for name, tracks in found.items()})


def distances(tracks: Sequence[FloatArray], drives: Sequence[DescribedDrive]) -> tuple[float, float]:
    """Mean and root mean square of the distances from truth over all frames, metres."""
    apart = np.concatenate([np.hypot(*(track - drive.truth).T) for track, drive in zip(tracks, drives, strict=True)])
    return float(apart.mean()), float(np.sqrt((apart**2).mean()))


def train(areas: AreaMap, training: Sequence[DescribedDrive], description: str, settings: ForestSettings) -> PlaceModel:
    """A model of all training drives; its probabilities are calibrated on whole drives held out."""
    numbers = np.repeat(np.arange(len(training)), [len(drive.labels) for drive in training])
    return train_places(
        np.concatenate([getattr(drive, description) for drive in training]),
        np.concatenate([drive.labels for drive in training]),
        areas.names,
        DESCRIBERS[description],
        settings,
        drives=numbers,
    )


def held_out_answers(areas: AreaMap, training: Sequence[DescribedDrive], settings: ForestSettings) -> list[IntArray]:
    """(N,) areas of each training drive's frames by a forest of the other drives: as good as on drives unseen."""
    answers = []
    for k, drive in enumerate(training):
        others = [other for j, other in enumerate(training) if j != k]
        features = np.concatenate([other.histograms for other in others])
        labels = np.concatenate([other.labels for other in others])
        shown = labels >= 0
        forest, _ = grow_forest(features[shown], labels[shown], len(areas), settings)
        answers.append(_best(forest.probabilities(drive.histograms), drive))
    return answers


def weights_of(
    areas: AreaMap, wheels: Wheels, training: Sequence[DescribedDrive], told: Sequence[IntArray], term: OdometryTerm
) -> Weights:
    """Eq. 5's weights of least mean distance on the training drives."""
    drives = [
        TrainingDrive(drive.odometry(wheels), told_areas, drive.truth)
        for drive, told_areas in zip(training, told, strict=True)
    ]
    return fit_weights(areas, drives, term)


def answers_of(model: PlaceModel, description: str, drives: Sequence[DescribedDrive]) -> tuple[float, float]:
    """Accuracy and expected calibration error over all frames of the drives that lie in an area."""
    labels = np.concatenate([drive.labels for drive in drives])
    probabilities = np.concatenate([model.predict_features(getattr(drive, description)) for drive in drives])
    judged = labels >= 0
    right = probabilities.argmax(axis=1) == labels
    return float(right[judged].mean()), calibration_curve(probabilities[judged], labels[judged]).error


def rectified_by_paper(
    areas: AreaMap, wheels: Wheels, drive: DescribedDrive, model: PlaceModel, weights: Weights, term: OdometryTerm
) -> FloatArray:
    """(N, 2) metres at the frames, by eq. 5; each frame has the most probable area, as in the paper."""
    told = _best(model.predict_features(drive.histograms), drive)
    reckoned = drive.reckoned(wheels)
    T_odom_base = reckoned.at(np.clip(drive.stamps_s, *reckoned.stamps_s[[0, -1]]))
    rectifier = PaperRectifier(areas, drive.T_map_start, weights, term)
    before, track = np.eye(4), []
    for stamp_s, area, T in zip(drive.stamps_s, told, T_odom_base, strict=True):
        rectifier.predict(np.linalg.inv(before) @ T)
        before = T
        estimate = rectifier.update(float(stamp_s), None if area < 0 else int(area))
        assert estimate.T_odom_body is not None
        track.append(estimate.T_odom_body[:2, 3])
    return np.array(track)


def rectified_by_probability(
    areas: AreaMap, wheels: Wheels, drive: DescribedDrive, model: PlaceModel, description: str
) -> FloatArray:
    """(N, 2) metres at the frames, by the probabilistic way with its own settings."""
    rectifier = AreaRectifier(areas, drive.T_map_start, area_shares=model.area_shares)
    odometry = WheelOdometry(wheels)
    probabilities = model.predict_features(getattr(drive, description))
    readings = [WheelTicks(stamp_s, int(left), int(right)) for stamp_s, left, right in drive.ticks.tolist()]
    track, last, way = [], 0, None
    for k, stamp_s in enumerate(drive.stamps_s.tolist()):
        until = int(np.searchsorted(drive.ticks[:, 0], stamp_s, side="right"))
        for number in range(last, until):
            step = odometry.process(readings[number]).step
            if step is not None:
                way = step if way is None else way.then(step)
            if way is not None and (number % _READINGS_A_STEP == 0 or number == until - 1):
                rectifier.predict(way.T_before_now, way.covariance)
                way = None
        last = until
        found = rectifier.update(stamp_s, probabilities[k] if drive.has_depth[k] else None)
        assert found.T_odom_body is not None
        track.append(found.T_odom_body[:2, 3])
    return np.array(track)


def _best(probabilities: FloatArray, drive: DescribedDrive) -> IntArray:
    """(N,) the most probable area, -1 where a frame has no depth."""
    return np.where(drive.has_depth, probabilities.argmax(axis=1), -1)


def _plain(weights: Weights) -> tuple[float, ...]:
    return (*(float(value) for value in weights.with_area.as_array()), weights.without_area.beta)
