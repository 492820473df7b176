"""What a pose graph holds, and what every solver of one offers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wheelsight.errors import ArgumentError
from wheelsight.geometry import FloatArray, IntArray, se3
from wheelsight.geometry.motion_kernels import is_definite
from wheelsight.keyframes import KeyframeId

# A turn known no better than this, as a standard deviation, is not known at all.
_UNKNOWN_TURN_RAD = np.pi
_TURNS = slice(3, 6)


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """An edge: where one keyframe is, seen from another.

    Attributes:
        first, second: the keyframes.
        T_first_second: (4, 4), as measured.
        covariance: (6, 6) of its left perturbation (v, ω), positive definite.
        is_loop: whether it may be false, so that a Cauchy kernel holds its pull down.
    """

    first: KeyframeId
    second: KeyframeId
    T_first_second: FloatArray
    covariance: FloatArray
    is_loop: bool = False

    @property
    def freedom(self) -> int:
        """How many directions it measures: 3 of a place whose heading is not known, else 6."""
        is_known = np.diag(self.covariance)[_TURNS] < _UNKNOWN_TURN_RAD**2
        return 3 + int(np.count_nonzero(is_known))


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Where a keyframe is in the map, as known from elsewhere.

    Attributes:
        keyframe: which.
        T_map_keyframe: (4, 4).
        covariance: (6, 6) of its left perturbation (v, ω), positive definite.
    """

    keyframe: KeyframeId
    T_map_keyframe: FloatArray
    covariance: FloatArray


class PoseGraph(Protocol):
    """Keyframes, and what is measured of where they are.

    Keyframes are numbered from 0 in the order in which they are added. Poses are T_map_keyframe; covariances are those
    of their left perturbations (v, ω), by where the graph is linearised at present, with loops as heavy as the kernel
    leaves them.
    """

    @property
    def poses(self) -> FloatArray:
        """T_map_keyframe (N, 4, 4), as of the last `update` or `optimise`; of newer keyframes as they were added."""

    @property
    def edges(self) -> tuple[RelativePose, ...]:
        """All, in the order in which they were added."""

    def add(self, T_map_keyframe: FloatArray) -> KeyframeId:
        """A keyframe, and about where it is."""

    def add_prior(self, prior: Prior) -> None:
        """One is needed at least: relative poses alone leave free where the map begins. Raises ArgumentError."""

    def add_edges(self, edges: Sequence[RelativePose]) -> None:
        """Measurements. Raises ArgumentError: keyframes that it does not hold, no covariance."""

    def remove_edges(self, edges: Sequence[RelativePose]) -> None:
        """Take out measurements, each by itself and not by what it says. Raises ArgumentError."""

    def remove_prior(self, prior: Prior) -> None:
        """Take out one that was added. Raises ArgumentError."""

    def unheld(self, without: Sequence[RelativePose] = ()) -> IntArray:
        """(N,) 0 of keyframes that edges, but some, join with one that a prior holds; else a number of their piece.

        Where they are nothing tells, and no solver can.
        """

    def update(self) -> None:
        """Take in what is new, from where the poses are: cheap, for use while driving."""

    def optimise(self, T_start: FloatArray | None = None) -> float:
        """The best poses, from (N, 4, 4) on or from the present ones; answers with half of the squared errors."""

    def marginal(self, keyframe: KeyframeId) -> FloatArray | None:
        """Covariance (6, 6) of a pose; None where nothing holds it, or the graph's digits do not tell it."""

    def joint(self, first: KeyframeId, second: KeyframeId) -> FloatArray | None:
        """Covariance (12, 12) of two poses, the first one's perturbation first; None as in `marginal`."""


class GraphContents:
    """Keyframes, edges and priors, checked: what all solvers keep alike."""

    def __init__(self, cauchy_scale: float = 1.0) -> None:
        self.cauchy_scale = cauchy_scale
        self._room, self._count = np.zeros((16, 4, 4)), 0
        self._edges: list[RelativePose] = []
        self._priors: list[Prior] = []

    def __len__(self) -> int:
        return self._count

    @property
    def poses(self) -> FloatArray:
        """T_map_keyframe (N, 4, 4), a copy."""
        return self._T.copy()

    @property
    def edges(self) -> tuple[RelativePose, ...]:
        """All, in the order in which they were added."""
        return tuple(self._edges)

    def add(self, T_map_keyframe: FloatArray) -> KeyframeId:
        """A keyframe, and about where it is. Raises ArgumentError."""
        if not se3.is_valid(T_map_keyframe):
            raise ArgumentError("T_map_keyframe is no rigid motion", fix="give a finite (4, 4) of SE(3)")
        if self._count == len(self._room):
            self._room = np.concatenate([self._room, np.zeros_like(self._room)])
        self._room[self._count] = T_map_keyframe
        self._count += 1
        self._changed()
        return KeyframeId(self._count - 1)

    def add_prior(self, prior: Prior) -> None:
        """See `PoseGraph`."""
        self._check([prior.keyframe], prior.T_map_keyframe, prior.covariance)
        self._priors.append(prior)
        self._changed()

    def add_edges(self, edges: Sequence[RelativePose]) -> None:
        """See `PoseGraph`."""
        for edge in edges:
            self._check([edge.first, edge.second], edge.T_first_second, edge.covariance)
            if edge.first == edge.second:
                raise ArgumentError(f"an edge joins keyframe {edge.first} with itself", fix="give two keyframes")
        self._edges.extend(edges)
        self._changed()

    def remove_edges(self, edges: Sequence[RelativePose]) -> None:
        """See `PoseGraph`."""
        gone = {id(edge) for edge in edges}
        kept = [edge for edge in self._edges if id(edge) not in gone]
        if len(kept) + len(gone) != len(self._edges):
            raise ArgumentError("the graph has no such edge", fix="give edges out of `edges`")
        self._edges = kept
        self._changed()

    def remove_prior(self, prior: Prior) -> None:
        """See `PoseGraph`."""
        kept = [one for one in self._priors if one is not prior]
        if len(kept) == len(self._priors):
            raise ArgumentError("the graph has no such prior", fix="give one that was added")
        self._priors = kept
        self._changed()

    def unheld(self, without: Sequence[RelativePose] = ()) -> IntArray:
        """See `PoseGraph`."""
        gone = {id(edge) for edge in without}
        ends = np.array([(edge.first, edge.second) for edge in self._edges if id(edge) not in gone], np.int64)
        first, second = ends.reshape(-1, 2).T
        links = coo_array((np.ones(len(ends)), (first, second)), shape=(len(self), len(self)))
        piece = 1 + np.asarray(connected_components(links, directed=False)[1], np.int64)
        held = piece[[prior.keyframe for prior in self._priors]]
        return np.where(np.isin(piece, held), 0, piece)

    @property
    def _T(self) -> FloatArray:
        return self._room[: self._count]

    @_T.setter
    def _T(self, T: FloatArray) -> None:
        self._room[: self._count] = T

    def _changed(self) -> None:
        """Forget what holds for other contents."""

    def _check(self, keyframes: Sequence[KeyframeId], T: FloatArray, covariance: FloatArray) -> None:
        for keyframe in keyframes:
            if not 0 <= keyframe < len(self):
                raise ArgumentError(f"there is no keyframe {keyframe}", fix=f"numbers go from 0 to {len(self) - 1}")
        C = np.ascontiguousarray(covariance, float)
        if not se3.is_valid(T):
            raise ArgumentError("a measurement is no rigid motion", fix="give a finite (4, 4) of SE(3)")
        if C.shape != (6, 6) or not np.isfinite(C).all() or not np.allclose(C, C.T) or not is_definite(C):
            raise ArgumentError("a covariance is not positive definite", fix="give (6, 6), none of it exact")

    def _need_prior(self) -> None:
        if not self._priors:
            raise ArgumentError("the graph has no prior, so nothing tells where it lies", fix="add_prior at its begin")
