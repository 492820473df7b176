"""OpenWay: where a robot that does not know its place may drive, by what it has seen about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.navigation._field_kernels import free_arc
from wheelsight.navigation.costmap import Costmap
from wheelsight.navigation.fields import Outline, checked

_DIRECTIONS = 24
_STEP_M = 0.05
# Beyond that one way is as good as another.
_FAR_M = 3.0


@dataclass(frozen=True, slots=True)
class OpenWay:
    """A turn on the spot, and so far straight on."""

    turn_rad: float
    way_m: float


def open_way(costmap: Costmap, outline: Outline, pose: FloatArray, margin_m: float) -> OpenWay:
    """The longest way straight on, after the least turn; whether it may turn there is not asked.

    Args:
        costmap: of what stands about the robot.
        outline: of the robot.
        pose: (3,) x, y, yaw in the costmap's frame.
        margin_m: to obstacles.
    """
    field, nobody = checked(costmap.field), np.empty((0, 5))
    turns = 2 * np.pi / _DIRECTIONS * np.arange(-(_DIRECTIONS // 2), _DIRECTIONS // 2)
    x, y, yaw = map(float, pose)
    arc = (_STEP_M, 0.0, 0.0, round(_FAR_M / _STEP_M))
    steps = [
        int(free_arc(field, outline, nobody, (x, y, float(np.cos(a)), float(np.sin(a))), arc, margin_m))
        for a in yaw + turns
    ]
    best = min(range(_DIRECTIONS), key=lambda n: (-steps[n], abs(turns[n])))
    return OpenWay(float(turns[best]), steps[best] * _STEP_M)
