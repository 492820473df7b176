"""AreaRectifier: recursive correction of wheel odometry by recognized areas, with covariance.

It replaces eq. 5 of Trinh et al. The state is the planar pose of the base, and the errors of the wheels: scale of
distances, heading drift per metre (unequal radii) and scale of turns (track width), each of which may vary slowly.
Wheels predict the state. A frame corrects it by the likelihood of its result as a function of the position: for each
area that of the hidden Markov filter (`AreaFilter`), constant within that area (`FloorShares`). A Gaussian with the
same mean and covariance replaces the product of the Gaussian and that likelihood (assumed density filtering; Maybeck
1982, chapter 12). Heading and wheel errors follow by their correlation with the position.

If the forest fails for a while, the likelihoods of all areas become alike and the wheels continue alone. A second
belief uses the wheels alone, for the case that the forest is worthless. The estimate is the mean of both by the
probability of that. The areas are the only knowledge of the building.

`PlaceMeter` turns the same likelihoods into position measurements for a Kalman filter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.areas import AreaMap
from wheelsight.core.checks import array_of
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import Estimate, PoseFinding, WheelEstimate, status_of
from wheelsight.core.geometry import FloatArray, se2, se3, so3
from wheelsight.core.settings.fusion import AreaRectifierSettings
from wheelsight.estimation import area_kernels as kernels

# Errors of calibrated wheels: ratio of distances, rad/m of turn (1 % unequal, 0.5 m apart: 0.02), ratio of turns; and
# their random walks per √m (simulator).
_WHEEL_SIGMAS, _WHEEL_WALKS = (0.01, 0.015, 0.03), (0.0002, 0.0003, 0.0005)
_BORDER_M = 0.4  # from an area's border, within which a frame may still show the last area, or already the next one
_LEAST_SUPPORT = 0.01  # a result that agrees with less of the predicted position is an outlier
_STRAY = 0.001  # share of the area probabilities by adjacency alone, not by the position


@dataclass(frozen=True, slots=True, eq=False)
class RectifiedEstimate(Estimate):
    """A pose that is corrected by areas.

    Attributes:
        area_probabilities: (A,) of the areas; the rest to 1 is that of the floor outside all areas.
        trust: probability that the forest is informative and does not fail at present.
        support: share of the predicted position that agrees with the frame's area; 1 without a frame.
    """

    area_probabilities: FloatArray | None = None
    trust: float = 1.0
    support: float = 1.0


class AreaRectifier:
    """Corrects wheels by areas, frame by frame. The same input gives the same result bit for bit.

    Args:
        areas: in the order of the forest's probabilities, at least one.
        T_odom_base: (4, 4) planar pose at the start.
        settings: of the start; None for the defaults.
        area_shares: (A,) shares of the forest's training frames, which are the prior of its probabilities
            (`PlaceModel.area_shares`); None for equal shares.

    Raises:
        ConfigError: no area, an invalid pose, or shares that are not one positive number per area.
    """

    def __init__(
        self,
        areas: AreaMap,
        T_odom_base: ArrayLike,
        settings: AreaRectifierSettings | None = None,
        *,
        area_shares: ArrayLike | None = None,
    ) -> None:
        self._shares, settings = checked_shares(areas, area_shares), settings or AreaRectifierSettings()
        self._corrected, self._alone = (_start(T_odom_base, settings) for _ in range(2))
        self._floor = FloorShares(areas, _BORDER_M)
        self._filter = AreaFilter(areas, places=self._parts()[0][:, 0])
        self._way_m = self._turn_rad = 0.0
        self._has_begun = False

    def predict(self, T_before_now: ArrayLike, covariance: ArrayLike) -> None:
        """Predict by a step of the wheels.

        Args:
            T_before_now: (4, 4) current pose in the frame of the base before the step.
            covariance: (6, 6) of its left perturbation.

        Raises:
            ConfigError: numbers that are not finite.
        """
        T, covariance = array_of("T_before_now", T_before_now, (4, 4)), array_of("covariance", covariance, (6, 6))
        if not (np.isfinite(T).all() and np.isfinite(covariance).all()):
            raise ConfigError("a step of the wheels is not finite", fix="leave steps out that odometry refused")
        step = np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])
        # From the left perturbation, which rotates about the previous position, to forward and left.
        J = np.array([[1.0, 0.0, -step[1]], [0.0, 1.0, step[0]], [0.0, 0.0, 1.0]])
        noise = J @ covariance[np.ix_(PLANE, PLANE)] @ J.T
        for belief in (self._corrected, self._alone):
            belief.move(step, noise)
        self._way_m += float(np.hypot(step[0], step[1]))
        self._turn_rad += abs(float(step[2]))

    def predict_to(self, wheels: WheelEstimate) -> None:
        """Predict by the next estimate of wheel odometry. The first one is the start; its step is ignored.

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
        """Return the pose at a frame.

        Args:
            stamp_s: of the frame, up to which the wheels are predicted.
            probabilities: (A,) of the areas, from the forest; None for no measurement.

        Raises:
            ConfigError: probabilities that are not one per area, negative, not finite, or all zero.
        """
        frame_likelihood = None if probabilities is None else likelihood_of(probabilities, self._shares)
        self._filter.predict(self._way_m, self._turn_rad)
        self._way_m = self._turn_rad = 0.0
        parts, axes = self._parts()
        self._filter.agree_with((1 - _STRAY) * parts[:, 0] + _STRAY * self._filter.places)
        support = 1.0
        if frame_likelihood is not None:
            likelihoods = self._filter.update(frame_likelihood)
            support = float(parts[:, 0] @ likelihoods / likelihoods.max())
            if support >= _LEAST_SUPPORT and np.ptp(likelihoods) > 0:
                self._corrected.correct(*reweighted(parts, likelihoods), axes)
        return self._estimate(stamp_s, support)

    def estimate(self, stamp_s: float) -> RectifiedEstimate:
        """Return the pose between frames, by the wheels; areas and trust are those of the last frame."""
        return self._estimate(stamp_s, 1.0)

    def _parts(self) -> tuple[FloatArray, FloatArray]:
        return self._floor.parts_of(self._corrected.mean[:2], self._corrected.covariance[:2, :2])

    def _estimate(self, stamp_s: float, support: float) -> RectifiedEstimate:
        pose, spread = pose_of(self._corrected, self._alone, self._filter.worth)
        x, y, yaw = pose
        # From x, y, yaw to the left perturbation, which rotates about the map's origin.
        J = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [0.0, 0.0, 1.0]])
        covariance = np.zeros((6, 6))
        covariance[np.ix_(PLANE, PLANE)] = J @ spread @ J.T
        return RectifiedEstimate(
            stamp_s,
            status_of(PoseFinding.DEAD_RECKONED),
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
        raise ConfigError("the start pose is invalid", fix="give T_odom_base (4, 4)")
    of_pose = (settings.position_sigma_m, settings.position_sigma_m, settings.yaw_sigma_rad)
    of_wheels, walk = _WHEEL_SIGMAS, np.square(_WHEEL_WALKS)
    return PlaneBelief(T[0, 3], T[1, 3], float(np.arctan2(T[1, 0], T[0, 0])), np.array(of_pose + of_wheels), walk)


def checked_shares(areas: AreaMap, area_shares: ArrayLike | None) -> FloatArray:
    """Return shares (A,) that sum to 1; equal ones for None. Raises ConfigError."""
    n = len(areas)
    if n == 0:
        raise ConfigError("there is no area to rectify by", fix="give areas")
    shares = np.full(n, 1 / n) if area_shares is None else np.asarray(area_shares, float)
    if shares.shape != (n,) or not (np.isfinite(shares).all() and (shares > 0).all()):
        raise ConfigError("area_shares are not one positive number an area", fix=f"give {n}")
    return np.asarray(shares / shares.sum())


def likelihood_of(probabilities: ArrayLike, shares: FloatArray) -> FloatArray:
    """Return the likelihood of a frame in each area (A,), from the forest's probabilities. Raises ConfigError."""
    probabilities = np.asarray(probabilities, float)
    if probabilities.shape != shares.shape:
        raise ConfigError(f"a frame has {probabilities.size} probabilities", fix=f"{len(shares)}, one an area")
    if not (np.isfinite(probabilities).all() and (probabilities >= 0).all() and probabilities.any()):
        raise ConfigError("a frame's probabilities are not", fix="0 to 1, finite, not all 0; None where unknown")
    return np.asarray(probabilities / shares)


@dataclass(frozen=True)
class AreaFilterParameters:
    """What is assumed of areas and of the forest that recognizes them, before the first frame."""

    accuracies: tuple[float, ...] = (0.95, 0.8, 0.6)  # of a forest that does not fail, one level each
    # Way after which the result of a failing forest changes, metres: decades, one level each.
    failing_appearances_m: tuple[float, ...] = (0.1, 1.0, 5.0, 25.0)
    worth: float = 0.9  # probability that the forest is informative
    appearance_m: float = 1.0  # way after which a result is independent of the last one
    appearance_per_rad_m: float = 0.5  # way that a turn by a radian counts as
    area_m: float = 10.0  # mean way through an area: some rooms
    level_m: float = 200.0  # mean way until the level of a forest that does not fail changes
    failure_m: float = 2000.0  # mean way until it fails
    recovery_m: float = 15.0  # mean way until it no longer does
    blip: float = 0.05  # share of single frames whose result is arbitrary
    neighbour_share: float = 0.5  # of the wrong results, those of a neighbouring area


class AreaFilter:
    """A hidden Markov filter over level, place and appearance.

    Three variables are hidden. The level is the current accuracy of the forest. The place is the area of the robot, or
    the floor outside all areas. The appearance is the area that frames look like. Frames from nearby poses look alike
    and are wrong together. So the appearance stays while the robot hardly moves, and is drawn again, from the
    confusions of a forest of that level, about once every `appearance_m`. A run of wrong results counts once.
    On the last levels, appearances do not depend on the area and stay for shorter or longer distances: a forest that
    fails for a while.

    The alternative hypothesis is a forest that was never informative: appearances do not depend on the area from the
    first frame on. The log-likelihood ratio of each result decides between both (`worth`). A forest that always gives
    the same result, or confuses areas, keeps its appearances for long. Only appearances that change with the areas
    support the forest.

    Forward filtering is exact (Rabiner 1989, section III.A). `update` returns the likelihood of one frame given all
    frames before it, which a filter of the position can use as a measurement without counting anything twice.

    Args:
        areas: in the order of the forest's probabilities.
        settings: of the method; None for the defaults.
        places: (A + 1,) probabilities of the places at the start; None for equal areas.
    """

    def __init__(
        self, areas: AreaMap, settings: AreaFilterParameters | None = None, places: FloatArray | None = None
    ) -> None:
        self._settings = settings or AreaFilterParameters()
        self._appearances = _appearances_of(areas, self._settings)
        # (A + 1, A + 1) transitions on leaving a place: to a neighbour or outside; from outside, to any area.
        n = len(areas)
        moves = np.ones((n + 1, n + 1)) - np.eye(n + 1)
        moves[:n, :n] = areas.adjacency().astype(float) - np.eye(n)
        self._moves = np.asarray(moves / moves.sum(axis=1, keepdims=True))
        start = np.append(np.full(len(areas), 1 / len(areas)), 0.0) if places is None else np.asarray(places, float)
        n_right, n_failing = len(self._settings.accuracies), len(self._settings.failing_appearances_m)
        levels = np.append(np.full(n_right, 1 / n_right), np.zeros(n_failing))
        self._n_right = n_right
        self._appearance_m = np.append(
            np.full(n_right, self._settings.appearance_m), self._settings.failing_appearances_m
        )
        self._rate_per_m, self._jumps = _level_jumps(self._settings)
        self._belief = levels[:, None, None] * start[None, :, None] * self._appearances
        self._worthless = np.full((n_failing, len(areas)), 1 / (n_failing * len(areas)))
        self._log_odds = np.log(self._settings.worth / (1 - self._settings.worth))

    @property
    def belief(self) -> FloatArray:
        """(L, A + 1, A) of level, place and appearance, given an informative forest; failing levels are last."""
        return np.array(self._belief)

    @property
    def places(self) -> FloatArray:
        """(A + 1,) probabilities of the areas, and of the floor outside them."""
        return np.asarray(self._belief.sum(axis=(0, 2)))

    @property
    def trust(self) -> float:
        """Probability that the forest is informative and does not fail at present."""
        return self.worth * float(self._belief[: self._n_right].sum())

    @property
    def worth(self) -> float:
        """Probability that the forest is informative, by all its results so far."""
        return float(1 / (1 + np.exp(-np.clip(self._log_odds, -700, 700))))

    def predict(self, way_m: float, turn_rad: float = 0.0) -> None:
        """Predict place, level and appearance by the absolute distance and turn."""
        settings = self._settings
        belief = self._belief
        left = 1 - np.exp(-way_m / settings.area_m)
        belief = (1 - left) * belief + left * np.einsum("pq,lpc->lqc", self._moves, belief)
        changed = 1 - np.exp(-way_m * self._rate_per_m)
        belief = (1 - changed) * belief + changed * np.tensordot(self._jumps, belief, axes=(0, 0))
        kept = np.exp(-(way_m + settings.appearance_per_rad_m * turn_rad) / self._appearance_m)[:, None, None]
        self._belief = kept * belief + (1 - kept) * self._appearances * belief.sum(axis=2, keepdims=True)
        kept, appearances = kept[self._n_right :, 0], self._appearances[self._n_right :, 0]
        self._worthless = kept * self._worthless + (1 - kept) * appearances * self._worthless.sum(axis=1, keepdims=True)

    def agree_with(self, places: FloatArray) -> None:
        """Set the marginal probabilities (A + 1,) of the places; the conditional ones stay."""
        known = self._belief.sum(axis=(0, 2))
        fallback = self._belief.sum(axis=1).sum(axis=1)[:, None, None] * self._appearances
        share = np.divide(self._belief, known[None, :, None], out=fallback, where=known[None, :, None] > 1e-300)
        self._belief = share * np.asarray(places, float)[None, :, None]
        self._belief /= self._belief.sum()

    def update(self, frame_likelihood: FloatArray) -> FloatArray:
        """Update by a frame.

        Args:
            frame_likelihood: (A,) likelihood of each appearance, p(area | frame) / p(area), up to a factor.

        Returns:
            (A + 1,) the frame's likelihood in each place, given all frames before; of mean 1 over the places.
        """
        frame_likelihood = frame_likelihood / max(frame_likelihood.mean(), 1e-300)
        frame_likelihood = (1 - self._settings.blip) * frame_likelihood + self._settings.blip
        before = self._belief.sum(axis=(0, 2))
        after = self._belief * frame_likelihood
        likelihoods = np.divide(after.sum(axis=(0, 2)), before, out=np.ones(len(before)), where=before > 1e-300)
        total = float(after.sum())
        self._belief = after / total
        worthless = self._worthless * frame_likelihood
        self._worthless = worthless / worthless.sum()
        self._log_odds += np.log(total / worthless.sum())
        return np.asarray(likelihoods / total)


def _level_jumps(settings: AreaFilterParameters) -> tuple[float, FloatArray]:
    """Return how often per metre a level may change, and the transitions (L, L) then, from row to column."""
    n, k = len(settings.accuracies), len(settings.failing_appearances_m)
    rates = np.zeros((n + k, n + k))
    rates[:n, :n] = 1 / (settings.level_m * n)
    # An informative forest rarely gets stuck: failures with a longer appearance are rarer.
    rare = 1 / np.maximum(np.array(settings.failing_appearances_m) / settings.appearance_m, 1)
    rates[:n, n:] = rare / rare.sum() / settings.failure_m
    rates[n:, :n] = 1 / (settings.recovery_m * n)
    np.fill_diagonal(rates, 0.0)
    fastest = float(rates.sum(axis=1).max())
    return fastest, np.eye(n + k) + (rates - np.diag(rates.sum(axis=1))) / fastest


def _appearances_of(areas: AreaMap, settings: AreaFilterParameters) -> FloatArray:
    """Return the probability (L, A + 1, A) of each appearance by level and place; uniform outside the areas."""
    n = len(areas)
    own = np.eye(n)
    near = areas.adjacency().astype(float) - own
    far = 1 - own
    near = np.where(near.sum(axis=1, keepdims=True) > 0, near, far)
    near, far = (wrong / np.maximum(wrong.sum(axis=1, keepdims=True), 1) for wrong in (near, far))
    wrong = settings.neighbour_share * near + (1 - settings.neighbour_share) * far
    appearances = np.full((len(settings.accuracies) + len(settings.failing_appearances_m), n + 1, n), 1 / n)
    for level, accuracy in enumerate(settings.accuracies):
        appearances[level, :n] = accuracy * own + (1 - accuracy) * wrong if n > 1 else 1.0
    return appearances


_OPEN = 1e6  # variance of an unmeasured direction, relative to the predicted one
_NARROWEST, _WIDEST = 1e-6, 1 - 1e-4


class PlaceMeter:
    """Measures positions by areas, frame by frame, for a Kalman filter. The same input gives the same result.

    The likelihood of the position by the area filter is not Gaussian. Its product with the filter's predicted position
    has a mean and a covariance. `measure` returns the measurement that moves the prediction there, as expectation
    propagation replaces a factor by a Gaussian (Minka, UAI 2001). Directions in which the prediction gets no narrower,
    such as along a corridor, get a very large variance.

    Args:
        areas: in the order of the forest's probabilities, at least one.
        area_shares: (A,) shares of the forest's training frames; None for equal shares.

    Raises:
        ConfigError: no area, or shares that are not one positive number per area.
    """

    def __init__(self, areas: AreaMap, area_shares: ArrayLike | None = None) -> None:
        self._areas, self._shares = areas, checked_shares(areas, area_shares)
        self._floor = FloorShares(areas, _BORDER_M)
        self._filter: AreaFilter | None = None
        self._T_odom_last = np.eye(4)

    def measure(
        self, T_odom_base: FloatArray, covariance: FloatArray, probabilities: ArrayLike | None
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return the position of a frame by its area.

        Args:
            T_odom_base: (4, 4) predicted pose at the frame.
            covariance: (6, 6) of its left perturbation.
            probabilities: (A,) of the areas, from the forest; None for no measurement.

        Returns:
            x, y (2,) in the map, metres, and covariance (2, 2); None without information, or if the area hardly
            agrees with the prediction.

        Raises:
            ConfigError: probabilities that are not one per area, negative, not finite, or all zero.
        """
        frame_likelihood = None if probabilities is None else likelihood_of(probabilities, self._shares)
        xy = T_odom_base[:2, 3]
        parts, axes = self._floor.parts_of(xy, se3.position_covariance(T_odom_base, covariance)[:2, :2])
        areas = self._predicted(T_odom_base, parts[:, 0])
        if frame_likelihood is None:
            return None
        likelihoods = areas.update(frame_likelihood)
        # The result of an uninformative forest has the likelihood 1 in all areas.
        likelihoods = 1 + areas.worth * (likelihoods - 1)
        if parts[:, 0] @ likelihoods / likelihoods.max() < _LEAST_SUPPORT:
            return None
        found = equivalent(*reweighted(parts, likelihoods))
        if found is None:
            return None
        offset, spread = axes @ found[0], axes @ found[1] @ axes.T
        return xy + offset, (spread + spread.T) / 2

    def _predicted(self, T_odom_base: FloatArray, places: FloatArray) -> AreaFilter:
        """Return the area filter, predicted at a frame's pose, with its probabilities (A + 1,) of the places."""
        if self._filter is None:
            self._filter = AreaFilter(self._areas, places=places)
        else:
            T_last_now = se3.invert(self._T_odom_last) @ T_odom_base
            self._filter.predict(float(np.hypot(*T_last_now[:2, 3])), float(so3.angle(T_last_now[:3, :3])))
            self._filter.agree_with((1 - _STRAY) * places + _STRAY * self._filter.places)
        self._T_odom_last = T_odom_base
        return self._filter


def equivalent(mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the measurement (2,) with covariance (2, 2) that updates N(0, I) to N(mean, covariance), or None.

    Along an axis of the covariance with variance c and mean m it is m / (1 - c) with c / (1 - c). Axes with c ≥ 1 have
    none.
    """
    variances, directions = np.linalg.eigh(covariance)
    is_measured = variances < _WIDEST
    if not is_measured.any():
        return None
    left = np.where(is_measured, np.maximum(variances, _NARROWEST), 0.0)
    values = np.where(is_measured, directions.T @ mean / (1 - left), 0.0)
    spread = np.where(is_measured, left / (1 - left), _OPEN)
    return directions @ values, (directions * spread) @ directions.T


_MOST_SHARES = 4_000_000
_FEWEST_STEPS, _MOST_STEPS = 15, 81


class FloorShares:
    """Share of each point of the floor in each area, sampled on a grid.

    Borders are soft because the recognized area changes a little before or behind the drawn line.

    Args:
        areas: at least one.
        border_m: standard deviation of the Gaussian that blurs the areas.
        cell_m: of the grid; larger for a large floor, to limit memory.
    """

    def __init__(self, areas: AreaMap, border_m: float = 0.4, cell_m: float = 0.1) -> None:
        from scipy.ndimage import gaussian_filter

        corners = np.concatenate([area.polygon for area in areas])
        low, high = corners.min(axis=0) - 4 * border_m, corners.max(axis=0) + 4 * border_m
        self._cell_m = max(cell_m, float(np.sqrt(np.prod(high - low) * len(areas) / _MOST_SHARES)))
        # Shifted by half a cell: borders on multiples of a decimetre lie between samples, which favours no area.
        low = corners.min(axis=0) - (np.ceil(4 * border_m / self._cell_m) + 1.5) * self._cell_m
        high = high + 2 * self._cell_m
        columns, rows = np.ceil((high - low) / self._cell_m).astype(int) + 1
        x, y = (low[axis] + self._cell_m * np.arange(n) for axis, n in enumerate((columns, rows)))
        index = areas.index_at(np.stack(np.meshgrid(x, y), axis=-1))
        sharp = (index[..., None] == np.arange(len(areas))).astype(np.float32)
        blur = border_m / self._cell_m
        self._shares = np.ascontiguousarray(gaussian_filter(sharp, (blur, blur, 0), mode="constant", truncate=4.0))
        self._corner = low

    def parts_of(self, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the parts of a Gaussian in the areas.

        Args:
            mean: (2,) metres.
            covariance: (2, 2) m².

        Returns:
            (A + 1, 6) mass and moments, see `area_kernels.parts_in_areas`, and their axes (2, 2).
        """
        variances, directions = np.linalg.eigh(covariance)
        sigmas = np.sqrt(np.maximum(variances, 1e-12))
        axes = np.ascontiguousarray(directions * sigmas)
        finest_m = 2.5 * self._cell_m
        steps = np.clip(np.ceil(2 * kernels.REACH * sigmas / finest_m), _FEWEST_STEPS, _MOST_STEPS).astype(int)
        parts = kernels.parts_in_areas(mean, axes, steps[0], steps[1], self._shares, self._corner, self._cell_m)
        return parts, axes


def reweighted(parts: FloatArray, likelihoods: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (2,) and covariance (2, 2), along the axes of the parts, of a Gaussian times `likelihoods` (A + 1,).

    The rounding of the grid is corrected: equal likelihoods give mean 0 and covariance 1 exactly.
    """

    def moments(weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        total = weights @ parts
        first, second = total[1:3] / total[0], total[3:6] / total[0]
        return first, np.array([[second[0], second[1]], [second[1], second[2]]]) - np.outer(first, first)

    base_mean, base_covariance = moments(np.ones(len(parts)))
    mean, covariance = moments(likelihoods / likelihoods.max())
    rescale = 1 / np.sqrt(np.diag(base_covariance))
    return (mean - base_mean) * rescale, covariance * np.outer(rescale, rescale)


PLANE = np.array([0, 1, 5])  # vx, vy, ωz of a (6,) perturbation


class PlaneBelief:
    """Mean and covariance of x, y in metres, yaw in radians, and the wheels' errors: scale, drift, turn.

    Scale is the relative error of distances, drift that of the heading in rad/m, turn the relative error of turns.

    Args:
        x_m, y_m, yaw_rad: at the start.
        sigmas: (6,) of the state at the start.
        walk: (3,) growth of the variances of scale, drift and turn per metre.
    """

    def __init__(self, x_m: float, y_m: float, yaw_rad: float, sigmas: FloatArray, walk: FloatArray) -> None:
        self.mean = np.array([x_m, y_m, yaw_rad, 0.0, 0.0, 0.0])
        self.covariance = np.diag(np.square(sigmas))
        self._walk = walk

    def move(self, step: FloatArray, step_covariance: FloatArray) -> None:
        """Predict by a step of the wheels (3,), forward, left, yaw, with its covariance (3, 3)."""
        kernels.step(self.mean, self.covariance, step, step_covariance, self._walk)

    def correct(self, mean: FloatArray, covariance: FloatArray, axes: FloatArray) -> None:
        """Set mean (2,) and covariance (2, 2) of the position along `axes`, in which they were 0 and the identity.

        `axes` (2, 2) is a root of the position's covariance, `axes @ axes.T`. The rest follows by its correlation.
        """
        gain = np.linalg.solve(axes, self.covariance[:2]).T
        self.mean += gain @ mean
        grown = self.covariance + gain @ (covariance - np.eye(2)) @ gain.T
        self.covariance = (grown + grown.T) / 2


def pose_of(one: PlaneBelief, other: PlaneBelief, share: float) -> tuple[FloatArray, FloatArray]:
    """Return x, y, yaw (3,) and their covariance (3, 3) of a mixture, in which `one` has the probability `share`."""
    apart = one.mean[:3] - other.mean[:3]
    apart[2] = se2.wrap_angle(apart[2])
    within = share * one.covariance[:3, :3] + (1 - share) * other.covariance[:3, :3]
    return other.mean[:3] + share * apart, within + share * (1 - share) * np.outer(apart, apart)
