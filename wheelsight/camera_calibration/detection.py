"""A board's corners in one image, or why there are none."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from wheelsight.camera_calibration.board import Board
from wheelsight.camera_calibration.settings import DetectionSettings
from wheelsight.camera_calibration.views import Corners
from wheelsight.geometry import ByteArray

_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE
# Infrared images are dark but for reflections: what lies between these percentiles is stretched.
_DARKEST, _BRIGHTEST = 1.0, 99.0
_OTHER_SIZES = tuple((columns, rows) for columns in range(4, 13) for rows in range(3, columns + 1))


def find_corners(image: ByteArray, board: Board, settings: DetectionSettings) -> Corners | str:
    """The board's corners in a grey image (H, W) uint8, or why it has none."""
    found = _charuco(image, board) if board.is_charuco else _checkerboard(image, board, settings)
    if found is None:
        return "no whole board is seen" if not board.is_charuco else "no board is seen"
    if len(found.ids) < min(settings.fewest_corners, board.count):
        return f"only {len(found.ids)} corners of the board are seen"
    width_px = edge_width_px(image, found, board)
    if width_px > settings.blurred_px:
        return f"blurred: edges take {width_px:.1f} px"
    return found


def as_grey(image: Any) -> ByteArray:
    """An image of any depth and channels as grey (H, W) uint8, stretched where it has 16 bits."""
    if image.ndim == 3:
        image = cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY)
    if image.dtype == np.uint8:
        return np.asarray(image, np.uint8)
    low, high = np.percentile(image, (_DARKEST, _BRIGHTEST))
    return np.asarray(np.clip((image.astype(float) - low) / max(high - low, 1) * 255, 0, 255), np.uint8)


def _checkerboard(image: ByteArray, board: Board, settings: DetectionSettings) -> Corners | None:
    size = (board.columns, board.rows)
    found, px = cv2.findChessboardCornersSB(image, size, flags=_FLAGS)
    if not found and image.shape[1] < settings.enlarge_below_px:
        large = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        found, px = cv2.findChessboardCornersSB(large, size, flags=_FLAGS)
        if found:
            px = (px + 0.5) / 2 - 0.5
    if not found:
        return None
    return Corners(np.arange(board.count), np.asarray(px, float).reshape(-1, 2))


def _charuco(image: ByteArray, board: Board) -> Corners | None:
    px, ids, _, _ = cv2.aruco.CharucoDetector(board.charuco()).detectBoard(image)
    if ids is None or not len(ids):
        return None
    return Corners(np.asarray(ids, np.int64).ravel(), np.asarray(px, float).reshape(-1, 2))


def edge_width_px(image: ByteArray, corners: Corners, board: Board) -> float:
    """How many pixels an edge between squares takes from 10 to 90 %: the median over pairs of neighbouring corners.

    0 where no two neighbours are seen.
    """
    places = {int(number): px for number, px in zip(corners.ids, corners.px, strict=True)}
    widths = []
    for number, px in places.items():
        for step in (1, board.columns):
            if number + step in places and (step != 1 or (number + 1) % board.columns):
                widths.append(_width_across(image, px, places[number + step]))
    return float(np.median(widths)) if widths else 0.0


def _width_across(image: ByteArray, a: Any, b: Any) -> float:
    """Of the edge from corner a to corner b, measured across it at its middle: 0.8 of its contrast over its slope."""
    length = float(np.linalg.norm(b - a))
    across = np.array([a[1] - b[1], b[0] - a[0]]) / max(length, 1e-9)
    reach = 0.45 * length
    at = np.linspace(-reach, reach, 41)
    along = a + (b - a) * np.linspace(0.3, 0.7, 5)[:, None]
    map_px = (along[:, None] + at[None, :, None] * across).astype(np.float32)
    profile = cv2.remap(image.astype(np.float32), map_px[..., 0], map_px[..., 1], cv2.INTER_LINEAR).mean(axis=0)
    contrast = abs(float(profile[:6].mean() - profile[-6:].mean()))
    slope = float(np.abs(np.gradient(profile, at)).max())
    return 0.8 * contrast / max(slope, 1e-6)


def other_size(image: ByteArray, board: Board) -> tuple[int, int] | None:
    """Inner corners of a checkerboard that is in the image while `board` is not; None where none is found."""
    for columns, rows in _OTHER_SIZES:
        if {columns, rows} == {board.columns, board.rows}:
            continue
        found, px = cv2.findChessboardCornersSB(
            image, (columns, rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
        )
        if found and len(px) == columns * rows:
            return columns, rows
    return None
