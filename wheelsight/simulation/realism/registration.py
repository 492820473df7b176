"""Depth images that are registered to colour by a driver: some pixels off, and taken at another moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wheelsight.geometry import FloatArray
from wheelsight.simulation.color_sensor import image_flow
from wheelsight.simulation.view import View

_NATIVE_WIDTH_PX = 640


@dataclass(frozen=True, slots=True)
class RegistrationSettings:
    """How far registration is off.

    Attributes:
        offset_sigma_px: offset of the depth image right and down, in pixels of an image 640 wide. Edges of depth lie
            3 to 4 px left and below those of colour in freiburg1_desk and freiburg1_rpy (the shift that makes their
            gradients agree best, over 40 frames of each).
        parallax_sigma_px_m: what is added for near things, over their depth: an error of 2 mm of the baseline at a
            focal length of 586 px. Chosen.
        period_s: of the cameras' own clocks. Depth is taken free of colour, so that it is up to half a period early or
            late: -19 to +17 ms in freiburg1_desk, 0 to 14 ms in 8.5 s of freiburg1_rpy.
        drift: how fast the one clock runs from the other, seconds a second; the same 14 ms in 8.5 s.
    """

    offset_sigma_px: float = 3.0
    parallax_sigma_px_m: float = 1.2
    period_s: float = 1 / 30
    drift: float = 1.7e-3


class Registration:
    """Of one unit, from its seed.

    Args:
        settings: how drivers register.
        width: of the images, pixels.
        rng: of the unit.
    """

    def __init__(self, settings: RegistrationSettings, width: int, rng: np.random.Generator) -> None:
        scale = width / _NATIVE_WIDTH_PX
        self._settings = settings
        self.offset_px: FloatArray = settings.offset_sigma_px * scale * rng.standard_normal(2)
        self.parallax_px_m: FloatArray = settings.parallax_sigma_px_m * scale * rng.standard_normal(2)
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

        Args:
            view: of the colour image.
            twist_camera: (6,) m/s and rad/s, velocity (v, ω) of the camera in its own frame.
            stamp_s: when colour was taken.
        """
        late_s = self.late_s(stamp_s)
        at, is_inside = self._sources(view, twist_camera, late_s)
        depth_m = np.where(is_inside, view.depth_m.ravel()[at], np.float32(0))
        v, w = np.split(np.asarray(twist_camera, float), 2)
        nearer = 1 + late_s * (w[0] * view.rays[..., 1] - w[1] * view.rays[..., 0]) * -1
        depth_m = np.where(depth_m > 0, np.maximum(depth_m * nearer - late_s * v[2], 1e-3), 0)
        geom = np.where(is_inside & (depth_m > 0), view.geom.ravel()[at], np.int32(-1))
        normal = view.normal_world.reshape(-1, 3)[at]
        normal[geom < 0] = 0
        return View(depth_m.astype(np.float32), geom, normal, view.T_world_camera, view.rays)

    def _sources(
        self, view: View, twist_camera: ArrayLike, late_s: float
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Which pixel of the view (H, W), as an index of the flat image, each one shows; and whether it is in it."""
        h, w = view.depth_m.shape
        with np.errstate(divide="ignore"):
            inverse = np.where(view.depth_m > 0, 1 / view.depth_m, np.float32(0))
        # What comes to a pixel later is now where it comes from.
        moved_px = image_flow(view, twist_camera) * np.float32(-late_s)
        columns = np.arange(w) + self.offset_px[0] + self.parallax_px_m[0] * inverse + moved_px[..., 0]
        rows = np.arange(h)[:, None] + self.offset_px[1] + self.parallax_px_m[1] * inverse + moved_px[..., 1]
        column, row = np.rint(columns).astype(np.int64), np.rint(rows).astype(np.int64)
        is_inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
        return np.where(is_inside, row * w + column, 0), is_inside
