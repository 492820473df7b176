"""Which depth pixels show the board's plane, and their means over small cells."""

from __future__ import annotations

import cv2
import numpy as np

from wheelsight.camera_calibration.settings import DepthSampleSettings
from wheelsight.camera_calibration.views import DepthCells
from wheelsight.geometry import BoolArray, Float32Array, FloatArray

_FIT_ROUNDS, _FEWEST_PX = 4, 50
_NOISE_SIGMAS = 4.5  # of a pixel's: one in 10⁵ is lost
_MOST_OF_CELL = 0.8


def board_cells(
    reading: Float32Array,
    outline_px: FloatArray,
    settings: DepthSampleSettings,
    *,
    is_disparity: bool,
    on_plate: bool,
) -> DepthCells:
    """Cells of the plane that a board is on, of one depth image.

    Args:
        reading: (H, W) depths in metres or raw disparities; 0 where there is none.
        outline_px: (N, 2) of what surely is board, in depth pixels.
        settings: which pixels count.
        is_disparity: whether readings are raw disparities.
        on_plate: whether the plane goes on around the outline; else cells stay within it.
    """
    seen = np.isfinite(reading) & (reading > 0)
    within = np.zeros(reading.shape, np.uint8)
    cv2.fillConvexPoly(within, cv2.convexHull(outline_px.astype(np.float32)).astype(np.int32), 1)
    plane = _plane(reading, seen, seen & (within > 0), settings.same_plane, is_disparity)
    if plane is None:
        return DepthCells.none()
    on_plane, off = plane
    kept = _grown(on_plane, within > 0) if on_plate else on_plane & (within > 0)
    rim = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * settings.rim_px + 1,) * 2)
    # Beside a hole as much as at the plate's edge: what shades it is no plane.
    closed = cv2.morphologyEx(kept.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    whole = cv2.erode(closed, rim, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    cells = _cells(reading, off, whole & on_plane, settings.cell_px)
    if len(cells.reading) < settings.fewest_cells:
        return DepthCells.none()
    if len(cells.reading) > settings.most_cells:
        cells = cells.only(np.linspace(0, len(cells.reading) - 1, settings.most_cells).round().astype(np.int64))
    return cells


def _plane(
    reading: Float32Array, seen: BoolArray, seed: BoolArray, same_plane: float, is_disparity: bool
) -> tuple[BoolArray, FloatArray] | None:
    """(H, W) whether a pixel lies on the plane of most of the seed, and how far off; None where there is too little.

    How far is in inverse depth, or raw disparity.
    """
    if np.count_nonzero(seed) < _FEWEST_PX:
        return None
    v, u = np.nonzero(seed)
    # Of a plane, disparity and inverse depth are linear in the pixel.
    inverse = reading if is_disparity else np.divide(1, reading, out=np.zeros_like(reading), where=seen)
    values, A = inverse[v, u].astype(float), np.stack([u, v, np.ones(len(u))], axis=-1)
    kept = np.abs(values - np.median(values)) <= 3 * max(float(np.subtract(*np.percentile(values, (75, 25)))), 1e-6)
    plane = np.zeros(3)
    for _ in range(_FIT_ROUNDS):
        plane = np.linalg.lstsq(A[kept], values[kept], rcond=None)[0]
        off = np.abs(values - A @ plane)
        kept = off <= max(3 * 1.48 * float(np.median(off[kept])), 1e-9)
        if np.count_nonzero(kept) < _FEWEST_PX:
            return None
    height, width = reading.shape
    expected = plane[0] * np.arange(width) + plane[1] * np.arange(height)[:, None] + plane[2]
    # Kinect's raw disparities fall to 0 inverse depth at about 1090: a share of the depth is one of 1090 - d.
    least = same_plane * (np.abs(1090.0 - expected) if is_disparity else np.abs(expected))
    least = np.maximum(least, _NOISE_SIGMAS * 1.48 * float(np.median(np.abs(values - A @ plane)[kept])))
    return np.asarray(seen & (np.abs(inverse - expected) <= least)), np.asarray(inverse - expected, float)


def _grown(on_plane: BoolArray, within: BoolArray) -> BoolArray:
    """What of the plane hangs together with the outline."""
    _, labels = cv2.connectedComponents(on_plane.astype(np.uint8), connectivity=4)
    inside = labels[within & on_plane]
    return np.asarray(labels == np.bincount(inside).argmax()) if len(inside) else on_plane & within


def _cells(reading: Float32Array, off: FloatArray, kept: BoolArray, side: int) -> DepthCells:
    """Means of the cells of side × side pixels most of which are kept."""
    rows, columns = (length // side for length in reading.shape)
    tiles = (slice(0, rows * side), slice(0, columns * side))
    v, u = np.mgrid[0 : reading.shape[0], 0 : reading.shape[1]]

    def sums(values: FloatArray) -> FloatArray:
        return np.asarray(values[tiles].reshape(rows, side, columns, side).sum(axis=(1, 3)), float)

    counts = sums(kept.astype(float))
    full = counts >= _MOST_OF_CELL * side**2
    # Where pixels are missing, the mean is of another place than the cell's middle.
    values = (u, v, reading, off, off**2)
    means = [sums(np.where(kept, value, 0.0))[full] / counts[full] for value in values]
    scatter = np.sqrt(np.maximum(means[4] - means[3] ** 2, 0))
    return DepthCells(np.stack(means[:2], axis=-1), means[2], scatter)
