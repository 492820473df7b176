"""Parts of a camera's mount: position and yaw by hand-eye calibration, the vertical axis by turns, and roll, pitch
and height by the floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wheelsight.core.calibration_parts import DepthNoise, Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3, so3
from wheelsight.core.settings.calibration import FloorRangeSettings
from wheelsight.core.trajectory import Trajectory
from wheelsight_calibration.parameters import LARGEST_DELAY_S, MOUNT_BY_DRIVE, DriveProblem
from wheelsight_calibration.solver import larger, robust_fit, spread
from wheelsight_calibration.wheel_drive import Segments, WheelDrive, cut, sizes_m, yaw_at_readings

# Hand-eye calibration in the plane. For each piece of a drive A·X = X·B holds, with A the base's motion by the wheels,
# B the camera's, and X the mount. On a floor, with a levelled camera, it is (R(θ) - 1) t + p = R(ψ) c: rotations θ
# determine the position t, straight motion the yaw ψ. The closed form is linear in t and R(ψ). From there a robust fit
# estimates mount, wheel sizes, clock delay and outward slide in bends together, because wrong sizes and slide bias t.


ComplexArray = NDArray[np.complex128]

# A piece of a drive ends after this distance or rotation, long relative to the camera's noise; chosen.
_SEGMENT_M, _SEGMENT_RAD = 0.3, 0.25
# Bias of visual odometry that residuals do not show; measured on simulated drives.
_LEAST_SIGMAS = np.array([1e-3, 1e-3, 1e-3, 5e-3, 2e-3, 2e-3, 1e-3, 1e-4])


@dataclass(frozen=True, eq=False)
class MountFit:
    """The planar mount of a camera, and the parameters fitted with it.

    Attributes:
        mount: (3,) x, y in metres and yaw in radians of T_base_level (see `levelled`).
        wheels: with the estimated sizes and delay; sizes relative to the scale of the camera.
        slide_s: outward speed in a bend divided by the inward acceleration; a few milliseconds for creeping tyres.
        covariance: (8, 8) of the logarithms of left and right radius and track width, of x, y, yaw, delay and slide,
            by the scatter of this drive.
        by_camera: (8, 8) the same by errors of the camera's calibration.
        segments: pieces of the camera's trajectory.
        residuals: (M, 3) of wheels and mount, along and across each piece in metres, yaw in radians.
        is_slip: (M,) pieces whose residual exceeds that of one in a thousand without slip.
    """

    mount: FloatArray
    wheels: Wheels
    slide_s: float
    covariance: FloatArray
    by_camera: FloatArray
    segments: Segments
    residuals: FloatArray
    is_slip: BoolArray

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations (4,) of x, y, yaw and delay, by the scatter of this drive."""
        return np.sqrt(np.diag(self.covariance)[3:7])

    @property
    def spread(self) -> FloatArray:
        """Robust standard deviation (3,) of the residuals."""
        return spread(self.residuals)


def level_rotation(up_camera: FloatArray) -> FloatArray:
    """R_camera_level (3, 3) of a frame with z up and x along the optical axis; along the image's top if vertical."""
    ahead = np.array([0.0, 0.0, 1.0]) if abs(up_camera[2]) < 0.98 else np.array([0.0, np.sign(up_camera[2]), 0.0])
    x = ahead - (ahead @ up_camera) * up_camera
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up_camera, x), up_camera], axis=-1)


def levelled(camera: Trajectory, up_camera: FloatArray) -> Trajectory:
    """The trajectory T_map_level of the levelled camera, from T_map_camera."""
    T_camera_level = se3.from_parts(level_rotation(up_camera), np.zeros(3))
    return Trajectory(camera.stamps_s, camera.T_frame_body @ T_camera_level, body="base")


def cut_level(drive: WheelDrive, wheels: Wheels, level: Trajectory) -> Segments:
    """The pieces of a drive. Raises CalibrationError if readings and frames do not overlap in time."""
    return cut(drive, level, wheels, _SEGMENT_M, LARGEST_DELAY_S + abs(wheels.delay_s), _SEGMENT_RAD)


def fit_mount(
    drive: WheelDrive, wheels: Wheels, segments: Segments, delay_s: float, camera_errors: FloatArray | None = None
) -> MountFit:
    """Fit the planar mount robustly to the motions of wheels and camera.

    Args:
        drive: the wheels' readings.
        wheels: nominal wheels, correct to a few percent.
        segments: from `cut_level`, with turns and straight motion.
        delay_s: initial delay of the wheels' stamps, correct to a few hundredths of a second.
        camera_errors: (K, 3, 3) of the levelled camera, see `camera_errors.motion_errors`; None for none.
    """
    base = segments.predicted(drive, sizes_m(wheels), delay_s, np.zeros(3))
    x, y, turn_rad = base.T
    middle = np.exp(0.5j * turn_rad)
    along_m = ((x + 1j * y) / middle).real
    sideways = np.asarray(-1j * along_m * turn_rad / (segments.end_s - segments.start_s) * middle)
    start = closed_form(base, segments.motions)
    problem = DriveProblem(MOUNT_BY_DRIVE, drive, segments, wheels, delay_s, start, sideways)
    found = robust_fit(problem, np.zeros(len(MOUNT_BY_DRIVE)))
    # The scatter of a few turns may be small by chance.
    covariance = larger(found.covariance, found.if_independent) + np.diag(_LEAST_SIGMAS**2)
    by_camera = problem.covariance_by(found, np.zeros((0, 3, 3)) if camera_errors is None else camera_errors)
    explained = (segments, found.residuals, found.is_outlier)
    return MountFit(
        problem.mount(found.values),
        problem.fitted(found.values),
        float(found.values[7]),
        covariance,
        by_camera,
        *explained,
    )


def closed_form(base: FloatArray, level: FloatArray) -> FloatArray:
    """x, y, yaw (3,) of T_base_level from motions (M, 3) of the base and of the levelled camera, by least squares.

    The size of the rotation is free and absorbs the scale error of the wheels.
    """
    p, c = base[:, :2] @ np.array([1, 1j]), level[:, :2] @ np.array([1, 1j])
    turn = np.exp(1j * level[:, 2]) - 1
    # Complex: p = a·c - turn·t, with a of R(ψ) and t of the place; the scale is shared by both.
    a, t = np.linalg.lstsq(np.stack([c, -turn], axis=-1), p)[0]
    size = max(abs(a), 1e-9)
    return np.array([t.real / size, t.imag / size, np.angle(a)])


# Largest offset between the clocks, and the step of the search for it, which fits refine; chosen.
_LARGEST_OFFSET_S, _OFFSET_STEP_S = 10.0, 0.02
# Interval over which rotations are compared; longer ones than the second figure hide a gap. Chosen.
_INTERVAL_S, _LONGEST_INTERVAL_S = 0.25, 1.0
_FEWEST_INTERVALS = 0.5  # share of the intervals that must lie within the time of the readings


@dataclass(frozen=True, eq=False)
class Turning:
    """The vertical axis and the clock delay by the rotations of wheels and camera.

    Attributes:
        up_camera: (3,) unit axis of left turns in the camera frame.
        delay_s: of the wheels' stamps behind the camera's, to 20 ms, within ±10 s of the nominal one.
        agreement: 0 to 1, the correlation of the camera's turns about that axis with the wheels'.
    """

    up_camera: FloatArray
    delay_s: float
    agreement: float


def common_turning(drive: WheelDrive, wheels: Wheels, camera: Trajectory) -> Turning:
    """The axis and delay for which the rotations of `camera` (T_map_camera) and of the wheels agree best.

    A robot on a floor rotates about the floor's normal only, so all rotations of the camera have one axis, and their
    angles are those of the wheels. Rotations outside the time of the readings are ignored; a delay is skipped if too
    few remain. Without rotations the agreement is 0.
    """
    marks = np.floor((camera.stamps_s - camera.stamps_s[:1]) / _INTERVAL_S) if len(camera.stamps_s) else np.zeros(0)
    cuts = np.flatnonzero(np.diff(marks, prepend=-1) > 0)
    start, end = cuts[:-1], cuts[1:]
    whole = camera.stamps_s[end] - camera.stamps_s[start] <= _LONGEST_INTERVAL_S
    start, end = start[whole], end[whole]
    turns = so3.log(se3.invert(camera.T_frame_body[start])[:, :3, :3] @ camera.T_frame_body[end, :3, :3])
    steps = round(_LARGEST_OFFSET_S / _OFFSET_STEP_S)
    turned_rad = yaw_at_readings(drive, wheels)
    best = Turning(np.array([0.0, -1.0, 0.0]), wheels.delay_s, 0.0)
    for delay_s in wheels.delay_s + _OFFSET_STEP_S * np.arange(-steps, steps + 1):
        begin_s, until_s = camera.stamps_s[start] + delay_s, camera.stamps_s[end] + delay_s
        inside = (begin_s >= drive.stamps_s[0]) & (until_s <= drive.stamps_s[-1])
        if np.count_nonzero(inside) < max(1.0, _FEWEST_INTERVALS * len(start)):
            continue
        ends_rad = (np.interp(stamps_s[inside], drive.stamps_s, turned_rad) for stamps_s in (until_s, begin_s))
        yaw_rad = np.subtract(*ends_rad)
        axis = yaw_rad @ turns[inside]
        size = float(np.sqrt(np.sum(yaw_rad**2) * np.sum(turns[inside] ** 2)))
        agreement = float(np.linalg.norm(axis)) / size if size > 0 else 0.0
        if agreement > best.agreement:
            best = Turning(axis / np.linalg.norm(axis), float(delay_s), agreement)
    return best


# The floor is the lowest plane across the robot's rotation axis that all depth images show at the same place. A plane
# is linear in inverse depth: with q = -n/h for upward normal n and distance h below the camera, a ray r (with z = 1)
# meets it at 1/z = q·r. Noise then enters on one side only, and is uniform for cameras that measure disparity.


_WORST_CONDITION = 1e6  # of the normal equations of a plane
_MOST_CLUSTERS = 25  # of consecutive views, whose spread gives the covariance
# No depth camera is better than a hundredth of a degree and half a mm.
_FLOOR_LEAST_SIGMAS = np.array([2e-4, 2e-4, 5e-4])
# Least height of a camera over the floor, the bins of the histogram of heights, and the share of its largest bin that a
# floor must reach; chosen.
_LEAST_HEIGHT_M, _BIN_M, _PEAK_SHARE = 0.05, 0.04, 0.2
# Bands around the plane, narrowed step by step (chosen), the number of reweighted fits after that, and χ² of an
# outlier, three standard deviations.
_BANDS_M, _ROBUST_STEPS, _OUTLIER_CHI2 = (0.15, 0.10, 0.06, 0.04, 0.04), 8, 9.0
# Points of the plane in a view, and views that show it, also as a share of all views; chosen.
_FEWEST_POINTS, _FEWEST_VIEWS, _FEWEST_VIEW_SHARE = 40, 10, 0.25
# Below the plane by this distance lies no noise of it; with more points there than this share of those on it, the plane
# is a table. Chosen.
_BELOW_M, _MOST_BELOW = 0.15, 0.1
_MOST_SWAY_DEG, _MOST_SWAY_M = 0.6, 0.02  # between views; a loose camera has more
_ADVICE = "tilt the camera down, or drive where more floor lies free before it"


@dataclass(frozen=True, eq=False)
class FloorDepths:
    """Subsampled depth images.

    Attributes:
        stamps_s: (V,) seconds.
        rays: (N, 3) through the sampled pixels, with z = 1.
        depth_m: (V, N), 0 where nothing was measured.
    """

    stamps_s: FloatArray
    rays: FloatArray
    depth_m: FloatArray


@dataclass(frozen=True, eq=False)
class FloorFit:
    """The floor in the camera frame.

    Attributes:
        up_camera: (3,) its upward normal.
        height_m: of the camera over it.
        covariance: (3, 3) of roll and pitch in radians (see `tilt_of`) and height in metres, as depth scatters.
        points_m: (N, 3) of it, in the camera frame, one for each pixel that shows it.
        weights: (N,) of these points in the fit, summed over all views, for inverse depth.
        stamps_s: (K,) of the views that determine the plane alone.
        tilts: (K, 3) roll, pitch and height by each of these views.
        view_count: number of all views.
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
        """Covariance (3, 3), as `covariance`, by errors of the camera that move its points by `moved_m` (K, N, 3).

        An error δ changes inverse depth relative to the plane by -q · δ / z, with q = -n/h.
        """
        q, z = -self.up_camera / self.height_m, self.points_m[:, 2]
        rays = self.points_m / z[:, None]
        weighted = self.weights[:, None] * rays
        moved_q = np.linalg.solve(weighted.T @ rays, weighted.T @ -(moved_m @ q / z).T).T
        shifts = moved_q @ _derivatives(q).T
        return np.asarray(shifts.T @ shifts)


def tilt_of(up_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Roll (positive right) and pitch (positive down) (...) in radians of a camera from its upward axis (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(up_camera, float), -1, 0)
    return np.arctan2(-x, -y), np.arctan2(-z, np.hypot(x, y))


def fit_floor(
    views: FloorDepths, up_camera: FloatArray, noise: DepthNoise, settings: FloorRangeSettings | None = None
) -> FloorFit:
    """Fit the floor to all views; `up_camera` (3,), the axis of the robot's turns, is correct to a few degrees.

    Raises:
        CalibrationError: too few views show a floor, the plane is not the lowest, or it varies between views.
    """
    settings, view_count = settings or FloorRangeSettings(), len(views.stamps_s)
    is_near = (views.depth_m > noise.near_m) & (views.depth_m < min(noise.far_m, settings.farthest_m))
    view, pixel = np.nonzero(is_near)
    depth_m = views.depth_m[is_near].astype(float)
    points = _FloorPoints(view, pixel, views.rays[pixel], 1 / depth_m, noise.sigma_m(depth_m) / depth_m**2)
    # The lowest peak of the histogram of heights below the camera.
    below_m = -(points.rays @ up_camera) / points.inverse
    edges = np.arange(_LEAST_HEIGHT_M, settings.highest_m, _BIN_M)
    counts, _ = np.histogram(below_m, edges)
    pairs = counts[:-1] + counts[1:]
    many = np.flatnonzero(pairs >= max(_PEAK_SHARE * pairs.max(), _FEWEST_POINTS))
    if not len(many):
        raise CalibrationError("hardly any depth lies below the camera: no floor is in view", fix=_ADVICE)
    lowest = (below_m >= edges[many[-1]]) & (below_m < edges[many[-1] + 2])
    q = -up_camera / float(np.median(below_m[lowest]))
    for band_m in _BANDS_M:
        q = points.plane(np.abs(points.off_m(q)) < band_m)
    for _ in range(_ROBUST_STEPS):
        q = points.plane(points.agreement(q))
    agreement = points.agreement(q)
    # Roll, pitch and height by each view that determines the plane alone.
    weights = agreement / points.sigma**2
    of_view, g = np.zeros((view_count, 3, 3)), np.zeros((view_count, 3))
    np.add.at(of_view, points.view, weights[:, None, None] * points.rays[:, :, None] * points.rays[:, None, :])
    np.add.at(g, points.view, (weights * (points.inverse - points.rays @ q))[:, None] * points.rays)
    seen = np.flatnonzero(np.bincount(points.view, agreement > 0.5, minlength=view_count) >= _FEWEST_POINTS)
    seen = seen[np.linalg.cond(of_view[seen]) < _WORST_CONDITION]
    tilts = _tilts(q + np.linalg.solve(of_view[seen], g[seen][..., None])[..., 0])
    if len(tilts) < max(_FEWEST_VIEWS, _FEWEST_VIEW_SHARE * view_count):
        raise CalibrationError(f"only {len(tilts)} of {view_count} views show enough floor", fix=_ADVICE)
    sway = 1.4826 * np.median(np.abs(tilts - np.median(tilts, axis=0)), axis=0)
    if max(sway[:2]) > np.radians(_MOST_SWAY_DEG) or sway[2] > _MOST_SWAY_M:
        raise CalibrationError(
            f"the floor sways by {np.degrees(max(sway[:2])):.1f}° and {100 * sway[2]:.0f} cm from view to view",
            fix="fix the camera to the robot, and drive on level ground",
        )
    off_m, height_m = points.off_m(q), float(1 / np.linalg.norm(q))
    if np.count_nonzero(off_m < -_BELOW_M) > _MOST_BELOW * np.count_nonzero(np.abs(off_m) < _BANDS_M[-1]):
        problem = f"much lies below the lowest plane in sight, {height_m:.2f} m under the camera: no floor is in view"
        raise CalibrationError(problem, fix=_ADVICE)
    on_floor = points.by_pixel(q, agreement)
    covariance = points.covariance(q, agreement)
    return FloorFit(-q * height_m, height_m, covariance, *on_floor, views.stamps_s[seen], tilts, view_count)


@dataclass(frozen=True, eq=False)
class _FloorPoints:
    """Depth readings of all views: view, pixel and inverse depth (P,), its standard deviation (P,) and rays (P, 3)."""

    view: IntArray
    pixel: IntArray
    rays: FloatArray
    inverse: FloatArray
    sigma: FloatArray

    def off_m(self, q: FloatArray) -> FloatArray:
        """Height (P,) of each point above the plane."""
        return np.asarray((self.inverse - self.rays @ q) / self.inverse / np.linalg.norm(q))

    def plane(self, agreement: FloatArray | BoolArray) -> FloatArray:
        """The plane (3,) by least squares, with points weighted by noise and by `agreement` (P,)."""
        weighted = (agreement / self.sigma**2)[:, None] * self.rays
        H, g = weighted.T @ self.rays, weighted.T @ self.inverse
        if np.linalg.matrix_rank(H) < 3 or np.linalg.cond(H) > _WORST_CONDITION:
            raise CalibrationError("the points below the camera form no plane: no floor is in view", fix=_ADVICE)
        return np.asarray(np.linalg.solve(H, g))

    def agreement(self, q: FloatArray) -> FloatArray:
        """Geman–McClure weights (P,), scaled by the spread of points near the plane; 0 for all others."""
        near = np.abs(self.off_m(q)) < 2 * _BANDS_M[-1]
        r = (self.inverse - self.rays @ q) / self.sigma
        scale = 1.4826 * float(np.median(np.abs(r[near]))) if near.any() else 1.0
        return np.where(near, (_OUTLIER_CHI2 / (_OUTLIER_CHI2 + (r / scale) ** 2)) ** 2, 0.0)

    def by_pixel(self, q: FloatArray, agreement: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (N, 3) of the plane, metres, where views agree with it, and weights (N,) of all views."""
        first, number = np.unique(self.pixel, return_index=True, return_inverse=True)[1:]
        weights = np.bincount(number, agreement / self.sigma**2).astype(float)
        rays = self.rays[first]
        inverse = rays @ q
        shown = (weights > 0) & (inverse > 0)
        return rays[shown] / inverse[shown, None], weights[shown]

    def covariance(self, q: FloatArray, agreement: FloatArray) -> FloatArray:
        """Covariance (3, 3) of roll, pitch and height by the sandwich estimator.

        The gradient is summed over runs of neighbouring views, whose errors correlate.
        """
        weights = agreement / self.sigma**2
        H = (weights[:, None] * self.rays).T @ self.rays
        gradient = (weights * (self.inverse - self.rays @ q))[:, None] * self.rays
        cluster = self.view * _MOST_CLUSTERS // (int(self.view.max()) + 1)
        sums = np.stack([np.bincount(cluster, column, minlength=_MOST_CLUSTERS) for column in gradient.T], axis=-1)
        groups = len(np.unique(cluster))
        inverse = np.linalg.inv(H)
        spread = inverse @ (sums.T @ sums) @ inverse * groups / max(groups - 3, 1)
        J = _derivatives(q)
        return np.asarray(J @ spread @ J.T + np.diag(_FLOOR_LEAST_SIGMAS**2))


def _tilts(q: FloatArray) -> FloatArray:
    """Roll, pitch and height (..., 3) of planes (..., 3)."""
    size = np.linalg.norm(q, axis=-1)
    return np.stack([*tilt_of(-q), 1 / size], axis=-1)


def _derivatives(q: FloatArray) -> FloatArray:
    """Derivatives (3, 3) of roll, pitch and height with respect to the plane."""
    steps = 1e-6 * np.linalg.norm(q) * np.eye(3)
    return np.stack([(_tilts(q + h) - _tilts(q - h)) / (2 * h.max()) for h in steps], axis=-1)
