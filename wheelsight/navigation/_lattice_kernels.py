"""Compiled: the search over places and headings for a way that a footprint can drive (Hybrid A*, Dolgov et al. 2010).

A base with two driven wheels goes ahead and back along arcs, and turns in place. States are told apart by place and
heading, in steps, and keep the exact ones. What is left is guessed by the cost-to-go of the cells, which no footprint
beats.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.navigation._drive_kernels import (
    CURVE,
    CURVE_BACK,
    TURN_AND_DRIVE,
    WAYS,
    Rules,
    cost_of,
    wrapped,
    write_arc,
    write_way,
)
from wheelsight.navigation._footprint_kernels import Cells, Shape, cell_of

# Arcs by headings that they turn, for both directions; and turns in place.
_BENDS = (0, 1, -1, 2, -2)
MOVES = 12
_ROOM = 512
FOUND, NOTHING_LEFT, TOO_MANY = 0, 1, 2


class Tree(NamedTuple):
    """States that were reached.

    Attributes:
        pose: (n, 4) x, y, yaw and direction of the last motion.
        cost: (n,) paid so far.
        link: (n, 2) int32 the state before, and the move from it; WAYS of the goal are counted from MOVES on.
        table: (2^k,) int32 of states by cell and heading, -1 where empty.
        is_closed: (n,) uint8.
        keys: (n,) int64.
    """

    pose: Any
    cost: Any
    link: Any
    table: Any
    is_closed: Any
    keys: Any


class Heap(NamedTuple):
    """What waits: keys (n,) float64, states (n,) int32, and (1,) how many."""

    keys: Any
    states: Any
    count: Any


@kernel
def _push(heap: Heap, key: float, state: int) -> None:
    k = heap.count[0]
    heap.count[0] += 1
    while k > 0:
        up = (k - 1) >> 1
        if heap.keys[up] <= key:
            break
        heap.keys[k], heap.states[k] = heap.keys[up], heap.states[up]
        k = up
    heap.keys[k], heap.states[k] = key, state


@kernel
def _pop(heap: Heap) -> Any:
    top = heap.states[0]
    heap.count[0] -= 1
    last = heap.count[0]
    key, state, k = heap.keys[last], heap.states[last], 0
    while 2 * k + 1 < last:
        down = 2 * k + 1
        if down + 1 < last and heap.keys[down + 1] < heap.keys[down]:
            down += 1
        if heap.keys[down] >= key:
            break
        heap.keys[k], heap.states[k] = heap.keys[down], heap.states[down]
        k = down
    heap.keys[k], heap.states[k] = key, state
    return int(top)


@kernel(error_model="numpy")
def search(cells: Cells, shape: Shape, rules: Rules, known: Any, start: Any, goal: Any, tree: Tree) -> Any:
    """How it ended, the last state, and how many were reached.

    Args:
        cells, shape, rules: of the place, the robot and its driving.
        known: (H, W) cost-to-go of the cells.
        start: (3,) free.
        goal: (3,) free; its heading NaN where any will do.
        tree: empty.
    """
    most = len(tree.cost)
    heap = Heap(np.empty(4 * most), np.empty(4 * most, np.int32), np.zeros(1, np.int64))
    out = np.empty((_ROOM, 4))
    tree.pose[0, :3], tree.pose[0, 3] = start, 1.0
    tree.cost[0], tree.link[0, 0], tree.link[0, 1], tree.is_closed[0] = 0.0, -1, -1, 0
    slot = _slot(tree, _key(cells, rules, start[0], start[1], start[2]))
    tree.keys[0], tree.table[slot] = _key(cells, rules, start[0], start[1], start[2]), 0
    count, popped = 1, 0
    _push(heap, 0.0, 0)
    while heap.count[0] > 0:
        state = _pop(heap)
        if tree.link[state, 1] >= MOVES:
            return FOUND, state, count
        if tree.is_closed[state]:
            continue
        tree.is_closed[state] = 1
        popped += 1
        if count + MOVES + WAYS >= most or heap.count[0] + MOVES + WAYS >= len(heap.keys):
            return TOO_MANY, -1, count
        left_m = np.hypot(tree.pose[state, 0] - goal[0], tree.pose[state, 1] - goal[1])
        # The farther it is, the more rarely that succeeds, and the longer it takes to see.
        every = 1 + int(left_m / rules.stride_m)
        if left_m < rules.connect_m and (popped % every == 0 or state == 0):
            count = _connect(cells, shape, rules, goal, tree, (state, count), heap, out)
        for move in range(MOVES):
            count = _expand(cells, shape, rules, known, tree, (state, move, count), heap, out)
    return NOTHING_LEFT, -1, count


@kernel(error_model="numpy")
def arc_of(rules: Rules, yaw: float, move: int) -> Any:
    """Way and turn of a move from a heading; all but the first end at one of the `headings`."""
    unit = 2 * np.pi / rules.headings
    nearest = np.rint(yaw / unit) * unit
    bends = len(_BENDS)
    if move >= 2 * bends:
        return 0.0, nearest + unit * (1 if move == 2 * bends else -1) - yaw
    way_m = rules.stride_m if move < bends else -rules.stride_m
    return way_m, nearest + unit * _BENDS[move % bends] - yaw


@kernel(error_model="numpy")
def _key(cells: Cells, rules: Rules, x: float, y: float, yaw: float) -> Any:
    """Of a place and a heading; between narrow walls places are told apart twice as finely."""
    row, column = cell_of(cells, x, y)
    is_narrow = row >= 0 and cells.distance_m[row, column] < rules.narrow_m
    size_m = 0.5 * rules.place_m if is_narrow else rules.place_m
    heading = int(np.rint(yaw * rules.headings / (2 * np.pi))) % rules.headings
    place = (np.int64((y - cells.y0) / size_m) << 22) + np.int64((x - cells.x0) / size_m)
    return 2 * (place * rules.headings + heading) + is_narrow


@kernel(error_model="numpy")
def _slot(tree: Tree, key: Any) -> Any:
    """Where in the table a key is or belongs."""
    mask = len(tree.table) - 1
    # The product stays below 2^63.
    slot = (((key ^ (key >> 21)) & 0x7FFFFFFF) * 0x9E3779B1 >> 16) & mask
    while tree.table[slot] >= 0 and tree.keys[tree.table[slot]] != key:
        slot = (slot + 1) & mask
    return int(slot)


@kernel(error_model="numpy")
def _expand(cells: Cells, shape: Shape, rules: Rules, known: Any, tree: Tree, at: Any, heap: Heap, out: Any) -> Any:
    """Reach the state after a move, where that is free and cheaper than before; how many states there are then."""
    state, move, count = at
    for k in range(4):
        out[0, k] = tree.pose[state, k]
    arc = arc_of(rules, out[0, 2], move)
    end = write_arc(out, 1, arc, rules)
    if end <= 1:
        return count
    row, column = cell_of(cells, out[end - 1, 0], out[end - 1, 1])
    if row < 0 or known[row, column] == np.inf:
        return count
    key = _key(cells, rules, out[end - 1, 0], out[end - 1, 1], out[end - 1, 2])
    slot = _slot(tree, key)
    there = tree.table[slot]
    paid = tree.cost[state]
    if there >= 0 and (tree.is_closed[there] or tree.cost[there] <= paid + abs(arc[0])):
        return count
    paid += cost_of(cells, shape, rules, out, 1, end)
    if paid == np.inf or (there >= 0 and tree.cost[there] <= paid):
        return count
    if there < 0:
        there = count
        tree.table[slot], tree.keys[there], tree.is_closed[there] = there, key, 0
        count += 1
    tree.pose[there, 0], tree.pose[there, 1] = out[end - 1, 0], out[end - 1, 1]
    tree.pose[there, 2], tree.pose[there, 3] = wrapped(out[end - 1, 2]), out[end - 1, 3]
    tree.cost[there], tree.link[there, 0], tree.link[there, 1] = paid, state, move
    _push(heap, paid + rules.greed * known[row, column], there)
    return count


@kernel(error_model="numpy")
def _connect(cells: Cells, shape: Shape, rules: Rules, goal: Any, tree: Tree, at: Any, heap: Heap, out: Any) -> Any:
    """Try to reach the goal from a state in one go; how many states there are then."""
    state, count = at
    best, chosen = np.inf, -1
    for way in range(WAYS):
        for k in range(4):
            out[0, k] = tree.pose[state, k]
        end = write_to_goal(out, 1, goal, way, rules)
        if end > 0:
            cost = cost_of(cells, shape, rules, out, 1, end)
            if cost < best:
                best, chosen = cost, way
    if chosen < 0:
        return count
    tree.pose[count, :3], tree.pose[count, 3] = goal, 1.0
    tree.cost[count], tree.link[count, 0], tree.link[count, 1] = tree.cost[state] + best, state, MOVES + chosen
    tree.is_closed[count], tree.keys[count] = 0, -1
    _push(heap, tree.cost[count], count)
    return count + 1


@kernel(error_model="numpy")
def write_to_goal(out: Any, at: int, goal: Any, way: int, rules: Rules) -> Any:
    """As `write_way`; where any heading will do, it is that in which the goal is reached without a turn there."""
    to = goal.copy()
    if np.isnan(to[2]):
        dx, dy = to[0] - out[at - 1, 0], to[1] - out[at - 1, 1]
        if way in (CURVE, CURVE_BACK):
            return 0
        sense = 1.0 if way == TURN_AND_DRIVE else -1.0
        to[2] = np.arctan2(sense * dy, sense * dx) if np.hypot(dx, dy) > 0.0 else out[at - 1, 2]
    return write_way(out, at, to, way, rules)


@kernel(error_model="numpy")
def way_to(rules: Rules, tree: Tree, last: int, goal: Any, out: Any) -> Any:
    """Write all poses from the start to a state into `out` (n, 4); how many, or 0 where there is no room."""
    length, state = 0, last
    while state >= 0:
        length += 1
        state = tree.link[state, 0]
    states = np.empty(length, np.int64)
    state = last
    for k in range(length):
        states[length - 1 - k] = state
        state = tree.link[state, 0]
    out[0] = tree.pose[states[0]]
    at = 1
    for k in range(1, length):
        move = tree.link[states[k], 1]
        if move >= MOVES:
            at = write_to_goal(out, at, goal, move - MOVES, rules)
        else:
            at = write_arc(out, at, arc_of(rules, out[at - 1, 2], move), rules)
        if at <= 0:
            return 0
    return at
