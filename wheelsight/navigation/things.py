"""Thing: something of a person's width that a depth image shows whole, on floor that is free in the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from wheelsight.geometry import BoolArray, FloatArray, IntArray
from wheelsight.navigation.people_settings import PeopleSettings
from wheelsight.navigation.surroundings import DepthView

# Columns beside a thing in which something nearer would hide a part of it.
_BESIDE = 2


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """Seen in one depth image.

    Attributes:
        middle: (2,) of it in `base`, metres: as far behind what is seen of it as a person's is.
        covariance: (2, 2) of that.
        radius_m: half of how wide it is, and a person's at the least.
    """

    middle: FloatArray
    covariance: FloatArray
    radius_m: float


def things_in(view: DepthView, is_on_floor: BoolArray, far_m: float, settings: PeopleSettings) -> list[Thing]:
    """What may be a person in a view.

    Args:
        view: of the frame.
        is_on_floor: (N,) of its points, whether the map has free floor there.
        far_m: farther from the camera nothing is seen.
        settings: of people.
    """
    if not is_on_floor.any():
        return []
    seen = _Seen.of(view)
    number = np.full(len(view.points), -1)
    number[is_on_floor] = _numbers(view.points[is_on_floor], settings.gap_m)
    whole = [
        which
        for which in (number == at for at in range(int(number.max()) + 1))
        if which.sum() >= settings.least_points and seen.is_whole(which, far_m, settings)
    ]
    camera = np.array(view.camera)
    things = [_thing(view.points[which] - camera, camera, settings) for which in whole]
    return [thing for thing in things if 2 * thing.radius_m <= settings.widest_m]


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Points as the camera has them: column and distance (N,), and how many columns there are."""

    column: IntArray
    range_m: FloatArray
    columns: int

    @classmethod
    def of(cls, view: DepthView) -> _Seen:
        apart = view.points - view.camera
        turned = (np.arctan2(apart[:, 1], apart[:, 0]) - view.first_rad) % (2 * np.pi)
        return cls(np.floor(turned / view.step_rad).astype(int), np.hypot(*apart.T), len(view.seen_m))

    def is_whole(self, which: BoolArray, far_m: float, settings: PeopleSettings) -> bool:
        """Whether neither the view's edge nor a nearer thing cuts it off: what is cut off moves as the camera does."""
        low, high = int(self.column[which].min()), int(self.column[which].max())
        if low < _BESIDE or high >= self.columns - _BESIDE or self.range_m[which].max() > far_m - settings.gap_m:
            return False
        near = ~which & (self.range_m < self.range_m[which].min())
        return not (near & (self.column >= low - _BESIDE) & (self.column <= high + _BESIDE)).any()


def _numbers(points: FloatArray, gap_m: float) -> IntArray:
    """(N,) number of the thing that each point (N, 2) is of: they hang together by gaps of so much at most."""
    pairs = cKDTree(points).query_pairs(gap_m, output_type="ndarray")
    shape = len(points), len(points)
    near = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape)
    return np.asarray(connected_components(near, directed=False)[1])


def _thing(points: FloatArray, camera: FloatArray, settings: PeopleSettings) -> Thing:
    """Of points (N, 2) from the camera."""
    seen = points.mean(axis=0)
    range_m = float(np.hypot(*seen))
    along = seen / max(range_m, 1e-6)
    across = np.array([-along[1], along[0]])
    # The middle of half a circle's line lies 2 / π of its radius before that of the circle.
    middle = camera + seen + 2 / np.pi * settings.body_m * along
    side = points @ across
    off = settings.sigma_m**2 * np.eye(2) + (settings.sigma_rad * range_m) ** 2 * np.outer(across, across)
    return Thing(middle, off, max(settings.body_m, float(np.ptp(side)) / 2))
