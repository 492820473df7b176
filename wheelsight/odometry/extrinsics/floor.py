"""fit_floor: the plane that a camera on a driving robot sees at the same place in all its depth images.

A plane is linear in inverse depth: with q = -n/h of a plane whose upward normal is n, at h below the camera, each ray r
(with z = 1) meets it at 1/z = q·r. So depth noise stands on one side only, and for cameras that measure disparity it is
the same for near and far. Walls pass by and have other normals; tables and seats lie above the floor and come and go;
of planes across the robot's axis of turning, the floor is the lowest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wheelsight.calibration import DepthNoise
from wheelsight.errors import CalibrationError
from wheelsight.geometry import BoolArray, FloatArray, IntArray
from wheelsight.odometry.extrinsics.settings import DEFAULTS, FloorSettings

_WORST_CONDITION = 1e6  # of equations that tell a plane
_MOST_CLUSTERS = 25  # of views in a row, by whose spread the covariance is told
_LEAST_SIGMAS = np.array([2e-4, 2e-4, 5e-4])  # no depth camera is better than a hundredth of a degree and half a mm
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
        covariance: (3, 3) of roll and pitch in radians (see `tilt_of`) and height in metres, as depth scatters.
        points_m: (N, 3) of it, in the camera frame, one for each pixel that shows it.
        weights: (N,) of these, 1/m²: what all views tell of it there, in inverse depth.
        stamps_s: (K,) of the views that show enough of it to tell the plane alone.
        tilts: (K, 3) roll, pitch and height by each of them.
        view_count: of all views.
    """

    up_camera: FloatArray
    height_m: float
    covariance: FloatArray
    points_m: FloatArray
    weights: FloatArray
    stamps_s: FloatArray
    tilts: FloatArray
    view_count: int

    def by_camera(self, moved_m: FloatArray) -> FloatArray:
        """Covariance (3, 3) as `covariance`, of errors of the camera that move its points by `moved_m` (K, N, 3).

        Each moves the plane as far as it moves inverse depths off it: by -q · δ / z, with q = -n/h.
        """
        q, z = -self.up_camera / self.height_m, self.points_m[:, 2]
        rays = self.points_m / z[:, None]
        weighted = self.weights[:, None] * rays
        moved_q = np.linalg.solve(weighted.T @ rays, weighted.T @ -(moved_m @ q / z).T).T
        shifts = moved_q @ _derivatives(q).T
        return np.asarray(shifts.T @ shifts)


def tilt_of(up_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Roll and pitch (...) in radians of a camera that sees up (..., 3) there: leaning right, and looking down."""
    x, y, z = np.moveaxis(np.asarray(up_camera, float), -1, 0)
    return np.arctan2(-x, -y), np.arctan2(-z, np.hypot(x, y))


def fit_floor(
    views: FloorViews, up_camera: FloatArray, noise: DepthNoise, settings: FloorSettings = DEFAULTS.floor
) -> Floor:
    """The floor, from where `up_camera` (3,), the axis of the robot's turns, is right to a few degrees.

    Raises:
        CalibrationError: no view shows a floor, too few do, or what is taken for it lies above much else or sways.
    """
    points = _Points.of(views, noise, settings)
    q = -up_camera / _coarse_height_m(points, up_camera)
    for band_m in settings.bands_m:
        q = points.plane(np.abs(points.off_m(q)) < band_m)
    for _ in range(settings.robust_steps):
        q = points.plane(points.agreement(q))
    agreement = points.agreement(q)
    seen, tilts = _view_by_view(points, q, agreement, len(views.stamps_s))
    _refuse_if_unsteady(tilts, len(views.stamps_s), settings)
    _refuse_if_not_lowest(points, q)
    height_m = float(1 / np.linalg.norm(q))
    covariance = _covariance(points, q, agreement)
    points_m, weights = points.by_pixel(q, agreement)
    return Floor(
        -q * height_m, height_m, covariance, points_m, weights, views.stamps_s[seen], tilts, len(views.stamps_s)
    )


def height_below(
    rays: FloatArray,
    depth_m: FloatArray,
    up_camera: FloatArray,
    expected_m: float,
    settings: FloorSettings = DEFAULTS.floor,
) -> float | None:
    """How high over the floor a camera is, roughly, by one view and where up is said to be; None where it sees none.

    Rays that are steep tell it even where up is some degrees off. A wall that fills the view has a lowest row, too, but
    does not lie level there.

    Args:
        rays: (N, 3) with z = 1.
        depth_m: (N,), 0 where nothing was measured; its unit may be wrong.
        up_camera: (3,) by the mount.
        expected_m: the height by the mount; searched is from a tenth of that to ten times it.
        settings: of one view.
    """
    down = -(rays @ up_camera)
    is_steep = (down > settings.steep * np.linalg.norm(rays, axis=-1)) & (depth_m > 0)
    logs = np.log(down[is_steep] * depth_m[is_steep] / expected_m)
    counts, edges = np.histogram(logs, np.arange(-settings.range_log, settings.range_log, settings.bin_log))
    pairs = counts[:-1] + counts[1:]
    many = np.flatnonzero(pairs >= max(settings.peak_share * pairs.max(initial=0), settings.fewest_points))
    if not len(many):
        return None
    lowest = (logs >= edges[many[-1]]) & (logs < edges[many[-1] + 2])
    if not _is_level(rays[is_steep][lowest], depth_m[is_steep][lowest], up_camera, settings):
        return None
    return float(expected_m * np.exp(np.median(logs[lowest])))


def _is_level(rays: FloatArray, depth_m: FloatArray, up_camera: FloatArray, settings: FloorSettings) -> bool:
    """Whether the plane through points lies more as a floor does than as a wall; in any unit of depth."""
    q = np.linalg.lstsq(rays, 1 / depth_m)[0]
    return bool(-(q @ up_camera) > math.cos(math.radians(settings.steepest_deg)) * np.linalg.norm(q))


@dataclass(frozen=True, eq=False)
class _Points:
    """Depth readings of all views: view, pixel and inverse depth (P,), its standard deviation (P,) and rays (P, 3).

    `settings` say which of them count.
    """

    view: IntArray
    pixel: IntArray
    rays: FloatArray
    inverse: FloatArray
    sigma: FloatArray
    settings: FloorSettings

    @classmethod
    def of(cls, views: FloorViews, noise: DepthNoise, settings: FloorSettings) -> _Points:
        is_near = (views.depth_m > noise.near_m) & (views.depth_m < min(noise.far_m, settings.farthest_m))
        view, pixel = np.nonzero(is_near)
        depth_m = views.depth_m[is_near].astype(float)
        return cls(view, pixel, views.rays[pixel], 1 / depth_m, noise.sigma_m(depth_m) / depth_m**2, settings)

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
        near = np.abs(self.off_m(q)) < 2 * self.settings.bands_m[-1]
        r = (self.inverse - self.rays @ q) / self.sigma
        scale = 1.4826 * float(np.median(np.abs(r[near]))) if near.any() else 1.0
        chi2 = self.settings.outlier_chi2
        return np.where(near, (chi2 / (chi2 + (r / scale) ** 2)) ** 2, 0.0)

    def by_pixel(self, q: FloatArray, agreement: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (N, 3) of the plane, metres, where views agree with it, and weights (N,) of all views."""
        first, number = np.unique(self.pixel, return_index=True, return_inverse=True)[1:]
        weights = np.bincount(number, agreement / self.sigma**2).astype(float)
        rays = self.rays[first]
        inverse = rays @ q
        shown = (weights > 0) & (inverse > 0)
        return rays[shown] / inverse[shown, None], weights[shown]

    def _equations(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        weighted = weights[:, None] * self.rays
        return weighted.T @ self.rays, weighted.T @ self.inverse


def _coarse_height_m(points: _Points, up_camera: FloatArray) -> float:
    """Of the heights below the camera at which many points lie, the lowest."""
    below_m = -(points.rays @ up_camera) / points.inverse
    settings = points.settings
    edges = np.arange(settings.least_height_m, settings.highest_m, settings.bin_m)
    counts, _ = np.histogram(below_m, edges)
    pairs = counts[:-1] + counts[1:]
    many = np.flatnonzero(pairs >= max(settings.peak_share * pairs.max(), settings.fewest_points))
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
    enough = np.bincount(points.view, agreement > 0.5, minlength=view_count) >= points.settings.fewest_points
    seen = np.flatnonzero(enough)
    seen = seen[np.linalg.cond(H[seen]) < _WORST_CONDITION]
    planes = q + np.linalg.solve(H[seen], g[seen][..., None])[..., 0]
    return seen, _tilts(planes)


def _tilts(q: FloatArray) -> FloatArray:
    """Roll, pitch and height (..., 3) of planes (..., 3)."""
    size = np.linalg.norm(q, axis=-1)
    return np.stack([*tilt_of(-q), 1 / size], axis=-1)


def _derivatives(q: FloatArray) -> FloatArray:
    """Of roll, pitch and height by the plane: (3, 3)."""
    steps = 1e-6 * np.linalg.norm(q) * np.eye(3)
    return np.stack([(_tilts(q + h) - _tilts(q - h)) / (2 * h.max()) for h in steps], axis=-1)


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
    J = _derivatives(q)
    return np.asarray(J @ spread @ J.T + np.diag(_LEAST_SIGMAS**2))


def _refuse_if_not_lowest(points: _Points, q: FloatArray) -> None:
    settings, off_m = points.settings, points.off_m(q)
    below, on = np.count_nonzero(off_m < -settings.below_m), np.count_nonzero(np.abs(off_m) < settings.bands_m[-1])
    if below > settings.most_below * on:
        raise CalibrationError(
            f"much lies below the lowest plane in sight, {1 / np.linalg.norm(q):.2f} m under the camera: "
            "no floor is in view",
            fix=_ADVICE,
        )


def _refuse_if_unsteady(tilts: FloatArray, view_count: int, settings: FloorSettings) -> None:
    if len(tilts) < max(settings.fewest_views, settings.fewest_share * view_count):
        raise CalibrationError(f"only {len(tilts)} of {view_count} views show enough floor to tell it", fix=_ADVICE)
    sway = 1.4826 * np.median(np.abs(tilts - np.median(tilts, axis=0)), axis=0)
    if max(sway[:2]) > np.radians(settings.most_sway_deg) or sway[2] > settings.most_sway_m:
        raise CalibrationError(
            f"the floor sways by {np.degrees(max(sway[:2])):.1f}° and {100 * sway[2]:.0f} cm from view to view",
            fix="fix the camera to the robot, and drive on level ground",
        )
