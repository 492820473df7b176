"""PlaceModel: names what it knows, says when it does not, and cannot be trained or used on what does not fit."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from places.made import NAMES, QUICK, SMALL_HISTOGRAMS, drive_through, frame_of, overlapped, trained

from wheelsight.core.areas import Area, AreaMap
from wheelsight.core.errors import PlaceError
from wheelsight.core.messages import RgbdFrame
from wheelsight.places import (
    ForestSettings,
    HistogramDescriber,
    HistogramSettings,
    LayoutDescriber,
    PlaceModel,
    Unknown,
)
from wheelsight_papers import describe_all, train_places

FIVE = HistogramDescriber(HistogramSettings(bins=2, missing="own_bin"))  # five numbers, as `overlapped` makes


def test_a_new_drive_is_named_as_it_was_taught(rng):
    model = trained()
    frames, labels = drive_through((2, 0, 1), 10, rng)
    matches = [model.predict(frame) for frame in frames]
    assert np.mean([match.area_index == label for match, label in zip(matches, labels, strict=True)]) > 0.9
    for match in matches:
        assert match.probabilities.shape == (3,)
        assert match.probabilities.sum() == pytest.approx(1)
        assert (match.area_index is None) == (match.reason is not None)


@pytest.mark.parametrize("describer", [LayoutDescriber(), HistogramDescriber()])
def test_any_description_serves(rng, describer):
    frames, labels = drive_through((0, 1, 2), 20, rng)
    features = describe_all(frames, describer).features
    model = train_places(features, labels, NAMES, describer, QUICK)
    tested, wanted = drive_through((1, 2, 0), 5, rng)
    named = [int(model.predict(frame).probabilities.argmax()) for frame in tested]
    assert np.mean(named == wanted) > 0.9


def test_one_frame_is_predicted_as_many_are(rng):
    model = trained()
    frames, _ = drive_through((0, 1, 2), 5, rng)
    together = model.predict_features(describe_all(frames, SMALL_HISTOGRAMS).features)
    np.testing.assert_allclose([model.predict(frame).probabilities for frame in frames], together, rtol=1e-12)


def test_what_is_unlike_all_areas_is_less_sure_than_what_is_like_one(rng):
    model = trained()
    odd = RgbdFrame(0.0, np.zeros((24, 32, 3), np.uint8), np.full((24, 32), 7.5, np.float32))
    assert model.predict(odd).probabilities.max() < model.predict(frame_of(1, rng)).probabilities.max()


def test_between_two_areas_the_answer_is_unknown(rng):
    model = trained()
    match = model.match(np.array([0.49, 0.48, 0.03]))
    assert match.area_index is None
    assert match.reason is Unknown.UNSURE
    assert model.match(np.array([0.0, 1.0, 0.0])).area_index == 1


def test_unknown_answers_leave_those_that_are_right_as_often_as_wanted(rng):
    features, labels = overlapped(rng, 1200, 1.1)
    settings = ForestSettings(trees=32, folds=3, wanted_accuracy=0.9)
    model = train_places(features, labels, NAMES, FIVE, settings)
    new, new_labels = overlapped(rng, 4000, 1.1)
    probabilities = model.predict_features(new)
    is_right = probabilities.argmax(axis=1) == new_labels
    answered = np.array([model.match(p).area_index is not None for p in probabilities])
    assert is_right.mean() < 0.88
    assert is_right[answered].mean() == pytest.approx(0.9, abs=0.05)
    assert 0.1 < answered.mean() < 0.9
    # What the model says of itself is what it then does.
    figures = model.figures
    assert figures.accuracy == pytest.approx(is_right.mean(), abs=0.05)
    assert figures.answered == pytest.approx(answered.mean(), abs=0.1)
    assert figures.answered_accuracy >= 0.9
    assert figures.log_loss < figures.raw_log_loss
    assert figures.calibration_error < 0.06
    assert 0 < figures.out_of_bag_accuracy < 1


def test_a_frame_without_depth_says_nothing(rng):
    frame = frame_of(1, rng)
    match = trained().predict(replace(frame, depth_m=np.zeros_like(frame.depth_m)))
    assert match.area_index is None
    assert match.reason is Unknown.NO_DEPTH
    np.testing.assert_allclose(match.probabilities, 1 / 3)
    nan = trained().predict(replace(frame, depth_m=np.full_like(frame.depth_m, np.nan)))
    assert nan.reason is Unknown.NO_DEPTH


def test_a_frame_of_another_size_is_refused(rng):
    with pytest.raises(PlaceError, match=r"frame 60 at 2\.000 s is 64x48 with depth 64x48; .* 32x24 with depth 32x24"):
        trained().predict(frame_of(1, rng, 2.0, size=(48, 64)))


def test_a_drive_whose_images_change_in_size_is_refused(rng):
    frames = [frame_of(0, rng, 0.0), frame_of(0, rng, 1.0, size=(48, 64))]
    with pytest.raises(PlaceError, match=r"frame 30 at 1\.000 s is 64x48"):
        describe_all(frames, SMALL_HISTOGRAMS)
    with pytest.raises(PlaceError, match="no frames to describe"):
        describe_all([], SMALL_HISTOGRAMS)


def test_described_frames_say_which_have_depth(rng):
    frames = [frame_of(0, rng, 0.0), frame_of(1, rng, 0.5)]
    frames.append(replace(frames[1], stamp_s=1.0, depth_m=np.zeros_like(frames[1].depth_m)))
    described = describe_all(frames, SMALL_HISTOGRAMS)
    assert described.features.shape == (3, SMALL_HISTOGRAMS.size)
    np.testing.assert_array_equal(described.stamps_s, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(described.has_depth, [True, True, False])
    assert described.frame_size == (24, 32, 24, 32)


def test_one_seed_gives_one_model(rng):
    features, labels = overlapped(rng, 300)
    first, again = (train_places(features, labels, NAMES, FIVE, QUICK) for _ in range(2))
    other = train_places(features, labels, NAMES, FIVE, QUICK.model_copy(update={"seed": 9}))
    np.testing.assert_array_equal(first.predict_features(features), again.predict_features(features))
    assert (first.scale, first.least_confidence, first.figures) == (again.scale, again.least_confidence, again.figures)
    assert not np.array_equal(first.predict_features(features), other.predict_features(features))


def test_frames_outside_all_areas_teach_nothing(rng):
    features, labels = overlapped(rng, 300)
    outside = np.arange(300) % 10 == 0
    model = train_places(features, np.where(outside, -1, labels), NAMES, FIVE, QUICK)
    poisoned = np.where(outside[:, None], 50.0, features)
    same = train_places(poisoned, np.where(outside, -1, labels), NAMES, FIVE, QUICK)
    np.testing.assert_array_equal(model.predict_features(features), same.predict_features(features))
    np.testing.assert_allclose(model.area_shares, np.bincount(labels[~outside]) / (~outside).sum())


def test_several_drives_are_held_out_whole(rng):
    """Each drive has light of its own, by which a forest that saw its frames would know them."""
    drives = np.repeat(np.arange(4), 150)
    labels = np.tile(np.arange(150) // 50, 4)
    features = 0.2 * rng.standard_normal((600, 5)) + (3 * drives + labels)[:, None]
    one = train_places(features, labels, NAMES, FIVE, QUICK)
    several = train_places(features, labels, NAMES, FIVE, QUICK, drives=drives)
    assert one.figures.accuracy > 0.9
    assert several.figures.accuracy < 0.75


def test_an_area_without_frames_is_named(rng):
    features, labels = overlapped(rng, 90)
    with pytest.raises(PlaceError, match=r"area 'attic' has no training frames \(drive through it, or leave"):
        train_places(features, labels, (*NAMES, "attic"), FIVE, QUICK)
    with pytest.raises(PlaceError, match="area 'corridor' has no training frames"):
        train_places(features[:0], labels[:0], NAMES, FIVE, QUICK)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda f, y: (f[:, :4], y, NAMES), r"features are \(90, 4\) \(histograms gives 5"),
        (lambda f, y: (f, y[:-1], NAMES), r"90 frames have labels \(89,\)"),
        (lambda f, y: (f, y.astype(float), NAMES), "90 frames have labels .* of float64"),
        (lambda f, y: (f, y + 1, NAMES), "label 3 is not an area index"),
        (lambda f, y: (f, y - 2, NAMES), "label -2 is not an area index"),
        (lambda f, y: (f, y * 0, ("a",)), "1 areas cannot be distinguished"),
        (lambda f, y: (f, y, ("a", "b", "a")), "3 areas cannot be distinguished"),
        (lambda f, y: (np.where(np.arange(90)[:, None] == 7, np.nan, f), y, NAMES), "features of frame 7 are not fin"),
    ],
)
def test_what_does_not_belong_together_is_refused(rng, change, problem):
    features, labels, names = change(*overlapped(rng, 90))
    with pytest.raises(PlaceError, match=problem):
        train_places(features, labels, names, FIVE, QUICK)


def test_an_area_of_a_single_frame_is_learnt_all_the_same(rng):
    features, labels = overlapped(rng, 90)
    model = train_places(features, np.where(np.arange(90) == 40, 3, labels), (*NAMES, "lift door"), FIVE, QUICK)
    assert model.predict_features(features).shape == (90, 4)


def test_other_areas_are_refused_by_name(rng):
    model = trained()
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    model.check_areas(AreaMap(tuple(Area(name, corners + [2 * i, 0], y_m=0.5) for i, name in enumerate(NAMES))))
    model.check_areas(list(NAMES))
    for names, problem in (
        ((*NAMES, "attic"), "the model has no area 'attic'"),
        (NAMES[:2], "the model has an area 'lift' that is not among those given"),
        (NAMES[::-1], "the model has other areas"),
    ):
        with pytest.raises(PlaceError, match=problem):
            model.check_areas(names)


def test_predicting_changes_nothing(rng):
    model = trained()
    frame = frame_of(2, rng)
    before = [np.copy(getattr(model.forest, f.name)) for f in fields(model.forest)]
    first = model.predict(frame).probabilities
    np.testing.assert_array_equal(model.predict(frame).probabilities, first)
    for field, array in zip(fields(model.forest), before, strict=True):
        np.testing.assert_array_equal(getattr(model.forest, field.name), array)
    assert isinstance(model, PlaceModel)
