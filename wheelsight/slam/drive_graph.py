"""DriveGraph: the pose graph of a drive that may lie in pieces, until a place that is seen again joins them.

Within a piece odometry says how far off a loop may be, and loops are judged by that. How two pieces lie to each other
nothing says but the loops themselves: two of them, of different keyframes, have to agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from wheelsight.geometry import FloatArray, IntArray, se3, so3
from wheelsight.keyframes import KeyframeId
from wheelsight.slam.graph import Prior, RelativePose
from wheelsight.slam.known import KnownMap
from wheelsight.slam.loops import LoopCloser, LoopReport
from wheelsight.slam.pose_graph import new_pose_graph
from wheelsight.slam.settings import LoopSettings
from wheelsight.slam.steps import ANCHOR_SIGMA, anchor, step_edge


@dataclass(frozen=True, slots=True, eq=False)
class LivedKeyframe:
    """A keyframe as odometry hands it over.

    Attributes:
        number: in the store; one after the other, from 0.
        stamp_s: of its frame, seconds.
        T_odom_keyframe: (4, 4).
        covariance: (6, 6) of the left perturbation (v, ω) of that; it grows along the way.
        begins: whether it is the first of a piece, of which nobody knows where it lies.
    """

    number: KeyframeId
    stamp_s: float
    T_odom_keyframe: FloatArray
    covariance: FloatArray
    begins: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class PoseUpdate:
    """Where the first keyframes are by now.

    Attributes:
        T_map_keyframe: (K, 4, 4).
        piece: (K,) the number of the keyframe with which the piece begins that each is in; those that are joined have
            the older one's. Nobody knows how pieces lie to each other.
    """

    T_map_keyframe: FloatArray
    piece: IntArray


class DriveGraph:
    """See the module.

    Args:
        settings: see `LoopSettings`.
        known: what an earlier drive has left; this one begins a piece of its own, unless somebody says where it begins.
    """

    def __init__(self, settings: LoopSettings, known: KnownMap | None = None) -> None:
        self._settings = settings
        self._graph = new_pose_graph(settings.cauchy_scale)
        self._closer = LoopCloser(self._graph, settings)
        self._piece: list[int] = []
        self._before: LivedKeyframe | None = None
        self._held: dict[int, Prior] = {}  # what holds each piece that is not joined
        self._across: list[RelativePose] = []  # loops between pieces that no other one agrees with yet
        self._start = None if known is None else known.start
        if known is not None:
            self._take(known)
        self._told: FloatArray = self._graph.poses  # where odometry has keyframes, by what it was told so far

    @property
    def poses(self) -> FloatArray:
        """T_map_keyframe (N, 4, 4)."""
        return self._graph.poses

    @property
    def pieces(self) -> IntArray:
        """(N,) as `PoseUpdate.piece`."""
        return np.array(self._piece, np.int64)

    @property
    def edges(self) -> tuple[RelativePose, ...]:
        """Of odometry and of loops that are kept."""
        return self._graph.edges

    def report(self) -> LoopReport:
        """What became of all loops so far."""
        return self._closer.report()

    def review(self) -> None:
        """Judge all loops anew."""
        if self._closer.report().judged:
            self._closer.review()

    def add(self, keyframe: LivedKeyframe) -> None:
        """The next keyframe, as odometry has it from the one before."""
        before, self._before = self._before, keyframe
        if before is None:
            self._begin(keyframe)
            return
        if keyframe.begins:
            self._begin_piece(keyframe)
            return
        then, now = ((one.T_odom_keyframe, one.covariance) for one in (before, keyframe))
        edge = step_edge(keyframe.number, then, now, self._settings.matches)
        self._graph.add(se3.nearest(self._graph.poses[-1] @ edge.T_first_second))
        self._graph.add_edges([edge])
        self._told = np.concatenate([self._told, self._told[-1:] @ edge.T_first_second])
        self._piece.append(self._piece[-1])

    def _take(self, known: KnownMap) -> None:
        """Keyframes of an earlier drive, as nodes that are held where they are."""
        priors = known.priors(ANCHOR_SIGMA, self._settings.known_sigma_m, self._settings.known_sigma_rad)
        for prior in priors:
            self._graph.add(prior.T_map_keyframe)
            self._graph.add_prior(prior)
        self._graph.add_edges(known.edges)
        self._piece = [0] * len(priors)

    def _begin(self, keyframe: LivedKeyframe) -> None:
        """The first keyframe of a drive: the map begins there; in a known one it is where somebody says, or nobody."""
        if keyframe.number and self._start is None:
            self._begin_piece(keyframe)
        else:
            start = anchor(keyframe.number, keyframe.T_odom_keyframe)
            self._hold(start if self._start is None else Prior(keyframe.number, *self._start), piece=0)

    def _begin_piece(self, keyframe: LivedKeyframe) -> None:
        """It is held where odom has it, until loops say where it lies."""
        self._held[keyframe.number] = anchor(keyframe.number, keyframe.T_odom_keyframe)
        self._hold(self._held[keyframe.number], piece=keyframe.number)

    def _hold(self, prior: Prior, piece: int) -> None:
        """A keyframe that is the first of its drive, or of its piece."""
        self._graph.add(prior.T_map_keyframe)
        self._graph.add_prior(prior)
        self._piece.append(piece)
        self._told = np.concatenate([self._told, prior.T_map_keyframe[None]])

    def close(self, loops: Sequence[RelativePose]) -> PoseUpdate | None:
        """Judge loops; where keyframes are by now, if that moves any or joins pieces."""
        if not loops:
            return None
        self._graph.update()
        within = [loop for loop in loops if self._piece[loop.first] == self._piece[loop.second]]
        if within:
            self._closer.offer(within)
        self._across += [loop for loop in loops if self._piece[loop.first] != self._piece[loop.second]]
        has_joined = self._join()
        shift_m = se3.view_shift_m(se3.invert(self._told) @ self._graph.poses).max()
        if not has_joined and shift_m <= self._settings.least_shift_m:
            return None
        self._told = self._graph.poses
        return PoseUpdate(self._told, self.pieces)

    def _join(self) -> bool:
        """Join two pieces by loops that agree, where there are some."""
        T = self._graph.poses
        for one, other in combinations(self._across, 2):
            ends = {self._ends(one), self._ends(other)}
            if len(ends) > 1 or one.second == other.second or not self._agree(one, other, T):
                continue
            ((first, second),) = ends
            X = T[one.first] @ one.T_first_second @ se3.invert(T[one.second])
            older, newer = min(first, second), max(first, second)
            moving = self.pieces == newer
            T[moving] = se3.nearest((X if newer == second else se3.invert(X)) @ T[moving])
            self._graph.remove_prior(self._held.pop(newer))
            joining = [loop for loop in self._across if self._ends(loop) == (first, second)]
            self._closer.join([loop for loop in joining if self._agree(one, loop, T, joined=True)], T)
            self._piece = [older if piece == newer else piece for piece in self._piece]
            self._across = [loop for loop in self._across if len(set(self._ends(loop))) > 1]
            return True
        return False

    def _ends(self, loop: RelativePose) -> tuple[int, int]:
        return self._piece[loop.first], self._piece[loop.second]

    def _agree(self, one: RelativePose, other: RelativePose, T: FloatArray, *, joined: bool = False) -> bool:
        """Whether two loops put the same piece to the same place, as seen where the other one's keyframe is.

        `joined`: whether T (N, 4, 4) has the pieces together already.
        """
        X = np.eye(4) if joined else T[one.first] @ one.T_first_second @ se3.invert(T[one.second])
        D = se3.invert(X @ T[other.second]) @ T[other.first] @ other.T_first_second
        is_near = np.linalg.norm(D[:3, 3]) <= self._settings.agree_m
        return bool(is_near and so3.angle(D[:3, :3]) <= self._settings.agree_rad)
