"""Where plans begin and end: a start that gets out of what it stands in, and a goal at which the footprint fits."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from wheelsight.geometry import Float32Array, FloatArray, Int32Array
from wheelsight.navigation._drivable import Drivable
from wheelsight.navigation._field_kernels import clearances_at
from wheelsight.navigation.costmap import CellState, Costmap
from wheelsight.navigation.fields import Outline
from wheelsight.navigation.plan_values import PlanFailure, PlanReason
from wheelsight.navigation.planner_settings import PlannerSettings

# Curvatures of ways out, 1/m, for both directions.
_BENDS = (0.0, 0.1, -0.1, 0.2, -0.2, 0.5, -0.5, 1.5, -1.5)
# Along them no margin covers what lies between two poses: metres from one to the next.
_ESCAPE_STEP_M, _BACKWARD = 0.01, 1.5
_TURN_STEPS = 3
# Of a first arc, the places at which a second one begins.
_SHARES = 3
_ANY_HEADINGS = 16


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """Where a plan is to end: pose (3,), its heading NaN where any will do; why it is not what was asked for, and by
    how much, metres and radians.
    """

    pose: FloatArray
    change: str
    off_m: float = 0.0
    off_rad: float = 0.0


def passable(drivable: Drivable) -> Float32Array:
    """(H, W) the least that a metre costs; infinite where the centre of rotation can be at no point of the cell.

    Where the inscribed circle alone is tight, whatever the heading, that is counted, too.
    """
    costmap, rules = drivable.costmap, drivable.rules
    slack_m = (0.5 - math.sqrt(0.5)) * costmap.resolution_m
    metre_cost, last = drivable.cells.metre_cost.copy(), len(drivable.margins_m) - 1
    for k, margin_m in enumerate(drivable.margins_m):
        is_nearer = costmap.distance_m < drivable.footprint.inscribed_m + margin_m + slack_m
        # The next outline may be free.
        tight = math.inf if k == last else rules.tight * ((k + 1) / last) ** 2
        metre_cost[is_nearer] = drivable.cells.metre_cost[is_nearer] + np.float32(tight)
    metre_cost[costmap.is_lethal] = np.inf
    return np.asarray(metre_cost, np.float32)


def components(metre_cost: Float32Array) -> Int32Array:
    """(H, W) from 1 on, of cells that are joined by their edges; 0 where blocked."""
    _, labels = cv2.connectedComponents(np.isfinite(metre_cost).astype(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    return labels.astype(np.int32)


def way_out(
    drivable: Drivable, outline: Outline, start: FloatArray, settings: PlannerSettings, *, is_wide: bool = False
) -> FloatArray | None:
    """(N, 4) a short way on which the robot comes free of what it stands in or too near to; None where none is found.

    One arc or turn, else two of them. Until it has come free nothing is nearer than at first by more than
    `escape_nearer_m`: as controllers, which drive it, have it. Where it stands free, the way is that pose alone.
    `is_wide`: free is where the wanted margin is.
    """
    pose, most = np.array([[*start, 1.0]]), 0.0 if is_wide else 1.0
    if drivable.tightness(pose[:, :3])[0] <= most:
        return pose
    here_m = float(_clearances(drivable, outline, pose, settings)[0])
    if here_m < -settings.escape_depth_m:
        return None
    least_m = min(settings.margin_m, here_m - settings.escape_nearer_m)
    dense = replace(drivable, rules=drivable.rules._replace(step_m=_ESCAPE_STEP_M))

    def passed(begin: FloatArray, arc: tuple[float, float]) -> FloatArray:
        """A way with as much of an arc behind it as may be, until it comes free."""
        poses = np.r_[begin, dense.arc(begin[-1], *arc)[1:]]
        is_free = drivable.tightness(poses[:, :3]) <= most
        clear_m = _clearances(drivable, outline, poses, settings)
        has_come = np.maximum.accumulate(clear_m >= settings.margin_m + settings.escape_nearer_m)
        is_nearer = clear_m < np.where(has_come, settings.margin_m, least_m)
        is_nearer[0] = False
        ends = [*(np.flatnonzero(is_free)[:1] + 1), *np.flatnonzero(is_nearer)[:1], len(poses)]
        return np.asarray(poses[: int(min(ends))])

    arcs = [arc for arc in _arcs(settings) if drivable.may(*arc)]
    first = [passed(pose, arc) for arc in arcs]
    begins = [way[: 1 + share * (len(way) - 1) // _SHARES] for way in first for share in range(1, _SHARES + 1)]
    second = (passed(begin, arc) for begin in begins if len(begin) > 1 for arc in arcs)
    free = ([way for way in ways if drivable.tightness(way[-1:, :3])[0] <= most] for ways in (first, second))
    found = next((ways for ways in free if ways), [])
    return min(found, key=lambda way: _long_m(way, drivable.rules.reach_m), default=None)


def _arcs(settings: PlannerSettings) -> list[tuple[float, float]]:
    """Ways and turns that a robot may get out by."""
    arcs = [(sense * settings.escape_m, sense * settings.escape_m * b) for sense in (1, -1) for b in _BENDS]
    return [*arcs, *((0.0, sense * math.pi) for sense in (1, -1))]


def _long_m(way: FloatArray, reach_m: float) -> float:
    """Of a way (N, 4), turns by what a corner moves; where the robot can go ahead, it does."""
    steps_m = np.hypot(*np.diff(way[:, :2], axis=0).T) + reach_m * np.abs(np.diff(way[:, 2]))
    return float((steps_m * np.where(way[1:, 3] < 0, _BACKWARD, 1.0)).sum())


def _clearances(drivable: Drivable, outline: Outline, poses: FloatArray, settings: PlannerSettings) -> FloatArray:
    """(N,) of the footprint at poses (N, 4), as controllers have it; below 0 within."""
    found = np.empty(len(poses))
    least_m = settings.margin_m + settings.escape_nearer_m
    clearances_at(drivable.costmap.field, outline, np.ascontiguousarray(poses[:, :3]), least_m, found)
    return found


def goal_near(
    drivable: Drivable, goal: FloatArray, labels: Int32Array, label: int, settings: PlannerSettings
) -> Goal | PlanFailure:
    """The goal (3,), or where the footprint does not fit there, the best pose in a component of cells where it does.

    That is the nearest one, where clearance costs something, too. Poses are tried on a grid of the costmap's cells, and
    three headings to each side; a heading's radian counts as a metre.
    """
    costmap = drivable.costmap
    row, column = costmap.cells_at(goal[:2]).tolist()
    if not (0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]):
        return PlanFailure(PlanReason.GOAL_OUTSIDE, beyond(costmap, goal))
    if np.isfinite(tightness_of(drivable, goal[None])[0]):
        if labels[row, column] == label:
            return Goal(goal, "")
        where = f"({goal[0]:.2f}, {goal[1]:.2f}) m"
        return PlanFailure(PlanReason.UNREACHABLE, f"{where} is free, and walls or things are all round it")
    is_unknown = costmap.is_lethal[row, column] and costmap.state[row, column] == CellState.UNKNOWN
    poses, off = _around(goal, costmap.resolution_m, settings)
    cells = costmap.cells_at(poses[:, :2])
    inside = ((cells >= 0) & (cells < labels.shape)).all(axis=1)
    near = np.zeros(len(poses), bool)
    near[inside] = labels[cells[inside, 0], cells[inside, 1]] == label
    poses, off = poses[near], off[near]
    tight = tightness_of(drivable, poses)
    # One that keeps clear is better than one that is nearer by a little, and hard to get to.
    score = off + 2 * settings.wanted_margin_m * tight
    if len(poses) and np.isfinite(score).any():
        return beside(goal, poses[int(np.argmin(score))], "the robot does not fit at the goal")
    reason = PlanReason.GOAL_UNKNOWN if is_unknown else PlanReason.GOAL_OCCUPIED
    return PlanFailure(reason, f"nor does it fit within {settings.goal_tolerance_m:g} m that can be reached")


def beyond(costmap: Costmap, pose: FloatArray) -> str:
    """That a pose lies outside of a costmap, and where that ends."""
    low, high = costmap.middle_of([-0.5, -0.5]), costmap.middle_of(np.array(costmap.state.shape) - 0.5)
    reaches = f"which reaches from ({low[0]:.2f}, {low[1]:.2f}) to ({high[0]:.2f}, {high[1]:.2f}) m"
    return f"({pose[0]:.2f}, {pose[1]:.2f}) m is beyond the map's edge, {reaches}"


def beside(goal: FloatArray, pose: FloatArray, why: str) -> Goal:
    """Another pose (3,) in the place of a goal (3,), and by how much it is another."""
    away_m, turned = float(np.hypot(*(pose - goal)[:2])), _turn(goal[2], pose[2])
    return Goal(pose.copy(), f"{why}: {away_m:.2f} m and {math.degrees(turned):.0f}° beside it", away_m, turned)


def nearest_heading(poses: FloatArray, goal: FloatArray, reach_m: float) -> int:
    """Which of poses (N, 4) so near to a goal's place is turned least against it (3,); -1: none is near."""
    near = np.flatnonzero(np.hypot(*(poses[:, :2] - goal[:2]).T) <= reach_m)
    turned = [_turn(goal[2], yaw) for yaw in poses[near, 2]]
    return int(near[np.argmin(turned)]) if len(near) else -1


def _turn(one: float, other: float) -> float:
    return 0.0 if math.isnan(one) else abs(math.remainder(float(one - other), 2 * math.pi))


def tightness_of(drivable: Drivable, poses: FloatArray) -> FloatArray:
    """(N,) as `Drivable.tightness` at poses (N, 3); of any heading, at the best of some."""
    if not np.isnan(poses[:, 2]).any():
        return drivable.tightness(poses)
    yaws = np.arange(_ANY_HEADINGS) * 2 * np.pi / _ANY_HEADINGS
    tried = np.stack([np.c_[poses[:, :2], np.full(len(poses), yaw)] for yaw in yaws])
    return np.asarray(drivable.tightness(tried.reshape(-1, 3)).reshape(len(yaws), -1).min(axis=0))


def _around(goal: FloatArray, step_m: float, settings: PlannerSettings) -> tuple[FloatArray, FloatArray]:
    """Poses (N, 3) within tolerance of a goal, and how far off each is (N,)."""
    count = int(settings.goal_tolerance_m / step_m)
    steps = step_m * np.arange(-count, count + 1)
    shares = np.arange(-_TURN_STEPS, _TURN_STEPS + 1) / _TURN_STEPS
    turns = np.zeros(1) if math.isnan(goal[2]) else settings.goal_tolerance_rad * shares
    offsets = np.stack(np.meshgrid(steps, steps, turns, indexing="ij"), axis=-1).reshape(-1, 3)
    away_m = np.hypot(offsets[:, 0], offsets[:, 1])
    kept = away_m <= settings.goal_tolerance_m
    return goal + offsets[kept], (away_m + np.abs(offsets[:, 2]))[kept]
