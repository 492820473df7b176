"""The pinhole camera with Brown's lens distortion: points to pixels and back (Trinh et al., eq. 1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import CalibrationError
from wheelsight.geometry.arrays import BoolArray, FloatArray, is_number

# Leaves less than 1e-8 pixel at the corners of the most distorted TUM camera (freiburg1).
_UNDISTORT_STEPS = 20
MOST_PIXELS = 1 << 25  # twice the largest depth camera's 16 million
# In longer sides of the image: from a view of 157°, wider than a pinhole's is, to pixels cut out of a large image.
_FOCAL_LENGTHS = 0.1, 1000.0
# Brown's coefficients are a few units at most, in long lenses some hundreds.
_LARGEST_DISTORTION = 1e4


@dataclass(frozen=True, slots=True)
class PinholeCamera:
    """Image size, focal lengths and principal point in pixels, and Brown's k1, k2, p1, p2, k3.

    Pixel centres lie at integers. The camera frame is optical: x right, y down, z forward.
    Raises CalibrationError for values no camera has.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        self._check_types()
        object.__setattr__(self, "distortion", tuple(float(k) for k in self.distortion))
        numbers = (self.width, self.height, self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.isfinite(numbers).all():
            raise CalibrationError(f"camera parameters must be finite numbers, not {numbers}")
        if self.width < 1 or self.height < 1 or self.fx <= 0 or self.fy <= 0:
            raise CalibrationError("a camera's image size and focal lengths must be positive")
        self._check_sizes()
        if not (-self.width < self.cx < 2 * self.width and -self.height < self.cy < 2 * self.height):
            raise CalibrationError(f"principal point ({self.cx}, {self.cy}) lies far outside the image")
        if len(self.distortion) != 5:
            raise CalibrationError("distortion takes five numbers: k1, k2, p1, p2, k3")

    def _check_types(self) -> None:
        for name in ("width", "height", "fx", "fy", "cx", "cy"):
            if not is_number(getattr(self, name)):
                fix = "give width, height, fx, fy, cx, cy in pixels"
                raise CalibrationError(f"{name} of a camera is a {type(getattr(self, name)).__name__}", fix=fix)
        try:
            known = all(is_number(k) for k in self.distortion)
        except TypeError:
            known = False
        if not known:
            raise CalibrationError("distortion takes five numbers: k1, k2, p1, p2, k3")

    def _check_sizes(self) -> None:
        for name, size in (("width", self.width), ("height", self.height)):
            if size != int(size):
                raise CalibrationError(f"{name} is {size:g}, not a whole number of pixels")
        if int(self.width) * int(self.height) > MOST_PIXELS:
            problem = f"width {self.width} × height {self.height} is larger than any depth camera's image"
            raise CalibrationError(problem, fix=f"at most {MOST_PIXELS / 1e6:.0f} million pixels")
        least, most = (share * max(self.width, self.height) for share in _FOCAL_LENGTHS)
        for name, focal_px in (("fx", self.fx), ("fy", self.fy)):
            if not least <= focal_px <= most:
                problem = (
                    f"{name} is {focal_px:g}, not {least:g} to {most:g} px in an image of {self.width}×{self.height}"
                )
                raise CalibrationError(problem, fix="give the focal length in pixels: metres / size of a pixel")
        largest = max(map(abs, self.distortion), default=0.0)
        if largest > _LARGEST_DISTORTION:
            problem = f"distortion holds {largest:g}, more than {_LARGEST_DISTORTION:g}"
            raise CalibrationError(problem, fix="give k1, k2, p1, p2, k3, which have no unit")

    @property
    def K(self) -> FloatArray:
        """The intrinsic matrix (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    @property
    def has_distortion(self) -> bool:
        """Whether any distortion coefficient differs from zero."""
        return any(self.distortion)

    def halved(self, times: int = 1) -> PinholeCamera:
        """The camera of images halved so often, each pixel of a 2×2 block; a row or column left over is cut off."""
        factor = 2.0**times
        width, height = self.width >> times, self.height >> times
        cx, cy = (self.cx + 0.5) / factor - 0.5, (self.cy + 0.5) / factor - 0.5  # pixel centres lie at integers
        return replace(self, width=width, height=height, fx=self.fx / factor, fy=self.fy / factor, cx=cx, cy=cy)

    def project(self, p_camera: ArrayLike) -> tuple[FloatArray, BoolArray]:
        """Pixels (..., 2) of points (..., 3) in metres, and (...) whether each is in front and in the image.

        Pixels of points that are not in front of the camera are NaN.
        """
        p = np.asarray(p_camera, float)
        in_front = p[..., 2] > 0
        z = np.where(in_front, p[..., 2], np.nan)
        px = self.denormalise(p[..., :2] / z[..., None])
        with np.errstate(invalid="ignore"):
            inside = (px >= -0.5).all(axis=-1) & (px < np.array([self.width, self.height]) - 0.5).all(axis=-1)
        return px, in_front & inside

    def back_project(self, px: ArrayLike, depth_m: ArrayLike) -> FloatArray:
        """Points (..., 3) in metres of pixels (..., 2) at depths (...) along z (Trinh et al., eq. 1)."""
        depth_m = np.asarray(depth_m, float)
        return np.concatenate([self.normalise(px) * depth_m[..., None], depth_m[..., None]], axis=-1)

    def denormalise(self, xy: ArrayLike) -> FloatArray:
        """Distorted pixels (..., 2) of undistorted coordinates (..., 2) on the plane z = 1."""
        xy = np.asarray(xy, float)
        if self.has_distortion:
            xy = self._distort(xy)
        return xy * (self.fx, self.fy) + (self.cx, self.cy)

    def normalise(self, px: ArrayLike) -> FloatArray:
        """Undistorted coordinates (..., 2) on the plane z = 1 of distorted pixels (..., 2)."""
        seen = (np.asarray(px, float) - (self.cx, self.cy)) / (self.fx, self.fy)
        if not self.has_distortion:
            return seen
        xy = seen
        for _ in range(_UNDISTORT_STEPS):
            radial, tangential = self._distortion_terms(xy)
            xy = (seen - tangential) / radial
        return xy

    def rays(self) -> FloatArray:
        """Directions (height, width, 3) with z = 1 of all pixels; times a depth image they are its points."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return self.back_project(np.stack([u, v], axis=-1), np.ones((self.height, self.width)))

    def _distort(self, xy: FloatArray) -> FloatArray:
        radial, tangential = self._distortion_terms(xy)
        return xy * radial + tangential

    def _distortion_terms(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The factor (..., 1) and the offset (..., 2) of Brown's model at undistorted coordinates."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = xy[..., 0], xy[..., 1]
        r2 = x**2 + y**2
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        offset = (2 * p1 * x * y + p2 * (r2 + 2 * x**2), p1 * (r2 + 2 * y**2) + 2 * p2 * x * y)
        return radial[..., None], np.stack(offset, axis=-1)
