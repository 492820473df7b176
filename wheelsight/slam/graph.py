"""Contents and interface of a pose graph. The module also makes edges from odometry and computes whitened errors
with Jacobians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3, so3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry.motion_kernels import is_definite
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.settings import StepSettings

# What a pose graph holds, and what every solver of one offers.


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


# What odometry says between two keyframes, as an edge of the graph; and what holds the first one.


# The first keyframe holds the map where it began; so little, in metres and radians, is as good as exact.
ANCHOR_SIGMA = 1e-4
# Variances (m² or rad²) above the one tell nothing any more; those below that share of the largest are its rounding.
_UNKNOWN, _ROUNDING = 1e6, 1e-15


def anchor(keyframe: KeyframeId, T_map_keyframe: FloatArray) -> Prior:
    """A keyframe (4, 4) that stays where it is."""
    return Prior(keyframe, T_map_keyframe, ANCHOR_SIGMA**2 * np.eye(6))


def step_edge(
    ends: tuple[KeyframeId, KeyframeId],
    before: tuple[FloatArray, FloatArray],
    now: tuple[FloatArray, FloatArray],
    settings: StepSettings,
) -> RelativePose:
    """From one keyframe to the next, by poses (4, 4) with covariances (6, 6) that grow along the way."""
    T_step, _ = motions.between(*before, *now)
    _, grown = motions.step_between(*before, *now)
    return RelativePose(*ends, motions.mended(T_step), _with_least(grown, settings))


def along_floor(edge: RelativePose, motion: tuple[FloatArray, FloatArray], up: FloatArray) -> RelativePose:
    """An edge by poses that takes from a motion (4, 4), with its covariance (6, 6), what is in the floor's plane.

    `up` (3,) is the plane's normal as the first keyframe has it. Height and tilt are those of the poses: that a floor
    is level is known of each pose, and no motion between two tells it.
    """
    T, C = motion
    floor, turn = np.eye(3) - np.outer(up, up), np.outer(up, up)
    in_plane = np.zeros((6, 6))
    in_plane[:3, :3], in_plane[3:, 3:] = floor, turn
    out_of_plane = np.eye(6) - in_plane
    ahead = in_plane @ motions.log(motions.times(T, motions.inverse(edge.T_first_second)))
    covariance = in_plane @ C @ in_plane + out_of_plane @ edge.covariance @ out_of_plane
    T_first_second = motions.mended(motions.times(motions.exp(ahead), edge.T_first_second))
    return RelativePose(edge.first, edge.second, T_first_second, covariance + ANCHOR_SIGMA**2 * np.eye(6))


def aligned_edge(
    ends: tuple[KeyframeId, KeyframeId], T_first_second: FloatArray, covariance: FloatArray, settings: StepSettings
) -> RelativePose:
    """Between a keyframe and an older one that odometry has come back to: a loop, since neither is the other's next."""
    return RelativePose(*ends, motions.mended(T_first_second), _with_least(covariance, settings), is_loop=True)


def _with_least(C: FloatArray, settings: StepSettings) -> FloatArray:
    """C (6, 6) with what no step is surer than."""
    return _definite(C + np.diag(np.square([settings.plane_sigma_m] * 3 + [settings.plane_sigma_rad] * 3)))


def _definite(C: FloatArray) -> FloatArray:
    """C (6, 6), positive definite by more than rounding.

    A camera before a bare wall was unsure by 10⁶ m along it, and rounding of that variance made others negative.
    """
    variances, axes = np.linalg.eigh((C + C.T) / 2)
    bounded = (axes * np.clip(variances, _ROUNDING * variances[-1], _UNKNOWN)) @ axes.T
    return np.asarray((bounded + bounded.T) / 2)


# Errors of measured poses in a graph, whitened, with Jacobians: what both solvers and the gate mean by an error.
#
# The error of an edge is log(T_first⁻¹ · T_second · T_measured⁻¹), the left perturbation by which the poses depart
# from what was measured; that of a prior log(T · T_measured⁻¹).


# Below, Taylor series of the Jacobian's coefficients are exact to 1e-13; above, so are the closed forms.
_SMALL_RAD = 0.3


class EdgeArrays(NamedTuple):
    """Edges as arrays: keyframes (E,), T_second_first (E, 4, 4) as measured, roots of information (E, 6, 6), loops."""

    first: IntArray
    second: IntArray
    T_measured_inverse: FloatArray
    whitening: FloatArray
    is_loop: BoolArray


def arrays_of(edges: Sequence[RelativePose]) -> EdgeArrays:
    """The same, laid side by side."""
    T = np.array([edge.T_first_second for edge in edges], float).reshape(-1, 4, 4)
    return EdgeArrays(
        np.array([edge.first for edge in edges], np.int64),
        np.array([edge.second for edge in edges], np.int64),
        se3.invert(T),
        whitening_of(np.array([edge.covariance for edge in edges], float).reshape(-1, 6, 6)),
        np.array([edge.is_loop for edge in edges], bool),
    )


def arrays_of_priors(priors: Sequence[Prior]) -> tuple[IntArray, FloatArray, FloatArray]:
    """Keyframes (P,), inverses of the poses (P, 4, 4), roots of information (P, 6, 6)."""
    T = np.array([prior.T_map_keyframe for prior in priors], float).reshape(-1, 4, 4)
    C = np.array([prior.covariance for prior in priors], float).reshape(-1, 6, 6)
    return np.array([prior.keyframe for prior in priors], np.int64), se3.invert(T), whitening_of(C)


def whitening_of(covariances: FloatArray) -> FloatArray:
    """W (..., 6, 6) with WᵀW = C⁻¹."""
    return np.linalg.inv(np.linalg.cholesky(covariances)) if len(covariances) else covariances


def edge_errors(T: FloatArray, edges: EdgeArrays) -> FloatArray:
    """Errors (E, 6) at poses (N, 4, 4), not whitened."""
    return se3.log(se3.invert(T[edges.first]) @ T[edges.second] @ edges.T_measured_inverse)


def edge_jacobians(T: FloatArray, edges: EdgeArrays, errors: FloatArray) -> FloatArray:
    """(E, 6, 6) of the errors by the second pose's left perturbation; by the first one's it is the negative."""
    return inverse_left_jacobian(errors) @ se3.adjoint(se3.invert(T[edges.first]))


def cauchy_loss(chi2: FloatArray, scale: float) -> FloatArray:
    """Half of squared whitened errors (...) under Cauchy's kernel: (c²/2) log(1 + χ²/c²)."""
    return np.asarray(scale**2 / 2 * np.log1p(chi2 / scale**2))


def inverse_left_jacobian(xi: FloatArray) -> FloatArray:
    """(..., 6, 6) with log(exp(δ) · exp(ξ)) ≈ ξ + J δ (Barfoot, State Estimation for Robotics, 7.86 and 7.95)."""
    J = so3.left_jacobian(xi[..., 3:])
    J_inverse = np.linalg.inv(J)
    found = np.zeros((*xi.shape[:-1], 6, 6))
    found[..., :3, :3] = found[..., 3:, 3:] = J_inverse
    found[..., :3, 3:] = -J_inverse @ _coupling(xi) @ J_inverse
    return found


def _coupling(xi: FloatArray) -> FloatArray:
    """Q (..., 3, 3), how turning moves what is moved."""
    V, W = so3.hat(xi[..., :3]), so3.hat(xi[..., 3:])
    angle = np.linalg.norm(xi[..., 3:], axis=-1)
    a, b, c = (factor[..., None, None] for factor in _factors(angle))
    WVW = W @ V @ W
    return np.asarray(
        V / 2 + a * (W @ V + V @ W + WVW) - b * (W @ W @ V + V @ W @ W - 3 * WVW) - c / 2 * (WVW @ W + W @ WVW)
    )


def _factors(angle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients of Q: (φ − sin φ)/φ³, (1 − φ²/2 − cos φ)/φ⁴, and that less 3(φ − sin φ − φ³/6)/φ⁵."""
    s = angle**2
    a = 1 / 6 - s / 120 + s**2 / 5040 - s**3 / 362880 + s**4 / 39916800
    b = -1 / 24 + s / 720 - s**2 / 40320 + s**3 / 3628800 - s**4 / 479001600
    d = -1 / 120 + s / 5040 - s**2 / 362880 + s**3 / 39916800 - s**4 / 6227020800
    large = angle > _SMALL_RAD
    phi = np.where(large, angle, 1.0)
    a = np.where(large, (phi - np.sin(phi)) / phi**3, a)
    b = np.where(large, (1 - phi**2 / 2 - np.cos(phi)) / phi**4, b)
    d = np.where(large, (phi - np.sin(phi) - phi**3 / 6) / phi**5, d)
    return a, b, b - 3 * d
