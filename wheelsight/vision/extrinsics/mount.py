"""Parts of a camera's mount: position and yaw by hand-eye calibration, the vertical axis by turns, and roll, pitch
and height by the floor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wheelsight.core.calibration_parts import DepthNoise, Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3, so3
from wheelsight.core.robust_fit import UNKNOWN_SIGMA, RobustFitSettings, robust_fit, spread
from wheelsight.core.trajectory import Trajectory
from wheelsight.vision.extrinsics.settings import DEFAULTS, FloorSettings, MountSettings, TurningSettings
from wheelsight.wheels.calibration import covariance_by
from wheelsight.wheels.drive import Drive, Segments, cut, yaw_at_readings

# fit_mount: where a camera sits on its robot, seen from above, by the motions of wheels and camera.
#
# For each piece of a drive A·X = X·B holds, with A the base's motion by the wheels, B the camera's, and X the mount.
# On a floor, with the camera levelled, it is (R(θ) - 1) t + p = R(ψ) c: turns θ show where the camera sits (t),
# straight ways where it looks (ψ). That is linear in t and R(ψ); from there, wheel sizes and the clocks' delay are
# fitted along with the mount, robustly, so that a wheel 2 % too small does not spoil it. So is how far the robot
# slides outwards in bends, for which it would look as if the camera sat further back.


ComplexArray = NDArray[np.complex128]

# Odometry by images is biased by as much, which no residual shows: found on simulated drives.
_LEAST_SIGMAS = np.array([1e-3, 1e-3, 1e-3, 5e-3, 2e-3, 2e-3, 1e-3, 1e-4])
# Of all that is fitted, but for the delay, which no robot exceeds.
_BOUNDS = np.array([np.log(2.0)] * 3 + [3.0, 3.0, 1.0, np.nan, 0.2])


@dataclass(frozen=True, eq=False)
class MountFit:
    """A camera's place seen from above, and what was fitted along with it.

    Attributes:
        mount: (3,) x, y in metres and yaw in radians of T_base_level (see `levelled`).
        wheels: with the sizes and delay found; sizes only as this drive and the camera's own scale tell them.
        slide_s: speed outwards in a bend over its acceleration inwards: of tyres that creep, a few milliseconds.
        covariance: (8, 8) of the logarithms of left and right radius and track width, of x, y, yaw, delay and slide,
            as far as the drive tells them.
        by_camera: (8, 8) the same by what the camera's calibration leaves open.
        segments: pieces of the camera's way.
        residuals: (M, 3) of wheels and mount, along and across each in metres, yaw in radians.
        is_slip: (M,) pieces whose residual is beyond what one in a thousand would show without a slip.
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
        """Standard deviations (4,) of x, y, yaw and delay, as far as the drive tells them."""
        return np.sqrt(np.diag(self.covariance)[3:7])

    @property
    def spread(self) -> FloatArray:
        """Robust standard deviation (3,) of the residuals."""
        return spread(self.residuals)


def level_rotation(up_camera: FloatArray) -> FloatArray:
    """R_camera_level (3, 3) of a frame with z up, x as the camera looks; looking straight down, as its image's top."""
    ahead = np.array([0.0, 0.0, 1.0]) if abs(up_camera[2]) < 0.98 else np.array([0.0, np.sign(up_camera[2]), 0.0])
    x = ahead - (ahead @ up_camera) * up_camera
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up_camera, x), up_camera], axis=-1)


def levelled(camera: Trajectory, up_camera: FloatArray) -> Trajectory:
    """T_map_level of a frame that sits where the camera does, from T_map_camera."""
    T_camera_level = se3.from_parts(level_rotation(up_camera), np.zeros(3))
    return Trajectory(camera.stamps_s, camera.T_frame_body @ T_camera_level, body="base")


def cut_level(drive: Drive, wheels: Wheels, level: Trajectory, settings: MountSettings = DEFAULTS.mount) -> Segments:
    """The pieces to be explained. Raises CalibrationError where readings and frames share no time."""
    longest_s = settings.largest_delay_s + abs(wheels.delay_s)
    return cut(drive, level, wheels, settings.segment_m, longest_s, settings.segment_rad)


def fit_mount(
    drive: Drive,
    wheels: Wheels,
    segments: Segments,
    delay_s: float,
    settings: MountSettings = DEFAULTS.mount,
    fit: RobustFitSettings = DEFAULTS.fit,
    camera_errors: FloatArray | None = None,
) -> MountFit:
    """The mount for which the wheels explain most pieces of the camera's way.

    Args:
        drive: the wheels' readings.
        wheels: nominal ones, right to a few hundredths or so.
        segments: from `cut_level`, with turns and straight ways.
        delay_s: of the wheels' stamps, right to a few hundredths of a second.
        settings: of the mount.
        fit: what counts as a disagreement.
        camera_errors: (K, 3, 3) of the levelled camera, see `camera_errors.motion_errors`; None for none.
    """
    problem = _Problem(drive, wheels, segments, delay_s, settings)
    found = robust_fit(problem, np.zeros(len(_BOUNDS)), fit)
    left_m, right_m, track_m = problem.sizes_m(found.values).tolist()
    fitted = replace(
        wheels,
        left_radius_m=left_m,
        right_radius_m=right_m,
        track_width_m=track_m,
        delay_s=problem.delay_s(found.values),
    )
    mount = problem.mount(found.values)
    covariance = _larger(found.covariance, found.if_independent) + np.diag(_LEAST_SIGMAS**2)
    by_camera = covariance_by(problem, found, np.zeros((0, 3, 3)) if camera_errors is None else camera_errors, fit)
    explained = (segments, found.residuals, found.is_outlier)
    return MountFit(mount, fitted, float(found.values[7]), covariance, by_camera, *explained)


def closed_form(base: FloatArray, level: FloatArray) -> FloatArray:
    """x, y, yaw (3,) of T_base_level from motions (M, 3) of the base and of the levelled camera, by least squares.

    The rotation's size is left free: it takes up what the wheels' scale is wrong by.
    """
    p, c = base[:, :2] @ np.array([1, 1j]), level[:, :2] @ np.array([1, 1j])
    turn = np.exp(1j * level[:, 2]) - 1
    # Complex: p = a·c - turn·t, with a of R(ψ) and t of the place; the scale is shared by both.
    a, t = np.linalg.lstsq(np.stack([c, -turn], axis=-1), p)[0]
    size = max(abs(a), 1e-9)
    return np.array([t.real / size, t.imag / size, np.angle(a)])


def _larger(a: FloatArray, b: FloatArray) -> FloatArray:
    """The covariance (P, P) that is in no direction smaller than either of two.

    The scatter of a few turns may by chance be small; by chance it is not believed to be so.
    """
    L = np.linalg.cholesky(b)
    inverse = np.linalg.inv(L)
    values, directions = np.linalg.eigh(inverse @ a @ inverse.T)
    across = L @ directions
    return np.asarray((across * np.maximum(values, 1.0)) @ across.T)


class _Problem:
    """Residuals as a function of what is sought: logarithms of sizes over nominal, mount and delay over their start."""

    def __init__(
        self, drive: Drive, wheels: Wheels, segments: Segments, delay_s: float, settings: MountSettings
    ) -> None:
        self.drive, self.segments, self.start_delay_s = drive, segments, delay_s
        self.nominal_m = np.array([wheels.left_radius_m, wheels.right_radius_m, wheels.track_width_m])
        base = segments.predicted(drive, self.nominal_m, delay_s, np.zeros(3))
        self.start_mount = closed_form(base, segments.motions)
        self.bounds = _BOUNDS.copy()
        self.bounds[6] = 2 * settings.largest_delay_s
        self.prior_sigmas = np.full(len(_BOUNDS), UNKNOWN_SIGMA)
        self.prior_sigmas[7] = settings.slide_sigma_s
        x, y, turn_rad = base.T
        middle = np.exp(0.5j * turn_rad)
        along_m = ((x + 1j * y) / middle).real
        self.sideways = np.asarray(-1j * along_m * turn_rad / (segments.end_s - segments.start_s) * middle)

    def sizes_m(self, values: FloatArray) -> FloatArray:
        return np.asarray(self.nominal_m * np.exp(values[:3]))

    def mount(self, values: FloatArray) -> FloatArray:
        return np.asarray(self.start_mount + values[3:6])

    def delay_s(self, values: FloatArray) -> float:
        return self.start_delay_s + float(values[6])

    def residuals(self, values: FloatArray) -> FloatArray:
        """(M, 3) in metres, metres, radians."""
        mount = self.mount(values)
        motions = self.segments.predicted(self.drive, self.sizes_m(values), self.delay_s(values), mount)
        slid = values[7] * self.sideways * np.exp(-1j * mount[2])
        motions[:, :2] += np.stack([slid.real, slid.imag], axis=-1)
        return self.segments.residuals(motions)


# common_turning: which way is up for the camera, and how late the wheels' clock is, by turns that both have seen.
#
# A robot on a floor turns about the floor's normal only. Seen from the camera, all its turns therefore have one axis,
# and their sizes are those of the wheels: the axis and the delay for which they agree best are found together.


@dataclass(frozen=True, eq=False)
class Turning:
    """What the turns say.

    Attributes:
        up_camera: (3,) the axis about which left turns go, of length 1, in the camera frame.
        delay_s: of the wheels' stamps against the camera's, to 20 ms, within ±`largest_offset_s` of the nominal one.
        agreement: 0 to 1, the correlation of the camera's turns about that axis with the wheels'.
    """

    up_camera: FloatArray
    delay_s: float
    agreement: float


def common_turning(
    drive: Drive, wheels: Wheels, camera: Trajectory, settings: TurningSettings = DEFAULTS.turning
) -> Turning:
    """The axis and delay for which the turns of `camera` (T_map_camera) and of the wheels agree best.

    Turns that share no time with the readings, at a delay, have no say in it; where fewer than half do, the delay is
    not considered. Without turns the agreement is 0.
    """
    marks = (
        np.floor((camera.stamps_s - camera.stamps_s[:1]) / settings.interval_s) if len(camera.stamps_s) else np.zeros(0)
    )
    cuts = np.flatnonzero(np.diff(marks, prepend=-1) > 0)
    start, end = cuts[:-1], cuts[1:]
    whole = camera.stamps_s[end] - camera.stamps_s[start] <= settings.longest_interval_s
    start, end = start[whole], end[whole]
    turns = so3.log(se3.invert(camera.T_frame_body[start])[:, :3, :3] @ camera.T_frame_body[end, :3, :3])
    steps = round(settings.largest_offset_s / settings.step_s)
    turned_rad = yaw_at_readings(drive, wheels)
    best = Turning(np.array([0.0, -1.0, 0.0]), wheels.delay_s, 0.0)
    for delay_s in wheels.delay_s + settings.step_s * np.arange(-steps, steps + 1):
        begin_s, until_s = camera.stamps_s[start] + delay_s, camera.stamps_s[end] + delay_s
        inside = (begin_s >= drive.stamps_s[0]) & (until_s <= drive.stamps_s[-1])
        if np.count_nonzero(inside) < max(1.0, settings.fewest_share * len(start)):
            continue
        ends_rad = (np.interp(stamps_s[inside], drive.stamps_s, turned_rad) for stamps_s in (until_s, begin_s))
        yaw_rad = np.subtract(*ends_rad)
        axis = yaw_rad @ turns[inside]
        size = float(np.sqrt(np.sum(yaw_rad**2) * np.sum(turns[inside] ** 2)))
        agreement = float(np.linalg.norm(axis)) / size if size > 0 else 0.0
        if agreement > best.agreement:
            best = Turning(axis / np.linalg.norm(axis), float(delay_s), agreement)
    return best


# fit_floor: the plane that a camera on a driving robot sees at the same place in all its depth images.
#
# A plane is linear in inverse depth: with q = -n/h of a plane whose upward normal is n, at h below the camera, each
# ray r (with z = 1) meets it at 1/z = q·r. So depth noise stands on one side only, and for cameras that measure
# disparity it is the same for near and far. Walls pass by and have other normals; tables and seats lie above the
# floor and come and go; of planes across the robot's axis of turning, the floor is the lowest.


_WORST_CONDITION = 1e6  # of equations that tell a plane
_MOST_CLUSTERS = 25  # of views in a row, by whose spread the covariance is told
_FLOOR_LEAST_SIGMAS = np.array(
    [2e-4, 2e-4, 5e-4]
)  # no depth camera is better than a hundredth of a degree and half a mm
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
    q = np.linalg.lstsq(rays[is_steep][lowest], 1 / depth_m[is_steep][lowest])[0]
    if not bool(-(q @ up_camera) > math.cos(math.radians(settings.steepest_deg)) * np.linalg.norm(q)):
        return None
    return float(expected_m * np.exp(np.median(logs[lowest])))


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
        weighted = (agreement / self.sigma**2)[:, None] * self.rays
        H, g = weighted.T @ self.rays, weighted.T @ self.inverse
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
    return np.asarray(J @ spread @ J.T + np.diag(_FLOOR_LEAST_SIGMAS**2))


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
