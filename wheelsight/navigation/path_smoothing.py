"""Path smoothing by any-angle lines, rounded corners and shortcuts.

`Drivable` checks and costs paths of a footprint on a costmap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, IntArray
from wheelsight.core.robots import RobotLimits
from wheelsight.navigation.costmap import Costmap
from wheelsight.navigation.costmap_kernels import PlanCells, Shape, least_clearance, tightnesses
from wheelsight.navigation.planner_kernels import (
    CURVE,
    ROOM,
    TURN_AND_DRIVE,
    DriveRules,
    centre,
    cost_of,
    is_line_cheaper,
    shorten,
    write_arc,
    write_way,
)
from wheelsight.navigation.settings import Footprint, PlannerSettings

# Distances before and after a corner where a curve may begin and end; the first free one is used.
_ROUNDINGS_M = (1.5, 1.0, 0.6, 0.35)
# Rounds in which a path is moved away from obstacles.
_ROUNDS = 4


def any_angle(way: IntArray, known: FloatArray, drivable: Drivable, metre_cost: Float32Array) -> FloatArray:
    """Return (N, 2) places of a path over cells (K, 2), joined by straight lines that cost no more than the cells."""
    corners, at, size_m = [0], 0, float(drivable.costmap.resolution_m)
    while at < len(way) - 1:
        # Double the span, then bisect: a line of sight usually ends once.
        span, best = 2, at + 1
        while at + span < len(way) and is_line_cheaper(way, at, at + span, known, metre_cost, size_m):
            best, span = at + span, span * 2
        low, high = best, min(at + span, len(way) - 1)
        if high > low and is_line_cheaper(way, at, high, known, metre_cost, size_m):
            low = high
        while high - low > 1:
            middle = (low + high) // 2
            if is_line_cheaper(way, at, middle, known, metre_cost, size_m):
                low = middle
            else:
                high = middle
        corners.append(low)
        at = low
    return np.asarray(drivable.costmap.middle_of(way[corners]))


def driven(corners: FloatArray, start: FloatArray, goal: FloatArray, drivable: Drivable) -> FloatArray | None:
    """Return a path (N, 4) along straight lines between places (K, 2), from a pose (4,) to another (3,).

    At a corner it drives a curve or turns in place, whichever is free and cheaper. A goal without a heading gets that
    of the last line. None if nothing is free.
    """
    lines = np.diff(corners, axis=0)
    lengths = np.hypot(lines[:, 0], lines[:, 1])
    headings = np.arctan2(lines[:, 1], lines[:, 0])
    pieces, pose = [start[None]], start
    for k in range(len(lines) - 1):
        best, best_cost = None, np.inf
        for rounding_m in (*_ROUNDINGS_M, 0.0):
            if 2 * rounding_m > min(lengths[k], lengths[k + 1]):
                continue
            piece = rounded_corner(pose, corners[k + 1], headings[k : k + 2], rounding_m, drivable)
            cost = drivable.cost(piece) if len(piece) else np.inf
            if cost < best_cost:
                best, best_cost = piece, cost
        if best is None:
            return None
        pieces.append(best[1:])
        pose = best[-1]
    reached = headings[-1] if lengths[-1] > 0 else pose[2]
    yaw = reached if np.isnan(goal[2]) else goal[2]
    last = drivable.way(pose, np.array([goal[0], goal[1], yaw]), TURN_AND_DRIVE)
    if not len(last) or drivable.cost(last) == np.inf:
        return None
    return np.concatenate([*pieces, last[1:]])


def rounded_corner(
    pose: FloatArray, corner: FloatArray, headings: FloatArray, rounding_m: float, drivable: Drivable
) -> FloatArray:
    """Return (N, 4) from a pose to beyond a corner, which it cuts on both sides; empty if that is impossible."""
    a, b = ((np.cos(h), np.sin(h)) for h in headings)
    to = np.array([*(corner - rounding_m * np.array(a)), headings[0]])
    line = drivable.way(pose, to, TURN_AND_DRIVE)
    if rounding_m == 0.0 or not len(line):
        return line
    behind = np.array([*(corner + rounding_m * np.array(b)), headings[1]])
    curve = drivable.way(line[-1], behind, CURVE)
    return np.concatenate([line, curve[1:]]) if len(curve) else curve


# Usual speed: a metre in a slower zone costs more, in proportion to its time.
_USUAL_M_S = 0.6
# Extra cost of a metre with the least clearance only, quadratic between that and the wanted one; a free metre costs 1.
# Of 80 plans in four real buildings 1 is nearer than 5 cm to anything, with a cost of 2 there are 7
# (docs/decisions/planner).
_TIGHT_COST = 4.0
# Costs in metres: of a turn in place of 1 rad, as both take half a second to a second; of a bend of 1 rad; and of a
# change between forward and backward.
_TURN_M, _BEND_M, _SWITCH_M = 0.5, 0.1, 0.5
# Least radius of curves; tighter ones become turns in place.
_RADIUS_M = 0.4
# Headings in the search: 5° each, which move the far end of a chair by 7 cm; the grid of places, half of it in narrow
# ones; and the distance of obstacles from the robot's inscribed circle below which a place is narrow, metres.
_HEADINGS, _PLACE_M, _NARROW_M = 72, 0.1, 0.2
# Length of the search's arcs, metres; at least enough to leave their cell.
_STRIDE_M = 0.1
# Factor of the heuristic; 2 is faster and nearer to walls (80 plans in four real buildings: docs/decisions/planner).
_GREED = 1.6
# Distance to the goal below which the search tries a direct connection, metres.
_CONNECT_M = 4.0
# Largest clearance that is measured.
MOST_CLEARANCE_M = 0.5
# Outlines with margins from the wanted one to the least.
_OUTLINES = 5


@dataclass(frozen=True, slots=True, eq=False)
class Drivable:
    """A costmap and a footprint in the form of the kernels, with the cost of driving.

    Attributes:
        margins_m: (K,) of the outlines, from the wanted one to the least.
    """

    costmap: Costmap
    footprint: Footprint
    margins_m: FloatArray
    cells: PlanCells
    shape: Shape
    rules: DriveRules

    @classmethod
    def of(
        cls, costmap: Costmap, footprint: Footprint, settings: PlannerSettings, limits: RobotLimits | None = None
    ) -> Drivable:
        """Convert a costmap, a footprint and settings. A limit of zero makes its motion infinitely expensive."""
        sums = np.zeros((costmap.is_lethal.shape[0], costmap.is_lethal.shape[1] + 1), np.int32)
        np.cumsum(costmap.is_lethal, axis=1, out=sums[:, 1:], dtype=np.int32)
        # (H, W) cost of a metre of the centre of rotation, by nearness to obstacles and speed zones.
        slow = np.float32(_USUAL_M_S) / costmap.speed_m_s
        metre = 1 + np.float32(settings.nearness_cost) * costmap.cost
        metre_cost = np.ascontiguousarray(metre * np.maximum(slow, 1), np.float32)
        cells = PlanCells(
            sums, costmap.distance_m, metre_cost, float(costmap.resolution_m), *map(float, costmap.origin)
        )
        margins_m = np.linspace(settings.wanted_margin_m, settings.margin_m, _OUTLINES)
        outlines = [footprint.padded(float(margin_m)) for margin_m in margins_m]
        middle = (outlines[0].corners.min(axis=0) + outlines[0].corners.max(axis=0)) / 2
        around_m = float(np.linalg.norm(outlines[0].corners - middle, axis=1).max())
        corners = np.ascontiguousarray([one.corners for one in outlines])
        shape = Shape(corners, outlines[-1].inscribed_m, float(middle[0]), float(middle[1]), around_m)
        limits = limits or RobotLimits()
        rules = DriveRules(
            step_m=2 * settings.margin_m,
            turn_m=_TURN_M if limits.turn_rad_s > 0 else math.inf,
            bend_m=_BEND_M if limits.turn_rad_s > 0 else math.inf,
            forward=1.0 if limits.forward_m_s > 0 else math.inf,
            backward=settings.backward_cost if limits.backward_m_s > 0 else math.inf,
            switch_m=_SWITCH_M,
            tight=_TIGHT_COST,
            radius_m=_RADIUS_M,
            reach_m=outlines[-1].circumscribed_m,
            headings=_HEADINGS,
            place_m=_PLACE_M,
            narrow_m=outlines[-1].inscribed_m + _NARROW_M,
            stride_m=max(_STRIDE_M, 1.5 * _PLACE_M),
            greed=_GREED,
            connect_m=_CONNECT_M,
        )
        return cls(costmap, footprint, margins_m, cells, shape, rules)

    def may(self, way_m: float, turn: float) -> bool:
        """Return whether the limits permit an arc."""
        factor = self.rules.backward if way_m < 0 else self.rules.forward
        return (way_m == 0 or math.isfinite(factor)) and (turn == 0 or math.isfinite(self.rules.turn_m))

    def tightness(self, poses: FloatArray) -> FloatArray:
        """Return (N,) at poses (N, 3): 0 if the wanted margin is free, 1 if only the least one is, else infinite."""
        found = np.empty(len(poses))
        tightnesses(self.cells, self.shape, np.ascontiguousarray(poses), found)
        return found

    def is_free(self, poses: FloatArray) -> BoolArray:
        """Return (N,) whether the footprint fits with the least margin at poses (N, 3)."""
        return np.isfinite(self.tightness(poses))

    def smooth(self, poses: FloatArray) -> FloatArray:
        """Return a cheaper path (M, 4) from the start of a path (N, 4) to its end, as far from obstacles as wanted."""
        given = self.cells, self.shape, self.rules
        return np.asarray(centre(*given, shorten(*given, np.ascontiguousarray(poses)), _ROUNDS))

    def cost(self, poses: FloatArray) -> float:
        """Return the cost of a path (N, 4) with its directions; infinite if any pose but the first collides."""
        return float(cost_of(self.cells, self.shape, self.rules, poses, 1, len(poses)))

    def clearance_m(self, poses: FloatArray) -> float:
        """Return the least clearance of the footprint at poses (N, 3), at most `MOST_CLEARANCE_M`."""
        corners = np.ascontiguousarray(self.footprint.corners)
        return float(least_clearance(self.cells, corners, np.ascontiguousarray(poses), MOST_CLEARANCE_M))

    def arc(self, pose: FloatArray, way_m: float, turn: float) -> FloatArray:
        """Return (N, 4) along an arc from a pose (4,), which is the first."""
        out = np.empty((ROOM, 4))
        out[0] = pose
        return out[: max(write_arc(out, 1, (float(way_m), float(turn)), self.rules), 1)].copy()

    def way(self, pose: FloatArray, to: FloatArray, way: int) -> FloatArray:
        """Return (N, 4) from a pose (4,), the first, to another (3,) by a connection of the kernels; empty without."""
        out = np.empty((ROOM, 4))
        out[0] = pose
        return out[: write_way(out, 1, np.ascontiguousarray(to[:3]), way, self.rules)].copy()
