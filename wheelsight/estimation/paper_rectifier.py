"""PaperRectifier: eq. 5 of Trinh et al., the way of their Table I, and the search for its weights.

Once a frame, on each axis for itself,

    x_t = alpha x_{t-1} + beta x_t^odometry + gamma x_t^camera,

where x_t^camera is the coordinate of the area that the forest names, alpha + beta + gamma = 1; where the area tells no
such coordinate, alpha + beta = 1 and gamma = 0. The paper leaves open what x_t^odometry is. Both readings are here:
"absolute", the coordinate that the wheels alone would have by now; "increment", the last rectified coordinate and the
way of the wheels since. Yaw stays the wheels', as in the paper.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.areas import AreaMap
from wheelsight.core.checks import need_motion
from wheelsight.core.errors import AreaError, ConfigError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray, IntArray
from wheelsight.core.settings.fusion import AxisWeights, OdometryTerm, Weights
from wheelsight.estimation import area_kernels as kernels

# Shares of weights in training; the last steps decide between a look that is trusted for seconds and for minutes.
_SHARES = np.concatenate([[0.0], np.geomspace(1e-4, 0.5, 25), 1 - np.geomspace(0.4, 1e-3, 8), [1.0]])
_MOST_ROUNDS = 20
# Gamma, odometry's share of what gamma leaves, and its share where nothing is told.
_STARTS = tuple((gamma, told, untold) for gamma in (0.01, 0.1) for told in (0.1, 1.0) for untold in (0.1, 1.0))


class PaperRectifier:
    """Eq. 5, frame by frame; between frames the wheels go on from the last rectified place.

    Args:
        areas: in the order of the forest's labels.
        T_odom_base: (4, 4) pose at the start, where the wheels begin.
        weights: from `fit_weights`.
        odometry_term: "absolute" or "increment".
    """

    def __init__(
        self, areas: AreaMap, T_odom_base: ArrayLike, weights: Weights, odometry_term: OdometryTerm = "increment"
    ) -> None:
        if odometry_term not in ("absolute", "increment"):
            raise ConfigError(f"odometry_term is {odometry_term!r}", fix="absolute or increment")
        self._told = coordinates_of(areas)
        self._weights = (weights.untold.as_array(), weights.told.as_array())
        self._is_increment = odometry_term == "increment"
        self._T_map_wheels = need_motion("T_odom_base", T_odom_base).copy()
        self._odometry_at_frame = self._T_map_wheels[:2, 3].copy()
        self._rectified = self._odometry_at_frame.copy()
        self._has_frame = False

    def predict(self, T_before_now: ArrayLike) -> None:
        """Go on by a step (4, 4) of the wheels. Raises ArgumentError for what is none."""
        self._T_map_wheels = self._T_map_wheels @ need_motion("T_before_now", T_before_now)

    def update(self, stamp_s: float, area_index: int | None) -> Estimate:
        """The pose at a frame whose area is `area_index`, or None where it is not known.

        The first frame has no frame before it, hence no x_{t-1}, and is where the wheels say.

        Raises:
            AreaError: an index that no area has.
        """
        if area_index is not None and not 0 <= area_index < len(self._told) - 1:
            raise AreaError(f"area index is {area_index}", fix=f"0 to {len(self._told) - 2}, or None")
        odometry = self._T_map_wheels[:2, 3]
        if self._has_frame:
            told = self._told[-1 if area_index is None else area_index]
            term = self._rectified + odometry - self._odometry_at_frame if self._is_increment else odometry
            self._rectified = np.array([self._next(self._rectified[axis], term[axis], told[axis]) for axis in range(2)])
        self._has_frame = True
        self._odometry_at_frame = odometry.copy()
        return self.estimate(stamp_s)

    def estimate(self, stamp_s: float) -> Estimate:
        """The pose now, by the wheels since the last frame; eq. 5 knows no covariance."""
        T_odom_base = self._T_map_wheels.copy()
        T_odom_base[:2, 3] += self._rectified - self._odometry_at_frame
        return Estimate(stamp_s, Status.TRACKING, T_odom_base, body="base")

    def _next(self, last: float, term: float, told: float) -> float:
        if np.isnan(told):
            alpha, beta, _ = self._weights[0]
            return float(alpha * last + beta * term)
        return float(self._weights[1] @ (last, term, told))


@dataclass(frozen=True, eq=False)
class TrainingDrive:
    """A drive with truth, at its frames.

    Attributes:
        odometry: (N, 2) x, y in metres of the wheels alone, in the map frame.
        area_indices: (N,) the forest's answers, -1 where unknown.
        truth: (N, 2) x, y in metres.
    """

    odometry: FloatArray
    area_indices: IntArray
    truth: FloatArray

    def __post_init__(self) -> None:
        n = len(self.odometry)
        if n == 0 or self.odometry.shape != (n, 2) or self.truth.shape != (n, 2) or self.area_indices.shape != (n,):
            raise ConfigError("a training drive needs x, y of wheels and truth, and an area, for each of its frames")
        if not (np.isfinite(self.odometry).all() and np.isfinite(self.truth).all()):
            raise ConfigError("a training drive has coordinates that are not finite")


def coordinates_of(areas: AreaMap) -> FloatArray:
    """(A + 1, 2) x and y that each area tells, NaN where it does not; the last row, of no area, tells none."""
    told = [[np.nan if value is None else value for value in (area.x_m, area.y_m)] for area in areas]
    return np.array([*told, [np.nan, np.nan]], float)


def rectify_drive(
    odometry: FloatArray, told: FloatArray, weights: Weights, odometry_term: OdometryTerm = "increment"
) -> FloatArray:
    """Eq. 5 along a whole drive: x, y (N, 2) from those of the wheels (N, 2) and of the areas (N, 2), NaN for none."""
    both = (weights.told.as_array(), weights.untold.as_array(), odometry_term == "increment")
    axes = [kernels.rectify(np.ascontiguousarray(odometry[:, k], float), told[:, k].copy(), *both) for k in range(2)]
    return np.stack(axes, axis=1)


def fit_weights(areas: AreaMap, drives: Sequence[TrainingDrive], odometry_term: OdometryTerm = "increment") -> Weights:
    """The weights of least mean distance from truth, the paper's figure, over all frames of training drives.

    Coordinate search: each free weight in turn takes the best of a row of values, until none gets better. The free
    ones are gamma, the odometry's share of what gamma leaves, and the odometry's share where nothing is told.

    Raises:
        ConfigError: no drive.
    """
    if not drives:
        raise ConfigError("weights are fitted on no drive", fix="give at least one training drive")
    coordinates = coordinates_of(areas)
    told = [coordinates[drive.area_indices] for drive in drives]

    def error_m(free: tuple[float, float, float]) -> float:
        weights = _weights_of(free)
        apart = [
            np.linalg.norm(rectify_drive(drive.odometry, t, weights, odometry_term) - drive.truth, axis=1)
            for drive, t in zip(drives, told, strict=True)
        ]
        return float(np.concatenate(apart).mean())

    best = min(_STARTS, key=error_m)
    for _ in range(_MOST_ROUNDS):
        before = best
        for place in range(3):
            best = min(best, *_along(best, place), key=error_m)
        if best == before:
            break
    return _weights_of(best)


def _along(free: tuple[float, float, float], place: int) -> Iterator[tuple[float, float, float]]:
    """`free` with every value in the place of one."""
    for share in _SHARES:
        trial = list(free)
        trial[place] = float(share)
        yield trial[0], trial[1], trial[2]


def _weights_of(free: tuple[float, float, float]) -> Weights:
    gamma, told, untold = free
    beta = (1 - gamma) * told
    return Weights(AxisWeights(max(1 - gamma - beta, 0.0), beta, gamma), AxisWeights(1 - untold, untold))
