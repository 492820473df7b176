"""A tour of views: which views show the unseen floor together, and the order in which a robot sees most of it soon."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from itertools import pairwise, permutations

import numpy as np

from wheelsight.core.geometry import BoolArray, FloatArray, IntArray

# Views of a tour: more take longer to choose, and change the first one in few cases.
VIEWS = 8
# Up to as many views, all orders are compared.
_ALL_ORDERS = 5


def covering_views(
    seen_by: Callable[[FloatArray, BoolArray], IntArray],
    is_wanted: BoolArray,
    views: FloatArray,
    most: FloatArray,
    cost: FloatArray,
    least: float,
    first: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return (K, 3) views that show wanted cells together, at most `VIEWS`, and (K,) how many each adds.

    Each next view adds the most cells for its cost. What a view adds only falls while others are chosen, so a view is
    counted again only when it would be next (Minoux 1978, accelerated greedy).

    Args:
        seen_by: returns (N, 2) wanted cells that a view (3,) shows, given the wanted ones (H, W).
        is_wanted: (H, W) cells to be seen.
        views: (V, 3) views to choose from.
        most: (V,) upper bounds of the number of cells that they show.
        cost: (V,) positive costs.
        least: number of cells below which a view is not worth its while.
        first: (3,) a view that is chosen in any case.
    """
    left, chosen, added = is_wanted.copy(), list[FloatArray](), list[int]()

    def choose(view: FloatArray, cells: IntArray) -> None:
        chosen.append(view)
        added.append(len(cells))
        left[cells[:, 0], cells[:, 1]] = False

    if first is not None:
        choose(first, seen_by(first, left))
    waiting = [(-value, k) for k, value in enumerate((most / cost).tolist())]
    heapq.heapify(waiting)
    while waiting and len(chosen) < VIEWS:
        _, k = heapq.heappop(waiting)
        cells = seen_by(views[k], left)
        value = len(cells) / cost[k]
        if len(cells) < least:
            continue
        if waiting and value < -waiting[0][0]:
            heapq.heappush(waiting, (-value, k))
        else:
            choose(views[k], cells)
    return np.array(chosen, float).reshape(-1, 3), np.array(added, float)


def best_order(costs: FloatArray, gains: FloatArray, first: int | None = None) -> tuple[list[int], float]:
    """Return the order of views with the least cost, and that cost.

    The cost is that of the whole way, and of the mean time after which a cell is seen: the shortest way alone puts
    large, far areas off.

    Args:
        costs: (1 + K, 1 + K) from place to place; place 0 is the robot's, the others are the views'.
        gains: (K,) number of cells that each view adds.
        first: a view to begin with.

    Returns:
        Numbers of views, from 0.
    """
    count = len(gains)
    share = [float(gain) for gain in gains / max(gains.sum(), 1e-9)]
    by_place = costs.tolist()

    def cost(order: list[int]) -> float:
        total = mean = 0.0
        for before, after in pairwise([-1, *order]):
            total += by_place[before + 1][after + 1]
            mean += total * share[after]
        return total + mean

    begin = [] if first is None else [first]
    rest = [k for k in range(count) if k != first]
    if len(rest) <= _ALL_ORDERS:
        best = min(([*begin, *order] for order in permutations(rest)), key=cost)
        return best, cost(best)
    # Cheapest insertion, then reversals and shifts as long as they gain anything.
    order, fixed = begin, len(begin)
    for k in rest:
        order = min(([*order[:at], k, *order[at:]] for at in range(fixed, len(order) + 1)), key=cost)
    while True:
        spans = [(a, b) for a in range(fixed, count) for b in range(a + 1, count + 1)]
        changed = [order[:a] + order[a:b][::-1] + order[b:] for a, b in spans]
        changed += [order[:a] + order[a + 1 : b] + [order[a]] + order[b:] for a, b in spans]
        changed += [order[:a] + [order[b - 1]] + order[a : b - 1] + order[b:] for a, b in spans]
        better = min(changed, key=cost)
        if cost(better) >= cost(order) - 1e-9:
            return order, cost(order)
        order = better
