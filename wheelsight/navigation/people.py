"""PeopleTracker: detects walking people in depth images and tracks them with constant-velocity Kalman filters."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, chi_square, se2
from wheelsight.navigation.settings import PeopleSettings
from wheelsight.navigation.surroundings import DepthView


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """A walking person.

    Attributes:
        position: (2,) metres.
        velocity: (2,) metres per second.
        covariance: (4, 4) of both.
        radius_m: radius of a circle that encloses the person.
    """

    position: FloatArray
    velocity: FloatArray
    covariance: FloatArray
    radius_m: float

    def carried(self, T: FloatArray) -> Person:
        """Return the person in another frame; T (3,) x, y, yaw maps points there."""
        M = se2.from_parts(*T)
        R = M[:2, :2]
        both = np.kron(np.eye(2), R)
        return Person(R @ self.position + M[:2, 2], R @ self.velocity, both @ self.covariance @ both.T, self.radius_m)


class PeopleTracker:
    """Tracks people in `odom` by nearest neighbours and a Kalman filter each.

    `odom` never jumps. Objects that stand are no people; they stay in the live layer.

    Args:
        settings: None for the defaults.
        far_m: range of the camera.
    """

    def __init__(self, settings: PeopleSettings | None = None, far_m: float = 4.5) -> None:
        self.settings = settings or PeopleSettings()
        self._far_m = far_m
        self._gate, self._sure = (chi_square.quantile(share, 2) for share in (self.settings.gate, self.settings.sure))
        self._tracked: list[_Tracked] = []

    def forget(self) -> None:
        """Drop all tracks."""
        self._tracked.clear()

    def update(self, view: DepthView, pose: FloatArray, is_on_floor: BoolArray) -> None:
        """Update the tracks with a frame.

        Args:
            view: of the frame.
            pose: (3,) x, y, yaw of the base in `odom` at its time.
            is_on_floor: (N,) whether each point lies on free floor of the map, away from obstacles.
        """
        s = self.settings
        T = se2.from_parts(*pose)
        R = T[:2, :2]
        seen = [
            Detection(R @ detection.middle + T[:2, 2], R @ detection.covariance @ R.T, detection.radius_m)
            for detection in detections_in(view, is_on_floor, self._far_m, s)
        ]
        for one in self._tracked:
            one.track.predict(view.stamp_s)
        pairs = self._pairs(seen)
        for number, one in pairs.items():
            one.update(seen[number], view.stamp_s, self._sure)
        self._tracked = [one for one in self._tracked if view.stamp_s - one.seen_s <= s.unseen_s]
        self._tracked += [_Tracked(detection, view.stamp_s, s) for k, detection in enumerate(seen) if k not in pairs]

    def people(self, now_s: float) -> tuple[Person, ...]:
        """Return the walking people, in `odom`, predicted to a time."""
        return tuple(one.person(now_s) for one in self._tracked if one.walks)

    def _pairs(self, seen: Sequence[Detection]) -> dict[int, _Tracked]:
        """Return the track of each object by its number: nearest pairs first, each track once."""
        ways = sorted(
            (one.track.distance(detection.middle, detection.covariance), number, k)
            for number, detection in enumerate(seen)
            for k, one in enumerate(self._tracked)
        )
        pairs: dict[int, _Tracked] = {}
        for distance, number, k in ways:
            one = self._tracked[k]
            if distance <= self._gate and number not in pairs and one not in pairs.values():
                pairs[number] = one
        return pairs


class _Tracked:
    """An object that is tracked from frame to frame."""

    def __init__(self, detection: Detection, stamp_s: float, settings: PeopleSettings) -> None:
        s = self._settings = settings
        self.track = Track(stamp_s, detection.middle, detection.covariance, s.walk_m_s, s.change_m2_s3)
        self.seen_s, self.walks, self._radius_m = stamp_s, False, detection.radius_m
        self._middles = deque([detection.middle], s.frames)

    def update(self, detection: Detection, stamp_s: float, sure: float) -> None:
        """Update it by an observation. It walks if it is significantly fast, and has left its place."""
        self.track.correct(detection.middle, detection.covariance)
        self.seen_s, self._radius_m = stamp_s, detection.radius_m
        self._middles.append(detection.middle)
        s, way_m = self._settings, float(np.hypot(*(self._middles[-1] - self._middles[0])))
        is_quick = self.track.speed_m_s >= s.least_m_s and self.track.speed_distance > sure
        self.walks = len(self._middles) == s.frames and is_quick and way_m >= s.way_m

    def person(self, now_s: float) -> Person:
        """Return it as a person, predicted to a time."""
        state, covariance = self.track.at(now_s)
        return Person(state[:2], state[2:], covariance, self._radius_m)


def discs_of(people: Sequence[Person]) -> FloatArray:
    """Return (P, 5) x, y, vx, vy, radius, as controllers use them."""
    return np.array([[*one.position, *one.velocity, one.radius_m] for one in people]).reshape(-1, 5)


# Columns beside an object in which a nearer one would hide a part of it.
_BESIDE = 2


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """An object of a person's width that a depth image shows completely, on free floor of the map.

    Attributes:
        middle: (2,) its centre in `base`, metres: as far behind its surface as that of a person.
        covariance: (2, 2) of the centre.
        radius_m: half of its width, at least that of a person.
    """

    middle: FloatArray
    covariance: FloatArray
    radius_m: float


def detections_in(view: DepthView, is_on_floor: BoolArray, far_m: float, settings: PeopleSettings) -> list[Detection]:
    """Return the objects in a view that may be people.

    Args:
        view: of the frame.
        is_on_floor: (N,) whether each point lies on free floor of the map.
        far_m: range of the camera.
        settings: of people.
    """
    if not is_on_floor.any():
        return []
    seen = _Seen.of(view)
    number = np.full(len(view.points), -1)
    # Points with gaps of at most `gap_m` between them are one object.
    points = view.points[is_on_floor]
    pairs = cKDTree(points).query_pairs(settings.gap_m, output_type="ndarray")
    near = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), (len(points), len(points)))
    number[is_on_floor] = np.asarray(connected_components(near, directed=False)[1])
    whole = [
        which
        for which in (number == at for at in range(int(number.max()) + 1))
        if which.sum() >= settings.least_points and seen.is_whole(which, far_m, settings)
    ]
    camera = np.array(view.camera)
    detections = [_detection(view.points[which] - camera, camera, settings) for which in whole]
    return [detection for detection in detections if 2 * detection.radius_m <= settings.widest_m]


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Points of a view: column and distance from the camera (N,), and the number of columns."""

    column: IntArray
    range_m: FloatArray
    columns: int

    @classmethod
    def of(cls, view: DepthView) -> _Seen:
        """Return the points of a view."""
        apart = view.points - view.camera
        turned = (np.arctan2(apart[:, 1], apart[:, 0]) - view.first_rad) % (2 * np.pi)
        return cls(np.floor(turned / view.step_rad).astype(int), np.hypot(*apart.T), len(view.seen_m))

    def is_whole(self, which: BoolArray, far_m: float, settings: PeopleSettings) -> bool:
        """Return whether neither the view's edge nor a nearer object cuts it: a cut would move with the camera."""
        low, high = int(self.column[which].min()), int(self.column[which].max())
        if low < _BESIDE or high >= self.columns - _BESIDE or self.range_m[which].max() > far_m - settings.gap_m:
            return False
        near = ~which & (self.range_m < self.range_m[which].min())
        return not (near & (self.column >= low - _BESIDE) & (self.column <= high + _BESIDE)).any()


def _detection(points: FloatArray, camera: FloatArray, settings: PeopleSettings) -> Detection:
    """Return the object of points (N, 2) relative to the camera."""
    seen = points.mean(axis=0)
    range_m = float(np.hypot(*seen))
    along = seen / max(range_m, 1e-6)
    across = np.array([-along[1], along[0]])
    # The centroid of a half circle's line is 2 / π of the radius in front of the circle's centre.
    middle = camera + seen + 2 / np.pi * settings.body_m * along
    side = points @ across
    off = settings.sigma_m**2 * np.eye(2) + (settings.sigma_rad * range_m) ** 2 * np.outer(across, across)
    return Detection(middle, off, max(settings.body_m, float(np.ptp(side)) / 2))


# Observation matrix: positions.
_SEEN = np.eye(2, 4)


class Track:
    """Kalman filter of an object with constant velocity and white noise in its acceleration.

    From Bar-Shalom, Li, Kirubarajan: Estimation, 6.2.2.

    Args:
        stamp_s: time of the first observation.
        position: (2,) its place, metres.
        covariance: (2, 2) of the place.
        speed_sigma_m_s: prior standard deviation of the velocity along each axis.
        change_m2_s3: power spectral density of the acceleration.

    Attributes:
        stamp_s: time of the state.
        state: (4,) x, y, vx, vy.
        covariance: (4, 4).
    """

    def __init__(
        self,
        stamp_s: float,
        position: FloatArray,
        covariance: FloatArray,
        speed_sigma_m_s: float,
        change_m2_s3: float,
    ) -> None:
        self.stamp_s = stamp_s
        self.state: FloatArray = np.array([*position, 0.0, 0.0], float)
        self.covariance: FloatArray = np.zeros((4, 4))
        self.covariance[:2, :2], self.covariance[2:, 2:] = covariance, speed_sigma_m_s**2 * np.eye(2)
        self._change = change_m2_s3

    def at(self, stamp_s: float) -> tuple[FloatArray, FloatArray]:
        """Return state (4,) and covariance (4, 4) predicted to a time."""
        step_s = stamp_s - self.stamp_s
        F = np.kron(np.array([[1.0, step_s], [0.0, 1.0]]), np.eye(2))
        ahead_s = abs(step_s)
        noise = np.array([[ahead_s**3 / 3, step_s * ahead_s / 2], [step_s * ahead_s / 2, ahead_s]])
        return F @ self.state, F @ self.covariance @ F.T + self._change * np.kron(noise, np.eye(2))

    def predict(self, stamp_s: float) -> None:
        """Predict to a later time."""
        self.state, self.covariance = self.at(stamp_s)
        self.stamp_s = stamp_s

    def distance(self, position: FloatArray, covariance: FloatArray) -> float:
        """Return the squared Mahalanobis distance of an observation, (2,) with (2, 2): χ² of two degrees of freedom."""
        off = position - self.state[:2]
        return float(off @ np.linalg.solve(self.covariance[:2, :2] + covariance, off))

    def correct(self, position: FloatArray, covariance: FloatArray) -> None:
        """Update by an observation, (2,) with (2, 2)."""
        S = self.covariance[:2, :2] + covariance
        K = np.linalg.solve(S, self.covariance[:2]).T
        self.state = self.state + K @ (position - self.state[:2])
        left = np.eye(4) - K @ _SEEN
        # Joseph's form stays symmetric and positive definite.
        self.covariance = left @ self.covariance @ left.T + K @ covariance @ K.T

    @property
    def speed_m_s(self) -> float:
        """Speed."""
        return float(np.hypot(*self.state[2:]))

    @property
    def speed_distance(self) -> float:
        """Squared Mahalanobis distance of the velocity from zero: χ² of two degrees of freedom if it stands."""
        return float(self.state[2:] @ np.linalg.solve(self.covariance[2:, 2:], self.state[2:]))
