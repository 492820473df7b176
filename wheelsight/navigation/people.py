"""PeopleTracker: who walks about a robot, where to and how fast, by what its depth camera sees.

What moves is followed in `odom`, which never jumps, from the pose of each frame. Something that stands is nobody who
walks, and stays with the live layer of the costmap.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import BoolArray, FloatArray, chi_square, se2
from wheelsight.navigation.constant_velocity import Track
from wheelsight.navigation.people_settings import PeopleSettings
from wheelsight.navigation.surroundings import DepthView
from wheelsight.navigation.things import Thing, things_in


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """Somebody who walks.

    Attributes:
        position: (2,) metres.
        velocity: (2,) metres a second.
        covariance: (4, 4) of both.
        radius_m: of a circle about all of him.
    """

    position: FloatArray
    velocity: FloatArray
    covariance: FloatArray
    radius_m: float

    def carried(self, T: FloatArray) -> Person:
        """The same in another frame, by the motion (3,) x, y, yaw that carries points there."""
        M = se2.from_parts(*T)
        R = M[:2, :2]
        both = np.kron(np.eye(2), R)
        return Person(R @ self.position + M[:2, 2], R @ self.velocity, both @ self.covariance @ both.T, self.radius_m)


class PeopleTracker:
    """See the module: nearest neighbour, and a Kalman filter each.

    Args:
        settings: or the defaults.
        far_m: farther from the camera nothing is seen.
    """

    def __init__(self, settings: PeopleSettings | None = None, far_m: float = 4.5) -> None:
        self.settings = settings or PeopleSettings()
        self._far_m = far_m
        self._gate, self._sure = (chi_square.quantile(share, 2) for share in (self.settings.gate, self.settings.sure))
        self._followed: list[_Followed] = []

    def forget(self) -> None:
        """Nobody is known any more."""
        self._followed.clear()

    def update(self, view: DepthView, pose: FloatArray, is_on_floor: BoolArray) -> None:
        """See a frame.

        Args:
            view: of it.
            pose: (3,) x, y, yaw of the base in `odom` when it was taken.
            is_on_floor: (N,) of its points, whether the map has free floor there, and nothing close by.
        """
        s = self.settings
        seen = [_placed(thing, pose) for thing in things_in(view, is_on_floor, self._far_m, s)]
        for one in self._followed:
            one.track.predict(view.stamp_s)
        pairs = self._pairs(seen)
        for number, one in pairs.items():
            one.see(seen[number], view.stamp_s, self._sure)
        self._followed = [one for one in self._followed if view.stamp_s - one.seen_s <= s.unseen_s]
        self._followed += [_Followed(thing, view.stamp_s, s) for k, thing in enumerate(seen) if k not in pairs]

    def people(self, now_s: float) -> tuple[Person, ...]:
        """Who walks, in `odom`, where he is now."""
        return tuple(one.person(now_s) for one in self._followed if one.walks)

    def _pairs(self, seen: Sequence[Thing]) -> dict[int, _Followed]:
        """Which thing, by its number, is whom: the nearest first, each once."""
        ways = sorted(
            (one.track.distance(thing.middle, thing.covariance), number, k)
            for number, thing in enumerate(seen)
            for k, one in enumerate(self._followed)
        )
        pairs: dict[int, _Followed] = {}
        for distance, number, k in ways:
            one = self._followed[k]
            if distance <= self._gate and number not in pairs and one not in pairs.values():
                pairs[number] = one
        return pairs


class _Followed:
    """A thing that is followed from frame to frame."""

    def __init__(self, thing: Thing, stamp_s: float, settings: PeopleSettings) -> None:
        s = self._settings = settings
        self.track = Track(stamp_s, thing.middle, thing.covariance, s.walk_m_s, s.change_m2_s3)
        self.seen_s, self.walks, self._radius_m = stamp_s, False, thing.radius_m
        self._middles = deque([thing.middle], s.frames)

    def see(self, thing: Thing, stamp_s: float, sure: float) -> None:
        """Take what is seen of it now; it walks where it is sure to be quick, and has left where it was."""
        self.track.correct(thing.middle, thing.covariance)
        self.seen_s, self._radius_m = stamp_s, thing.radius_m
        self._middles.append(thing.middle)
        s, way_m = self._settings, float(np.hypot(*(self._middles[-1] - self._middles[0])))
        is_quick = self.track.speed_m_s >= s.least_m_s and self.track.speed_distance > sure
        self.walks = len(self._middles) == s.frames and is_quick and way_m >= s.way_m

    def person(self, now_s: float) -> Person:
        state, covariance = self.track.at(now_s)
        return Person(state[:2], state[2:], covariance, self._radius_m)


def discs_of(people: Sequence[Person]) -> FloatArray:
    """(P, 5) x, y, vx, vy, radius, as controllers take them."""
    return np.array([[*one.position, *one.velocity, one.radius_m] for one in people]).reshape(-1, 5)


def _placed(thing: Thing, pose: FloatArray) -> Thing:
    """The same where a base at a pose (3,) sees it."""
    T = se2.from_parts(*pose)
    R = T[:2, :2]
    return Thing(R @ thing.middle + T[:2, 2], R @ thing.covariance @ R.T, thing.radius_m)
