"""LoopCloser: decides which loops a pose graph keeps, by a chi-square gate, a Cauchy kernel and clusters of loops
that agree.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, chi_square, se3
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.slam.graph import PoseGraph, RelativePose, arrays_of, cauchy_loss, edge_errors, inverse_left_jacobian
from wheelsight.slam.settings import LoopSettings

# LoopCloser: which loops a pose graph keeps.
#
# A loop passes a chi-square gate by the joint marginal of its keyframes, and is then held by a Cauchy kernel. What
# was refused is reviewed from time to time: all loops under the kernel, and each refused cluster that agrees with
# itself, are hypotheses beside the present one; that wins by which all measurements are explained best, a cluster
# never by what it says itself. An honest odometry makes the gate right; where it states too little of its errors, the
# review finds out. Where two pieces hang together by loops alone, no odometry speaks for those that came first: there
# a refused cluster is heard as they are.


class Refusal(StrEnum):
    """Why the graph does not go by a loop."""

    CONTRADICTS = "it contradicts the rest"
    UNKNOWN = "the graph does not tell how far off it may be"


@dataclass(frozen=True, slots=True, eq=False)
class JudgedLoop:
    """A loop, and what became of it.

    Attributes:
        loop: as offered.
        is_kept: whether the graph goes by it.
        chi2: its squared error over what loop and poses leave open, when it was judged last; infinite where the graph
            did not tell what they leave open.
        limit: the largest chi2 that is kept.
        cluster: the number of the cluster of loops that it agrees with, as of the last review; -1 before one.
    """

    loop: RelativePose
    is_kept: bool
    chi2: float
    limit: float
    cluster: int = -1

    @property
    def refusal(self) -> Refusal | None:
        """Why it is not kept, or None."""
        if self.is_kept:
            return None
        return Refusal.CONTRADICTS if np.isfinite(self.chi2) else Refusal.UNKNOWN


@dataclass(frozen=True, slots=True, eq=False)
class LoopReport:
    """All loops, and how they were judged.

    Attributes:
        judged: in the order in which they were offered.
        reviews: how often all were judged anew.
        overturned: how often another hypothesis won.
    """

    judged: tuple[JudgedLoop, ...]
    reviews: int = 0
    overturned: int = 0

    @property
    def kept(self) -> tuple[RelativePose, ...]:
        """Loops that the graph goes by."""
        return tuple(one.loop for one in self.judged if one.is_kept)

    @property
    def refused(self) -> tuple[RelativePose, ...]:
        """Loops that contradict the rest, or that could not be judged."""
        return tuple(one.loop for one in self.judged if not one.is_kept)

    @property
    def refusals(self) -> dict[str, int]:
        """How many were refused, by reason."""
        return dict(Counter(str(one.refusal) for one in self.judged if one.refusal is not None))


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    """Loops that poses may go by.

    Attributes:
        own: the cluster that must not speak for it, or -1.
        kept: (L,) the loops.
        T_start: (N, 4, 4) whence the poses are sought.
    """

    own: int
    kept: BoolArray
    T_start: FloatArray


class LoopCloser:
    """Judges loops, and has the graph go by those that are kept.

    Args:
        graph: with a prior; the caller adds keyframes and odometry, and calls `update` if no loop is offered.
        settings: see `LoopSettings`.
    """

    def __init__(self, graph: PoseGraph, settings: LoopSettings | None = None) -> None:
        self.graph, self.settings = graph, settings or LoopSettings()
        self._loops: list[RelativePose] = []
        self._kept: list[bool] = []
        self._chi2: list[float] = []
        self._limit: list[float] = []
        self._clusters: IntArray = np.empty(0, np.int64)
        self._refused_since = self._reviews = self._overturned = 0

    def offer(self, loops: Sequence[RelativePose]) -> tuple[JudgedLoop, ...]:
        """Judge loops of keyframes that the graph holds; poses are those with the kept ones then."""
        before, limits = len(self._loops), limits_of(loops, self.settings.gate_probability)
        chi2 = [chi_squared(self.graph, loop) for loop in loops]
        kept = [found <= limit for found, limit in zip(chi2, limits, strict=True)]
        self.graph.add_edges([loop for loop, is_kept in zip(loops, kept, strict=True) if is_kept])
        self._take(loops, kept, chi2)
        self.graph.update()
        self._refused_since += kept.count(False)
        if self._refused_since >= self.settings.review_after:
            self.review()
        return self._judged(before)

    def join(self, loops: Sequence[RelativePose], T_start: FloatArray) -> None:
        """Go by loops that alone tell how two pieces lie to each other, and solve from poses (N, 4, 4) that fit them.

        They are judged like all others afterwards.
        """
        self.graph.add_edges(loops)
        self._take(loops, [True] * len(loops), [np.inf] * len(loops))
        self.graph.optimise(T_start)
        self._settle()

    def offer_all(self, loops: Sequence[RelativePose]) -> LoopReport:
        """Judge loops of a drive that is over, all together: none has to fit what was known before the others."""
        self._take(loops, [False] * len(loops), [np.inf] * len(loops))
        self.review()
        return self.report()

    def review(self) -> bool:
        """Judge all anew, and try other hypotheses; whether one has won."""
        self._refused_since, self._reviews = 0, self._reviews + 1
        T_start, settings = self.graph.poses, self.settings
        self._clusters = clusters_of(self._loops, T_start, settings.cluster_keyframes, settings.gate_probability)
        self._settle()
        T_now, kept_now = self.graph.poses, np.array(self._kept, bool)
        best, gain = (T_now, kept_now), settings.least_gain
        for one in self._hypotheses(kept_now, T_start):
            self._keep(one.kept)
            self.graph.optimise(one.T_start)
            T = self.graph.poses
            found = self._cost(T_now, one.own) - self._cost(T, one.own)
            if found > gain:
                best, gain = (T, one.kept), found
        has_won = best[0] is not T_now
        self._keep(best[1])
        self.graph.optimise(best[0])
        if has_won:
            self._overturned += 1
            self._settle()
        return has_won

    def report(self) -> LoopReport:
        """What became of all loops so far."""
        return LoopReport(self._judged(0), self._reviews, self._overturned)

    def _judged(self, since: int) -> tuple[JudgedLoop, ...]:
        """From one on; while driving all would be thousands at each keyframe."""
        clusters = [*self._clusters.tolist(), *[-1] * (len(self._loops) - len(self._clusters))]
        columns = (self._loops, self._kept, self._chi2, self._limit, clusters)
        return tuple(JudgedLoop(*row) for row in zip(*(column[since:] for column in columns), strict=True))

    def _take(self, loops: Sequence[RelativePose], kept: list[bool], chi2: list[float]) -> None:
        self._loops.extend(loops)
        self._kept.extend(kept)
        self._chi2.extend(chi2)
        self._limit.extend(limits_of(loops, self.settings.gate_probability))

    def _hypotheses(self, kept: BoolArray, T: FloatArray) -> Iterator[_Hypothesis]:
        """All loops, and each of the largest refused clusters (L,)."""
        yield _Hypothesis(-1, np.ones(len(kept), bool), T)
        if kept.all():
            return
        numbers, counts = np.unique(self._clusters[~kept], return_counts=True)
        largest = np.argsort(-counts, kind="stable")[: self.settings.most_appeals]
        for number in numbers[largest[counts[largest] >= self.settings.least_members]]:
            cluster = self._clusters == number
            yield self._in_place_of_others(cluster, kept, T) or _Hypothesis(int(number), kept | cluster, T)

    def _in_place_of_others(self, cluster: BoolArray, kept: BoolArray, T: FloatArray) -> _Hypothesis | None:
        """By a cluster (L,) where nothing but loops tells how its two ends lie; None where odometry tells."""
        first, second = (np.array([getattr(loop, end) for loop in self._loops]) for end in ("first", "second"))
        piece = self.graph.unheld(without=self._loops)
        ends = np.sort(np.column_stack([piece[first], piece[second]]), axis=1)
        older, newer = ends[np.flatnonzero(cluster)[0]]
        if older == newer:
            return None
        rivals = kept & (ends == (older, newer)).all(axis=1)
        middle = self._loops[np.flatnonzero(cluster)[np.count_nonzero(cluster) // 2]]
        return _Hypothesis(-1, (kept & ~rivals) | cluster, laid_by(middle, piece == newer, T))

    def _keep(self, kept: BoolArray) -> None:
        """Have the graph go by these loops (L,)."""
        gone = [loop for loop, was, now in zip(self._loops, self._kept, kept, strict=True) if was and not now]
        new = [loop for loop, was, now in zip(self._loops, self._kept, kept, strict=True) if now and not was]
        if gone:
            self.graph.remove_edges(gone)
        if new:
            self.graph.add_edges(new)
        self._kept = kept.tolist()

    def _settle(self) -> None:
        """Judge each loop by the graph's poses, and solve anew, until none changes sides."""
        limits = np.array(self._limit)
        for _ in range(self.settings.most_rounds):
            self._chi2 = [chi_squared(self.graph, loop) for loop in self._loops]
            kept = self._held_together(np.array(self._chi2) / limits)
            if (kept == np.array(self._kept)).all():
                return
            self._keep(kept)
            self.graph.optimise()

    def _held_together(self, ratio: FloatArray) -> BoolArray:
        """(L,) loops that pass the gate by chi-square over limit; and of others those that the graph cannot do without.

        Many that state too little of their errors fail all at once, and a piece that hangs by them alone would float:
        those that fit best stay, no more of them than it takes, and the others are judged by these.
        """
        kept = ratio <= 1
        going = [number for number in np.argsort(ratio, kind="stable") if self._kept[number] and not kept[number]]
        piece = self.graph.unheld(without=[self._loops[number] for number in going])
        for number in going if piece.any() else []:
            ends = sorted(piece[[self._loops[number].first, self._loops[number].second]])
            if ends[0] != ends[1]:
                kept[number], piece[piece == ends[1]] = True, ends[0]
        return kept

    def _stretches(self, first: IntArray) -> IntArray:
        """Over how many stretches of the way each cluster (C,) goes."""
        along = first // max(self.settings.cluster_keyframes, 1)
        return np.bincount(np.unique(np.column_stack([self._clusters, along]), axis=0)[:, 0])

    def _cost(self, T: FloatArray, own: int) -> float:
        """What poses leave unexplained of odometry and of all loops, kept or not, those of cluster `own` left out."""
        edges, loops = arrays_of([e for e in self.graph.edges if not e.is_loop]), arrays_of(self._loops)
        chi2, of_loops = (
            ((of.whitening @ edge_errors(T, of)[..., None])[..., 0] ** 2).sum(axis=-1) for of in (edges, loops)
        )
        loss = cauchy_loss(of_loops, self.settings.cauchy_scale)
        counts = np.bincount(self._clusters)
        means = np.bincount(self._clusters, loss) / counts
        votes = np.minimum(counts, self.settings.cluster_votes * self._stretches(loops.first))
        if own >= 0:
            votes[own] = 0
        return float(chi2.sum() / 2 + votes @ means)


def limits_of(loops: Sequence[RelativePose], gate_probability: float) -> list[float]:
    """The largest chi-square of each that passes."""
    return [chi_square.quantile(gate_probability, loop.freedom) for loop in loops]


def laid_by(loop: RelativePose, moving: BoolArray, T: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) with the keyframes (N,) that move, the piece at one end of a loop, where the loop has them."""
    X = T[loop.first] @ loop.T_first_second @ se3.invert(T[loop.second])
    laid = T.copy()
    laid[moving] = se3.nearest((X if moving[loop.second] else se3.invert(X)) @ T[moving])
    return laid


def chi_squared(graph: PoseGraph, loop: RelativePose) -> float:
    """A loop's squared error at the graph's poses over what these and its own covariance leave open.

    Infinite where the graph does not tell what they leave open: such a loop passes no gate.
    """
    open_by_poses = graph.joint(loop.first, loop.second)
    if open_by_poses is None:
        return np.inf
    ends = graph.poses[[loop.first, loop.second]]
    T_first_second = se3.invert(ends[0]) @ ends[1]
    r = se3.log(T_first_second @ se3.invert(loop.T_first_second))
    A = inverse_left_jacobian(r) @ se3.adjoint(se3.invert(ends[0]))
    J = np.concatenate([-A, A], axis=1)
    S = loop.covariance + J @ open_by_poses @ J.T
    S = (S + S.T) / 2
    return float(r @ np.linalg.solve(S, r)) if is_definite(S) else np.inf


# Loops that speak of one stretch and agree with each other: they are right or wrong together.


def clusters_of(loops: Sequence[RelativePose], T: FloatArray, nearby: int, probability: float) -> IntArray:
    """The number of the cluster (L,) of each loop, from 0.

    Args:
        loops: of keyframes.
        T: (N, 4, 4) their poses; only those of neighbours are compared, which odometry knows well.
        nearby: keyframes that lie between neighbours at either end, at most.
        probability: with which two loops that are true agree.
    """
    first, second = (np.array([getattr(loop, end) for loop in loops], np.int64) for end in ("first", "second"))
    order = np.argsort(first, kind="stable")
    ends = np.searchsorted(first[order], first[order] + nearby, side="right")
    pairs = [np.empty((0, 2), np.int64)]
    for here, end in enumerate(ends):
        later = order[here + 1 : end]
        later = later[np.abs(second[later] - second[order[here]]) <= nearby]
        pairs.append(np.column_stack([np.full(len(later), order[here]), later]))
    i, j = np.concatenate(pairs).T
    agree = _agree(loops, T, i, j, probability)
    joined = coo_array((np.ones(np.count_nonzero(agree)), (i[agree], j[agree])), shape=(len(loops), len(loops)))
    return np.asarray(connected_components(joined, directed=False)[1], np.int64)


def _agree(loops: Sequence[RelativePose], T: FloatArray, i: IntArray, j: IntArray, probability: float) -> BoolArray:
    """Whether loops i and j (P,) say the same of how two stretches lie."""
    if not len(i):
        return np.zeros(0, bool)
    first, second = (np.array([getattr(loop, end) for loop in loops], np.int64) for end in ("first", "second"))
    Z = np.array([loop.T_first_second for loop in loops])
    C = np.array([loop.covariance for loop in loops])
    # The stretches as j has them, expressed for the keyframes of i.
    before = se3.invert(T[first[i]]) @ T[first[j]]
    told = before @ Z[j] @ se3.invert(T[second[j]]) @ T[second[i]]
    Ad = se3.adjoint(before)
    r = se3.log(told @ se3.invert(Z[i]))
    S = C[i] + Ad @ C[j] @ np.swapaxes(Ad, 1, 2)
    squares = np.einsum("pi,pi->p", r, np.linalg.solve(S, r[..., None])[..., 0])
    freedom = np.minimum(*(np.array([loop.freedom for loop in loops])[of] for of in (i, j)))
    return np.asarray(squares <= [chi_square.quantile(probability, degrees) for degrees in freedom.tolist()])
