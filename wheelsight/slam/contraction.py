"""Graphs without some of their keyframes: what edges said across one that is left out, they say between others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from wheelsight.geometry import se3
from wheelsight.keyframes import KeyframeId
from wheelsight.slam.graph import RelativePose


def without(edges: Sequence[RelativePose], left_out: Iterable[int]) -> tuple[RelativePose, ...]:
    """Edges of a graph without some keyframes, hanging together as before.

    All edges of a keyframe that is left out are carried over to one neighbour: that at the end of its surest edge, of
    odometry before a loop. Motions and covariances are composed, and what is composed of a loop is a loop. Between two
    keyframes at most one such edge is kept, the surest, and none where a measured one is surer: those that were carried
    over by one edge share its error, and several would count it as often.
    """
    graph = _Edges(edges)
    for number in left_out:
        graph.contract(number)
    return graph.all()


class _Edges:
    def __init__(self, edges: Sequence[RelativePose]) -> None:
        self._edges: dict[int, RelativePose] = dict(enumerate(edges))
        self._count, self._measured = len(edges), len(edges)
        self._of: defaultdict[int, set[int]] = defaultdict(set)
        for key, edge in self._edges.items():
            self._of[edge.first].add(key)
            self._of[edge.second].add(key)

    def all(self) -> tuple[RelativePose, ...]:
        """In the order in which they came."""
        return tuple(self._edges[key] for key in sorted(self._edges))

    def contract(self, number: int) -> None:
        """Carry the edges of a keyframe over to a neighbour."""
        of_it = [self._taken(key) for key in sorted(self._of[number])]
        if not of_it:
            return
        surest = min(of_it, key=lambda edge: (edge.is_loop, _volume(edge)))
        by = surest if surest.second == number else inverse(surest)
        for edge in of_it:
            onward = edge if edge.first == number else inverse(edge)
            if edge is not surest and onward.second != by.first:
                self._carry(composed(by, onward))

    def _carry(self, new: RelativePose) -> None:
        """Keep a composed edge, unless a surer one says how its ends lie to each other."""
        beside = sorted(self._of[new.first] & self._of[new.second])
        if any(_volume(self._edges[key]) <= _volume(new) for key in beside):
            return
        for key in beside:
            if key >= self._measured:
                self._taken(key)
        self._edges[self._count] = new
        for end in (new.first, new.second):
            self._of[end].add(self._count)
        self._count += 1

    def _taken(self, key: int) -> RelativePose:
        edge = self._edges.pop(key)
        for end in (edge.first, edge.second):
            self._of[end].discard(key)
        return edge


def composed(first: RelativePose, second: RelativePose) -> RelativePose:
    """From the one's first keyframe to the other's second, by the one between."""
    T, Ad = first.T_first_second, se3.adjoint(first.T_first_second)
    C = first.covariance + Ad @ second.covariance @ Ad.T
    T_both, is_loop = se3.nearest(T @ second.T_first_second), first.is_loop or second.is_loop
    return RelativePose(first.first, second.second, T_both, (C + C.T) / 2, is_loop)


def inverse(edge: RelativePose) -> RelativePose:
    """The same, seen from the other end."""
    T_second_first = se3.invert(edge.T_first_second)
    Ad = se3.adjoint(T_second_first)
    C = Ad @ edge.covariance @ Ad.T
    first, second = KeyframeId(edge.second), KeyframeId(edge.first)
    return RelativePose(first, second, T_second_first, (C + C.T) / 2, edge.is_loop)


def _volume(edge: RelativePose) -> float:
    """How unsure an edge is: the log of its covariance's volume, in which metres and radians need no exchange rate."""
    return float(np.linalg.slogdet(edge.covariance)[1])
