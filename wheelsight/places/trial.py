"""PlaceTrial: a model's answers on a drive that it was not trained on, beside the truth."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from wheelsight.errors import PlaceError
from wheelsight.events import RgbdFrame
from wheelsight.geometry import BoolArray, ByteArray, FloatArray, IntArray
from wheelsight.places.calibration import CalibrationCurve, calibration_curve
from wheelsight.places.model import PlaceModel, Unknown

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
