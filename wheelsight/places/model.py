"""PlaceModel: names the area that a frame was taken in, with probabilities, or says that it does not know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from typing import Any

import numpy as np

from wheelsight.areas import AreaMap
from wheelsight.errors import PlaceError
from wheelsight.events import RgbdFrame
from wheelsight.files import StrPath
from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.inputs.settings import checked_settings
from wheelsight.places.calibration import ProbabilityScale
from wheelsight.places.describer import Describer, FrameSize, has_depth, size_error, size_of
from wheelsight.places.describers import describer_from
from wheelsight.places.forest import Forest, ForestSettings
from wheelsight.places.storage import NO_MODEL, RETRAIN, load_document, save_document

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
