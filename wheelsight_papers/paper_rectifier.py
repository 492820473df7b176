"""PaperRectifier: eq. 5 of Trinh et al., the method of their Table I, and the search for its weights.

At each frame, on each axis,

    x_t = alpha x_{t-1} + beta x_t^odometry + gamma x_t^camera,

where x_t^camera is the coordinate of the area that the forest names, and alpha + beta + gamma = 1. If the area has no
such coordinate, alpha + beta = 1 and gamma = 0. The paper does not define x_t^odometry. Both readings are available:
"absolute", the coordinate of the wheels alone; "increment", the last rectified coordinate plus the motion of the wheels
since. Yaw is that of the wheels, as in the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.config import PlaceSettings
from wheelsight.core.areas import AreaMap
from wheelsight.core.checks import need_motion
from wheelsight.core.errors import AreaError, ConfigError
from wheelsight.core.estimates import Estimate, PoseFinding, WheelEstimate, status_of
from wheelsight.core.geometry import FloatArray, IntArray
from wheelsight.core.settings.fusion import AxisWeights, OdometryTerm, Weights
from wheelsight.estimation import area_kernels as kernels
from wheelsight.estimation.area_localizer import Places
from wheelsight.places import PlaceMatch

# Shares of weights in training. The last steps distinguish measurements that count for seconds and for minutes.
_SHARES = np.concatenate([[0.0], np.geomspace(1e-4, 0.5, 25), 1 - np.geomspace(0.4, 1e-3, 8), [1.0]])
_MOST_ROUNDS = 20
# Gamma, the odometry's share of the rest, and its share without a coordinate of the area.
_STARTS = tuple((gamma, share, alone) for gamma in (0.01, 0.1) for share in (0.1, 1.0) for alone in (0.1, 1.0))


class PaperRectifier:
    """Eq. 5, frame by frame. Between frames the wheels continue from the last rectified position.

    Args:
        areas: in the order of the forest's labels.
        T_odom_base: (4, 4) pose at the start.
        weights: from `fit_weights`.
        odometry_term: "absolute" or "increment".
    """

    def __init__(
        self, areas: AreaMap, T_odom_base: ArrayLike, weights: Weights, odometry_term: OdometryTerm = "increment"
    ) -> None:
        if odometry_term not in ("absolute", "increment"):
            raise ConfigError(f"odometry_term is {odometry_term!r}", fix="absolute or increment")
        self._coordinates = coordinates_of(areas)
        self._weights = (weights.without_area.as_array(), weights.with_area.as_array())
        self._is_increment = odometry_term == "increment"
        self._T_map_wheels = need_motion("T_odom_base", T_odom_base).copy()
        self._odometry_at_frame = self._T_map_wheels[:2, 3].copy()
        self._rectified = self._odometry_at_frame.copy()
        self._has_frame = False

    def predict(self, T_before_now: ArrayLike) -> None:
        """Predict by a step (4, 4) of the wheels. Raises ArgumentError for an invalid one."""
        self._T_map_wheels = self._T_map_wheels @ need_motion("T_before_now", T_before_now)

    def update(self, stamp_s: float, area_index: int | None) -> Estimate:
        """Return the pose at a frame of the area `area_index`; None for an unknown area.

        The first frame has no x_{t-1}, so its pose is that of the wheels.

        Raises:
            AreaError: an invalid index.
        """
        if area_index is not None and not 0 <= area_index < len(self._coordinates) - 1:
            raise AreaError(f"area index is {area_index}", fix=f"0 to {len(self._coordinates) - 2}, or None")
        odometry = self._T_map_wheels[:2, 3]
        if self._has_frame:
            camera = self._coordinates[-1 if area_index is None else area_index]
            term = self._rectified + odometry - self._odometry_at_frame if self._is_increment else odometry
            (alpha, beta, _), with_camera = self._weights
            self._rectified = np.array(
                [
                    float(alpha * last + beta * by_wheels)
                    if np.isnan(by_camera)
                    else float(with_camera @ (last, by_wheels, by_camera))
                    for last, by_wheels, by_camera in zip(self._rectified, term, camera, strict=True)
                ]
            )
        self._has_frame = True
        self._odometry_at_frame = odometry.copy()
        return self.estimate(stamp_s)

    def estimate(self, stamp_s: float) -> Estimate:
        """Return the current pose, by the wheels since the last frame. Eq. 5 has no covariance."""
        T_odom_base = self._T_map_wheels.copy()
        T_odom_base[:2, 3] += self._rectified - self._odometry_at_frame
        return Estimate(stamp_s, status_of(PoseFinding.DEAD_RECKONED), T_odom_base, body="base")


class ByPaper:
    """Corrects wheels by eq. 5 for `ByPlaces`, with the weights of the settings."""

    def __init__(self, places: Places, settings: PlaceSettings) -> None:
        assert settings.weights is not None  # resolved with the model
        assert settings.odometry_term is not None
        weights = settings.weights.as_weights()
        self._inner = PaperRectifier(places.areas, places.T_odom_base, weights, settings.odometry_term)
        self._has_begun = False

    def predict(self, wheels: WheelEstimate) -> None:
        """Predict by the next estimate of the wheels; the first one is the start."""
        step = wheels.step
        if self._has_begun and step is not None:
            self._inner.predict(step.T_before_now)
        self._has_begun = True

    def correct(self, stamp_s: float, match: PlaceMatch) -> Estimate:
        """Return the pose at a frame, corrected by its area."""
        return self._inner.update(stamp_s, match.area_index)

    def estimate(self, stamp_s: float) -> Estimate:
        """Return the pose between frames."""
        return self._inner.estimate(stamp_s)


@dataclass(frozen=True, eq=False)
class TrainingDrive:
    """A drive with ground truth, at its frames.

    Attributes:
        odometry: (N, 2) x, y in metres of the wheels alone, in the map frame.
        area_indices: (N,) areas by the forest, -1 for unknown.
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
    """Return x and y (A + 1, 2) of each area, NaN if it has none; the last row is that of an unknown area."""
    coordinates = [[np.nan if value is None else value for value in (area.x_m, area.y_m)] for area in areas]
    return np.array([*coordinates, [np.nan, np.nan]], float)


def rectify_drive(
    odometry: FloatArray, of_areas: FloatArray, weights: Weights, odometry_term: OdometryTerm = "increment"
) -> FloatArray:
    """Return x, y (N, 2) by eq. 5 along a drive, from the wheels (N, 2) and the areas (N, 2), NaN for none."""
    known, unknown = weights.with_area.as_array(), weights.without_area.as_array()
    axes = [
        kernels.rectify(np.ascontiguousarray(wheels, float), area.copy(), known, unknown, odometry_term == "increment")
        for wheels, area in zip(odometry.T, of_areas.T, strict=True)
    ]
    return np.stack(axes, axis=1)


def fit_weights(areas: AreaMap, drives: Sequence[TrainingDrive], odometry_term: OdometryTerm = "increment") -> Weights:
    """Return the weights with the least mean distance from ground truth, as in the paper, over all training frames.

    Coordinate search: each free weight in turn takes the best of a list of values, until none improves. The free
    weights are gamma, the odometry's share of the rest, and the odometry's share without a coordinate of the area.

    Raises:
        ConfigError: no drive.
    """
    if not drives:
        raise ConfigError("weights are fitted on no drive", fix="give at least one training drive")
    coordinates = coordinates_of(areas)
    by_camera = [coordinates[drive.area_indices] for drive in drives]

    def error_m(free: Sequence[float]) -> float:
        weights = _weights_of(free)
        apart = [
            np.linalg.norm(rectify_drive(drive.odometry, t, weights, odometry_term) - drive.truth, axis=1)
            for drive, t in zip(drives, by_camera, strict=True)
        ]
        return float(np.concatenate(apart).mean())

    best: tuple[float, ...] = min(_STARTS, key=error_m)
    for _ in range(_MOST_ROUNDS):
        before = best
        for place in range(3):
            trials = [(*best[:place], float(share), *best[place + 1 :]) for share in _SHARES]
            best = min(best, *trials, key=error_m)
        if best == before:
            break
    return _weights_of(best)


def _weights_of(free: Sequence[float]) -> Weights:
    gamma, share, alone = free
    beta = (1 - gamma) * share
    return Weights(AxisWeights(max(1 - gamma - beta, 0.0), beta, gamma), AxisWeights(1 - alone, alone))
