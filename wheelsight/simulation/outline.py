"""The outline of the simulated robot from above."""

from __future__ import annotations

import numpy as np
import shapely

from wheelsight.geometry import FloatArray
from wheelsight.simulation.robot import Robot

TAIL_M = 0.3  # how far a wheelchair reaches behind its axle


def outline_m(robot: Robot) -> FloatArray:
    """(3,) how far it reaches along x, from and to, and half its width, in the frame of the base."""
    return np.array([-TAIL_M, robot.length_m - TAIL_M, robot.width_m / 2])


def outline_at(robot: Robot, T_world_base: FloatArray) -> shapely.Polygon:
    """The rectangle on the floor of a robot at a pose (4, 4)."""
    back_m, front_m, half_m = outline_m(robot)
    corners = np.array([(back_m, -half_m), (front_m, -half_m), (front_m, half_m), (back_m, half_m)])
    return shapely.Polygon(corners @ T_world_base[:2, :2].T + T_world_base[:2, 3])
