"""LoopCloser: decides which loops a pose graph keeps, by a chi-square gate, a Cauchy kernel and consistent clusters."""

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

GATE_PROBABILITY = 0.999
"""Share of true loops that pass the chi-square gate, with correct covariances. Chosen."""
_REVIEW_AFTER = 10  # refused loops after which all loops are reviewed; chosen
_CLUSTER_KEYFRAMES = 5  # largest distance, in keyframes at either end, of neighbouring loops in a cluster; chosen
# Largest weight of loops that agree, in each stretch of _CLUSTER_KEYFRAMES: a repeated wrong match agrees with itself.
# Found on synthetic graphs: docs/decisions/loops-and-graph.md.
_CLUSTER_VOTES = 3.0
# Refused clusters that become hypotheses in a review: their least size, chosen, and their largest number, the largest
# first, which bounds its time.
_LEAST_MEMBERS, _MOST_HYPOTHESES = 3, 4
# Log-likelihood ratio by which another hypothesis must explain all measurements better: 150 to 1. Chosen.
_LEAST_GAIN = 5.0
_MOST_ROUNDS = 5  # largest number of rounds of gating and optimisation; chosen


class LoopRefusal(StrEnum):
    """Reason why the graph does not use a loop."""

    CONTRADICTS = "it contradicts the rest"
    UNKNOWN = "the graph cannot say how far off it may be"


@dataclass(frozen=True, slots=True, eq=False)
class LoopDecision:
    """A loop and the decision on it.

    Attributes:
        chi2: its latest squared Mahalanobis distance; infinite if the graph cannot compute the covariance.
        limit: largest chi2 that passes the gate.
        cluster: number of its cluster of consistent loops as of the last review; -1 before one.
    """

    loop: RelativePose
    is_kept: bool
    chi2: float
    limit: float
    cluster: int = -1

    @property
    def refusal(self) -> LoopRefusal | None:
        """Reason of the refusal, or None if it is kept."""
        if self.is_kept:
            return None
        return LoopRefusal.CONTRADICTS if np.isfinite(self.chi2) else LoopRefusal.UNKNOWN


@dataclass(frozen=True, slots=True, eq=False)
class LoopReport:
    """All loops and the decisions on them.

    Attributes:
        reviews: number of reviews of all loops.
        overturned: number of reviews in which another hypothesis replaced the current one.
    """

    decisions: tuple[LoopDecision, ...]
    reviews: int = 0
    overturned: int = 0

    @property
    def kept(self) -> tuple[RelativePose, ...]:
        """Loops that the graph uses."""
        return tuple(one.loop for one in self.decisions if one.is_kept)

    @property
    def refused(self) -> tuple[RelativePose, ...]:
        """Loops that contradict the others, or whose covariance is unknown."""
        return tuple(one.loop for one in self.decisions if not one.is_kept)

    @property
    def refusals(self) -> dict[str, int]:
        """Number of refused loops by reason."""
        return dict(Counter(str(one.refusal) for one in self.decisions if one.refusal is not None))


class LoopCloser:
    """Decides which loops a pose graph keeps.

    A loop passes a chi-square gate by the joint marginal of its keyframes, and then has a Cauchy kernel. After some
    refusals, a review compares alternative hypotheses: all loops under the kernel, and each consistent cluster of
    refused loops in addition to the current ones. The hypothesis that best explains all measurements wins; a cluster
    does not vote on itself. The gate assumes honest odometry covariances, and the review detects covariances that are
    too small. Two pieces that are connected by loops alone have no odometry between them. There, a refused cluster is
    tried in place of the kept loops.

    Args:
        graph: graph with a prior. The caller adds keyframes and odometry, and calls `update` if there are no loops.
    """

    def __init__(self, graph: PoseGraph) -> None:
        self.graph = graph
        self._loops: list[RelativePose] = []
        self._kept: list[bool] = []
        self._chi2: list[float] = []
        self._limit: list[float] = []
        self._clusters: IntArray = np.empty(0, np.int64)
        self._refused_since = self._reviews = self._overturned = 0

    def report(self) -> LoopReport:
        """Return the decisions on all loops so far."""
        return LoopReport(self._decisions(0), self._reviews, self._overturned)

    def _decisions(self, since: int) -> tuple[LoopDecision, ...]:
        """Return the decisions from one loop on; while driving, all would be thousands at each keyframe."""
        clusters = [*self._clusters.tolist(), *[-1] * (len(self._loops) - len(self._clusters))]
        columns = (self._loops, self._kept, self._chi2, self._limit, clusters)
        return tuple(LoopDecision(*row) for row in zip(*(column[since:] for column in columns), strict=True))

    def offer(self, loops: Sequence[RelativePose]) -> tuple[LoopDecision, ...]:
        """Check loops between keyframes of the graph, and return the decisions.

        The loops that pass are added to the graph, and its poses are updated.
        """
        before, limits = len(self._loops), _limits_of(loops)
        chi2 = [chi_squared(self.graph, loop) for loop in loops]
        kept = [found <= limit for found, limit in zip(chi2, limits, strict=True)]
        self.graph.add_edges([loop for loop, is_kept in zip(loops, kept, strict=True) if is_kept])
        self._record(loops, kept, chi2)
        self.graph.update()
        self._refused_since += kept.count(False)
        if self._refused_since >= _REVIEW_AFTER:
            self.review()
        return self._decisions(before)

    def offer_all(self, loops: Sequence[RelativePose]) -> LoopReport:
        """Check all loops of a finished drive together, so that their order does not matter."""
        self._record(loops, [False] * len(loops), [np.inf] * len(loops))
        self.review()
        return self.report()

    def join(self, loops: Sequence[RelativePose], T_start: FloatArray) -> None:
        """Use loops that alone connect two pieces, and optimise from poses (N, 4, 4) that fit them.

        Afterwards the gate checks them like all others.
        """
        self.graph.add_edges(loops)
        self._record(loops, [True] * len(loops), [np.inf] * len(loops))
        self.graph.optimise(T_start)
        self._settle()

    def review(self) -> bool:
        """Check all loops again and compare the alternative hypotheses; return whether one replaced the current one."""
        self._refused_since, self._reviews = 0, self._reviews + 1
        T_start = self.graph.poses
        self._clusters = clusters_of(self._loops, T_start, _CLUSTER_KEYFRAMES, GATE_PROBABILITY)
        self._settle()
        T_now, kept_now = self.graph.poses, np.array(self._kept, bool)
        best, gain = (T_now, kept_now), _LEAST_GAIN
        for own, kept, T_begin in self._hypotheses(kept_now, T_start):
            self._keep(kept)
            self.graph.optimise(T_begin)
            T = self.graph.poses
            found = self._cost(T_now, own) - self._cost(T, own)
            if found > gain:
                best, gain = (T, kept), found
        has_won = best[0] is not T_now
        self._keep(best[1])
        self.graph.optimise(best[0])
        if has_won:
            self._overturned += 1
            self._settle()
        return has_won

    def _hypotheses(self, kept: BoolArray, T: FloatArray) -> Iterator[tuple[int, BoolArray, FloatArray]]:
        """Yield alternatives to the kept loops (L,): all loops, and each of the largest refused clusters.

        Each is the cluster without a vote on it, or -1; the loops (L,) to use; and initial poses (N, 4, 4).
        """
        yield -1, np.ones(len(kept), bool), T
        if kept.all():
            return
        numbers, counts = np.unique(self._clusters[~kept], return_counts=True)
        largest = np.argsort(-counts, kind="stable")[:_MOST_HYPOTHESES]
        for number in numbers[largest[counts[largest] >= _LEAST_MEMBERS]]:
            cluster = self._clusters == number
            first, second = (np.array([getattr(loop, end) for loop in self._loops]) for end in ("first", "second"))
            piece = self.graph.unanchored(without=self._loops)
            ends = np.sort(np.column_stack([piece[first], piece[second]]), axis=1)
            older, newer = ends[np.flatnonzero(cluster)[0]]
            if older == newer:  # odometry connects both ends of the cluster
                yield int(number), kept | cluster, T
                continue
            # The cluster replaces the kept loops between two pieces.
            alternatives = kept & (ends == (older, newer)).all(axis=1)
            middle = self._loops[np.flatnonzero(cluster)[np.count_nonzero(cluster) // 2]]
            yield -1, (kept & ~alternatives) | cluster, aligned_by(middle, piece == newer, T)

    def _cost(self, T: FloatArray, own: int) -> float:
        """Return the negative log-likelihood of odometry and all loops at poses (N, 4, 4), except of cluster `own`."""
        edges, loops = arrays_of([e for e in self.graph.edges if not e.is_loop]), arrays_of(self._loops)
        chi2, of_loops = (
            ((of.whitening @ edge_errors(T, of)[..., None])[..., 0] ** 2).sum(axis=-1) for of in (edges, loops)
        )
        loss = cauchy_loss(of_loops)
        counts = np.bincount(self._clusters)
        means = np.bincount(self._clusters, loss) / counts
        # A cluster has a limited number of votes for each stretch of keyframes that it covers.
        along = loops.first // _CLUSTER_KEYFRAMES
        stretches = np.bincount(np.unique(np.column_stack([self._clusters, along]), axis=0)[:, 0])
        votes = np.minimum(counts, _CLUSTER_VOTES * stretches)
        if own >= 0:
            votes[own] = 0
        return float(chi2.sum() / 2 + votes @ means)

    def _record(self, loops: Sequence[RelativePose], kept: list[bool], chi2: list[float]) -> None:
        """Store loops with their decisions."""
        self._loops.extend(loops)
        self._kept.extend(kept)
        self._chi2.extend(chi2)
        self._limit.extend(_limits_of(loops))

    def _keep(self, kept: BoolArray) -> None:
        """Make the graph use exactly these loops (L,)."""
        gone = [loop for loop, was, now in zip(self._loops, self._kept, kept, strict=True) if was and not now]
        new = [loop for loop, was, now in zip(self._loops, self._kept, kept, strict=True) if now and not was]
        if gone:
            self.graph.remove_edges(gone)
        if new:
            self.graph.add_edges(new)
        self._kept = kept.tolist()

    def _settle(self) -> None:
        """Gate each loop by the graph's poses and optimise, until no decision changes."""
        limits = np.array(self._limit)
        for _ in range(_MOST_ROUNDS):
            self._chi2 = [chi_squared(self.graph, loop) for loop in self._loops]
            ratio = np.array(self._chi2) / limits
            kept = ratio <= 1
            # Loops with covariances that are too small may fail all at once, and disconnect a piece that has no other
            # edges. The best of them stay, as few as connect the piece, and the others are checked against these.
            order = np.argsort(ratio, kind="stable")
            going = [number for number in order if self._kept[number] and not kept[number]]
            piece = self.graph.unanchored(without=[self._loops[number] for number in going])
            for number in going if piece.any() else []:
                ends = sorted(piece[[self._loops[number].first, self._loops[number].second]])
                if ends[0] != ends[1]:
                    kept[number], piece[piece == ends[1]] = True, ends[0]
            if (kept == np.array(self._kept)).all():
                return
            self._keep(kept)
            self.graph.optimise()


def _limits_of(loops: Sequence[RelativePose]) -> list[float]:
    """Return the chi-square limit of each loop."""
    return [chi_square.quantile(GATE_PROBABILITY, loop.freedom) for loop in loops]


def aligned_by(loop: RelativePose, moving: BoolArray, T: FloatArray) -> FloatArray:
    """Return poses (N, 4, 4) with one piece, the keyframes `moving` (N,), moved so that a loop's error is zero."""
    X = T[loop.first] @ loop.T_first_second @ se3.invert(T[loop.second])
    aligned = T.copy()
    aligned[moving] = se3.nearest((X if moving[loop.second] else se3.invert(X)) @ T[moving])
    return aligned


def chi_squared(graph: PoseGraph, loop: RelativePose) -> float:
    """Return the squared Mahalanobis distance of a loop from the graph's poses.

    Infinite if the graph cannot compute their joint covariance: such a loop fails the gate.
    """
    joint = graph.joint(loop.first, loop.second)
    if joint is None:
        return np.inf
    ends = graph.poses[[loop.first, loop.second]]
    T_first_second = se3.invert(ends[0]) @ ends[1]
    r = se3.log(T_first_second @ se3.invert(loop.T_first_second))
    A = inverse_left_jacobian(r) @ se3.adjoint(se3.invert(ends[0]))
    J = np.concatenate([-A, A], axis=1)
    S = loop.covariance + J @ joint @ J.T
    S = (S + S.T) / 2
    return float(r @ np.linalg.solve(S, r)) if is_definite(S) else np.inf


def clusters_of(loops: Sequence[RelativePose], T: FloatArray, nearby: int, probability: float) -> IntArray:
    """Return the cluster number (L,) of each loop, from 0.

    A cluster links neighbouring loops that agree on the relative pose of their two stretches of keyframes.

    Args:
        T: (N, 4, 4) keyframe poses. Only those of neighbours are compared, which odometry knows well.
        nearby: largest distance of neighbours at either end, in keyframes.
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
    if not len(i):
        return np.arange(len(loops))
    Z = np.array([loop.T_first_second for loop in loops])
    C = np.array([loop.covariance for loop in loops])
    # The relative pose by j, expressed in the keyframes of i.
    before = se3.invert(T[first[i]]) @ T[first[j]]
    predicted = before @ Z[j] @ se3.invert(T[second[j]]) @ T[second[i]]
    Ad = se3.adjoint(before)
    r = se3.log(predicted @ se3.invert(Z[i]))
    S = C[i] + Ad @ C[j] @ np.swapaxes(Ad, 1, 2)
    squares = np.einsum("pi,pi->p", r, np.linalg.solve(S, r[..., None])[..., 0])
    freedom = np.minimum(*(np.array([loop.freedom for loop in loops])[of] for of in (i, j)))
    agree = squares <= [chi_square.quantile(probability, degrees) for degrees in freedom.tolist()]
    joined = coo_array((np.ones(np.count_nonzero(agree)), (i[agree], j[agree])), shape=(len(loops), len(loops)))
    return np.asarray(connected_components(joined, directed=False)[1], np.int64)
