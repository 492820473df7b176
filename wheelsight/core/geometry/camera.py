"""`PinholeCamera` projects points to pixels and back, with Brown's lens distortion (Trinh et al., eq. 1).
`fitted_lens` approximates another lens model by Brown's coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry.arrays import BoolArray, FloatArray, is_number

# Leaves less than 1e-8 pixel at the corners of the most distorted TUM camera (freiburg1).
_UNDISTORT_STEPS = 20
MOST_PIXELS = 1 << 25  # twice the largest depth camera's 16 million
# In longer sides of the image: from a view of 157°, too wide for a pinhole, to a cut-out of a large image.
_FOCAL_LENGTHS = 0.1, 1000.0
# Brown's coefficients are a few units at most, in long lenses some hundreds.
_LARGEST_DISTORTION = 1e4
# Rays from the principal point, and radii on each up to 87° off the axis, at which a lens is checked.
_RAYS, _RADII = 32, np.geomspace(1e-4, 20.0, 300)
# Share of the image: calibrations of cheap lenses fold in the last corner, beyond the board that they were made by.
_MOST_FOLDED = 0.05
# Radius of a point in the image over that of a pinhole: the strongest pincushion stays under 1.3.
_MOST_STRETCH = 2.0


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
        """The camera of images halved `times` times, each pixel of a 2×2 block; odd rows and columns are cut off."""
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

    def lens_fault(self) -> str | None:
        """The problem of an impossible distortion, which folds or stretches within the image; else None."""
        if not self.has_distortion:
            return None
        k1, k2, p1, p2, k3 = self.distortion
        angles = np.linspace(0, 2 * np.pi, _RAYS, endpoint=False)
        xy = _RADII[None, :, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None, :]
        with np.errstate(all="ignore"):
            seen = self._distort(xy)
            reach = np.linalg.norm(seen, axis=2)
            px = seen * (self.fx, self.fy) + (self.cx, self.cy)
            inside = (px >= -0.5).all(axis=-1) & (px <= np.array([self.width, self.height]) - 0.5).all(axis=-1)
            to_end = np.where(seen > 0, [self.width - 0.5 - self.cx, self.height - 0.5 - self.cy], [self.cx, self.cy])
            shares = np.abs(seen) * (self.fx, self.fy) / np.maximum(to_end, 1e-9)
            far = np.linalg.norm(seen, axis=-1) / np.maximum(shares.max(axis=-1), 1e-9)
            inside, border = np.asarray(inside), np.asarray(far, float)
            sees = np.logical_and.accumulate(inside, axis=1)
            # The determinant of the distortion's derivative is not positive where the lens folds.
            x, y = xy[..., 0], xy[..., 1]
            r2 = x**2 + y**2
            radial, slope = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
            across = slope * x * y + 2 * p1 * x + 2 * p2 * y
            along = radial + slope * x**2 + 2 * p1 * y + 6 * p2 * x, radial + slope * y**2 + 6 * p1 * y + 2 * p2 * x
            folds = sees & ~(along[0] * along[1] - across**2 > 0)
            first = folds.argmax(axis=1)
            at_fold = (np.arange(_RAYS), first)
            lost = np.where(folds.any(axis=1), 1 - np.minimum(reach[at_fold] / border[at_fold], 1) ** 2, 0.0)
            stretch = float(np.where(sees, reach / _RADII, 0.0).max())
        if lost.mean() > _MOST_FOLDED:
            return f"folds the image: {100 * lost.mean():.0f} % of it would show no point"
        if stretch > _MOST_STRETCH:
            return f"stretches the image {stretch:.2g}-fold within its border"
        return None

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


class LensFit(NamedTuple):
    """Brown's k1, k2, p1, p2, k3 for another model of a lens, and largest and median residual on the plane z = 1."""

    distortion: tuple[float, float, float, float, float]
    worst: float
    median: float


def fitted_lens(xy: ArrayLike, xy_distorted: ArrayLike) -> LensFit:
    """Fit Brown's model, linear in its coefficients, to undistorted and distorted points (N, 2) on the plane z = 1."""
    seen: FloatArray = np.asarray(xy, float)
    shift: FloatArray = np.asarray(xy_distorted, float) - seen
    x, y = seen.T
    r2 = x**2 + y**2
    rows = np.stack(
        [
            np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x**2, x * r2**3], axis=1),
            np.stack([y * r2, y * r2**2, r2 + 2 * y**2, 2 * x * y, y * r2**3], axis=1),
        ],
        axis=1,
    )
    found = np.linalg.lstsq(rows.reshape(-1, 5), shift.reshape(-1), rcond=None)[0]
    left = rows @ found - shift
    k1, k2, p1, p2, k3 = (float(k) for k in found)
    off = np.linalg.norm(left, axis=1)
    return LensFit((k1, k2, p1, p2, k3), float(off.max()), float(np.median(off)))
