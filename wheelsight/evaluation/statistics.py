"""Statistics: what a list of errors comes to."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import EvaluationError


@dataclass(frozen=True, slots=True)
class Statistics:
    """Of `count` errors, in their unit; `std` is of the population (divided by `count`)."""

    rmse: float
    mean: float
    median: float
    max: float
    min: float
    std: float
    count: int

    @classmethod
    def of(cls, errors: ArrayLike) -> Statistics:
        """The statistics of errors (N,). Raises EvaluationError when there are none, or one is not finite."""
        e = np.asarray(errors, float).ravel()
        if not len(e) or not np.isfinite(e).all():
            raise EvaluationError("statistics need at least one error, all of them finite")
        return cls(
            rmse=float(np.sqrt(np.mean(e**2))),
            mean=float(e.mean()),
            median=float(np.median(e)),
            max=float(e.max()),
            min=float(e.min()),
            std=float(e.std()),
            count=len(e),
        )

    def in_degrees(self) -> Statistics:
        """These statistics, of angles in radians, in degrees."""
        rmse, mean, median, largest, smallest, std = np.degrees(
            (self.rmse, self.mean, self.median, self.max, self.min, self.std)
        ).tolist()
        return Statistics(rmse, mean, median, largest, smallest, std, self.count)

    def to_dict(self) -> dict[str, float]:
        """The fields by name, for metrics.json."""
        return asdict(self)
