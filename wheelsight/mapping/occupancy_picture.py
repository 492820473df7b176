"""An occupancy map as a picture: what is free, what is in the way, a scale, and the way that was driven."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.files import StrPath, write_bytes
from wheelsight.geometry import ByteArray, FloatArray
from wheelsight.mapping.occupancy import CellKind, OccupancyGrid

_LONGER_SIDE_PX = 1100
_LEAST_WIDTH_PX, _MOST_PX_A_CELL = 640, 16
# Told apart by people who see no red and green (Okabe & Ito 2008); red, green, blue.
COLOURS = {
    CellKind.UNKNOWN: (222, 222, 222),
    CellKind.FREE: (255, 255, 255),
    CellKind.OVERHANG: (190, 225, 245),
    CellKind.OBSTACLE: (40, 40, 40),
    CellKind.DROP_OFF: (213, 94, 0),
    CellKind.KEEP_OUT: (204, 121, 167),
}
_WAY, _INK, _PAPER = (0, 114, 178), (40, 40, 40), (255, 255, 255)
_CROSS, _LEAST_STEP_PX = (170, 170, 170), 70
_SCALES_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_STRIP_PX, _GAP_PX = 34, 10


@dataclass(frozen=True, slots=True, eq=False)
class PlanLine:
    """A line over the map.

    Attributes:
        points: (N, 2) in `map`; closed outlines have their first point at the end again.
        colour: red, green, blue.
        name: for the legend; empty for none.
        width_px: of it.
        text: in the middle of its points.
    """

    points: ArrayLike
    colour: tuple[int, int, int]
    name: str = ""
    width_px: int = 2
    text: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class PlanMark:
    """A place on the map.

    Attributes:
        xy: (2,) in `map`.
        sign: its form.
        colour: red, green, blue.
        name: for the legend; empty for none.
        text: beside it.
    """

    xy: ArrayLike
    sign: Literal["circle", "square", "cross"]
    colour: tuple[int, int, int]
    name: str = ""
    text: str = ""


def picture_of(
    grid: OccupancyGrid,
    stretches: Sequence[ArrayLike] = (),
    lines: Sequence[PlanLine] = (),
    marks: Sequence[PlanMark] = (),
    *,
    has_axes: bool = False,
) -> ByteArray:
    """The map (h, w, 3) uint8 red, green, blue, y up the page, with a legend below.

    Args:
        grid: as it is.
        stretches: of the way, (K, 2) places in `map` each: dots, joined by a line within a stretch. A circle is the
            first of all, a square the last.
        lines, marks: what else is drawn, in this order.
        has_axes: whether x and y are written at its edges, by which places can be read off.
    """
    rows, columns = grid.kind.shape
    px = min(max(_LONGER_SIDE_PX // max(rows, columns), 1), _MOST_PX_A_CELL)
    colours = np.array([COLOURS[kind] for kind in CellKind], np.uint8)
    image = colours[grid.kind[::-1]].repeat(px, axis=0).repeat(px, axis=1)
    image = np.ascontiguousarray(image)
    if has_axes:
        _draw_axes(image, grid, px)
    _draw_way(image, grid, [np.asarray(stretch, float).reshape(-1, 2) for stretch in stretches], px)
    for line in lines:
        _draw_line(image, grid, line, px)
    for mark in marks:
        _draw_mark(image, grid, mark, px)
    wide = np.full((image.shape[0], max(image.shape[1], _LEAST_WIDTH_PX), 3), COLOURS[CellKind.UNKNOWN], np.uint8)
    left = (wide.shape[1] - image.shape[1]) // 2
    wide[:, left : left + image.shape[1]] = image
    drawn: list[PlanLine | PlanMark] = [*lines, *marks]
    named = [one for one in drawn if one.name]
    below = [_named(named, wide.shape[1])] if named else []
    return np.concatenate([wide, *below, _legend(grid, px, wide.shape[1])])


def save_picture(image: ByteArray, path: StrPath) -> None:
    """Write red, green, blue (h, w, 3) as PNG, atomically. Raises OutputError."""
    written, code = cv2.imencode(".png", image[..., ::-1])
    assert written
    write_bytes(path, code.tobytes())


def _draw_way(image: ByteArray, grid: OccupancyGrid, stretches: list[FloatArray], px: int) -> None:
    if not sum(map(len, stretches)):
        return
    for stretch in stretches:
        at = _pixels(grid, stretch, px)
        cv2.polylines(image, [at], isClosed=False, color=_WAY, thickness=2, lineType=cv2.LINE_AA)
        for dot in at.tolist():
            cv2.circle(image, dot, 3, _WAY, -1, cv2.LINE_AA)
    ends = _pixels(grid, np.concatenate(stretches)[[0, -1]], px)
    cv2.circle(image, ends[0].tolist(), 6, _WAY, -1, cv2.LINE_AA)
    cv2.rectangle(image, (ends[1] - 5).tolist(), (ends[1] + 5).tolist(), _WAY, -1)


def _draw_axes(image: ByteArray, grid: OccupancyGrid, px: int) -> None:
    """Crosses at whole steps of x and y, and what these are along the left and lower edge."""
    a_metre, (height, width) = px / grid.resolution_m, image.shape[:2]
    step_m = next((step for step in _SCALES_M if step * a_metre >= _LEAST_STEP_PX), _SCALES_M[-1])
    x_m, y_m = (
        step_m * np.arange(ceil(low / step_m), floor((low + size / a_metre) / step_m) + 1)
        for low, size in zip(grid.origin, (width, height), strict=True)
    )
    for at in _pixels(grid, [(x, y) for x in x_m for y in y_m], px).tolist():
        cv2.drawMarker(image, at, _CROSS, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)
    for x in x_m.tolist():
        left = int(_pixels(grid, (x, 0.0), px)[0, 0])
        cv2.line(image, (left, height - 6), (left, height), _INK, 1)
        _write_beside(image, f"{x:g}", max(left - 4, 0), height - 10)
    for y in y_m.tolist():
        bottom = int(_pixels(grid, (0.0, y), px)[0, 1])
        cv2.line(image, (0, bottom), (6, bottom), _INK, 1)
        _write_beside(image, f"{y:g}", 10, bottom + 5)


def _pixels(grid: OccupancyGrid, xy: ArrayLike, px: int) -> Any:
    """(N, 2) int32 of places (N, 2) in `map`."""
    cells = (np.asarray(xy, float).reshape(-1, 2) - grid.origin) / grid.resolution_m
    return np.rint(px * np.stack([cells[:, 0], len(grid.kind) - cells[:, 1]], axis=-1)).astype(np.int32)


def _draw_line(image: ByteArray, grid: OccupancyGrid, line: PlanLine, px: int) -> None:
    at = _pixels(grid, line.points, px)
    if len(at):
        cv2.polylines(image, [at], False, line.colour, line.width_px, cv2.LINE_AA)
        if line.text:
            x, y = np.rint(np.unique(at, axis=0).mean(axis=0)).astype(int).tolist()
            _write_beside(image, line.text, x - 4 * len(line.text), y)


def _draw_mark(image: ByteArray, grid: OccupancyGrid, mark: PlanMark, px: int) -> None:
    x, y = _pixels(grid, mark.xy, px)[0].tolist()
    _sign(image, mark, x, y)
    if mark.text:
        _write_beside(image, mark.text, x + 11, y + 5)


def _sign(image: ByteArray, mark: PlanMark, x: int, y: int) -> None:
    """Upon a rim of paper, so that it is seen on lines of its own colour."""
    if mark.sign == "circle":
        cv2.circle(image, (x, y), 8, _PAPER, -1, cv2.LINE_AA)
        cv2.circle(image, (x, y), 6, mark.colour, -1, cv2.LINE_AA)
    elif mark.sign == "square":
        cv2.rectangle(image, (x - 7, y - 7), (x + 7, y + 7), _PAPER, -1)
        cv2.rectangle(image, (x - 5, y - 5), (x + 5, y + 5), mark.colour, -1)
    else:
        for colour, width in ((_PAPER, 6), (mark.colour, 3)):
            cv2.drawMarker(image, (x, y), colour, cv2.MARKER_TILTED_CROSS, 13, width, cv2.LINE_AA)


def _write_beside(image: ByteArray, text: str, left: int, bottom: int) -> None:
    for colour, width in ((_PAPER, 4), (_INK, 1)):
        cv2.putText(image, _plain(text), (left, bottom), cv2.FONT_HERSHEY_SIMPLEX, 0.43, colour, width, cv2.LINE_AA)


def _plain(text: str) -> str:
    """OpenCV's letters are ASCII."""
    return text.replace("°", " deg").encode("ascii", "replace").decode()


def _named(drawn: Iterable[PlanLine | PlanMark], width: int) -> ByteArray:
    """(h, width, 3): names of lines and marks, each once; in more rows where they need them."""
    strips, left = [np.full((_STRIP_PX, width, 3), 255, np.uint8)], _GAP_PX
    for one in {one.name: one for one in drawn}.values():
        span = 34 + 8 * len(one.name) + _GAP_PX
        if left > _GAP_PX and left + span > width:
            strips.append(np.full((_STRIP_PX, width, 3), 255, np.uint8))
            left = _GAP_PX
        if isinstance(one, PlanLine):
            cv2.line(strips[-1], (left, 17), (left + 22, 17), one.colour, one.width_px + 1)
        else:
            _sign(strips[-1], one, left + 11, 17)
        _write(strips[-1], one.name, left + 28)
        left += span
    return np.concatenate(strips)


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
        cv2.rectangle(strip, (left, 9), (left + 16, 25), COLOURS[kind], -1)
        cv2.rectangle(strip, (left, 9), (left + 16, 25), _INK, 1)
        _write(strip, name, left + 22)
    right = width - _GAP_PX
    text = f"{scale_m:g} m"
    cv2.line(strip, (right - length, 17), (right, 17), _INK, 3)
    _write(strip, text, right - length - 9 * len(text) - 4)
    return strip


def _write(strip: ByteArray, text: str, left: int) -> None:
    cv2.putText(strip, _plain(text), (left, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.43, _INK, 1, cv2.LINE_AA)
