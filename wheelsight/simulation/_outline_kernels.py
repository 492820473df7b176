"""Compiled search for the outlines in a view, and the further rays through the pixels there."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel

# Faces of a box meet at 90 degrees; a curved face turns by less from a pixel to the next, unless it is tiny.
_SAME_FACE = 0.9
# x and y from a pixel's middle, in pixels. With the ray through the middle there is one in each fifth of the width and
# of the height: upright and level edges, of which rooms are full, are told as finely as by a grid of 25.
OFFSETS = np.array([[-0.4, 0.2], [-0.2, -0.4], [0.2, 0.4], [0.4, -0.2]])


@kernel
def is_same_face(one: int, n: Any, other: int, m: Any) -> Any:
    """Whether two rays met one face of one geom, or both nothing.

    Given are the geoms' indices, -1 for none, and the normals as three numbers: handing arrays over would take most of
    the time.
    """
    return one == other and (one < 0 or n[0] * m[0] + n[1] * m[1] + n[2] * m[2] > _SAME_FACE)


@kernel
def three(vectors: Any, v: int, u: int) -> Any:
    """A pixel's normal or ray as three numbers."""
    return float(vectors[v, u, 0]), float(vectors[v, u, 1]), float(vectors[v, u, 2])


@kernel
def find(geom: Any, normal_world: Any, tile: Any) -> Any:
    """Rows and columns (N, 2) of a tile's pixels with another face above, below, on the left or the right.

    `geom` (H, W) and `normal_world` (H, W, 3) are of the whole view; `tile` is its rows from `tile`[0] to `tile`[1] and
    columns from `tile`[2] to `tile`[3], the last left out. A straight edge through a pixel parts it from at least one
    of those four, if nothing else is near.
    """
    height, width = geom.shape
    found = np.empty(((tile[1] - tile[0]) * (tile[3] - tile[2]), 2), np.int32)
    count = 0
    for v in range(tile[0], tile[1]):
        for u in range(tile[2], tile[3]):
            g, n = geom[v, u], three(normal_world, v, u)
            for a, b in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
                inside = 0 <= a < height and 0 <= b < width
                if inside and not is_same_face(g, n, geom[a, b], three(normal_world, a, b)):
                    found[count, 0], found[count, 1] = v, u
                    count += 1
                    break
    return found[:count]


@kernel
def spread(rays: Any, pixels: Any) -> Any:
    """Rays (N, S, 3) through parts of pixels, rows and columns (N, 2), from the `rays` (H, W, 3) through their middles.

    Between neighbouring pixels a lens bends rays evenly.
    """
    height, width = rays.shape[:2]
    out = np.empty((len(pixels), len(OFFSETS), 3))
    for i in range(len(pixels)):
        v, u = pixels[i]
        left, right = max(u - 1, 0), min(u + 1, width - 1)
        above, below = max(v - 1, 0), min(v + 1, height - 1)
        for s in range(len(OFFSETS)):
            x, y = OFFSETS[s, 0] / max(right - left, 1), OFFSETS[s, 1] / max(below - above, 1)
            for k in range(3):
                across, down = rays[v, right, k] - rays[v, left, k], rays[below, u, k] - rays[above, u, k]
                out[i, s, k] = rays[v, u, k] + x * across + y * down
    return out
