"""Drivable: what is asked of a costmap, a footprint and settings along a way, in kernels' terms."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import BoolArray, Float32Array, FloatArray
from wheelsight.navigation import _drive_kernels as drive
from wheelsight.navigation import _footprint_kernels as under
from wheelsight.navigation.costmap import Costmap
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.planner_settings import PlannerSettings
from wheelsight.robot_limits import RobotLimits

MOST_CLEARANCE_M = 0.5
# Poses that one piece of a way may have: at 5 cm each, 400 m.
_ROOM = 8192
# Margins that are told apart, from the wanted one to the least.
_OUTLINES = 5


@dataclass(frozen=True, slots=True, eq=False)
class Drivable:
    """A costmap as kernels take it, with a footprint and what driving costs.

    Attributes:
        costmap, footprint: as given.
        margins_m: (K,) of the outlines, from the wanted one to the least.
        cells, shape, rules: of both, and of settings.
    """

    costmap: Costmap
    footprint: Footprint
    margins_m: FloatArray
    cells: under.Cells
    shape: under.Shape
    rules: drive.Rules

    @classmethod
    def of(
        cls, costmap: Costmap, footprint: Footprint, settings: PlannerSettings, limits: RobotLimits | None = None
    ) -> Drivable:
        """Of a costmap, a footprint and settings; what limits of zero forbid costs infinitely much."""
        sums = np.zeros((costmap.is_lethal.shape[0], costmap.is_lethal.shape[1] + 1), np.int32)
        np.cumsum(costmap.is_lethal, axis=1, out=sums[:, 1:], dtype=np.int32)
        metre_cost = _metre_cost(costmap, settings)
        cells = under.Cells(
            sums, costmap.distance_m, metre_cost, float(costmap.resolution_m), *map(float, costmap.origin)
        )
        margins_m = np.linspace(settings.wanted_margin_m, settings.margin_m, _OUTLINES)
        outlines = [footprint.padded(float(margin_m)) for margin_m in margins_m]
        middle = (outlines[0].corners.min(axis=0) + outlines[0].corners.max(axis=0)) / 2
        around_m = float(np.linalg.norm(outlines[0].corners - middle, axis=1).max())
        corners = np.ascontiguousarray([one.corners for one in outlines])
        shape = under.Shape(corners, outlines[-1].inscribed_m, float(middle[0]), float(middle[1]), around_m)
        rules = _rules(outlines[-1], settings, limits or RobotLimits())
        return cls(costmap, footprint, margins_m, cells, shape, rules)

    def may(self, way_m: float, turn: float) -> bool:
        """Whether limits of zero leave an arc."""
        factor = self.rules.backward if way_m < 0 else self.rules.forward
        return (way_m == 0 or math.isfinite(factor)) and (turn == 0 or math.isfinite(self.rules.turn_m))

    def tightness(self, poses: FloatArray) -> FloatArray:
        """(N,) of poses (N, 3): 0 where the wanted margin is free, 1 where the least one alone is, infinite: none."""
        found = np.empty(len(poses))
        under.tightnesses(self.cells, self.shape, np.ascontiguousarray(poses), found)
        return found

    def is_free(self, poses: FloatArray) -> BoolArray:
        """(N,) whether the footprint fits with the least margin at poses (N, 3)."""
        return np.isfinite(self.tightness(poses))

    def cost(self, poses: FloatArray) -> float:
        """Of driving along poses (N, 4) with their directions; infinite where one of them collides but the first."""
        return float(drive.cost_of(self.cells, self.shape, self.rules, poses, 1, len(poses)))

    def clearance_m(self, poses: FloatArray) -> float:
        """Of the footprint at poses (N, 3), at most `MOST_CLEARANCE_M`."""
        corners = np.ascontiguousarray(self.footprint.corners)
        return float(under.least_clearance(self.cells, corners, np.ascontiguousarray(poses), MOST_CLEARANCE_M))

    def arc(self, pose: FloatArray, way_m: float, turn: float) -> FloatArray:
        """(N, 4) along an arc from a pose (4,), which is the first."""
        out = np.empty((_ROOM, 4))
        out[0] = pose
        return out[: max(drive.write_arc(out, 1, (float(way_m), float(turn)), self.rules), 1)].copy()

    def way(self, pose: FloatArray, to: FloatArray, way: int) -> FloatArray:
        """(N, 4) from a pose (4,), which is the first, to another (3,) by one of the kernels' ways; empty: none."""
        out = np.empty((_ROOM, 4))
        out[0] = pose
        return out[: drive.write_way(out, 1, np.ascontiguousarray(to[:3]), way, self.rules)].copy()


def _rules(least: Footprint, settings: PlannerSettings, limits: RobotLimits) -> drive.Rules:
    return drive.Rules(
        step_m=2 * settings.margin_m,
        turn_m=settings.turn_m if limits.turn_rad_s > 0 else math.inf,
        bend_m=settings.bend_m if limits.turn_rad_s > 0 else math.inf,
        forward=1.0 if limits.forward_m_s > 0 else math.inf,
        backward=settings.backward_cost if limits.backward_m_s > 0 else math.inf,
        switch_m=settings.switch_m,
        tight=settings.tight_cost,
        radius_m=settings.radius_m,
        reach_m=least.circumscribed_m,
        headings=settings.headings,
        place_m=settings.place_m,
        narrow_m=least.inscribed_m + settings.narrow_m,
        stride_m=max(settings.stride_m, 1.5 * settings.place_m),
        greed=settings.greed,
        connect_m=settings.connect_m,
        most_states=settings.most_states,
    )


def _metre_cost(costmap: Costmap, settings: PlannerSettings) -> Float32Array:
    """(H, W) of a metre of the centre of rotation's way, where nothing says it cannot be there."""
    metre = 1 + np.float32(settings.nearness_cost) * costmap.cost
    slow = np.float32(settings.usual_m_s) / costmap.speed_m_s
    dear = np.float32(1) if costmap.dearness is None else costmap.dearness
    return np.ascontiguousarray(metre * np.maximum(slow, 1) * dear, np.float32)
