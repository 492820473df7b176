"""Compiled inner loops that bring frames onto the grid of an ideal camera, and halve it level by level.

All images are float32. Depth 0 and grey -1 say that nothing is known there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

NO_GREY = np.float32(-1.0)
# How far away something is taken to be where depth is unknown.
_TYPICAL_DEPTH_M = np.float32(2.0)
_NEAREST_M = np.float32(0.05)


@njit(cache=True, nogil=True, error_model="numpy")
def halve_depth(depth_m: Any, jump: float, begin: int, end: int, half: Any) -> None:
    """Rows `begin` to `end` of `half` (h, w): the mean of each 2×2 block's depths that lie on its nearest surface.

    A reading is on the surface if it lies less than `jump` times the nearest depth behind it.
    """
    factor, far, none, one = np.float32(1 + jump), np.float32(1e30), np.float32(0), np.float32(1)
    for r in range(begin, end):
        upper, lower, out = depth_m[2 * r], depth_m[2 * r + 1], half[r]
        for c in range(half.shape[1]):
            a, b, d, e = upper[2 * c], upper[2 * c + 1], lower[2 * c], lower[2 * c + 1]
            a, b = a if a > none else far, b if b > none else far
            d, e = d if d > none else far, e if e > none else far
            nearest = min(min(a, b), min(d, e))
            limit = nearest * factor
            total = (a if a <= limit else none) + (b if b <= limit else none)
            total += (d if d <= limit else none) + (e if e <= limit else none)
            count = (one if a <= limit else none) + (one if b <= limit else none)
            count += (one if d <= limit else none) + (one if e <= limit else none)
            out[c] = total / count if nearest < far else none


@njit(cache=True, nogil=True, error_model="numpy")
def halve_grey(grey: Any, begin: int, end: int, half: Any) -> None:
    """Rows `begin` to `end` of `half` (h, w): the mean of each 2×2 block, unknown where one of the four is."""
    quarter, none = np.float32(0.25), np.float32(0)
    for r in range(begin, end):
        upper, lower, out = grey[2 * r], grey[2 * r + 1], half[r]
        for c in range(half.shape[1]):
            a, b, d, e = upper[2 * c], upper[2 * c + 1], lower[2 * c], lower[2 * c + 1]
            out[c] = quarter * (a + b + d + e) if min(min(a, b), min(d, e)) >= none else NO_GREY


@njit(cache=True, nogil=True, error_model="numpy")
def straighten(
    depth_m: Any, grey: Any, source_px: Any, grid: Any, twist: Any, shutter_s: Any, jump: Any, rows: Any, out: Any
) -> None:
    """Rows of depth and grey (h, w) on the ideal grid, as if all rows were read at the middle row's time.

    A row's delay grows linearly with its number, and the row a point is seen in moves linearly with the delay; both
    together give that row in closed form.

    Args:
        depth_m, grey: (h, w) as measured, of a lens with distortion and a rolling shutter.
        source_px: (h, w, 2) where a pixel of the ideal grid lies in it, shutter left aside.
        grid: fx, fy, cx, cy of the ideal grid.
        twist: (6,) velocity (v, ω) of the camera in its own frame a second.
        shutter_s: time from the first row to the last; 0 for none.
        jump: share of a depth by which neighbours on one surface may differ.
        rows: first and last row to do.
        out: (2, h, w) depth, 0 where none is known, and grey; grey (0, 0) is left alone.
    """
    height, width = depth_m.shape
    one, pace, middle = np.float32(1), shutter_s / np.float32(height), np.float32(0.5 * height - 0.5)
    has_grey = grey.shape[0] == height
    for r in range(rows[0], rows[1]):
        y = np.float32((r - grid[3]) / grid[1])
        for c in range(width):
            u, v, x = source_px[r, c, 0], source_px[r, c, 1], np.float32((c - grid[2]) / grid[0])
            late = np.float32(0)
            if pace != 0:
                du, dv = _flow(x, y, _depth_near(depth_m, u, v), twist)
                row = (v + pace * middle * grid[1] * dv) / (one + pace * grid[1] * dv)
                late = pace * (row - middle)
                u, v = u - late * grid[0] * du, row
            z = _depth_between(depth_m, u, v, jump)
            out[0, r, c] = z + late * (twist[2] + (twist[3] * y - twist[4] * x) * z) if z > 0 else z
            if has_grey:
                out[1, r, c] = _between(grey, u, v)


@njit(cache=True, nogil=True, error_model="numpy")
def sample_grey(
    image: Any,
    depth_m: Any,
    grid: Any,
    T_color_camera: Any,
    color: Any,
    twist: Any,
    shutter_s: Any,
    rows: Any,
    out: Any,
) -> None:
    """Grey values (h, w) that another camera, of colour, saw at the points of a depth image on the ideal grid.

    Args:
        image: (H, W) grey as measured.
        depth_m: (h, w) on the ideal grid, straightened.
        grid: fx, fy, cx, cy of the ideal grid.
        T_color_camera: (3, 4) or more rows.
        color: fx, fy, cx, cy, k1, k2, p1, p2, k3 of the colour camera at the image's size.
        twist: (6,) velocity (v, ω) of the depth camera in its own frame a second.
        shutter_s: time from the image's first row to the last; 0 for none.
        rows: first and last row to do.
        out: (h, w); -1 where the point is unknown or out of sight.
    """
    pace, middle = shutter_s / np.float32(image.shape[0]), np.float32(0.5 * image.shape[0] - 0.5)
    for r in range(rows[0], rows[1]):
        ray_y = np.float32((r - grid[3]) / grid[1])
        for c in range(out.shape[1]):
            z = depth_m[r, c]
            out[r, c] = NO_GREY
            if z <= 0:
                continue
            x, y = np.float32((c - grid[2]) / grid[0]) * z, ray_y * z
            if pace != 0:
                late = pace * (_row_seen(x, y, z, T_color_camera, color) - middle)
                x -= late * (twist[0] + twist[4] * z - twist[5] * y)
                y -= late * (twist[1] + twist[5] * x - twist[3] * z)
                z -= late * (twist[2] + twist[3] * y - twist[4] * x)
            u, v = _seen_at(x, y, z, T_color_camera, color)
            out[r, c] = _between(image, u, v)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _flow(x: Any, y: Any, z: Any, twist: Any) -> Any:
    """How fast a point at (x, y, 1)·z moves over the image as the camera moves on, negated: (2,) a second, at f = 1.

    Of a camera with velocity (v, ω), a fixed point moves by -(v + ω × p); this is the image of +(v + ω × p).
    """
    near = np.float32(1) / z
    dx = twist[0] * near + twist[4] - twist[5] * y
    dy = twist[1] * near + twist[5] * x - twist[3]
    dz = twist[2] * near + twist[3] * y - twist[4] * x
    return dx - x * dz, dy - y * dz


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _depth_near(depth_m: Any, u: Any, v: Any) -> Any:
    """Depth of the nearest pixel, or a typical one where that is unknown."""
    half = np.float32(0.5)
    column = min(max(int(u + half), 0), depth_m.shape[1] - 1)
    z = depth_m[min(max(int(v + half), 0), depth_m.shape[0] - 1), column]
    return z if z > 0 else _TYPICAL_DEPTH_M


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _depth_between(depth_m: Any, u: Any, v: Any, jump: float) -> Any:
    """Depth between four pixels where they are one surface, else that of the nearest pixel; 0 outside."""
    height, width = depth_m.shape
    half = np.float32(0.5)
    column, row = int(u + half), int(v + half)
    if not (-half < u and -half < v and column < width and row < height):
        return np.float32(0.0)
    nearest = depth_m[row, column]
    if nearest <= 0 or u < 0 or v < 0 or u >= width - 1 or v >= height - 1:
        return nearest
    c, r = int(u), int(v)
    a, b, d, e = depth_m[r, c], depth_m[r, c + 1], depth_m[r + 1, c], depth_m[r + 1, c + 1]
    limit = jump * nearest
    if min(a, b, d, e) <= 0 or max(a, b, d, e) - min(a, b, d, e) > limit:
        return nearest
    s, t = np.float32(u - c), np.float32(v - r)
    one = np.float32(1.0)
    return (one - t) * ((one - s) * a + s * b) + t * ((one - s) * d + s * e)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _row_seen(x: Any, y: Any, z: Any, T: Any, color: Any) -> Any:
    """The colour camera's row of a point, lens left aside: near enough to know when it was read."""
    b = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    d = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    return color[1] * b / max(d, _NEAREST_M) + color[3]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _seen_at(x: Any, y: Any, z: Any, T: Any, color: Any) -> Any:
    """The colour camera's pixel (2,) of a point of the depth camera; far outside where it is behind."""
    a = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    b = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    d = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    if d <= _NEAREST_M:
        return np.float32(-1), np.float32(-1)
    a, b, two = a / d, b / d, np.float32(2)
    if color[4] == 0 and color[5] == 0 and color[6] == 0 and color[7] == 0 and color[8] == 0:
        return color[0] * a + color[2], color[1] * b + color[3]
    q = a * a + b * b
    radial = np.float32(1) + q * (color[4] + q * (color[5] + q * color[8]))
    a, b = (
        a * radial + two * color[6] * a * b + color[7] * (q + two * a * a),
        b * radial + color[6] * (q + two * b * b) + two * color[7] * a * b,
    )
    return color[0] * a + color[2], color[1] * b + color[3]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _between(image: Any, u: Any, v: Any) -> Any:
    """Bilinear value between pixels; -1 outside the image or where a neighbour is unknown."""
    height, width = image.shape
    if not (0 <= u < width - 1 and 0 <= v < height - 1):
        return NO_GREY
    c, r = int(u), int(v)
    a, b, d, e = image[r, c], image[r, c + 1], image[r + 1, c], image[r + 1, c + 1]
    if a < 0 or b < 0 or d < 0 or e < 0:
        return NO_GREY
    s, t = np.float32(u - c), np.float32(v - r)
    one = np.float32(1.0)
    return (one - t) * ((one - s) * a + s * b) + t * ((one - s) * d + s * e)
