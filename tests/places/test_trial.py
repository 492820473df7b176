"""PlaceTrial: counts that a plain loop confirms, on answers that are known."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from places.made import drive_through, frame_of, trained
from sklearn.metrics import confusion_matrix

from wheelsight.core.errors import PlaceError
from wheelsight.core.messages import RgbdFrame
from wheelsight_papers import PlaceTrial, answer_all, predictions_csv, read_labels, try_places


def trial_of(rng: np.random.Generator, each: int = 15) -> PlaceTrial:
    frames, labels = drive_through((0, 1, 2, 1), each, rng)
    labels[2] = -1
    labels[each - 1] = 1  # wrongly labelled, so that the model is wrong there
    frames[4] = RgbdFrame(frames[4].stamp_s, frames[4].color, np.zeros_like(frames[4].depth_m), 4)
    by_stamp = dict(zip([frame.stamp_s for frame in frames], labels.tolist(), strict=True))
    return try_places(trained(), frames, by_stamp.__getitem__)


def test_the_confusion_matrix_is_scikit_learns_with_a_column_of_blind_frames(rng: np.random.Generator) -> None:
    trial = trial_of(rng)
    seen = trial.is_judged & trial.answers.has_depth
    best = trial.answers.probabilities.argmax(axis=1)
    expected = confusion_matrix(trial.labels[seen], best[seen], labels=[0, 1, 2])
    np.testing.assert_array_equal(trial.confusion[:, :3], expected)
    assert trial.confusion[:, 3].tolist() == [1, 0, 0]
    assert trial.confusion.sum() == 59


def test_accuracies_are_shares_of_judged_frames(rng: np.random.Generator) -> None:
    trial = trial_of(rng)
    right = named = named_rightly = 0
    for label, p, name, sees in zip(
        trial.labels, trial.answers.probabilities, trial.answers.named, trial.answers.has_depth, strict=True
    ):
        if label >= 0:
            right += sees and p.argmax() == label
            named += name >= 0
            named_rightly += name == label
    assert trial.accuracy == pytest.approx(right / 59)
    assert trial.answered == pytest.approx(named / 59)
    assert trial.answered_accuracy == pytest.approx(named_rightly / named)
    assert 0.9 < trial.accuracy < 1


def test_blind_frames_are_answered_with_unknown(rng: np.random.Generator) -> None:
    answers = trial_of(rng).answers
    assert (answers.named[4], bool(answers.has_depth[4])) == (-1, False)
    np.testing.assert_allclose(answers.probabilities[4], 1 / 3)
    np.testing.assert_allclose(answers.probabilities.sum(axis=1), 1)


def test_the_surest_mistake_of_each_pair_is_kept_with_its_picture(rng: np.random.Generator) -> None:
    trial = trial_of(rng)
    pairs = [(mistake.true, mistake.named) for mistake in trial.mistakes]
    assert (1, 0) in pairs
    assert len(pairs) == len(set(pairs))
    mistake = trial.mistakes[pairs.index((1, 0))]
    index = int(np.flatnonzero(trial.answers.stamps_s == mistake.stamp_s)[0])
    assert mistake.confidence == trial.answers.probabilities[index, 0]
    assert mistake.color.shape == (24, 32, 3)
    assert [m.confidence for m in trial.mistakes] == sorted((m.confidence for m in trial.mistakes), reverse=True)


def test_a_drive_without_areas_or_frames_cannot_be_judged(rng: np.random.Generator) -> None:
    with pytest.raises(PlaceError, match="no frame has an area, so that nothing can be judged"):
        try_places(trained(), [frame_of(0, rng)], lambda stamp_s: -1)
    with pytest.raises(PlaceError, match="there are no frames to look at"):
        answer_all(trained(), [])


def test_predictions_are_a_table_that_serves_as_labels(rng: np.random.Generator, tmp_path: Path) -> None:
    answers = trial_of(rng).answers
    path = tmp_path / "predictions.csv"
    path.write_text(predictions_csv(answers, ("a", "b, c", "d")))
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert list(rows[0]) == ["stamp_s", "area", "p(a)", "p(b, c)", "p(d)"]
    assert rows[4]["area"] == ""
    assert sum(float(rows[0][f"p({name})"]) for name in ("a", "b, c", "d")) == pytest.approx(1, abs=2e-4)
    labels = read_labels(path).of_frames(answers.stamps_s, ("a", "b, c", "d"))
    np.testing.assert_array_equal(labels, answers.named)
