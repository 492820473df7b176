"""Least squares over a model: Levenberg-Marquardt with numeric derivatives, and what its answer is worth.

Each residual sees one pose at most. Poses are therefore eliminated view by view (the Schur complement of bundle
adjustment), and what is solved is as large as the cameras' parameters alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wheelsight.camera_calibration.model import Residuals
from wheelsight.geometry import FloatArray, IntArray

_STEP = 1e-6  # of parameters that are all about a hundredth to one
_MOST_STEPS, _SMALL_GAIN = 60, 1e-6
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-9, 1e12
_POSE = 6
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Solution:
    """The best parameters (n,), the covariance (g, g) of those before the poses, and half the sum of squares."""

    x: FloatArray
    covariance: FloatArray
    cost: float


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
    """The parameters of least cost, from a start near it, until a step lowers it by less than a share `small_gain`."""
    x, damping = start.copy(), _DAMPING
    linear = _linearised(residuals, x)
    for _ in range(_MOST_STEPS):
        normal, cost, gain = _normal(residuals, linear), float(linear.r @ linear.r), None
        while gain is None and damping < _MOST_DAMPING:
            moved = x + _step(normal, damping)
            r = _all(residuals, moved)
            if np.isfinite(r).all() and r @ r <= cost:
                gain, x, damping = 1 - float(r @ r) / max(cost, 1e-30), moved, max(damping / 10, _LEAST_DAMPING)
            else:
                damping *= 10
        linear = _linearised(residuals, x)
        if gain is None or gain < small_gain:
            break
    return Solution(x, _covariance(residuals, linear), float(linear.r @ linear.r) / 2)


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
        depth.by_cameras[:, knots : at.stop] = residuals.by_knots(x, of_sum)


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


def _covariance(residuals: Residuals, linear: _Linear) -> FloatArray:
    """(g, g): the inverse Hessian, and where views disagree more than their noise does, the spread of their gradients.

    Cells of one depth image share an error that their scatter does not show, such as rounding; so do corners of a bent
    board. What views pull at the answer tells of both (Huber's sandwich, by view). Of each parameter the larger counts.
    """
    normal, count = _normal(residuals, linear), residuals.model.count
    D = normal.D + _TINY * np.eye(_POSE)
    B_over_D = np.linalg.solve(D, normal.B.transpose(0, 2, 1)).transpose(0, 2, 1)
    S = normal.A - (B_over_D @ normal.B.transpose(0, 2, 1)).sum(axis=0)
    plain = np.linalg.pinv(S, hermitian=True)
    pulls = np.stack([linear.by_cameras[linear.view == k].T @ linear.r[linear.view == k] for k in range(count)])
    pulls = pulls - np.einsum("vgp,vp->vg", B_over_D, normal.of_poses)
    spread = plain @ (pulls.T @ pulls) @ plain * (count / max(count - 1, 1))
    grown = np.sqrt(np.maximum(np.diag(spread) / np.maximum(np.diag(plain), 1e-300), 1.0))
    return np.asarray(plain * np.outer(grown, grown))
