"""Forest: the same as scikit-learn's, eq. 7 against its single trees, and arrays that make no trees."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from odometry.plain_kernels import plain
from places.made import overlapped
from sklearn.ensemble import RandomForestClassifier

from wheelsight.core.errors import PlaceError
from wheelsight.places import Forest, ForestSettings
from wheelsight.places import describer_kernels as compiled
from wheelsight_papers import grow_forest
from wheelsight_papers.training import flatten


def entropy(labels: np.ndarray) -> float:
    """Trinh et al., eq. 6, first line."""
    shares = np.bincount(labels) / max(len(labels), 1)
    return float(-sum(p * np.log2(p) for p in shares if p > 0))


def grown(rng, trees: int = 6, **others):
    features, labels = overlapped(rng, 300)
    forest = RandomForestClassifier(trees, criterion="entropy", random_state=3, **others).fit(features, labels)
    return forest, overlapped(rng, 200)[0]


@pytest.mark.parametrize("others", [{}, {"max_depth": 3}, {"min_samples_leaf": 7}, {"max_depth": 1, "trees": 1}])
def test_flat_arrays_answer_as_scikit_learn_does(rng, others):
    forest, tested = grown(rng, **others)
    np.testing.assert_allclose(flatten(forest, 3).probabilities(tested), forest.predict_proba(tested), atol=1e-12)


def test_features_at_thresholds_go_the_same_way(rng):
    forest, _ = grown(rng)
    edges = np.concatenate([tree.tree_.threshold[tree.tree_.feature >= 0] for tree in forest.estimators_])
    tested = rng.choice(edges, (500, 5)).astype(np.float32)
    np.testing.assert_allclose(flatten(forest, 3).probabilities(tested), forest.predict_proba(tested), atol=1e-12)


@pytest.mark.parametrize("trees", [1, 2, 6])
def test_the_answer_is_the_mean_of_the_leaves_distributions(rng, trees):
    """Trinh et al., eq. 7: p(c|v) = 1/T Σ p_t(c|v), asked of the single trees."""
    forest, tested = grown(rng, trees)
    of_trees = [tree.predict_proba(tested) for tree in forest.estimators_]
    np.testing.assert_allclose(flatten(forest, 3).probabilities(tested), sum(of_trees) / trees, atol=1e-12)


def test_one_frame_and_many_are_answered_alike(rng):
    forest, tested = grown(rng)
    flat = flatten(forest, 3)
    one_by_one = np.array([flat.probabilities(features) for features in tested[:20]])
    np.testing.assert_array_equal(one_by_one, flat.probabilities(tested[:20]))
    nodes = (flat.roots, flat.left, flat.right, flat.feature, flat.threshold, flat.share)
    np.testing.assert_array_equal(plain(compiled).means_of_leaves(tested[:20], *nodes), one_by_one)


def test_a_tree_splits_where_information_gain_is_greatest():
    """Trinh et al., eq. 6, second line: no other threshold on the same feature gains more."""
    rng = np.random.default_rng(5)
    features, labels = overlapped(rng, 200)
    forest = RandomForestClassifier(
        1, criterion="entropy", bootstrap=False, max_features=None, max_depth=1, random_state=0
    ).fit(features, labels)
    flat = flatten(forest, 3)

    def gain(feature: int, threshold: float) -> float:
        low = features[:, feature] <= threshold
        parts = (labels[low], labels[~low])
        return entropy(labels) - sum(len(part) / len(labels) * entropy(part) for part in parts)

    best = max(gain(f, t) for f in range(5) for t in features[:, f])
    assert gain(int(flat.feature[0]), float(flat.threshold[0])) == pytest.approx(best)
    assert best > 0.1


def test_settings_reach_the_trees(rng):
    features, labels = overlapped(rng, 300)
    forest, _ = grow_forest(features, labels, 3, ForestSettings(trees=5, max_depth=2))
    assert forest.tree_count == 5
    assert len(forest.left) <= 5 * 7, "two splits deep: at most seven nodes a tree"
    deeper, _ = grow_forest(features, labels, 3, ForestSettings(trees=5, max_depth=None))
    assert len(deeper.left) > len(forest.left)


def test_one_seed_gives_one_forest(rng):
    features, labels = overlapped(rng, 300)
    first, again, other = (
        grow_forest(features, labels, 3, ForestSettings(trees=4, seed=seed))[0] for seed in (1, 1, 2)
    )
    for field in fields(Forest):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(again, field.name))
    assert not np.array_equal(first.threshold, other.threshold)


def test_an_area_that_was_not_shown_gets_nothing(rng):
    features, labels = overlapped(rng, 300)
    forest, _ = grow_forest(features, np.array([0, 2, 3])[labels], 5, ForestSettings(trees=4))
    p = forest.probabilities(features)
    np.testing.assert_array_equal(p[:, [1, 4]], 0)
    np.testing.assert_allclose(p.sum(axis=1), 1)


def test_out_of_bag_is_near_the_accuracy_on_new_frames_and_below_that_on_its_own(rng):
    features, labels = overlapped(rng, 900)
    forest, out_of_bag = grow_forest(features, labels, 3, ForestSettings(trees=64), out_of_bag=True)
    new, new_labels = overlapped(rng, 3000)
    accuracy = (forest.probabilities(new).argmax(axis=1) == new_labels).mean()
    assert out_of_bag == pytest.approx(accuracy, abs=0.05)
    assert out_of_bag < (forest.probabilities(features).argmax(axis=1) == labels).mean() - 0.05


def test_out_of_bag_with_one_tree_asks_only_frames_it_did_not_see(rng):
    features, labels = overlapped(rng, 900)
    _, out_of_bag = grow_forest(features, labels, 3, ForestSettings(trees=1), out_of_bag=True)
    forest = RandomForestClassifier(1, criterion="entropy", max_depth=16, random_state=0).fit(features, labels)
    unseen = np.setdiff1d(np.arange(900), forest.estimators_samples_[0])
    assert out_of_bag == pytest.approx((forest.predict(features[unseen]) == labels[unseen]).mean())


def test_features_of_another_size_are_refused(rng):
    forest, _ = grown(rng)
    with pytest.raises(PlaceError, match=r"features are \(2, 6\) \(this forest takes 5 numbers"):
        flatten(forest, 3).probabilities(np.zeros((2, 6), np.float32))


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("left", lambda a: np.where(a >= 0, 0, a)),  # back to the root: a walk without end
        ("right", lambda a: np.where(a >= 0, a + 10**6, a)),
        ("right", lambda a: np.where(a >= 0, -7, a)),
        ("feature", lambda a: a + 5),
        ("feature", lambda a: a - 5),
        ("roots", lambda a: a + 10**6),
        ("roots", lambda a: a - 1),
        ("roots", lambda a: a[:0]),
        ("threshold", lambda a: a * np.nan),
        ("share", lambda a: a - 0.5),
        ("share", lambda a: a * np.nan),
        ("share", lambda a: a[:-1]),
        ("left", lambda a: a.astype(np.int64)),
        ("left", lambda a: a.astype(object)),
        ("threshold", lambda a: a[:-1]),
        ("size", lambda d: 0),
    ],
)
def test_arrays_that_make_no_trees_are_refused(rng, name, change):
    flat = flatten(grown(rng)[0], 3)
    parts = {field.name: getattr(flat, field.name) for field in fields(Forest)}
    parts[name] = change(parts[name])
    with pytest.raises(PlaceError, match="do not make trees"):
        Forest(**parts)
