"""Depth cameras: what each makes of the depth that its rays meet; distortion, multipath, registration to colour."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight_sim import sensor_kernels as kernels
from wheelsight_sim.color_sensor import image_flow
from wheelsight_sim.scene import View

# Correlating noise over less than this makes none.
_WHITE_PX = 0.3


@dataclass(frozen=True, slots=True)
class IdealDepth:
    """Depth without error from `near_m` to `far_m`, so that what remains of an error is not the sensor's."""

    near_m: float = 0.05
    far_m: float = 20.0

    def measure(
        self, view: View, camera: PinholeCamera, infrared: FloatArray, shine: FloatArray, rng: np.random.Generator
    ) -> Float32Array:
        """(H, W) depth in metres along z as the sensor reports it, 0 where it reports none: the truth where in range.

        Geoms reflect the shares `infrared` (G,) of its light, and mirror away `shine` (G,); `rng` is of this frame.
        """
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
        seen = kernels.returned_light(view, infrared * (1 - shine))
        usable = kernels.detectable(seen, shine, chance, _limits(self))
        usable &= kernels.lit_by_projector(view.depth_m, view.geom, focal_baseline, self.shadow_px / native_per_px)
        whole = self.quadratic_per_m * self.native_focal_px * self.baseline_m
        pattern = kernels.Pattern(
            math.sqrt(max(whole**2 - 1 / (12 * self.steps_per_px**2), 0.0)),
            self.oblique_m,
            focal_baseline,
            self.native_focal_px * self.baseline_m,
            self.steps_per_px,
        )
        shifts_px = np.asarray((self.edge_sigma_px / native_per_px) * ndtri((np.arange(256) + 0.5) / 256))
        return np.asarray(kernels.match_pattern(seen, usable, noise, chance, shifts_px, pattern))


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
        seen = kernels.returned_light(view, scattered)
        usable = kernels.detectable(seen, shine, kernels.Chance(chance, 1.0), _limits(self))
        phase = kernels.Phase(np.array(self.axial), self.reference, self.jump, self.edge_share, self.edge_loss)
        return np.asarray(kernels.time_light(seen, usable, scattered, noise, chance, phase))


DepthSensor = IdealDepth | StructuredLight | TimeOfFlight


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


_GRID = 8, 6  # knots across and down of what is not radial: a scale of 80 px, as the mean residuals have it


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
        # (H, W) smooth chance of unit deviation.
        knots = rng.standard_normal(_GRID[::-1])
        knots = (knots - knots.mean()) / knots.std()
        rough = settings.rough_sigma_steps * np.asarray(
            cv2.resize(knots, radius.shape[::-1], interpolation=cv2.INTER_CUBIC), float
        )
        self._settings = settings
        near, far = settings.near_steps, settings.far_steps
        self._near_px = unlike[0] * np.interp(radius, settings.radii, near) / settings.steps_per_px
        self._far_px = (unlike[1] * np.interp(radius, settings.radii, far) + rough) / settings.steps_per_px
        self.scale = 1 + settings.scale_sigma * float(rng.standard_normal())

    def distorted(self, view: View) -> Float32Array:
        """(H, W) depth in metres that the unit measures without noise, 0 where there is none."""
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
        self, settings: PhaseDistortionSettings, camera: PinholeCamera, scattered: FloatArray, rng: np.random.Generator
    ) -> None:
        rays = camera.rays()
        self._settings, self._scattered = settings, scattered
        self._offset_m = settings.offset_sigma_m * float(rng.standard_normal())
        self._phase_rad = float(rng.uniform(0, 2 * np.pi))
        self._radial_m = settings.radial_m * (rays[..., 0] ** 2 + rays[..., 1] ** 2)

    def distorted(self, view: View) -> Float32Array:
        """(H, W) depth in metres that the unit measures without noise, 0 where there is none."""
        s, z = self._settings, view.depth_m
        swing_m = s.swing_m * np.sin(2 * np.pi * z / s.wave_m + self._phase_rad)
        longer_m = multipath_m(view, self._scattered, s.grid)
        return np.where(z > 0, z + swing_m + self._radial_m + self._offset_m + longer_m, 0).astype(np.float32)


DepthDistortion = DisparityDistortion | PhaseDistortion

_NEAREST_M = 0.1


def multipath_m(view: View, scattered: FloatArray, grid: tuple[int, int]) -> Float32Array:
    """(H, W) how much deeper points seem for the light that was scattered twice; 0 where nothing is seen.

    The radiometric model of Jiménez et al., "Modeling and correction of multipath interference in time of flight
    cameras", Image and Vision Computing 32 (2014), with one further reflection: each of a grid of patches receives the
    light of the lamp directly, and from every other patch, on which the lamp shines too, by their form factor. A
    pixel's distance is the mean of the ways, weighted by their light. Patches do not hide one another.

    `scattered` (G,) is the share of the light that each geom scatters; `grid` the columns and rows of patches.
    """
    h, w = view.depth_m.shape
    rows = ((np.arange(grid[1]) + 0.5) * h / grid[1]).astype(int)
    columns = ((np.arange(grid[0]) + 0.5) * w / grid[0]).astype(int)
    at = np.ix_(rows, columns)
    z, geom = view.depth_m[at].astype(float).ravel(), view.geom[at].ravel()
    p = (view.rays[at] * view.depth_m[at][..., None]).reshape(-1, 3)
    R = view.T_world_camera[rows][:, None, :3, :3]
    n = np.einsum("rcji,rcj->rci", np.broadcast_to(R, (*grid[::-1], 3, 3)), view.normal_world[at]).reshape(-1, 3)
    reach_m = np.maximum(np.linalg.norm(p, axis=1), _NEAREST_M)
    towards = -p / reach_m[:, None]
    cosine = np.maximum(np.einsum("ni,ni->n", n, towards), 0.05)
    albedo = np.where(geom >= 0, scattered[geom], 0.0)
    # A patch is as large as its share of the image, at its depth, and more where it is seen aslant.
    per_px = abs(view.rays[0, -1, 0] - view.rays[0, 0, 0]) / w * abs(view.rays[-1, 0, 1] - view.rays[0, 0, 1]) / h
    area_m2 = per_px * (h * w / len(z)) * z**2 / cosine
    # (N,) mean of half the detours by every other patch, weighted by light; none for the direct way.
    sent = area_m2 * cosine / reach_m**2
    direct = cosine / reach_m**2
    apart = p[None] - p[:, None]
    distance_m = np.maximum(np.linalg.norm(apart, axis=2), _NEAREST_M)
    leaving = np.maximum(np.einsum("ijk,jk->ij", -apart, n), 0) / distance_m
    arriving = np.maximum(np.einsum("ijk,ik->ij", apart, n), 0) / distance_m
    indirect = albedo * sent * leaving * arriving / (np.pi * distance_m**2)
    detour_m = 0.5 * (reach_m[None] + distance_m - reach_m[:, None])
    longer_m = np.asarray((indirect * detour_m).sum(axis=1) / (direct + indirect.sum(axis=1)))
    longer_m = np.where(z > 0, longer_m * z / reach_m, 0.0).reshape(grid[::-1]).astype(np.float32)
    return np.asarray(cv2.resize(longer_m, (w, h), interpolation=cv2.INTER_LINEAR))


_NATIVE_WIDTH_PX = 640
_FOCAL_BASELINE_PX_M = 586 * 0.075  # of Kinect v1
_FAR_M = 100.0
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))


@dataclass(frozen=True, slots=True)
class RegistrationSettings:
    """How far registration is off.

    Attributes:
        offset_sigma_px: offset of the depth image right and down, in pixels of an image 640 wide. Keypoint odometry on
            freiburg1_desk and freiburg1_rpy is nearest to motion capture where depth is moved 4 px to the right and 0
            to 2 px up, of shifts tried in steps of 2 to 4 px.
        scale_sigma: by how much the depth image is larger than the colour image, as a share. On both recordings 1.5 %
            more or less makes odometry worse.
        parallax_sigma_px_m: what is added for near things, over their depth: an error of 2 mm of the baseline at a
            focal length of 586 px. Chosen.
        period_s: of the cameras' own clocks. Depth is taken free of colour, so that it is up to half a period early or
            late: -19 to +17 ms in freiburg1_desk, 0 to 14 ms in 8.5 s of freiburg1_rpy.
        drift: how fast the one clock runs from the other, seconds a second; the same 14 ms in 8.5 s.
        border_px: (left, top, right, bottom) of the colour image that the depth camera does not see, in pixels of an
            image 640 wide: where no pixel of freiburg1_desk and freiburg1_rpy ever has depth, or on the left one in
            three has.
        step_px: a step of disparity, in native pixels, beside which blocks do not match. Chosen.
        hole_px: how wide the hole is, in pixels of an image 640 wide: in rows of the two recordings and red_kitchen,
            holes between depths that differ by 15 cm are 6 to 9 px wide in the median, the projector's shadow among
            them; 5 px beside it.
    """

    offset_sigma_px: float = 3.0
    scale_sigma: float = 0.005
    parallax_sigma_px_m: float = 1.2
    period_s: float = 1 / 30
    drift: float = 1.7e-3
    border_px: tuple[float, float, float, float] = (9.0, 37.0, 42.0, 0.0)
    step_px: float = 3.0
    hole_px: float = 5.0


class Registration:
    """Of one unit, from its seed.

    `width` is that of the images, pixels.
    """

    def __init__(self, settings: RegistrationSettings, width: int, rng: np.random.Generator) -> None:
        scale = width / _NATIVE_WIDTH_PX
        self._settings, self._scale = settings, scale
        self.offset_px: FloatArray = settings.offset_sigma_px * scale * rng.standard_normal(2)
        self.parallax_px_m: FloatArray = settings.parallax_sigma_px_m * scale * rng.standard_normal(2)
        self.scale = settings.scale_sigma * float(rng.standard_normal())
        self._phase = float(rng.random())
        self._drift = settings.drift * float(rng.choice([-1, 1]))

    def late_s(self, stamp_s: float) -> float:
        """By how much the depth image is taken after the colour image of a time; negative where before it."""
        turns = self._phase + self._drift * stamp_s / self._settings.period_s
        return (turns % 1.0 - 0.5) * self._settings.period_s

    def seen_by_depth(self, view: View, twist_camera: ArrayLike, stamp_s: float) -> View:
        """What the pixels of the registered depth image show, whose colour image is `view`.

        To first order in the time between the two: each pixel takes what the view has beside it, from the pixel's own
        offset and from where its point moves meanwhile, and depth grows by the camera's motion. A pixel that would
        look beside the image shows nothing.

        `twist_camera` (6,) is the velocity (v, ω) of the camera in its own frame, m/s and rad/s.
        """
        late_s = self.late_s(stamp_s)
        h, w = view.depth_m.shape
        with np.errstate(divide="ignore"):
            inverse = np.where(view.depth_m > 0, 1 / view.depth_m, np.float32(0))
        # What comes to a pixel later is now where it comes from.
        moved_px = image_flow(view, twist_camera) * np.float32(-late_s)
        along, down = np.arange(w), np.arange(h)[:, None]
        offset_px, parallax_px_m = self.offset_px, self.parallax_px_m
        columns = along + self.scale * (along - w / 2) + offset_px[0] + parallax_px_m[0] * inverse + moved_px[..., 0]
        rows = down + self.scale * (down - h / 2) + offset_px[1] + parallax_px_m[1] * inverse + moved_px[..., 1]
        column, row = np.rint(columns).astype(np.int64), np.rint(rows).astype(np.int64)
        is_inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
        at = np.where(is_inside, row * w + column, 0)
        # The pixels of the colour image that the depth camera sees.
        s = self._settings
        left, top, right, bottom = (round(self._scale * px) for px in s.border_px)
        is_in_sight = np.zeros((h, w), bool)
        is_in_sight[top : h - bottom, left : w - right] = True
        is_inside &= is_in_sight
        # (H, W) where a block of the pattern lies on two depths.
        near_m = cv2.erode(np.where(view.depth_m > 0, view.depth_m, np.float32(_FAR_M)), _CROSS)
        far_m = cv2.dilate(view.depth_m, _CROSS)
        step_px = _FOCAL_BASELINE_PX_M * (1 / np.maximum(near_m, 0.1) - 1 / np.maximum(far_m, 0.1))
        across = max(round(s.hole_px * self._scale), 1)
        shape = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (across, across))
        is_inside &= ~np.asarray(cv2.dilate((step_px > s.step_px).astype(np.uint8), shape), bool).ravel()[at]
        depth_m = np.where(is_inside, view.depth_m.ravel()[at], np.float32(0))
        v, turn = np.split(np.asarray(twist_camera, float), 2)
        nearer = 1 + late_s * (turn[0] * view.rays[..., 1] - turn[1] * view.rays[..., 0]) * -1
        depth_m = np.where(depth_m > 0, np.maximum(depth_m * nearer - late_s * v[2], 1e-3), 0)
        geom = np.where(is_inside & (depth_m > 0), view.geom.ravel()[at], np.int32(-1))
        normal = view.normal_world.reshape(-1, 3)[at]
        normal[geom < 0] = 0
        return View(depth_m.astype(np.float32), geom, normal, view.T_world_camera, view.rays)
