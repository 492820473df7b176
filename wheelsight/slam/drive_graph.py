"""DriveGraph: the pose graph of a drive. It may consist of pieces until a recognized place joins them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeAlias

import numpy as np

from wheelsight.core.geometry import FloatArray, IntArray, se3, so3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.graph import ANCHOR_SIGMA, Prior, RelativePose, along_floor, anchor, step_edge
from wheelsight.slam.loop_gate import LoopCloser, LoopReport, laid_by
from wheelsight.slam.place_recognition import KnownMap
from wheelsight.slam.settings import LoopSettings
from wheelsight.slam.solvers import new_pose_graph

# DriveGraph: the pose graph of a drive that may lie in pieces, until a place that is seen again joins them.


CameraMotion: TypeAlias = tuple[FloatArray, FloatArray]
"""A motion (4, 4), and the covariance (6, 6) of its left perturbation."""


@dataclass(frozen=True, slots=True, eq=False)
class LivedKeyframe:
    """A keyframe as odometry hands it over.

    Attributes:
        number: in the store; one after the other, from 0.
        stamp_s: of its frame, seconds.
        T_odom_keyframe: (4, 4).
        covariance: (6, 6) of the left perturbation (v, ω) of that; it grows along the way.
        begins: whether it is the first of a piece, of which nobody knows where it lies.
        T_before_now: (4, 4) from the one before, as the camera by itself has laid it in its map; None: as odom has it.
        motion: from the one before, (4, 4), and the covariance (6, 6) of its left perturbation, by all that is known
            now: where odometry has thought better of the way since, odom leaps, and the robot has not. None: as the
            poses in odom say.
        T_map_keyframe: (4, 4) where odometry has laid it in the map; it counts of a drive's first one, where somebody
            says where the drive begins: the robot may have moved before its camera saw anything. None: it has not.
        seen_from: how odometry has aligned it with an older keyframe than the one before, to which it had come back.
    """

    number: KeyframeId
    stamp_s: float
    T_odom_keyframe: FloatArray
    covariance: FloatArray
    begins: bool = False
    T_before_now: FloatArray | None = None
    motion: CameraMotion | None = None
    T_map_keyframe: FloatArray | None = None
    seen_from: RelativePose | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SeenAgain:
    """A keyframe of before to which odometry has come back, so that a frame there needs none of its own.

    Attributes:
        number, stamp_s: of the keyframe; of the frame, seconds.
        T_odom_keyframe: (4, 4) as that frame has it.
        covariance: (6, 6) of the left perturbation (v, ω) of the frame's pose in odom.
        of_motion: (6, 6) likewise of the frame's motion against the keyframe.
    """

    number: KeyframeId
    stamp_s: float
    T_odom_keyframe: FloatArray
    covariance: FloatArray
    of_motion: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PoseUpdate:
    """Where the first keyframes are by now.

    Attributes:
        T_map_keyframe: (K, 4, 4).
        piece: (K,) the number of the keyframe with which the piece begins that each is in; those that are joined have
            the older one's. Nobody knows how pieces lie to each other.
        loops: (L, 2) the keyframes that each loop that is kept ties together, the older one first.
    """

    T_map_keyframe: FloatArray
    piece: IntArray
    loops: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class KeyframePlace:
    """How surely a keyframe is placed in the map.

    Attributes:
        number: of the keyframe.
        T_odom_keyframe: (4, 4) as odometry handed it over.
        covariance_odom: (6, 6) of the left perturbation (v, ω) of that, as then.
        T_map_keyframe: (4, 4).
        covariance: (6, 6) of the left perturbation (v, ω) of that.
        newest: the keyframe that was the newest then.
    """

    number: KeyframeId
    T_odom_keyframe: FloatArray
    covariance_odom: FloatArray
    T_map_keyframe: FloatArray
    covariance: FloatArray
    newest: KeyframeId


class DriveGraph:
    """See the module.

    Args:
        settings: see `LoopSettings`.
        known: what an earlier drive has left; this one begins a piece of its own, unless somebody says where it begins.
    """

    def __init__(self, settings: LoopSettings, known: KnownMap | None = None) -> None:
        self._settings = settings
        self._graph = PieceGraph(settings)
        self._before: LivedKeyframe | None = None
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
        return self._graph.pieces

    @property
    def edges(self) -> tuple[RelativePose, ...]:
        """Of odometry and of loops that are kept."""
        return self._graph.edges

    def report(self) -> LoopReport:
        """What became of all loops so far."""
        return self._graph.report()

    def place(self, again: SeenAgain | None = None) -> KeyframePlace | None:
        """How surely the newest keyframe is placed in the map, or one that is seen `again` by what was seen of it.

        None while nobody knows where its piece lies.
        """
        newest = self._before
        told = newest if again is None else again
        if newest is None or told is None or self._graph.pieces[told.number] > 0:
            return None
        covariance = self._graph.covariance(told.number)
        if covariance is None:
            return None
        T_map_keyframe = self._graph.poses[told.number]
        if again is not None:
            Ad = se3.adjoint(T_map_keyframe)
            covariance = covariance + Ad @ again.of_motion @ Ad.T
        lived = told.T_odom_keyframe, told.covariance
        return KeyframePlace(told.number, *lived, T_map_keyframe, covariance, newest.number)

    def review(self) -> None:
        """Judge all loops anew."""
        self._graph.review()

    def add(self, keyframe: LivedKeyframe) -> None:
        """The next keyframe, as odometry has it from the one before."""
        before, self._before = self._before, keyframe
        if before is None:
            self._begin(keyframe)
            return
        if keyframe.begins:
            self._begin_piece(keyframe)
            return
        edge = self._edge(before, keyframe)
        self._graph.add(se3.nearest(self._graph.poses[-1] @ edge.T_first_second), int(self._graph.pieces[-1]))
        self._graph.add_edges([edge])
        laid = edge.T_first_second if keyframe.T_before_now is None else keyframe.T_before_now
        self._told = np.concatenate([self._told, self._told[-1:] @ laid])

    def _edge(self, before: LivedKeyframe, keyframe: LivedKeyframe) -> RelativePose:
        then, now = ((one.T_odom_keyframe, one.covariance) for one in (before, keyframe))
        edge = step_edge((before.number, keyframe.number), then, now, self._settings.matches)
        up = before.T_odom_keyframe[2, :3]
        return edge if keyframe.motion is None else along_floor(edge, keyframe.motion, up)

    @property
    def adrift(self) -> tuple[KeyframeId, ...]:
        """The keyframes of the last one's piece while nobody knows where that lies; else none."""
        pieces = self._graph.pieces
        alike = np.flatnonzero((pieces == pieces[-1]) & (pieces > 0))
        return tuple(KeyframeId(int(number)) for number in alike)

    def near(self, limit_m: float) -> tuple[KeyframeId, ...]:
        """Keyframes next to the last one, of its piece, the nearest first; turns by a radian count as 1.5 m."""
        poses, pieces = self._graph.poses, self._graph.pieces
        apart_m = se3.view_shift_m(se3.invert(poses[:-1]) @ poses[-1])
        apart_m[pieces[:-1] != pieces[-1]] = np.inf
        order = np.argsort(apart_m)
        return tuple(KeyframeId(int(number)) for number in order[: np.count_nonzero(apart_m < limit_m)])

    def _take(self, known: KnownMap) -> None:
        """Keyframes of an earlier drive, as nodes that are held where they are."""
        for prior in known.priors(ANCHOR_SIGMA, self._settings.known_sigma_m, self._settings.known_sigma_rad):
            self._graph.add(prior.T_map_keyframe, piece=0)
            self._graph.hold(prior)
        self._graph.add_edges(known.edges)

    def _begin(self, keyframe: LivedKeyframe) -> None:
        """The first keyframe of a drive: the map begins there; in a known one it is where somebody says, or nobody."""
        if keyframe.number and self._start is None:
            self._begin_piece(keyframe)
            return
        if self._start is None:
            self._hold(anchor(keyframe.number, keyframe.T_odom_keyframe), piece=0)
            return
        T_said, covariance = self._start
        T_map_keyframe = T_said if keyframe.T_map_keyframe is None else keyframe.T_map_keyframe
        self._hold(Prior(keyframe.number, T_map_keyframe, covariance), piece=0)

    def _begin_piece(self, keyframe: LivedKeyframe) -> None:
        """It is held where odom has it, until loops say where it lies."""
        start = anchor(keyframe.number, keyframe.T_odom_keyframe)
        self._hold(start, piece=keyframe.number, until_joined=True)

    def _hold(self, prior: Prior, piece: int, *, until_joined: bool = False) -> None:
        """A keyframe that is the first of its drive, or of its piece."""
        self._graph.add(prior.T_map_keyframe, piece)
        self._graph.hold(prior, until_joined=until_joined)
        self._told = np.concatenate([self._told, prior.T_map_keyframe[None]])

    def close(self, loops: Sequence[RelativePose]) -> PoseUpdate | None:
        """Judge loops; where keyframes are by now, if that moves any or joins pieces.

        Without any loop, too: beside wheels odom knows better than the camera how keyframes lie to each other.
        """
        has_joined = bool(loops) and self._graph.close(loops)
        shift_m = se3.view_shift_m(se3.invert(self._told) @ self._graph.poses).max()
        if not has_joined and shift_m <= self._settings.least_shift_m:
            return None
        self._told = self._graph.poses
        ends = [sorted((edge.first, edge.second)) for edge in self.edges if edge.is_loop]
        return PoseUpdate(self._told, self.pieces, np.array(ends, np.int64).reshape(-1, 2))


# PieceGraph: a pose graph that may lie in pieces, until places that are seen again join them.
#
# Within a piece edges say how far off a loop may be, and loops are judged by that. How two pieces lie to each other
# nothing says but the loops themselves: two of them, seen from apart, have to agree, and few may say otherwise. Only
# such count as know all directions: what one guesses along a corridor, where it looks alike, the next one guesses as
# well.


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
