"""fit_floor: the plane that a camera on a driving robot sees at the same place in all its depth images.

A plane is linear in inverse depth: with q = -n/h of a plane whose upward normal is n, at h below the camera, each ray r
(with z = 1) meets it at 1/z = q·r. So depth noise stands on one side only, and for cameras that measure disparity it is
the same for near and far. Walls pass by and have other normals; tables and seats lie above the floor and come and go;
of planes across the robot's axis of turning, the floor is the lowest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import DepthNoise
from wheelsight.errors import CalibrationError
from wheelsight.geometry import BoolArray, FloatArray, IntArray

_FARTHEST_M = 5.0
_HIGHEST_M, _LEAST_HEIGHT_M = 3.0, 0.05
_BIN_M = 0.04
_PEAK_SHARE = 0.2
_BANDS_M = (0.15, 0.10, 0.06, 0.04, 0.04)
_ROBUST_STEPS = 8
_OUTLIER_CHI2 = 9.0
_FEWEST_POINTS, _FEWEST_VIEWS, _FEWEST_SHARE = 40, 10, 0.25
_BELOW_M, _MOST_BELOW = 0.15, 0.1
_MOST_SWAY_RAD, _MOST_SWAY_M = np.radians(0.6), 0.02
_WORST_CONDITION = 1e6
_MOST_CLUSTERS = 25
_LEAST_SIGMAS = np.array([2e-4, 2e-4, 5e-4])  # no depth camera is better than a hundredth of a degree and half a mm
# Of one view: the sine by which a ray points down, and heights in steps of 8 %, up to ten times less or more.
_STEEP, _BIN_LOG, _RANGE_LOG = 0.2, 0.08, 2.3
_ADVICE = "tilt the camera down, or drive where more floor lies free before it"


@dataclass(frozen=True, eq=False)
class FloorViews:
    """Thinned depth images.

    Attributes:
        stamps_s: (V,) seconds.
        rays: (N, 3) through the pixels kept, with z = 1.
        depth_m: (V, N), 0 where nothing was measured.
    """

    stamps_s: FloatArray
    rays: FloatArray
    depth_m: FloatArray


@dataclass(frozen=True, eq=False)
class Floor:
    """The floor in the camera frame.

    Attributes:
        up_camera: (3,) its upward normal.
        height_m: of the camera over it.
        covariance: (3, 3) of roll and pitch in radians (see `tilt_of`) and height in metres.
        stamps_s: (K,) of the views that show enough of it to tell the plane alone.
        tilts: (K, 3) roll, pitch and height by each of them.
        view_count: of all views.
    """

    up_camera: FloatArray
    height_m: float
    covariance: FloatArray
    stamps_s: FloatArray
    tilts: FloatArray
    view_count: int


def tilt_of(up_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Roll and pitch (...) in radians of a camera that sees up (..., 3) there: leaning right, and looking down."""
    x, y, z = np.moveaxis(np.asarray(up_camera, float), -1, 0)
    return np.arctan2(-x, -y), np.arctan2(-z, np.hypot(x, y))


def fit_floor(views: FloorViews, up_camera: FloatArray, noise: DepthNoise) -> Floor:
    """The floor, from where `up_camera` (3,), the axis of the robot's turns, is right to a few degrees.

    Raises:
        CalibrationError: no view shows a floor, too few do, or what is taken for it lies above much else or sways.
    """
    points = _Points.of(views, noise)
    q = -up_camera / _coarse_height_m(points, up_camera)
    for band_m in _BANDS_M:
        q = points.plane(np.abs(points.off_m(q)) < band_m)
    for _ in range(_ROBUST_STEPS):
        q = points.plane(points.agreement(q))
    agreement = points.agreement(q)
    seen, tilts = _view_by_view(points, q, agreement, len(views.stamps_s))
    _refuse_if_unsteady(tilts, len(views.stamps_s))
    _refuse_if_not_lowest(points, q)
    height_m = float(1 / np.linalg.norm(q))
    covariance = _covariance(points, q, agreement)
    return Floor(-q * height_m, height_m, covariance, views.stamps_s[seen], tilts, len(views.stamps_s))


def height_below(rays: FloatArray, depth_m: FloatArray, up_camera: FloatArray, expected_m: float) -> float | None:
    """How high over the floor a camera is, roughly, by one view and where up is said to be; None where it sees none.

    Rays that are steep tell it even where up is some degrees off.

    Args:
        rays: (N, 3) with z = 1.
        depth_m: (N,), 0 where nothing was measured; its unit may be wrong.
        up_camera: (3,) by the mount.
        expected_m: the height by the mount; searched is from a tenth of that to ten times it.
    """
    down = -(rays @ up_camera)
    is_steep = (down > _STEEP * np.linalg.norm(rays, axis=-1)) & (depth_m > 0)
    logs = np.log(down[is_steep] * depth_m[is_steep] / expected_m)
    counts, edges = np.histogram(logs, np.arange(-_RANGE_LOG, _RANGE_LOG, _BIN_LOG))
    pairs = counts[:-1] + counts[1:]
    many = np.flatnonzero(pairs >= max(_PEAK_SHARE * pairs.max(initial=0), _FEWEST_POINTS))
    if not len(many):
        return None
    lowest = (logs >= edges[many[-1]]) & (logs < edges[many[-1] + 2])
    return float(expected_m * np.exp(np.median(logs[lowest])))


@dataclass(frozen=True, eq=False)
class _Points:
    """Depth readings of all views: view (P,), rays (P, 3), inverse depth (P,) and its standard deviation (P,)."""

    view: IntArray
    rays: FloatArray
    inverse: FloatArray
    sigma: FloatArray

    @classmethod
    def of(cls, views: FloorViews, noise: DepthNoise) -> _Points:
        is_near = (views.depth_m > noise.near_m) & (views.depth_m < min(noise.far_m, _FARTHEST_M))
        view, pixel = np.nonzero(is_near)
        depth_m = views.depth_m[is_near].astype(float)
        return cls(view, views.rays[pixel], 1 / depth_m, noise.sigma_m(depth_m) / depth_m**2)

    def off_m(self, q: FloatArray) -> FloatArray:
        """How far (P,) each point lies above the plane."""
        return np.asarray((self.inverse - self.rays @ q) / self.inverse / np.linalg.norm(q))

    def plane(self, agreement: FloatArray | BoolArray) -> FloatArray:
        """The plane (3,) by least squares, points weighted by their noise and by `agreement` (P,)."""
        H, g = self._equations(agreement / self.sigma**2)
        if np.linalg.matrix_rank(H) < 3 or np.linalg.cond(H) > _WORST_CONDITION:
            raise CalibrationError("what lies below the camera is no plane: no floor is in view", fix=_ADVICE)
        return np.asarray(np.linalg.solve(H, g))

    def agreement(self, q: FloatArray) -> FloatArray:
        """Geman and McClure's weights (P,), as narrow as the spread of what is near the plane; 0 for all else."""
        near = np.abs(self.off_m(q)) < 2 * _BANDS_M[-1]
        r = (self.inverse - self.rays @ q) / self.sigma
        scale = 1.4826 * float(np.median(np.abs(r[near]))) if near.any() else 1.0
        return np.where(near, (_OUTLIER_CHI2 / (_OUTLIER_CHI2 + (r / scale) ** 2)) ** 2, 0.0)

    def _equations(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        weighted = weights[:, None] * self.rays
        return weighted.T @ self.rays, weighted.T @ self.inverse


def _coarse_height_m(points: _Points, up_camera: FloatArray) -> float:
    """Of the heights below the camera at which many points lie, the lowest."""
    below_m = -(points.rays @ up_camera) / points.inverse
    edges = np.arange(_LEAST_HEIGHT_M, _HIGHEST_M, _BIN_M)
    counts, _ = np.histogram(below_m, edges)
    pairs = counts[:-1] + counts[1:]
    many = np.flatnonzero(pairs >= max(_PEAK_SHARE * pairs.max(), _FEWEST_POINTS))
    if not len(many):
        raise CalibrationError("next to no depth lies below the camera: no floor is in view", fix=_ADVICE)
    lowest = (below_m >= edges[many[-1]]) & (below_m < edges[many[-1] + 2])
    return float(np.median(below_m[lowest]))


def _view_by_view(
    points: _Points, q: FloatArray, agreement: FloatArray, view_count: int
) -> tuple[IntArray, FloatArray]:
    """Indices (K,) of the views that tell the plane alone, and roll, pitch and height (K, 3) by each."""
    weights = agreement / points.sigma**2
    H = np.zeros((view_count, 3, 3))
    np.add.at(H, points.view, weights[:, None, None] * points.rays[:, :, None] * points.rays[:, None, :])
    g = np.zeros((view_count, 3))
    np.add.at(g, points.view, (weights * (points.inverse - points.rays @ q))[:, None] * points.rays)
    enough = np.bincount(points.view, agreement > 0.5, minlength=view_count) >= _FEWEST_POINTS
    seen = np.flatnonzero(enough)
    seen = seen[np.linalg.cond(H[seen]) < _WORST_CONDITION]
    planes = q + np.linalg.solve(H[seen], g[seen][..., None])[..., 0]
    return seen, _tilts(planes)


def _tilts(q: FloatArray) -> FloatArray:
    """Roll, pitch and height (..., 3) of planes (..., 3)."""
    size = np.linalg.norm(q, axis=-1)
    return np.stack([*tilt_of(-q), 1 / size], axis=-1)


def _covariance(points: _Points, q: FloatArray, agreement: FloatArray) -> FloatArray:
    """Covariance (3, 3) of roll, pitch and height: the inverse Hessian on both sides of the gradient's spread.

    The gradient is summed over runs of neighbouring views, which share how the robot sways and what stands about.
    """
    weights = agreement / points.sigma**2
    H = (weights[:, None] * points.rays).T @ points.rays
    gradient = (weights * (points.inverse - points.rays @ q))[:, None] * points.rays
    cluster = points.view * _MOST_CLUSTERS // (int(points.view.max()) + 1)
    sums = np.stack([np.bincount(cluster, column, minlength=_MOST_CLUSTERS) for column in gradient.T], axis=-1)
    groups = len(np.unique(cluster))
    inverse = np.linalg.inv(H)
    spread = inverse @ (sums.T @ sums) @ inverse * groups / max(groups - 3, 1)
    steps = 1e-6 * np.linalg.norm(q) * np.eye(3)
    J = np.stack([(_tilts(q + h) - _tilts(q - h)) / (2 * h.max()) for h in steps], axis=-1)
    return np.asarray(J @ spread @ J.T + np.diag(_LEAST_SIGMAS**2))


def _refuse_if_not_lowest(points: _Points, q: FloatArray) -> None:
    off_m = points.off_m(q)
    below, on = np.count_nonzero(off_m < -_BELOW_M), np.count_nonzero(np.abs(off_m) < _BANDS_M[-1])
    if below > _MOST_BELOW * on:
        raise CalibrationError(
            f"much lies below the lowest plane in sight, {1 / np.linalg.norm(q):.2f} m under the camera: "
            "no floor is in view",
            fix=_ADVICE,
        )


def _refuse_if_unsteady(tilts: FloatArray, view_count: int) -> None:
    if len(tilts) < max(_FEWEST_VIEWS, _FEWEST_SHARE * view_count):
        raise CalibrationError(f"only {len(tilts)} of {view_count} views show enough floor to tell it", fix=_ADVICE)
    sway = 1.4826 * np.median(np.abs(tilts - np.median(tilts, axis=0)), axis=0)
    if max(sway[:2]) > _MOST_SWAY_RAD or sway[2] > _MOST_SWAY_M:
        raise CalibrationError(
            f"the floor sways by {np.degrees(max(sway[:2])):.1f}° and {100 * sway[2]:.0f} cm from view to view",
            fix="fix the camera to the robot, and drive on level ground",
        )
