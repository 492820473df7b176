"""PieceGraph: a pose graph that may lie in pieces, until places that are seen again join them.

Within a piece edges say how far off a loop may be, and loops are judged by that. How two pieces lie to each other
nothing says but the loops themselves: two of them, seen from apart, have to agree, and few may say otherwise. Only such
count as know all directions: what one guesses along a corridor, where it looks alike, the next one guesses as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from wheelsight.geometry import FloatArray, IntArray, se3, so3
from wheelsight.keyframes import KeyframeId
from wheelsight.slam.graph import Prior, RelativePose
from wheelsight.slam.loops import LoopCloser, LoopReport, laid_by
from wheelsight.slam.pose_graph import new_pose_graph
from wheelsight.slam.settings import LoopSettings


class PieceGraph:
    """See the module.

    Args:
        settings: see `LoopSettings`.
    """

    def __init__(self, settings: LoopSettings) -> None:
        self._settings = settings
        self._graph = new_pose_graph(settings.cauchy_scale)
        self._closer = LoopCloser(self._graph, settings)
        self._piece: list[int] = []
        self._held: dict[int, Prior] = {}  # what holds each piece that is not joined
        self._across: list[RelativePose] = []  # loops between pieces that no other one agrees with yet

    @property
    def poses(self) -> FloatArray:
        """T_map_keyframe (N, 4, 4)."""
        return self._graph.poses

    @property
    def pieces(self) -> IntArray:
        """(N,) the piece that each keyframe is in; of pieces that are joined the lower number."""
        return np.array(self._piece, np.int64)

    @property
    def edges(self) -> tuple[RelativePose, ...]:
        """Those that were added, and loops that are kept."""
        return self._graph.edges

    def report(self) -> LoopReport:
        """What became of all loops so far."""
        return self._closer.report()

    def review(self) -> None:
        """Judge all loops anew."""
        if self._closer.report().judged:
            self._closer.review()

    def add(self, T_map_keyframe: FloatArray, piece: int) -> None:
        """The next keyframe, about where it is (4, 4), in a piece."""
        self._graph.add(T_map_keyframe)
        self._piece.append(piece)

    def add_edges(self, edges: Sequence[RelativePose]) -> None:
        """Within pieces."""
        self._graph.add_edges(edges)

    def hold(self, prior: Prior, *, until_joined: bool = False) -> None:
        """Hold a keyframe where it is, or only until loops say where its piece lies."""
        self._graph.add_prior(prior)
        if until_joined:
            self._held[self._piece[prior.keyframe]] = prior

    def covariance(self, keyframe: KeyframeId) -> FloatArray | None:
        """(6, 6) of the left perturbation (v, ω) of a keyframe's pose in its piece; None where no digits tell it."""
        return self._graph.marginal(keyframe)

    def close(self, loops: Sequence[RelativePose]) -> bool:
        """Judge loops; whether they have joined two pieces, of which the one of the higher number moves."""
        self._graph.update()
        within = [loop for loop in loops if self._piece[loop.first] == self._piece[loop.second]]
        if within:
            self._closer.offer(within)
        across = [loop for loop in loops if self._piece[loop.first] != self._piece[loop.second]]
        self._across += [loop for loop in across if self._knows_all(loop)]
        self._across = self._across[-self._settings.most_across :]
        return self._join()

    def _join(self) -> bool:
        """Join two pieces by loops that agree, where there are some and few speak against them."""
        T = self._graph.poses
        for one, other in combinations(self._across, 2):
            if self._ends(one) != self._ends(other) or not self._bear_out(one, other, T):
                continue
            alike = [loop for loop in self._across if self._ends(loop) == self._ends(one)]
            agreeing = [loop for loop in alike if self._agree(one, loop, T)]
            if len(agreeing) >= self._settings.join_majority * (len(alike) - len(agreeing)):
                self._join_by(one, agreeing, T)
                return True
        return False

    def _join_by(self, one: RelativePose, agreeing: Sequence[RelativePose], T: FloatArray) -> None:
        """Lay the newer piece where a loop has it, and solve both together from there."""
        first, second = self._ends(one)
        older, newer = min(first, second), max(first, second)
        self._graph.remove_prior(self._held.pop(newer))
        self._closer.join(agreeing, laid_by(one, self.pieces == newer, T))
        self._piece = [older if piece == newer else piece for piece in self._piece]
        self._across = [loop for loop in self._across if len(set(self._ends(loop))) > 1]

    def _bear_out(self, one: RelativePose, other: RelativePose, T: FloatArray) -> bool:
        """Whether two loops agree that were seen from apart: what takes one view for another does so again beside."""
        apart_m = float(se3.view_shift_m(se3.invert(T[one.second]) @ T[other.second]))
        return apart_m >= self._settings.join_apart_m and self._agree(one, other, T)

    def _ends(self, loop: RelativePose) -> tuple[int, int]:
        return self._piece[loop.first], self._piece[loop.second]

    def _knows_all(self, loop: RelativePose) -> bool:
        """Whether a loop is as sure in each direction as two of them have to agree."""
        variances = [np.linalg.eigvalsh(part)[-1] for part in (loop.covariance[:3, :3], loop.covariance[3:, 3:])]
        return bool(variances[0] <= self._settings.agree_m**2 and variances[1] <= self._settings.agree_rad**2)

    def _agree(self, one: RelativePose, other: RelativePose, T: FloatArray) -> bool:
        """Whether two loops put the same piece to the same place, as seen where the other one's keyframe is."""
        X = T[one.first] @ one.T_first_second @ se3.invert(T[one.second])
        D = se3.invert(X @ T[other.second]) @ T[other.first] @ other.T_first_second
        is_near = np.linalg.norm(D[:3, 3]) <= self._settings.agree_m
        return bool(is_near and so3.angle(D[:3, :3]) <= self._settings.agree_rad)
