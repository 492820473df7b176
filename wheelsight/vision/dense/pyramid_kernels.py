"""Compiled inner loops that resample and halve images, and compute normals and gradients of references."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.vision.dense.alignment_kernels import ALONG_U, ALONG_V, DEPTH, GREY, NX, NY, NZ, OFFSET

# Compiled inner loops that bring frames onto the grid of an ideal camera, and halve it level by level.
#
# Images are float32, but for colours as measured. Depth 0, grey -1 and colour -1 say that nothing is known there.
#
# Where a row's pixels were seen is worked out for the whole row at once, then the images are read there: loops of
# plain arithmetic are done eight pixels at a time. Cameras, poses and twists come as tuples, and helpers that read
# images do so without branches, for numba counts references to an array that an inlined helper takes, pixel by pixel,
# unless it sees that nothing happens in between; and threads that count the same reference wait for each other.


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
