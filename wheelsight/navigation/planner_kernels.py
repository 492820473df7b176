"""Compiled planner: cost-to-go on the grid, Hybrid A*, motion primitives, and replacement of parts of a path."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.navigation.costmap_kernels import PlanCells, Shape, cell_of, tightness

# Cost-to-go of cells, and the path down it: Dijkstra with buckets instead of a heap. A bucket is no wider than the
# cheapest step, so all cells of the lowest one are final (Denardo & Fox 1979).

_DIAGONAL = np.sqrt(2.0)
# Width of a bucket in cheapest steps. Rounding must not put a cell into the bucket that it was reached from.
_WIDTH = 0.999


@kernel(error_model="numpy")
def cost_to_go_kernel(metre_cost: Any, resolution_m: float, goals: Any, goal_costs: Any) -> Any:
    """Return (H, W) float64, the cost of the cheapest 8-connected paths to any goal; infinite without one.

    A step costs its length times the mean of both cells' costs. It may not cut the corner of a blocked cell.

    Args:
        metre_cost: (H, W) float32, at least 1; infinite where blocked.
        resolution_m: side of a cell.
        goals: (N, 2) row and column.
        goal_costs: (N,) remaining cost at the goals.
    """
    rows, columns = metre_cost.shape
    wide = columns + 2
    costs = np.full((rows + 2) * wide, np.inf, np.float32)
    highest = np.float32(1.0)
    for i in range(rows):
        for j in range(columns):
            costs[(i + 1) * wide + j + 1] = metre_cost[i, j]
            if metre_cost[i, j] < np.inf:
                highest = max(highest, metre_cost[i, j])
    known = np.full(len(costs), np.inf)
    width = _WIDTH * resolution_m
    last = 0.0
    for k in range(len(goals)):
        last = max(last, goal_costs[k])
    # A power of two, so that a mask takes the place of a division.
    buckets = 4
    while buckets < int(max(_DIAGONAL * highest * resolution_m, last) / width) + 3:
        buckets *= 2
    heads = np.full(buckets, -1, np.int32)
    links = np.full((len(costs), 2), -1, np.int32)
    waiting = 0
    for k in range(len(goals)):
        cell = (goals[k, 0] + 1) * wide + goals[k, 1] + 1
        if costs[cell] < np.inf and goal_costs[k] < known[cell]:
            waiting += _put(cell, goal_costs[k], known, heads, links, 1 / width)
    _spread(costs, known, heads, links, wide, resolution_m, waiting)
    return known.reshape(rows + 2, wide)[1:-1, 1:-1].copy()


@kernel(error_model="numpy")
def _put(cell: int, cost: float, known: Any, heads: Any, links: Any, per_m: float) -> Any:
    """Move a cell to the bucket of its new, lower cost; return 1 if it was in no bucket, else 0."""
    is_new = 1
    if known[cell] < np.inf:
        is_new = 0
        _take(cell, int(known[cell] * per_m) & (len(heads) - 1), heads, links)
    known[cell] = cost
    bucket = int(cost * per_m) & (len(heads) - 1)
    links[cell, 0], links[cell, 1] = -1, heads[bucket]
    if heads[bucket] >= 0:
        links[heads[bucket], 0] = cell
    heads[bucket] = cell
    return is_new


@kernel(error_model="numpy")
def _take(cell: Any, bucket: int, heads: Any, links: Any) -> None:
    before, after = links[cell, 0], links[cell, 1]
    if before >= 0:
        links[before, 1] = after
    else:
        heads[bucket] = after
    if after >= 0:
        links[after, 0] = before


@kernel(error_model="numpy")
def _spread(costs: Any, known: Any, heads: Any, links: Any, wide: int, resolution_m: float, waiting: int) -> None:
    """Settle all waiting cells, and those reached from them."""
    per_m = 1 / (_WIDTH * resolution_m)
    straight = np.array([1, -1, wide, -wide])
    sides = np.array([[1, wide], [1, -wide], [-1, wide], [-1, -wide]])
    half, diagonal = 0.5 * resolution_m, 0.5 * _DIAGONAL * resolution_m
    bucket = 0
    while waiting > 0:
        cell = np.int64(heads[bucket])
        if cell < 0:
            bucket = (bucket + 1) & (len(heads) - 1)
            continue
        _take(cell, bucket, heads, links)
        waiting -= 1
        here, paid = costs[cell], known[cell]
        for k in range(4):
            other = cell + straight[k]
            cost = paid + half * (here + costs[other])
            if cost < known[other]:
                waiting += _put(other, cost, known, heads, links, per_m)
            if costs[cell + sides[k, 0]] == np.inf or costs[cell + sides[k, 1]] == np.inf:
                continue
            other = cell + sides[k, 0] + sides[k, 1]
            cost = paid + diagonal * (here + costs[other])
            if cost < known[other]:
                waiting += _put(other, cost, known, heads, links, per_m)


@kernel(error_model="numpy")
def passable_costs(cells: PlanCells, is_lethal: Any, least_m: Any, added: Any) -> Any:
    """Return (H, W) float32 costs of a metre; infinite where lethal or nearer to an obstacle than the last distance.

    Args:
        cells: of the costmap.
        is_lethal: (H, W).
        least_m: (K,) falling distances.
        added: (K,) rising cost of a metre nearer to an obstacle than each of them.
    """
    costs = np.empty(cells.metre_cost.shape, np.float32)
    for i in range(costs.shape[0]):
        for j in range(costs.shape[1]):
            cost, away_m = np.float32(cells.metre_cost[i, j]), cells.distance_m[i, j]
            tight = np.float32(0.0)
            for k in range(len(least_m)):
                if away_m >= least_m[k]:
                    break
                tight = added[k]
            costs[i, j] = np.float32(np.inf) if is_lethal[i, j] else cost + tight
    return costs


@kernel(error_model="numpy")
def is_line_cheaper(way: Any, begin: int, end: int, known: Any, metre_cost: Any, resolution_m: float) -> Any:
    """Return whether a straight line between two cells of a path (K, 2) costs no more than the path over the cells."""
    rows, columns = way[end, 0] - way[begin, 0], way[end, 1] - way[begin, 1]
    length = np.hypot(rows, columns)
    before = known[way[begin, 0], way[begin, 1]] - known[way[end, 0], way[end, 1]]
    steps = max(int(np.ceil(2 * length)), 1)
    total, most = 0.0, before * (1 + 1e-6) * steps / max(length * resolution_m, 1e-12)
    for k in range(steps):
        share = (k + 0.5) / steps
        total += metre_cost[int(np.rint(way[begin, 0] + share * rows)), int(np.rint(way[begin, 1] + share * columns))]
        if total > most:
            return False
    return True


@kernel(error_model="numpy")
def descend(known: Any, metre_cost: Any, resolution_m: float, row: int, column: int) -> Any:
    """Return (N, 2) rows and columns of the cheapest path from a cell to the goal, each a neighbour of the last."""
    rows, columns = known.shape
    way = np.empty((rows * columns, 2), np.int64)
    count = 0
    while True:
        way[count, 0], way[count, 1] = row, column
        count += 1
        best, next_row, next_column = np.inf, -1, -1
        for i in range(max(row - 1, 0), min(row + 2, rows)):
            for j in range(max(column - 1, 0), min(column + 2, columns)):
                if (
                    metre_cost[i, column] == np.inf
                    or metre_cost[row, j] == np.inf
                    or not known[i, j] < known[row, column]
                ):
                    continue
                step = _DIAGONAL if i != row and j != column else 1.0
                cost = known[i, j] + 0.5 * step * resolution_m * (metre_cost[i, j] + metre_cost[row, column])
                if cost < best:
                    best, next_row, next_column = cost, i, j
        if next_row < 0:
            return way[:count].copy()
        row, column = next_row, next_column


# Search over places and headings for a path of a footprint (Hybrid A*, Dolgov et al. 2010).
#
# A differential drive moves along arcs, forward and backward, and turns in place. States are discretized by place and
# heading, but keep their exact poses. The heuristic is the cost-to-go of the cells, a lower bound for any footprint.

# Arcs by the headings that they turn, in both directions; and turns in place.
_BENDS = (0, 1, -1, 2, -2)
MOVES = 12
_ROOM = 512
FOUND, NOTHING_LEFT, TOO_MANY = 0, 1, 2


class SearchTree(NamedTuple):
    """States of a search.

    Attributes:
        pose: (n, 4) x, y, yaw and direction of the last motion.
        cost: (n,) cost so far.
        link: (n, 2) int32 parent state, and the move from it; connections to the goal are numbered from MOVES on.
        table: (2^k,) int32 hash table of states by cell and heading, -1 where empty.
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
    """Open states: keys (n,) float64, states (n,) int32, and their number (1,)."""

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
def search(
    cells: PlanCells, shape: Shape, rules: DriveRules, known: Any, start: Any, goal: Any, tree: SearchTree
) -> Any:
    """Search a path; return how it ended, the last state, and the number of states.

    Args:
        cells, shape, rules: of the costmap, the robot and its driving.
        known: (H, W) cost-to-go of the cells.
        start: (3,) free.
        goal: (3,) free; a heading of NaN is any heading.
        tree: empty.
    """
    most = len(tree.cost)
    heap = Heap(np.empty(4 * most), np.empty(4 * most, np.int32), np.zeros(1, np.int64))
    out = np.empty((_ROOM, 4))
    tree.pose[0, 0], tree.pose[0, 1], tree.pose[0, 2], tree.pose[0, 3] = start[0], start[1], start[2], 1.0
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
        # A connection from farther away succeeds less often, and takes longer to check.
        every = 1 + int(left_m / rules.stride_m)
        if left_m < rules.connect_m and (popped % every == 0 or state == 0):
            count = _connect(cells, shape, rules, goal, tree, (state, count), heap, out)
        for move in range(MOVES):
            count = _expand(cells, shape, rules, known, tree, (state, move, count), heap, out)
    return NOTHING_LEFT, -1, count


@kernel(error_model="numpy")
def arc_of(rules: DriveRules, yaw: float, move: Any) -> Any:
    """Return way and turn of a move from a heading; all but the first end at one of the `headings`."""
    unit = 2 * np.pi / rules.headings
    nearest = np.rint(yaw / unit) * unit
    bends = len(_BENDS)
    if move >= 2 * bends:
        return 0.0, nearest + unit * (1 if move == 2 * bends else -1) - yaw
    way_m = rules.stride_m if move < bends else -rules.stride_m
    return way_m, nearest + unit * _BENDS[move % bends] - yaw


@kernel(error_model="numpy")
def _key(cells: PlanCells, rules: DriveRules, x: float, y: float, yaw: float) -> Any:
    """Return the key of a place and a heading; in narrow places the grid is twice as fine."""
    row, column = cell_of(cells, x, y)
    is_narrow = row >= 0 and cells.distance_m[row, column] < rules.narrow_m
    size_m = 0.5 * rules.place_m if is_narrow else rules.place_m
    heading = int(np.rint(yaw * rules.headings / (2 * np.pi))) % rules.headings
    place = (np.int64((y - cells.y0) / size_m) << 22) + np.int64((x - cells.x0) / size_m)
    return 2 * (place * rules.headings + heading) + is_narrow


@kernel(error_model="numpy")
def _slot(tree: SearchTree, key: Any) -> Any:
    """Return the slot of a key in the hash table."""
    mask = len(tree.table) - 1
    # The product stays below 2^63.
    slot = (((key ^ (key >> 21)) & 0x7FFFFFFF) * 0x9E3779B1 >> 16) & mask
    while tree.table[slot] >= 0 and tree.keys[tree.table[slot]] != key:
        slot = (slot + 1) & mask
    return int(slot)


@kernel(error_model="numpy")
def _expand(
    cells: PlanCells, shape: Shape, rules: DriveRules, known: Any, tree: SearchTree, at: Any, heap: Heap, out: Any
) -> Any:
    """Add the state after a move if that is free and cheaper than before; return the number of states."""
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
def _connect(
    cells: PlanCells, shape: Shape, rules: DriveRules, goal: Any, tree: SearchTree, at: Any, heap: Heap, out: Any
) -> Any:
    """Try to connect a state to the goal directly; return the number of states."""
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
    tree.pose[count, 0], tree.pose[count, 1], tree.pose[count, 2], tree.pose[count, 3] = goal[0], goal[1], goal[2], 1.0
    tree.cost[count], tree.link[count, 0], tree.link[count, 1] = tree.cost[state] + best, state, MOVES + chosen
    tree.is_closed[count], tree.keys[count] = 0, -1
    _push(heap, tree.cost[count], count)
    return count + 1


@kernel(error_model="numpy")
def write_to_goal(out: Any, at: int, goal: Any, way: int, rules: DriveRules) -> Any:
    """Write a connection to a goal; for any heading, with the one that needs no turn at the goal."""
    to = goal.copy()
    if np.isnan(to[2]):
        dx, dy = to[0] - out[at - 1, 0], to[1] - out[at - 1, 1]
        if way in (CURVE, CURVE_BACK):
            return 0
        sense = 1.0 if way == TURN_AND_DRIVE else -1.0
        to[2] = np.arctan2(sense * dy, sense * dx) if np.hypot(dx, dy) > 0.0 else out[at - 1, 2]
    return write_way(out, at, to, way, rules)


@kernel(error_model="numpy")
def way_to(rules: DriveRules, tree: SearchTree, last: int, goal: Any, out: Any) -> Any:
    """Write all poses from the start to a state into `out` (n, 4); return their number, or 0 without room."""
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
            at = write_arc(out, at, arc_of(rules, out[at - 1, 2], np.int64(move)), rules)
        if at <= 0:
            return 0
    return at


# Poses along arcs, turns in place and curves, and the cost to drive along them.
#
# Poses (N, 4) are x, y, yaw and direction, 1 forward and -1 backward. Between two of them no point of the robot moves
# farther than `DriveRules.step_m`.

TURN_AND_DRIVE, BACK_AND_TURN, CURVE, CURVE_BACK = 0, 1, 2, 3
WAYS = 4
_EPSILON = 1e-9
_TWO_PI = 2 * np.pi


class DriveRules(NamedTuple):
    """Costs of driving and limits of the search; see `PlannerSettings`."""

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


@kernel(error_model="numpy")
def wrapped(angle: float) -> Any:
    """Return an angle in [-π, π)."""
    return angle - _TWO_PI * np.floor((angle + np.pi) / _TWO_PI)


@kernel(error_model="numpy")
def write_arc(out: Any, at: int, arc: Any, rules: DriveRules) -> Any:
    """Write poses after pose `at - 1` along an arc of (way, turn), backward if the way is negative.

    A turn in place keeps the direction. Returns the number of poses, 0 without room.
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
def write_way(out: Any, at: int, to: Any, way: int, rules: DriveRules) -> Any:
    """Write poses after pose `at - 1` to another (3,) by one of WAYS; return the number of poses, 0 if impossible."""
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
def _write_curve(out: Any, at: int, to: Any, sense: float, rules: DriveRules) -> Any:
    """Write a cubic Hermite curve between both headings, with a radius of at least `radius_m` everywhere."""
    x, y, yaw = out[at - 1, 0], out[at - 1, 1], out[at - 1, 2]
    length_m = np.hypot(to[0] - x, to[1] - y)
    turn = abs(wrapped(to[2] - yaw))
    if length_m < _EPSILON or turn > 0.75 * np.pi:
        return 0
    ax, ay = sense * length_m * np.cos(yaw), sense * length_m * np.sin(yaw)
    bx, by = sense * length_m * np.cos(to[2]), sense * length_m * np.sin(to[2])
    # A curve turns more than its ends differ, and is longer; its exact steps are checked below.
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
def cost_of(cells: PlanCells, shape: Shape, rules: DriveRules, poses: Any, begin: int, end: int) -> Any:
    """Return the cost to drive from pose `begin - 1` over those up to `end`; infinite if one is not free.

    `begin` is at least 1.
    """
    total = 0.0
    for k in range(begin, end):
        total += step_cost(cells, shape, rules, poses, k)
        if total == np.inf:
            break
    return total


@kernel(error_model="numpy")
def step_cost(cells: PlanCells, shape: Shape, rules: DriveRules, poses: Any, k: int) -> Any:
    """Return the cost to drive from pose `k - 1` to pose `k`; infinite if the latter is not free."""
    x, y, yaw = poses[k, 0], poses[k, 1], poses[k, 2]
    tight = tightness(cells, shape, x, y, yaw)
    if tight == np.inf:
        return np.inf
    row, column = cell_of(cells, x, y)
    # Squared, so that a slightly low clearance hardly bends a path.
    tight = rules.tight * tight * tight
    way_m = np.hypot(x - poses[k - 1, 0], y - poses[k - 1, 1])
    turn = abs(yaw - poses[k - 1, 2])
    if way_m < _EPSILON:
        # A forbidden turn has an infinite cost, and infinity times zero would be NaN.
        return rules.turn_m * turn * (1.0 + tight) if turn > _EPSILON else 0.0
    cost = way_m * (cells.metre_cost[row, column] + tight) * (rules.backward if poses[k, 3] < 0 else rules.forward)
    if turn > _EPSILON:
        cost += rules.bend_m * turn
    if poses[k, 3] != poses[k - 1, 3]:
        cost += rules.switch_m
    return cost


# Replacement of parts of a path by cheaper ones.

# Most poses of a part: 400 m at 5 cm each; the least relative gain of a replacement; and the poses that are checked
# first.
ROOM = 8192
_LEAST_GAIN, _SPARSE = 1e-3, 12


class PathBuffer(NamedTuple):
    """A path that is changed in place.

    Attributes:
        poses: (M, 4), with room.
        steps: (M,) cost of the step to each pose.
        made: (2, ROOM, 4) the best part so far, and one that is tried.
    """

    poses: Any
    steps: Any
    made: Any


@kernel(error_model="numpy")
def buffered(cells: PlanCells, shape: Shape, rules: DriveRules, poses: Any) -> Any:
    """Return a `PathBuffer` of a path (N, 4)."""
    buffer = PathBuffer(np.empty((2 * len(poses) + ROOM, 4)), np.zeros(2 * len(poses) + ROOM), np.empty((2, ROOM, 4)))
    buffer.poses[: len(poses)] = poses
    for k in range(1, len(poses)):
        buffer.steps[k] = step_cost(cells, shape, rules, buffer.poses, k)
    return buffer


@kernel(error_model="numpy")
def shorten(cells: PlanCells, shape: Shape, rules: DriveRules, poses: Any) -> Any:
    """Return a path (M, 4) whose parts are curves, or turns and lines, where those are free and cheaper.

    It tries long parts of a path (N, 4) first, then shorter ones. Each begins halfway along the last.
    """
    buffer, count = buffered(cells, shape, rules, poses), len(poses)
    span = count - 1
    while span >= 4:
        at = 0
        while at + 2 < count:
            end = min(at + span, count - 1)
            length = _shorter(cells, shape, rules, buffer, at, end)
            if length > 0 and count - (end - at + 1) + length < len(buffer.poses):
                count = _replace(cells, shape, rules, buffer, (at, end, length, count))
                end = at + length - 1
            at += max((end - at) // 2, 1)
        span //= 2
    return buffer.poses[:count].copy()


@kernel(error_model="numpy")
def _replace(cells: PlanCells, shape: Shape, rules: DriveRules, buffer: PathBuffer, where: Any) -> Any:
    """Put the best part in place of poses `at` to `end` of a path; return its new number of poses."""
    at, end, length, count = where
    rest = count - end - 1
    buffer.poses[at + length : at + length + rest] = buffer.poses[end + 1 : count].copy()
    buffer.steps[at + length : at + length + rest] = buffer.steps[end + 1 : count].copy()
    buffer.poses[at : at + length] = buffer.made[0, :length]
    for k in range(at + 1, min(at + length + 1, at + length + rest)):
        buffer.steps[k] = step_cost(cells, shape, rules, buffer.poses, k)
    return at + length + rest


@kernel(error_model="numpy")
def _limit(buffer: PathBuffer, at: int, end: int) -> Any:
    """Return the cost below which a replacement of poses `at` to `end` is a gain."""
    before = 0.0
    for k in range(at + 1, end + 1):
        before += buffer.steps[k]
    return before * (1 - _LEAST_GAIN)


@kernel(error_model="numpy")
def _shorter(cells: PlanCells, shape: Shape, rules: DriveRules, buffer: PathBuffer, at: int, end: int) -> Any:
    """Write the cheapest connection of the ends of a part; return its number of poses, 0 if it gains nothing."""
    limit, length, path = _limit(buffer, at, end), 0, buffer.poses
    goes_back, way_m, turn = False, 0.0, 0.0
    for k in range(at + 1, end + 1):
        goes_back |= path[k, 3] < 0
        way_m += np.hypot(path[k, 0] - path[k - 1, 0], path[k, 1] - path[k - 1, 1])
        turn += abs(path[k, 2] - path[k - 1, 2])
    # A straight part is the best connection already.
    if turn < 1e-6 and way_m < 1e-6 + np.hypot(path[end, 0] - path[at, 0], path[end, 1] - path[at, 1]):
        return 0
    for way in range(WAYS):
        if way not in (TURN_AND_DRIVE, CURVE) and not goes_back:
            continue
        buffer.made[1, 0] = path[at]
        count = write_way(buffer.made[1], 1, path[end, :3].copy(), way, rules)
        if count < 2:
            continue
        # The next part begins in the direction of this one, or pays for the change.
        change = rules.switch_m if buffer.made[1, count - 1, 3] != path[end, 3] else 0.0
        cost = _cost_below(cells, shape, rules, buffer.made[1], count, limit - change) + change
        if cost < limit:
            limit, length = cost, count
            buffer.made[0, :count] = buffer.made[1, :count]
    return length


@kernel(error_model="numpy")
def _cost_below(cells: PlanCells, shape: Shape, rules: DriveRules, poses: Any, count: int, limit: float) -> Any:
    """Return the cost of poses after the first; infinite as soon as it must reach a limit, or one is not free."""
    total, x, y = 0.0, poses[count - 1, 0], poses[count - 1, 1]
    # Most long parts meet a wall, which few poses show.
    for k in range(_SPARSE, count, _SPARSE):
        if tightness(cells, shape, poses[k, 0], poses[k, 1], poses[k, 2]) == np.inf:
            return np.inf
    for k in range(1, count):
        total += step_cost(cells, shape, rules, poses, k)
        # A metre costs 1 at least.
        if total + np.hypot(x - poses[k, 0], y - poses[k, 1]) * (1 - 1e-9) >= limit:
            return np.inf
    return total


# Poses of a part whose middle is moved, about two metres, and how: metres to the left, radians.
_PIECE_POSES = 40
_ASIDE_M = (0.0, 0.02, -0.02, 0.05, -0.05)
_TURNED_RAD = (0.0, 0.04, -0.04)


@kernel(error_model="numpy")
def centre(cells: PlanCells, shape: Shape, rules: DriveRules, poses: Any, rounds: int) -> Any:
    """Return a path (M, 4), shifted and turned a little, part by part, where that is cheaper: away from obstacles.

    It tries other places for the middle of each part, joined to its ends by curves. Parts overlap by half.
    """
    buffer, count = buffered(cells, shape, rules, poses), len(poses)
    for _ in range(rounds):
        at, has_changed = 0, False
        while at + 4 < count:
            end = min(at + _PIECE_POSES, count - 1)
            length = _recentred(cells, shape, rules, buffer, at, end)
            if length > 0 and count - (end - at + 1) + length < len(buffer.poses):
                count, has_changed = _replace(cells, shape, rules, buffer, (at, end, length, count)), True
                end = at + length - 1
            at += max((end - at) // 2, 1)
        if not has_changed:
            break
    return buffer.poses[:count].copy()


@kernel(error_model="numpy")
def _recentred(cells: PlanCells, shape: Shape, rules: DriveRules, buffer: PathBuffer, at: int, end: int) -> Any:
    """Write a part with its middle moved; return its number of poses.

    0 if that gains nothing, if the part is nowhere tight, or if it changes its direction.
    """
    path, is_tight = buffer.poses, False
    for k in range(at, end + 1):
        if path[k, 3] != path[end, 3]:
            return 0
        is_tight = is_tight or tightness(cells, shape, path[k, 0], path[k, 1], path[k, 2]) > 0
    if not is_tight:
        return 0
    limit, length, middle = _limit(buffer, at, end), 0, path[at + (end + 1 - at) // 2]
    way, via = CURVE if path[end, 3] > 0 else CURVE_BACK, np.empty(3)
    c, s = np.cos(middle[2]), np.sin(middle[2])
    for aside_m in _ASIDE_M:
        for turn in _TURNED_RAD:
            if aside_m == 0.0 and turn == 0.0:
                continue
            via[0], via[1], via[2] = middle[0] - s * aside_m, middle[1] + c * aside_m, middle[2] + turn
            buffer.made[1, 0] = path[at]
            count = write_way(buffer.made[1], 1, via, way, rules)
            count = write_way(buffer.made[1], count, path[end, :3].copy(), way, rules) if count > 1 else 0
            if count < 2:
                continue
            cost = _cost_below(cells, shape, rules, buffer.made[1], count, limit)
            if cost < limit:
                limit, length = cost, count
                buffer.made[0, :count] = buffer.made[1, :count]
    return length
