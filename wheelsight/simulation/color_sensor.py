"""A colour camera's sensor: radiance to bytes by way of lens, exposure, electrons, noise and gamma.

The linear model of the EMVA standard 1288 (release 4, section 2): electrons are Poisson distributed about what light
and time make of them, reading adds Gaussian noise, a gain turns them into numbers that saturate; then sRGB's curve
(IEC 61966-2-1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from wheelsight.errors import ConfigError
from wheelsight.geometry import ByteArray, Float32Array, FloatArray
from wheelsight.simulation import _blur_kernels as kernels
from wheelsight.simulation.view import View

_NORMALS = 4096
_LEVELS = 16384
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# Lamps seen directly count in metering as if they were this bright.
_METERED_AT_MOST = 1.5


@dataclass(frozen=True, slots=True)
class Exposure:
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

    fixed: Exposure | None = None
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

    def meter(self, radiance: Float32Array, last: Exposure | None = None) -> Exposure:
        """The exposure of a frame (H, W, 3), which goes from the last frame's towards what this one asks for."""
        if self.fixed is not None:
            return self.fixed
        level = float(np.minimum(radiance[::4, ::4] @ _LUMINANCE, _METERED_AT_MOST).mean())
        longest = self.longest_s * self.highest_gain
        wanted = min(self.target * self.full_well / (self.electrons_per_s * max(level, 1e-6)), longest)
        if last is not None:
            wanted = last.product_s**self.inertia * wanted ** (1 - self.inertia)
        time_s = min(wanted, self.longest_s)
        return Exposure(time_s, wanted / time_s)

    def expose(
        self,
        radiance: Float32Array,
        view: View,
        exposure: Exposure,
        rng: np.random.Generator,
        twist_camera: ArrayLike | None = None,
    ) -> ByteArray:
        """The image (H, W, 3) a camera delivers of a view's radiance (H, W, 3).

        Args:
            radiance: of each pixel, from `Painter.paint`.
            view: what the radiance belongs to.
            exposure: time and gain, from `meter`.
            rng: draws one number; all noise of the frame follows from it.
            twist_camera: (6,) m/s and rad/s, velocity (v, ω) of the camera in its own frame; motion blur needs it.

        Raises:
            ConfigError: the sensor has motion blur, and no twist was given.
        """
        image = self._through_lens(radiance)
        if self.motion_blur:
            if twist_camera is None:
                raise ConfigError("motion blur needs the camera's twist", fix="give twist_camera, or motion_blur=False")
            flow = image_flow(view, twist_camera) * np.float32(exposure.time_s)
            image = kernels.smear(image, flow)
        out = np.empty(image.shape, np.uint8)
        kernels.develop(
            image,
            self._fall_off(view.rays),
            self._exposed(exposure),
            _normal_quantiles(),
            _srgb_bytes(),
            int(rng.integers(2**31)),
            out,
        )
        return out

    def _exposed(self, exposure: Exposure) -> kernels.Exposed:
        electrons, gain = self.electrons_per_s * exposure.time_s, exposure.gain / self.full_well
        return kernels.Exposed(electrons, self.full_well, self.read_noise, gain)

    def _through_lens(self, radiance: Float32Array) -> Float32Array:
        if self.lens_sigma_px <= 0:
            return radiance
        blurred = cv2.GaussianBlur(radiance, (3, 3), self.lens_sigma_px, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(blurred, np.float32)

    def _fall_off(self, rays: FloatArray) -> Float32Array:
        """Share of light (H, W) that reaches each pixel: cos⁴ of its ray's angle, as far as the lens shows it."""
        cosine_squared = 1 / np.einsum("hwc,hwc->hw", rays, rays)
        return np.asarray(1 - self.vignetting * (1 - cosine_squared**2), np.float32)


def image_flow(view: View, twist_camera: ArrayLike) -> Float32Array:
    """How fast each pixel's point moves in the image (H, W, 2), in pixels per second; 0 where there is none.

    A point at p moves with -v - ω × p in a camera that moves with v and turns with ω.
    """
    twist = np.asarray(twist_camera, float)
    out = np.empty((*view.depth_m.shape, 2), np.float32)
    kernels.flow(view.depth_m, view.rays, twist, out)
    return out


@cache
def _normal_quantiles() -> Float32Array:
    """Equally likely values of a normal distribution of mean 0 and variance 1, exactly."""
    values = ndtri((np.arange(_NORMALS) + 0.5) / _NORMALS)
    return np.asarray(values / values.std(), np.float32)


@cache
def _srgb_bytes() -> ByteArray:
    """The byte of each linear level 0 to 1 in equal steps, by sRGB's curve."""
    x = np.linspace(0, 1, _LEVELS)
    curve = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)
