"""A colour camera: radiance becomes bytes by way of lens, exposure, electrons, noise, gamma and JPEG."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera
from wheelsight_sim.scene import View
from wheelsight_sim.sensor_kernels import Exposed, develop, flow_kernel, smear

# The linear model of the EMVA standard 1288 (release 4, section 2): electrons are Poisson distributed about what
# light and time make of them, reading adds Gaussian noise, a gain turns them into numbers that saturate; then sRGB's
# curve (IEC 61966-2-1).

_LEVELS = np.linspace(0, 1, 16384)
# The byte of each of these linear levels by sRGB's curve.
_SRGB_BYTES: ByteArray = np.round(
    255 * np.where(_LEVELS <= 0.0031308, 12.92 * _LEVELS, 1.055 * _LEVELS ** (1 / 2.4) - 0.055)
).astype(np.uint8)
# Equally likely values of a normal distribution, of mean 0 and, once divided, variance 1 exactly.
_QUANTILES = ndtri((np.arange(4096) + 0.5) / 4096)
_NORMALS = np.asarray(_QUANTILES / _QUANTILES.std(), np.float32)
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# Lamps seen directly count in metering as if they were this bright.
_METERED_AT_MOST = 1.5


@dataclass(frozen=True, slots=True)
class ExposureSetting:
    """What the camera's control has set for one frame: how long the shutter is open, and the gain."""

    time_s: float
    gain: float = 1.0

    @property
    def product_s(self) -> float:
        """Time times gain: what decides how bright the frame is."""
        return self.time_s * self.gain


@dataclass(frozen=True, slots=True)
class ColorSensor:
    """A small CMOS colour sensor behind a wide lens, with automatic exposure.

    Full well and read noise are those a 37.7 dB best signal-to-noise ratio and 59.5 dB dynamic range stand for, of a
    1/4-inch sensor of the years of the first Kinect (Micron MT9D112, data sheet, table 1): 10^3.77 electrons and a
    read noise of 10^(59.5/20) less.

    Attributes:
        fixed: the exposure of every frame; None meters.
        longest_s: the longest time the shutter is open; gain makes up for the rest.
        highest_gain: that the control may set.
        target: mean level the control seeks, as a share of full scale, linear.
        inertia: share of the last frame's exposure that the next keeps (in the logarithm): 0 follows at once.
        electrons_per_s: that radiance 1 makes in a pixel in a second.
        full_well: electrons a pixel holds.
        read_noise: standard deviation of reading, electrons.
        vignetting: how much of the cos⁴ law the image shows; 0 is a corrected lens.
        lens_sigma_px: the lens's blur.
        motion_blur: whether things smear while the shutter is open.
    """

    fixed: ExposureSetting | None = None
    longest_s: float = 1 / 50
    highest_gain: float = 8.0
    target: float = 0.26
    inertia: float = 0.8
    electrons_per_s: float = 200_000.0
    full_well: float = 5900.0
    read_noise: float = 6.2
    vignetting: float = 0.6
    lens_sigma_px: float = 0.5
    motion_blur: bool = False

    def __post_init__(self) -> None:
        positive = (self.longest_s, self.highest_gain, self.target, self.electrons_per_s, self.full_well)
        others = (self.read_noise, self.lens_sigma_px)
        if not (np.isfinite([*positive, *others]).all() and min(positive) > 0 and min(others) >= 0):
            raise ConfigError("a colour sensor's times, levels and electrons must be positive numbers")
        if not (0 <= self.inertia < 1 and 0 <= self.vignetting <= 1 and self.target < 1):
            raise ConfigError("a colour sensor's inertia, vignetting and target lie between 0 and 1")

    def meter(self, radiance: Float32Array, last: ExposureSetting | None = None) -> ExposureSetting:
        """The exposure of a frame (H, W, 3), which goes from the last frame's towards what this one asks for."""
        if self.fixed is not None:
            return self.fixed
        level = float(np.minimum(radiance[::4, ::4] @ _LUMINANCE, _METERED_AT_MOST).mean())
        longest = self.longest_s * self.highest_gain
        wanted = min(self.target * self.full_well / (self.electrons_per_s * max(level, 1e-6)), longest)
        if last is not None:
            wanted = last.product_s**self.inertia * wanted ** (1 - self.inertia)
        time_s = min(wanted, self.longest_s)
        return ExposureSetting(time_s, wanted / time_s)

    def expose(
        self,
        radiance: Float32Array,
        view: View,
        exposure: ExposureSetting,
        rng: np.random.Generator,
        twist_camera: ArrayLike | None = None,
    ) -> ByteArray:
        """The image (H, W, 3) a camera delivers of a view's radiance (H, W, 3).

        `rng` draws one number, from which all noise of the frame follows. `twist_camera` (6,) is the velocity (v, ω) of
        the camera in its own frame, m/s and rad/s; motion blur needs it.

        Raises:
            ConfigError: the sensor has motion blur, and no twist was given.
        """
        image = radiance
        if self.lens_sigma_px > 0:
            blurred = cv2.GaussianBlur(radiance, (3, 3), self.lens_sigma_px, borderType=cv2.BORDER_REPLICATE)
            image = np.asarray(blurred, np.float32)
        if self.motion_blur:
            if twist_camera is None:
                raise ConfigError("motion blur needs the camera's twist", fix="give twist_camera, or motion_blur=False")
            flow = image_flow(view, twist_camera) * np.float32(exposure.time_s)
            image = smear(image, flow)
        electrons, gain = self.electrons_per_s * exposure.time_s, exposure.gain / self.full_well
        out = np.empty(image.shape, np.uint8)
        cosine_squared = 1 / np.einsum("hwc,hwc->hw", view.rays, view.rays)
        develop(
            image,
            np.asarray(1 - self.vignetting * (1 - cosine_squared**2), np.float32),
            Exposed(electrons, self.full_well, self.read_noise, gain),
            _NORMALS,
            _SRGB_BYTES,
            int(rng.integers(2**31)),
            out,
        )
        return out


def image_flow(view: View, twist_camera: ArrayLike) -> Float32Array:
    """How fast each pixel's point moves in the image (H, W, 2), in pixels per second; 0 where there is none.

    A point at p moves with -v - ω × p in a camera that moves with v and turns with ω.
    """
    twist = np.asarray(twist_camera, float)
    out = np.empty((*view.depth_m.shape, 2), np.float32)
    flow_kernel(view.depth_m, view.rays, twist, out)
    return out


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """How a control follows what it meters.

    Between neighbouring frames of 240 each, brightness at tracked points changes by a factor e^0.04 (freiburg1_desk),
    e^0.07 (freiburg1_rpy) and e^0.02 (red_kitchen), and over all of them by e^0.7 to e^1.15; the ratios of blue and
    red to green change by e^0.2 to e^0.6 over all.

    Attributes:
        level: (least, most) mean level that a unit's control seeks, as a share of full scale, linear: 0.26 in
            red_kitchen, 0.36 in freiburg1_desk, 0.38 in freiburg1_rpy, where 2 to 8 % of the pixels are white.
        delay_s: after which a frame's light acts on the exposure: it is read out, metered, set, and exposed. Three
            frames at 30 Hz. Chosen.
        settling_s: time constant of the control. Chosen for the changes between frames above.
        overshoot: share by which it goes beyond its goal at first. Chosen.
        step: exposures come in steps of this share. Chosen: lines of a sensor's shutter.
        flicker_s: exposures longer than this are multiples of it, against lamps that flicker at 100 Hz.
        longest_s: of an exposure: a frame of 30 Hz.
        balance_s: time constant of the white balance. Chosen for the changes above.
        balance_strength: share of the colour cast that it takes out; 1 makes every picture grey on average.
    """

    level: tuple[float, float] = (0.25, 0.38)
    delay_s: float = 0.1
    settling_s: float = 0.15
    overshoot: float = 0.25
    step: float = 0.03
    flicker_s: float = 0.01
    longest_s: float = 1 / 30
    balance_s: float = 0.7
    balance_strength: float = 0.5


def response(settings: ControlSettings, period_s: float, frames: int) -> FloatArray:
    """(K,) weights of what the last K frames asked for, the newest first, on the exposure of this one; their sum is 1.

    The impulse response of a damped oscillation whose first step goes `overshoot` beyond the goal, `delay_s` late.
    """
    ages_s = period_s * np.arange(frames)
    decay = -np.log(max(settings.overshoot, 1e-6))
    damping = decay / np.hypot(np.pi, decay)
    own_rad_s = 1 / (settings.settling_s * damping)
    swing_rad_s = own_rad_s * np.sqrt(1 - damping**2)
    since_s = np.maximum(ages_s + period_s - settings.delay_s, 0.0)
    done = 1 - np.exp(-damping * own_rad_s * since_s) * (
        np.cos(swing_rad_s * since_s) + damping * own_rad_s / swing_rad_s * np.sin(swing_rad_s * since_s)
    )
    weights = np.diff(np.concatenate([[0.0], done]))
    return np.asarray(weights / weights.sum())


def exposure_of(
    settings: ControlSettings, wanted_s: ArrayLike, weights: ArrayLike, highest_gain: float
) -> ExposureSetting:
    """The exposure whose product the last frames asked for: time in steps and without flicker, gain for the rest.

    Args:
        settings: of the control.
        wanted_s: (K,) time times gain that each of the last frames asked for, the newest first.
        weights: (K,) from `response`; of the first frames of a drive, the oldest stands for all before it.
        highest_gain: that may be set.
    """
    logs, weights = np.log(np.asarray(wanted_s, float)), np.asarray(weights, float)
    logs = np.concatenate([logs, np.full(len(weights) - len(logs), logs[-1])])
    product_log = float(logs @ weights)
    product_s = float(np.exp(np.round(product_log / settings.step) * settings.step))
    time_s = min(product_s, settings.longest_s)
    if time_s > settings.flicker_s:
        time_s = settings.flicker_s * np.floor(time_s / settings.flicker_s + 1e-9)
    return ExposureSetting(time_s, min(product_s / time_s, highest_gain))


def balance_of(settings: ControlSettings, colors: FloatArray, period_s: float) -> FloatArray:
    """(3,) factors of red, green and blue; mean colours (K, 3) of the last frames, the newest first."""
    weights = np.exp(-period_s * np.arange(len(colors)) / settings.balance_s)
    mean = np.exp(np.average(np.log(np.maximum(colors, 1e-6)), axis=0, weights=weights))
    factors = (mean[1] / mean) ** settings.balance_strength
    return np.asarray(factors.clip(0.5, 2.0))


@dataclass(frozen=True, slots=True)
class LensSettings:
    """Brown's distortion of a small wide lens, and how well it was calibrated.

    Attributes:
        distortion: k1, k2, p1, p2, k3: Kinect v1's colour camera of TUM's freiburg1 (Sturm et al., "A benchmark for
            the evaluation of RGB-D SLAM systems", IROS 2012).
        unlike_sigma: how far a unit's k1, k2 and k3 are from these, as one factor for all three. Chosen.
        tangential_sigma: of a unit's p1 and p2; freiburg1's are 0.005 and 0.003.
        focal_sigma: error of the calibrated focal length, as a share. The maker's 525 px, which many take, is off
            freiburg1's calibrated 517 px by 1.5 %; a board does better, by how much is chosen.
        centre_sigma_px: error of the calibrated principal point, in pixels of an image 640 wide; 16 px is the
            maker's for freiburg1. Chosen.
        distortion_sigma: error of the calibrated k1, k2, k3, as one share. Chosen.
    """

    distortion: tuple[float, float, float, float, float] = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    unlike_sigma: float = 0.1
    tangential_sigma: float = 0.003
    focal_sigma: float = 0.003
    centre_sigma_px: float = 2.0
    distortion_sigma: float = 0.05


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera as it is, and as its calibration has it."""

    true: PinholeCamera
    nominal: PinholeCamera


def lens_of(camera: PinholeCamera, settings: LensSettings, rng: np.random.Generator) -> Lens:
    """The lens of one unit of a camera, and one calibration of it.

    `camera` has no distortion, and the size wanted.
    """
    k1, k2, p1, p2, k3 = settings.distortion
    unlike = 1 + settings.unlike_sigma * rng.standard_normal()
    tangential = np.array([p1, p2]) + settings.tangential_sigma * rng.standard_normal(2)
    nominal = replace(camera, distortion=(unlike * k1, unlike * k2, *tangential, unlike * k3))
    focal = 1 + settings.focal_sigma * rng.standard_normal()
    centre_px = settings.centre_sigma_px * camera.width / 640 * rng.standard_normal(2)
    bent = 1 + settings.distortion_sigma * rng.standard_normal()
    distortion = (bent * unlike * k1, bent * unlike * k2, *tangential, bent * unlike * k3)
    middle: dict[str, Any] = {"cx": camera.cx + centre_px[0], "cy": camera.cy + centre_px[1]}
    true = replace(nominal, fx=camera.fx * focal, fy=camera.fy * focal, distortion=distortion, **middle)
    return Lens(true, nominal)


@dataclass(frozen=True, slots=True)
class PixelSettings:
    """How images are brought to the host.

    Attributes:
        has_bayer: whether pixels have one colour each, as those of all small sensors.
        jpeg_quality: of 100; 0 for none. 75 and 80 are those of Kinect's images in `kinect_v1_herrera_board` and
            red_kitchen, by their quantisation tables; with colour halved each way, as both have it.
    """

    has_bayer: bool = True
    jpeg_quality: int = 80


def as_delivered(color: ByteArray, settings: PixelSettings) -> ByteArray:
    """An image (H, W, 3) as the host gets it.

    Colours are taken out and filled in after gamma, where a camera does so before: a simplification that leaves the
    noise of edges as it is.
    """
    if settings.has_bayer:
        # Each pixel's own colour of the pattern red, green / green, blue, and the others from its neighbours.
        mosaic = color[..., 1].copy()
        mosaic[0::2, 0::2] = color[0::2, 0::2, 0]
        mosaic[1::2, 1::2] = color[1::2, 1::2, 2]
        # OpenCV names the pattern by the pixels of its second row and column.
        color = np.asarray(cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2RGB), np.uint8)
    if settings.jpeg_quality:
        halved = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420]
        options = [cv2.IMWRITE_JPEG_QUALITY, settings.jpeg_quality, *halved]
        _, data = cv2.imencode(".jpg", color[..., ::-1], options)
        color = np.asarray(cv2.cvtColor(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB), np.uint8)
    return color
