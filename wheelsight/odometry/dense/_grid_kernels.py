"""Compiled inner loops that bring frames onto the grid of an ideal camera, and halve it level by level.

All images are float32. Depth 0 and grey -1 say that nothing is known there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

NO_GREY = np.float32(-1.0)


@njit(cache=True, nogil=True)
def halve_depth(depth_m: Any, jump: float, begin: int, end: int, half: Any) -> None:
    """Rows `begin` to `end` of `half` (h, w): the mean of each 2×2 block's depths that lie on its nearest surface.

    A reading is on the surface if it lies less than `jump` times the nearest depth behind it.
    """
    for r in range(begin, end):
        for c in range(half.shape[1]):
            nearest = np.float32(np.inf)
            for i in range(2):
                for j in range(2):
                    z = depth_m[2 * r + i, 2 * c + j]
                    if 0 < z < nearest:
                        nearest = z
            total, count = np.float32(0.0), 0
            limit = nearest * np.float32(1 + jump)
            for i in range(2):
                for j in range(2):
                    z = depth_m[2 * r + i, 2 * c + j]
                    if 0 < z <= limit:
                        total += z
                        count += 1
            half[r, c] = total / np.float32(count) if count else np.float32(0.0)


@njit(cache=True, nogil=True)
def halve_grey(grey: Any, begin: int, end: int, half: Any) -> None:
    """Rows `begin` to `end` of `half` (h, w): the mean of each 2×2 block, unknown where one of the four is."""
    for r in range(begin, end):
        for c in range(half.shape[1]):
            a, b = grey[2 * r, 2 * c], grey[2 * r, 2 * c + 1]
            d, e = grey[2 * r + 1, 2 * c], grey[2 * r + 1, 2 * c + 1]
            known = a >= 0 and b >= 0 and d >= 0 and e >= 0
            half[r, c] = np.float32(0.25) * (a + b + d + e) if known else NO_GREY


@njit(cache=True, nogil=True)
def straighten_depth(
    depth_m: Any, source_px: Any, grid: Any, twist: Any, late_s: Any, jump: float, begin: int, end: int, out: Any
) -> None:
    """Rows `begin` to `end` of depth (h, w) on the ideal grid, as if all rows were read at the middle row's time.

    Args:
        depth_m: (h, w) as measured, of a lens with distortion and a rolling shutter.
        source_px: (h, w, 2) where a pixel of the ideal grid lies in it, shutter left aside.
        grid: fx, fy, cx, cy of the ideal grid.
        twist: (6,) velocity (v, ω) of the camera in its own frame a second.
        late_s: (h,) how long after the middle row each row was read.
        jump: share of a depth by which neighbours on one surface may differ.
        out: (h, w) depth, 0 where none is known.
    """
    for r in range(begin, end):
        for c in range(out.shape[1]):
            x, y = (c - grid[2]) / grid[0], (r - grid[3]) / grid[1]
            u, v = source_px[r, c, 0], source_px[r, c, 1]
            z = _depth_between(depth_m, u, v, jump)
            late = _late(late_s, v)
            if late != 0.0:
                z_near = z if z > 0 else np.float32(2.0)
                for _ in range(2):
                    du, dv = _flow(x, y, z_near, twist)
                    late = _late(late_s, v - late * grid[1] * dv)
                    z_there = _depth_between(depth_m, u - late * grid[0] * du, v - late * grid[1] * dv, jump)
                    z_near = z_there if z_there > 0 else z_near
                z = z_there
                z += np.float32(late * (twist[2] + (twist[3] * y - twist[4] * x) * z)) if z > 0 else np.float32(0.0)
            out[r, c] = z


@njit(cache=True, nogil=True)
def sample_grey(
    image: Any, depth_m: Any, grid: Any, T_color_camera: Any, color: Any, twist: Any, late: Any, rows: Any, out: Any
) -> None:
    """Grey values (h, w) that a colour camera saw at the points of a depth image on the ideal grid.

    Args:
        image: (H, W) grey as measured.
        depth_m: (h, w) on the ideal grid, straightened.
        grid: fx, fy, cx, cy of the ideal grid.
        T_color_camera: (4, 4).
        color: fx, fy, cx, cy, k1, k2, p1, p2, k3 of the colour camera at the image's size.
        twist: (6,) velocity (v, ω) of the camera in its own frame a second.
        late: time in seconds from the middle row to the last one of a rolling shutter, the image's height, and the
            depth to assume where none is known; 0 leaves grey unknown there.
        rows: first and last row to do.
        out: (h, w); -1 where the point is unknown or out of sight.
    """
    for r in range(rows[0], rows[1]):
        for c in range(out.shape[1]):
            z = depth_m[r, c] if depth_m[r, c] > 0 else late[2]
            out[r, c] = NO_GREY
            if z <= 0:
                continue
            x, y = (c - grid[2]) / grid[0] * z, (r - grid[3]) / grid[1] * z
            u, v = _seen_at(x, y, z, T_color_camera, color)
            if late[0] != 0.0:
                s = (v / late[1] - 0.5) * 2 * late[0]
                x -= s * (twist[0] + twist[4] * z - twist[5] * y)
                y -= s * (twist[1] + twist[5] * x - twist[3] * z)
                z -= s * (twist[2] + twist[3] * y - twist[4] * x)
                u, v = _seen_at(x, y, z, T_color_camera, color)
            out[r, c] = _between(image, u, v)


@njit(cache=True, nogil=True)
def gradients(grey: Any, begin: int, end: int, along_u: Any, along_v: Any) -> None:
    """Central differences of grey a pixel, rows `begin` to `end`; 0 beside what is unknown."""
    height, width = grey.shape
    for r in range(begin, end):
        for c in range(width):
            along_u[r, c] = along_v[r, c] = np.float32(0.0)
            if 0 < c < width - 1 and grey[r, c - 1] >= 0 and grey[r, c + 1] >= 0:
                along_u[r, c] = np.float32(0.5) * (grey[r, c + 1] - grey[r, c - 1])
            if 0 < r < height - 1 and grey[r - 1, c] >= 0 and grey[r + 1, c] >= 0:
                along_v[r, c] = np.float32(0.5) * (grey[r + 1, c] - grey[r - 1, c])


@njit(cache=True, nogil=True)
def normals(depth_m: Any, grid: Any, radius: int, jump: float, begin: int, end: int, out: Any) -> None:
    """Unit normals (h, w, 3) towards the camera by least squares of inverse depth over a window; 0 where none.

    On a plane inverse depth is linear in the pixel, 1/z = a·u + b·v + c, so the normal follows from its slopes
    (Badino et al., ICRA 2011, fit the same model). The window is (2·radius + 1)², on one surface only.
    """
    height, width = depth_m.shape
    for r in range(begin, end):
        for c in range(width):
            out[r, c, 0] = out[r, c, 1] = out[r, c, 2] = np.float32(0.0)
            z = depth_m[r, c]
            if z <= 0 or r < radius or c < radius or r >= height - radius or c >= width - radius:
                continue
            suu = svv = suv = su = sv = s = sud = svd = sd = np.float32(0.0)
            limit = np.float32(jump) * z
            for i in range(-radius, radius + 1):
                for j in range(-radius, radius + 1):
                    near = depth_m[r + i, c + j]
                    if near > 0 and abs(near - z) < limit:
                        d = np.float32(1.0) / near - np.float32(1.0) / z
                        suu += j * j
                        svv += i * i
                        suv += i * j
                        su += j
                        sv += i
                        s += np.float32(1.0)
                        sud += j * d
                        svd += i * d
                        sd += d
            if s < 6:
                continue
            suu, svv, suv = suu - su * su / s, svv - sv * sv / s, suv - su * sv / s
            sud, svd = sud - su * sd / s, svd - sv * sd / s
            det = suu * svv - suv * suv
            if det < np.float32(1.0):
                continue
            a, b = (svv * sud - suv * svd) / det, (suu * svd - suv * sud) / det
            x, y = (c - grid[2]) / grid[0], (r - grid[3]) / grid[1]
            nx, ny = grid[0] * a, grid[1] * b
            nz = (np.float32(1.0) / z) - nx * x - ny * y
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            out[r, c, 0], out[r, c, 1], out[r, c, 2] = -nx / length, -ny / length, -nz / length


@njit(cache=True, nogil=True, inline="always")
def _flow(x: Any, y: Any, z: Any, twist: Any) -> Any:
    """How fast a point at (x, y, 1)·z moves over the image as the camera moves on, negated: (2,) a second, at f = 1.

    Of a camera with velocity (v, ω), a fixed point moves by -(v + ω × p); this is the image of +(v + ω × p).
    """
    dx = twist[0] / z + twist[4] - twist[5] * y
    dy = twist[1] / z + twist[5] * x - twist[3]
    dz = twist[2] / z + twist[3] * y - twist[4] * x
    return dx - x * dz, dy - y * dz


@njit(cache=True, nogil=True, inline="always")
def _late(late_s: Any, row: Any) -> Any:
    return late_s[min(max(int(row + 0.5), 0), len(late_s) - 1)]


@njit(cache=True, nogil=True, inline="always")
def _depth_between(depth_m: Any, u: Any, v: Any, jump: float) -> Any:
    """Depth between four pixels where they are one surface, else that of the nearest pixel; 0 outside."""
    height, width = depth_m.shape
    column, row = int(u + 0.5), int(v + 0.5)
    if not (0 <= column < width and 0 <= row < height) or u < -0.5 or v < -0.5:
        return np.float32(0.0)
    nearest = depth_m[row, column]
    c, r = int(np.floor(u)), int(np.floor(v))
    if nearest <= 0 or c < 0 or r < 0 or c >= width - 1 or r >= height - 1:
        return nearest
    a, b, d, e = depth_m[r, c], depth_m[r, c + 1], depth_m[r + 1, c], depth_m[r + 1, c + 1]
    limit = np.float32(jump) * nearest
    if min(a, b, d, e) <= 0 or max(a, b, d, e) - min(a, b, d, e) > limit:
        return nearest
    s, t = np.float32(u - c), np.float32(v - r)
    one = np.float32(1.0)
    return (one - t) * ((one - s) * a + s * b) + t * ((one - s) * d + s * e)


@njit(cache=True, nogil=True, inline="always")
def _seen_at(x: Any, y: Any, z: Any, T: Any, color: Any) -> Any:
    """The colour camera's pixel (2,) of a point of the depth camera; far outside where it is behind."""
    a = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    b = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    d = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    if d <= 0.05:
        return -1e6, -1e6
    a, b = a / d, b / d
    q = a * a + b * b
    radial = 1 + q * (color[4] + q * (color[5] + q * color[8]))
    a, b = (
        a * radial + 2 * color[6] * a * b + color[7] * (q + 2 * a * a),
        b * radial + color[6] * (q + 2 * b * b) + 2 * color[7] * a * b,
    )
    return color[0] * a + color[2], color[1] * b + color[3]


@njit(cache=True, nogil=True, inline="always")
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
