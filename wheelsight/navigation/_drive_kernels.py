"""Compiled: poses along arcs, turns in place and curves, and what it costs to drive along them.

Poses (N, 4) are x, y, yaw and direction, 1 forward and -1 backward, in steps in which no point of the robot moves
farther than `Rules.step_m`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.navigation._footprint_kernels import Cells, Shape, cell_of, tightness

TURN_AND_DRIVE, BACK_AND_TURN, CURVE, CURVE_BACK = 0, 1, 2, 3
WAYS = 4
_EPSILON = 1e-9
_TWO_PI = 2 * np.pi


class Rules(NamedTuple):
    """What driving costs and how it is searched; see `PlannerSettings`."""

    step_m: float
    turn_m: float
    bend_m: float
    forward: float
    backward: float
    switch_m: float
    tight: float
    radius_m: float
    reach_m: float
    headings: int
    place_m: float
    narrow_m: float
    stride_m: float
    greed: float
    connect_m: float
    most_states: int


@kernel(error_model="numpy")
def wrapped(angle: float) -> Any:
    """An angle in [-π, π)."""
    return angle - _TWO_PI * np.floor((angle + np.pi) / _TWO_PI)


@kernel(error_model="numpy")
def write_arc(out: Any, at: int, arc: Any, rules: Rules) -> Any:
    """Write poses after pose `at - 1` along an arc of (way, turn), backward where the way is negative; how many then.

    A turn in place keeps the direction. Where there is no room it is 0.
    """
    way_m, turn = arc
    x, y, yaw = out[at - 1, 0], out[at - 1, 1], out[at - 1, 2]
    sense = out[at - 1, 3] if way_m == 0.0 else np.sign(way_m)
    steps = int(np.ceil((abs(way_m) + rules.reach_m * abs(turn)) / rules.step_m - _EPSILON))
    if at + steps > len(out):
        return 0
    for k in range(steps):
        share = (k + 1) / steps
        half = 0.5 * turn * share
        chord = way_m * share * (np.sin(half) / half if abs(half) > _EPSILON else 1.0)
        out[at + k, 0], out[at + k, 1] = x + chord * np.cos(yaw + half), y + chord * np.sin(yaw + half)
        out[at + k, 2], out[at + k, 3] = yaw + turn * share, sense
    return at + steps


@kernel(error_model="numpy")
def write_way(out: Any, at: int, to: Any, way: int, rules: Rules) -> Any:
    """Write poses after pose `at - 1` to another (3,) by one of WAYS; how many there are then, 0 where it cannot be."""
    if way >= CURVE:
        return _write_curve(out, at, to, 1.0 if way == CURVE else -1.0, rules)
    dx, dy = to[0] - out[at - 1, 0], to[1] - out[at - 1, 1]
    length_m = np.hypot(dx, dy)
    yaw, sense = out[at - 1, 2], 1.0 if way == TURN_AND_DRIVE else -1.0
    if length_m < _EPSILON:
        return write_arc(out, at, (0.0, wrapped(to[2] - yaw)), rules)
    heading = np.arctan2(sense * dy, sense * dx)
    at = write_arc(out, at, (0.0, wrapped(heading - yaw)), rules)
    at = write_arc(out, at, (sense * length_m, 0.0), rules) if at > 0 else 0
    return write_arc(out, at, (0.0, wrapped(to[2] - heading)), rules) if at > 0 else 0


@kernel(error_model="numpy")
def _write_curve(out: Any, at: int, to: Any, sense: float, rules: Rules) -> Any:
    """A cubic curve (Hermite's) that begins and ends along both headings, nowhere narrower than `radius_m`."""
    x, y, yaw = out[at - 1, 0], out[at - 1, 1], out[at - 1, 2]
    length_m = np.hypot(to[0] - x, to[1] - y)
    turn = abs(wrapped(to[2] - yaw))
    if length_m < _EPSILON or turn > 0.75 * np.pi:
        return 0
    ax, ay = sense * length_m * np.cos(yaw), sense * length_m * np.sin(yaw)
    bx, by = sense * length_m * np.cos(to[2]), sense * length_m * np.sin(to[2])
    # A curve turns more than its ends tell, and goes farther; what it moves by is looked at below.
    steps = int(np.ceil((1.2 * length_m + rules.reach_m * (turn + 0.5)) / rules.step_m)) + 2
    if at + steps > len(out):
        return 0
    heading, past_x, past_y = yaw, x, y
    for k in range(steps):
        t = (k + 1) / steps
        h1, h2, h3 = t * t * (3 - 2 * t), t * (1 - t) * (1 - t), t * t * (t - 1)
        px, py = x + h1 * (to[0] - x) + h2 * ax + h3 * bx, y + h1 * (to[1] - y) + h2 * ay + h3 * by
        d1, d2, d3 = 6 * t * (1 - t), (1 - t) * (1 - 3 * t), t * (3 * t - 2)
        vx, vy = d1 * (to[0] - x) + d2 * ax + d3 * bx, d1 * (to[1] - y) + d2 * ay + d3 * by
        change = wrapped(np.arctan2(sense * vy, sense * vx) - heading)
        moved_m = np.hypot(px - past_x, py - past_y)
        if abs(change) * rules.radius_m > moved_m or moved_m + rules.reach_m * abs(change) > rules.step_m:
            return 0
        heading, past_x, past_y = heading + change, px, py
        out[at + k, 0], out[at + k, 1], out[at + k, 2], out[at + k, 3] = px, py, heading, sense
    return at + steps


@kernel(error_model="numpy")
def cost_of(cells: Cells, shape: Shape, rules: Rules, poses: Any, begin: int, end: int) -> Any:
    """What it costs to drive from pose `begin - 1` over those up to `end`; infinite where one is not free.

    `begin` is at least 1.
    """
    total = 0.0
    for k in range(begin, end):
        x, y, yaw = poses[k, 0], poses[k, 1], poses[k, 2]
        tight = tightness(cells, shape, x, y, yaw)
        if tight == np.inf:
            return np.inf
        row, column = cell_of(cells, x, y)
        # By the square, so that what is a little too near hardly bends a way.
        tight = rules.tight * tight * tight
        way_m = np.hypot(x - poses[k - 1, 0], y - poses[k - 1, 1])
        turn = abs(yaw - poses[k - 1, 2])
        if way_m < _EPSILON:
            # What is not allowed costs infinitely much, and times nothing would be no number.
            total += rules.turn_m * turn * (1.0 + tight) if turn > _EPSILON else 0.0
            continue
        factor = rules.backward if poses[k, 3] < 0 else rules.forward
        total += way_m * (cells.metre_cost[row, column] + tight) * factor
        if turn > _EPSILON:
            total += rules.bend_m * turn
        if poses[k, 3] != poses[k - 1, 3]:
            total += rules.switch_m
    return total
