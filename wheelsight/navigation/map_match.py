"""MapMatch: lays what stands about the robot on what the map has there, between two places that are recognised.

Keyframes correct a robot where it looks as somebody looked before. Walls and furniture are in the map from all sides.
"""

from __future__ import annotations

import cv2
import numpy as np

from wheelsight.geometry import BoolArray, Float32Array, FloatArray, se2
from wheelsight.geometry.chi_square import quantile
from wheelsight.navigation.costmap import CellState, StaticLayer, distances_m
from wheelsight.navigation.live_layer import LiveObstacles
from wheelsight.navigation.navigator_settings import MatchSettings


class MapMatch:
    """Holds by how much a localization is off in a map, as obstacles have it.

    Gauss-Newton over distances to the map's nearest obstacle (likelihood fields; Thrun, Burgard & Fox, 6.4), robust,
    and held by what was known before: along a bare corridor nothing is learned. Nor does it lead farther than the
    localization may be off by what it states: chairs that stand elsewhere would pull it along.

    Args:
        static: of the map, which stays as it is.
        settings: or the defaults.

    Attributes:
        T_map_told: (3, 3) from where the localization has the robot in the map to where it is.
        share: of the obstacles seen, how many the map has, at the last match; None before any.
    """

    def __init__(self, static: StaticLayer, settings: MatchSettings | None = None) -> None:
        self.settings = settings or MatchSettings()
        self.T_map_told: FloatArray = np.eye(3)
        self.share: float | None = None
        # Distances to the middle of cells; half a cell is the surface of the thing.
        self._distance_m: Float32Array = distances_m(static.state == CellState.OCCUPIED, static.resolution_m)
        self._resolution_m, self._origin = static.resolution_m, np.array(static.origin)
        slopes = [cv2.Sobel(self._distance_m, cv2.CV_32F, *axis, ksize=3, scale=0.125) for axis in ((1, 0), (0, 1))]
        self._slope = np.stack(slopes, axis=-1) / np.float32(static.resolution_m)

    def update(
        self,
        live: LiveObstacles,
        T_told_odom: FloatArray,
        xy_odom: FloatArray,
        sigmas: tuple[float, float] = (np.inf, np.inf),
    ) -> None:
        """Match anew; what was found before is given up where nothing is matched and `sigmas` are too small for it.

        Args:
            live: obstacles in `odom`.
            T_told_odom: (3,) where `odom` lies in the map, as the localization has it.
            xy_odom: (2,) where the robot is; what is far from it is left out.
            sigmas: metres and radians, of where the localization has the robot in the map.
        """
        s = self.settings
        points = _places(live)
        points = points[np.hypot(*(points - xy_odom).T) < s.far_m]
        middle = se2.apply(se2.from_parts(*T_told_odom), xy_odom[None])[0]
        known = self._information(sigmas[0], sigmas[1])
        self.share = None
        if _chi2(known, self.T_map_told, middle) > quantile(s.likely, 3):
            self.T_map_told = np.eye(3)
        if len(points) < s.least_points:
            return
        step = max(len(points) // s.most_points, 1)
        told = se2.apply(se2.from_parts(*T_told_odom), points[::step])
        best: tuple[float, FloatArray] | None = None
        for begin in (self.T_map_told, np.eye(3)):
            for turn in s.starts_rad:
                T = self._solved(begin, _about(middle, turn) @ begin, told, middle, known)
                held = _chi2(self._information(), T @ se2.invert(begin), middle) + _chi2(known, T, middle)
                cost = self._cost(T, told) + held / 2
                if best is None or cost < best[0] - 1e-9:
                    best = cost, T
        assert best is not None
        distance_m, _ = self._at(se2.apply(best[1], told))
        share = float((distance_m < s.near_m).mean())
        if share >= s.least_share:
            self.T_map_told, self.share = best[1], share

    def _information(self, sigma_m: float = 0.0, sigma_rad: float = 0.0) -> FloatArray:
        """(3, 3) of how little the localization drifts between two matches, beside what it states of itself."""
        place, heading = sigma_m**2 + self.settings.hold_m**2, sigma_rad**2 + self.settings.hold_rad**2
        return np.diag([1 / place, 1 / place, 1 / heading])

    def _solved(
        self, begin: FloatArray, T: FloatArray, told: FloatArray, middle: FloatArray, known: FloatArray
    ) -> FloatArray:
        """(3, 3) the motion near to one (3, 3), begun at another, that lays points (N, 2) on obstacles.

        `known`: (3, 3) information of how little the localization is off, by what it states.
        """
        s, hold = self.settings, self._information()
        for _ in range(s.rounds):
            places = se2.apply(T, told)
            distance_m, slope = self._at(places)
            weight = self._weights(distance_m) / s.correlation
            arm = places - middle
            J = np.column_stack([slope, slope[:, 1] * arm[:, 0] - slope[:, 0] * arm[:, 1]])
            off, away = _small(T @ se2.invert(begin), middle), _small(T, middle)
            H = (J * weight[:, None]).T @ J + hold + known
            change = -np.linalg.solve(H, J.T @ (weight * distance_m) + hold @ off + known @ away)
            T = _about(middle, float(change[2]), (float(change[0]), float(change[1]))) @ T
            if np.abs(change).max() < 1e-4:
                break
        return T

    def _at(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances (N,) to the nearest obstacle, less half a cell, and their slopes (N, 2), between cells' middles."""
        at = ((places - self._origin) / self._resolution_m - 0.5).astype(np.float32)
        x, y = np.ascontiguousarray(at[:, 0]), np.ascontiguousarray(at[:, 1])
        beyond = self.settings.cut_m + 1.0
        distance = cv2.remap(self._distance_m, x, y, cv2.INTER_LINEAR, borderValue=beyond).ravel()
        slope = cv2.remap(self._slope, x, y, cv2.INTER_LINEAR, borderValue=0).reshape(-1, 2)
        return np.maximum(distance - self._resolution_m / 2, 0).astype(float), slope.astype(float)

    def _weights(self, distance_m: FloatArray) -> FloatArray:
        """(N,) information of each distance, 1/m²: Cauchy's; none of what the map does not have."""
        s = self.settings
        is_known: BoolArray = distance_m < s.cut_m
        return np.where(is_known, 1 / (s.sigma_m**2 + distance_m**2), 0.0)

    def _cost(self, T: FloatArray, told: FloatArray) -> float:
        distance_m, _ = self._at(se2.apply(T, told))
        s = self.settings
        return float(np.log1p((np.minimum(distance_m, s.cut_m) / s.sigma_m) ** 2).sum() / 2 / s.correlation)


def _places(live: LiveObstacles) -> FloatArray:
    """(N, 2) middles of cells in which something stands."""
    return np.asarray((np.argwhere(live.is_occupied)[:, ::-1] + 0.5) * live.resolution_m + live.origin)


def _about(middle: FloatArray, turn_rad: float, shift: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """(3, 3) a turn about a place, and a shift (2,)."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    R = np.array([[c, -s], [s, c]])
    T = np.eye(3)
    T[:2, :2], T[:2, 2] = R, middle - R @ middle + shift
    return T


def _chi2(information: FloatArray, T: FloatArray, middle: FloatArray) -> float:
    """Of a motion (3, 3) about a place, by information (3, 3)."""
    off = _small(T, middle)
    return float(off @ information @ off)


def _small(T: FloatArray, middle: FloatArray) -> FloatArray:
    """(3,) shift of a place, and turn, of a motion (3, 3)."""
    return np.array([*(se2.apply(T, middle[None])[0] - middle), np.arctan2(T[1, 0], T[0, 0])])
