"""PlaceMeter: the area that a frame shows, as a position that a Kalman filter takes as it takes any other.

What the area filter (`filter`) says of each area is a likelihood of the position (`_floor`), and no Gaussian. The
filter's belief of the position, seen through it, has a mean and a covariance; what is told is the measurement that
takes the belief there, as expectation propagation replaces a factor by a Gaussian (Minka, UAI 2001). Directions in
which the belief gets no narrower, such as along a corridor, are left open: their variance says nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.areas import AreaMap
from wheelsight.fusion.areas._floor import FloorShares, reweighted
from wheelsight.fusion.areas.filter import AreaFilter
from wheelsight.fusion.areas.rectifier import checked_shares, likelihood_of
from wheelsight.fusion.areas.settings import AreaRectifierSettings
from wheelsight.geometry import FloatArray, se3, so3

_OPEN = 1e6  # times the belief's own variance
_NARROWEST, _WIDEST = 1e-6, 1 - 1e-4


class PlaceMeter:
    """Positions by areas, frame by frame; the same input gives the same answer to the last bit.

    Args:
        areas: in the order of the forest's probabilities, at least one.
        settings: what is believed of areas and forest; of the wheels, the filter knows more.
        area_shares: (A,) of the frames that the forest was trained on; None: all alike.

    Raises:
        ConfigError: no area, or shares that are not one positive number an area.
    """

    def __init__(
        self, areas: AreaMap, settings: AreaRectifierSettings | None = None, area_shares: ArrayLike | None = None
    ) -> None:
        self.settings = settings or AreaRectifierSettings()
        self._areas, self._shares = areas, checked_shares(areas, area_shares)
        self._floor = FloorShares(areas, self.settings.border_m)
        self._filter: AreaFilter | None = None
        self._T_odom_last = np.eye(4)

    def measure(
        self, T_odom_base: FloatArray, covariance: FloatArray, probabilities: ArrayLike | None
    ) -> tuple[FloatArray, FloatArray] | None:
        """The position that a frame tells.

        Args:
            T_odom_base: (4, 4) at the frame, as it is believed without it.
            covariance: (6, 6) of its left perturbation.
            probabilities: (A,) of the areas, from the forest, or None where it does not know.

        Returns:
            x, y (2,) in the map, metres, and covariance (2, 2); or None where the frame tells nothing, or what hardly
            agrees with the belief.

        Raises:
            ConfigError: not one probability an area, negative, not finite, or all zero.
        """
        frame_likelihood = None if probabilities is None else likelihood_of(probabilities, self._shares)
        xy = T_odom_base[:2, 3]
        parts, axes = self._floor.parts_of(xy, _of_position(T_odom_base, covariance))
        areas = self._moved_to(T_odom_base, parts[:, 0])
        if frame_likelihood is None:
            return None
        likelihoods = areas.update(frame_likelihood)
        # Of a forest that was never worth anything an answer says nothing, whatever the area.
        likelihoods = 1 + areas.worth * (likelihoods - 1)
        if parts[:, 0] @ likelihoods / likelihoods.max() < self.settings.least_support:
            return None
        told = equivalent(*reweighted(parts, likelihoods))
        if told is None:
            return None
        offset, spread = axes @ told[0], axes @ told[1] @ axes.T
        return xy + offset, (spread + spread.T) / 2

    def _moved_to(self, T_odom_base: FloatArray, places: FloatArray) -> AreaFilter:
        """The area filter at a frame's pose, which is in the places (A + 1,) by these probabilities."""
        if self._filter is None:
            self._filter = AreaFilter(self._areas, self.settings.forest, places)
        else:
            T_last_now = se3.invert(self._T_odom_last) @ T_odom_base
            self._filter.predict(float(np.hypot(*T_last_now[:2, 3])), float(so3.angle(T_last_now[:3, :3])))
            stray = self.settings.stray
            self._filter.agree_with((1 - stray) * places + stray * self._filter.places)
        self._T_odom_last = T_odom_base
        return self._filter


def equivalent(mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """The measurement (2,) with covariance (2, 2) that takes N(0, I) to N(mean, covariance); None if there is none.

    Along an axis of the covariance with variance c and mean m it is m / (1 - c) with c / (1 - c); along axes in which
    c is not below 1, none.
    """
    variances, directions = np.linalg.eigh(covariance)
    tells = variances < _WIDEST
    if not tells.any():
        return None
    left = np.where(tells, np.maximum(variances, _NARROWEST), 0.0)
    values = np.where(tells, directions.T @ mean / (1 - left), 0.0)
    spread = np.where(tells, left / (1 - left), _OPEN)
    return directions @ values, (directions * spread) @ directions.T


def _of_position(T_odom_base: FloatArray, covariance: FloatArray) -> FloatArray:
    """(2, 2) of x and y, from that of the left perturbation, which turns about the map's origin."""
    return se3.position_covariance(T_odom_base, covariance)[:2, :2]
