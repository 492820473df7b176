"""fit_mount: where a camera sits on its robot, seen from above, by the motions of wheels and camera.

For each piece of a drive A·X = X·B holds, with A the base's motion by the wheels, B the camera's, and X the mount. On a
floor, with the camera levelled, it is (R(θ) - 1) t + p = R(ψ) c: turns θ show where the camera sits (t), straight ways
where it looks (ψ). That is linear in t and R(ψ); from there, wheel sizes and the clocks' delay are fitted along with
the mount, robustly, so that a wheel 2 % too small does not spoil it. So is how far the robot slides outwards in bends,
for which it would look as if the camera sat further back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wheelsight.calibration import Wheels
from wheelsight.geometry import BoolArray, FloatArray, se3
from wheelsight.odometry._robust_fit import UNKNOWN_SIGMA, RobustFitSettings, robust_fit, spread
from wheelsight.odometry.extrinsics.settings import DEFAULTS, MountSettings
from wheelsight.odometry.wheels.drive import Drive
from wheelsight.odometry.wheels.reference_errors import covariance_by
from wheelsight.odometry.wheels.segments import Segments, cut
from wheelsight.trajectory import Trajectory

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
        self.sideways = _sideways(base, segments.end_s - segments.start_s)

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


def _sideways(base: FloatArray, seconds: FloatArray) -> ComplexArray:
    """Where a robot (M,) comes to slide outwards, as x + iy in metres for a slide of one second, by motions (M, 3)."""
    x, y, turn_rad = base.T
    middle = np.exp(0.5j * turn_rad)
    along_m = ((x + 1j * y) / middle).real
    return np.asarray(-1j * along_m * turn_rad / seconds * middle)
