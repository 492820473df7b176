"""Compiled inner loops of feature odometry: depth at keypoints, RANSAC, refinement and Hamming distances."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import Float32Array, FloatArray, IntArray, UInt64Array
from wheelsight.core.geometry.hamming_kernels import hamming

# Compiled inner loops of feature odometry: depth at keypoints, RANSAC over closed-form alignment, refinement.


_FIXED_POINT_STEPS = 6
# From near to far: where a ray meets an object's edge and the wall behind, the object hides the wall.
_GUESSES_M = (0.6, 1.0, 1.7, 3.0)
_NEAREST_M = 0.1


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
    """Which three pairs make a hypothesis: sides of at least so many metres, alike to so much and a share of them."""

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
        if p[2] < _NEAREST_M:
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
        if z <= _NEAREST_M:
            continue
        u, v = fx * x / z + cx, fy * y / z + cy
        if 0 < u < width and 0 < v < height:
            px[i, 0], px[i, 1] = u, v
    return px


@kernel
def align_three(p_a: FloatArray, p_b: FloatArray) -> Any:
    """Rotation and translation that lay (3, 3) points b on points a: Zhang section 3.2, the reflection mended."""
    mean_a = (p_a[0] + p_a[1] + p_a[2]) / 3
    mean_b = (p_b[0] + p_b[1] + p_b[2]) / 3
    W = np.zeros((3, 3))
    for i in range(3):
        W += np.outer(p_a[i] - mean_a, p_b[i] - mean_b)
    U, _, Vt = np.linalg.svd(W)
    if np.linalg.det(U) * np.linalg.det(Vt) < 0:
        U[:, 2] = -U[:, 2]
    R = U @ Vt
    return R, mean_a - R @ mean_b


@kernel
def residuals_of(R: FloatArray, t: FloatArray, pairs: Pairs, out: FloatArray) -> Any:
    """Squared, normalised distance (N,) between points, moved, and what was seen of them; inf behind the camera."""
    p_reference, xy, depth_m, scale_xy, scale_m = pairs
    for i in range(len(p_reference)):
        x, y, z = p_reference[i]
        Z = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        if Z < _NEAREST_M:
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
    close together to tell a rotation, are not tried. Stops early once a better hypothesis is unlikely (at 99.9 %).
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
        if Z < _NEAREST_M:
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
