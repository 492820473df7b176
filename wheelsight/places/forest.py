"""Forest: scikit-learn's random forest, grown by entropy, kept as flat arrays that a kernel walks in microseconds."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from wheelsight.errors import PlaceError
from wheelsight.extras import needed
from wheelsight.geometry import Float32Array, FloatArray, Int32Array, IntArray
from wheelsight.places import _kernels as kernels
from wheelsight.settings import CHOSEN, Settings, setting

_NO_CHILD = -1
# Under this, starting threads takes longer than growing trees.
_WORTH_THREADS = 20_000


class ForestSettings(Settings):
    """How a forest is grown, and how its probabilities are made to mean what they say."""

    trees: int = setting(64, "T of Trinh et al., eq. 7; the paper tries 1 to 6", CHOSEN, ge=1, le=1000)
    max_depth: int | None = setting(16, "D: splits from root to leaf at most; none: no limit", CHOSEN, gt=0, le=64)
    min_leaf: int = setting(1, "frames that a leaf holds at least", CHOSEN, gt=0, le=1_000_000)
    seed: int = setting(0, "one seed gives one forest", CHOSEN, ge=0, lt=2**32)
    folds: int = setting(5, "blocks held out in turn to calibrate probabilities", CHOSEN, ge=2, le=20)
    block_frames: int = setting(10, "neighbours that are held out together, about", CHOSEN, gt=0, le=1_000_000)
    gap_frames: int = setting(2, "left out of training on both sides of a block held out", CHOSEN, ge=0, le=1_000_000)
    wanted_accuracy: float = setting(
        0.95, "of answers on blocks held out; what is less sure is answered with unknown", CHOSEN, gt=0, le=1
    )


@dataclass(frozen=True, eq=False)
class Forest:
    """Trees one after the other in flat arrays of M nodes.

    Attributes:
        roots: (T,) index of each tree's first node.
        left, right: (M,) index of the child for a feature up to the threshold, and above it; -1 in leaves.
        feature: (M,) which of the D numbers is asked for.
        threshold: (M,) what it is compared with.
        share: (M, A) share of each area among the training frames that reached the node.
        size: D.

    Raises:
        PlaceError: arrays that do not make trees.
    """

    roots: Int32Array
    left: Int32Array
    right: Int32Array
    feature: Int32Array
    threshold: FloatArray
    share: FloatArray
    size: int

    def __post_init__(self) -> None:
        if not _are_trees(self):
            raise PlaceError("its arrays do not make trees", fix="the file is damaged; train the model again")

    @property
    def tree_count(self) -> int:
        """T."""
        return len(self.roots)

    def probabilities(self, features: Float32Array) -> FloatArray:
        """Means of the leaves' distributions (A,) or (N, A) for features (D,) or (N, D): Trinh et al., eq. 7."""
        features = np.ascontiguousarray(features, np.float32)
        if features.ndim not in (1, 2) or features.shape[-1] != self.size:
            raise PlaceError(f"features are {features.shape}", fix=f"this forest takes {self.size} numbers a frame")
        walk = kernels.mean_of_leaves if features.ndim == 1 else kernels.means_of_leaves
        nodes = (self.roots, self.left, self.right, self.feature, self.threshold, self.share)
        mean: FloatArray = walk(features, *nodes)
        return mean


def grow_forest(
    features: Float32Array, labels: IntArray, area_count: int, settings: ForestSettings, out_of_bag: bool = False
) -> tuple[Forest, float]:
    """A forest of features (N, D) and areas (N,), each tree on frames drawn with replacement; its accuracy out of bag.

    Splits gain the most information, eq. 6 of Trinh et al., among √D features drawn anew at each node. Out of bag,
    each frame is asked of those trees that were grown without it; frames that are in all of them are left out. Frames
    have neighbours that are alike, so that this flatters; held-out blocks do not. NaN where it is not asked for.

    Raises:
        ConfigError: scikit-learn is not installed.
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
    return flatten(grown, area_count), _accuracy_out_of_bag(grown, labels) if out_of_bag else float("nan")


def flatten(grown: Any, area_count: int) -> Forest:
    """The Forest that a fitted RandomForestClassifier is; areas that it was not shown get a share of 0."""
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


def _accuracy_out_of_bag(grown: Any, labels: IntArray) -> float:
    votes = np.nan_to_num(grown.oob_decision_function_)
    asked = votes.sum(axis=1) > 0
    named = np.asarray(grown.classes_)[votes.argmax(axis=1)]
    return float((named == labels)[asked].mean()) if asked.any() else float("nan")


def _are_trees(f: Forest) -> bool:
    """Whether every way from a root ends in a leaf within the arrays: the kernels themselves check nothing."""
    m = len(f.left)
    flat = ((f.left, "i4"), (f.right, "i4"), (f.feature, "i4"), (f.threshold, "f8"))
    if any(array.shape != (m,) or array.dtype != kind for array, kind in flat):
        return False
    if f.share.ndim != 2 or len(f.share) != m or f.share.dtype != np.float64 or f.share.shape[1] < 1 or f.size < 1:
        return False
    if f.roots.ndim != 1 or f.roots.dtype != np.int32 or not len(f.roots) or not m:
        return False
    inner, nodes = f.left >= 0, np.arange(m)
    # Children come after their parents, so that no way goes in a circle.
    forward = all(((side > nodes) & (side < m))[inner].all() for side in (f.left, f.right))
    inside = bool(((f.roots >= 0) & (f.roots < m)).all() and ((f.feature >= 0) & (f.feature < f.size)).all())
    shares = np.isfinite(f.share).all() and (f.share >= 0).all() and np.allclose(f.share.sum(axis=1), 1)
    return bool(forward and inside and shares and np.isfinite(f.threshold).all())
