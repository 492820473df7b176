"""PlaceModel: names the area that a frame was taken in, with probabilities, or says that it does not know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from wheelsight.areas import AreaMap
from wheelsight.errors import PlaceError
from wheelsight.events import RgbdFrame
from wheelsight.files import StrPath
from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.places.calibration import ProbabilityScale
from wheelsight.places.describer import Describer, FrameSize, has_depth, size_error, size_of
from wheelsight.places.forest import Forest, ForestSettings


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
        path = Path(path)
        from wheelsight.places.storage import save_model

        save_model(self, path)

    @classmethod
    def load(cls, path: StrPath, areas: AreaMap | Sequence[str] | None = None) -> PlaceModel:
        """Read a model that `save` wrote; of `areas`, if they are given.

        Raises:
            PlaceError: no such file, a file that is no model, one that holds anything but plain values and arrays
                (refused before these are made), another version, or other areas.
        """
        path = Path(path)
        from wheelsight.places.storage import load_model

        model = load_model(path)
        if areas is not None:
            try:
                model.check_areas(areas)
            except PlaceError as error:
                raise PlaceError(error.problem, path=path, fix=error.fix) from error
        return model
