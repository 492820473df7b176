"""Depth cameras as they are: what each makes of the depth that its rays truly meet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from wheelsight.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight.simulation import _depth_kernels as kernels
from wheelsight.simulation.view import View

# Correlating noise over less than this makes none.
_WHITE_PX = 0.3


class DepthSensor(Protocol):
    """Turns true depth into a measurement."""

    def measure(
        self, view: View, camera: PinholeCamera, infrared: FloatArray, shine: FloatArray, rng: np.random.Generator
    ) -> Float32Array:
        """(H, W) depth in metres along z as the sensor reports it, 0 where it reports none.

        Args:
            view: what the rays hit.
            camera: whose pixels they go through.
            infrared: (G,) reflectance of each geom at the sensor's wavelength, 0 to 1.
            shine: (G,) share of the light each geom mirrors away, 0 to 1.
            rng: of this frame; the same state gives the same image.
        """
        ...


@dataclass(frozen=True, slots=True)
class IdealDepth:
    """Depth without error from `near_m` to `far_m`, so that what remains of an error is not the sensor's."""

    near_m: float = 0.05
    far_m: float = 20.0

    def measure(
        self, view: View, camera: PinholeCamera, infrared: FloatArray, shine: FloatArray, rng: np.random.Generator
    ) -> Float32Array:
        """The true depth where it is in range."""
        in_range = (view.depth_m >= self.near_m) & (view.depth_m <= self.far_m)
        return np.where(in_range, view.depth_m, np.float32(0))


@dataclass(frozen=True, slots=True)
class StructuredLight:
    """Kinect v1: a camera finds the pattern of a projector to its right again, block by block.

    Lengths in pixels are of the native image, `native_focal_px`; other sizes scale them.

    Attributes:
        native_focal_px, baseline_m: of Khoshelham & Elberink, "Accuracy and resolution of Kinect depth data for indoor
            mapping applications", Sensors 12 (2012): 5.453 mm of focal length at 9.3 µm a pixel, 75 mm.
        steps_per_px: to which disparities are rounded; 1/8 px gives the 2.85e-3 z² m between neighbouring depths that
            the same paper reports.
        quadratic_per_m: σ(z) = 1.425e-3 z² m in all, rounding included; the same paper, eq. 9 and section 4.
        oblique_m: growth of σ with the angle of incidence θ, oblique_m / √z · θ²/(π/2 - θ)²: Nguyen, Izadi & Lovell,
            "Modeling Kinect sensor noise for improved 3D reconstruction and tracking", 3DIMPVT 2012, eq. 3.
        edge_sigma_px: how far edges are displaced: the same, lateral noise, eq. 1: 0.8 px seen frontally.
        block_px: width of the blocks whose pixels share a displacement, and twice the noise's correlation length;
            chosen for the ragged look of edges, under the 9 px that Konolige & Mihelich ("Technical description of
            Kinect calibration", ROS wiki 2011) infer for matching.
        near_m, far_m: beyond these nothing is returned. Reliable are 0.8 to 3.5 m (the maker's range); the sensor goes
            on to the disparities of about 0.45 and 10 m.
        grazing_deg: incidence beyond which nothing matches. Nguyen et al. could measure up to about 80°; planes fitted
            to depth of freiburg1_rpy (TUM) and red_kitchen (7-Scenes) are met at up to 80° often, at 80° to 85° a third
            as often or less, and never beyond.
        least_light: returned light below which nothing matches, in reflectance · cos θ / r². Planes in freiburg1_rpy
            still return where cos θ / r² is 0.004 per m² (67° at 10 m), and no wall reflects more than 0.85 of it.
            Black surfaces (0.05) return to 4 m, white walls beyond the disparities' limit.
        lobe_deg, blinding: a surface that mirrors more than `blinding` blinds the camera where seen within about
            `lobe_deg` of its normal. Chosen: a hole of a hand's width in a polished door at a metre.
        shadow_px: what stands before a point in the projector's view by less disparity does not shade it; under it
            are the steps between pixels of slopes.
    """

    native_focal_px: float = 586.0
    baseline_m: float = 0.075
    steps_per_px: float = 8.0
    quadratic_per_m: float = 1.425e-3
    oblique_m: float = 1e-4
    edge_sigma_px: float = 0.8
    block_px: float = 3.0
    near_m: float = 0.45
    far_m: float = 10.0
    grazing_deg: float = 82.0
    least_light: float = 0.003
    lobe_deg: float = 5.0
    blinding: float = 0.25
    shadow_px: float = 1.0

    def measure(
        self, view: View, camera: PinholeCamera, infrared: FloatArray, shine: FloatArray, rng: np.random.Generator
    ) -> Float32Array:
        """Matched depth in whole millimetres; holes where the projector does not reach or too little returns."""
        native_per_px = self.native_focal_px / camera.fx
        focal_baseline = camera.fx * self.baseline_m
        cells = tuple(int(side * native_per_px / self.block_px) + 1 for side in view.depth_m.shape)
        chance = kernels.Chance(rng.integers(0, 256, (*cells, 3), np.uint8), native_per_px / self.block_px)
        noise = _correlated(rng, view.depth_m.shape, 0.5 * self.block_px / native_per_px)
        seen = _light(view, infrared * (1 - shine))
        usable = kernels.detectable(seen, shine, chance, _limits(self))
        usable &= kernels.lit_by_projector(view.depth_m, view.geom, focal_baseline, self.shadow_px / native_per_px)
        pattern = kernels.Pattern(
            self._matching_sigma_px,
            self.oblique_m,
            focal_baseline,
            self.native_focal_px * self.baseline_m,
            self.steps_per_px,
        )
        shifts_px = _normal_table(self.edge_sigma_px / native_per_px)
        return np.asarray(kernels.match_pattern(seen, usable, noise, chance, shifts_px, pattern))

    @property
    def _matching_sigma_px(self) -> float:
        """What is left of the published deviation for matching once rounding has taken its 1/√12 of a step."""
        whole = self.quadratic_per_m * self.native_focal_px * self.baseline_m
        return math.sqrt(max(whole**2 - 1 / (12 * self.steps_per_px**2), 0.0))


@dataclass(frozen=True, slots=True)
class TimeOfFlight:
    """Kinect v2: every pixel times the light of a lamp beside the camera. Multiple reflections are left out.

    Attributes:
        axial: σ(z, θ) = a + b·z + c·z² + d·z^1.5·θ²/(π/2 - θ)² in metres: Fankhauser et al., "Kinect v2 for mobile
            robot navigation: evaluation and modeling", ICAR 2015, measured indoors; 1.3 mm at 1 m, 4.3 mm at 4 m.
        reference: reflectance for which that holds; other surfaces have σ · sqrt(reference / theirs), as where photons
            are what is counted. Chosen: a light wall.
        near_m, far_m: the maker names 0.5 to 4.5 m reliable, and 8 m the greatest value of a depth image.
        least_light: returned light below which a pixel is empty, in reflectance · cos θ / r². Without the drivers'
            limits users of libfreenect2 read depth to 10 m (its issue 143) and 12 m: a wall of reflectance 0.6 does.
        grazing_deg: incidence beyond which nothing is returned; Fankhauser et al. measured to about 80°.
        lobe_deg, blinding: as of `StructuredLight`: the lamp's mirror image saturates pixels.
        jump: a step between neighbours by this share of the depth mixes their light. Wasenmüller & Stricker,
            "Comparison of Kinect v1 and v2 depth images in terms of accuracy and precision", ACCV workshops 2016, find
            such flying pixels at edges; how many are kept is chosen.
        edge_share: the most of a pixel's light that comes from across an edge: half, where edges cross it.
        edge_loss: share of pixels at edges that the driver's filters remove.
    """

    axial: tuple[float, float, float, float] = (1.5e-3, -0.5e-3, 0.3e-3, 0.1e-3)
    reference: float = 0.6
    near_m: float = 0.5
    far_m: float = 8.0
    least_light: float = 0.004
    grazing_deg: float = 82.0
    lobe_deg: float = 5.0
    blinding: float = 0.25
    jump: float = 0.03
    edge_share: float = 0.5
    edge_loss: float = 0.4

    def measure(
        self, view: View, camera: PinholeCamera, infrared: FloatArray, shine: FloatArray, rng: np.random.Generator
    ) -> Float32Array:
        """Timed depth in whole millimetres, with flying pixels at edges."""
        chance = rng.integers(0, 256, (*view.depth_m.shape, 3), np.uint8)
        noise = _correlated(rng, view.depth_m.shape, 0.0)
        scattered = infrared * (1 - shine)
        seen = _light(view, scattered)
        usable = kernels.detectable(seen, shine, kernels.Chance(chance, 1.0), _limits(self))
        phase = kernels.Phase(np.array(self.axial), self.reference, self.jump, self.edge_share, self.edge_loss)
        return np.asarray(kernels.time_light(seen, usable, scattered, noise, chance, phase))


def _light(view: View, scattered: FloatArray) -> kernels.Seen:
    R_world_rows = np.ascontiguousarray(view.T_world_camera[:, :3, :3])
    cosine, light = kernels.returned_light(
        view.depth_m, view.geom, view.normal_world, R_world_rows, view.rays, scattered
    )
    return kernels.Seen(view.depth_m, view.geom, cosine, light)


def _limits(sensor: StructuredLight | TimeOfFlight) -> kernels.Limits:
    return kernels.Limits(
        sensor.near_m,
        sensor.far_m,
        math.cos(math.radians(sensor.grazing_deg)),
        sensor.least_light,
        math.radians(sensor.lobe_deg),
        sensor.blinding,
    )


def _correlated(rng: np.random.Generator, shape: tuple[int, ...], sigma_px: float) -> NDArray[np.float32]:
    """(H, W) normal numbers of unit deviation, alike over about `sigma_px`."""
    white = rng.standard_normal(shape, np.float32)
    if sigma_px < _WHITE_PX:
        return white
    reach = math.ceil(3 * sigma_px)
    weights = cv2.getGaussianKernel(2 * reach + 1, sigma_px, cv2.CV_32F)
    # Weights that keep the deviation, not the sum.
    weights = weights / np.linalg.norm(weights)
    return np.asarray(cv2.sepFilter2D(white, cv2.CV_32F, weights, weights, borderType=cv2.BORDER_REFLECT_101))


def _normal_table(sigma: float) -> FloatArray:
    """(256,) equally likely values of a normal distribution."""
    return np.asarray(sigma * ndtri((np.arange(256) + 0.5) / 256))
