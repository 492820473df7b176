"""The parameters of two cameras, their depth error and the boards' poses.

The cost is that of Herrera, Kannala & Heikkilä, "Joint depth and color camera calibration with distortion correction",
TPAMI 34 (2012): corners in pixels and depth on the boards' planes, each over its standard deviation, with what is known
beforehand as further residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from wheelsight.camera_calibration.settings import CameraCalibrationSettings
from wheelsight.camera_calibration.splines import finer
from wheelsight.camera_calibration.task import nominal_step
from wheelsight.camera_calibration.views import RAW_DISPARITY
from wheelsight.depth_error import LARGEST_GRID, DepthError
from wheelsight.geometry import FloatArray, IntArray, PinholeCamera, se3, so3

_LENS, BARE_LENS, _POSE, BEFORE_KNOTS = 9, 4, 6, 3


class Points(NamedTuple):
    """Corners of all views, one after the other: view (N,), point on the board in squares (N, 3), pixel (N, 2)."""

    view: IntArray
    square: FloatArray
    px: FloatArray


class Cells(NamedTuple):
    """Depth cells of all views: view (N,), pixel (N, 2), reading (N,), a pixel's scatter in it (N,)."""

    view: IntArray
    px: FloatArray
    reading: FloatArray
    scatter: FloatArray


class Sigmas(NamedTuple):
    """Of corners in colour and infrared, pixels, and of depth: a factor on what its noise model says."""

    color_px: float
    infrared_px: float
    depth: float


@dataclass(frozen=True, eq=False)
class Model:
    """What is sought and what it is sought from.

    Attributes:
        color, infrared, cells: what was measured.
        color_start, depth_start: lenses to begin with; their sizes, and of the depth lens without infrared images the
            prior.
        sensor: one of `SENSORS`, or `RAW_DISPARITY`.
        is_registered: whether depth has colour's pixels.
        square_m: side of a square, or None where it is sought.
        noise: (constant_m, quadratic_per_m) of a cell, before `Sigmas.depth`.
        knots_m: distances (K,) of the curve's knots, two or more, where there is one.
        T_color_depth: (4, 4) to begin with.
        count: of views.
        settings: priors and grids.
        keeps_color: whether the colour lens is known and stays.
    """

    color: Points
    infrared: Points
    cells: Cells
    color_start: PinholeCamera
    depth_start: PinholeCamera
    sensor: str
    is_registered: bool
    square_m: float | None
    noise: tuple[float, float]
    knots_m: FloatArray
    T_color_depth: FloatArray
    count: int
    settings: CameraCalibrationSettings
    keeps_color: bool = False

    def slices(self) -> dict[str, slice]:
        """Where in the vector of parameters each block stands; poses last."""
        sizes = {
            "color": _LENS,
            "depth": 0 if self.is_registered else _LENS if self.seeks_depth_distortion else BARE_LENS,
            "apart": 0 if self.is_registered else _POSE,
            "square": int(self.square_m is None),
            "error": self._error_size() if len(self.cells.px) else 0,
            "poses": _POSE * self.count,
        }
        if not self.is_registered and not len(self.cells.px) and not len(self.infrared.px):
            sizes["depth"] = sizes["apart"] = 0
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    def _error_size(self) -> int:
        if self.sensor == "tof":
            return 3 + len(self.knots_m)
        if self.sensor == "stereo":
            return 3
        return BEFORE_KNOTS + 2 * self.grid[0] * self.grid[1]

    @property
    def seeks_depth_distortion(self) -> bool:
        """Whether boards must tell how the depth lens bends; stereo's images are straightened in the camera.

        Tilted planes tell it without infrared images too: a pixel that looks aside of where it is believed to meets a
        tilted plane nearer or farther. No lens is straight, nor is depth that a driver registers to a colour image.
        """
        return self.sensor != "stereo" or len(self.infrared.px) > 0

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of the pattern's knots."""
        return self.settings.model.pattern_rows, self.settings.model.pattern_columns

    @property
    def has_pattern(self) -> bool:
        """Whether depth is off over the image as disparities are."""
        return self.sensor in ("structured-light", RAW_DISPARITY)

    def color_camera(self, x: FloatArray) -> PinholeCamera:
        """The colour camera of parameters."""
        return _lens(x[self.slices()["color"]], self.color_start)

    def depth_camera(self, x: FloatArray) -> PinholeCamera:
        """The depth camera of parameters."""
        if self.is_registered:
            return self.color_camera(x)
        p = x[self.slices()["depth"]]
        return _lens(p, self.depth_start) if len(p) else self.depth_start

    def T_color_depth_of(self, x: FloatArray) -> FloatArray:
        """(4, 4) of parameters."""
        p = x[self.slices()["apart"]]
        return se3.exp(p) @ self.T_color_depth if len(p) else self.T_color_depth

    def square_of(self, x: FloatArray) -> float:
        """Side of a square, metres."""
        p = x[self.slices()["square"]]
        return float(np.exp(p[0])) if self.square_m is None else self.square_m

    def poses_of(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (count, 3, 3) and translations (count, 3), metres, from boards into the colour camera."""
        p = x[self.slices()["poses"]].reshape(-1, _POSE)
        return so3.exp(p[:, 3:]), p[:, :3] * self.square_of(x)

    def error_of(self, x: FloatArray) -> DepthError:
        """The depth error of parameters."""
        p = x[self.slices()["error"]]
        if not len(p):
            return DepthError()
        if self.sensor == "tof":
            knots_m, added_m = (finer(values, LARGEST_GRID).tolist() for values in (self.knots_m, p[3:]))
            curve = tuple(zip(knots_m, added_m, strict=True))
            return DepthError(float(np.exp(p[0])), float(p[1]), float(p[2]), curve_m=curve)
        if self.sensor == "stereo":
            return DepthError(float(np.exp(p[0])), radial_m=float(p[2]), inverse_per_m=float(p[1]))
        patterns = finer(finer(p[BEFORE_KNOTS:].reshape(2, *self.grid), LARGEST_GRID, 1), LARGEST_GRID, 2).tolist()
        pattern, lasting = (tuple(tuple(row) for row in rows) for rows in patterns)
        fade_m = float(np.clip(p[2], 0, 10))
        if self.sensor == RAW_DISPARITY:
            step = self.nominal_step * float(np.exp(p[0]))
            at_zero = -self.nominal_step * self.settings.model.disparity_of_infinity + float(p[1])
            numbers: dict[str, Any] = {"disparity_at_zero_per_m": at_zero, "disparity_step_per_m": step}
        else:
            numbers = {"scale": float(np.exp(p[0])), "inverse_per_m": float(p[1])}
        return replace(DepthError(**numbers), fade_m=fade_m, pattern_per_m=pattern, lasting_per_m=lasting)

    @property
    def nominal_step(self) -> float:
        """Inverse depth, 1/m, of one raw disparity, as Kinect v1's maker has it: an eighth of a pixel."""
        return nominal_step(self.settings)

    @property
    def is_scale_free(self) -> bool:
        """Whether depth's scale is sought: boards of unknown size take theirs from depth."""
        return self.square_m is not None


def _lens(p: FloatArray, start: PinholeCamera) -> PinholeCamera:
    """A lens of ln(fx / start's), ln(fy / fx), centre off the image's middle by start's fx, and Brown's numbers."""
    fx = start.fx * float(np.exp(p[0]))
    cx, cy = (start.width - 1) / 2 + start.fx * p[2], (start.height - 1) / 2 + start.fx * p[3]
    k1, k2, p1, p2, k3 = p[4:] if len(p) > BARE_LENS else start.distortion
    centre = float(np.clip(cx, 0, start.width)), float(np.clip(cy, 0, start.height))
    return PinholeCamera(start.width, start.height, fx, fx * float(np.exp(p[1])), *centre, (k1, k2, p1, p2, k3))


def lens_parameters(camera: PinholeCamera, start: PinholeCamera, is_bare: bool = False) -> FloatArray:
    """The parameters of a lens, seen from `start`."""
    centre = (camera.cx - (start.width - 1) / 2) / start.fx, (camera.cy - (start.height - 1) / 2) / start.fx
    bare = [np.log(camera.fx / start.fx), np.log(camera.fy / camera.fx), *centre]
    return np.array(bare if is_bare else [*bare, *camera.distortion], float)
