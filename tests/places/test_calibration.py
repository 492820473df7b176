"""Probabilities: scaled they lose no log loss, curves and thresholds by hand, and blocks that do not touch."""

from __future__ import annotations

import numpy as np
import pytest
from places.made import overlapped
from sklearn.metrics import log_loss as log_loss_of_sklearn

from wheelsight.places import ForestSettings, ProbabilityScale
from wheelsight_papers import calibration_curve, fit_scale, grow_forest, log_loss
from wheelsight_papers.training import held_out_folds, least_confidence


def test_no_temperature_and_no_blend_leave_probabilities_as_they_are(rng):
    p = rng.dirichlet([1, 1, 1], 20)
    np.testing.assert_allclose(ProbabilityScale().apply(p), p, rtol=1e-9)


def test_a_scale_is_the_softmax_it_says(rng):
    p = rng.dirichlet([1, 1, 1, 1], 20)
    logits = np.log(0.9 * p + 0.1 / 4) / 1.7
    np.testing.assert_allclose(
        ProbabilityScale(1.7, 0.1).apply(p), np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True), rtol=1e-9
    )


def test_a_scale_keeps_the_order_and_sums_to_one_even_of_certainty():
    p = np.array([[1.0, 0.0, 0.0], [0.5, 0.3, 0.2]])
    for scale in (ProbabilityScale(0.1, 0.0), ProbabilityScale(5.0, 0.5), ProbabilityScale(1.0, 1.0)):
        scaled = scale.apply(p)
        np.testing.assert_allclose(scaled.sum(axis=1), 1)
        assert (np.diff(scaled, axis=1) <= 1e-15).all()


def test_log_loss_is_scikit_learns(rng):
    p, labels = rng.dirichlet([1, 1, 1], 50), rng.integers(0, 3, 50)
    assert log_loss(p, labels) == pytest.approx(log_loss_of_sklearn(labels, p, labels=[0, 1, 2]))


@pytest.mark.parametrize("trees", [1, 3, 32])
def test_calibration_improves_what_a_forest_says_of_overlapping_classes(rng, trees):
    shown, tried, tested = (overlapped(rng, 600) for _ in range(3))
    forest, _ = grow_forest(*shown, 3, ForestSettings(trees=trees))
    scale = fit_scale(forest.probabilities(tried[0]), tried[1])
    raw = forest.probabilities(tested[0])
    scaled = scale.apply(raw)
    assert log_loss(scaled, tested[1]) < log_loss(raw, tested[1])
    assert calibration_curve(scaled, tested[1]).error < 0.08
    assert calibration_curve(scaled, tested[1]).error <= calibration_curve(raw, tested[1]).error + 0.01
    np.testing.assert_array_equal(scaled.argmax(axis=1), raw.argmax(axis=1))


def test_probabilities_that_are_true_are_left_nearly_alone(rng):
    p = rng.dirichlet([2, 2, 2], 20_000)
    labels = (rng.random((len(p), 1)) > np.cumsum(p, axis=1)).sum(axis=1)
    scaled = fit_scale(p, labels).apply(p)
    assert np.abs(scaled - p).mean() < 0.02
    assert calibration_curve(p, labels).error < 0.02


def test_temperature_undoes_what_was_flattened(rng):
    p = rng.dirichlet([1, 1, 1], 20_000)
    labels = (rng.random((len(p), 1)) > np.cumsum(p, axis=1)).sum(axis=1)
    flat = np.sqrt(p) / np.sqrt(p).sum(axis=1, keepdims=True)
    assert fit_scale(flat, labels).temperature == pytest.approx(0.5, abs=0.05)


def test_a_curve_by_hand():
    p = np.array([[0.95, 0.05], [0.95, 0.05], [0.35, 0.65], [0.4, 0.6], [1.0, 0.0]])
    curve = calibration_curve(p, [0, 1, 1, 0, 0], bins=10)
    np.testing.assert_array_equal(curve.count, [2, 3])
    np.testing.assert_allclose(curve.confidence, [0.625, (0.95 + 0.95 + 1.0) / 3])
    np.testing.assert_allclose(curve.accuracy, [0.5, 2 / 3])
    assert curve.error == pytest.approx(0.4 * 0.125 + 0.6 * (2.9 / 3 - 2 / 3))


def test_the_least_confidence_is_where_answers_are_as_right_as_wanted(rng):
    confidence = rng.uniform(0.5, 1, 4000)
    labels = (rng.random(4000) > confidence).astype(int)
    p = np.column_stack([confidence, 1 - confidence])
    least = least_confidence(p, labels, 0.9)
    answered = confidence >= least
    assert (labels[answered] == 0).mean() >= 0.9
    assert least == pytest.approx(0.8, abs=0.05), "the mean of 0.8 to 1 is 0.9"


def test_what_is_always_right_is_answered_from_one_half_on():
    assert least_confidence(np.tile([0.6, 0.4], (30, 1)), np.zeros(30, int), 0.95) == 0.5


def test_where_no_confidence_suffices_the_one_that_errs_least_is_kept(rng):
    confidence = rng.uniform(0.5, 1, 2000)
    labels = (rng.random(2000) > 0.4 + 0.3 * (confidence > 0.9)).astype(int)
    least = least_confidence(np.column_stack([confidence, 1 - confidence]), labels, 0.99)
    assert least >= 0.9


def test_folds_hold_each_frame_out_once_and_keep_away_from_it():
    labels = np.repeat([0, 1, 0, 2, -1], [50, 80, 40, 10, 20])
    folds = held_out_folds(labels, 5, block_frames=10, gap_frames=4)
    assert len(folds) == 5
    np.testing.assert_array_equal(sum(tried.astype(int) for _, tried in folds), labels >= 0)
    for shown, tried in folds:
        assert not (shown & tried).any()
        assert not (shown & (labels < 0)).any()
        assert set(labels[shown]) == {0, 1, 2}, "every area is still to be learnt"
        of_large = np.flatnonzero(tried & (labels != 2))
        distance = np.abs(np.flatnonzero(shown)[:, None] - of_large[None, :]).min()
        assert distance > 4


def test_blocks_are_about_as_long_as_asked():
    (_, tried), *_ = held_out_folds(np.zeros(600, int), 3, block_frames=20, gap_frames=2)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], tried, [False]])))
    np.testing.assert_array_equal(edges[1::2] - edges[::2], 20)
    assert len(edges) // 2 == 10


def test_whole_drives_are_held_out_where_there_are_several():
    labels, drives = np.tile([0, 0, 1, 1, -1], 3), np.repeat([7, 8, 9], 5)
    folds = held_out_folds(labels, 5, 20, 5, drives)
    assert len(folds) == 3
    for shown, tried in folds:
        assert len(set(drives[tried])) == 1
        assert not set(drives[tried]) & set(drives[shown])


def test_an_area_of_one_frame_does_not_stop_the_others():
    folds = held_out_folds(np.repeat([0, 1], [1, 60]), 4, 10, 3)
    assert sum(int(tried.sum()) for _, tried in folds) == 61
