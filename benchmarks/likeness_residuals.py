"""How well images agree under the true motion: what any odometry has to live with, whichever it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory

_STRIDE_PX = 4
_LARGEST_JUMP = 0.1  # of the depth: beyond, another surface is seen
_FEWEST = 200


@dataclass(frozen=True, slots=True)
class Residuals:
    """Medians over pixels, of what is seen twice.

    Attributes:
        depth_per_m: |measured - expected depth| over its square, 1/m: Kinect's noise alone gives 1.4e-3.
        grey: |difference of grey| in levels, after the change of exposure.
    """

    depth_per_m: float
    grey: float


def residuals(
    frames: Sequence[RgbdFrame], truth: Trajectory, calibration: Calibration, apart: int = 5
) -> Residuals | None:
    """Of pairs so many frames apart, carried into each other by the truth; None where none can be compared."""
    if not calibration.is_registered:
        return None
    found = [
        pair
        for a, b in zip(frames[::apart], frames[apart::apart], strict=False)
        if (pair := _of_pair(a, b, truth, calibration)) is not None
    ]
    return Residuals(*np.median(found, axis=0).tolist()) if found else None


def _of_pair(a: RgbdFrame, b: RgbdFrame, truth: Trajectory, calibration: Calibration) -> FloatArray | None:
    stamps_s = np.array([a.stamp_s, b.stamp_s])
    if stamps_s[0] < truth.stamps_s[0] or stamps_s[1] > truth.stamps_s[-1]:
        return None
    T_world_a, T_world_b = truth.at(stamps_s)
    camera, _ = calibration.cameras
    v, u = np.mgrid[0 : camera.height : _STRIDE_PX, 0 : camera.width : _STRIDE_PX].reshape(2, -1)
    depth_m = a.depth_m[v, u]
    v, u, depth_m = (values[depth_m > 0] for values in (v, u, depth_m))
    p_a = camera.back_project(np.stack([u, v], axis=-1), depth_m)
    p_b = se3.apply(se3.compose(se3.invert(T_world_b), T_world_a), p_a)
    px, is_inside = camera.project(p_b)
    column, row = np.rint(np.where(is_inside[:, None], px, 0)).astype(int).T
    row, column = row.clip(0, camera.height - 1), column.clip(0, camera.width - 1)
    measured_m, expected_m = b.depth_m[row, column], p_b[:, 2]
    is_same = is_inside & (measured_m > 0) & (np.abs(measured_m - expected_m) < _LARGEST_JUMP * expected_m)
    if np.count_nonzero(is_same) < _FEWEST:
        return None
    grey_a, grey_b = (cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY).astype(float) for frame in (a, b))
    change = grey_b[row, column][is_same] - grey_a[v, u][is_same]
    depth = np.abs(measured_m - expected_m)[is_same] / expected_m[is_same] ** 2
    return np.array([np.median(depth), np.median(np.abs(change - np.median(change)))])
