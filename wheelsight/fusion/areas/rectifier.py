"""AreaRectifier: the areas that a forest names correct the wheels, as a recursive estimate with covariance.

The way meant to be better than eq. 5 of Trinh et al. The state is the base's pose in the plane and what is wrong with
the wheels: the scale of the way, a drift of the heading a metre (unequal radii) and the scale of turns (track width),
each of which may wander slowly. Wheels predict it. A frame corrects it by the likelihood of its answer as a function
of the position: for each area the hidden Markov filter's (`filter`), anywhere in that area (`_floor`). The
product of a Gaussian with that likelihood is replaced by the Gaussian of the same mean and covariance (assumed density
filtering; Maybeck 1982, chapter 12), and what is correlated with the position, heading and wheels, follows.

A forest that fails for a while makes all areas' likelihoods alike, and the wheels go on from where they are. Beside
all this the wheels are reckoned alone, for the case that the forest never was worth anything; the answer is the mean
of both by the probability of that. Nothing but the areas is known of the building.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.areas import AreaMap
from wheelsight.checks import array_of
from wheelsight.errors import ConfigError
from wheelsight.estimates import Estimate, Status, WheelEstimate
from wheelsight.fusion.areas._floor import FloorShares, reweighted
from wheelsight.fusion.areas._plane_belief import PLANE, PlaneBelief, pose_of
from wheelsight.fusion.areas.filter import AreaFilter
from wheelsight.fusion.areas.settings import AreaRectifierSettings
from wheelsight.geometry import FloatArray, se3


@dataclass(frozen=True, slots=True, eq=False)
class RectifiedEstimate(Estimate):
    """A pose that areas have corrected.

    Attributes:
        area_probabilities: (A,) that the base is in each area; what they leave of 1 is outside all of them.
        trust: probability that the forest is worth something and does not fail just now.
        support: share of the position's belief before the frame that agrees with its answer, or 1 without one.
    """

    area_probabilities: FloatArray | None = None
    trust: float = 1.0
    support: float = 1.0


class AreaRectifier:
    """Wheels corrected by areas, frame by frame; the same input gives the same answer to the last bit.

    Args:
        areas: in the order of the forest's probabilities, at least one.
        T_odom_base: (4, 4) pose at the start, in the plane.
        settings: see there.
        area_shares: (A,) of the frames that the forest was trained on, which its probabilities take for granted
            (`PlaceModel.area_shares`); None: all alike.

    Raises:
        ConfigError: no area, a pose that is none, or shares that are not one positive number an area.
    """

    def __init__(
        self,
        areas: AreaMap,
        T_odom_base: ArrayLike,
        settings: AreaRectifierSettings | None = None,
        *,
        area_shares: ArrayLike | None = None,
    ) -> None:
        self.settings = settings or AreaRectifierSettings()
        self._shares = checked_shares(areas, area_shares)
        self._corrected, self._alone = (_start(T_odom_base, self.settings) for _ in range(2))
        self._floor = FloorShares(areas, self.settings.border_m)
        self._filter = AreaFilter(areas, self.settings.forest, self._parts()[0][:, 0])
        self._way_m = self._turn_rad = 0.0
        self._has_begun = False

    def predict(self, T_before_now: ArrayLike, covariance: ArrayLike) -> None:
        """Go on by a step of the wheels.

        Args:
            T_before_now: (4, 4) pose now in the frame of the base before.
            covariance: (6, 6) of its left perturbation.

        Raises:
            ConfigError: numbers that are not finite.
        """
        T, covariance = array_of("T_before_now", T_before_now, (4, 4)), array_of("covariance", covariance, (6, 6))
        if not (np.isfinite(T).all() and np.isfinite(covariance).all()):
            raise ConfigError("a step of the wheels is not finite", fix="leave steps out that odometry refused")
        step = np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])
        # Of forward and left rather than of the left perturbation, which turns about the place before.
        J = np.array([[1.0, 0.0, -step[1]], [0.0, 1.0, step[0]], [0.0, 0.0, 1.0]])
        noise = J @ covariance[np.ix_(PLANE, PLANE)] @ J.T
        for belief in (self._corrected, self._alone):
            belief.move(step, noise)
        self._way_m += float(np.hypot(step[0], step[1]))
        self._turn_rad += abs(float(step[2]))

    def predict_to(self, wheels: WheelEstimate) -> None:
        """Go on to the next estimate of wheel odometry; the first is the start, whatever step it tells.

        Raises:
            ConfigError: an estimate without pose or covariance.
        """
        if wheels.T_odom_body is None or wheels.covariance is None:
            raise ConfigError("an estimate of the wheels has no pose or no covariance", fix="leave it out")
        step = wheels.step
        if self._has_begun and step is not None:
            self.predict(step.T_before_now, step.covariance)
        self._has_begun = True

    def update(self, stamp_s: float, probabilities: ArrayLike | None) -> RectifiedEstimate:
        """The pose at a frame.

        Args:
            stamp_s: of the frame; the wheels have been predicted up to it.
            probabilities: (A,) of the areas, from the forest, or None where it does not know: no measurement.

        Raises:
            ConfigError: not one probability an area, negative, not finite, or all zero.
        """
        frame_likelihood = None if probabilities is None else likelihood_of(probabilities, self._shares)
        self._filter.predict(self._way_m, self._turn_rad)
        self._way_m = self._turn_rad = 0.0
        parts, axes = self._parts()
        stray = self.settings.stray
        self._filter.agree_with((1 - stray) * parts[:, 0] + stray * self._filter.places)
        support = 1.0
        if frame_likelihood is not None:
            likelihoods = self._filter.update(frame_likelihood)
            support = float(parts[:, 0] @ likelihoods / likelihoods.max())
            if support >= self.settings.least_support and np.ptp(likelihoods) > 0:
                self._corrected.correct(*reweighted(parts, likelihoods), axes)
        return self._estimate(stamp_s, support)

    def estimate(self, stamp_s: float) -> RectifiedEstimate:
        """The pose between frames, by the wheels since the last one; areas and trust are as of that frame."""
        return self._estimate(stamp_s, 1.0)

    def _parts(self) -> tuple[FloatArray, FloatArray]:
        return self._floor.parts_of(self._corrected.mean[:2], self._corrected.covariance[:2, :2])

    def _estimate(self, stamp_s: float, support: float) -> RectifiedEstimate:
        pose, spread = pose_of(self._corrected, self._alone, self._filter.worth)
        x, y, yaw = pose
        # From x, y, yaw to the perturbation from the left, which turns about the map's origin.
        J = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [0.0, 0.0, 1.0]])
        covariance = np.zeros((6, 6))
        covariance[np.ix_(PLANE, PLANE)] = J @ spread @ J.T
        return RectifiedEstimate(
            stamp_s,
            Status.TRACKING,
            se3.from_plane(x, y, yaw),
            covariance,
            body="base",
            area_probabilities=self._filter.places[:-1],
            trust=self._filter.trust,
            support=support,
        )


def _start(T_odom_base: ArrayLike, settings: AreaRectifierSettings) -> PlaneBelief:
    T = np.asarray(T_odom_base, float)
    if not se3.is_valid(T):
        raise ConfigError("the pose at the start is none", fix="give T_odom_base (4, 4)")
    of_pose = (settings.position_sigma_m, settings.position_sigma_m, settings.yaw_sigma_rad)
    of_wheels = (settings.scale_sigma, settings.drift_sigma_rad_per_m, settings.turn_sigma)
    walk = np.square([settings.scale_walk, settings.drift_walk_rad_per_m, settings.turn_walk])
    return PlaneBelief(T[0, 3], T[1, 3], float(np.arctan2(T[1, 0], T[0, 0])), np.array(of_pose + of_wheels), walk)


def checked_shares(areas: AreaMap, area_shares: ArrayLike | None) -> FloatArray:
    """(A,) that sum to 1; of None, all alike. Raises ConfigError."""
    n = len(areas)
    if n == 0:
        raise ConfigError("there is no area to rectify by", fix="give areas")
    shares = np.full(n, 1 / n) if area_shares is None else np.asarray(area_shares, float)
    if shares.shape != (n,) or not (np.isfinite(shares).all() and (shares > 0).all()):
        raise ConfigError("area_shares are not one positive number an area", fix=f"give {n}")
    return np.asarray(shares / shares.sum())


def likelihood_of(probabilities: ArrayLike, shares: FloatArray) -> FloatArray:
    """(A,) what a frame says for each area, from the forest's probabilities (A,). Raises ConfigError."""
    probabilities = np.asarray(probabilities, float)
    if probabilities.shape != shares.shape:
        raise ConfigError(f"a frame has {probabilities.size} probabilities", fix=f"{len(shares)}, one an area")
    if not (np.isfinite(probabilities).all() and (probabilities >= 0).all() and probabilities.any()):
        raise ConfigError("a frame's probabilities are not", fix="0 to 1, finite, not all 0; None where unknown")
    return np.asarray(probabilities / shares)
