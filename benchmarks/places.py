"""`python -m benchmarks.places [RECORDING …]`: how quick places are named, and how often rightly on real frames."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from sklearn.cluster import KMeans
from sklearn.ensemble import RandomForestClassifier

from benchmarks import machine
from benchmarks.table import Sheet
from benchmarks.targets import Target
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import OpenOptions, open_recording
from wheelsight.places import (
    Describer,
    ForestSettings,
    HistogramDescriber,
    HistogramSettings,
    LayoutDescriber,
    PlaceModel,
)
from wheelsight_papers import calibration_curve, describe_all, train_places

TRAINING_FRAMES = 1433  # as many as in the paper
AREAS = 8
FRAME_LIMIT_MS = 1.0
LEAST_SPEEDUP = 5.0
TRAINING_LIMIT_S = 5.0
DESCRIBERS: tuple[Describer, ...] = (HistogramDescriber(), LayoutDescriber())
_REPEATS = 40
_TRAINING_REPEATS = 3
# A turn by a radian changes a view about as much as a metre's way.
_METRES_PER_RADIAN = 1.0
_DIMMED = 0.6
_SECOND, _APART = 30, 5  # frames
_HEADS: tuple[str, ...] = ("recording", "trained on", "description", "areas", "tested", "unseen", "accuracy", "dimmed")
_HEADS += ("named", "right", "calibration")


@dataclass(frozen=True, slots=True)
class PlaceTimes:
    """Medians over repeats, of one 640×480 frame.

    Attributes:
        describer: which description.
        describe_ms: the frame in numbers.
        predict_ms: description, forest and calibration: `PlaceModel.predict`.
        plain_ms: the same forest asked by scikit-learn's predict_proba about numpy.histogram's grey and depth
            histograms of all pixels.
        training_s: growing and calibrating on 1 433 frames.
    """

    describer: str
    describe_ms: float
    predict_ms: float
    plain_ms: float
    training_s: float

    @property
    def speedup(self) -> float:
        """How many times quicker than the plain way."""
        return self.plain_ms / self.predict_ms


@dataclass(frozen=True, slots=True)
class RealAccuracy:
    """How a model did on a part of a recording that it was not trained on.

    Attributes:
        recording: its name.
        split: which part it was trained on.
        describer: which description.
        areas: how many the training part visits.
        tested_areas: how many of these the test part visits too; where it is one, accuracy says little.
        unseen: share of test frames in areas the training part does not visit; left out of the figures below.
        accuracy: share of test frames whose most probable area is the true one.
        dimmed_accuracy: the same with the test frames' colours at 0.6 of their brightness.
        answered: share of test frames whose area is named at all.
        answered_accuracy: share of those that are right.
        calibration_error: of the probabilities.
        held_out_accuracy: what the model expected of itself.
    """

    recording: str
    split: str
    describer: str
    areas: int
    tested_areas: int
    unseen: float
    accuracy: float
    dimmed_accuracy: float
    answered: float
    answered_accuracy: float
    calibration_error: float
    held_out_accuracy: float


def measure_places() -> list[PlaceTimes]:
    """Time each description with a forest of the default settings; compiled kernels are warmed first."""
    frames = [_made_frame(area, number) for number in range(4) for area in range(AREAS)]
    return [_times(describer, frames) for describer in DESCRIBERS]


def _times(describer: Describer, frames: Sequence[RgbdFrame]) -> PlaceTimes:
    features, labels = _many(describe_all(frames, describer).features)
    names = [f"area {i}" for i in range(AREAS)]
    model = train_places(features, labels, names, describer)
    frame, plain_ask = frames[0], _plain_way(frames[0], model)
    return PlaceTimes(
        describer.kind,
        1e3 * _median_s(lambda: describer.describe(frame)),
        1e3 * _median_s(lambda: model.predict(frame)),
        1e3 * _median_s(plain_ask),
        _median_s(lambda: train_places(features, labels, names, describer), _TRAINING_REPEATS),
    )


def _plain_way(frame: RgbdFrame, model: PlaceModel) -> Callable[[], object]:
    """What anyone would write first: numpy.histogram of both images, and predict_proba of a forest of that size."""
    settings, bins = model.settings, HistogramSettings().bins

    def describe(color: ByteArray, depth_m: Float32Array) -> FloatArray:
        grey = color @ np.array([0.299, 0.587, 0.114])
        counts = np.histogram(grey, bins, (0, 256))[0], np.histogram(depth_m, bins, (0, 8))[0]
        shares: FloatArray = np.concatenate(counts) / grey.size
        return shares

    rng = np.random.default_rng(0)
    histograms = np.abs(describe(frame.color, frame.depth_m) + 0.002 * rng.standard_normal((TRAINING_FRAMES, 2 * bins)))
    forest = RandomForestClassifier(settings.trees, criterion="entropy", max_depth=settings.max_depth, random_state=0)
    forest.fit(histograms, np.arange(TRAINING_FRAMES) % AREAS)
    return lambda: forest.predict_proba(describe(frame.color, frame.depth_m)[None])


def _made_frame(area: int, number: int) -> RgbdFrame:
    """A corridor's end at a distance that the area shows, under noise, with holes."""
    rng = np.random.default_rng((area, number))
    across, down = np.meshgrid(np.linspace(-1, 1, 640), np.linspace(-1, 1, 480))
    depth_m = np.minimum(1 / np.maximum(np.maximum(abs(across), abs(down)), 0.1), 1.5 + 0.6 * area)
    depth_m = np.where(rng.random(depth_m.shape) < 0.1, 0, depth_m + 0.02 * rng.standard_normal(depth_m.shape))
    grey = 40 + 20 * area + 30 * across[..., None] + rng.normal(0, 12, (480, 640, 3))
    return RgbdFrame(float(number), np.clip(grey, 0, 255).astype(np.uint8), depth_m.astype(np.float32), number)


def _many(features: Float32Array) -> tuple[Float32Array, IntArray]:
    """As many frames as the paper trains on: those described, in runs of one area, with noise of a tenth."""
    rng = np.random.default_rng(0)
    labels = np.arange(TRAINING_FRAMES) * AREAS // TRAINING_FRAMES
    chosen = features[labels + AREAS * rng.integers(0, len(features) // AREAS, TRAINING_FRAMES)]
    noise = 0.1 * features.std(axis=0) * rng.standard_normal(chosen.shape)
    return (chosen + noise).astype(np.float32), labels


def areas_by_clustering(truth: Trajectory, count: int, seed: int = 0) -> IntArray:
    """Areas (N,) of a hand-held camera's poses: clusters of where it was and where it looked."""
    looking = truth.T_frame_body[:, :3, 2]
    places = np.hstack([truth.positions_m, _METRES_PER_RADIAN * looking])
    labels: IntArray = KMeans(count, n_init=10, random_state=seed).fit(places).labels_.astype(np.int64)
    return labels


def measure_real(
    folder: Path, describers: Sequence[Describer] = DESCRIBERS, areas: int = 6, camera: str | None = None
) -> list[RealAccuracy]:
    """Train on the first 60 % of a recording and test on the rest; the same backwards; and on every other second.

    Where a recording goes where it has not been, the first two test few of the areas; the third tests all, on views
    at least a sixth of a second from any that was shown. Frames without a true pose are left out. `camera` names the
    calibration, where the recording does not tell.
    """
    recording = open_recording(folder, OpenOptions(camera=camera))
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    if recording.ground_truth is None:
        raise SystemExit(f"{folder}: without ground truth there are no areas to test")
    poses = recording.ground_truth.at([frame.stamp_s for frame in frames], max_gap_s=0.1)
    known = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    frames = [frames[i] for i in known]
    stamps_s = np.array([frame.stamp_s for frame in frames])
    labels = areas_by_clustering(Trajectory(stamps_s, poses[known]), areas)
    figures = []
    for describer in describers:
        features = describe_all(frames, describer).features
        dimmed = describe_all(map(_dimmed, frames), describer).features
        for split, shown, tested in _splits(len(frames)):
            figures.append(_accuracy(recording.name, split, describer, (features, dimmed), labels, shown, tested))
    return figures


def _splits(n: int) -> list[tuple[str, BoolArray, BoolArray]]:
    """What to train on (N,) and to test on (N,), by name."""
    frame, cut = np.arange(n), n * 6 // 10
    first, last = frame < cut, frame >= n - cut
    odd, phase = frame // _SECOND % 2 == 1, frame % _SECOND
    apart = (phase >= _APART) & (phase < _SECOND - _APART)
    return [("first 60 %", first, ~first), ("last 60 %", last, ~last), ("every other second", ~odd, odd & apart)]


def _dimmed(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, color=(_DIMMED * frame.color).astype(np.uint8))


def _accuracy(
    recording: str,
    split: str,
    describer: Describer,
    features: tuple[Float32Array, Float32Array],
    labels: IntArray,
    shown: BoolArray,
    tested: BoolArray,
) -> RealAccuracy:
    visited = np.unique(labels[shown])
    index = np.full(labels.max() + 1, -1)
    index[visited] = np.arange(len(visited))
    names = [f"area {i}" for i in visited]
    model = train_places(features[0][shown], index[labels[shown]], names, describer, ForestSettings())
    unseen = float((index[labels[tested]] < 0).mean())
    tested = tested & (index[labels] >= 0)
    (probabilities, of_dimmed), true = (model.predict_features(f[tested]) for f in features), index[labels[tested]]
    is_right, answered = probabilities.argmax(axis=1) == true, probabilities.max(axis=1) >= model.least_confidence
    return RealAccuracy(
        recording,
        split,
        describer.kind,
        len(visited),
        len(np.unique(true)),
        unseen,
        float(is_right.mean()),
        float((of_dimmed.argmax(axis=1) == true).mean()),
        float(answered.mean()),
        float(is_right[answered].mean()) if answered.any() else float("nan"),
        calibration_curve(probabilities, true).error,
        model.figures.accuracy,
    )


def places_sheet(times: Sequence[PlaceTimes]) -> Sheet:
    """One row a description."""
    header = ("description", "in numbers ms", "named ms", "numpy, scikit-learn ms", "faster", "training s")
    rows = tuple(
        (
            t.describer,
            f"{t.describe_ms:.2f}",
            f"{t.predict_ms:.2f}",
            f"{t.plain_ms:.1f}",
            f"{t.speedup:.0f}×",
            f"{t.training_s:.1f}",
        )
        for t in times
    )
    return Sheet("Places: a 640×480 frame on one core; training on 1,433 frames", header, rows)


def judge_places(times: Sequence[PlaceTimes]) -> list[Target]:
    """What naming a place may take."""
    return [
        target
        for t in times
        for target in (
            Target(f"places, {t.describer}: description and forest, one core", FRAME_LIMIT_MS, t.predict_ms, "ms", 2),
            Target(f"places, {t.describer}: faster than plainly", LEAST_SPEEDUP, t.speedup, "×", 0, is_least=True),
            Target(f"places, {t.describer}: training on 1,433 frames", TRAINING_LIMIT_S, t.training_s, "s"),
        )
    ]


def accuracy_sheet(accuracies: Sequence[RealAccuracy]) -> Sheet:
    """One row a recording, split and description."""
    rows = []
    for a in accuracies:
        shares = (a.unseen, a.accuracy, a.dimmed_accuracy, a.answered, a.answered_accuracy, a.calibration_error)
        words = (a.recording, a.split, a.describer, str(a.areas), str(a.tested_areas))
        rows.append((*words, *(f"{share:.2f}" for share in shares)))
    return Sheet("Places named on real recordings", _HEADS, tuple(rows))


def _median_s(work: Callable[[], object], repeats: int = _REPEATS) -> float:
    def once() -> float:
        begin = time.perf_counter()
        work()
        return time.perf_counter() - begin

    once()
    return statistics.median(once() for _ in range(repeats))


def main() -> None:
    """Print the times, and the accuracy on each recording named."""
    times = measure_places()
    accuracies = [figure for folder in sys.argv[1:] for figure in measure_real(*_folder_and_camera(folder))]
    sheets = [places_sheet(times), *([accuracy_sheet(accuracies)] if accuracies else [])]
    if machine.is_busy():
        print("The machine is busy: times will be too long.", file=sys.stderr)
    for sheet in sheets:
        print(sheet.to_markdown())


def _folder_and_camera(text: str) -> tuple[Path, Sequence[Describer], int, str | None]:
    folder, _, camera = text.partition(":")
    return Path(folder), DESCRIBERS, 6, camera or None


if __name__ == "__main__":
    main()
