"""Levenberg-Marquardt solver of a camera calibration, with its residuals and priors. `agreeing` rejects outliers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, PinholeCamera, se3
from wheelsight_calibration.camera_model import (
    BARE_LENS,
    BEFORE_KNOTS,
    DISPARITY_OF_INFINITY,
    NOMINAL_STEP,
    Counted,
    Model,
    Points,
    Sigmas,
    cubic_grid_weights,
    cubic_weights,
    lens_parameters,
)
from wheelsight_calibration.views import FEWEST_CORNERS, RAW_DISPARITY, Corners

# Least squares by Levenberg-Marquardt with numeric derivatives. Each residual depends on one pose at most, so poses are
# eliminated view by view (the Schur complement of bundle adjustment), and the solved system has the size of the
# cameras' parameters.

_STEP = 1e-6  # of parameters that are all about a hundredth to one
_MOST_STEPS, _SMALL_GAIN = 60, 1e-6
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-9, 1e12
_POSE = 6
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Solution:
    """The best parameters with the covariances of those before the poses.

    Attributes:
        x: parameters (n,).
        covariance: (g, g) for independent noise of cells and corners.
        by_views: (g, g) by the disagreement of views.
        cost: half the sum of squares.
    """

    x: FloatArray
    covariance: FloatArray
    by_views: FloatArray
    cost: float

    def sigmas_of(self, J: FloatArray, columns: slice | list[int]) -> FloatArray:
        """Standard deviations (m,) of functions with derivatives J (m, c) by some parameters; the larger of both."""
        at = np.arange(len(self.covariance))[columns]
        some = (C[np.ix_(at, at)] for C in (self.covariance, self.by_views))
        variances = np.array([np.einsum("mi,ij,mj->m", J, C, J) for C in some])
        return np.asarray(np.sqrt(np.maximum(variances.max(axis=0), 0)))


class _LinearSystem(NamedTuple):
    """Residuals (m,) and their derivatives by the cameras' parameters (m, g) and by the pose (m, 6) of `view` (m,).

    `view` is -1 for priors, which depend on no pose.
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
    """The parameters of least cost by Levenberg–Marquardt, from a start near the minimum.

    It ends when an undamped step lowers the cost by less than the share `small_gain`. A damped step with little gain is
    no criterion: scale, offset and curve of time of flight are nearly equivalent, and damping hides the small effect of
    the priors that separate them.
    """
    x, damping = start.copy(), _DAMPING
    linear = _linearised(residuals, x)
    for _ in range(_MOST_STEPS):
        normal, cost, gain, first = _normal(residuals, linear), float(linear.r @ linear.r), None, damping
        while gain is None and damping < _MOST_DAMPING:
            moved = x + _step(normal, damping)
            blocks = (
                residuals.color(moved),
                residuals.infrared(moved),
                residuals.depth(moved),
                residuals.priors(moved),
            )
            r = np.concatenate([block.ravel() for block in blocks])
            if np.isfinite(r).all() and r @ r <= cost:
                gain, x, damping = 1 - float(r @ r) / max(cost, 1e-30), moved, max(damping / 10, _LEAST_DAMPING)
            else:
                damping *= 10
        linear = _linearised(residuals, x)
        if gain is None or (gain < small_gain and first == _LEAST_DAMPING):
            break
        damping = _LEAST_DAMPING if gain < small_gain else damping
    return Solution(x, *_covariances(residuals, linear), float(linear.r @ linear.r) / 2)


def _linearised(residuals: Residuals, x: FloatArray) -> _LinearSystem:
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
        parts.append(_LinearSystem(here, by_cameras, by_pose, view))
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
    # Derivatives of depth by its error; those by knots follow from their weights.
    depth, error = parts[2], at["error"]
    knots = error.start + BEFORE_KNOTS
    for k in range(error.start, min(knots, error.stop)):
        moved = x.copy()
        moved[k] += _STEP
        depth.by_cameras[:, k] = (residuals.depth(moved) - depth.r) / _STEP
    if error.stop > knots:
        of_sum = (residuals.depth(x, more=_STEP) - depth.r) / _STEP
        depth.by_cameras[:, knots : error.stop] = residuals.by_knots(x, of_sum, depth.r)
    priors = residuals.priors(x)
    parts.append(
        _LinearSystem(priors, residuals.prior_rows[:, :first], np.zeros((len(priors), _POSE)), np.full(len(priors), -1))
    )
    return _LinearSystem(*(np.concatenate(items) for items in zip(*parts, strict=True)))


def _normal(residuals: Residuals, linear: _LinearSystem) -> _Normal:
    r, J, P, view = linear
    count, size = residuals.model.count, J.shape[1]
    B, D, of_poses = np.zeros((count, size, _POSE)), np.zeros((count, _POSE, _POSE)), np.zeros((count, _POSE))
    for k in range(count):
        rows = view == k
        B[k], D[k], of_poses[k] = J[rows].T @ P[rows], P[rows].T @ P[rows], P[rows].T @ r[rows]
    return _Normal(J.T @ J, B, D, J.T @ r, of_poses)


def _step(normal: _Normal, damping: float) -> FloatArray:
    """The step of all parameters."""
    A = normal.A + damping * np.diag(np.diag(normal.A) + _TINY)
    diagonal = np.einsum("vii->vi", normal.D)
    D = normal.D + damping * diagonal[:, :, None] * np.eye(_POSE) + _TINY * np.eye(_POSE)
    B_over_D = np.linalg.solve(D, normal.B.transpose(0, 2, 1)).transpose(0, 2, 1)
    S = A - (B_over_D @ normal.B.transpose(0, 2, 1)).sum(axis=0)
    g = normal.of_cameras - np.einsum("vgp,vp->g", B_over_D, normal.of_poses)
    of_cameras = -np.linalg.lstsq(S, g, rcond=None)[0]
    of_poses = -np.linalg.solve(D, (normal.of_poses + np.einsum("vgp,g->vp", normal.B, of_cameras))[..., None])
    return np.concatenate([of_cameras, of_poses.ravel()])


def _covariances(residuals: Residuals, linear: _LinearSystem) -> tuple[FloatArray, FloatArray]:
    """Two covariances (g, g): the inverse Hessian, and the jackknife over views.

    Cells of one depth image share errors that their scatter does not show, such as rounding and deviations from curve
    and pattern. So do corners of a bent board. Only views err independently. Each view's part of the reduced normal
    equations gives the solution without it by one Gauss-Newton step; the sum over views of its squared change is the
    jackknife (Efron 1982; MacKinnon & White 1985, HC3, here by cluster: Bell & McCaffrey 2002). It accounts for the
    leverage of a view, which Huber's sandwich does not: with few views that is too small. Priors add their information.
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


def _information(linear: _LinearSystem, view: int) -> FloatArray:
    """Information (g, g) of one view on the cameras, with its pose fixed; of the priors for -1."""
    J = linear.by_cameras[linear.view == view]
    return np.asarray(J.T @ J)


_LEAST_SLOPE = 0.1  # of corrected depth by the reading; no sensor has less


@dataclass(eq=False)
class Residuals:
    """Residuals of a model, prediction minus measurement, block by block, in standard deviations."""

    model: Model
    sigmas: Sigmas

    def __post_init__(self) -> None:
        m = self.model
        self.at = m.slices()
        self.size = self.at["poses"].stop
        self.knot_weights, self.knot_slopes = _weights_of(m)
        constant, quadratic = m.noise
        # For raw disparities in nominal inverse depth, 1/m; else in metres.
        is_raw = m.sensor == RAW_DISPARITY
        self._reading_sigma = quadratic if is_raw else constant + quadratic * m.cells.reading**2
        self._rays: tuple[PinholeCamera | None, FloatArray] = (None, np.empty((0, 2)))
        self._priors = prior_rows(m)

    def color(self, x: FloatArray) -> FloatArray:
        """Residuals of colour corners (N, 2), in σ."""
        p = self._points(x, self.model.color)
        px = self.model.color_camera(x).denormalise(p[:, :2] / p[:, 2:])
        return (px - self.model.color.px) / self.sigmas.color_px

    def infrared(self, x: FloatArray) -> FloatArray:
        """Residuals of infrared corners (N, 2), in σ."""
        if not len(self.model.infrared.px):
            return np.empty((0, 2))
        p = se3.apply(se3.invert(self.model.T_color_depth_of(x)), self._points(x, self.model.infrared))
        px = self.model.depth_camera(x).denormalise(p[:, :2] / p[:, 2:])
        return (px - self.model.infrared.px) / self.sigmas.infrared_px

    def depth(self, x: FloatArray, more: float = 0.0) -> FloatArray:
        """Residuals of depth cells (N,), in σ; `more` is added to the sum over knots."""
        if not len(self.model.cells.px):
            return np.empty(0)
        off_m, sigma_m = self.depth_m(x, more)
        return off_m / sigma_m

    def depth_m(self, x: FloatArray, more: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Distance of cells from the boards' planes along the axis, and their σ, metres (N,)."""
        m = self.model
        camera = m.depth_camera(x)
        if self._rays[0] != camera:
            self._rays = camera, camera.normalise(m.cells.px)
        rays = self._rays[1]
        R, t = m.poses_of(x)
        T = m.T_color_depth_of(x)
        n = R[:, :, 2]
        # The plane n · p = h of the colour camera's frame, in the depth camera's.
        h = (n * t).sum(axis=1) - n @ T[:3, 3]
        n_depth = n @ T[:3, :3]
        view = m.cells.view
        z = h[view] / ((n_depth[view, :2] * rays).sum(axis=1) + n_depth[view, 2])
        true_m, slope = self._true_m(x, rays, more)
        return true_m - z, self.sigmas.depth * self._reading_sigma * slope

    def _true_m(self, x: FloatArray, rays: FloatArray, more: float) -> tuple[FloatArray, FloatArray]:
        """`DepthError.of_readings` of all cells with constant parts cached, and its derivative by the reading.

        Noise is in readings, so a residual over the derivative is that of the reading. The derivative must be complete.
        Without the curve's slope it grows as a line moves from the curve to the scale, which changes no depth:
        thousands of cells then raise the scale by 2 %.
        """
        m, p = self.model, x[self.at["error"]]
        reading, knots = m.cells.reading, p[BEFORE_KNOTS:]
        radius2 = (rays**2).sum(axis=1)
        if m.sensor == "tof":
            scale = float(np.exp(p[0]))
            true_m = scale * reading + p[1] + p[2] * radius2 + self.knot_weights @ knots + more
            return true_m, np.maximum(scale + self.knot_slopes @ knots, _LEAST_SLOPE)
        if m.sensor == "stereo":
            scale, inverse = float(np.exp(p[0])), 1 / reading + p[1]
            return scale / inverse + p[2] * radius2, scale / (inverse * reading) ** 2
        if m.sensor == RAW_DISPARITY:
            q, scale, of_reading = self._inverse_of_raw(p), 1.0, np.full(len(reading), np.exp(p[0]))
            inverse = q
        else:
            q, scale, of_reading = 1 / reading, float(np.exp(p[0])), 1 / reading**2
            inverse = q + p[1]
        fade, steeper = self._fading(p, q)
        inverse = inverse + (self.knot_weights @ knots.reshape(2, -1)[0]) * fade
        inverse = np.maximum(inverse + self.knot_weights @ knots.reshape(2, -1)[1] + more, 1e-3)
        return scale / inverse, scale * of_reading * steeper / inverse**2

    def _fading(self, p: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The factor (N,) of the fading pattern at inverse depths q, and the derivative (N,) of 1/z by q with it."""
        fade_m = float(np.clip(p[2], 0, 10))
        fade = np.exp(fade_m * (q - 1))
        pattern = self.knot_weights @ p[BEFORE_KNOTS:].reshape(2, -1)[0]
        return fade, np.maximum(1 + fade_m * fade * pattern, _LEAST_SLOPE)

    def by_knots(self, x: FloatArray, of_sum: FloatArray, r: FloatArray) -> FloatArray:
        """Derivatives (N, K) of depth's residuals r (N,) by all knots.

        They follow from `of_sum` (N,), the derivatives by the sum over knots, and from the knots' effect on σ.
        """
        weights, p = self.knot_weights, x[self.at["error"]]
        if not self.model.has_pattern:
            slope = np.maximum(float(np.exp(p[0])) + self.knot_slopes @ p[BEFORE_KNOTS:], _LEAST_SLOPE)
            return of_sum[:, None] * weights - (r / slope)[:, None] * self.knot_slopes
        q = 1 / self.model.cells.reading
        if self.model.sensor == RAW_DISPARITY:
            q = self._inverse_of_raw(p)
        fade, steeper = self._fading(p, q)
        of_fading = of_sum * fade - r * float(np.clip(p[2], 0, 10)) * fade / steeper
        return np.concatenate([of_fading[:, None] * weights, of_sum[:, None] * weights], axis=1)

    def _inverse_of_raw(self, p: FloatArray) -> FloatArray:
        m = self.model
        at_zero = -NOMINAL_STEP * DISPARITY_OF_INFINITY + p[1]
        return np.asarray(at_zero + NOMINAL_STEP * np.exp(p[0]) * m.cells.reading)

    def _points(self, x: FloatArray, points: Points) -> FloatArray:
        R, t = self.model.poses_of(x)
        square_m = self.model.square_of(x)
        return np.asarray(np.einsum("nij,nj->ni", R[points.view], square_m * points.square) + t[points.view])

    @property
    def prior_rows(self) -> FloatArray:
        """The derivatives (P, n) of `priors`."""
        return self._priors[0]

    def priors(self, x: FloatArray) -> FloatArray:
        """Residuals of the priors (P,), in σ."""
        rows, expected = self._priors
        return np.asarray(rows @ x - expected)


def _weights_of(model: Model) -> tuple[FloatArray, FloatArray]:
    """The weight (N, K) of each knot of pattern or curve at each cell, and that of the curve's slope.

    Splines in place of lines: between knots 0.25 m apart, the slopes of lines deviate by up to 1 % from a swing of 7 mm
    in 1.9 m, which tilts all boards there alike.
    """
    none = np.zeros((len(model.cells.px), 0))
    if model.has_pattern:
        return cubic_grid_weights(model.cells.px, model.depth_start, model.grid), none
    if model.sensor != "tof" or not len(model.knots_m):
        return none, none
    reading, knots_m = model.cells.reading, model.knots_m
    return cubic_weights(reading, knots_m), cubic_weights(reading, knots_m, derivative=1)


# Priors of the parameters, as rows of a least-squares problem.


_HELD = 1e-6  # standard deviation of a fixed parameter
# Fading of the pattern and its standard deviation. Herrera et al. 2012: exp(-0.0018 d), which is exp(0.6 m / z).
_OF_FADE, _FADE_M = 0.5, 0.5
# Standard deviations of k1, k2 and k3, three times the values of TUM's three Kinects, and of p1 and p2 (0.006 there).
_RADIAL, _TANGENTIAL = (0.3, 1.0, 1.5), 0.01
_ASPECT = 0.003  # of fy / fx: 0.004 for TUM's three Kinects, 0.001 for others
# Of a depth lens without infrared images: share of the focal length (571 to 594 px of 586), and centre of 640 px, of
# published Kinects.
_DEPTH_FOCAL, _DEPTH_CENTRE_PX = 0.02, 15.0
PRIOR_APART_M = 0.1  # between the two cameras; no sensor is wider
# Of a knot of the pattern, 3.5 steps of Kinect v1's disparity, and of its second difference (board of Herrera et al.).
_PATTERN_PER_M, _PATTERN_BEND_PER_M = 0.01, 0.004
# Of time of flight's scale: a quartz is good to 1e-4, a ruler to 0.2 %. Without it scale, offset and curve are
# equivalent. Then of a knot of the curve and its second difference: Kinect v2 swings by 7 mm (Lachat et al. 2015).
_TOF_SCALE, _CURVE_M, _CURVE_BEND_M = 0.002, 0.01, 0.005


def prior_rows(model: Model) -> tuple[FloatArray, FloatArray]:
    """The priors as rows (P, n) and values (P,) in σ: rows @ x is about the values."""
    priors = _Priors(model.slices()["poses"].stop)
    at = model.slices()
    if model.keeps_color:
        for index, value in enumerate(lens_parameters(model.color_start, model.color_start)):
            priors.add([at["color"].start + index], [1], float(value), _HELD)
    else:
        _of_lens(priors, model, at["color"], model.color_start)
    _of_lens(priors, model, at["depth"], model.depth_start, is_nominal=not len(model.infrared.px))
    for k in range(at["apart"].start, min(at["apart"].start + 3, at["apart"].stop)):
        priors.add([k], [1], 0.0, PRIOR_APART_M)
    if at["error"].stop > at["error"].start:
        _of_error(priors, model, at["error"].start)
    return np.array(priors.rows).reshape(-1, priors.size), np.array(priors.values)


class _Priors:
    """Collects rows and values."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.rows: list[FloatArray] = []
        self.values: list[float] = []

    def add(self, columns: list[int], weights: list[float], value: float, sigma: float) -> None:
        """Add the prior of a weighted sum of parameters."""
        row = np.zeros(self.size)
        row[columns] = np.array(weights) / sigma
        self.rows.append(row)
        self.values.append(value / sigma)


def _of_lens(priors: _Priors, model: Model, place: slice, start: PinholeCamera, *, is_nominal: bool = False) -> None:
    """The priors of a lens; `is_nominal` for one without corners of its own, whose prior is `start`."""
    first, length = place.start, place.stop - place.start
    if not length:
        return
    known = lens_parameters(start, start)
    if is_nominal:
        priors.add([first], [1], 0.0, _DEPTH_FOCAL)
    priors.add([first + 1], [1], float(np.log(start.fy / start.fx)), _ASPECT)
    centre = (1.0 if is_nominal else 2.0) * _DEPTH_CENTRE_PX * start.width / 640 / start.fx
    for k in (2, 3):
        priors.add([first + k], [1], float(known[k]), centre)
    bent = [*_RADIAL[:2], _TANGENTIAL, _TANGENTIAL, _RADIAL[2]]
    for k in range(BARE_LENS, length):
        priors.add([first + k], [1], float(known[k]) if is_nominal else 0.0, bent[k - BARE_LENS])


def _of_error(priors: _Priors, model: Model, first: int) -> None:
    knots = first + BEFORE_KNOTS
    if not model.is_scale_free:
        priors.add([first], [1], 0.0, _HELD)
    if model.sensor == "tof":
        priors.add([first], [1], 0.0, _TOF_SCALE)
        for k in range(len(model.knots_m)):
            priors.add([knots + k], [1], 0.0, _CURVE_M)
        for k in range(len(model.knots_m) - 2):
            priors.add([knots + k, knots + k + 1, knots + k + 2], [1, -2, 1], 0.0, _CURVE_BEND_M)
    if not model.has_pattern:
        return
    priors.add([first + 2], [1], _OF_FADE, _FADE_M)
    rows, columns = model.grid
    for number in knots + np.arange(2 * rows * columns).reshape(2, rows, columns):
        for knot in number.ravel().tolist():
            priors.add([knot], [1], 0.0, _PATTERN_PER_M)
        for line in [*number.tolist(), *number.T.tolist()]:
            for three in zip(line, line[1:], line[2:], strict=False):
                priors.add(list(three), [1, -2, 1], 0.0, _PATTERN_BEND_PER_M)


_LENS, _OF_DEPTH = 9, 3
_LEAST_FACTOR = 1e-3
_LEAST_SIGMA_PX = 0.02  # of a corner in images without noise
# A corner or cell of depth farther off is an outlier: one corner in 10⁵ by noise.
_CORNER_SIGMAS, _CELL_SIGMAS = 4.5, 4.0
# A view whose residuals exceed the median view's by this factor has a moved or bent board, or depth of another moment.
_VIEW_FACTOR, _DEPTH_VIEW_FACTOR = 2.5, 4.0
_AS_BAD = 0.8
_LEAST_MEDIAN = 0.3  # in σ; if all views agree better than that, none is an outlier


def sigmas_of(residuals: Residuals, x: FloatArray) -> Sigmas:
    """Standard deviations by the residuals, each corrected for its degrees of freedom."""
    model, before = residuals.model, residuals.sigmas

    def of(r: FloatArray, taken: int) -> float:
        return float(np.sqrt((r**2).sum() / max(r.size - taken, r.size / 4, 1))) if r.size else 1.0

    return Sigmas(
        max(before.color_px * of(residuals.color(x), _POSE * model.count + _LENS), _LEAST_SIGMA_PX),
        max(before.infrared_px * of(residuals.infrared(x), _LENS), _LEAST_SIGMA_PX),
        max(before.depth * of(residuals.depth(x), _OF_DEPTH), _LEAST_FACTOR),
    )


def agreeing(counted: Counted, residuals: Residuals, x: FloatArray) -> Counted:
    """The views, corners and cells that agree with the rest."""
    model = residuals.model
    color, infrared = (np.linalg.norm(block(x), axis=1) for block in (residuals.color, residuals.infrared))
    depth = np.abs(residuals.depth(x))
    gone: dict[int, str] = {}
    for off, view, factor, what in (
        (color, model.color.view, _VIEW_FACTOR, "corners in colour"),
        (infrared, model.infrared.view, _VIEW_FACTOR, "corners in infrared"),
        (depth, model.cells.view, _DEPTH_VIEW_FACTOR, "depth"),
    ):
        # A moved view biases the depth of others, so depth is tested once corners agree.
        for k, times in ({} if gone else _unlike(off, view, model.count, factor)).items():
            gone.setdefault(k, f"its {what} disagree with the other views': {times:.1f} times theirs")
    most = _CORNER_SIGMAS * np.sqrt(2)
    new_color = [_fewer(seen, color[model.color.view == k] <= most) for k, seen in enumerate(counted.color)]
    new_infrared = [
        None if seen is None else _fewer(seen, infrared[model.infrared.view == k] <= most)
        for k, seen in enumerate(counted.infrared)
    ]
    cells = []
    for k, seen_cells in enumerate(counted.cells):
        kept = depth[model.cells.view == k] <= _CELL_SIGMAS
        cells.append(seen_cells.only(kept))
    dropped = _corners(counted.color) + _corners(counted.infrared) - _corners(new_color) - _corners(new_infrared)
    new = replace(
        counted,
        color=tuple(new_color),
        infrared=tuple(new_infrared),
        cells=tuple(cells),
        dropped_corners=counted.dropped_corners + dropped,
        dropped_cells=counted.dropped_cells + len(depth) - sum(len(c.reading) for c in cells),
    )
    return new.without(gone)


def _unlike(off: FloatArray, view: IntArray, count: int, factor: float) -> dict[int, float]:
    """Views whose median exceeds `factor` times that of the usual view, with the ratio."""
    medians = {k: float(np.median(off[view == k])) for k in range(count) if (view == k).any()}
    if not medians:
        return {}
    usual = max(float(np.median(list(medians.values()))), _LEAST_MEDIAN)
    # A bad view biases good ones, which the next round tests again without it.
    least = max(factor * usual, _AS_BAD * max(medians.values()))
    return {k: value / usual for k, value in medians.items() if value > factor * usual and value >= least}


def _fewer(corners: Corners, kept: BoolArray) -> Corners:
    """A view's corners without outliers, if enough remain."""
    enough = np.count_nonzero(kept) >= min(FEWEST_CORNERS, len(kept))
    return corners.only(kept) if enough else corners


def _corners(views: tuple[Corners | None, ...] | list[Corners] | list[Corners | None]) -> int:
    return sum(0 if seen is None else len(seen.ids) for seen in views)
