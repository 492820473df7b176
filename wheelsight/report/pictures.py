"""Two frames side by side with the matches that joined them, as an image a page can hold."""

from __future__ import annotations

import base64

import cv2
import numpy as np

from wheelsight.geometry import BoolArray, ByteArray, FloatArray, IntArray
from wheelsight.pipeline.run_record import MatchPicture

INLIER_RGB = (0, 158, 115)
OUTLIER_RGB = (213, 94, 0)
_HALO_RGB = (255, 255, 255)
_PANEL_WIDTH_PX = 640
_GUTTER_PX = 6
_DRAWN_LINES = 100
_QUALITY = 85
_SUBPIXEL_BITS = 4


def draw_matches(picture: MatchPicture) -> ByteArray:
    """The reference frame (left) and the current frame (right) with their matches, (H, W, 3) uint8, red green blue.

    Each match is marked in both images, inliers with circles, outliers with crosses; about 100 of them,
    evenly chosen, are joined by a line. Images wider than 640 px are drawn smaller.
    """
    left, left_scale = _panel(picture.reference_color)
    right, right_scale = _panel(picture.color)
    canvas = np.full((max(len(left), len(right)), left.shape[1] + _GUTTER_PX + right.shape[1], 3), 255, np.uint8)
    canvas[: len(left), : left.shape[1]] = left
    canvas[: len(right), left.shape[1] + _GUTTER_PX :] = right
    start = np.asarray(picture.reference_px, float).reshape(-1, 2) * left_scale
    end = np.asarray(picture.px, float).reshape(-1, 2) * right_scale + (left.shape[1] + _GUTTER_PX, 0)
    drawable = np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)
    is_inlier = np.asarray(picture.is_inlier, bool)
    classes = ((is_inlier & drawable, INLIER_RGB), (~is_inlier & drawable, OUTLIER_RGB))
    for which, colour in classes:
        _draw_lines(canvas, start, end, _evenly(which, drawable.sum()), colour)
    for which, colour in classes:
        _draw_marks(canvas, np.concatenate([start[which], end[which]]), colour)
    return canvas


def data_uri(picture: MatchPicture) -> str:
    """`draw_matches` in a data URI."""
    return webp_uri(draw_matches(picture))


def webp_uri(image: ByteArray) -> str:
    """An image (H, W, 3) uint8, red green blue, as WebP in a data URI."""
    _, webp = cv2.imencode(".webp", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    return "data:image/webp;base64," + base64.b64encode(webp.tobytes()).decode("ascii")


def _panel(color: ByteArray) -> tuple[ByteArray, float]:
    """The image, brought to the panel's width where it is wider, and its scale."""
    scale = min(1.0, _PANEL_WIDTH_PX / color.shape[1])
    if scale == 1.0:
        return color, scale
    size = (_PANEL_WIDTH_PX, max(1, round(color.shape[0] * scale)))
    return np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8), scale


def _evenly(which: BoolArray, total: int) -> IntArray:
    """Indices of the chosen matches to be joined by lines: their fair part of all lines drawn."""
    index = np.flatnonzero(which)
    share = min(len(index), int(np.ceil(_DRAWN_LINES * len(index) / max(total, 1))))
    return index[np.linspace(0, len(index) - 1, share).round().astype(int)] if share else index


def _draw_lines(
    canvas: ByteArray, start: FloatArray, end: FloatArray, index: IntArray, colour: tuple[int, int, int]
) -> None:
    for i in index:
        cv2.line(canvas, _fixed(start[i]), _fixed(end[i]), colour, 1, cv2.LINE_AA, _SUBPIXEL_BITS)


def _draw_marks(canvas: ByteArray, points: FloatArray, colour: tuple[int, int, int]) -> None:
    for point in points:
        x, y = point.round().astype(int).tolist()
        for shade, width in ((_HALO_RGB, 3), (colour, 2)):
            if colour == INLIER_RGB:
                cv2.circle(canvas, _fixed(point), 3 << _SUBPIXEL_BITS, shade, width, cv2.LINE_AA, _SUBPIXEL_BITS)
            else:
                cv2.drawMarker(canvas, (x, y), shade, cv2.MARKER_TILTED_CROSS, 7, width, cv2.LINE_AA)


def _fixed(point: FloatArray) -> tuple[int, int]:
    x, y = (point * (1 << _SUBPIXEL_BITS)).round().astype(int).tolist()
    return x, y
