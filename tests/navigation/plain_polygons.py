"""Footprints against cells in plain Python, by clipping: what kernels and plans are held against."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

Points = list[tuple[float, float]]


def clipped(polygon: Points, axis: int, limit: float, sign: float) -> Points:
    """The part of a convex polygon where sign · coordinate ≤ sign · limit (Sutherland and Hodgman)."""
    kept: Points = []
    for before, after in zip(polygon[-1:] + polygon[:-1], polygon, strict=True):
        a, b = sign * (before[axis] - limit), sign * (after[axis] - limit)
        if (a < 0) != (b < 0):
            share = a / (a - b)
            kept.append((before[0] + share * (after[0] - before[0]), before[1] + share * (after[1] - before[1])))
        if b <= 0:
            kept.append(after)
    return kept


def area(polygon: Points) -> float:
    pairs = zip(polygon, polygon[1:] + polygon[:1], strict=True)
    return abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in pairs)) / 2


def shared_m2(polygon: Points, x: float, y: float, side: float) -> float:
    """What a polygon and a square share."""
    for axis, limit, sign in ((0, x, -1.0), (0, x + side, 1.0), (1, y, -1.0), (1, y + side, 1.0)):
        polygon = clipped(polygon, axis, limit, sign)
        if not polygon:
            return 0.0
    return area(polygon)


def placed(corners: np.ndarray, pose: Sequence[float]) -> Points:
    x, y, yaw = (float(part) for part in pose)
    c, s = math.cos(yaw), math.sin(yaw)
    return [(x + c * a - s * b, y + s * a + c * b) for a, b in corners.tolist()]


def cells_under(
    is_lethal: np.ndarray,
    resolution_m: float,
    origin: tuple[float, float],
    corners: np.ndarray,
    pose: Sequence[float],
    least_m2: float = 1e-8,
) -> int:
    """How many lethal cells share more than so much with an outline at a pose."""
    polygon = placed(corners, pose)
    xs, ys = zip(*polygon, strict=True)
    first = [int((min(values) - low) // resolution_m) for values, low in ((ys, origin[1]), (xs, origin[0]))]
    last = [int((max(values) - low) // resolution_m) for values, low in ((ys, origin[1]), (xs, origin[0]))]
    found = 0
    for row in range(max(first[0], 0), min(last[0] + 1, is_lethal.shape[0])):
        for column in range(max(first[1], 0), min(last[1] + 1, is_lethal.shape[1])):
            if is_lethal[row, column]:
                x, y = origin[0] + column * resolution_m, origin[1] + row * resolution_m
                found += shared_m2(polygon, x, y, resolution_m) > least_m2
    return found
