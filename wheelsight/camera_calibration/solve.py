"""Least squares over a model: Levenberg-Marquardt with numeric derivatives, and what its answer is worth.

Each residual sees one pose at most. Poses are therefore eliminated view by view (the Schur complement of bundle
adjustment), and what is solved is as large as the cameras' parameters alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wheelsight.camera_calibration.residuals import Residuals
from wheelsight.geometry import FloatArray, IntArray

_STEP = 1e-6  # of parameters that are all about a hundredth to one
_MOST_STEPS, _SMALL_GAIN = 60, 1e-6
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-9, 1e12
_POSE = 6
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Solution:
    """The best parameters, what is known of those before the poses, and how well they fit.

    Attributes:
        x: parameters (n,).
        covariance: (g, g), as noise has it that is independent of cell to cell and corner to corner.
        by_views: (g, g), as views disagree.
        cost: half the sum of squares.
    """

    x: FloatArray
    covariance: FloatArray
    by_views: FloatArray
    cost: float

    def sigmas_of(self, J: FloatArray, columns: slice | list[int]) -> FloatArray:
        """Standard deviations (m,) of what has these derivatives (m, c) by some parameters: the larger of both."""
        at = np.arange(len(self.covariance))[columns]
        some = (C[np.ix_(at, at)] for C in (self.covariance, self.by_views))
        variances = np.array([np.einsum("mi,ij,mj->m", J, C, J) for C in some])
        return np.asarray(np.sqrt(np.maximum(variances.max(axis=0), 0)))


class _Linear(NamedTuple):
    """Residuals (m,) and their derivatives: by the cameras' parameters (m, g), and by the pose (m, 6) of `view` (m,).

    `view` is -1 of priors, which see no pose.
    """

    r: FloatArray
    by_cameras: FloatArray
    by_pose: FloatArray
    view: IntArray


class _Normal(NamedTuple):
    """Normal equations: A (g, g), B (V, g, 6) and D (V, 6, 6), and the gradients (g,) and (V, 6)."""

    A: FloatArray
    B: FloatArray
    D: FloatArray
    of_cameras: FloatArray
    of_poses: FloatArray


def solve(residuals: Residuals, start: FloatArray, small_gain: float = _SMALL_GAIN) -> Solution:
    """The parameters of least cost, from a start near it, until an undamped step lowers it by less than `small_gain`.

    That is a share of it. A damped step that gains little is no end: where parameters can stand in for each other, as
    scale, offset and curve of time of flight, only what is known beforehand parts them, and damping hides that little.
    """
    x, damping = start.copy(), _DAMPING
    linear = _linearised(residuals, x)
    for _ in range(_MOST_STEPS):
        normal, cost, gain, first = _normal(residuals, linear), float(linear.r @ linear.r), None, damping
        while gain is None and damping < _MOST_DAMPING:
            moved = x + _step(normal, damping)
            r = _all(residuals, moved)
            if np.isfinite(r).all() and r @ r <= cost:
                gain, x, damping = 1 - float(r @ r) / max(cost, 1e-30), moved, max(damping / 10, _LEAST_DAMPING)
            else:
                damping *= 10
        linear = _linearised(residuals, x)
        if gain is None or (gain < small_gain and first == _LEAST_DAMPING):
            break
        damping = _LEAST_DAMPING if gain < small_gain else damping
    return Solution(x, *_covariances(residuals, linear), float(linear.r @ linear.r) / 2)


def _all(residuals: Residuals, x: FloatArray) -> FloatArray:
    """All residuals (m,), in the order of `_linearised`."""
    blocks = (residuals.color(x), residuals.infrared(x), residuals.depth(x), residuals.priors(x))
    return np.concatenate([block.ravel() for block in blocks])


def _linearised(residuals: Residuals, x: FloatArray) -> _Linear:
    m, at = residuals.model, residuals.at
    first = at["poses"].start
    lens_of_depth = {"depth", "apart", "square"} | ({"color"} if m.is_registered else set())
    parts = []
    for block, view, sees in (
        (residuals.color, np.repeat(m.color.view, 2), {"color", "square"}),
        (residuals.infrared, np.repeat(m.infrared.view, 2), lens_of_depth),
        (residuals.depth, m.cells.view, lens_of_depth),
    ):
        here = block(x).ravel()
        by_cameras, by_pose = np.zeros((len(here), first)), np.zeros((len(here), _POSE))
        parts.append(_Linear(here, by_cameras, by_pose, view))
        if not len(here):
            continue
        for k in (k for name in sorted(sees) for k in range(at[name].start, at[name].stop)):
            moved = x.copy()
            moved[k] += _STEP
            by_cameras[:, k] = (block(moved).ravel() - here) / _STEP
        for k in range(_POSE):
            moved = x.copy()
            moved[first + k :: _POSE] += _STEP
            by_pose[:, k] = (block(moved).ravel() - here) / _STEP
    _by_error(residuals, x, parts[2])
    priors = residuals.priors(x)
    parts.append(
        _Linear(priors, residuals.prior_rows[:, :first], np.zeros((len(priors), _POSE)), np.full(len(priors), -1))
    )
    return _Linear(*(np.concatenate(items) for items in zip(*parts, strict=True)))


def _by_error(residuals: Residuals, x: FloatArray, depth: _Linear) -> None:
    """Fill in the derivatives of depth by its error: knots all move what they are weights of."""
    at = residuals.at["error"]
    knots = at.start + residuals.knots_from
    for k in range(at.start, min(knots, at.stop)):
        moved = x.copy()
        moved[k] += _STEP
        depth.by_cameras[:, k] = (residuals.depth(moved) - depth.r) / _STEP
    if at.stop > knots:
        of_sum = (residuals.depth(x, more=_STEP) - depth.r) / _STEP
        depth.by_cameras[:, knots : at.stop] = residuals.by_knots(x, of_sum, depth.r)


def _normal(residuals: Residuals, linear: _Linear) -> _Normal:
    r, J, P, view = linear
    count, size = residuals.model.count, J.shape[1]
    B, D, of_poses = np.zeros((count, size, _POSE)), np.zeros((count, _POSE, _POSE)), np.zeros((count, _POSE))
    for k in range(count):
        rows = view == k
        B[k], D[k], of_poses[k] = J[rows].T @ P[rows], P[rows].T @ P[rows], P[rows].T @ r[rows]
    return _Normal(J.T @ J, B, D, J.T @ r, of_poses)


def _step(normal: _Normal, damping: float) -> FloatArray:
    """What to add to all parameters."""
    A = normal.A + damping * np.diag(np.diag(normal.A) + _TINY)
    diagonal = np.einsum("vii->vi", normal.D)
    D = normal.D + damping * diagonal[:, :, None] * np.eye(_POSE) + _TINY * np.eye(_POSE)
    B_over_D = np.linalg.solve(D, normal.B.transpose(0, 2, 1)).transpose(0, 2, 1)
    S = A - (B_over_D @ normal.B.transpose(0, 2, 1)).sum(axis=0)
    g = normal.of_cameras - np.einsum("vgp,vp->g", B_over_D, normal.of_poses)
    of_cameras = -np.linalg.lstsq(S, g, rcond=None)[0]
    of_poses = -np.linalg.solve(D, (normal.of_poses + np.einsum("vgp,g->vp", normal.B, of_cameras))[..., None])
    return np.concatenate([of_cameras, of_poses.ravel()])


def _covariances(residuals: Residuals, linear: _Linear) -> tuple[FloatArray, FloatArray]:
    """(g, g) twice: the inverse Hessian, and what leaving out one view after the other tells.

    Cells of one depth image share errors that their scatter does not show: what the curve or the pattern cannot follow,
    rounding. So do corners of a bent board. The view is what errs independently. Each view's share of the reduced
    normal equations gives the answer without it by one Gauss-Newton step, and the sum over views of what it moved
    by is the jackknife (Efron 1982; MacKinnon & White 1985, HC3, here by cluster: Bell & McCaffrey 2002). It takes in
    how much a view pulls the answer to itself, which Huber's sandwich does not: that one is too small where few views
    decide. What is known beforehand adds what it is worth.
    """
    normal, count = _normal(residuals, linear), residuals.model.count
    D = normal.D + _TINY * np.eye(_POSE)
    B_over_D = np.linalg.solve(D, normal.B.transpose(0, 2, 1)).transpose(0, 2, 1)
    S = normal.A - (B_over_D @ normal.B.transpose(0, 2, 1)).sum(axis=0)
    plain = np.linalg.pinv(S, hermitian=True)
    by_views = plain @ _information(linear, -1) @ plain
    for k in range(count):
        of_view = _information(linear, k) - B_over_D[k] @ normal.B[k].T
        rows = linear.view == k
        pull = linear.by_cameras[rows].T @ linear.r[rows] - B_over_D[k] @ normal.of_poses[k]
        moved = np.linalg.pinv(S - of_view, hermitian=True) @ pull
        by_views += np.outer(moved, moved) * (count - 1) / count
    return plain, by_views


def _information(linear: _Linear, view: int) -> FloatArray:
    """(g, g) of one view about the cameras, its pose held; of the priors for -1."""
    J = linear.by_cameras[linear.view == view]
    return np.asarray(J.T @ J)
