"""What a depth camera's own errors make of true depth, before noise: they stay the same for one unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from wheelsight.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight.simulation.view import View

_GRID = 8, 6  # knots across and down of what is not radial: a scale of 80 px, as the mean residuals have it


class DepthDistortion(Protocol):
    """Turns true depth into the depth that a unit would measure without noise."""

    def distorted(self, view: View) -> Float32Array:
        """(H, W) depth in metres, 0 where there is none."""
        ...


@dataclass(frozen=True, slots=True)
class DisparityDistortionSettings:
    """Kinect v1: an error of the disparity that depends on the place in the image and fades with distance.

    The model is that of Herrera, Kannala & Heikkilä, "Joint depth and color camera calibration with distortion
    correction", TPAMI 34 (2012), eq. 6: a pattern over the image times an exponential of the disparity. Its numbers
    were measured on their data set of one Kinect (`kinect_v1_herrera_board`): planes fitted to the raw disparities of
    six images of a wall, 0.9 to 2.2 m away, that fills them. Residuals have a deviation of 1.5 steps at 0.9 m (4 mm),
    1.0 at 2.2 m (14 mm), rounding included.

    Attributes:
        radii: of rays from the optical axis, for which `near_steps` and `far_steps` stand.
        near_steps: mean residual at `near_m` along them, in steps of disparity, 1/8 px of the native image.
        far_steps: the same of what does not fade.
        near_m, fade_m: what is near fades by exp(-(z - near_m) / fade_m).
        rough_sigma_steps: deviation of the mean residuals of 80 × 80 px, beside the radial part.
        unlike_sigma: by which factor units differ. Chosen.
        scale_sigma: error of the focal length times baseline, as a share. freiburg1's depth had to be scaled by 1.035
            and freiburg2's by 1.031 (Sturm et al., IROS 2012), which they were; what is left is chosen.
        steps_per_px, native_focal_px, baseline_m: as of `StructuredLight`.
    """

    radii: tuple[float, ...] = (0.05, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65)
    near_steps: tuple[float, ...] = (-3.1, -2.0, -0.4, 0.2, 0.1, 1.4, 3.4)
    far_steps: tuple[float, ...] = (-0.3, 0.2, 0.3, 0.4, 0.1, -1.0, -1.1)
    near_m: float = 0.9
    fade_m: float = 0.5
    rough_sigma_steps: float = 0.5
    unlike_sigma: float = 0.3
    scale_sigma: float = 0.007
    steps_per_px: float = 8.0
    native_focal_px: float = 586.0
    baseline_m: float = 0.075


class DisparityDistortion:
    """Of one unit, from its seed."""

    def __init__(self, settings: DisparityDistortionSettings, camera: PinholeCamera, rng: np.random.Generator) -> None:
        rays = camera.rays()
        radius = np.hypot(rays[..., 0], rays[..., 1])
        unlike = 1 + settings.unlike_sigma * rng.standard_normal(2)
        rough = settings.rough_sigma_steps * _smooth(rng, radius.shape)
        self._settings = settings
        near, far = settings.near_steps, settings.far_steps
        self._near_px = unlike[0] * np.interp(radius, settings.radii, near) / settings.steps_per_px
        self._far_px = (unlike[1] * np.interp(radius, settings.radii, far) + rough) / settings.steps_per_px
        self.scale = 1 + settings.scale_sigma * float(rng.standard_normal())

    def distorted(self, view: View) -> Float32Array:
        """See `DepthDistortion`."""
        s = self._settings
        z = np.maximum(view.depth_m, np.float32(0.1))
        error_px = self._near_px * np.exp(-(z - s.near_m) / s.fade_m) + self._far_px
        # In Kinect's raw numbers, which grow with distance, as the residuals are; disparities are less by as much.
        disparity_px = s.native_focal_px * s.baseline_m / z - error_px
        depth_m = self.scale * s.native_focal_px * s.baseline_m / np.maximum(disparity_px, 1e-2)
        return np.where(view.depth_m > 0, depth_m, 0).astype(np.float32)


@dataclass(frozen=True, slots=True)
class PhaseDistortionSettings:
    """Kinect v2: distances that swing about the true ones, and light that comes back by more than one way.

    Attributes:
        swing_m, wave_m: amplitude and period over distance. Lachat et al., "Assessment and calibration of a RGB-D
            camera (Kinect v2 sensor) towards a potential use for close-range 3D modeling", Remote Sensing 7 (2015),
            find deviations that swing by -15 to +7 mm from 1 to 6 m.
        offset_sigma_m: constant error; the same.
        radial_m: more in the image's corners, in proportion to the square of the ray's angle; the same, fig. 8: about
            1 cm in the corners.
        grid: columns and rows of the points among which light is exchanged.
    """

    swing_m: float = 0.007
    wave_m: float = 1.9
    offset_sigma_m: float = 0.005
    radial_m: float = 0.02
    grid: tuple[int, int] = (24, 20)


class PhaseDistortion:
    """Of one unit, from its seed."""

    def __init__(
        self,
        settings: PhaseDistortionSettings,
        camera: PinholeCamera,
        scattered: FloatArray,
        rng: np.random.Generator,
    ) -> None:
        rays = camera.rays()
        self._settings, self._scattered = settings, scattered
        self._offset_m = settings.offset_sigma_m * float(rng.standard_normal())
        self._phase_rad = float(rng.uniform(0, 2 * np.pi))
        self._radial_m = settings.radial_m * (rays[..., 0] ** 2 + rays[..., 1] ** 2)

    def distorted(self, view: View) -> Float32Array:
        """See `DepthDistortion`."""
        from wheelsight.simulation.realism.multipath import multipath_m

        s, z = self._settings, view.depth_m
        swing_m = s.swing_m * np.sin(2 * np.pi * z / s.wave_m + self._phase_rad)
        longer_m = multipath_m(view, self._scattered, s.grid)
        return np.where(z > 0, z + swing_m + self._radial_m + self._offset_m + longer_m, 0).astype(np.float32)


def _smooth(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """(H, W) smooth chance of unit deviation."""
    knots = rng.standard_normal(_GRID[::-1])
    knots = (knots - knots.mean()) / knots.std()
    return np.asarray(cv2.resize(knots, shape[::-1], interpolation=cv2.INTER_CUBIC), float)
