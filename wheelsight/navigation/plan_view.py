"""PlanView: whether a camera will have looked at the floor that a plan leads over, by the time the robot is there.

What lies beside a robot and was never looked at is no wall: it is one to who turns into it, and none to who comes round
and drives up to it.
"""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.navigation._plan_view_kernels import Eye, Walls, first_blind, first_over
from wheelsight.navigation.costmap import CellState, Costmap
from wheelsight.navigation.fields import sides_of
from wheelsight.navigation.footprint import Footprint

__all__ = ["Eye", "PlanView"]

# A frame is this many poses of a plan old, about 0.1 m of way, before anybody goes by it.
_LAG = 2


class PlanView:
    """Of one robot.

    Args:
        footprint: of it.
        eye: its camera.
    """

    def __init__(self, footprint: Footprint, eye: Eye) -> None:
        self._sides, self._eye = sides_of(footprint), eye

    def first_blind(self, poses: FloatArray, hidden: FloatArray, costmap: Costmap) -> int | None:
        """Number of the first pose that goes over hidden floor which no pose before it looks at; None where none does.

        Args:
            poses: (N, 3) x, y, yaw of `base`, dense, in the frame of the costmap; the robot is at the first.
            hidden: (M, 3) x, y of floor that no camera has looked at, and how near to it one must look, metres.
            costmap: what stands in it hides what is behind.
        """
        points, slack_m = np.ascontiguousarray(hidden[:, :2]), np.ascontiguousarray(hidden[:, 2])
        ways, over = np.ascontiguousarray(poses, float), np.empty(len(points), np.int64)
        first_over(ways, points, self._sides, over)
        is_met = over < len(ways)
        is_there = np.ascontiguousarray(costmap.state == CellState.OCCUPIED)
        walls = Walls(is_there, costmap.resolution_m, costmap.origin)
        found = int(first_blind(ways, points[is_met], slack_m[is_met], over[is_met], self._eye, walls, _LAG))
        return found if found < len(ways) else None
