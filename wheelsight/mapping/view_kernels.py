"""Compiled inner loops that read surfels: rendering from a pose, and signed distances for meshes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.mapping.block_kernels import CONFIDENCE, PAGE, RADIUS, InView, SurfelArrays

# Rendering: oriented disks, with those of the nearest surface blended. Disks are visited in order, so that no pixel
# depends on how rows are split.

_ZERO, _QUARTER, _ONE = np.float32(0.0), np.float32(0.25), np.float32(1.0)
# Unstable surfels are shown only where no stable one is: they rank as if this far away.
BEHIND_M = np.float32(1000.0)
_NEAREST_M = np.float32(0.1)
_RIM = np.float32(1.001)
# A disk in the camera frame: slopes x/z, y/z of its centre, the quadratic form (3) of slopes that is 1 at its rim, n·p,
# weight; then the values that a pixel averages: normal (3), whether grey is known, grey, red, green, blue (0 if not).
DISK, _FORM, _PLANE, _WEIGHT = 16, 2, 5, 6
_NORMAL, _PAINTED, _GREY, _RED = 8, 11, 12, 13
# Rows of the buffers of a page's surfels, as in geometry, and of their disks: the first entries up to the normal, and
# the first and last row and column of its bounding box.
_SURFEL, _BOUND, _SHOWN = 8, 11, 15
# Of a pixel: rank of the nearest disk, weight, weighted depth; and in another array, weighted, a disk's last half.
NEAR, _RANK, _TOTAL, _DEPTH = 3, 0, 1, 2
SUMS = 8


class RenderCamera(NamedTuple):
    """T_map_camera (4, 4) and fx, fy, cx, cy (4,), float32, and the image's size in pixels."""

    T: Any
    grid: Any
    width: Any
    height: Any


class RenderLimits(NamedTuple):
    """RenderLimits of the surfels that are shown.

    Attributes:
        far_m: largest distance.
        stable: least confidence of stable surfels.
        least: least confidence of shown ones.
        vague_m2: unstable surfels with a larger variance are left out.
        smallest_px, largest_px: radii of their disks in the image.
        cosine: least cosine of the viewing angle.
        since_s: surfels last seen before are left out.
    """

    far_m: Any
    stable: Any
    least: Any
    vague_m2: Any
    smallest_px: Any
    largest_px: Any
    cosine: Any
    since_s: Any


class Disks(NamedTuple):
    """Surfels in a camera's image.

    Attributes:
        disk: (entries, DISK) float32.
        bound: (entries, 4) int16 first and last row, first and last column.
        count: (pages, 2) number of stable and unstable disks.
    """

    disk: Any
    bound: Any
    count: Any


class RenderImage(NamedTuple):
    """Sums of pixels: slopes of columns (w,) and rows (h,), `near` (h, w, NEAR), `sums` (h, w, SUMS).

    Disks within `blend` per metre of depth, plus `blend_m`, are of one surface.
    """

    ray_x: Any
    ray_y: Any
    near: Any
    sums: Any
    blend: Any
    blend_m: Any


@kernel(error_model="numpy", fastmath={"contract"})
def project_disks(
    begin: Any, end: Any, in_view: InView, surfels: SurfelArrays, lens: RenderCamera, limits: RenderLimits, out: Disks
) -> None:
    """Compute the disks of surfels of pages `begin` to `end` that face the camera.

    The stable ones of page k begin at entry k·PAGE, and its unstable ones end before entry (k + 1)·PAGE.
    """
    # Read from the tuples once: each access would be reference-counted.
    pages, page_fill, T, grid = in_view.pages, in_view.fill, lens.T, lens.grid
    geometry, look, seen_s, variance = surfels.geometry, surfels.look, surfels.seen_s, surfels.variance
    stable, least, vague_m2, since_s = limits.stable, limits.least, limits.vague_m2, limits.since_s
    disk, bound, last_column, last_row = out.disk, out.bound, np.float32(lens.width - 1), np.float32(lens.height - 1)
    surfel, shown = np.empty((_SURFEL, PAGE), np.float32), np.empty((_SHOWN, PAGE), np.float32)
    for k in range(begin, end):
        first, fill, low, high = pages[k] * PAGE, page_fill[pages[k]], k * PAGE, (k + 1) * PAGE
        for i in range(fill):
            for j in range(_SURFEL):
                surfel[j, i] = geometry[first + i, j]
            is_vague = surfel[CONFIDENCE, i] < stable and variance[first + i] > vague_m2
            if surfel[CONFIDENCE, i] < least or seen_s[first + i, 1] < since_s or is_vague:
                surfel[CONFIDENCE, i] = _ZERO
        _project(surfel, fill, T, grid, last_column, last_row, limits, shown)
        for i in range(fill):
            if not shown[_WEIGHT, i] > 0:
                continue
            is_stable = shown[_WEIGHT, i] >= stable
            entry = low if is_stable else high - 1
            low, high = (low + 1, high) if is_stable else (low, high - 1)
            _draw(disk, bound, entry, shown, look, first + i, i)
        out.count[k, 0], out.count[k, 1] = low - k * PAGE, (k + 1) * PAGE - high


@kernel(error_model="numpy", inline="always")
def _draw(disk: Any, bound: Any, entry: Any, shown: Any, look: Any, slot: Any, i: Any) -> None:
    """Write the disk of a page's surfel i, with its look."""
    for j in range(_PAINTED):
        disk[entry, j] = shown[j, i]
    for j in range(4):
        bound[entry, j] = int(shown[_BOUND + j, i])
    known = _ONE if look[slot, 3] >= 0 else _ZERO
    disk[entry, _PAINTED], disk[entry, _GREY] = known, known * look[slot, 3]
    for j in range(3):
        seen = look[slot, j]
        disk[entry, _RED + j] = known * (seen if seen >= 0 else look[slot, 3])


@kernel(error_model="numpy", inline="always")
def _project(
    surfel: Any, fill: Any, T: Any, grid: Any, last_column: Any, last_row: Any, limits: RenderLimits, shown: Any
) -> None:
    """Compute the first entries of disks and their boxes (_SHOWN, PAGE) of a page's surfels; weight 0 if invisible."""
    # Read once: the compiler cannot know that writing to buffers does not change them.
    fx, fy, cx, cy = grid[0], grid[1], grid[2], grid[3]
    ax, ay, az, bx, by, bz = T[0, 0], T[1, 0], T[2, 0], T[0, 1], T[1, 1], T[2, 1]
    dx, dy, dz, tx, ty, tz = T[0, 2], T[1, 2], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    far_m, smallest_px, largest_px, cosine = limits.far_m, limits.smallest_px, limits.largest_px, limits.cosine
    for i in range(fill):
        a, b, d = surfel[0, i] - tx, surfel[1, i] - ty, surfel[2, i] - tz
        p, q, s = surfel[4, i], surfel[5, i], surfel[6, i]
        z, facing = dx * a + dy * b + dz * d, -(a * p + b * q + d * s)
        x, y = (ax * a + ay * b + az * d) / z, (bx * a + by * b + bz * d) / z
        nx, ny = ax * p + ay * q + az * s, bx * p + by * q + bz * s
        least_m = smallest_px * z * z / (fx * (facing if facing < z else z))
        radius = surfel[RADIUS, i] if surfel[RADIUS, i] > least_m else least_m
        xx, xy, yy = _form(x, y, nx, ny, -facing, z, radius)
        det = xx * yy - _QUARTER * xy * xy
        across, down = fx * np.sqrt(yy / det), fy * np.sqrt(xx / det)
        across, down = across if across < largest_px else largest_px, down if down < largest_px else largest_px
        top, bottom = np.ceil(fy * y + cy - down), np.floor(fy * y + cy + down)
        left, right = np.ceil(fx * x + cx - across), np.floor(fx * x + cx + across)
        top, bottom = top if top > _ZERO else _ZERO, bottom if bottom < last_row else last_row
        left, right = left if left > _ZERO else _ZERO, right if right < last_column else last_column
        is_seen = (z >= _NEAREST_M) & (z <= far_m) & (facing >= cosine * z) & (top <= bottom) & (left <= right)
        shown[0, i], shown[1, i], shown[_PLANE, i] = x, y, -facing
        shown[_FORM, i], shown[_FORM + 1, i], shown[_FORM + 2, i] = xx, xy, yy
        shown[_WEIGHT, i] = surfel[CONFIDENCE, i] if is_seen else _ZERO
        shown[_NORMAL, i], shown[_NORMAL + 1, i] = nx, ny
        shown[_NORMAL + 2, i] = dx * p + dy * q + dz * s
        shown[_BOUND, i], shown[_BOUND + 1, i], shown[_BOUND + 2, i], shown[_BOUND + 3, i] = top, bottom, left, right


@kernel(error_model="numpy", inline="always")
def _form(x: Any, y: Any, nx: Any, ny: Any, plane: Any, z: Any, radius: Any) -> Any:
    """Return coefficients of dx², dx·dy, dy² of the squared distance from the centre on the plane, over radius².

    To first order the plane's depth changes by dz = g·dx + h·dy, and a point by (z·dx + x·dz, z·dy + y·dz, dz).
    """
    g, h = -z * z * nx / plane, -z * z * ny / plane
    ray2, scale = x * x + y * y + _ONE, _ONE / (radius * radius)
    xx = scale * (z * z + (x * z + x * z) * g + ray2 * g * g)
    xy = (scale + scale) * (z * (x * h + y * g) + ray2 * g * h)
    return xx, xy, scale * (z * z + (y * z + y * z) * h + ray2 * h * h)


@kernel(error_model="numpy")
def blend(begin: Any, end: Any, disks: Disks, image: RenderImage) -> None:
    """Sum up the stable disks, weighted, of the nearest surface at each pixel of rows `begin` to `end`.

    A disk that is clearly nearer than the sum so far restarts the sum; one clearly farther is left out.
    """
    bound, count = disks.bound, disks.count
    image.sums[begin:end], image.near[begin:end] = 0, 0
    image.near[begin:end, :, _RANK] = np.inf
    for k in range(len(count)):
        for entry in range(k * PAGE, k * PAGE + count[k, 0]):
            if bound[entry, 0] < end and bound[entry, 1] >= begin:
                _add_disk(entry, _ZERO, False, begin, end, disks, image)


@kernel(error_model="numpy")
def fill_in(begin: Any, end: Any, disks: Disks, image: RenderImage) -> None:
    """After blending, add the unstable disks where no stable one is, except those with a stable one at their centre.

    They are noisy, and the nearest one is too near: they are summed once, and again around the resulting mean.
    """
    near, sums = image.near, image.sums
    _add_unstable(False, begin, end, disks, image)
    for r in range(begin, end):
        for c in range(near.shape[1]):
            if near[r, c, _RANK] >= BEHIND_M and near[r, c, _TOTAL] > _ZERO:
                near[r, c, _RANK] = BEHIND_M + near[r, c, _DEPTH] / near[r, c, _TOTAL]
                near[r, c, _TOTAL] = near[r, c, _DEPTH] = _ZERO
                for i in range(SUMS):
                    sums[r, c, i] = _ZERO
    _add_unstable(True, begin, end, disks, image)


@kernel(error_model="numpy")  # not inlined: `fill_in` would compile all of it twice
def _add_unstable(is_known: Any, begin: Any, end: Any, disks: Disks, image: RenderImage) -> None:
    bound, count, near = disks.bound, disks.count, image.near
    for k in range(len(count)):
        for entry in range((k + 1) * PAGE - count[k, 1], (k + 1) * PAGE):
            r, c = (bound[entry, 0] + bound[entry, 1]) // 2, (bound[entry, 2] + bound[entry, 3]) // 2
            if bound[entry, 0] < end and bound[entry, 1] >= begin and near[r, c, _RANK] >= BEHIND_M:
                _add_disk(entry, BEHIND_M, is_known, begin, end, disks, image)


@kernel(error_model="numpy", inline="always")
def _add_disk(entry: Any, behind_m: Any, is_known: Any, begin: Any, end: Any, disks: Disks, image: RenderImage) -> None:
    """Add a disk to the sums of its pixels, except those with a nearer rank than `behind_m`.

    Pixels take the nearest surface, or with `is_known` the disks around the known one.
    """
    disk, bound, ray_x, ray_y, near, sums = disks.disk, disks.bound, image.ray_x, image.ray_y, image.near, image.sums
    low, high = max(bound[entry, 0], begin), min(bound[entry, 1] + 1, end)
    left, right = max(bound[entry, 2], 0), bound[entry, 3] + 1
    middle_x, middle_y, plane, confidence = disk[entry, 0], disk[entry, 1], disk[entry, _PLANE], disk[entry, _WEIGHT]
    xx, xy, yy = disk[entry, _FORM], disk[entry, _FORM + 1], disk[entry, _FORM + 2]
    # Read before the first write, so that the compiler can vectorise the sums.
    nx, ny, nz, known = disk[entry, 8], disk[entry, 9], disk[entry, 10], disk[entry, 11]
    grey, red, green, blue = disk[entry, 12], disk[entry, 13], disk[entry, 14], disk[entry, 15]
    for r in range(low, high):
        dy = ray_y[r] - middle_y
        across, part = ny * ray_y[r] + nz, yy * dy * dy
        for c in range(left, right):
            nearest, dx = near[r, c, _RANK], ray_x[c] - middle_x
            if nearest < behind_m:
                continue
            rim = dx * (xx * dx + xy * dy) + part
            z = plane / (nx * ray_x[c] + across)
            rank, reach = z + behind_m, image.blend * z + image.blend_m
            is_before = rank < nearest - reach
            if (rim > _ONE) | (rank > nearest + reach) | (is_known & is_before):
                continue
            kept = _ZERO if is_before else _ONE
            weight = confidence * (_RIM - rim) * (_RIM - rim)
            near[r, c, _RANK] = nearest if is_known else min(nearest, rank)
            near[r, c, _TOTAL] = kept * near[r, c, _TOTAL] + weight
            near[r, c, _DEPTH] = kept * near[r, c, _DEPTH] + weight * z
            s0, s1, s2, s3 = sums[r, c, 0], sums[r, c, 1], sums[r, c, 2], sums[r, c, 3]
            s4, s5, s6, s7 = sums[r, c, 4], sums[r, c, 5], sums[r, c, 6], sums[r, c, 7]
            sums[r, c, 0], sums[r, c, 1] = kept * s0 + weight * nx, kept * s1 + weight * ny
            sums[r, c, 2], sums[r, c, 3] = kept * s2 + weight * nz, kept * s3 + weight * known
            sums[r, c, 4], sums[r, c, 5] = kept * s4 + weight * grey, kept * s5 + weight * red
            sums[r, c, 6], sums[r, c, 7] = kept * s6 + weight * green, kept * s7 + weight * blue


@kernel(error_model="numpy")
def divide(begin: Any, end: Any, near: Any, sums: Any, depth_m: Any, normal: Any, grey: Any, colors: Any) -> None:
    """Compute the means of rows `begin` to `end`: depth, normal, grey, and colour; 0, 0, -1, -1 where nothing is.

    `colors`: (h, w, 3), or another shape if colour is not needed.
    """
    with_color = colors.shape[:2] == grey.shape
    for r in range(begin, end):
        for c in range(grey.shape[1]):
            depth_m[r, c] = near[r, c, _DEPTH] / near[r, c, _TOTAL] if near[r, c, _TOTAL] > 0 else _ZERO
            length2 = _ZERO
            for i in range(3):
                length2 += sums[r, c, i] * sums[r, c, i]
            scale = _ONE / np.sqrt(length2) if length2 > 0 else _ZERO
            for i in range(3):
                normal[r, c, i] = sums[r, c, i] * scale
            painted = sums[r, c, _PAINTED - _NORMAL]
            grey[r, c] = sums[r, c, _GREY - _NORMAL] / painted if painted > 0 else -_ONE
            if with_color:
                for i in range(3):
                    colors[r, c, i] = sums[r, c, _RED - _NORMAL + i] / painted if painted > 0 else -_ONE


@kernel
def add_distances(
    position: Any, normal: Any, confidence: Any, origin: Any, voxel_m: float, reach: int, distance: Any, weight: Any
) -> None:
    """Add to each voxel near surfels its distance to their planes, positive on the side of their normals.

    The mean of plane distances, weighted by nearness, is the implicit moving-least-squares surface of Kolluri 2008.

    Args:
        position, normal, confidence: (n, 3), (n, 3), (n,).
        origin: (3,) centre of voxel 0.
        reach: range of a surfel, voxels.
        distance, weight: (x, y, z) sums.
    """
    size = distance.shape
    inverse = 1.0 / (reach * voxel_m) ** 2
    for i in range(len(position)):
        p, n = position[i], normal[i]
        a = int(np.rint((p[0] - origin[0]) / voxel_m))
        b = int(np.rint((p[1] - origin[1]) / voxel_m))
        c = int(np.rint((p[2] - origin[2]) / voxel_m))
        for x in range(max(a - reach, 0), min(a + reach + 1, size[0])):
            for y in range(max(b - reach, 0), min(b + reach + 1, size[1])):
                for z in range(max(c - reach, 0), min(c + reach + 1, size[2])):
                    dx = origin[0] + x * voxel_m - p[0]
                    dy = origin[1] + y * voxel_m - p[1]
                    dz = origin[2] + z * voxel_m - p[2]
                    near = 1.0 - (dx * dx + dy * dy + dz * dz) * inverse
                    if near > 0:
                        share = near * near * confidence[i]
                        distance[x, y, z] += share * (dx * n[0] + dy * n[1] + dz * n[2])
                        weight[x, y, z] += share
