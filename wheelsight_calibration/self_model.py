"""Parameters of a robot's self-calibration, with priors: lens and depth of the camera, its mount, wheels, clock, gyro.

`RobotModel` is linear in the camera's parameters: each displaces the points of a depth image by a known amount.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration, DepthError, PointErrors
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.camera_errors import moved_in_camera_m
from wheelsight.core.depth_errors import knot_weights, mode_of
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.estimation import ErrorStateSettings
from wheelsight_calibration.camera_model import cubic_grid_weights
from wheelsight_calibration.parameters import Parameter, stated

SENSORS = ("structured-light", "tof", "stereo")

# σ of a time-of-flight camera's depth at 3 m is some millimetres, that of a disparity over a centimetre.
_PROBE_M, _TOF_SIGMA_M = 3.0, 0.006
_GRID = 4, 5  # rows and columns of the smooth part of a disparity's error; Kinect v1's is alike over 80 px of 640
_FILE_GRID = 13, 17  # knots of a file's pattern, which is linear between them
_FADE_M = 0.7  # of the near part; Herrera et al. 2012, as the boards' calibrations of freiburg's Kinects have it
_CURVE_M = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5)  # knots of a time of flight's curve (Lachat et al. 2015)

# Standard deviations of what no board measured, beside `depth_errors.NOMINAL_ERRORS`. Half a step of a Kinect's
# disparity, 0.0014 1/m, at each knot, twice as much near by in the corners (Herrera et al. 2012: 1 and 1.5 steps);
# 7 mm of a time of flight's curve and 2 cm of its corners (Lachat et al. 2015). Shares of these remain after a board.
_KNOT_PER_M, _NEAR_PER_M, _CURVE_SIGMA_M, _RADIAL_SIGMA_M, _AFTER_BOARD = 0.0014, 0.004, 0.007, 0.02, 0.2
# Mount by a ruler, and one that a drive measured.
_RULER_M, _RULER_RAD, _MEASURED_M, _MEASURED_RAD = 0.01, float(np.radians(1.0)), 0.004, float(np.radians(0.25))
_DELAY_SIGMA_S, _SLIDE_SIGMA_S, _GYRO_SCALE_SIGMA = 0.02, 0.02, 0.01
_MAP_SCALE_SIGMA = 0.03  # of the map's edges, which the former calibration made
_BOUND = 10.0  # of a parameter, in σ of its prior; a value beyond three is said

# Bias that residuals do not show, by the beginnings of names; from the errors on three simulated units.
_LEAST_SIGMAS = {
    "focal_length": 0.005, "centre": 0.004, "depth_scale": 0.004, "depth_pattern": 3e-4, "depth_curve": 0.003,
    "depth_near": 0.001, "roll": 0.0015, "pitch": 0.002, "yaw": 0.003, "x": 0.006, "y": 0.006, "height": 0.006,
    "left_radius": 0.0015, "right_radius": 0.0015, "track_width": 0.002, "delay_s": 0.003, "gyro_bias": 3e-4,
}  # fmt: skip

MOUNT = ("roll", "pitch", "yaw", "x", "y", "height")
WHEELS = ("left_radius", "right_radius", "track_width", "delay_s", "slide_s")
GYRO = ("gyro_bias", "gyro_scale")


def sensor_of(calibration: Calibration) -> str:
    """Return how depth is measured, one of `SENSORS`: by the form of the known depth error, else by the noise."""
    error = calibration.depth_error
    is_tof = bool(error.curve_m) or error.offset_m != 0 or error.radial_m != 0
    is_disparity = bool(error.pattern_per_m or error.lasting_per_m) or error.inverse_per_m != 0
    if is_tof and is_disparity:
        fix = "calibrate it by a board: wheelsight calibrate camera"
        raise CalibrationError("field depth_error mixes terms of time of flight and of disparity", fix=fix)
    if is_disparity or error.is_of_disparity:
        return "structured-light"
    return "tof" if is_tof or calibration.depth_noise.sigma_m(_PROBE_M) < _TOF_SIGMA_M else "structured-light"


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Parameters about one calibration, in one vector: changes of its values, 0 for none.

    Attributes:
        calibration: that the map was made with.
        sensor: one of `SENSORS`.
        has_mount, has_wheels, has_gyro: which parts the data concern.
        prior: (P, P) covariance.
        names: of all parameters, those of the camera first.
        camera_count: number of these.
    """

    calibration: Calibration
    sensor: str
    has_mount: bool
    has_wheels: bool
    has_gyro: bool
    prior: FloatArray
    names: tuple[str, ...]
    camera_count: int

    @classmethod
    def of(
        cls,
        calibration: Calibration,
        *,
        has_wheels: bool,
        has_gyro: bool,
        is_mount_measured: bool = False,
        sensor: str | None = None,
    ) -> RobotModel:
        """Return the model of a robot. Raises CalibrationError for a depth error of mixed kinds."""
        sensor = sensor or sensor_of(calibration)
        has_mount = calibration.T_base_camera is not None
        has_wheels = has_wheels and has_mount and calibration.wheels is not None
        has_gyro = has_gyro and has_mount
        names = _camera_names(sensor)
        camera_count = len(names)
        names += ("map_scale",)
        names += MOUNT if has_mount else ()
        names += WHEELS if has_wheels else ()
        names += GYRO if has_gyro else ()
        model = cls(calibration, sensor, has_mount, has_wheels, has_gyro, np.eye(len(names)), names, camera_count)
        return replace(model, prior=model._priors(is_mount_measured))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Each parameter with its bound and prior, as `parameters` has those of other calibrations."""
        sigmas = np.sqrt(np.diag(self.prior)).tolist()
        return tuple(Parameter(name, _BOUND * s, s) for name, s in zip(self.names, sigmas, strict=True))

    @property
    def least_sigmas(self) -> FloatArray:
        """(P,) standard deviations of errors that residuals do not show."""
        found = np.zeros(len(self))
        for k, name in enumerate(self.names):
            found[k] = next((sigma for start, sigma in _LEAST_SIGMAS.items() if name.startswith(start)), 0.0)
        return found

    def index(self, name: str) -> int:
        """Return the place of a parameter. Raises ValueError for an unknown one."""
        return self.names.index(name)

    def displacements(self, rays: FloatArray, depth_m: FloatArray) -> FloatArray:
        """Return the derivatives (N, 3, C) of points by the camera's parameters: rays (N, 3) with z = 1, depth (N,)."""
        depth = self.depth_changes(rays, depth_m)
        aside = np.zeros((len(rays), 3, self.camera_count))
        aside[:, :2, 0] = rays[:, :2] * depth_m[:, None]
        aside[:, 0, 1] = aside[:, 1, 2] = depth_m
        return np.asarray(aside + rays[:, :, None] * depth[:, None, :])

    def depth_changes(self, rays: FloatArray, depth_m: FloatArray) -> FloatArray:
        """Return the derivatives (N, C) of corrected depth by the camera's parameters."""
        _, camera = self.calibration.cameras
        z = np.asarray(depth_m, float)
        columns = [np.zeros((len(z), 3)), z[:, None]]
        if self.sensor == "tof":
            radius2 = (rays[:, :2] ** 2).sum(axis=1)
            columns += [np.ones((len(z), 1)), radius2[:, None], _hats(z)]
        else:
            px = camera.denormalise(rays[:, :2])
            # Of inverse depth; a part that fades is bowl-shaped, as structured light's is.
            near = self._near_shape(rays[:, :2]) * np.exp(_FADE_M * (1 / z - 1))
            of_inverse = np.concatenate([cubic_grid_weights(px, camera, _GRID), near[:, None]], axis=1)
            columns.append(-(z[:, None] ** 2) * of_inverse)
        return np.concatenate(columns, axis=1)

    def depth_gains(self, rays: FloatArray, depth_m: FloatArray) -> FloatArray:
        """Return how the derivatives (N, C) of corrected depth grow with the reading, 1/m."""
        step_m = 0.01
        further, nearer = (self.depth_changes(rays, depth_m + sign * step_m) for sign in (1, -1))
        return np.asarray((further - nearer) / (2 * step_m))

    def _near_shape(self, xy: FloatArray) -> FloatArray:
        """(N,) squared radius over that of the image's corner, less its mean."""
        _, camera = self.calibration.cameras
        corner = ((camera.width / camera.fx / 2) ** 2) + ((camera.height / camera.fy / 2) ** 2)
        return np.asarray((xy**2).sum(axis=1) / corner - 1 / 3)

    def _priors(self, is_mount_measured: bool) -> FloatArray:
        prior = np.zeros((len(self), len(self)))
        camera = slice(0, self.camera_count)
        prior[camera, camera] = self._camera_prior()
        sigmas: dict[str, float] = dict.fromkeys(
            ("roll", "pitch", "yaw"), _MEASURED_RAD if is_mount_measured else _RULER_RAD
        )
        sigmas |= dict.fromkeys(("x", "y", "height"), _MEASURED_M if is_mount_measured else _RULER_M)
        sigmas |= {"delay_s": _DELAY_SIGMA_S, "slide_s": _SLIDE_SIGMA_S, "gyro_scale": _GYRO_SCALE_SIGMA}
        sigmas["map_scale"] = _MAP_SCALE_SIGMA
        sigmas["gyro_bias"] = float(self.calibration.gyro.bias_sigma_rad_s) or 1e-4
        for name, sigma in sigmas.items():
            if name in self.names:
                prior[self.index(name), self.index(name)] = sigma**2
        if self.has_wheels:
            assert self.calibration.wheels is not None
            scale, drift, turn = _wheel_sigmas(self.calibration.wheels)
            half = drift * self.calibration.wheels.track_width_m / 2
            parts = np.array([[scale, -half, 0.0], [scale, half, 0.0], [0.0, 0.0, turn]])
            at = slice(self.index("left_radius"), self.index("left_radius") + 3)
            prior[at, at] = parts @ parts.T
        return prior

    def _camera_prior(self) -> FloatArray:
        """(C, C): by the calibration's point errors, nominal ones if it has none, and what these do not hold."""
        is_known = self.calibration.point_errors is not None
        share = _AFTER_BOARD if is_known else 1.0
        if self.sensor == "tof":
            depth = [0.0, 0.0, _RADIAL_SIGMA_M, *[_CURVE_SIGMA_M] * len(_CURVE_M)]
        else:
            depth = [0.0, *[_KNOT_PER_M] * (_GRID[0] * _GRID[1]), _NEAR_PER_M]
        rough = share * np.array([0.0, 0.0, 0.0, *depth])
        least = np.array([1e-4, 1e-4, 1e-4, 2e-4, *[1e-5] * (self.camera_count - 4)])
        points_m = self.sample_points_m()
        moved_m = moved_in_camera_m(self.calibration, points_m)
        J = self.displacements(points_m / points_m[:, 2:], points_m[:, 2]) / points_m[:, 2, None, None]
        J = J.reshape(-1, self.camera_count)
        unit = np.maximum(rough, 0.1 * _nominal_size(self.sensor, self.camera_count))
        H = (J * unit).T @ (J * unit)
        ridge = 1e-6 * np.trace(H) * np.eye(self.camera_count)
        g = (J * unit).T @ (moved_m / points_m[:, 2, None]).reshape(len(moved_m), -1).T
        found = unit[:, None] * np.linalg.solve(H + ridge, g)
        return np.asarray(found @ found.T + np.diag(rough**2 + least**2))

    def sample_points_m(self) -> FloatArray:
        """Return points (N, 3) all over the image at distances of 0.8 to 4 m, in the camera frame."""
        _, camera = self.calibration.cameras
        u, v = np.meshgrid(np.linspace(0, camera.width - 1, 9), np.linspace(0, camera.height - 1, 7))
        xy = camera.normalise(np.stack([u.ravel(), v.ravel()], axis=-1))
        rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
        return np.concatenate([rays * z for z in (0.8, 1.2, 2.0, 3.0, 4.0)])

    def mount(self, values: FloatArray) -> FloatArray:
        """Return T_base_camera (4, 4). Raises ValueError without mount."""
        T = self.calibration.T_base_camera
        assert T is not None
        at = self.index("roll")
        v = values[at : at + 6]
        moved = np.array(T, float)
        moved[:3, :3] = so3.exp(v[:3]) @ T[:3, :3]
        moved[:3, 3] += v[3:]
        return moved

    def wheels(self, values: FloatArray) -> Wheels:
        """Return the wheels with these sizes and this delay."""
        wheels = self.calibration.wheels
        assert wheels is not None
        at = self.index("left_radius")
        left, right, track, delay_s = values[at : at + 4].tolist()
        return replace(
            wheels,
            left_radius_m=wheels.left_radius_m * float(np.exp(left)),
            right_radius_m=wheels.right_radius_m * float(np.exp(right)),
            track_width_m=wheels.track_width_m * float(np.exp(track)),
            delay_s=wheels.delay_s + delay_s,
        )

    def depth_error(self, values: FloatArray) -> DepthError:
        """Return the known depth error with the found change after it."""
        old, c = self.calibration.depth_error, values[: self.camera_count]
        scale = float(np.exp(c[3]))
        if self.sensor == "tof":
            old_m, old_added = np.array(old.curve_m or [(0.0, 0.0)]).T
            knots = sorted({*old_m.tolist(), *_CURVE_M})
            added = scale * np.interp(knots, old_m, old_added) + np.interp(knots, _CURVE_M, c[6:])
            curve = tuple(zip(knots, added.tolist(), strict=True))
            offset_m, radial_m = (scale * a + b for a, b in ((old.offset_m, c[4]), (old.radial_m, c[5])))
            numbers: dict[str, Any] = {"offset_m": float(offset_m), "radial_m": float(radial_m), "curve_m": curve}
            return replace(old, scale=old.scale * scale, **numbers)
        _, camera = self.calibration.cameras
        rows, columns = _FILE_GRID
        v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
        px = np.stack([u.ravel() * (camera.width - 1), v.ravel() * (camera.height - 1)], axis=-1)
        # Of inverse depth after the known correction, whose scale stands before it.
        lasting = old.scale * (cubic_grid_weights(px, camera, _GRID) @ c[4:-1]).reshape(rows, columns)
        near = old.scale * (c[-1] * self._near_shape(camera.normalise(px))).reshape(rows, columns)
        fade_m = old.fade_m if old.pattern_per_m else _FADE_M
        return replace(
            old,
            scale=old.scale * scale,
            fade_m=fade_m,
            lasting_per_m=_added(old.lasting_per_m, lasting),
            pattern_per_m=_added(old.pattern_per_m, near),
        )

    def lens(self, camera: PinholeCamera, values: FloatArray) -> PinholeCamera:
        """Return a lens with the found changes of focal length and centre."""
        stretch, x, y = values[:3].tolist()
        # A pixel's ray becomes ray · (1 + stretch) + shift.
        fx, fy = camera.fx / (1 + stretch), camera.fy / (1 + stretch)
        return replace(camera, fx=fx, fy=fy, cx=camera.cx - x * fx, cy=camera.cy - y * fy)

    def calibrated(self, values: FloatArray, covariance: FloatArray) -> Calibration:
        """Return the calibration with these values; wheels and points with standard deviations by (P, P)."""
        color, depth = self.calibration.cameras
        parts: dict[str, Any] = {"depth": self.lens(depth, values), "depth_error": self.depth_error(values)}
        parts["color"] = parts["depth"] if self.calibration.is_registered else color
        parts["point_errors"] = self.point_errors(covariance)
        if self.has_mount:
            parts["T_base_camera"] = self.mount(values)
        if self.has_wheels:
            parts["wheels"] = self._stated(self.wheels(values), covariance)
        if self.has_gyro:
            at, gyro = self.index("gyro_bias"), self.calibration.gyro
            sigma = max(float(np.sqrt(covariance[at, at])), 1e-5)
            bias = gyro.bias_rad_s + float(values[at])
            # Temperature moves the bias from day to day by more than a drive's σ; chosen: a tenth of the nominal one.
            parts["gyro"] = replace(gyro, bias_rad_s=bias, bias_sigma_rad_s=max(sigma, 0.1 * gyro.bias_sigma_rad_s))
        return replace(self.calibration, **parts)

    def _stated(self, wheels: Wheels, covariance: FloatArray) -> Wheels:
        at = self.index("left_radius")
        C = covariance[at : at + 3, at : at + 3]
        ratio = np.array([-1.0, 1.0, 0.0])
        mean = np.array([0.5, 0.5, 0.0])
        ratio_sigma, scale = float(np.sqrt(ratio @ C @ ratio)), float(np.sqrt(mean @ C @ mean))
        return stated(wheels, ratio_sigma, float(np.sqrt(C[2, 2])), scale)

    def point_errors(self, covariance: FloatArray) -> PointErrors:
        """Return the modes of the points' remaining error by a covariance (P, P); of the largest ones."""
        C = covariance[: self.camera_count, : self.camera_count]
        points_m = self.sample_points_m()
        J = self.displacements(points_m / points_m[:, 2:], points_m[:, 2])
        values, directions = np.linalg.eigh(C)
        modes = (directions * np.sqrt(np.maximum(values, 0))).T
        moved_m = np.einsum("npc,kc->knp", J, modes)
        size = np.linalg.norm(moved_m.reshape(len(modes), -1), axis=1)
        largest = np.argsort(-size)[: min(len(modes), 20)]
        T = self.calibration.T_color_camera
        in_color = moved_m[largest] @ T[:3, :3].T
        found = mode_of(se3.apply(T, points_m), in_color)
        return PointErrors(tuple(tuple(mode) for mode in found.tolist()))

    def depth_at(self, depths_m: FloatArray) -> FloatArray:
        """Return the derivatives (D, C) of the mean corrected depth over the image, at distances (D,)."""
        points_m = self.sample_points_m()
        rays = points_m[: len(points_m) // 5] / points_m[: len(points_m) // 5, 2:]
        return np.stack([self.depth_changes(rays, np.full(len(rays), z)).mean(axis=0) for z in depths_m.tolist()])


def _camera_names(sensor: str) -> tuple[str, ...]:
    lens = ("focal_length", "centre_x", "centre_y", "depth_scale")
    if sensor == "tof":
        return (*lens, "depth_offset", "depth_radial", *(f"depth_curve_{z:g}m" for z in _CURVE_M))
    knots = (f"depth_pattern_{row}{column}" for row in range(_GRID[0]) for column in range(_GRID[1]))
    return (*lens, *knots, "depth_near")


def _nominal_size(sensor: str, count: int) -> FloatArray:
    """(C,) typical sizes, which condition a fit."""
    depth = [0.02, 0.01, _RADIAL_SIGMA_M, *[_CURVE_SIGMA_M] * len(_CURVE_M)]
    if sensor != "tof":
        depth = [0.02, *[_KNOT_PER_M] * (count - 5), _NEAR_PER_M]
    return np.array([0.015, 0.014, 0.014, *depth])


def _hats(z: FloatArray) -> FloatArray:
    """(N, K) weights of the curve's knots, linear between them and constant beyond."""
    return np.stack([np.interp(z, _CURVE_M, unit) for unit in np.eye(len(_CURVE_M))], axis=-1)


def _wheel_sigmas(wheels: Wheels) -> tuple[float, float, float]:
    usual = ErrorStateSettings()
    return (
        wheels.scale_sigma or usual.scale_sigma,
        wheels.drift_sigma_rad_per_m or usual.drift_sigma_rad_per_m,
        wheels.turn_sigma or usual.turn_sigma,
    )


def _added(rows: tuple[tuple[float, ...], ...], change: FloatArray) -> tuple[tuple[float, ...], ...]:
    """Return the sum of a file's pattern and a change (rows, columns), on the grid of the finer one."""
    if not rows:
        return tuple(tuple(row) for row in change.tolist())
    old = np.array(rows)
    shape = max(old.shape[0], change.shape[0]), max(old.shape[1], change.shape[1])
    total = _resampled(old, shape) + _resampled(change, shape)
    return tuple(tuple(row) for row in total.tolist())


def _resampled(grid: FloatArray, shape: tuple[int, int]) -> FloatArray:
    down, across = (knot_weights(np.linspace(0, 1, n), old) for n, old in zip(shape, grid.shape, strict=True))
    return np.asarray(down @ grid @ across.T)
