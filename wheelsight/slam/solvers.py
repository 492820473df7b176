"""Solvers of pose graphs: GTSAM with iSAM2, and Levenberg-Marquardt with scipy's sparse factors."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, TypeAlias

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from wheelsight.core.geometry import FloatArray, IntArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.runtime import needed, why_missing
from wheelsight.slam.graph import (
    CAUCHY_SCALE,
    EdgeArrays,
    PoseGraph,
    Prior,
    RelativePose,
    arrays_of,
    cauchy_loss,
    edge_errors,
    edge_jacobians,
    inverse_left_jacobian,
    whitening_of,
)

# GTSAM's tangents are (ω, v) and its perturbations multiply from the right. They are converted exactly.
_SWAPPED = np.array([3, 4, 5, 0, 1, 2])
# iSAM2 keeps the linearization of poses that moved by less, metres and radians; GTSAM's default is 0.1.
_RELINEARISE = 0.01
_MOST_STEPS, _STEPS_OF_UPDATE = 100, 2  # of optimise and update
_LEAST_GAIN = 1e-7


def new_pose_graph() -> PoseGraph:
    """Return a GTSAM pose graph, or the built-in one if GTSAM is not installed."""
    return OwnPoseGraph() if why_missing("gtsam") else GtsamPoseGraph()


class GtsamPoseGraph(PoseGraph):
    """Pose graph solved by GTSAM (4.3 or newer): iSAM2 in `update`, Levenberg-Marquardt in `optimise`.

    Raises ConfigError if GTSAM is not installed.
    """

    def __init__(self) -> None:
        super().__init__()
        self._gtsam = needed("gtsam")
        self._isam: Any = None
        self._held = (0, 0, 0)  # numbers of keyframes, edges and priors in iSAM2
        self._marginals: Any = None
        self._own: OwnPoseGraph | None = None  # fallback for covariances

    def update(self) -> None:
        """Add new contents to iSAM2. It is rebuilt after a removal and after `optimise`."""
        self._need_prior()
        if self.unanchored().any():
            self.optimise()  # without damping, iSAM2's covariances would be rounding errors
            return
        if self._isam is None:
            parameters = self._gtsam.ISAM2Params()
            parameters.setRelinearizeThreshold(_RELINEARISE)
            parameters.relinearizeSkip = 1
            self._isam, self._held = self._gtsam.ISAM2(parameters), (0, 0, 0)
        keyframes, edges, priors = self._held
        try:
            self._isam.update(self._factors(edges, priors), self._values(keyframes))
            for _ in range(_STEPS_OF_UPDATE):
                self._isam.update()
            self._T = self._poses_of(self._isam.calculateEstimate())
        except RuntimeError:
            # With loops of little weight, the Cholesky factor loses precision; damping solves it.
            self.optimise()
            return
        self._held = (len(self), len(self._edges), len(self._priors))
        self._marginals = self._own = None

    def optimise(self, T_start: FloatArray | None = None) -> float:
        """See `PoseGraph`."""
        self._need_prior()
        if T_start is not None:
            self._T = np.array(T_start, float).reshape(len(self), 4, 4)
        graph = self._factors(0, 0)
        parameters = self._gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(_MOST_STEPS)
        parameters.setRelativeErrorTol(_LEAST_GAIN)
        found = self._gtsam.LevenbergMarquardtOptimizer(graph, self._values(0), parameters).optimize()
        self._T, self._isam = self._poses_of(found), None
        self._marginals = self._own = None
        return float(graph.error(found))

    def remove_edges(self, edges: Sequence[RelativePose]) -> None:
        """See `PoseGraph`."""
        super().remove_edges(edges)
        self._isam = None

    def remove_prior(self, prior: Prior) -> None:
        """See `PoseGraph`."""
        super().remove_prior(prior)
        self._isam = None

    def _changed(self) -> None:
        self._marginals = self._own = None

    def covariance(self, keyframes: list[KeyframeId]) -> FloatArray | None:
        """See `PoseGraph`."""
        self._need_prior()
        if self._own is None:
            # On long paths with loops of little weight, GTSAM's Cholesky factors lose precision; ours are LU.
            with suppress(RuntimeError):
                counts = len(self), len(self._edges), len(self._priors)
                is_current = self._isam is not None and self._held == counts
                if not is_current and self._marginals is None and not self.unanchored().any():
                    self._marginals = self._gtsam.Marginals(self._factors(0, 0), self._values(0))
                source = self._isam if is_current else self._marginals
                if source is not None:
                    keys = [int(one) for one in keyframes]
                    if len(keys) == 1:
                        blocks = [[source.marginalCovariance(keys[0])]]
                    else:
                        found = source.jointMarginalCovariance(keys)
                        blocks = [[found.at(a, b) for b in keys] for a in keys]
                    Ad = se3.adjoint(self._T[keyframes])
                    ours = Ad[:, None] @ np.array(blocks)[:, :, _SWAPPED][..., _SWAPPED] @ np.swapaxes(Ad, 1, 2)
                    return np.concatenate(np.concatenate(ours, axis=1), axis=1)
            self._own = OwnPoseGraph()
            for T in self._T:
                self._own.add(se3.nearest(T))
            for prior in self._priors:
                self._own.add_prior(prior)
            self._own.add_edges(self._edges)
        return self._own.covariance(keyframes)

    def _factors(self, from_edge: int, from_prior: int) -> Any:
        gtsam, graph = self._gtsam, self._gtsam.NonlinearFactorGraph()
        for prior in self._priors[from_prior:]:
            noise = self._noise(prior.T_map_keyframe, prior.covariance)
            graph.add(gtsam.PriorFactorPose3(int(prior.keyframe), gtsam.Pose3(prior.T_map_keyframe), noise))
        for edge in self._edges[from_edge:]:
            noise = self._noise(edge.T_first_second, edge.covariance)
            if edge.is_loop:
                kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY_SCALE)
                noise = gtsam.noiseModel.Robust.Create(kernel, noise)
            measured = gtsam.Pose3(edge.T_first_second)
            graph.add(gtsam.BetweenFactorPose3(int(edge.first), int(edge.second), measured, noise))
        return graph

    def _noise(self, T: FloatArray, covariance: FloatArray) -> Any:
        """Return the noise of the right perturbation (ω, v) that equals a left one (v, ω)."""
        Ad = se3.adjoint(se3.invert(T))
        C = Ad @ covariance @ Ad.T
        return self._gtsam.noiseModel.Gaussian.Covariance(((C + C.T) / 2)[np.ix_(_SWAPPED, _SWAPPED)])

    def _values(self, from_keyframe: int) -> Any:
        values = self._gtsam.Values()
        for keyframe in range(from_keyframe, len(self)):
            values.insert(keyframe, self._gtsam.Pose3(self._T[keyframe]))
        return values

    def _poses_of(self, values: Any) -> FloatArray:
        return np.array([values.atPose3(keyframe).matrix() for keyframe in range(len(self))])


_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-5, 1e-12, 1e10
_MOST_STEPS_OF_OWN, _STEPS_OF_OWN_UPDATE = 100, 3  # of optimise and update
# Iterations end when the relative decrease of the cost is smaller.
_LEAST_GAIN_OF_OWN = 1e-7
_SIDE = np.arange(6)
_GraphArrays: TypeAlias = tuple[EdgeArrays, tuple[IntArray, FloatArray, FloatArray]]


class OwnPoseGraph(PoseGraph):
    """Pose graph solved by Levenberg-Marquardt with scipy's sparse factors.

    It is used where GTSAM has no wheel, and tests compare GTSAM's results with it.
    """

    def __init__(self) -> None:
        super().__init__()
        self._held_factor: tuple[SuperLU | None, IntArray] | None = None
        self._problem: _GraphArrays | None = None  # edges and priors

    def update(self) -> None:
        """Do some iterations from the current poses."""
        self._descend(_STEPS_OF_OWN_UPDATE)

    def optimise(self, T_start: FloatArray | None = None) -> float:
        """See `PoseGraph`."""
        if T_start is not None:
            self._T = np.array(T_start, float).reshape(len(self), 4, 4)
        return self._descend(_MOST_STEPS_OF_OWN)

    def _descend(self, most_steps: int) -> float:
        """Minimise by Levenberg-Marquardt, and return the final cost."""
        problem, damping = self._as_arrays(), _FIRST_DAMPING
        cost = _cost(self._T, problem)
        for _ in range(most_steps):
            (H, gradient), gain = _linearised(self._T, problem), 0.0
            while damping < _MOST_DAMPING:
                factor = _factor((H + sparse.diags_array(damping * H.diagonal())).tocsc())
                if factor is not None:
                    T_tried = se3.exp(-factor.solve(gradient).reshape(-1, 6)) @ self._T
                    cost_tried = _cost(T_tried, problem)
                    if cost_tried <= cost:
                        gain, damping = cost - cost_tried, max(damping / 10, _LEAST_DAMPING)
                        self._T, cost = T_tried, cost_tried
                        break
                damping *= 10
            if gain <= _LEAST_GAIN_OF_OWN * cost:
                break
        self._held_factor = None
        return cost

    def covariance(self, keyframes: list[KeyframeId]) -> FloatArray | None:
        """See `PoseGraph`."""
        if self._held_factor is None:
            # Of keyframes connected to a prior: an unconnected one would make the whole matrix singular.
            information, is_held = _linearised(self._T, self._as_arrays())[0], self.unanchored() == 0
            of_held = np.flatnonzero(np.repeat(is_held, 6))
            factor = _factor(information[of_held][:, of_held].tocsc())
            self._held_factor = factor, np.where(is_held, np.cumsum(is_held) - 1, -1)
        factor, row = self._held_factor
        if factor is None or (row[keyframes] < 0).any():
            return None
        rows = (6 * row[keyframes][:, None] + _SIDE).ravel()
        unit = np.zeros((factor.shape[0], len(rows)))
        unit[rows, np.arange(len(rows))] = 1.0
        C = factor.solve(unit)[rows]
        is_valid = np.isfinite(C).all() and (np.diag(C) > 0).all()
        return np.asarray((C + C.T) / 2) if is_valid else None

    def _as_arrays(self) -> _GraphArrays:
        self._need_prior()
        if self._problem is None:
            # Of priors: keyframes (P,), inverses of the poses (P, 4, 4), and roots of information (P, 6, 6).
            T = np.array([prior.T_map_keyframe for prior in self._priors], float)
            C = np.array([prior.covariance for prior in self._priors], float)
            keyframes = np.array([prior.keyframe for prior in self._priors], np.int64)
            self._problem = arrays_of(self._edges), (keyframes, se3.invert(T), whitening_of(C))
        return self._problem

    def _changed(self) -> None:
        self._held_factor = self._problem = None


def _factor(information: sparse.csc_array) -> SuperLU | None:
    """Return the LU factor, or None if the matrix is numerically singular."""
    try:
        # A symmetric positive definite matrix needs no pivoting, and has the least fill-in without it.
        return splu(information, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:
        return None


def _cost(T: FloatArray, problem: _GraphArrays) -> float:
    edges, (at, T_inverse, W) = problem
    chi2 = _squares(edge_errors(T, edges), edges.whitening)
    loss = np.where(edges.is_loop, cauchy_loss(chi2), chi2 / 2)
    return float(loss.sum() + _squares(se3.log(T[at] @ T_inverse), W).sum() / 2)


def _squares(errors: FloatArray, whitening: FloatArray) -> FloatArray:
    return np.asarray(((whitening @ errors[..., None])[..., 0] ** 2).sum(axis=-1))


def _linearised(T: FloatArray, problem: _GraphArrays) -> tuple[sparse.csc_array, FloatArray]:
    """Return information and gradient of the normal equations, with robust weights of loops."""
    (edges, (at, T_inverse, W_prior)), n = problem, len(T)
    r = edge_errors(T, edges)
    chi2 = _squares(r, edges.whitening)
    weight = np.where(edges.is_loop, 1 / (1 + chi2 / CAUCHY_SCALE**2), 1.0)
    J = edges.whitening @ edge_jacobians(T, edges, r)
    B = weight[:, None, None] * (np.swapaxes(J, 1, 2) @ J)
    g = weight[:, None] * np.einsum("eij,ei->ej", J, (edges.whitening @ r[..., None])[..., 0])
    r_prior = se3.log(T[at] @ T_inverse)
    J_prior = W_prior @ inverse_left_jacobian(r_prior)
    blocks, gradient = np.zeros((n, 6, 6)), np.zeros((n, 6))
    for keyframes, block in ((edges.first, B), (edges.second, B), (at, np.swapaxes(J_prior, 1, 2) @ J_prior)):
        np.add.at(blocks, keyframes, block)
    np.add.at(gradient, edges.first, -g)
    np.add.at(gradient, edges.second, g)
    np.add.at(gradient, at, np.einsum("pij,pi->pj", J_prior, (W_prior @ r_prior[..., None])[..., 0]))
    every, all_blocks = np.arange(n), np.concatenate([blocks, -B, -B])
    rows = np.concatenate([every, edges.first, edges.second])
    columns = np.concatenate([every, edges.second, edges.first])
    i = np.broadcast_to((6 * rows[:, None] + _SIDE)[:, :, None], all_blocks.shape)
    j = np.broadcast_to((6 * columns[:, None] + _SIDE)[:, None, :], all_blocks.shape)
    # Blocks in the same place are summed.
    information = sparse.coo_array((all_blocks.ravel(), (i.ravel(), j.ravel())), shape=(6 * n, 6 * n)).tocsc()
    return information, gradient.ravel()
