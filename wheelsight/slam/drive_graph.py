"""DriveGraph: the pose graph of a drive. It may consist of submaps until a recognized place joins them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeAlias

import numpy as np

from wheelsight.core.geometry import FloatArray, IntArray, se3, so3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.graph import ANCHOR_SIGMA, Prior, RelativePose, along_floor, anchor, step_edge
from wheelsight.slam.loop_gate import LoopCloser, LoopReport, aligned_by
from wheelsight.slam.place_recognition import KnownMap
from wheelsight.slam.solvers import new_pose_graph

# Standard deviations of keyframe positions and rotations in a map that is extended. Chosen.
_KNOWN_SIGMA_M, _KNOWN_SIGMA_RAD = 0.3, 0.1
_LEAST_SHIFT_M = 0.002  # least motion of keyframes that is reported; a turn by a radian counts as 1.5 m; chosen
# Largest difference of two loops that join submaps of a map, and of their standard deviations. Chosen.
_AGREE_M, _AGREE_RAD = 0.3, 0.1
JOIN_APART_M = 0.5
"""Least distance of their viewpoints, with a turn by a radian as 1.5 m: a repeated wrong match agrees with itself."""
_JOIN_MAJORITY = 2.0  # number of loops that must agree for each loop between the submaps that contradicts; chosen
_MOST_ACROSS = 60  # newest loops between submaps that are kept: comparing more takes long; estimated

CameraMotion: TypeAlias = tuple[FloatArray, FloatArray]
"""A motion (4, 4) and the covariance (6, 6) of its left perturbation."""


@dataclass(frozen=True, slots=True, eq=False)
class OdometryKeyframe:
    """A keyframe with its odometry.

    Attributes:
        T_odom_keyframe: (4, 4).
        covariance: (6, 6) of the left perturbation (v, ω) of T_odom_keyframe; it grows along the way.
        begins: whether it begins a submap with an unknown pose in the map.
        T_before_now: (4, 4) motion from the previous keyframe in the camera's own map; None: the motion in odom.
        motion: motion (4, 4) from the previous keyframe with its covariance (6, 6), by the current estimate. It differs
            from odom after odometry has revised its estimate: odom jumps, the robot does not. None: by the poses in
            odom.
        T_map_keyframe: (4, 4) pose given by odometry. Used for the first keyframe of a drive with a given start pose,
            since the robot may move before its camera sees anything. None: it has not moved.
        seen_from: alignment with an older, revisited keyframe other than the previous one.
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
class Revisit:
    """A revisit: odometry tracks an earlier keyframe again, so no new one is made.

    Attributes:
        T_odom_keyframe: (4, 4) pose of the keyframe by that frame.
        covariance: (6, 6) of the left perturbation (v, ω) of the frame's pose in odom.
        of_motion: (6, 6) of the left perturbation of the frame's motion relative to the keyframe.
    """

    number: KeyframeId
    stamp_s: float
    T_odom_keyframe: FloatArray
    covariance: FloatArray
    of_motion: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PoseUpdate:
    """Poses of the first K keyframes after loops moved them.

    Attributes:
        T_map_keyframe: (K, 4, 4).
        submap: (K,) number of the first keyframe of each keyframe's submap. Joined submaps have the lowest number. The
            relative pose of two submaps is unknown.
        loops: (L, 2) keyframes of each kept loop, the older one first.
    """

    T_map_keyframe: FloatArray
    submap: IntArray
    loops: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class KeyframePlace:
    """Pose of a keyframe in the map, with covariance.

    Attributes:
        T_odom_keyframe: (4, 4) odometry pose, as it was added.
        covariance_odom: (6, 6) of the left perturbation (v, ω) of T_odom_keyframe, as it was added.
        covariance: (6, 6) of the left perturbation (v, ω) of T_map_keyframe.
    """

    number: KeyframeId
    T_odom_keyframe: FloatArray
    covariance_odom: FloatArray
    T_map_keyframe: FloatArray
    covariance: FloatArray
    newest: KeyframeId


class SubmapGraph:
    """Pose graph that may consist of submaps until recognized places join them.

    Loops within a submap are gated by the graph's covariance. The relative pose of two submaps depends on loops alone:
    two loops from separate viewpoints must agree, and few may contradict them. Only loops that constrain all directions
    count, since self-similar views along a corridor repeat the same error.
    """

    def __init__(self) -> None:
        self._graph = new_pose_graph()
        self._closer = LoopCloser(self._graph)
        self._submap: list[int] = []
        self._held: dict[int, Prior] = {}  # prior of each submap that is not joined
        self._across: list[RelativePose] = []  # loops between submaps without a second one that agrees

    @property
    def poses(self) -> FloatArray:
        """T_map_keyframe (N, 4, 4)."""
        return self._graph.poses

    @property
    def submaps(self) -> IntArray:
        """(N,) submap of each keyframe. Joined submaps have the lowest number."""
        return np.array(self._submap, np.int64)

    @property
    def edges(self) -> tuple[RelativePose, ...]:
        """Added edges and kept loops."""
        return self._graph.edges

    def report(self) -> LoopReport:
        """Return the decisions on all loops so far."""
        return self._closer.report()

    def review(self) -> None:
        """Review all loops; see `LoopCloser.review`."""
        if self._closer.report().decisions:
            self._closer.review()

    def add_pose(self, T_map_keyframe: FloatArray, submap: int) -> None:
        """Add the next keyframe to a submap, with an initial pose (4, 4)."""
        self._graph.add(T_map_keyframe)
        self._submap.append(submap)

    def add_edges(self, edges: Sequence[RelativePose]) -> None:
        """Add edges within submaps."""
        self._graph.add_edges(edges)

    def add_prior(self, prior: Prior, *, until_joined: bool = False) -> None:
        """Add a prior, permanently or until loops join its submap to another."""
        self._graph.add_prior(prior)
        if until_joined:
            self._held[self._submap[prior.keyframe]] = prior

    def offer(self, loops: Sequence[RelativePose]) -> bool:
        """Check loops, and return whether they joined two submaps. The submap with the higher number moves."""
        self._graph.update()
        within = [loop for loop in loops if self._submap[loop.first] == self._submap[loop.second]]
        if within:
            self._closer.offer(within)
        across = [loop for loop in loops if self._submap[loop.first] != self._submap[loop.second]]
        for loop in across:
            # Its standard deviation in each direction must be within the limits for agreement.
            variances = [np.linalg.eigvalsh(part)[-1] for part in (loop.covariance[:3, :3], loop.covariance[3:, 3:])]
            if variances[0] <= _AGREE_M**2 and variances[1] <= _AGREE_RAD**2:
                self._across.append(loop)
        self._across = self._across[-_MOST_ACROSS:]
        # Join two submaps if loops agree and few contradict them.
        T = self._graph.poses
        for one, other in combinations(self._across, 2):
            if self._ends(one) != self._ends(other):
                continue
            # The views must be separate: from the same viewpoint, a wrong match repeats itself.
            apart_m = float(se3.view_shift_m(se3.invert(T[one.second]) @ T[other.second]))
            if not (apart_m >= JOIN_APART_M and self._agree(one, other, T)):
                continue
            alike = [loop for loop in self._across if self._ends(loop) == self._ends(one)]
            agreeing = [loop for loop in alike if self._agree(one, loop, T)]
            if len(agreeing) >= _JOIN_MAJORITY * (len(alike) - len(agreeing)):
                # Move the newer submap to where a loop puts it, and optimise both submaps from there.
                older, newer = sorted(self._ends(one))
                self._graph.remove_prior(self._held.pop(newer))
                self._closer.join(agreeing, aligned_by(one, self.submaps == newer, T))
                self._submap = [older if submap == newer else submap for submap in self._submap]
                self._across = [loop for loop in self._across if len(set(self._ends(loop))) > 1]
                return True
        return False

    def _ends(self, loop: RelativePose) -> tuple[int, int]:
        return self._submap[loop.first], self._submap[loop.second]

    def _agree(self, one: RelativePose, other: RelativePose, T: FloatArray) -> bool:
        """Return whether two loops give the same relative pose of submaps, compared at the other loop's keyframe."""
        X = T[one.first] @ one.T_first_second @ se3.invert(T[one.second])
        D = se3.invert(X @ T[other.second]) @ T[other.first] @ other.T_first_second
        is_near = np.linalg.norm(D[:3, 3]) <= _AGREE_M
        return bool(is_near and so3.angle(D[:3, :3]) <= _AGREE_RAD)


class DriveGraph(SubmapGraph):
    """Pose graph of a drive. It may consist of submaps until a recognized place joins them.

    Args:
        known: map of an earlier drive. Without a start pose in it, the drive begins a separate submap.
    """

    def __init__(self, known: KnownMap | None = None) -> None:
        super().__init__()
        self._before: OdometryKeyframe | None = None
        self._start = None if known is None else known.start
        if known is not None:
            for prior in known.priors(ANCHOR_SIGMA, _KNOWN_SIGMA_M, _KNOWN_SIGMA_RAD):
                self.add_pose(prior.T_map_keyframe, submap=0)
                self.add_prior(prior)
            self.add_edges(known.edges)
        self._reported: FloatArray = self.poses  # keyframe poses that odometry has

    def place(self, revisit: Revisit | None = None) -> KeyframePlace | None:
        """Return the map pose of the newest keyframe, or of a revisited one with the revisit's uncertainty added.

        None while its submap is not joined to the map, or if the covariance cannot be computed.
        """
        newest = self._before
        asked = newest if revisit is None else revisit
        if newest is None or asked is None or self.submaps[asked.number] > 0:
            return None
        covariance = self._graph.marginal(asked.number)
        if covariance is None:
            return None
        T_map_keyframe = self.poses[asked.number]
        if revisit is not None:
            Ad = se3.adjoint(T_map_keyframe)
            covariance = covariance + Ad @ revisit.of_motion @ Ad.T
        odometry = asked.T_odom_keyframe, asked.covariance
        return KeyframePlace(asked.number, *odometry, T_map_keyframe, covariance, newest.number)

    def add(self, keyframe: OdometryKeyframe) -> None:
        """Add the next keyframe, with an odometry edge from the previous one unless it begins a submap."""
        before, self._before = self._before, keyframe
        number, T_odom_keyframe = keyframe.number, keyframe.T_odom_keyframe
        if before is None and self._start is not None:
            T_start, covariance = self._start
            T_map_keyframe = T_start if keyframe.T_map_keyframe is None else keyframe.T_map_keyframe
            self._begin(Prior(number, T_map_keyframe, covariance), submap=0)
        elif before is None and not number:  # the map's origin
            self._begin(anchor(number, T_odom_keyframe), submap=0)
        elif before is None or keyframe.begins:  # fixed in odom until loops join the submap to another
            self._begin(anchor(number, T_odom_keyframe), submap=number, until_joined=True)
        else:
            then, now = ((one.T_odom_keyframe, one.covariance) for one in (before, keyframe))
            edge = step_edge((before.number, number), then, now)
            if keyframe.motion is not None:
                edge = along_floor(edge, keyframe.motion, up=before.T_odom_keyframe[2, :3])
            self.add_pose(se3.nearest(self.poses[-1] @ edge.T_first_second), int(self.submaps[-1]))
            self.add_edges([edge])
            step = edge.T_first_second if keyframe.T_before_now is None else keyframe.T_before_now
            self._reported = np.concatenate([self._reported, self._reported[-1:] @ step])

    def _begin(self, prior: Prior, submap: int, *, until_joined: bool = False) -> None:
        """Add the first keyframe of a drive or of a submap, with its prior."""
        self.add_pose(prior.T_map_keyframe, submap)
        self.add_prior(prior, until_joined=until_joined)
        self._reported = np.concatenate([self._reported, prior.T_map_keyframe[None]])

    def close(self, loops: Sequence[RelativePose]) -> PoseUpdate | None:
        """Check loops, and return keyframe poses if any moved or submaps were joined, else None.

        Poses may move without a loop as well: with wheels, the relative poses in odom are better than the camera's.
        """
        has_joined = bool(loops) and self.offer(loops)
        shift_m = se3.view_shift_m(se3.invert(self._reported) @ self.poses).max()
        if not has_joined and shift_m <= _LEAST_SHIFT_M:
            return None
        self._reported = self.poses
        ends = [sorted((edge.first, edge.second)) for edge in self.edges if edge.is_loop]
        return PoseUpdate(self._reported, self.submaps, np.array(ends, np.int64).reshape(-1, 2))

    @property
    def unjoined(self) -> tuple[KeyframeId, ...]:
        """Keyframes of the last keyframe's submap while that is not joined to the map; else none."""
        submaps = self.submaps
        alike = np.flatnonzero((submaps == submaps[-1]) & (submaps > 0))
        return tuple(KeyframeId(int(number)) for number in alike)

    def near(self, limit_m: float) -> dict[KeyframeId, float]:
        """Return keyframes of the last one's submap within a distance of it, the nearest first, each with its distance.

        A turn by a radian counts as 1.5 m.
        """
        poses, submaps = self.poses, self.submaps
        apart_m = se3.view_shift_m(se3.invert(poses[:-1]) @ poses[-1])
        apart_m[submaps[:-1] != submaps[-1]] = np.inf
        order = np.argsort(apart_m)[: np.count_nonzero(apart_m < limit_m)]
        return {KeyframeId(int(number)): float(apart_m[number]) for number in order}
