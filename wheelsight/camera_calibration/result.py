"""What a calibration by a board found: the calibration itself, how sure it is, and what it leaves unexplained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.camera_calibration.board import Board
from wheelsight.camera_calibration.views import Corners
from wheelsight.depth_error import DepthError
from wheelsight.geometry import FloatArray, IntArray, PinholeCamera
from wheelsight.point_errors import PointErrors


@dataclass(frozen=True, eq=False, slots=True)
class CornerResiduals:
    """Of one camera's corners: view (N,), pixel (N, 2), and predicted less seen (N, 2), pixels."""

    view: IntArray
    px: FloatArray
    off_px: FloatArray

    @property
    def rms_px(self) -> float:
        """Root mean square distance of a corner; NaN of none."""
        return float(np.sqrt((self.off_px**2).sum(axis=1).mean())) if len(self.px) else float("nan")

    def of_views(self, count: int) -> FloatArray:
        """The same of each of `count` views (count,)."""
        total = np.bincount(self.view, (self.off_px**2).sum(axis=1), count)
        return np.asarray(np.sqrt(total / np.maximum(np.bincount(self.view, minlength=count), 1)))


@dataclass(frozen=True, eq=False, slots=True)
class DepthResiduals:
    """Of depth cells: view (N,), pixel (N, 2), distance of the plane (N,), and corrected reading less it (N,), metres.

    `before_m` (N,) is the same of readings as they came, by the nominal disparity where they are raw.
    """

    view: IntArray
    px: FloatArray
    depth_m: FloatArray
    off_m: FloatArray
    before_m: FloatArray

    @property
    def rms_m(self) -> float:
        """Root mean square; NaN of none."""
        return float(np.sqrt((self.off_m**2).mean())) if len(self.off_m) else float("nan")


@dataclass(frozen=True, eq=False, slots=True)
class UsedView:
    """A view that counts: its name, corners in colour, and its board's pose in the colour camera (4, 4), metres."""

    name: str
    corners: Corners
    T_color_board: FloatArray

    @property
    def distance_m(self) -> float:
        """Of the board's origin along the axis."""
        return float(self.T_color_board[2, 3])


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """Two cameras calibrated by a board.

    Attributes:
        board: with the side of its squares as it was found, where nobody knew it.
        color, depth: the lenses; alike where depth is registered, and `depth` None where no view has any.
        T_color_depth: (4, 4), or None where depth is registered or there is none.
        depth_error: to free readings of.
        sensor: how depth is measured: one of `views.SENSORS`, or `RAW_DISPARITY`.
        sigmas: standard deviations by name: color.fx, depth.cx, T.x, T.roll_deg, …
        depth_sigma_m: pairs of distance and standard deviation of corrected depth there, (K, 2).
        point_errors: how far off points may be with all of that, in the colour camera's frame; None without depth.
        color_sigma_px: how far off the colour pixel of a depth pixel may be, root mean square over the image.
        noise: (constant_m, quadratic_per_m) of a pixel, as planes scatter; None without depth.
        views: those that count.
        left_out: names of others, and why.
        color_residuals, infrared_residuals, depth_residuals: what is left.
        dropped_corners, dropped_cells: how many disagreed with their view.
        warnings: what to know.
    """

    board: Board
    color: PinholeCamera
    depth: PinholeCamera | None
    T_color_depth: FloatArray | None
    depth_error: DepthError
    sensor: str
    sigmas: dict[str, float]
    depth_sigma_m: FloatArray
    point_errors: PointErrors | None
    color_sigma_px: float
    noise: tuple[float, float] | None
    views: tuple[UsedView, ...]
    left_out: tuple[tuple[str, str], ...]
    color_residuals: CornerResiduals
    infrared_residuals: CornerResiduals
    depth_residuals: DepthResiduals
    dropped_corners: int = 0
    dropped_cells: int = 0
    warnings: tuple[str, ...] = ()
