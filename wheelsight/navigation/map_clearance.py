"""Whether a command leads a robot to what the map has: behaviours go by no plan, and a camera does not see all around.

The collision monitor forgets what left the view some time ago, as it must for people. A robot that looked about beside
a kitchen's counter, 40 s after it had seen that, turned into it.
"""

from __future__ import annotations

import cv2
import numpy as np

from wheelsight.commands import VelocityCommand
from wheelsight.geometry import FloatArray
from wheelsight.navigation._field_kernels import clearance_at, moved
from wheelsight.navigation.costmap import CellState, Costmap
from wheelsight.navigation.fields import CostField, Outline
from wheelsight.navigation.navigator_settings import BehaviourSettings

_STEP_S = 0.1


def keeps_clear(
    costmap: Costmap,
    outline: Outline,
    pose: FloatArray,
    command: VelocityCommand,
    settings: BehaviourSettings,
    *,
    minds_unknown: bool = False,
) -> bool:
    """Whether a robot at a pose (3,) in the map, that obeys for `clear_s`, comes no nearer than `clear_m` to obstacles.

    One that is nearer already may go where it is less near. Unknown floor is an obstacle with `minds_unknown` alone.
    """
    is_obstacle = costmap.state == CellState.OCCUPIED
    if minds_unknown:
        is_obstacle |= costmap.state == CellState.UNKNOWN
    is_free = (~is_obstacle).astype(np.uint8)
    distance_m = cv2.distanceTransform(is_free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * np.float32(costmap.resolution_m)
    field = CostField(distance_m, np.zeros_like(distance_m), costmap.resolution_m, costmap.origin)
    at = (float(pose[0]), float(pose[1]), float(np.cos(pose[2])), float(np.sin(pose[2])))
    least_m = float(clearance_at(field, outline, at, settings.clear_m))
    for _ in range(round(settings.clear_s / _STEP_S)):
        at = moved(at, command.forward_m_s * _STEP_S, command.turn_rad_s * _STEP_S)
        clearance_m = float(clearance_at(field, outline, at, settings.clear_m))
        if clearance_m < min(settings.clear_m, least_m):
            return False
    return True
