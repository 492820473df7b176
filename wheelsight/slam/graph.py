"""Contents and interface of a pose graph, edges from odometry, and whitened errors with Jacobians."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3, so3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.core.keyframes import KeyframeId

# A heading with this standard deviation or a larger one is unknown.
_UNKNOWN_TURN_RAD = np.pi
_TURNS = slice(3, 6)


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """An edge: the measured pose of one keyframe relative to another.

    Attributes:
        T_first_second: (4, 4), as measured.
        covariance: (6, 6) of its left perturbation (v, ω), positive definite.
        is_loop: whether it may be an outlier, so that a Cauchy kernel limits its weight.
    """

    first: KeyframeId
    second: KeyframeId
    T_first_second: FloatArray
    covariance: FloatArray
    is_loop: bool = False

    @property
    def freedom(self) -> int:
        """Number of measured directions: 3 for a position without heading, else 6."""
        is_known = np.diag(self.covariance)[_TURNS] < _UNKNOWN_TURN_RAD**2
        return 3 + int(np.count_nonzero(is_known))


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """A prior on the pose of a keyframe in the map.

    Attributes:
        T_map_keyframe: (4, 4).
        covariance: (6, 6) of its left perturbation (v, ω), positive definite.
    """

    keyframe: KeyframeId
    T_map_keyframe: FloatArray
    covariance: FloatArray


class PoseGraph(ABC):
    """Keyframe poses, and measurements of them.

    Keyframes are numbered from 0 in the order in which they are added. Poses are T_map_keyframe. Covariances are those
    of their left perturbations (v, ω) at the current linearization point, with loops at their robust weights.
    """

    def __init__(self) -> None:
        self._room, self._count = np.zeros((16, 4, 4)), 0
        self._edges: list[RelativePose] = []
        self._priors: list[Prior] = []

    @abstractmethod
    def update(self) -> None:
        """Optimise incrementally from the current poses: cheap, for use while driving."""

    @abstractmethod
    def optimise(self, T_start: FloatArray | None = None) -> float:
        """Optimise fully from poses (N, 4, 4) or from the current ones; return half of the squared error."""

    def marginal(self, keyframe: KeyframeId) -> FloatArray | None:
        """Return the covariance (6, 6) of a pose; None if it is unobservable or numerically singular."""
        return self.covariance([keyframe])

    def joint(self, first: KeyframeId, second: KeyframeId) -> FloatArray | None:
        """Return the covariance (12, 12) of two poses, the first one's perturbation first; None as in `marginal`."""
        return self.covariance([first, second])

    @abstractmethod
    def covariance(self, keyframes: list[KeyframeId]) -> FloatArray | None:
        """Return the joint covariance (6 K, 6 K) of poses; None as in `marginal`."""

    def __len__(self) -> int:
        return self._count

    @property
    def poses(self) -> FloatArray:
        """A copy of T_map_keyframe (N, 4, 4) by the last optimisation; newer keyframes have their initial pose."""
        return self._T.copy()

    @property
    def edges(self) -> tuple[RelativePose, ...]:
        """All edges, in the order in which they were added."""
        return tuple(self._edges)

    def add(self, T_map_keyframe: FloatArray) -> KeyframeId:
        """Add a keyframe with an initial pose (4, 4), and return its number. Raises ArgumentError."""
        if not se3.is_valid(T_map_keyframe):
            raise ArgumentError("T_map_keyframe is not a rigid motion", fix="give a finite (4, 4) of SE(3)")
        if self._count == len(self._room):
            self._room = np.concatenate([self._room, np.zeros_like(self._room)])
        self._room[self._count] = T_map_keyframe
        self._count += 1
        self._changed()
        return KeyframeId(self._count - 1)

    def add_prior(self, prior: Prior) -> None:
        """Add a prior; a graph needs at least one, to fix the map frame. Raises ArgumentError."""
        self._check([prior.keyframe], prior.T_map_keyframe, prior.covariance)
        self._priors.append(prior)
        self._changed()

    def add_edges(self, edges: Sequence[RelativePose]) -> None:
        """Add measurements. Raises ArgumentError for an unknown keyframe or an invalid covariance."""
        for edge in edges:
            self._check([edge.first, edge.second], edge.T_first_second, edge.covariance)
            if edge.first == edge.second:
                raise ArgumentError(f"an edge joins keyframe {edge.first} with itself", fix="give two keyframes")
        self._edges.extend(edges)
        self._changed()

    def remove_edges(self, edges: Sequence[RelativePose]) -> None:
        """Remove edges by identity, not by value. Raises ArgumentError."""
        gone = {id(edge) for edge in edges}
        kept = [edge for edge in self._edges if id(edge) not in gone]
        if len(kept) + len(gone) != len(self._edges):
            raise ArgumentError("the graph has no such edge", fix="give edges out of `edges`")
        self._edges = kept
        self._changed()

    def remove_prior(self, prior: Prior) -> None:
        """Remove a prior by identity. Raises ArgumentError."""
        kept = [one for one in self._priors if one is not prior]
        if len(kept) == len(self._priors):
            raise ArgumentError("the graph has no such prior", fix="give one that was added")
        self._priors = kept
        self._changed()

    def unanchored(self, without: Sequence[RelativePose] = ()) -> IntArray:
        """Return (N,) 0 for keyframes connected to a prior by edges, else the number of their component.

        Edges in `without` are ignored. The poses of unconnected components are unobservable.
        """
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

    @abstractmethod
    def _changed(self) -> None:
        """Invalidate results that depend on the contents."""

    def _check(self, keyframes: Sequence[KeyframeId], T: FloatArray, covariance: FloatArray) -> None:
        for keyframe in keyframes:
            if not 0 <= keyframe < len(self):
                raise ArgumentError(f"there is no keyframe {keyframe}", fix=f"numbers go from 0 to {len(self) - 1}")
        C = np.ascontiguousarray(covariance, float)
        if not se3.is_valid(T):
            raise ArgumentError("a measurement is not a rigid motion", fix="give a finite (4, 4) of SE(3)")
        if C.shape != (6, 6) or not np.isfinite(C).all() or not np.allclose(C, C.T) or not is_definite(C):
            raise ArgumentError(
                "a covariance is not positive definite", fix="give a symmetric (6, 6) without zero variances"
            )

    def _need_prior(self) -> None:
        if not self._priors:
            raise ArgumentError(
                "the graph has no prior, so its frame is not fixed", fix="call add_prior for the first keyframe"
            )


# Added to the error of each odometry step, metres per coordinate and radians per axis: planar odometry has no error out
# of the plane. Estimated: floors are level to some millimetres per metre.
_PLANE_SIGMA_M, _PLANE_SIGMA_RAD = 1e-3, 1e-3
# Standard deviations above which the Cauchy kernel reduces a loop's weight. Found on synthetic graphs:
# docs/decisions/loops-and-graph.md.
CAUCHY_SCALE = 1.0
# Standard deviation of the prior that fixes the map frame, metres and radians; in effect exact.
ANCHOR_SIGMA = 1e-4
# Larger variances (m² or rad²) are clipped, as are those below this share of the largest, which are rounding errors.
_UNKNOWN, _ROUNDING = 1e6, 1e-15


def anchor(keyframe: KeyframeId, T_map_keyframe: FloatArray) -> Prior:
    """Return a prior that fixes a keyframe at its pose (4, 4)."""
    return Prior(keyframe, T_map_keyframe, ANCHOR_SIGMA**2 * np.eye(6))


def step_edge(
    ends: tuple[KeyframeId, KeyframeId], before: tuple[FloatArray, FloatArray], now: tuple[FloatArray, FloatArray]
) -> RelativePose:
    """Return the edge between successive keyframes, from poses (4, 4) with covariances (6, 6) that grow along the way.

    Args:
        before, now: odometry pose and covariance of the first and the second keyframe.
    """
    T_step, _ = motions.between(*before, *now)
    _, grown = motions.step_between(*before, *now)
    return RelativePose(*ends, motions.renormalized(T_step), _with_least(grown))


def along_floor(edge: RelativePose, motion: tuple[FloatArray, FloatArray], up: FloatArray) -> RelativePose:
    """Return an edge with its in-plane part replaced by a motion (4, 4) with covariance (6, 6).

    `up` (3,) is the normal of the floor in the first keyframe. Height and tilt remain those of the edge, since a level
    floor constrains each pose and not the motion between two.
    """
    T, C = motion
    floor, turn = np.eye(3) - np.outer(up, up), np.outer(up, up)
    in_plane = np.zeros((6, 6))
    in_plane[:3, :3], in_plane[3:, 3:] = floor, turn
    out_of_plane = np.eye(6) - in_plane
    ahead = in_plane @ motions.log(motions.times(T, motions.inverse(edge.T_first_second)))
    covariance = in_plane @ C @ in_plane + out_of_plane @ edge.covariance @ out_of_plane
    T_first_second = motions.renormalized(motions.times(motions.exp(ahead), edge.T_first_second))
    return RelativePose(edge.first, edge.second, T_first_second, covariance + ANCHOR_SIGMA**2 * np.eye(6))


def aligned_edge(
    ends: tuple[KeyframeId, KeyframeId], T_first_second: FloatArray, covariance: FloatArray
) -> RelativePose:
    """Return a loop edge from the alignment of a keyframe with an older, revisited one."""
    return RelativePose(*ends, motions.renormalized(T_first_second), _with_least(covariance), is_loop=True)


def _with_least(C: FloatArray) -> FloatArray:
    """Return C (6, 6) plus the least variances of a step, clipped so that it is positive definite beyond rounding.

    A camera in front of a bare wall gave a standard deviation of 10⁶ m along it. Rounding of that variance made other
    ones negative.
    """
    C = C + np.diag(np.square([_PLANE_SIGMA_M] * 3 + [_PLANE_SIGMA_RAD] * 3))
    variances, axes = np.linalg.eigh((C + C.T) / 2)
    bounded = (axes * np.clip(variances, _ROUNDING * variances[-1], _UNKNOWN)) @ axes.T
    return np.asarray((bounded + bounded.T) / 2)


# The error of an edge is log(T_first⁻¹ · T_second · T_measured⁻¹), the left perturbation of the measurement that gives
# the poses. The error of a prior is log(T · T_measured⁻¹).

# Below this angle, the Taylor series of the coefficients are accurate to 1e-13; above it, the closed forms are.
_SMALL_RAD = 0.3


class EdgeArrays(NamedTuple):
    """Edges as arrays: keyframes (E,), inverse measured poses (E, 4, 4), roots of information (E, 6, 6), loop flags
    (E,).
    """

    first: IntArray
    second: IntArray
    T_measured_inverse: FloatArray
    whitening: FloatArray
    is_loop: BoolArray


def arrays_of(edges: Sequence[RelativePose]) -> EdgeArrays:
    """Return edges as arrays."""
    T = np.array([edge.T_first_second for edge in edges], float).reshape(-1, 4, 4)
    return EdgeArrays(
        np.array([edge.first for edge in edges], np.int64),
        np.array([edge.second for edge in edges], np.int64),
        se3.invert(T),
        whitening_of(np.array([edge.covariance for edge in edges], float).reshape(-1, 6, 6)),
        np.array([edge.is_loop for edge in edges], bool),
    )


def whitening_of(covariances: FloatArray) -> FloatArray:
    """Return W (..., 6, 6) with WᵀW = C⁻¹."""
    return np.linalg.inv(np.linalg.cholesky(covariances)) if len(covariances) else covariances


def edge_errors(T: FloatArray, edges: EdgeArrays) -> FloatArray:
    """Return errors (E, 6) at poses (N, 4, 4), not whitened."""
    return se3.log(se3.invert(T[edges.first]) @ T[edges.second] @ edges.T_measured_inverse)


def edge_jacobians(T: FloatArray, edges: EdgeArrays, errors: FloatArray) -> FloatArray:
    """Return Jacobians (E, 6, 6) by the second pose's left perturbation; those by the first one's are the negative."""
    return inverse_left_jacobian(errors) @ se3.adjoint(se3.invert(T[edges.first]))


def cauchy_loss(chi2: FloatArray) -> FloatArray:
    """Return half of squared whitened errors (...) under the Cauchy kernel: (c²/2) log(1 + χ²/c²)."""
    return np.asarray(CAUCHY_SCALE**2 / 2 * np.log1p(chi2 / CAUCHY_SCALE**2))


def inverse_left_jacobian(xi: FloatArray) -> FloatArray:
    """Return J (..., 6, 6) with log(exp(δ) · exp(ξ)) ≈ ξ + J δ.

    Barfoot, State Estimation for Robotics, equations 7.86 and 7.95.
    """
    # Q, the coupling of translation and rotation, has the coefficients a = (φ − sin φ)/φ³, b = (1 − φ²/2 − cos φ)/φ⁴,
    # and c = b − 3(φ − sin φ − φ³/6)/φ⁵.
    V, W, angle = so3.hat(xi[..., :3]), so3.hat(xi[..., 3:]), np.linalg.norm(xi[..., 3:], axis=-1)
    s = angle**2
    a = 1 / 6 - s / 120 + s**2 / 5040 - s**3 / 362880 + s**4 / 39916800
    b = -1 / 24 + s / 720 - s**2 / 40320 + s**3 / 3628800 - s**4 / 479001600
    d = -1 / 120 + s / 5040 - s**2 / 362880 + s**3 / 39916800 - s**4 / 6227020800
    large = angle > _SMALL_RAD
    phi = np.where(large, angle, 1.0)
    a = np.where(large, (phi - np.sin(phi)) / phi**3, a)
    b = np.where(large, (1 - phi**2 / 2 - np.cos(phi)) / phi**4, b)
    d = np.where(large, (phi - np.sin(phi) - phi**3 / 6) / phi**5, d)
    a, b, c = (factor[..., None, None] for factor in (a, b, b - 3 * d))
    WVW = W @ V @ W
    Q = V / 2 + a * (W @ V + V @ W + WVW) - b * (W @ W @ V + V @ W @ W - 3 * WVW) - c / 2 * (WVW @ W + W @ WVW)
    J_inverse = np.linalg.inv(so3.left_jacobian(xi[..., 3:]))
    found = np.zeros((*xi.shape[:-1], 6, 6))
    found[..., :3, :3] = found[..., 3:, 3:] = J_inverse
    found[..., :3, 3:] = -J_inverse @ Q @ J_inverse
    return found
