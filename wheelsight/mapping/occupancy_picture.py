"""An occupancy map as a picture: what is free, what is in the way, a scale, and the way that was driven."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry import ByteArray, FloatArray, Int32Array
from wheelsight.mapping.occupancy import CellKind, OccupancyGrid

_LONGER_SIDE_PX = 1100
_LEAST_WIDTH_PX, _MOST_PX_A_CELL = 640, 16
# Told apart by people who see no red and green (Okabe & Ito 2008); red, green, blue.
_COLOURS = {
    CellKind.UNKNOWN: (222, 222, 222),
    CellKind.FREE: (255, 255, 255),
    CellKind.OVERHANG: (190, 225, 245),
    CellKind.OBSTACLE: (40, 40, 40),
    CellKind.DROP_OFF: (213, 94, 0),
    CellKind.KEEP_OUT: (204, 121, 167),
}
_WAY, _INK = (0, 114, 178), (40, 40, 40)
_SCALES_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_STRIP_PX, _GAP_PX = 34, 10


def picture_of(grid: OccupancyGrid, stretches: Sequence[ArrayLike] = ()) -> ByteArray:
    """The map (h, w, 3) uint8 red, green, blue, y up the page, with a legend below.

    Args:
        grid: as it is.
        stretches: of the way, (K, 2) places in `map` each: dots, joined by a line within a stretch. A circle is the
            first of all, a square the last.
    """
    rows, columns = grid.kind.shape
    px = min(max(_LONGER_SIDE_PX // max(rows, columns), 1), _MOST_PX_A_CELL)
    colours = np.array([_COLOURS[kind] for kind in CellKind], np.uint8)
    image = colours[grid.kind[::-1]].repeat(px, axis=0).repeat(px, axis=1)
    image = np.ascontiguousarray(image)
    _draw_way(image, grid, [np.asarray(stretch, float).reshape(-1, 2) for stretch in stretches], px)
    wide = np.full((image.shape[0], max(image.shape[1], _LEAST_WIDTH_PX), 3), _COLOURS[CellKind.UNKNOWN], np.uint8)
    left = (wide.shape[1] - image.shape[1]) // 2
    wide[:, left : left + image.shape[1]] = image
    return np.concatenate([wide, _legend(grid, px, wide.shape[1])])


def _draw_way(image: ByteArray, grid: OccupancyGrid, stretches: list[FloatArray], px: int) -> None:
    if not sum(map(len, stretches)):
        return
    for stretch in stretches:
        at = _pixels(stretch, grid, px)
        cv2.polylines(image, [at], isClosed=False, color=_WAY, thickness=2, lineType=cv2.LINE_AA)
        for dot in at.tolist():
            cv2.circle(image, dot, 3, _WAY, -1, cv2.LINE_AA)
    ends = _pixels(np.concatenate(stretches)[[0, -1]], grid, px)
    cv2.circle(image, ends[0].tolist(), 6, _WAY, -1, cv2.LINE_AA)
    cv2.rectangle(image, (ends[1] - 5).tolist(), (ends[1] + 5).tolist(), _WAY, -1)


def _pixels(p_map: FloatArray, grid: OccupancyGrid, px: int) -> Int32Array:
    """(K, 2)."""
    cells = (p_map - grid.origin) / grid.resolution_m
    return np.rint(px * np.stack([cells[:, 0], len(grid.kind) - cells[:, 1]], axis=-1)).astype(np.int32)


def _legend(grid: OccupancyGrid, px: int, width: int) -> ByteArray:
    """(h, width, 3): the colours that occur, and a scale."""
    shown = [kind for kind in CellKind if (grid.kind == kind).any()]
    names = [kind.name.lower().replace("_", "-") for kind in shown]
    spans = [28 + 8 * len(name) + _GAP_PX for name in names]
    at = [_GAP_PX + sum(spans[:k]) for k in range(len(spans))]
    a_metre = px / grid.resolution_m
    scale_m = max([length for length in _SCALES_M if length * a_metre <= width / 5] or [_SCALES_M[0]])
    length = ceil(scale_m * a_metre)
    strip = np.full((_STRIP_PX, width, 3), 255, np.uint8)
    for kind, name, left in zip(shown, names, at, strict=True):
        cv2.rectangle(strip, (left, 9), (left + 16, 25), _COLOURS[kind], -1)
        cv2.rectangle(strip, (left, 9), (left + 16, 25), _INK, 1)
        _write(strip, name, left + 22)
    right = width - _GAP_PX
    text = f"{scale_m:g} m"
    cv2.line(strip, (right - length, 17), (right, 17), _INK, 3)
    _write(strip, text, right - length - 9 * len(text) - 4)
    return strip


def _write(strip: ByteArray, text: str, left: int) -> None:
    cv2.putText(strip, text, (left, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.43, _INK, 1, cv2.LINE_AA)
