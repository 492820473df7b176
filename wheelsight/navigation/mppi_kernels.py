"""Compiled rollouts: commands through a robot's dynamics, their costs, and their weighted mean.

Williams, Aldrich, Theodorou: Model predictive path integral control: from theory to parallel computation, 2017.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import Float32Array, FloatArray
from wheelsight.navigation.clearance_kernels import (
    CostField,
    Outline,
    clearance_at,
    cost_and_speed_at,
    people_apart,
    toward,
)

# Least way of any corner between two measurements of clearance.
_LOOK_M = 0.1
# Fast-math flags that keep infinity and NaN.
_FAST = {"contract", "nsz", "arcp"}


class Begin(NamedTuple):
    """Start of rollouts: pose, measured speeds, the way's point there, and distances of obstacles and people."""

    x: float
    y: float
    yaw: float
    forward_m_s: float
    turn_rad_s: float
    point: int
    clearance_m: float
    apart_m: float


class PathAhead(NamedTuple):
    """Part of a path that is driven in one direction.

    Attributes:
        points: (M, 6) x, y, cosine and sine of the robot's heading, metres along, and the highest speed there.
        direction: 1 forward, -1 backward.
    """

    points: FloatArray
    direction: float


class Dynamics(NamedTuple):
    """Response of a base to commands.

    Attributes:
        outline: of the robot.
        forward_m_s, backward_m_s, turn_rad_s: highest speeds.
        speed_up, slow_down, turn_change: largest changes of speeds in one step.
        share: part of the difference to a command that the lag leaves to one step.
        step_s: seconds per step.
        reach_m: distance from the axle to the farthest corner.
    """

    outline: Outline
    forward_m_s: float
    backward_m_s: float
    turn_rad_s: float
    speed_up: float
    slow_down: float
    turn_change: float
    share: float
    step_s: float
    reach_m: float


class RolloutWeights(NamedTuple):
    """Weights of a rollout's costs, per second unless stated.

    Nearness costs by way instead of time. Otherwise a robot would creep or stand in front of a goal beside a wall.
    Aside to progress, beyond and near were found on kinematic drives of the tests alone. People count from a step away;
    contact is more than everything else.

    Attributes:
        margin_m, people_margin_m: of the settings.
        aside: of half a square metre beside the way; beyond `aside_m` it grows linearly.
        heading: of 1 - cosine of the angle to the way.
        progress: of a metre less along the way, at the end.
        beyond: of a square metre beyond the way's end.
        wrong_way: of a metre per second against the way's direction.
        too_fast: of a metre per second above a zone's limit.
        cost: of a metre at the field's cost of 1.
        near: of a metre along an obstacle, quadratic from 0 at `near_m` to the whole at `margin_m`.
        change_forward, change_turn: of the square of a command's change in one step.
        contact: of coming nearer than `margin_m`, once.
        people: of a second near people, as `near`, within `people_m`.
    """

    margin_m: float
    people_margin_m: float
    aside: float = 80.0
    aside_m: float = 0.1
    heading: float = 4.0
    progress: float = 8.0
    beyond: float = 200.0
    wrong_way: float = 20.0
    too_fast: float = 50.0
    cost: float = 1.0
    near: float = 1.5
    near_m: float = 0.3
    change_forward: float = 1.0
    change_turn: float = 0.5
    contact: float = 1000.0
    people: float = 8.0
    people_m: float = 0.6


@kernel(error_model="numpy", fastmath=_FAST)
def draw(nominal: FloatArray, noise: Float32Array, spread: Any, dynamics: Dynamics, drawn: Float32Array) -> None:
    """Draw commands (K, T, 2) around nominal ones (T, 2) by standard noise (K, T, 2), within the limits.

    The first row is the nominal one, the second a stop.
    """
    rollouts, steps, _ = noise.shape
    for k in range(rollouts):
        for t in range(steps):
            v = nominal[t, 0] + spread[0] * noise[k, t, 0]
            w = nominal[t, 1] + spread[1] * noise[k, t, 1]
            if k <= 1:
                v, w = (nominal[t, 0], nominal[t, 1]) if k == 0 else (0.0, 0.0)
            drawn[k, t, 0] = min(max(v, -dynamics.backward_m_s), dynamics.forward_m_s)
            drawn[k, t, 1] = min(max(w, -dynamics.turn_rad_s), dynamics.turn_rad_s)


@kernel(error_model="numpy", fastmath=_FAST)
def costs_of(
    begin: Begin,
    way: PathAhead,
    field: CostField,
    people: FloatArray,
    dynamics: Dynamics,
    weights: RolloutWeights,
    drawn: Float32Array,
    costs: FloatArray,
) -> None:
    """Compute the costs of rollouts (K, T, 2) into (K,)."""
    poses = np.empty((0, 3))
    for k in range(len(drawn)):
        costs[k], _ = roll_out(begin, way, field, people, dynamics, weights, drawn[k], poses)


@kernel(error_model="numpy", fastmath=_FAST)
def roll_out(
    begin: Begin,
    way: PathAhead,
    field: CostField,
    people: FloatArray,
    dynamics: Dynamics,
    weights: RolloutWeights,
    commands: Float32Array,
    poses: FloatArray,
) -> Any:
    """Return the cost of a rollout (T, 2), and the step of a collision, or T. Write poses (T, 3), or none to (0, 3)."""
    steps = len(commands)
    pose = (begin.x, begin.y, np.cos(begin.yaw), np.sin(begin.yaw))
    v, w, point, way_m = begin.forward_m_s, begin.turn_rad_s, begin.point, 0.0
    around = _look(field, pose, begin.clearance_m, weights)
    apart, close, touches, total = begin.apart_m, _close(begin.apart_m, weights), False, 0.0
    for t in range(steps):
        v, w = _follow(v, w, _ends(commands[t, 0], way, point), commands[t, 1], dynamics)
        pose = _moved(pose, v * dynamics.step_s, w * dynamics.step_s)
        point = _advance(way, point, pose[0], pose[1])
        if len(poses) > 0:
            poses[t, 0], poses[t, 1], poses[t, 2] = pose[0], pose[1], np.arctan2(pose[3], pose[2])
        way_m += (abs(v) + dynamics.reach_m * abs(w)) * dynamics.step_s
        # No point of the outline has moved farther than this, so it cannot have touched anything beyond.
        if way_m >= max(around[0] - weights.margin_m, _LOOK_M) or t == steps - 1:
            clearance = clearance_at(field, dynamics.outline, pose, weights.margin_m)
            touches = _touches(clearance, around[0], weights.margin_m)
            around, way_m = _look(field, pose, clearance, weights), 0.0
        if len(people) > 0 and t % 2 == 1:
            before, apart = apart, people_apart(people, dynamics.outline, pose, (t + 1) * dynamics.step_s)
            touches |= _touches(apart, before, weights.people_margin_m)
            close = _close(apart, weights)
        if touches:
            return total + weights.contact * (2.0 - t / steps), t
        cost = _of_way(way, point, pose, v, weights) + _of_changes(commands, t, weights)
        total += (cost + abs(v) * around[1] + close + weights.too_fast * max(abs(v) - around[2], 0.0)) * dynamics.step_s
    return total + _of_end(way, begin.point, point, pose, weights), steps


@kernel(error_model="numpy", fastmath=_FAST)
def _look(field: CostField, pose: Any, clearance: float, weights: RolloutWeights) -> Any:
    """Return clearance, cost of a metre, and speed limit at a pose."""
    share = max(weights.near_m - clearance, 0.0) / (weights.near_m - weights.margin_m)
    floor, fastest = cost_and_speed_at(field, pose[0], pose[1])
    return clearance, weights.near * share * share + weights.cost * floor, fastest


@kernel(error_model="numpy", fastmath=_FAST)
def _close(apart: float, weights: RolloutWeights) -> Any:
    """Return the cost of a second at a distance from people."""
    share = max(weights.people_m - apart, 0.0) / (weights.people_m - weights.people_margin_m)
    return weights.people * share * share


@kernel(error_model="numpy", fastmath=_FAST)
def _follow(v: float, w: float, wanted_v: float, wanted_w: float, dynamics: Dynamics) -> Any:
    """Return the speeds after one step."""
    v = toward(v, v + dynamics.share * (wanted_v - v), dynamics.speed_up, dynamics.slow_down)
    change = dynamics.share * (wanted_w - w)
    return v, w + min(max(change, -dynamics.turn_change), dynamics.turn_change)


@kernel(error_model="numpy", fastmath=_FAST)
def _moved(pose: Any, way_m: float, turn_rad: float) -> Any:
    """Return the same as `moved` for the turn of a step, by series: an error of 1e-7 at a fifth of a radian."""
    x, y, c, s = pose
    h = turn_rad / 2
    hh = h * h
    hc, hs = 1.0 - hh * (0.5 - hh / 24.0), h * (1.0 - hh * (1.0 / 6.0 - hh / 120.0))
    mc, ms = c * hc - s * hs, s * hc + c * hs
    chord = way_m * (1.0 - hh / 6.0)
    return x + chord * mc, y + chord * ms, mc * hc - ms * hs, ms * hc + mc * hs


@kernel(error_model="numpy", fastmath=_FAST)
def _along(way: PathAhead, point: int, x: float, y: float) -> Any:
    """Return how far a place lies beyond a point of the way, in its direction."""
    p = way.points
    return way.direction * ((x - p[point, 0]) * p[point, 2] + (y - p[point, 1]) * p[point, 3])


@kernel(error_model="numpy", fastmath=_FAST)
def _advance(way: PathAhead, point: int, x: float, y: float) -> Any:
    """Return the point of the way that a robot has reached, from the one before."""
    last = len(way.points) - 1
    while point < last:
        if _along(way, point, x, y) <= (way.points[point + 1, 4] - way.points[point, 4]) / 2:
            break
        point += 1
    return point


@kernel(error_model="numpy", fastmath=_FAST)
def _ends(v: float, way: PathAhead, point: int) -> Any:
    """Limit a commanded speed so that the robot stops at the way's end."""
    most = way.points[point, 5]
    return min(max(v, -most), most)


@kernel(error_model="numpy", fastmath=_FAST)
def _of_way(way: PathAhead, point: int, pose: Any, v: float, weights: RolloutWeights) -> Any:
    p = way.points
    px, py, pc, ps = p[point, 0], p[point, 1], p[point, 2], p[point, 3]
    aside = (pose[1] - py) * pc - (pose[0] - px) * ps
    cosine = pose[2] * pc + pose[3] * ps
    against = max(-way.direction * v, 0.0)
    # Quadratic near the way and linear far from it, so that a detour does not pull the robot into the obstacle.
    off = weights.aside_m * (np.sqrt(aside * aside + weights.aside_m * weights.aside_m) - weights.aside_m)
    return weights.aside * off + weights.heading * (1.0 - cosine) + weights.wrong_way * against


@kernel(error_model="numpy", fastmath=_FAST)
def _of_changes(commands: Float32Array, t: int, weights: RolloutWeights) -> Any:
    if t == 0:
        return 0.0
    dv, dw = commands[t, 0] - commands[t - 1, 0], commands[t, 1] - commands[t - 1, 1]
    return weights.change_forward * dv * dv + weights.change_turn * dw * dw


@kernel(error_model="numpy", fastmath=_FAST)
def _touches(clearance: float, before: float, margin_m: float) -> Any:
    """Return whether a robot comes too near; not if it was too near already, and moves away."""
    return clearance <= margin_m and not (before <= margin_m and clearance > before + 1e-4)


@kernel(error_model="numpy", fastmath=_FAST)
def _of_end(way: PathAhead, begin: int, point: int, pose: Any, weights: RolloutWeights) -> Any:
    along = _along(way, point, pose[0], pose[1])
    beyond = max(along, 0.0) if point == len(way.points) - 1 else 0.0
    return weights.beyond * beyond * beyond - weights.progress * (way.points[point, 4] - way.points[begin, 4] + along)


@kernel(error_model="numpy", fastmath=_FAST)
def blend(costs: FloatArray, drawn: Float32Array, temperature: float, blended: FloatArray) -> Any:
    """Write the mean of commands (K, T, 2) by exp(-cost / temperature) into (T, 2); return the row of the cheapest."""
    best = int(np.argmin(costs))
    blended[:] = 0.0
    total = 0.0
    for k in range(len(costs)):
        weight = np.exp((costs[best] - costs[k]) / temperature)
        if weight < 1e-6:
            continue
        total += weight
        for t in range(drawn.shape[1]):
            blended[t, 0] += weight * drawn[k, t, 0]
            blended[t, 1] += weight * drawn[k, t, 1]
    blended /= total
    return best
