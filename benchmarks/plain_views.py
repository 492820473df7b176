"""Views of a plain camera for tests and benchmarks of the collision monitor, without a depth image."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.navigation.perception import DepthView

COLUMNS = 64


def view_of_points(
    stamp_s: float, points: ArrayLike, camera: tuple[float, float], half_angle_rad: float, reach_m: tuple[float, float]
) -> DepthView:
    """Return the view of a camera that looks ahead and has depth everywhere. A column ends at its nearest point.

    Args:
        stamp_s: time of the frame.
        points: (N, 2) in `base`.
        camera: x and y in `base`.
        half_angle_rad: half of the field of view.
        reach_m: distances of the nearest and farthest visible floor.
    """
    points = np.asarray(points, float).reshape(-1, 2)
    step_rad = 2 * half_angle_rad / COLUMNS
    apart = points - np.array(camera)
    column = np.floor((np.arctan2(apart[:, 1], apart[:, 0]) + half_angle_rad) / step_rad)
    seen_m = np.full(COLUMNS, float(reach_m[1]))
    inside = (column >= 0) & (column < COLUMNS)
    np.minimum.at(seen_m, column[inside].astype(int), np.hypot(*apart[inside].T))
    return DepthView(stamp_s, points, camera, -half_angle_rad, step_rad, seen_m, reach_m[0])
