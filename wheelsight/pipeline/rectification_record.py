"""RectificationRecord: what areas did to the wheels, frame by frame, and what is left of their error in the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.areas import AreaMap
from wheelsight.evaluation import Statistics
from wheelsight.geometry import BoolArray, FloatArray, IntArray
from wheelsight.trajectory import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What a frame said of the area, and what was believed once it was heard.

    Attributes:
        stamp_s: of the frame.
        probabilities: (A,) by the model, or None where the frame is no measurement.
        named: index of the area that the model names, -1 for none.
        belief: (A,) that the base is in each area by the filter, or None: the paper's way has none.
        trust: probability that the forest is in order, NaN where nothing tells.
        note: why it is no measurement, or "".
    """

    stamp_s: float
    probabilities: FloatArray | None = None
    named: int = -1
    belief: FloatArray | None = None
    trust: float = float("nan")
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class MapErrors:
    """Distances in x and y from the true base, nothing aligned, at the frames at which all paths are known.

    Attributes:
        stamps_s: (M,) of these frames, at least one.
        wheels_m: (M,) of the wheels alone.
        rectified_m: (M,) of the rectified path.
    """

    stamps_s: FloatArray
    wheels_m: FloatArray
    rectified_m: FloatArray

    @property
    def wheels(self) -> Statistics:
        """Of the wheels alone."""
        return Statistics.of(self.wheels_m)

    @property
    def rectified(self) -> Statistics:
        """Of the rectified path."""
        return Statistics.of(self.rectified_m)

    @property
    def left(self) -> float:
        """Mean distance of the rectified path over that of the wheels; NaN where these do not err."""
        return self.rectified.mean / self.wheels.mean if self.wheels.mean > 0 else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class RectificationRecord:
    """What a report tells of areas.

    Attributes:
        way: "probabilistic" or "paper".
        areas: in the map frame.
        looks: one for each frame, in order of time.
        wheels: the wheels alone, T_odom_base from the same start.
        start: how the start is known, in a sentence.
        true_areas: (N,) index of the true area at each look, -1 in none or unknown; None without ground truth.
        errors: in the map, or None without ground truth.
    """

    way: str
    areas: AreaMap
    looks: tuple[Look, ...]
    wheels: Trajectory
    start: str
    true_areas: IntArray | None = None
    errors: MapErrors | None = None

    @property
    def stamps_s(self) -> FloatArray:
        """(N,) of the looks."""
        return np.array([look.stamp_s for look in self.looks], float)

    @property
    def forest(self) -> FloatArray:
        """(N, A) the model's probabilities, rows of NaN where there is no measurement."""
        return self._rows([look.probabilities for look in self.looks])

    @property
    def belief(self) -> FloatArray | None:
        """(N, A) the filter's probabilities, rows of NaN before the first pose; None of the paper's way."""
        return self._rows([look.belief for look in self.looks]) if self.way == "probabilistic" else None

    @property
    def trust(self) -> FloatArray:
        """(N,) that the forest is in order, NaN where nothing tells."""
        return np.array([look.trust for look in self.looks], float)

    @property
    def is_judged(self) -> BoolArray:
        """(N,) whether a look has a true area and is a measurement."""
        seen = np.array([look.probabilities is not None for look in self.looks], bool)
        return seen & (self.true_areas >= 0) if self.true_areas is not None else np.zeros(len(self.looks), bool)

    def accuracy(self, probabilities: FloatArray) -> float:
        """Share of judged looks whose most probable area (N, A) is the true one; NaN where none is judged."""
        which = self.is_judged & ~np.isnan(probabilities).any(axis=1)
        if self.true_areas is None or not which.any():
            return float("nan")
        return float((probabilities[which].argmax(axis=1) == self.true_areas[which]).mean())

    def _rows(self, rows: list[FloatArray | None]) -> FloatArray:
        nothing = np.full(len(self.areas), np.nan)
        found = [nothing if row is None else row for row in rows]
        return np.array(found, float).reshape(-1, len(self.areas))
