"""Compiled inner loops over images: resampling, halving, normals and gradients of references, depth at keypoints,
RANSAC, refinement and Hamming distances.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import Float32Array, FloatArray, IntArray, UInt64Array
from wheelsight.core.geometry.hamming_kernels import hamming

# Channels of a reference's pixel: the plane n·q = d and its depth, NaN where unknown; grey and its gradient a pixel.
NX, NY, NZ, OFFSET, DEPTH, GREY, ALONG_U, ALONG_V = range(8)
CHANNELS = 8

# Images are float32, but for colours as measured. Depth 0, grey -1 and colour -1 say that nothing is known there.
#
# Where a row's pixels were seen is worked out for the whole row at once, then the images are read there: loops of
# plain arithmetic are done eight pixels at a time. Cameras, poses and twists come as tuples, and helpers that read
# images do so without branches, for numba counts references to an array that an inlined helper takes, pixel by pixel,
# unless it sees that nothing happens in between.

NO_GREY = np.float32(-1.0)
# How far away something is taken to be where depth is unknown.
_TYPICAL_DEPTH_M = np.float32(2.0)
_NEAREST_M = np.float32(0.05)


class Exposure(NamedTuple):
    """How rows of an image were read while the camera moved. All numbers are float32, as kernels read them fastest.

    Attributes:
        grid: (4,) fx, fy, cx, cy of the ideal grid.
        twist: (6,) velocity (v, ω) of the depth camera in its own frame a second.
        shutter_s: time from the first row to the last; 0 for none.
        depth_late_s: how much later than colour depth was measured.
    """

    grid: tuple[np.float32, ...]
    twist: tuple[np.float32, ...]
    shutter_s: np.float32
    depth_late_s: np.float32 = np.float32(0)


@kernel(error_model="numpy")
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


@kernel(error_model="numpy")
def halve_grey(grey: Any, begin: int, end: int, half: Any) -> None:
    """Rows `begin` to `end` of `half` (h, w): the mean of each 2×2 block, unknown where one of the four is."""
    quarter, none = np.float32(0.25), np.float32(0)
    for r in range(begin, end):
        upper, lower, out = grey[2 * r], grey[2 * r + 1], half[r]
        for c in range(half.shape[1]):
            a, b, d, e = upper[2 * c], upper[2 * c + 1], lower[2 * c], lower[2 * c + 1]
            out[c] = quarter * (a + b + d + e) if min(min(a, b), min(d, e)) >= none else NO_GREY


@kernel(error_model="numpy")
def straighten(depth_m: Any, grey: Any, source_px: Any, exposure: Exposure, jump: Any, rows: Any, out: Any) -> None:
    """Rows of depth and grey (h, w) on the ideal grid, as if all rows were read at the time of colour's middle row.

    Args:
        depth_m, grey: (h, w) as measured, of a lens with distortion and a rolling shutter.
        source_px: (h, w, 2) where a pixel of the ideal grid lies in it, shutter left aside.
        exposure: of the rows.
        jump: share of a depth by which neighbours on one surface may differ.
        rows: first and last row to do.
        out: (2, h, w) depth, 0 where none is known, and grey; grey (0, 0) is left alone.
    """
    grid, twist, behind = exposure.grid, exposure.twist, exposure.depth_late_s
    height, width = depth_m.shape
    has_grey = grey.shape[0] == height
    u, v, late = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    for r in range(rows[0], rows[1]):
        y = (np.float32(r) - grid[3]) / grid[1]
        _find_source(y, source_px[r], depth_m, exposure, height, u, v, late)
        if has_grey:
            for c in range(width):
                out[1, r, c] = _between(grey, u[c], v[c])
        if behind != 0:
            for c in range(width):
                du, dv = _flow((np.float32(c) - grid[2]) / grid[0], y, _depth_near(depth_m, u[c], v[c]), twist)
                u[c], v[c], late[c] = u[c] - behind * grid[0] * du, v[c] - behind * grid[1] * dv, late[c] + behind
        for c in range(width):
            z, x = _depth_between(depth_m, u[c], v[c], jump), (np.float32(c) - grid[2]) / grid[0]
            out[0, r, c] = z + late[c] * (twist[2] + (twist[3] * y - twist[4] * x) * z) if z > 0 else z


@kernel(error_model="numpy")
def straighten_color(image: Any, depth_m: Any, source_px: Any, exposure: Exposure, rows: Any, out: Any) -> None:
    """Rows of colour (h, w, 3) on the ideal grid, as `straighten` brings grey there.

    Args: as of `straighten`, and
        image: (h, w, 3) uint8 as measured.
        depth_m: (h, w) as measured; never looked at without a shutter.
        out: (h, w, 3); -1 where unknown.
    """
    grid = exposure.grid
    height, width = image.shape[0], image.shape[1]
    u, v, late = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    for r in range(rows[0], rows[1]):
        y = (np.float32(r) - grid[3]) / grid[1]
        _find_source(y, source_px[r], depth_m, exposure, height, u, v, late)
        for c in range(width):
            out[r, c, 0], out[r, c, 1], out[r, c, 2] = _color_between(image, u[c], v[c])


@kernel(error_model="numpy")
def sample_grey(
    image: Any, depth_m: Any, exposure: Exposure, T_color_camera: Any, color: Any, rows: Any, out: Any
) -> None:
    """Grey values (h, w) that another camera, of colour, saw at the points of a depth image on the ideal grid.

    Args:
        image: (H, W) grey as measured.
        depth_m: (h, w) on the ideal grid, straightened.
        exposure: of the image's rows.
        T_color_camera: (12,) the upper three rows.
        color: fx, fy, cx, cy, k1, k2, p1, p2, k3 of the colour camera at the image's size.
        rows: first and last row to do.
        out: (h, w); -1 where the point is unknown or out of sight.
    """
    grid, width = exposure.grid, depth_m.shape[1]
    u, v = np.empty(width, np.float32), np.empty(width, np.float32)
    for r in range(rows[0], rows[1]):
        y = (np.float32(r) - grid[3]) / grid[1]
        _look_up(y, depth_m[r], exposure, T_color_camera, color, image.shape[0], u, v)
        for c in range(width):
            out[r, c] = _between(image, u[c], v[c])


@kernel(error_model="numpy")
def sample_color(
    image: Any, depth_m: Any, exposure: Exposure, T_color_camera: Any, color: Any, rows: Any, out: Any
) -> None:
    """Colours (h, w, 3) that another camera saw at the points of a depth image, as `sample_grey` finds grey values.

    Args: as of `sample_grey`, but `image` (H, W, 3) uint8 and `out` (h, w, 3).
    """
    grid, width = exposure.grid, depth_m.shape[1]
    u, v = np.empty(width, np.float32), np.empty(width, np.float32)
    for r in range(rows[0], rows[1]):
        y = (np.float32(r) - grid[3]) / grid[1]
        _look_up(y, depth_m[r], exposure, T_color_camera, color, image.shape[0], u, v)
        for c in range(width):
            out[r, c, 0], out[r, c, 1], out[r, c, 2] = _color_between(image, u[c], v[c])


@kernel(error_model="numpy")
def _find_source(y: Any, source_px: Any, depth_m: Any, exposure: Any, height: Any, u: Any, v: Any, late: Any) -> None:
    """Where (w,) u and v the ideal grid's pixels of the row at y were seen, and how late after the middle row.

    A row's delay grows linearly with its number, and the row a point is seen in moves linearly with the delay; both
    together give that row in closed form.
    """
    grid, twist, shutter_s = exposure.grid, exposure.twist, exposure.shutter_s
    one, pace, middle = np.float32(1), shutter_s / np.float32(height), np.float32(0.5 * height - 0.5)
    for c in range(len(u)):
        u[c], v[c], late[c] = source_px[c, 0], source_px[c, 1], np.float32(0)
    if shutter_s == 0:
        return
    for c in range(len(u)):
        late[c] = _depth_near(depth_m, u[c], v[c])
    for c in range(len(u)):
        du, dv = _flow((np.float32(c) - grid[2]) / grid[0], y, late[c], twist)
        row = (v[c] + pace * middle * grid[1] * dv) / (one + pace * grid[1] * dv)
        late[c] = pace * (row - middle)
        u[c], v[c] = u[c] - late[c] * grid[0] * du, row


@kernel(error_model="numpy")
def _look_up(ray_y: Any, depth_m: Any, exposure: Any, T: Any, color: Any, height: Any, u: Any, v: Any) -> None:
    """Where (w,) u and v a colour camera of so many rows saw points of one row of depth (w,); -1 where unknown."""
    grid, twist, shutter_s = exposure.grid, exposure.twist, exposure.shutter_s
    outside = np.float32(-1)
    pace, middle = shutter_s / np.float32(height), np.float32(0.5 * height - 0.5)
    for c in range(len(u)):
        z = depth_m[c]
        x, y, is_known = (np.float32(c) - grid[2]) / grid[0] * z, ray_y * z, z > 0
        late = pace * (_row_seen(x, y, z, T, color) - middle)
        x -= late * (twist[0] + twist[4] * z - twist[5] * y)
        y -= late * (twist[1] + twist[5] * x - twist[3] * z)
        z -= late * (twist[2] + twist[3] * y - twist[4] * x)
        a, b, is_before = _seen_at(x, y, z, T, color)
        u[c] = a if is_known & is_before else outside
        v[c] = b if is_known & is_before else outside


@kernel(error_model="numpy", inline="always")
def _flow(x: Any, y: Any, z: Any, twist: Any) -> Any:
    """How fast a point at (x, y, 1)·z moves over the image as the camera moves on, negated: (2,) a second, at f = 1.

    Of a camera with velocity (v, ω), a fixed point moves by -(v + ω × p); this is the image of +(v + ω × p).
    """
    near = np.float32(1) / z
    dx = twist[0] * near + twist[4] - twist[5] * y
    dy = twist[1] * near + twist[5] * x - twist[3]
    dz = twist[2] * near + twist[3] * y - twist[4] * x
    return dx - x * dz, dy - y * dz


@kernel(error_model="numpy", inline="always")
def _depth_near(depth_m: Any, u: Any, v: Any) -> Any:
    """Depth of the nearest pixel, or a typical one where that is unknown."""
    half = np.float32(0.5)
    z = depth_m[_within(v + half, depth_m.shape[0] - 1), _within(u + half, depth_m.shape[1] - 1)]
    return z if z > 0 else _TYPICAL_DEPTH_M


@kernel(error_model="numpy", inline="always")
def _depth_between(depth_m: Any, u: Any, v: Any, jump: float) -> Any:
    """Depth between four pixels where they are one surface, else that of the nearest pixel; 0 outside."""
    height, width = depth_m.shape
    half, none = np.float32(0.5), np.float32(0.0)
    nearest = depth_m[_within(v + half, height - 1), _within(u + half, width - 1)]
    r, c = _within(v, height - 2), _within(u, width - 2)
    a, b, d, e = depth_m[r, c], depth_m[r, c + 1], depth_m[r + 1, c], depth_m[r + 1, c + 1]
    low, high = min(min(a, b), min(d, e)), max(max(a, b), max(d, e))
    is_one = (low > none) & (high - low <= jump * nearest) & (u >= none) & (v >= none)
    is_one &= (u < width - 1) & (v < height - 1)
    z = _mixed(a, b, d, e, np.float32(u - c), np.float32(v - r)) if is_one else nearest
    is_inside = (-half < u) & (-half < v) & (u < width - half) & (v < height - half)
    return z if is_inside else none


@kernel(error_model="numpy", inline="always")
def _row_seen(x: Any, y: Any, z: Any, T: Any, color: Any) -> Any:
    """The colour camera's row of a point, lens left aside: near enough to know when it was read."""
    b = T[4] * x + T[5] * y + T[6] * z + T[7]
    d = T[8] * x + T[9] * y + T[10] * z + T[11]
    return color[1] * b / max(d, _NEAREST_M) + color[3]


@kernel(error_model="numpy", inline="always")
def _seen_at(x: Any, y: Any, z: Any, T: Any, color: Any) -> Any:
    """The colour camera's pixel (u, v) of a point of the depth camera, and whether it is before the camera."""
    a = T[0] * x + T[1] * y + T[2] * z + T[3]
    b = T[4] * x + T[5] * y + T[6] * z + T[7]
    d = T[8] * x + T[9] * y + T[10] * z + T[11]
    near, two = max(d, _NEAREST_M), np.float32(2)
    a, b = a / near, b / near
    q, ab = a * a + b * b, two * a * b
    radial = np.float32(1) + q * (color[4] + q * (color[5] + q * color[8]))
    a_bent = a * radial + color[6] * ab + color[7] * (q + two * a * a)
    b_bent = b * radial + color[6] * (q + two * b * b) + color[7] * ab
    return color[0] * a_bent + color[2], color[1] * b_bent + color[3], d > _NEAREST_M


@kernel(error_model="numpy", inline="always")
def _between(image: Any, u: Any, v: Any) -> Any:
    """Bilinear value between pixels; -1 outside the image or where a neighbour is unknown."""
    height, width = image.shape
    r, c = _within(v, height - 2), _within(u, width - 2)
    a, b, d, e = image[r, c], image[r, c + 1], image[r + 1, c], image[r + 1, c + 1]
    is_known = _is_between(u, v, width, height) & (min(min(a, b), min(d, e)) >= 0)
    return _mixed(a, b, d, e, np.float32(u - c), np.float32(v - r)) if is_known else NO_GREY


@kernel(error_model="numpy", inline="always")
def _color_between(image: Any, u: Any, v: Any) -> Any:
    """Bilinear red, green and blue between pixels of bytes; -1 outside the image."""
    height, width = image.shape[0], image.shape[1]
    r, c = _within(v, height - 2), _within(u, width - 2)
    s, t = np.float32(u - c), np.float32(v - r)
    red, green, blue = _channel(image, r, c, 0, s, t), _channel(image, r, c, 1, s, t), _channel(image, r, c, 2, s, t)
    is_known = _is_between(u, v, width, height)
    return red if is_known else NO_GREY, green if is_known else NO_GREY, blue if is_known else NO_GREY


@kernel(error_model="numpy", inline="always")
def _channel(image: Any, r: Any, c: Any, k: Any, s: Any, t: Any) -> Any:
    a, b = np.float32(image[r, c, k]), np.float32(image[r, c + 1, k])
    return _mixed(a, b, np.float32(image[r + 1, c, k]), np.float32(image[r + 1, c + 1, k]), s, t)


@kernel(error_model="numpy", inline="always")
def _is_between(u: Any, v: Any, width: Any, height: Any) -> Any:
    return (u >= 0) & (v >= 0) & (u < width - 1) & (v < height - 1)


@kernel(error_model="numpy", inline="always")
def _within(x: Any, last: Any) -> Any:
    """The whole part of a coordinate, held within an image."""
    return int(min(max(x, np.float32(0)), np.float32(last)))


@kernel(error_model="numpy", inline="always")
def _mixed(a: Any, b: Any, d: Any, e: Any, s: Any, t: Any) -> Any:
    """Bilinear value at s to the right and t below a, of a, b beside it, and d, e below them."""
    one = np.float32(1.0)
    return (one - t) * ((one - s) * a + s * b) + t * ((one - s) * d + s * e)


# Compiled inner loops that make references: normals, gradients, and all that a look-up needs side by side.

_NAN = np.float32(np.nan)
_FEWEST = np.float32(6)
# So far a lens and a depth camera's window spread the rim of what stands before a surface.
_BOUNDARY_PX = 2
# Squared cosine to the ray below which neighbours are too far apart in depth for a normal. Beyond what sensors measure:
# of a floor that were cut off nearer, only the places would be left that noise tilts, and lifts, towards the camera.
_GRAZED = np.float32(0.01)
# Normals of so many pixels side by side are fitted at once: no branches, and sums that stay close at hand.
_STRETCH = 128
# Sums over a window, of u, v beside its middle and d, by how much inverse depth is more than there.
_S, _SU, _SV, _SUU, _SVV, _SUV, _SD, _SUD, _SVD, _SDD = range(10)
_SUMS = 10


@kernel(error_model="numpy")
def pack(depth_m: Any, normal: Any, grey: Any, grid: Any, boundary: Any, begin: int, end: int, out: Any) -> None:
    """Rows `begin` to `end` of a reference's pixels (h, w, CHANNELS), NaN where something is unknown.

    Args:
        depth_m, normal, grey: (h, w), 0 where unknown; (h, w, 3), 0 where unknown; (h, w), -1 where unknown.
        grid: fx, fy, cx, cy.
        boundary: (3,) by how much what stands before a surface must be nearer to make an occlusion boundary; see
            `_step`. Grey beside one has no gradient: it moves as what stands before does.
    """
    height, width = depth_m.shape
    half = np.float32(0.5)
    for r in range(begin, end):
        y = np.float32((r - grid[3]) / grid[1])
        for c in range(width):
            z, x = depth_m[r, c], np.float32((c - grid[2]) / grid[0])
            nx, ny, nz = normal[r, c, 0], normal[r, c, 1], normal[r, c, 2]
            out[r, c, NX], out[r, c, NY], out[r, c, NZ] = nx, ny, nz
            out[r, c, OFFSET] = z * (nx * x + ny * y + nz) if nz != 0 else _NAN
            out[r, c, DEPTH] = z if z > 0 else _NAN
            out[r, c, GREY] = out[r, c, ALONG_U] = out[r, c, ALONG_V] = _NAN
            if grey[r, c] >= 0:
                out[r, c, GREY] = grey[r, c]
            if 0 < c < width - 1 and grey[r, c - 1] >= 0 and grey[r, c + 1] >= 0:
                out[r, c, ALONG_U] = half * (grey[r, c + 1] - grey[r, c - 1])
            if 0 < r < height - 1 and grey[r - 1, c] >= 0 and grey[r + 1, c] >= 0:
                out[r, c, ALONG_V] = half * (grey[r + 1, c] - grey[r - 1, c])
            if _is_at_boundary(depth_m, r, c, boundary):
                out[r, c, ALONG_U] = out[r, c, ALONG_V] = _NAN


@kernel(error_model="numpy", inline="always")
def _is_at_boundary(depth_m: Any, r: int, c: int, boundary: Any) -> Any:
    """Whether something stands before the surface within `_BOUNDARY_PX`, by more than a step `boundary`.

    On a plane inverse depth is linear: what is nearer on one side than it is farther on the other is another surface.
    """
    height, width = depth_m.shape
    if min(r, c) < _BOUNDARY_PX or r >= height - _BOUNDARY_PX or c >= width - _BOUNDARY_PX:
        return False
    z, two, found = depth_m[r, c], np.float32(2), False
    limit = _step(boundary, z)
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one = depth_m[r + _BOUNDARY_PX * i, c + _BOUNDARY_PX * j]
        other = depth_m[r - _BOUNDARY_PX * i, c - _BOUNDARY_PX * j]
        found |= (one > 0) & (other > 0) & (z * (z / one + z / other - two) > limit)
    return found


@kernel(error_model="numpy", inline="always")
def _step(step: Any, z: Any) -> Any:
    """A step (3,) in depth, in metres at a depth z: metres, a share of z, and metres a square metre of it."""
    return step[0] + z * (step[1] + step[2] * z)


@kernel(error_model="numpy")
def normals(depth_m: Any, grid: Any, radius: int, step: Any, bend: Any, begin: int, end: int, out: Any) -> None:
    """Unit normals (h, w, 3) towards the camera by least squares of inverse depth over a window; 0 where none.

    On a plane inverse depth is linear in the pixel, 1/z = a·u + b·v + c, so the normal follows from its slopes
    (Badino et al., ICRA 2011, fit the same model). The window is (2·radius + 1)², on one surface only, without its
    middle, whose noise is much the pixel's own: a normal that turns with the noise of the point it stands on makes
    every wall pull towards the camera, by 2 to 4 mm in a corridor seen by a Kinect.

    Args:
        step: (3,) by which neighbours on one surface may differ; see `_step`.
        bend: (2,) what a surface may be off its plane, RMS: metres, and metres a square metre of depth.
    """
    (height, width), core = depth_m.shape, radius // 2
    out[begin:end] = 0
    sums, found = np.empty((_SUMS, _STRETCH), np.float32), np.empty((3, _STRETCH), np.float32)
    for r in range(max(begin, radius), min(end, height - radius)):
        for first in range(radius, width - radius, _STRETCH):
            n = min(_STRETCH, width - radius - first)
            here = depth_m[r, first : first + n]
            sums[:] = 0
            for i in range(-radius, radius + 1):
                for j in range(-radius, radius + 1):
                    if max(abs(i), abs(j)) <= core:
                        continue
                    _sum_up(here, depth_m[r + i, first + j : first + j + n], step, i, j, sums)
            _solve(here, sums, grid, bend, r, first, found)
            for c in range(n):
                for k in range(3):
                    out[r, first + c, k] = found[k, c]


@kernel(error_model="numpy", inline="always")
def _sum_up(here: Any, there: Any, step: Any, i: int, j: int, sums: Any) -> None:
    """Add to the windows' sums what their pixels i rows and j columns from the middle, `there`, tell of its surface.

    A limit that noise reaches would pick those neighbours that err as the middle does.
    """
    zero, one, u, v = np.float32(0), np.float32(1), np.float32(j), np.float32(i)
    for c in range(len(here)):
        z, near = here[c], there[c]
        is_like = (near > 0) & (abs(near - z) < _step(step, z))
        known = one if is_like else zero
        d = (z - near) / (z * near) if is_like else zero
        sums[_S, c] += known
        sums[_SU, c] += u * known
        sums[_SV, c] += v * known
        sums[_SUU, c] += u * u * known
        sums[_SVV, c] += v * v * known
        sums[_SUV, c] += u * v * known
        sums[_SD, c] += d
        sums[_SUD, c] += u * d
        sums[_SVD, c] += v * d
        sums[_SDD, c] += d * d


@kernel(error_model="numpy", inline="always")
def _solve(here: Any, sums: Any, grid: Any, bend: Any, r: int, first: int, found: Any) -> None:
    """Normals (3, n) of the pixels `here`, from column `first` of row r on, by the sums over their windows."""
    zero, one, y = np.float32(0), np.float32(1), np.float32((r - grid[3]) / grid[1])
    for c in range(len(here)):
        z, s, su, sv, sd = here[c], sums[_S, c], sums[_SU, c], sums[_SV, c], sums[_SD, c]
        suu, svv, suv = sums[_SUU, c] - su * su / s, sums[_SVV, c] - sv * sv / s, sums[_SUV, c] - su * sv / s
        sud, svd, sdd = sums[_SUD, c] - su * sd / s, sums[_SVD, c] - sv * sd / s, sums[_SDD, c] - sd * sd / s
        det = suu * svv - suv * suv
        a, b = (svv * sud - suv * svd) / det, (suu * svd - suv * sud) / det
        sigma = bend[0] / (z * z) + bend[1]
        is_flat = (s >= _FEWEST) & (det >= one) & ((sdd - a * sud - b * svd) / s <= sigma * sigma)
        x = np.float32((first + c - grid[2]) / grid[0])
        nx, ny = grid[0] * a, grid[1] * b
        # Inverse depth of the plane, not of the pixel; in its units it is n·(x, y, 1).
        near = one / z + (sd - a * su - b * sv) / s
        nz = near - nx * x - ny * y
        square = nx * nx + ny * ny + nz * nz
        is_seen = is_flat & (near > zero) & (near * near >= _GRAZED * square * (x * x + y * y + one))
        scale = -one / np.sqrt(square)
        found[0, c] = scale * nx if is_seen else zero
        found[1, c] = scale * ny if is_seen else zero
        found[2, c] = scale * nz if is_seen else zero


_FIXED_POINT_STEPS = 6
# From near to far: where a ray meets an object's edge and the wall behind, the object hides the wall.
_GUESSES_M = (0.6, 1.0, 1.7, 3.0)
_NEAREST_RAY_M = 0.1


class DepthImage(NamedTuple):
    """A depth image (h, w) in metres, where its camera is, and what of it counts.

    `intrinsics` (4,) are fx, fy, cx, cy; within `jump`, as a share of the depth, readings are of one surface.
    """

    depth_m: Float32Array
    R_color_depth: FloatArray
    t_color_depth: FloatArray
    intrinsics: FloatArray
    is_registered: bool
    near_m: float
    far_m: float
    jump: float


class Triangles(NamedTuple):
    """Limits of three pairs that make a hypothesis: least length of a side, largest difference of its two lengths."""

    least_m: float
    change_m: float
    change_share: float


class Pairs(NamedTuple):
    """N points (N, 3) known in a reference, and what was seen of them: `xy` (N, 2) on the plane z = 1, depth (N,).

    `scale_xy`, `scale_m` (N,) are 1/σ of these; a `scale_m` of 0 leaves depth out.
    """

    p_reference: FloatArray
    xy: FloatArray
    depth_m: FloatArray
    scale_xy: FloatArray
    scale_m: FloatArray


@kernel
def depth_at_keypoints(image: DepthImage, px: FloatArray, xy: FloatArray) -> Any:
    """Depth (N,) along the colour camera's z axis at keypoints (N, 2), 0 where there is none to trust.

    Registered, the depth image is read at the keypoint's own pixel. Else the point is sought where the ray through
    `xy` meets the depth image's surface: guess a depth, look where that point falls in the depth image, take the
    depth found there as the next guess, until it stays. Where it does not from any guess, at edges that one camera
    sees past and the other does not, there is none.
    """
    found = np.zeros(len(px))
    for i in range(len(px)):
        if image.is_registered:
            z = _smooth_depth(image.depth_m, px[i, 0], px[i, 1], image.jump)
            if image.near_m <= z <= image.far_m:
                found[i] = z
            continue
        for guess_m in _GUESSES_M:
            z = _depth_along_ray(image, xy[i], guess_m)
            if z > 0:
                found[i] = z
                break
    return found


@kernel
def _depth_along_ray(image: DepthImage, xy: FloatArray, guess_m: float) -> Any:
    """Depth of the colour camera at `xy` (2,) by fixed-point iteration from a guess; 0 where it does not settle."""
    R_color_depth, t_color_depth, intrinsics = image.R_color_depth, image.t_color_depth, image.intrinsics
    z_color = guess_m
    for _ in range(_FIXED_POINT_STEPS):
        ray = np.array([xy[0] * z_color, xy[1] * z_color, z_color]) - t_color_depth
        p = R_color_depth.T @ ray
        if p[2] < _NEAREST_RAY_M:
            return 0.0
        u = intrinsics[0] * p[0] / p[2] + intrinsics[2]
        v = intrinsics[1] * p[1] / p[2] + intrinsics[3]
        z = _smooth_depth(image.depth_m, u, v, image.jump)
        if not image.near_m <= z <= image.far_m:
            return 0.0
        x, y = (u - intrinsics[2]) / intrinsics[0] * z, (v - intrinsics[3]) / intrinsics[1] * z
        before = z_color
        z_color = R_color_depth[2, 0] * x + R_color_depth[2, 1] * y + R_color_depth[2, 2] * z + t_color_depth[2]
        if abs(z_color - before) < 1e-4:
            return z_color
    return 0.0


@kernel
def _smooth_depth(depth_m: Float32Array, u: float, v: float, jump: float) -> Any:
    """Bilinear depth at a pixel; 0 beside holes, at edges of objects and outside the image.

    The sixteen readings around must all be there and differ by at most `jump` of the nearest: a keypoint on an
    object's edge could belong to either side.
    """
    column, row = int(np.floor(u)), int(np.floor(v))
    if column < 1 or row < 1 or column >= depth_m.shape[1] - 2 or row >= depth_m.shape[0] - 2:
        return 0.0
    low, high = np.inf, 0.0
    for r in range(row - 1, row + 3):
        for c in range(column - 1, column + 3):
            z = depth_m[r, c]
            if z <= 0:
                return 0.0
            low, high = min(low, z), max(high, z)
    if high - low > jump * low:
        return 0.0
    a, b = u - column, v - row
    top = (1 - a) * depth_m[row, column] + a * depth_m[row, column + 1]
    bottom = (1 - a) * depth_m[row + 1, column] + a * depth_m[row + 1, column + 1]
    return (1 - b) * top + b * bottom


@kernel
def project(points: FloatArray, fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> Any:
    """Pixels (N, 2) of points (N, 3) seen by a camera without distortion; NaN behind it or outside the image."""
    px = np.full((len(points), 2), np.nan)
    for i in range(len(points)):
        x, y, z = points[i]
        if z <= _NEAREST_RAY_M:
            continue
        u, v = fx * x / z + cx, fy * y / z + cy
        if 0 < u < width and 0 < v < height:
            px[i, 0], px[i, 1] = u, v
    return px


@kernel
def align_three(p_a: FloatArray, p_b: FloatArray) -> Any:
    """Return rotation and translation from (3, 3) points b to points a, without reflection (Zhang, section 3.2)."""
    mean_a = (p_a[0] + p_a[1] + p_a[2]) / 3
    mean_b = (p_b[0] + p_b[1] + p_b[2]) / 3
    W = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                W[j, k] += (p_a[i, j] - mean_a[j]) * (p_b[i, k] - mean_b[k])
    U, _, Vt = np.linalg.svd(W)
    if np.linalg.det(U) * np.linalg.det(Vt) < 0:
        for i in range(3):
            U[i, 2] = -U[i, 2]
    R = U @ Vt
    return R, mean_a - R @ mean_b


@kernel
def residuals_of(R: FloatArray, t: FloatArray, pairs: Pairs, out: FloatArray) -> Any:
    """Squared, normalised distance (N,) between points, moved, and what was seen of them; inf behind the camera."""
    p_reference, xy, depth_m, scale_xy, scale_m = pairs
    for i in range(len(p_reference)):
        x, y, z = p_reference[i]
        Z = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        if Z < _NEAREST_RAY_M:
            out[i] = np.inf
            continue
        u = ((R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]) / Z - xy[i, 0]) * scale_xy[i]
        v = ((R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]) / Z - xy[i, 1]) * scale_xy[i]
        w = (Z - depth_m[i]) * scale_m[i]
        out[i] = u * u + v * v + w * w
    return out


@kernel
def ransac(pairs: Pairs, rules: Triangles, gate: float, iterations: int, seed: int) -> Any:
    """R, t current from reference that most of N point pairs agree with, and how many do (their chi-square < gate).

    All pairs have depth; three make a hypothesis. Those whose distances differ between the frames, or that stand too
    close together to determine a rotation, are not tried. Stops early once a better hypothesis is unlikely (at 99.9 %).
    """
    np.random.seed(seed)
    p_reference, xy, depth_m = pairs.p_reference, pairs.xy, pairs.depth_m
    p_current = np.column_stack((xy * depth_m.reshape(-1, 1), depth_m))
    n = len(p_reference)
    best_R, best_t, best, needed = np.eye(3), np.zeros(3), 0, iterations
    squares = np.empty(n)
    trial = 0
    while trial < needed:
        trial += 1
        chosen = np.random.choice(n, 3, replace=False) if n < 20 else np.random.randint(0, n, 3)
        if chosen[0] == chosen[1] or chosen[1] == chosen[2] or chosen[0] == chosen[2]:
            continue
        a, b = p_current[chosen], p_reference[chosen]
        if not _same_triangle(a, b, rules):
            continue
        R, t = align_three(a, b)
        residuals_of(R, t, pairs, squares)
        agreeing = int(np.count_nonzero(squares < gate))
        if agreeing > best:
            best, best_R, best_t = agreeing, R, t
            miss = 1 - (agreeing / n) ** 3
            needed = min(iterations, 1 if miss < 1e-9 else int(np.log(1e-3) / np.log(miss)) + 1)
    return best_R, best_t, best


@kernel
def _same_triangle(a: FloatArray, b: FloatArray, rules: Triangles) -> bool:
    for i in range(3):
        j = (i + 1) % 3
        side_a = np.sqrt(((a[i] - a[j]) ** 2).sum())
        side_b = np.sqrt(((b[i] - b[j]) ** 2).sum())
        if side_a < rules.least_m or abs(side_a - side_b) > rules.change_m + rules.change_share * side_a:
            return False
    return True


@kernel
def normal_equations(R: FloatArray, t: FloatArray, pairs: Pairs, gate: float) -> Any:
    """H (6, 6), g (6,) of the robust least squares at R, t, and its cost Σ χ² / (1 + χ² / (gate/2)).

    Perturbation δ = (v, ω) from the left of T_current_reference. Weights are Geman and McClure's,
    1 / (1 + χ² / (gate/2))², so that a pair beyond the gate counts for little.
    """
    p_reference, xy, depth_m, scale_xy, scale_m = pairs
    H, g, cost = np.zeros((6, 6)), np.zeros(6), 0.0
    J = np.zeros((3, 6))
    for i in range(len(p_reference)):
        x, y, z = p_reference[i]
        X = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
        Y = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
        Z = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        if Z < _NEAREST_RAY_M:
            continue
        a = scale_xy[i] / Z
        d = scale_m[i]
        r0, r1, r2 = (X / Z - xy[i, 0]) * scale_xy[i], (Y / Z - xy[i, 1]) * scale_xy[i], (Z - depth_m[i]) * d
        square = r0 * r0 + r1 * r1 + r2 * r2
        root = 1 / (1 + square / (0.5 * gate))
        weight = root * root
        cost += square * root
        # Rows: x/z, y/z and z of the moved point p; dp = v + ω × p.
        J[0, 0], J[0, 2], J[1, 1], J[1, 2], J[2, 2] = a, -a * X / Z, a, -a * Y / Z, d
        J[0, 3], J[0, 4], J[0, 5] = J[0, 2] * Y, a * Z - J[0, 2] * X, -a * Y
        J[1, 3], J[1, 4], J[1, 5] = -a * Z + J[1, 2] * Y, -J[1, 2] * X, a * X
        J[2, 3], J[2, 4] = d * Y, -d * X
        for p in range(6):
            g[p] += weight * (J[0, p] * r0 + J[1, p] * r1 + J[2, p] * r2)
            for q in range(p, 6):
                H[p, q] += weight * (J[0, p] * J[0, q] + J[1, p] * J[1, q] + J[2, p] * J[2, q])
    for p in range(6):
        for q in range(p):
            H[p, q] = H[q, p]
    return H, g, cost


@kernel
def refine(R: FloatArray, t: FloatArray, pairs: Pairs, gate: float, steps: int) -> Any:
    """Gauss–Newton from R, t: the better R, t, H (6, 6) there, and χ² (N,) of all pairs."""
    for _ in range(steps):
        H, g, _ = normal_equations(R, t, pairs, gate)
        for p in range(6):
            H[p, p] += 1e-9 * H[p, p] + 1e-12
        step = -np.linalg.solve(H, g)
        dR = rotation(step[3:])
        R, t = dR @ R, dR @ t + step[:3]
        if np.abs(step).max() < 1e-7:
            break
    H, _, _ = normal_equations(R, t, pairs, gate)
    squares = residuals_of(R, t, pairs, np.empty(len(pairs.p_reference)))
    return R, t, H, squares


@kernel
def rotation(omega: FloatArray) -> Any:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = np.sqrt((omega**2).sum())
    W = np.array([[0.0, -omega[2], omega[1]], [omega[2], 0.0, -omega[0]], [-omega[1], omega[0], 0.0]])
    if angle < 1e-6:
        return np.eye(3) + W + 0.5 * (W @ W)
    return np.eye(3) + np.sin(angle) / angle * W + (1 - np.cos(angle)) / angle**2 * (W @ W)


# Compiled Hamming distances between 256-bit descriptors, held as four 64-bit words.

_FAR = 1000


@kernel
def nearest_both_ways(first: UInt64Array, second: UInt64Array) -> Any:
    """For each of (N, 4) the nearest of (M, 4) and its distance; and for each of the second its nearest in the first.

    The lower index wins where distances are equal; -1 where the other set is empty.
    """
    n, m = len(first), len(second)
    nearest, distance = np.full(n, -1, np.int64), np.full(n, _FAR, np.int64)
    nearest_back, distance_back = np.full(m, -1, np.int64), np.full(m, _FAR, np.int64)
    for i in range(n):
        for j in range(m):
            d = hamming(first[i], second[j])
            if d < distance[i]:
                distance[i], nearest[i] = d, j
            if d < distance_back[j]:
                distance_back[j], nearest_back[j] = d, i
    return nearest, distance, nearest_back


class Cells(NamedTuple):
    """Seen keypoints (N, 2) and descriptors (N, 4), sorted into square cells, `columns` by `rows`.

    `order[starts[c]:starts[c + 1]]` lie in cell c.
    """

    px: FloatArray
    descriptors: UInt64Array
    order: IntArray
    starts: IntArray
    columns: int
    rows: int
    cell_px: int


@kernel
def nearest_within(
    expected_px: FloatArray,
    expected: UInt64Array,
    seen: Cells,
    radius_px: float,
    max_hamming: int,
    distinct_share: float,
) -> Any:
    """For each expected keypoint the index of the nearest descriptor within `radius_px`, or -1.

    A seen keypoint wanted by several goes to the one whose descriptor is nearest.
    """
    px, descriptors, order, starts, columns, rows, cell_px = seen
    found = np.full(len(expected), -1, np.int64)
    owner, owned_at = np.full(len(px), -1, np.int64), np.full(len(px), _FAR, np.int64)
    for i in range(len(expected)):
        u, v = expected_px[i, 0], expected_px[i, 1]
        if not (np.isfinite(u) and np.isfinite(v)):
            continue
        left, right = _cells_around(u, radius_px, cell_px, columns)
        top, bottom = _cells_around(v, radius_px, cell_px, rows)
        best, second_best, best_j = _FAR, _FAR, -1
        for row in range(top, bottom + 1 if left <= right else top):
            for j in order[starts[row * columns + left] : starts[row * columns + right + 1]]:
                if (px[j, 0] - u) ** 2 + (px[j, 1] - v) ** 2 > radius_px**2:
                    continue
                d = hamming(expected[i], descriptors[j])
                if d < best:
                    best, second_best, best_j = d, best, j
                elif d < second_best:
                    second_best = d
        # Ambiguous in its own neighbourhood: a repeated texture, better left out.
        if best_j < 0 or best > max_hamming or best > distinct_share * second_best + 1:
            continue
        if best < owned_at[best_j]:
            if owner[best_j] >= 0:
                found[owner[best_j]] = -1
            owner[best_j], owned_at[best_j], found[i] = i, best, best_j
    return found


@kernel
def _cells_around(x: float, radius_px: float, cell_px: int, count: int) -> Any:
    """First and last of `count` cells in a row, or column, that lie within the radius; the first is larger for none."""
    return max(0, int((x - radius_px) // cell_px)), min(count - 1, int((x + radius_px) // cell_px))
