"""`PlaceModel` classifies the area of a frame with a random forest and calibrated probabilities. Models are saved as
plain data.
"""

from __future__ import annotations

import io
import math
import warnings
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.areas import AreaMap
from wheelsight.core.errors import PlaceError
from wheelsight.core.files import StrPath, write_bytes
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, Int32Array, IntArray
from wheelsight.core.inputs import Kind, parse_json, read_bytes
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.runtime import needed
from wheelsight.core.settings import CHOSEN, Settings, setting
from wheelsight.core.settings.base import checked_settings
from wheelsight.places.describer_kernels import mean_of_leaves, means_of_leaves
from wheelsight.places.describers import Describer, FrameSize, describer_from, has_depth, size_error, size_of

# Forest: scikit-learn's random forest, grown by entropy, kept as flat arrays that a kernel walks in microseconds.


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
        walk = mean_of_leaves if features.ndim == 1 else means_of_leaves
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


# Probabilities that mean what they say: held-out blocks, a scale fitted on them, and when to answer *unknown*.


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


# PlaceModel: names the area that a frame was taken in, with probabilities, or says that it does not know.


FORMAT = "wheelsight-places-1"
_ARRAYS = ("roots", "left", "right", "feature", "threshold", "share")


class Unknown(StrEnum):
    """Why a frame's area is not named."""

    UNSURE = "no area is probable enough"
    NO_DEPTH = "the frame has no depth"


@dataclass(frozen=True, slots=True, eq=False)
class PlaceMatch:
    """Which area a frame was taken in.

    Attributes:
        probabilities: (A,) of the areas, summing to 1; all alike where the frame has no depth and says nothing.
        area_index: of the area named, or None: unknown.
        reason: why it is unknown, or None.
    """

    probabilities: FloatArray
    area_index: int | None
    reason: Unknown | None = None


@dataclass(frozen=True, slots=True)
class HeldOutFigures:
    """How the model did on blocks of its training frames that were held out, scaled by a scale of the other blocks.

    Attributes:
        accuracy: share of frames whose most probable area is the true one.
        log_loss, calibration_error: of the scaled probabilities.
        raw_log_loss, raw_calibration_error: of the forest's own.
        answered: share of frames whose area is named.
        answered_accuracy: share of these that are right; NaN where there are none.
        out_of_bag_accuracy: each frame asked of the trees grown without it; flattered by neighbouring frames.
        area_accuracy: (A) as `accuracy`, of the frames of each area; NaN where none was held out.
    """

    accuracy: float
    log_loss: float
    calibration_error: float
    raw_log_loss: float
    raw_calibration_error: float
    answered: float
    answered_accuracy: float
    out_of_bag_accuracy: float
    area_accuracy: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class PlaceModel:
    """A forest, what describes frames to it, and what its answers are worth.

    Attributes:
        forest: the trees.
        area_names: (A,) in the order of the probabilities.
        describer: turns frames into the forest's features.
        scale: from the forest's probabilities to those of being right.
        least_confidence: an area less probable than this is not named.
        area_shares: (A,) of the training frames; what the probabilities take for granted before they see a frame.
        settings: that the forest was grown with.
        figures: on held-out blocks.
        frame_size: height and width of colour, then of depth, that frames must have; None: any.
    """

    forest: Forest
    area_names: tuple[str, ...]
    describer: Describer
    scale: ProbabilityScale
    least_confidence: float
    area_shares: FloatArray
    settings: ForestSettings
    figures: HeldOutFigures
    frame_size: FrameSize | None = None

    def predict(self, frame: RgbdFrame) -> PlaceMatch:
        """The area of a frame.

        Raises:
            PlaceError: images of another size or type than the model was trained on.
        """
        size = size_of(frame)
        if self.frame_size is not None and size != self.frame_size:
            raise size_error(frame, size, self.frame_size, "the model was trained on")
        if not has_depth(frame):
            return PlaceMatch(np.full(len(self.area_names), 1 / len(self.area_names)), None, Unknown.NO_DEPTH)
        return self.match(self.scale.apply(self.forest.probabilities(self.describer.describe(frame))))

    def predict_features(self, features: Float32Array) -> FloatArray:
        """Probabilities (N, A) of described frames (N, D)."""
        return self.scale.apply(self.forest.probabilities(features))

    def match(self, probabilities: FloatArray) -> PlaceMatch:
        """What probabilities (A,) amount to: an area's name, or unknown."""
        index = int(probabilities.argmax())
        if probabilities[index] < self.least_confidence:
            return PlaceMatch(probabilities, None, Unknown.UNSURE)
        return PlaceMatch(probabilities, index)

    def check_areas(self, areas: AreaMap | Sequence[str]) -> None:
        """Raises PlaceError where the areas are not those that the model was trained on, in the same order."""
        names = areas.names if isinstance(areas, AreaMap) else tuple(areas)
        if names == self.area_names:
            return
        odd = [name for name in (*names, *self.area_names) if (name in names) != (name in self.area_names)]
        problem = f"knows area {odd[0]!r} not" if odd and odd[0] in names else "knows other areas"
        if odd and odd[0] not in names:
            problem = f"knows an area {odd[0]!r} that is not among those given"
        raise PlaceError(f"the model {problem}", fix="train it on these areas, in this order")

    def save(self, path: StrPath) -> None:
        """Write the model atomically, with skops, as plain values and arrays. Raises OutputError."""
        save_document(_to_document(self), path)

    @classmethod
    def load(cls, path: StrPath, areas: AreaMap | Sequence[str] | None = None) -> PlaceModel:
        """Read a model that `save` wrote; of `areas`, if they are given.

        Raises:
            PlaceError: no such file, a file that is no model, one that holds anything but plain values and arrays
                (refused before these are made), another version, or other areas.
        """
        model = load_document(path, _from_document)
        if areas is not None:
            try:
                model.check_areas(areas)
            except PlaceError as error:
                raise PlaceError(error.problem, path=path, fix=error.fix) from error
        return model


def _to_document(model: PlaceModel) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "area_names": list(model.area_names),
        "area_shares": model.area_shares.tolist(),
        "describer": model.describer.settings,
        "frame_size": None if model.frame_size is None else list(model.frame_size),
        "settings": model.settings.model_dump(mode="json"),
        "scale": asdict(model.scale),
        "least_confidence": model.least_confidence,
        "figures": asdict(model.figures) | {"area_accuracy": list(model.figures.area_accuracy)},
        "forest": {name: getattr(model.forest, name) for name in _ARRAYS} | {"size": model.forest.size},
    }


def _from_document(document: Any) -> PlaceModel:
    if not isinstance(document, dict) or "format" not in document:
        raise PlaceError("is no model of places", fix=NO_MODEL)
    if document["format"] != FORMAT:
        raise PlaceError(f"is of version {document['format']!r}", fix=f"this wheelsight reads {FORMAT!r}; {RETRAIN}")
    describer = describer_from(document["describer"])
    forest = Forest(**{name: document["forest"][name] for name in _ARRAYS}, size=int(document["forest"]["size"]))
    size = document["frame_size"]
    model = PlaceModel(
        forest,
        tuple(str(name) for name in document["area_names"]),
        describer,
        ProbabilityScale(**{f.name: float(document["scale"][f.name]) for f in fields(ProbabilityScale)}),
        float(document["least_confidence"]),
        np.array(document["area_shares"], float),
        checked_settings(ForestSettings, document["settings"], PlaceError, "settings: ", RETRAIN),
        _figures_from(document["figures"]),
        None if size is None else (int(size[0]), int(size[1]), int(size[2]), int(size[3])),
    )
    _check_agreement(model)
    return model


def _figures_from(told: dict[str, Any]) -> HeldOutFigures:
    area_accuracy = tuple(float(value) for value in told["area_accuracy"])
    singles = {f.name: float(told[f.name]) for f in fields(HeldOutFigures) if f.name != "area_accuracy"}
    return HeldOutFigures(**singles, area_accuracy=area_accuracy)


def _check_agreement(model: PlaceModel) -> None:
    areas, forest, scale = len(model.area_names), model.forest, model.scale
    if forest.size != model.describer.size:
        problem = f"describes frames with {model.describer.size} numbers, but its forest takes {forest.size}"
        raise PlaceError(problem, fix=RETRAIN)
    if forest.share.shape[1] != areas or model.area_shares.shape != (areas,) or areas < 2:
        raise PlaceError(f"names {areas} areas, but its forest has {forest.share.shape[1]}", fix=RETRAIN)
    if not (0 < scale.temperature < np.inf and 0 <= scale.blend <= 1 and 0 <= model.least_confidence <= 1):
        raise PlaceError("has impossible probabilities", fix=RETRAIN)


# Models of places in files: plain values and arrays in skops' format, and nothing that could do something.


Made = TypeVar("Made")
# A forest of 64 trees takes some megabytes, and 20 unpacked; one of 1000, on ten times as many frames, 400.
_MOST_BYTES = 1 << 28
_MOST_SCHEMA_BYTES = 1 << 20
_MOST_ENTRIES = 1000
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # the others are unpacked whole, whatever size they name
_NUMBERS = "biuf"
RETRAIN = "train the model again"
NO_MODEL = "give a file that `PlaceModel.save` wrote"
_DISTRUST = "do not trust this file"
_FILE = Kind("a model of places", most_mb=256, fix=NO_MODEL)
# What a model of ours is made of; skops itself would allow far more, such as estimators and functions of numpy.
_PLAIN = {
    ("DictNode", "builtins.dict"),
    ("ListNode", "builtins.list"),
    ("JsonNode", "builtins.str"),
    ("TypeNode", "builtins.str"),
    ("NdArrayNode", "numpy.ndarray"),
}


def save_document(document: dict[str, Any], path: StrPath) -> None:
    """Write plain values and arrays atomically. Raises OutputError."""
    write_bytes(path, needed("skops.io").dumps(document, compression=zipfile.ZIP_DEFLATED))


def load_document(path: StrPath, made_into: Callable[[Any], Made]) -> Made:
    """Read plain values and arrays, and make a model of them by `made_into`, whose errors become this file's.

    Raises:
        PlaceError: naming the file: it cannot be read, is no model, holds more than plain values and arrays (nothing
            of it is then made), is of another version, or contradicts itself.
        ConfigError: skops is not installed.
    """
    path, skops_io = Path(path), needed("skops.io")
    data = read_bytes(path, _FILE, PlaceError)
    try:
        _refuse_all_but_plain(data)
        return made_into(skops_io.loads(data, trusted=[]))
    except PlaceError as error:
        raise PlaceError(error.problem, path=path, fix=error.fix) from error
    except Exception as error:  # a damaged file fails inside zip, json, numpy or skops in ways of their own
        raise PlaceError(f"is damaged: {type(error).__name__}", path=path, fix=RETRAIN) from error


def _refuse_all_but_plain(data: bytes) -> None:
    """Read the file's table of contents, and only that; whatever it names but plain values is refused."""
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise PlaceError("is no model of places", fix=NO_MODEL)
    if data.count(b"PK\x01\x02") > _MOST_ENTRIES:
        raise PlaceError("lists more than a model of places ever holds", fix=_DISTRUST)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if "schema.json" not in archive.namelist():
            raise PlaceError("is no model of places", fix=NO_MODEL)
        if any(entry.compress_type not in _PACKED for entry in archive.infolist()):
            raise PlaceError("is packed in a way that models of places are not", fix=_DISTRUST)
        sizes = {entry.filename: entry.file_size for entry in archive.infolist()}
        if sum(entry.file_size for entry in archive.infolist()) > _MOST_BYTES:
            raise PlaceError("unpacks to more than a model of places ever needs", fix=_DISTRUST)
        if sizes["schema.json"] > _MOST_SCHEMA_BYTES:
            raise PlaceError("lists more than a model of places ever holds", fix=_DISTRUST)
        try:
            schema = parse_json(archive.read("schema.json"))
        except ValueError as error:
            raise PlaceError(f"its list of contents {error}", fix=_DISTRUST) from error
        odd = {found for found in _types_in(schema) if found not in _PLAIN}
        if odd:
            loader, kind = sorted(odd)[0]
            raise PlaceError(f"holds a {kind} ({loader}), which no model of places does", fix=_DISTRUST)
        _refuse_large_arrays(archive, schema, sizes)
    untrusted = needed("skops.io").get_untrusted_types(data=data)
    if untrusted:
        raise PlaceError(f"holds a {untrusted[0]}, which no model of places does", fix=_DISTRUST)


def _refuse_large_arrays(archive: zipfile.ZipFile, schema: Any, sizes: dict[str, int]) -> None:
    """Read the arrays' headers, and only these: they must be of numbers, and as large as they say."""
    named = [str(node["file"]) for node in _nodes_in(schema) if "file" in node]
    if sum(sizes.get(name, 0) for name in named) > _MOST_BYTES:  # one may be named many times over
        raise PlaceError("unpacks to more than a model of places ever needs", fix=_DISTRUST)
    for name in set(named):
        with archive.open(name) as stream:
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, kind = read(stream)
            told = stream.tell() + math.prod(shape) * kind.itemsize
        if kind.kind not in _NUMBERS or not kind.itemsize or min(shape, default=0) < 0 or told != sizes[name]:
            raise PlaceError(f"holds {name}, an array that is not what it says", fix=_DISTRUST)


def _nodes_in(schema: Any) -> Iterator[dict[str, Any]]:
    """Everything that a skops schema would make, at any depth."""
    waiting = [schema]
    while waiting:
        node = waiting.pop()
        if isinstance(node, dict):
            yield node
            waiting.extend(node.values())
        elif isinstance(node, list):
            waiting.extend(node)


def _types_in(schema: Any) -> Iterator[tuple[str, str]]:
    """Loader and full type of everything that a skops schema would make."""
    for node in _nodes_in(schema):
        if "__loader__" in node or "__class__" in node:
            yield str(node.get("__loader__")), f"{node.get('__module__')}.{node.get('__class__')}"
