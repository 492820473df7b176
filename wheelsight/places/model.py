"""`PlaceModel` classifies the area of a frame with a random forest and calibrated probabilities.

Forests are grown by scikit-learn and stored as flat arrays. Models are saved in skops' format, as plain values and
arrays that cannot run code.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.areas import AreaMap
from wheelsight.core.errors import PlaceError
from wheelsight.core.files import StrPath, write_bytes
from wheelsight.core.geometry import Float32Array, FloatArray, Int32Array
from wheelsight.core.inputs import Kind, parse_json, read_bytes
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.runtime import needed
from wheelsight.core.settings import CHOSEN, Settings, setting
from wheelsight.core.settings.base import checked_settings
from wheelsight.places.describer_kernels import mean_of_leaves, means_of_leaves
from wheelsight.places.describers import Describer, FrameSize, describer_from, has_depth, size_error, size_of


class ForestSettings(Settings):
    """How a forest is grown and its probabilities are calibrated."""

    trees: int = setting(64, "T of Trinh et al., eq. 7; the paper tries 1 to 6", CHOSEN, ge=1, le=1000)
    max_depth: int | None = setting(
        16, "D: largest number of splits from root to leaf; none: no limit", CHOSEN, gt=0, le=64
    )
    min_leaf: int = setting(1, "least number of frames in a leaf", CHOSEN, gt=0, le=1_000_000)
    seed: int = setting(0, "random seed of the forest", CHOSEN, ge=0, lt=2**32)
    folds: int = setting(5, "number of folds held out in turn to calibrate probabilities", CHOSEN, ge=2, le=20)
    block_frames: int = setting(
        10, "approximate number of neighbouring frames held out together", CHOSEN, gt=0, le=1_000_000
    )
    gap_frames: int = setting(
        2, "frames not used in training on both sides of a held-out block", CHOSEN, ge=0, le=1_000_000
    )
    wanted_accuracy: float = setting(
        0.95,
        "accuracy of answers on held-out blocks; less confident ones are answered with unknown",
        CHOSEN,
        gt=0,
        le=1,
    )


@dataclass(frozen=True, eq=False)
class Forest:
    """Trees in flat arrays of M nodes.

    Attributes:
        roots: (T,) index of each tree's root.
        left, right: (M,) index of the child for a feature up to the threshold, and above it; -1 in leaves.
        feature: (M,) index of the feature that is compared.
        share: (M, A) share of each area among the training frames that reached the node.

    Raises PlaceError if the arrays are not trees.
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
        """Number of trees T."""
        return len(self.roots)

    def probabilities(self, features: Float32Array) -> FloatArray:
        """Return mean leaf distributions (A,) or (N, A) of features (D,) or (N, D): Trinh et al., eq. 7."""
        features = np.ascontiguousarray(features, np.float32)
        if features.ndim not in (1, 2) or features.shape[-1] != self.size:
            raise PlaceError(f"features are {features.shape}", fix=f"this forest takes {self.size} numbers a frame")
        walk = mean_of_leaves if features.ndim == 1 else means_of_leaves
        nodes = (self.roots, self.left, self.right, self.feature, self.threshold, self.share)
        mean: FloatArray = walk(features, *nodes)
        return mean


def _are_trees(f: Forest) -> bool:
    """Return whether every path from a root ends in a leaf within the arrays: kernels do not check it."""
    m = len(f.left)
    flat = ((f.left, "i4"), (f.right, "i4"), (f.feature, "i4"), (f.threshold, "f8"))
    if any(array.shape != (m,) or array.dtype != kind for array, kind in flat):
        return False
    if f.share.ndim != 2 or len(f.share) != m or f.share.dtype != np.float64 or f.share.shape[1] < 1 or f.size < 1:
        return False
    if f.roots.ndim != 1 or f.roots.dtype != np.int32 or not len(f.roots) or not m:
        return False
    inner, nodes = f.left >= 0, np.arange(m)
    # Children come after their parents, so that there are no cycles.
    forward = all(((side > nodes) & (side < m))[inner].all() for side in (f.left, f.right))
    inside = bool(((f.roots >= 0) & (f.roots < m)).all() and ((f.feature >= 0) & (f.feature < f.size)).all())
    shares = np.isfinite(f.share).all() and (f.share >= 0).all() and np.allclose(f.share.sum(axis=1), 1)
    return bool(forward and inside and shares and np.isfinite(f.threshold).all())


LEAST_PROBABILITY = 1e-12


@dataclass(frozen=True, slots=True)
class ProbabilityScale:
    """Calibrates a forest's probabilities: softmax(log((1 - blend) p + blend / A) / temperature).

    The blend avoids certainty if all of a few trees agree by chance. The temperature sharpens (below 1) or flattens the
    rest. The order of the areas does not change.
    """

    temperature: float = 1.0
    blend: float = 0.0

    def apply(self, probabilities: ArrayLike) -> FloatArray:
        """Return calibrated probabilities (..., A) of a forest's (..., A)."""
        p = np.asarray(probabilities, float)
        mixed = np.maximum((1 - self.blend) * p + self.blend / p.shape[-1], LEAST_PROBABILITY)
        powers = (mixed / mixed.max(axis=-1, keepdims=True)) ** (1 / self.temperature)
        scaled: FloatArray = powers / powers.sum(axis=-1, keepdims=True)
        return scaled


FORMAT = "wheelsight-places-1"
_ARRAYS = ("roots", "left", "right", "feature", "threshold", "share")


class Unknown(StrEnum):
    """Reason why a frame's area is unknown."""

    UNSURE = "no area is probable enough"
    NO_DEPTH = "the frame has no depth"


@dataclass(frozen=True, slots=True, eq=False)
class PlaceMatch:
    """The area of a frame.

    Attributes:
        probabilities: (A,) of the areas, with sum 1; uniform for a frame without depth.
        area_index: index of the area, or None if unknown.
        reason: why it is unknown, or None.
    """

    probabilities: FloatArray
    area_index: int | None
    reason: Unknown | None = None


@dataclass(frozen=True, slots=True)
class HeldOutFigures:
    """Results on held-out blocks of the training frames, each scaled by a scale fitted on the other blocks.

    Attributes:
        accuracy: share of frames whose most probable area is the true one.
        log_loss, calibration_error: of the calibrated probabilities.
        raw_log_loss, raw_calibration_error: of the forest's own.
        answered: share of frames with a named area.
        answered_accuracy: share of these that are right; NaN if there are none.
        out_of_bag_accuracy: see `grow_forest`; too optimistic, since neighbouring frames are alike.
        area_accuracy: (A) accuracy for the frames of each area; NaN if none were held out.
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
    """A forest with its describer, calibration and evaluation.

    Attributes:
        area_names: (A,) in the order of the probabilities.
        scale: calibration of the forest's probabilities.
        least_confidence: areas with a lower probability are not named.
        area_shares: (A,) of the training frames: the prior probabilities.
        frame_size: required height and width of colour, then of depth; None: any.
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
        """Return the area of a frame.

        Raises PlaceError for images of another size or type than in training.
        """
        size = size_of(frame)
        if self.frame_size is not None and size != self.frame_size:
            raise size_error(frame, size, self.frame_size, "the model was trained on")
        if not has_depth(frame):
            return PlaceMatch(np.full(len(self.area_names), 1 / len(self.area_names)), None, Unknown.NO_DEPTH)
        return self.match(self.scale.apply(self.forest.probabilities(self.describer.describe(frame))))

    def predict_features(self, features: Float32Array) -> FloatArray:
        """Return probabilities (N, A) of features (N, D)."""
        return self.scale.apply(self.forest.probabilities(features))

    def match(self, probabilities: FloatArray) -> PlaceMatch:
        """Return the area for probabilities (A,), or unknown."""
        index = int(probabilities.argmax())
        if probabilities[index] < self.least_confidence:
            return PlaceMatch(probabilities, None, Unknown.UNSURE)
        return PlaceMatch(probabilities, index)

    def check_areas(self, areas: AreaMap | Sequence[str]) -> None:
        """Raise PlaceError if the areas differ from those of the training, or in order."""
        names = areas.names if isinstance(areas, AreaMap) else tuple(areas)
        if names == self.area_names:
            return
        odd = [name for name in (*names, *self.area_names) if (name in names) != (name in self.area_names)]
        problem = f"has no area {odd[0]!r}" if odd and odd[0] in names else "has other areas, or another order"
        if odd and odd[0] not in names:
            problem = f"has an area {odd[0]!r} that is not among those given"
        raise PlaceError(f"the model {problem}", fix="train it on these areas, in this order")

    def save(self, path: StrPath) -> None:
        """Write the model, atomically, in skops' format. Raises OutputError."""
        document = {
            "format": FORMAT,
            "area_names": list(self.area_names),
            "area_shares": self.area_shares.tolist(),
            "describer": self.describer.settings,
            "frame_size": None if self.frame_size is None else list(self.frame_size),
            "settings": self.settings.model_dump(mode="json"),
            "scale": asdict(self.scale),
            "least_confidence": self.least_confidence,
            "figures": asdict(self.figures) | {"area_accuracy": list(self.figures.area_accuracy)},
            "forest": {name: getattr(self.forest, name) for name in _ARRAYS} | {"size": self.forest.size},
        }
        write_bytes(path, needed("skops.io").dumps(document, compression=zipfile.ZIP_DEFLATED))

    @classmethod
    def load(cls, path: StrPath, areas: AreaMap | Sequence[str] | None = None) -> PlaceModel:
        """Read a model written by `save`, and check it against `areas`, if given.

        Raises PlaceError if the file is missing, not a model, has other contents than plain values and arrays (rejected
        before they are created), is of another version, or has other areas, and ConfigError if skops is not installed.
        """
        path, skops_io = Path(path), needed("skops.io")
        data = read_bytes(path, _FILE, PlaceError)
        try:
            _refuse_all_but_plain(data)
            model = _from_document(skops_io.loads(data, trusted=[]))
        except PlaceError as error:
            raise PlaceError(error.problem, path=path, fix=error.fix) from error
        except Exception as error:  # a damaged file causes various errors of zip, json, numpy and skops
            raise PlaceError(f"is damaged: {type(error).__name__}", path=path, fix=RETRAIN) from error
        if areas is not None:
            try:
                model.check_areas(areas)
            except PlaceError as error:
                raise PlaceError(error.problem, path=path, fix=error.fix) from error
        return model


def _from_document(document: Any) -> PlaceModel:
    if not isinstance(document, dict) or "format" not in document:
        raise PlaceError("is no model of places", fix=NO_MODEL)
    if document["format"] != FORMAT:
        raise PlaceError(f"is of version {document['format']!r}", fix=f"this wheelsight reads {FORMAT!r}; {RETRAIN}")
    describer = describer_from(document["describer"])
    forest = Forest(**{name: document["forest"][name] for name in _ARRAYS}, size=int(document["forest"]["size"]))
    size, of_figures = document["frame_size"], document["figures"]
    area_accuracy = tuple(float(value) for value in of_figures["area_accuracy"])
    singles = {f.name: float(of_figures[f.name]) for f in fields(HeldOutFigures) if f.name != "area_accuracy"}
    model = PlaceModel(
        forest,
        tuple(str(name) for name in document["area_names"]),
        describer,
        ProbabilityScale(**{f.name: float(document["scale"][f.name]) for f in fields(ProbabilityScale)}),
        float(document["least_confidence"]),
        np.array(document["area_shares"], float),
        checked_settings(ForestSettings, document["settings"], PlaceError, "settings: ", RETRAIN),
        HeldOutFigures(**singles, area_accuracy=area_accuracy),
        None if size is None else (int(size[0]), int(size[1]), int(size[2]), int(size[3])),
    )
    areas, scale = len(model.area_names), model.scale
    if forest.size != describer.size:
        problem = f"describes frames with {describer.size} numbers, but its forest takes {forest.size}"
        raise PlaceError(problem, fix=RETRAIN)
    if forest.share.shape[1] != areas or model.area_shares.shape != (areas,) or areas < 2:
        raise PlaceError(f"names {areas} areas, but its forest has {forest.share.shape[1]}", fix=RETRAIN)
    if not (0 < scale.temperature < np.inf and 0 <= scale.blend <= 1 and 0 <= model.least_confidence <= 1):
        raise PlaceError("has impossible probabilities", fix=RETRAIN)
    return model


# A forest of 64 trees takes some megabytes, 20 unpacked. One of 1000 trees on ten times as many frames takes 400.
_MOST_BYTES = 1 << 28
_MOST_SCHEMA_BYTES = 1 << 20
_MOST_ENTRIES = 1000
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # other methods unpack without a size limit
_NUMBERS = "biuf"
RETRAIN = "train the model again"
NO_MODEL = "give a file that `PlaceModel.save` wrote"
_DISTRUST = "do not trust this file"
_FILE = Kind("a model of places", most_mb=256, fix=NO_MODEL)
# Types in a model. skops itself would allow far more, such as estimators and functions of numpy.
_PLAIN = {
    ("DictNode", "builtins.dict"),
    ("ListNode", "builtins.list"),
    ("JsonNode", "builtins.str"),
    ("TypeNode", "builtins.str"),
    ("NdArrayNode", "numpy.ndarray"),
}


def _refuse_all_but_plain(data: bytes) -> None:
    """Read only the file's table of contents, and raise PlaceError for anything but plain values and arrays."""
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
        of_types = (node for node in _nodes_in(schema) if "__loader__" in node or "__class__" in node)
        types = {(str(n.get("__loader__")), f"{n.get('__module__')}.{n.get('__class__')}") for n in of_types}
        if types - _PLAIN:
            loader, kind = sorted(types - _PLAIN)[0]
            raise PlaceError(f"holds a {kind} ({loader}), which no model of places does", fix=_DISTRUST)
        _refuse_large_arrays(archive, schema, sizes)
    untrusted = needed("skops.io").get_untrusted_types(data=data)
    if untrusted:
        raise PlaceError(f"holds a {untrusted[0]}, which no model of places does", fix=_DISTRUST)


def _refuse_large_arrays(archive: zipfile.ZipFile, schema: Any, sizes: dict[str, int]) -> None:
    """Read only the arrays' headers, and raise PlaceError unless they are numeric and of the stated size."""
    named = [str(node["file"]) for node in _nodes_in(schema) if "file" in node]
    if sum(sizes.get(name, 0) for name in named) > _MOST_BYTES:  # a file may be named many times
        raise PlaceError("unpacks to more than a model of places ever needs", fix=_DISTRUST)
    for name in set(named):
        with archive.open(name) as stream:
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, kind = read(stream)
            stated = stream.tell() + math.prod(shape) * kind.itemsize
        if kind.kind not in _NUMBERS or not kind.itemsize or min(shape, default=0) < 0 or stated != sizes[name]:
            raise PlaceError(f"holds {name}, an array of another type or size than stated", fix=_DISTRUST)


def _nodes_in(schema: Any) -> Iterator[dict[str, Any]]:
    """Yield all nodes of a skops schema, at any depth."""
    waiting = [schema]
    while waiting:
        node = waiting.pop()
        if isinstance(node, dict):
            yield node
            waiting.extend(node.values())
        elif isinstance(node, list):
            waiting.extend(node)
