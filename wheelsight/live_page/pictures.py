"""Images of a page: the plan, the costmap over it, and what the camera sees."""

from __future__ import annotations

import cv2
import numpy as np

from wheelsight.geometry import ByteArray
from wheelsight.navigation import CellState, Costmap, StaticLayer

# Blue, green, red, as OpenCV has them; told apart by people who see no red and green (Okabe & Ito 2008).
_PLAN = np.zeros((3, 3), np.uint8)
_PLAN[CellState.FREE] = 255, 255, 255
_PLAN[CellState.UNKNOWN] = 214, 207, 201
_PLAN[CellState.OCCUPIED] = 40, 40, 40
_COST, _LETHAL = (0, 159, 230), (0, 94, 213)
_COST_ALPHA, _LETHAL_ALPHA = 150, 190


def plan_png(layer: StaticLayer) -> bytes:
    """What is free, in the way and unknown; a pixel a cell, y up."""
    return _encoded(".png", _PLAN[np.minimum(layer.state[::-1], CellState.OCCUPIED)])


def costmap_png(costmap: Costmap) -> bytes:
    """What driving costs, to be laid over the plan: the dearer, the less clear; a pixel a cell, y up."""
    image = np.zeros((*costmap.cost.shape, 4), np.uint8)
    image[..., :3] = _COST
    image[..., 3] = np.clip(costmap.cost, 0, 1) * _COST_ALPHA
    image[costmap.is_lethal] = (*_LETHAL, _LETHAL_ALPHA)
    # Of what nobody knows the plan tells already; it would hide all else.
    image[costmap.state == CellState.UNKNOWN] = 0
    return _encoded(".png", image[::-1])


def camera_jpeg(rgb: ByteArray, width_px: int, quality: int) -> bytes:
    """An image (h, w, 3), no wider than so."""
    height, width = rgb.shape[:2]
    if width > width_px:
        size = width_px, max(1, round(height * width_px / width))
        rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
    return _encoded(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])


def _encoded(kind: str, image: ByteArray, how: list[int] | None = None) -> bytes:
    return bytes(cv2.imencode(kind, np.ascontiguousarray(image), how or [])[1])
