"""Depth images that are registered to colour by a driver: some pixels off, and taken at another moment."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wheelsight.geometry import BoolArray, Float32Array, FloatArray
from wheelsight.simulation.color_sensor import image_flow
from wheelsight.simulation.view import View

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

    Args:
        settings: how drivers register.
        width: of the images, pixels.
        rng: of the unit.
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

        Args:
            view: of the colour image.
            twist_camera: (6,) m/s and rad/s, velocity (v, ω) of the camera in its own frame.
            stamp_s: when colour was taken.
        """
        late_s = self.late_s(stamp_s)
        at, is_inside = self._sources(view, twist_camera, late_s)
        is_inside &= ~self._beside_steps(view.depth_m).ravel()[at]
        depth_m = np.where(is_inside, view.depth_m.ravel()[at], np.float32(0))
        v, w = np.split(np.asarray(twist_camera, float), 2)
        nearer = 1 + late_s * (w[0] * view.rays[..., 1] - w[1] * view.rays[..., 0]) * -1
        depth_m = np.where(depth_m > 0, np.maximum(depth_m * nearer - late_s * v[2], 1e-3), 0)
        geom = np.where(is_inside & (depth_m > 0), view.geom.ravel()[at], np.int32(-1))
        normal = view.normal_world.reshape(-1, 3)[at]
        normal[geom < 0] = 0
        return View(depth_m.astype(np.float32), geom, normal, view.T_world_camera, view.rays)

    def _sources(self, view: View, twist_camera: ArrayLike, late_s: float) -> tuple[NDArray[np.int64], BoolArray]:
        """Which pixel of the view (H, W), as an index of the flat image, each one shows; and whether it is in it."""
        h, w = view.depth_m.shape
        with np.errstate(divide="ignore"):
            inverse = np.where(view.depth_m > 0, 1 / view.depth_m, np.float32(0))
        # What comes to a pixel later is now where it comes from.
        moved_px = image_flow(view, twist_camera) * np.float32(-late_s)
        along, down = np.arange(w), np.arange(h)[:, None]
        columns = (
            along
            + self.scale * (along - w / 2)
            + self.offset_px[0]
            + self.parallax_px_m[0] * inverse
            + moved_px[..., 0]
        )
        rows = (
            down + self.scale * (down - h / 2) + self.offset_px[1] + self.parallax_px_m[1] * inverse + moved_px[..., 1]
        )
        column, row = np.rint(columns).astype(np.int64), np.rint(rows).astype(np.int64)
        is_inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
        return np.where(is_inside, row * w + column, 0), is_inside & self._in_sight(h, w)

    def _in_sight(self, h: int, w: int) -> BoolArray:
        """(H, W) which pixels of the colour image the depth camera sees."""
        left, top, right, bottom = (round(self._scale * px) for px in self._settings.border_px)
        is_in_sight = np.zeros((h, w), bool)
        is_in_sight[top : h - bottom, left : w - right] = True
        return is_in_sight

    def _beside_steps(self, depth_m: Float32Array) -> BoolArray:
        """(H, W) where a block of the pattern lies on two depths."""
        s = self._settings
        near_m = cv2.erode(np.where(depth_m > 0, depth_m, np.float32(_FAR_M)), _CROSS)
        far_m = cv2.dilate(depth_m, _CROSS)
        step_px = _FOCAL_BASELINE_PX_M * (1 / np.maximum(near_m, 0.1) - 1 / np.maximum(far_m, 0.1))
        across = max(round(s.hole_px * self._scale), 1)
        shape = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (across, across))
        return np.asarray(cv2.dilate((step_px > s.step_px).astype(np.uint8), shape), bool)
