"""GtsamPoseGraph: a pose graph solved by GTSAM, by iSAM2 while driving and by Levenberg–Marquardt as a whole.

The only file that knows GTSAM (4.3 or newer). GTSAM's tangents are (ω, v) and its perturbations multiply from the
right; here they are turned into ours and back, exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from wheelsight.extras import needed, why_missing
from wheelsight.geometry import FloatArray, se3
from wheelsight.keyframes import KeyframeId
from wheelsight.slam.graph import GraphContents, PoseGraph, Prior, RelativePose
from wheelsight.slam.own_solver import OwnPoseGraph

_SWAPPED = np.array([3, 4, 5, 0, 1, 2])
# A pose that has moved by less, in metres and radians, keeps its linear form: GTSAM's own default is 0.1.
_RELINEARISE = 0.01
_MOST_STEPS, _STEPS_OF_UPDATE = 100, 2
_LEAST_GAIN = 1e-7


def new_pose_graph(cauchy_scale: float = 1.0) -> PoseGraph:
    """GTSAM's where it is installed, else our own."""
    return OwnPoseGraph(cauchy_scale) if why_missing("gtsam") else GtsamPoseGraph(cauchy_scale)


class GtsamPoseGraph(GraphContents):
    """A `PoseGraph` of GTSAM. Raises ConfigError where that is not installed."""

    def __init__(self, cauchy_scale: float = 1.0) -> None:
        super().__init__(cauchy_scale)
        self._gtsam = needed("gtsam")
        self._isam: Any = None
        self._held = (0, 0, 0)  # keyframes, edges and priors that iSAM2 has
        self._marginals: Any = None
        self._own: OwnPoseGraph | None = None  # tells covariances where GTSAM cannot

    def update(self) -> None:
        """What is new goes into iSAM2; after edges were taken out, or poses found as a whole, it begins anew."""
        self._need_prior()
        if self.unheld().any():
            self.optimise()  # iSAM2 has no damping, and would hand out covariances of rounding errors
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
            # What hangs by loops that have let go leaves its Cholesky factor short of digits; damped it is solved.
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

    def marginal(self, keyframe: KeyframeId) -> FloatArray | None:
        """See `PoseGraph`."""
        return self._covariance([keyframe])

    def joint(self, first: KeyframeId, second: KeyframeId) -> FloatArray | None:
        """See `PoseGraph`."""
        return self._covariance([first, second])

    def _covariance(self, keyframes: list[KeyframeId]) -> FloatArray | None:
        self._need_prior()
        if self._own is None:
            # Long ways whose loops have let go leave GTSAM's Cholesky factors short of digits; ours is LU.
            with suppress(RuntimeError):
                source = self._source()
                if source is not None:
                    return self._by_gtsam(source, keyframes)
            self._own = self._own_copy()
        return self._own.marginal(*keyframes) if len(keyframes) == 1 else self._own.joint(*keyframes)

    def _source(self) -> Any:
        """What tells covariances: iSAM2 where it holds all, else the graph linearised; None where a piece floats."""
        if self._isam is not None and self._held == (len(self), len(self._edges), len(self._priors)):
            return self._isam
        if self._marginals is None and not self.unheld().any():
            self._marginals = self._gtsam.Marginals(self._factors(0, 0), self._values(0))
        return self._marginals

    def _by_gtsam(self, source: Any, keyframes: list[KeyframeId]) -> FloatArray:
        keys = [int(one) for one in keyframes]
        if len(keys) == 1:
            blocks = [[source.marginalCovariance(keys[0])]]
        else:
            found = source.jointMarginalCovariance(keys)
            blocks = [[found.at(a, b) for b in keys] for a in keys]
        Ad = se3.adjoint(self._T[keyframes])
        ours = Ad[:, None] @ np.array(blocks)[:, :, _SWAPPED][..., _SWAPPED] @ np.swapaxes(Ad, 1, 2)
        return np.concatenate(np.concatenate(ours, axis=1), axis=1)

    def _own_copy(self) -> OwnPoseGraph:
        other = OwnPoseGraph(self.cauchy_scale)
        for T in self._T:
            other.add(se3.nearest(T))
        for prior in self._priors:
            other.add_prior(prior)
        other.add_edges(self._edges)
        return other

    def _factors(self, from_edge: int, from_prior: int) -> Any:
        gtsam, graph = self._gtsam, self._gtsam.NonlinearFactorGraph()
        for prior in self._priors[from_prior:]:
            noise = self._noise(prior.T_map_keyframe, prior.covariance)
            graph.add(gtsam.PriorFactorPose3(int(prior.keyframe), gtsam.Pose3(prior.T_map_keyframe), noise))
        for edge in self._edges[from_edge:]:
            noise = self._noise(edge.T_first_second, edge.covariance)
            if edge.is_loop:
                kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(self.cauchy_scale)
                noise = gtsam.noiseModel.Robust.Create(kernel, noise)
            measured = gtsam.Pose3(edge.T_first_second)
            graph.add(gtsam.BetweenFactorPose3(int(edge.first), int(edge.second), measured, noise))
        return graph

    def _noise(self, T: FloatArray, covariance: FloatArray) -> Any:
        """Of the right perturbation (ω, v) that amounts to a left one (v, ω): it is seen from the far end."""
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
