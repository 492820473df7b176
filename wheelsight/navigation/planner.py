"""Planner: a way that a footprint can drive, from a costmap, a start and a goal.

First the cheapest way over the cells is made straight, rounded and held against the footprint. Where the footprint does
not pass along it, places and headings are searched, guided by what is left to go over the cells; then that way is
made shorter. So narrow doors cost time only where there are any.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry import BoolArray, Float32Array, FloatArray
from wheelsight.geometry.se2 import wrap_angle
from wheelsight.navigation import _cost_to_go_kernels as grid
from wheelsight.navigation import _lattice_kernels as lattice
from wheelsight.navigation import _smoothing as smoothing
from wheelsight.navigation._drivable import Drivable
from wheelsight.navigation._goals import (
    Goal,
    beside,
    beyond,
    components,
    goal_near,
    nearest_heading,
    passable,
    tightness_of,
    way_out,
)
from wheelsight.navigation.costmap import CellState, Costmap
from wheelsight.navigation.fields import outline_of
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.grid_search import cost_to_go
from wheelsight.navigation.plan_values import Plan, PlanFailure, PlanReason
from wheelsight.navigation.planner_settings import PlannerSettings
from wheelsight.robot_limits import RobotLimits

_DIMENSIONS = (2, 3)
_ROUNDS = 4
# To say why there is no plan takes another one at most, and no long one: about a second on a small computer.
_MOST_STATES_TO_EXPLAIN = 50_000
# Widths are halved so often until the narrowest place is known: 20 m to a millimetre.
_HALVINGS = 14
# Places, by chance, at which no robot of any use fails to fit everywhere; and how many are looked at before the next.
_PLACES_TRIED, _AT_ONCE = 1000, 200
_ABOUT_UNKNOWN = "map it, or --set navigation.costmap.unknown=costly lets plans lead there"


class Planner:
    """Plans for one robot.

    Args:
        footprint: of the robot.
        settings: or the defaults.
        limits: of the robot: what one of zero forbids is in no plan.
    """

    def __init__(
        self, footprint: Footprint, settings: PlannerSettings | None = None, limits: RobotLimits | None = None
    ) -> None:
        self.footprint, self.settings = footprint, settings or PlannerSettings()
        self.limits = limits or RobotLimits()
        self._outline = outline_of(footprint)

    def has_room(self, costmap: Costmap, poses: ArrayLike) -> BoolArray:
        """(N,) whether the footprint fits at poses (N, 3) with the wanted margin."""
        drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
        return np.asarray(drivable.tightness(np.asarray(poses, float)) == 0)

    def why_no_room_near(self, costmap: Costmap, goal: ArrayLike) -> PlanFailure | None:
        """Why no plan may end at a goal (3,) or beside it, whatever is between; None where one may.

        A yaw of NaN is any heading.
        """
        drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
        # As if all cells were joined: which of them can be reached is not asked.
        anywhere = np.ones(costmap.state.shape, np.int32)
        found = goal_near(drivable, np.asarray(goal, float), anywhere, 1, self.settings)
        return None if isinstance(found, Goal) else found

    def plan(self, costmap: Costmap, start: ArrayLike, goal: ArrayLike) -> Plan | PlanFailure:
        """A way from where the robot stands to a goal.

        What anybody may ask for is answered by a reason, and raises nothing.

        Args:
            costmap: in the frame of start and goal.
            start: (3,) x, y, yaw of `base`.
            goal: likewise; or (2,), where any heading will do.
        """
        begin, end = np.array(start, float).ravel(), np.array(goal, float).ravel()
        if len(begin) != 3 or len(end) not in _DIMENSIONS or not np.isfinite([*begin, *end]).all():
            return PlanFailure(PlanReason.INVALID, f"from {begin} to {end}")
        end = np.array([*end, math.nan][:3])
        if self.limits.forward_m_s == 0 and self.limits.backward_m_s == 0:
            return PlanFailure(PlanReason.STANDS, "forward_m_s and backward_m_s are 0")
        if not _is_inside(costmap, begin):
            return PlanFailure(PlanReason.START_OUTSIDE, beyond(costmap, begin))
        stood = costmap.standing_at(self.footprint.padded(self.settings.margin_m), begin)
        drivable = Drivable.of(stood, self.footprint, self.settings, self.limits)
        out = way_out(drivable, self._outline, begin, self.settings)
        if out is None:
            return self._stuck(stood, begin)
        found = self._from(drivable, out, end)
        if isinstance(found, Plan) or found.reason is not PlanReason.UNREACHABLE:
            return found
        # With the least margin alone, it may stand where no step of the search lets it turn, though a slight arc does.
        wide = way_out(drivable, self._outline, begin, self.settings, is_wide=True)
        again = found if wide is None or len(wide) == 1 else self._from(drivable, wide, end)
        return again if isinstance(again, Plan) else found

    def _stuck(self, costmap: Costmap, begin: FloatArray) -> PlanFailure:
        """Why there is no way out from where the robot stands (3,): things, or floor that is unknown."""
        known = Drivable.of(costmap.with_unknown_free(), self.footprint, self.settings, self.limits)
        nor = f"nor within {self.settings.escape_m:g} m"
        if way_out(known, self._outline, begin, self.settings) is None:
            return PlanFailure(PlanReason.START_OCCUPIED, nor)
        return PlanFailure(PlanReason.START_UNKNOWN, f"{nor}; {_ABOUT_UNKNOWN}")

    def why_no_way(self, costmap: Costmap, start: ArrayLike, goal: ArrayLike) -> str:
        """What of a costmap keeps the robot from a goal (3,) to which there is no plan, with places and widths."""
        begin, end = np.array(start, float), np.array(goal, float)
        rules = self.settings.model_copy(update={"most_states": _MOST_STATES_TO_EXPLAIN})
        quick = Planner(self.footprint, rules, self.limits)
        if (costmap.is_lethal & (costmap.state == CellState.UNKNOWN)).any():
            found = quick.plan(costmap.with_unknown_free(), begin, end[:2] if np.isnan(end[-1]) else end)
            if isinstance(found, Plan):
                drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
                at = found.poses[int(np.argmin(drivable.is_free(found.poses)))]
                return f"floor on the way there is unknown, first at ({at[0]:.2f}, {at[1]:.2f}) m; {_ABOUT_UNKNOWN}"
        narrowest = narrowest_place(costmap, begin[:2], end[:2], self.settings.goal_tolerance_m)
        if narrowest is None:
            return "walls or things of the map are all round it"
        width_m, (x, y) = narrowest
        low, high = self.footprint.corners.min(axis=0), self.footprint.corners.max(axis=0)
        needs_m = float(high[1] - low[1]) + 2 * self.settings.margin_m
        where = f"the way there is {width_m:.2f} m wide at ({x:.2f}, {y:.2f}) m"
        if width_m < needs_m:
            return f"{where}, and the robot needs {needs_m:.2f} m"
        limits = self.limits.forward_m_s, self.limits.backward_m_s, self.limits.turn_rad_s
        forbidden = ", or its limits of 0 forbid it" if 0 in limits else ""
        return f"{where} at its narrowest; the robot, {high[0] - low[0]:.2f} m long, has no room to turn{forbidden}"

    def why_no_room(self, costmap: Costmap) -> str:
        """Why the robot fits nowhere in a costmap, with sizes; empty where it fits at any of many places."""
        drivable = Drivable.of(costmap, self.footprint, self.settings, self.limits)
        cells = np.argwhere(costmap.distance_m >= self.footprint.inscribed_m)
        cells = np.random.default_rng(0).permutation(cells)[:_PLACES_TRIED]
        for some in np.array_split(cells, max(len(cells) // _AT_ONCE, 1)):
            poses = np.column_stack([costmap.middle_of(some), np.full(len(some), math.nan)])
            if np.isfinite(tightness_of(drivable, poses)).any():
                return ""
        widest_m = max(2 * float(costmap.distance_m.max()) - costmap.resolution_m, 0.0)
        length_m, width_m = np.ptp(self.footprint.corners, axis=0)
        return f"the widest is {widest_m:.2f} m, and the robot is {length_m:.2f} m long and {width_m:.2f} m wide"

    def _from(self, drivable: Drivable, out: FloatArray, end: FloatArray) -> Plan | PlanFailure:
        """To a goal (3,) from where a way out (N, 4) ends."""
        metre_cost = passable(drivable)
        labels = components(metre_cost)
        row, column = drivable.costmap.cells_at(out[-1, :2]).tolist()
        aim = goal_near(drivable, end, labels, int(labels[row, column]), self.settings)
        if isinstance(aim, PlanFailure):
            return aim
        return self._way(drivable, metre_cost, out, aim)

    def _way(self, drivable: Drivable, metre_cost: Float32Array, out: FloatArray, goal: Goal) -> Plan | PlanFailure:
        """From where a way out (N, 4) ends."""
        costmap = drivable.costmap
        goal_row, goal_column = costmap.cells_at(goal.pose[:2]).tolist()
        known = cost_to_go(metre_cost, costmap.resolution_m, (goal_row, goal_column))
        row, column = costmap.cells_at(out[-1, :2]).tolist()
        if not np.isfinite(known[row, column]):
            return PlanFailure(PlanReason.UNREACHABLE, "walls or things are between")
        way = grid.descend(known, metre_cost, float(costmap.resolution_m), row, column)
        corners = smoothing.any_angle(way, known, drivable, metre_cost)
        if len(corners) < 2:
            corners = np.repeat(corners, 2, axis=0)
        corners[0], corners[-1] = out[-1, :2], goal.pose[:2]
        poses, states = smoothing.driven(corners, out[-1], goal.pose, drivable), 0
        if poses is None or drivable.tightness(poses[:, :3]).any():
            found = self._searched(drivable, known, out[-1], goal)
            if isinstance(found, PlanFailure):
                if poses is None:
                    return found
            else:
                searched, looked_at, end = found
                states = looked_at if poses is None or end is goal else 0
                # Both may pass, where it is tight: then the cheaper one that ends as it was asked.
                if poses is None or (end is goal and drivable.cost(searched) < drivable.cost(poses)):
                    poses, goal = searched, end
        poses = smoothing.centred(smoothing.shortened(poses, drivable), drivable, _ROUNDS)
        poses = np.concatenate([out[:-1], poses])
        return _plan(drivable, poses, goal, states)

    def _searched(
        self, drivable: Drivable, known: FloatArray, start: FloatArray, goal: Goal
    ) -> tuple[FloatArray, int, Goal] | PlanFailure:
        """Poses (N, 4) by the search over places and headings, how many it looked at, and the goal they lead to.

        Where none leads to it by its heading, that is the place with the nearest heading that it comes to.
        """
        most = self.settings.most_states
        slots = 1 << math.ceil(math.log2(2 * most))
        tree = lattice.Tree(
            pose=np.empty((most, 4)),
            cost=np.empty(most),
            link=np.empty((most, 2), np.int32),
            table=np.full(slots, -1, np.int32),
            is_closed=np.empty(most, np.uint8),
            keys=np.empty(most, np.int64),
        )
        how, last, count = lattice.search(
            drivable.cells, drivable.shape, drivable.rules, known, np.ascontiguousarray(start[:3]), goal.pose, tree
        )
        if how == lattice.NOTHING_LEFT:
            last = nearest_heading(tree.pose[:count], goal.pose, drivable.rules.place_m)
            if last < 0:
                none = f"of {count} places and headings that can be reached none leads there"
                return PlanFailure(PlanReason.UNREACHABLE, f"{none}: too narrow, or no room to turn")
            goal = beside(goal.pose, tree.pose[last, :3], "no way leads to the goal as it is asked")
        if how == lattice.TOO_MANY:
            return PlanFailure(PlanReason.GAVE_UP, f"after {count} places and headings")
        room = np.empty((1 << 16, 4))
        end = lattice.way_to(drivable.rules, tree, last, goal.pose, room)
        if end == 0:
            return PlanFailure(PlanReason.GAVE_UP, f"the way has more than {len(room)} poses")
        return room[:end].copy(), count, goal


def narrowest_place(
    costmap: Costmap, start: FloatArray, goal: FloatArray, near_m: float
) -> tuple[float, tuple[float, float]] | None:
    """How wide, in metres, the widest way from one place (2,) to another is at its narrowest, and where (x, y) that is.

    Both ends count from the roomiest place near to them. None where walls are between.
    """
    here, there = _roomiest(costmap, start, near_m), _roomiest(costmap, goal, near_m)
    low_m, high_m = 0.0, float(min(costmap.distance_m[here], costmap.distance_m[there]))
    if high_m == 0 or not _are_joined(costmap.distance_m > 0, here, there):
        return None
    if not _are_joined(costmap.distance_m >= high_m, here, there):
        for _ in range(_HALVINGS):
            middle_m = (low_m + high_m) / 2
            is_wide = _are_joined(costmap.distance_m >= max(middle_m, 1e-6), here, there)
            low_m, high_m = (middle_m, high_m) if is_wide else (low_m, middle_m)
    else:
        low_m = high_m
    metre_cost = np.where(costmap.distance_m >= max(low_m, 1e-6), 1, np.inf).astype(np.float32)
    known = cost_to_go(metre_cost, costmap.resolution_m, there)
    way = grid.descend(known, metre_cost, float(costmap.resolution_m), *here)
    row, column = way[int(np.argmin(costmap.distance_m[way[:, 0], way[:, 1]]))]
    x, y = costmap.middle_of([row, column]).tolist()
    return 2 * float(costmap.distance_m[row, column]) - costmap.resolution_m, (x, y)


def _roomiest(costmap: Costmap, xy: FloatArray, near_m: float) -> tuple[int, int]:
    """Row and column near a place (2,) that are farthest from anything."""
    reach = int(near_m / costmap.resolution_m)
    row, column = np.clip(costmap.cells_at(xy), 0, np.array(costmap.state.shape) - 1).tolist()
    top, left = max(row - reach, 0), max(column - reach, 0)
    near = costmap.distance_m[top : row + reach + 1, left : column + reach + 1]
    down, right = np.unravel_index(int(np.argmax(near)), near.shape)
    return top + int(down), left + int(right)


def _are_joined(is_open: BoolArray, here: tuple[int, int], there: tuple[int, int]) -> bool:
    _, labels = cv2.connectedComponents(is_open.astype(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    return bool(labels[here] == labels[there] > 0)


def _is_inside(costmap: Costmap, pose: FloatArray) -> bool:
    cell = costmap.cells_at(pose[:2])
    return bool(((cell >= 0) & (cell < costmap.state.shape)).all())


def _plan(drivable: Drivable, poses: FloatArray, goal: Goal, states: int) -> Plan:
    way = poses[:, :3].copy()
    way[:, 2] = wrap_angle(way[:, 2])
    steps = np.diff(way[:, :2], axis=0)
    end = way[-1].copy()
    return Plan(
        poses=way,
        directions=poses[:, 3].astype(np.int64),
        length_m=float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
        least_clearance_m=drivable.clearance_m(way),
        goal=end,
        goal_change=goal.change,
        frame=drivable.costmap.frame,
        cost=drivable.cost(poses),
        states=states,
        goal_off_m=goal.off_m,
        goal_off_rad=goal.off_rad,
    )
