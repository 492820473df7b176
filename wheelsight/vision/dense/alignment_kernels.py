"""Compiled inner loops of dense alignment: residuals, normal equations, Gauss-Newton steps, rotation-only alignment,
and information that frame and reference share.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.vision.image_kernels import ALONG_U, ALONG_V, CHANNELS, DEPTH, GREY, NX, NY, NZ, OFFSET

if TYPE_CHECKING:
    from wheelsight.core.geometry.arrays import Float32Array, FloatArray


# Compiled inner loops of dense alignment: residuals, weights and normal equations, a row of partial sums each.
#
# A row is gone over in loops without branches, which the compiler does for many pixels at once; only the look-up in
# the reference goes pixel by pixel. What is inlined here takes its liberties with rounding from its caller.

# Columns of the partial sums of a row: of planes 21 of H's upper triangle and 6 of b, the same of grey, then these.
GREY_SUMS = 27
# Of each kind of residual: how many, the sum of |error| / σ, and of its weighted squares.
PLANE_COUNT, GREY_COUNT, PAIRS = 54, 57, 60
# Sums for the regression of exposure.
FIT_N, FIT_X, FIT_Y, FIT_XX, FIT_YY = 61, 62, 63, 64, 65
SUMS = 66

# What `how` holds, (10,) float32: gate in metres a metre of depth, scale of plane residuals, σ of grey, gain, offset,
# Huber's limit, weight of grey (0: depth alone), σ of the colour camera's place in pixels, the slope of grey a pixel
# below which it may be noise and shows nothing, and how much of a residual is taken for the frame's own noise.

# So many pixels side by side are done at once, by buffers whose size the compiler knows.
_STRETCH = 320
# Rows of the buffer of a stretch's moved points, and of the buffer of those of them that have a partner: point, depth
# and grey here, and the partner's channels.
_MX, _MY, _MZ, _MU, _MV, _MOVED = range(6)
_PX, _PY, _PZ, _HERE_Z, _HERE, _PARTNER, _PAIR = *range(6), 5 + CHANNELS
# Rows of the buffer in which residuals of one kind are collected.
_GX, _GY, _GZ, _J3, _J4, _J5, _ERROR, _ROOT, _LEVER, _RESIDUAL = range(10)


class Images(NamedTuple):
    """A level of a frame, and of the reference that it is aligned with.

    Attributes:
        depth_m, grey: (h, w) float32 of the frame; depth 0 and grey -1 where unknown.
        reference: (h, w, CHANNELS) float32.
        grid: (4,) fx, fy, cx, cy of both; float32, but for turns.
    """

    depth_m: Float32Array
    grey: Float32Array
    reference: Float32Array
    grid: Float32Array | FloatArray


@kernel(error_model="numpy", fastmath={"reassoc", "contract"})
def accumulate(images: Images, T_rows: Any, noise: Any, how: Any, stride: int, begin: int, end: int, sums: Any) -> None:
    """Normal equations of point-to-plane and photometric residuals over every `stride`th row of a frame.

    A point p of the frame goes to p' = T p in the reference frame and to the pixel there on which it falls. Its
    residuals are n·p' - d of the reference's plane at that pixel, and gain·I_reference + offset - I, both divided by
    their standard deviations. The tangent is (v, ω), from the left: ∂p'/∂ξ = [I, -[p']×] (Steinbrücker et al. 2011;
    Newcombe et al. 2011; Whelan et al. 2015, eqs. 3 to 7).

    Args:
        images: frame and reference.
        T_rows: (h, 3, 4) T_reference_frame of each row, which differ where a rolling shutter's speed is refined.
        noise: depth's constant and quadratic σ, near and far limit in metres.
        how: see above.
        begin, end: of the rows' numbers; number k is row k · stride.
        sums: (h // stride, SUMS) of float64, written row by row: the total does not depend on how rows are split.
    """
    depth_m, grey, reference, grid = images.depth_m, images.grey, images.reference, images.grid
    width = depth_m.shape[1]
    moved, pairs = np.empty((_MOVED, _STRETCH), np.float32), np.empty((_PAIR, _STRETCH), np.float32)
    residuals = np.empty((_RESIDUAL, _STRETCH), np.float32)
    x = ((np.arange(width) - grid[2]) / grid[0]).astype(np.float32)
    for k in range(begin, end):
        r = k * stride
        y, row = np.float32((r - grid[3]) / grid[1]), sums[k]
        row[:] = 0.0
        for first in range(0, width, _STRETCH):
            last = min(first + _STRETCH, width)
            here = depth_m[r, first:last]
            _move(here, x[first:last], y, T_rows[r], grid, moved)
            n = _pair(here, grey[r, first:last], reference, noise, moved, pairs)
            row[PAIRS] += n
            _meet_planes(pairs, n, noise, how, residuals)
            _weigh(pairs, residuals, n, how[5], row, PLANE_COUNT)
            _add(residuals, n, row[:GREY_SUMS])
            if how[6] > 0:
                _compare_grey(pairs, n, grid, how, residuals, row)
                _weigh(pairs, residuals, n, how[5], row, GREY_COUNT)
                _add(residuals, n, row[GREY_SUMS:])


@kernel(error_model="numpy", inline="always")
def _move(depth_m: Any, x: Any, y: Any, T: Any, grid: Any, moved: Any) -> None:
    """Points T p of a stretch of p = (x, y, 1)·z, and the pixels they fall on."""
    fx, fy, cx, cy = grid[0], grid[1], grid[2], grid[3]
    ax, bx, tx = T[0, 0], T[0, 1] * y + T[0, 2], T[0, 3]
    ay, by, ty = T[1, 0], T[1, 1] * y + T[1, 2], T[1, 3]
    az, bz, tz = T[2, 0], T[2, 1] * y + T[2, 2], T[2, 3]
    for c in range(len(x)):
        z = depth_m[c]
        px, py, pz = z * (ax * x[c] + bx) + tx, z * (ay * x[c] + by) + ty, z * (az * x[c] + bz) + tz
        moved[_MX, c], moved[_MY, c], moved[_MZ, c] = px, py, pz
        moved[_MU, c], moved[_MV, c] = fx * px / pz + cx, fy * py / pz + cy


@kernel(error_model="numpy", inline="always")
def _pair(depth_m: Any, grey: Any, reference: Any, noise: Any, moved: Any, pairs: Any) -> Any:
    """Collect the points that fall into the reference, each with the plane of the pixel it falls on and the grey there.

    Returns how many. No branches: which points do is known too late for the processor to guess.
    """
    one, half, near, far = np.float32(1), np.float32(0.5), noise[2], noise[3]
    last_u, last_v = np.float32(reference.shape[1] - 2), np.float32(reference.shape[0] - 2)
    n = 0
    for c in range(len(depth_m)):
        z, pz, u, v = depth_m[c], moved[_MZ, c], moved[_MU, c], moved[_MV, c]
        is_seen = (z >= near) & (z <= far) & (pz >= near) & (u >= one) & (u < last_u) & (v >= one) & (v < last_v)
        line, column = int(v + half) if is_seen else 0, int(u + half) if is_seen else 0
        pairs[_PX, n], pairs[_PY, n], pairs[_PZ, n] = moved[_MX, c], moved[_MY, c], pz
        pairs[_HERE_Z, n], pairs[_HERE, n] = z, grey[c]
        for k in range(GREY):
            pairs[_PARTNER + k, n] = reference[line, column, k]
        line, column = int(v) if is_seen else 0, int(u) if is_seen else 0
        s, t = u - np.float32(column), v - np.float32(line)
        for k in range(GREY, CHANNELS):
            above, below = reference[line, column, k], reference[line + 1, column, k]
            above += s * (reference[line, column + 1, k] - above)
            below += s * (reference[line + 1, column + 1, k] - below)
            pairs[_PARTNER + k, n] = above + t * (below - above)
        n += is_seen
    return n


@kernel(error_model="numpy", inline="always")
def _meet_planes(pairs: Any, n: int, noise: Any, how: Any, out: Any) -> None:
    """Gradients g = ∂error/∂p', errors and 1 / σ of n pairs as to the partners' planes; 0 where there is none.

    Both depths err along the ray; what counts of it is bounded where planes are grazed. How long a lever is, and how
    much a pair weighs, goes by where the point is once its own share of the error is taken off. By its noisy depth, all
    that are too far by chance would turn a frame more, and weigh less, than those that are too near.
    """
    zero, one, least = np.float32(0), np.float32(1), np.float32(0.04)
    constant, quadratic, gate, scale, own = noise[0], noise[1], how[0], how[1], how[9]
    for k in range(n):
        px, py, pz, z = pairs[_PX, k], pairs[_PY, k], pairs[_PZ, k], pairs[_HERE_Z, k]
        nx, ny, nz = pairs[_PARTNER + NX, k], pairs[_PARTNER + NY, k], pairs[_PARTNER + NZ, k]
        qz, along = pairs[_PARTNER + DEPTH, k], nx * px + ny * py + nz * pz
        error = along - pairs[_PARTNER + OFFSET, k]
        cosine2 = along * along / (px * px + py * py + pz * pz)
        cosine2 = cosine2 if cosine2 > least else least
        is_near = (abs(qz - pz) <= gate * (one + pz)) & (error == error)
        share = own * error / along
        lever = one - share if is_near & (abs(share) < gate) else one
        z, pz = lever * z, lever * pz
        here, there = constant + quadratic * z * z, constant + quadratic * pz * pz
        out[_GX, k], out[_GY, k], out[_GZ, k] = (
            nx if is_near else zero,
            ny if is_near else zero,
            nz if is_near else zero,
        )
        out[_ERROR, k], out[_LEVER, k] = error if is_near else zero, lever
        out[_ROOT, k] = one / (scale * np.sqrt((here * here + there * there) * cosine2)) if is_near else zero


@kernel(error_model="numpy", inline="always")
def _compare_grey(pairs: Any, n: int, grid: Any, how: Any, out: Any, row: Any) -> None:
    """Likewise of the grey values of n pairs; and sum up in the row what the regression of exposure needs."""
    zero, one = np.float32(0), np.float32(1)
    fx, fy, gate, sigma2, gain, offset = grid[0], grid[1], how[0], how[2] * how[2], how[3], how[4]
    limit, weight_of, misplaced2, least2 = how[5], how[6], how[7] * how[7], how[8] * how[8]
    s = sx = sy = sxx = syy = zero
    for k in range(n):
        px, py, pz, qz, here = pairs[_PX, k], pairs[_PY, k], pairs[_PZ, k], pairs[_PARTNER + DEPTH, k], pairs[_HERE, k]
        du, dv = pairs[_PARTNER + ALONG_U, k], pairs[_PARTNER + ALONG_V, k]
        there = pairs[_PARTNER + GREY, k]
        slope2 = du * du + dv * dv
        is_known = (abs(qz - pz) <= gate * (one + pz)) & (here >= zero) & (slope2 >= least2) & (there == there)
        there = there if is_known else zero
        gx, gy = gain * du * fx / pz if is_known else zero, gain * dv * fy / pz if is_known else zero
        error = gain * there + offset - here if is_known else zero
        root = weight_of / np.sqrt(sigma2 + misplaced2 * slope2) if is_known else zero
        out[_GX, k], out[_GY, k], out[_GZ, k] = gx, gy, -(gx * px + gy * py) / pz
        out[_ERROR, k], out[_ROOT, k], out[_LEVER, k] = error, root, one
        scaled = abs(error) * root
        weight = limit / (scaled if scaled > limit else limit) if is_known else zero
        s += weight
        sx += weight * there
        sy += weight * here
        sxx += weight * there * there
        syy += weight * here * here
    row[FIT_N] += s
    row[FIT_X] += sx
    row[FIT_Y] += sy
    row[FIT_XX] += sxx
    row[FIT_YY] += syy


@kernel(error_model="numpy", inline="always")
def _weigh(pairs: Any, residuals: Any, n: int, limit: Any, row: Any, place: int) -> None:
    """Turn n residuals into weighted Jacobians (g, p × g) and errors by Huber's weights; sum up in the row."""
    zero, one = np.float32(0), np.float32(1)
    count = total = squares = zero
    for k in range(n):
        lever, root = residuals[_LEVER, k], residuals[_ROOT, k]
        px, py, pz = lever * pairs[_PX, k], lever * pairs[_PY, k], lever * pairs[_PZ, k]
        scaled = abs(residuals[_ERROR, k]) * root
        weight = limit / (scaled if scaled > limit else limit)
        count += one if root > zero else zero
        total += scaled
        squares += weight * scaled * scaled
        root *= np.sqrt(weight)
        gx, gy, gz = root * residuals[_GX, k], root * residuals[_GY, k], root * residuals[_GZ, k]
        residuals[_GX, k], residuals[_GY, k], residuals[_GZ, k] = gx, gy, gz
        residuals[_J3, k], residuals[_J4, k] = py * gz - pz * gy, pz * gx - px * gz
        residuals[_J5, k], residuals[_ERROR, k] = px * gy - py * gx, root * residuals[_ERROR, k]
    row[place] += count
    row[place + 1] += total
    row[place + 2] += squares


@kernel(error_model="numpy", inline="always")
def _add(residuals: Any, n: int, row: Any) -> None:
    """Add the products of n Jacobians and errors to a row's sums: J is rows _GX to _J5."""
    at = 0
    for i in range(6):
        for j in range(i, 7):
            total = np.float32(0)
            for k in range(n):
                total += residuals[i, k] * residuals[j, k]
            if j < 6:
                row[at] += total
                at += 1
            else:
                row[21 + i] += total


# Compiled steps of Gauss–Newton: normal equations solved, the motion moved on, residual scales learned.

# Entries of `how`; see `accumulate`.
GATE, PLANE_SCALE, GREY_SIGMA, GAIN, STEP_OFFSET, HUBER, GREY_WEIGHT, COLOR_SIGMA, LEAST_SLOPE, OWN_NOISE = range(10)

# Mean absolute value of a standard normal variable.
MEAN_ABS = 0.7978845608028654
_PLANE_SCALES = (1.0, 4.0)
_GREY_SIGMAS = (3.0, 30.0)
_GAINS = (0.3, 3.0)
_FEWEST = 100


@kernel(error_model="numpy")
def advance(sums: Any, T: Any, how: Any, total: Any, T_held: Any, hold: Any) -> float:
    """One step: add up the rows' sums, move T (4, 4) in place, and adapt `how`. The largest part of the change.

    Args:
        sums: (rows, SUMS) as `accumulate` leaves them.
        T: (4, 4) T_reference_frame.
        how: as `accumulate` takes it; scales of residuals and exposure are learned from the residuals.
        total: (SUMS,) becomes the sum over rows.
        T_held, hold: where T is held (4, 4), and by how much information (6, 6) of its tangent.
    """
    total[:] = 0.0
    for r in range(sums.shape[0]):
        for k in range(SUMS):
            total[k] += sums[r, k]
    change = solve(total, hold, offset(T, T_held))
    move(change, T)
    _learn(total, how)
    return float(np.abs(change).max())


@kernel(error_model="numpy")
def offset(T: Any, T_held: Any) -> Any:
    """The tangent (6,) from T_held to T, to first order."""
    d, D = np.zeros(6), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            D[i, j] = T[i, 0] * T_held[j, 0] + T[i, 1] * T_held[j, 1] + T[i, 2] * T_held[j, 2]
    for i in range(3):
        d[i] = T[i, 3] - D[i, 0] * T_held[0, 3] - D[i, 1] * T_held[1, 3] - D[i, 2] * T_held[2, 3]
    d[3], d[4], d[5] = (D[2, 1] - D[1, 2]) / 2, (D[0, 2] - D[2, 0]) / 2, (D[1, 0] - D[0, 1]) / 2
    return d


@kernel(error_model="numpy")
def solve(total: Any, hold: Any, held: Any) -> Any:
    """-H⁻¹ b (6,) by Cholesky, with information `hold` (6, 6) that says to undo `held` (6,).

    H is damped so slightly that only directions no one saw feel it.
    """
    H, k, trace = np.empty((6, 6)), 0, 0.0
    x = -total[21:27] - total[GREY_SUMS + 21 : GREY_SUMS + 27]
    for i in range(6):
        for j in range(i, 6):
            H[i, j] = H[j, i] = total[k] + total[GREY_SUMS + k] + hold[i, j]
            k += 1
        for j in range(6):
            x[i] -= hold[i, j] * held[j]
        trace += H[i, i]
    for i in range(6):
        H[i, i] += 1e-9 * trace + 1e-12
    for i in range(6):
        for j in range(i):
            H[i, i] -= H[i, j] * H[i, j]
        H[i, i] = np.sqrt(max(H[i, i], 1e-12 * trace + 1e-300))
        for n in range(i + 1, 6):
            for j in range(i):
                H[n, i] -= H[n, j] * H[i, j]
            H[n, i] /= H[i, i]
    for i in range(6):
        for j in range(i):
            x[i] -= H[i, j] * x[j]
        x[i] /= H[i, i]
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            x[i] -= H[j, i] * x[j]
        x[i] /= H[i, i]
    return x


@kernel(error_model="numpy")
def move(change: Any, T: Any) -> None:
    """T ← exp(change) T, with change (v, ω)."""
    angle2 = change[3] ** 2 + change[4] ** 2 + change[5] ** 2
    angle = np.sqrt(angle2)
    if angle < 1e-4:
        a, b, d = 1 - angle2 / 6, 0.5 - angle2 / 24, 1 / 6 - angle2 / 120
    else:
        a, b, d = np.sin(angle) / angle, (1 - np.cos(angle)) / angle2, (angle - np.sin(angle)) / (angle2 * angle)
    W = np.zeros((3, 3))
    W[0, 1], W[0, 2], W[1, 2] = -change[5], change[4], -change[3]
    W[1, 0], W[2, 0], W[2, 1] = change[5], -change[4], change[3]
    WW = _product(W, W)
    R, V = np.eye(3) + a * W + b * WW, np.eye(3) + b * W + d * WW
    moved = np.empty((3, 4))
    for i in range(3):
        for j in range(4):
            moved[i, j] = R[i, 0] * T[0, j] + R[i, 1] * T[1, j] + R[i, 2] * T[2, j]
        moved[i, 3] += V[i, 0] * change[0] + V[i, 1] * change[1] + V[i, 2] * change[2]
    for i in range(3):
        for j in range(4):
            T[i, j] = moved[i, j]


@kernel(error_model="numpy")
def place_rows(T: Any, T_previous_reference: Any, seconds: float, twist: Any, late_s: Any, T_rows: Any) -> None:
    """T_reference_frame (h, 3, 4) of each row, whose points the twist they were straightened by may have misplaced.

    Args:
        T: (4, 4) T_reference_frame of the middle row.
        T_previous_reference: (4, 4) of the camera at the frame before, `seconds` ago.
        twist: (6,) by which the frame was straightened.
        late_s: (h,) how long after the middle row each row was read.
    """
    step = _product(T_previous_reference, T)
    turn, wrong, M = _turn(step), np.empty(6), np.zeros((4, 4))
    for i in range(3):
        M[i, 3] = wrong[i] = step[i, 3] / seconds - twist[i]
        wrong[3 + i] = turn[i] / seconds - twist[3 + i]
    M[0, 1], M[0, 2], M[1, 2] = -wrong[5], wrong[4], -wrong[3]
    M[1, 0], M[2, 0], M[2, 1] = wrong[5], -wrong[4], wrong[3]
    change = _product(T, M)
    for r in range(len(late_s)):
        for i in range(3):
            for j in range(4):
                T_rows[r, i, j] = T[i, j] + late_s[r] * change[i, j]


@kernel(error_model="numpy")
def _turn(T: Any) -> Any:
    """Rotation vector (3,) of T; half a turn comes out as nothing, which no camera makes between frames."""
    axis = np.array([T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]])
    sine = 0.5 * np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    angle = np.arctan2(sine, 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1))
    return axis * (0.5 if sine < 1e-9 else 0.5 * angle / sine)


@kernel(error_model="numpy")
def _product(A: Any, B: Any) -> Any:
    """A B of small square matrices, without a library's start-up."""
    n = A.shape[0]
    C = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            for k in range(n):
                C[i, j] += A[i, k] * B[k, j]
    return C


@kernel(error_model="numpy")
def _learn(total: Any, how: Any) -> None:
    """Learn from the residuals how large they are, and how the exposure has changed."""
    if total[PLANE_COUNT] > _FEWEST:
        scale = how[PLANE_SCALE] * total[PLANE_COUNT + 1] / total[PLANE_COUNT] / MEAN_ABS
        how[PLANE_SCALE] = min(max(scale, _PLANE_SCALES[0]), _PLANE_SCALES[1])
    if total[GREY_COUNT] <= _FEWEST or how[GREY_WEIGHT] <= 0:
        return
    ratio = total[GREY_COUNT + 1] / total[GREY_COUNT] / MEAN_ABS / how[GREY_WEIGHT]
    how[GREY_SIGMA] = min(max(how[GREY_SIGMA] * ratio, _GREY_SIGMAS[0]), _GREY_SIGMAS[1])
    moments = total[FIT_N], total[FIT_X], total[FIT_Y], total[FIT_XX], total[FIT_YY]
    how[GAIN], how[STEP_OFFSET] = fit_exposure(moments, how[GAIN])


@kernel(error_model="numpy")
def fit_exposure(moments: Any, gain: float) -> Any:
    """Gain and offset by which grey there becomes grey here: as bright, and as rich in contrast.

    Not by least squares: these find less gain the worse the images lie on each other, down to where none of the
    contrast is left that would bring them there. The gain stays as before if grey is all alike.

    `moments`: weighted sums of 1, there, here, there², here².
    """
    n, x, y, xx, yy = moments
    there, here = n * xx - x * x, n * yy - y * y
    if min(there, here) > 1e-3 * n * n:
        gain = min(max(np.sqrt(here / there), _GAINS[0]), _GAINS[1])
    return gain, (y - gain * x) / n


# Compiled Gauss–Newton of a turn and a change of exposure by grey values alone.

# Sums over pixels: H's upper triangle, b, how many and the sum of absolute errors, then the regression of exposure.
B, COUNT, ABSOLUTE, FIT, TURN_SUMS = 6, 9, 10, 11, 16
_STEPS, _SMALL_TURN = 8, 5e-4
# Huber's limit in grey levels of the reference, and the share of an image's pixels that must be seen in both.
_LIMIT, _LEAST_SHARE = 20.0, 0.3


@kernel(error_model="numpy")
def find_turn(images: Images, T: Any, exposure: Any) -> None:
    """Better rotation of T_reference_frame and exposure (gain, offset) in place; the best on the way is kept.

    The exposure is found before the first step: a step of it looks like any motion else.

    Args: as of `accumulate_turn`.
    """
    best, sums, tried = np.inf, np.empty(TURN_SUMS), T.copy()
    accumulate_turn(images, tried, exposure, np.inf, sums)
    _turn_learn(sums, exposure)
    for _ in range(_STEPS):
        accumulate_turn(images, tried, exposure, exposure[0] * _LIMIT, sums)
        if sums[COUNT] < _LEAST_SHARE * images.grey.size or sums[ABSOLUTE] / sums[COUNT] > best:
            return
        best = sums[ABSOLUTE] / sums[COUNT]
        for i in range(3):
            for j in range(4):
                T[i, j] = tried[i, j]
        change = _solve(sums)
        if np.abs(change).max() < _SMALL_TURN:
            return
        move(change, tried)
        for i in range(3):
            tried[i, 3] = T[i, 3]
        _turn_learn(sums, exposure)


@kernel(error_model="numpy")
def accumulate_turn(images: Images, T: Any, exposure: Any, limit: float, sums: Any) -> None:
    """Normal equations of a rotation on the spot, R ← exp(ω) R, by grey values alone (Whelan et al. 2015, IV.B).

    There the frame before is the reference, and images are turned as if all were far away. A keyframe may lie metres
    back: points are therefore placed by their depth and the expected way, and only those without depth far away.
    The error is gain·I_reference + offset - I.

    Args:
        images: frame and reference; their grid is float64.
        T: (4, 4) T_reference_frame.
        exposure: (2,) gain and offset.
        limit: Huber's limit in grey levels.
        sums: (TURN_SUMS,).
    """
    depth_m, grey, reference, grid = images.depth_m, images.grey, images.reference, images.grid
    height, width = grey.shape
    gain, offset = exposure[0], exposure[1]
    sums[:] = 0.0
    for r in range(height):
        for c in range(width):
            x, y = (c - grid[2]) / grid[0], (r - grid[3]) / grid[1]
            near = 1.0 / depth_m[r, c] if depth_m[r, c] > 0 else 0.0
            qx, qy, qz = _turned(T, x, y)
            px, py, pz = qx + near * T[0, 3], qy + near * T[1, 3], qz + near * T[2, 3]
            if pz < 0.1:
                continue
            u, v = grid[0] * px / pz + grid[2], grid[1] * py / pz + grid[3]
            if not (1 <= u < width - 2 and 1 <= v < height - 2):
                continue
            column, line = int(u + 0.5), int(v + 0.5)
            here, there = grey[r, c], reference[line, column, GREY]
            gx = gain * reference[line, column, ALONG_U] * grid[0] / pz
            gy = gain * reference[line, column, ALONG_V] * grid[1] / pz
            if here < 0 or np.isnan(there + gx + gy):
                continue
            error = gain * there + offset - here
            weight = 1.0 if abs(error) <= limit else limit / abs(error)
            _turn_add((qx, qy, qz), (gx, gy, -(gx * px + gy * py) / pz), error, weight, sums)
            _add_exposure(there, here, weight, sums)


@kernel(error_model="numpy", inline="always")
def _turned(T: Any, x: Any, y: Any) -> Any:
    """The ray (x, y, 1), turned."""
    qx = T[0, 0] * x + T[0, 1] * y + T[0, 2]
    qy = T[1, 0] * x + T[1, 1] * y + T[1, 2]
    qz = T[2, 0] * x + T[2, 1] * y + T[2, 2]
    return qx, qy, qz


@kernel(error_model="numpy", inline="always")
def _add_exposure(there: Any, here: Any, weight: Any, sums: Any) -> None:
    """One pixel's share in the regression of exposure."""
    sums[FIT] += weight
    sums[FIT + 1] += weight * there
    sums[FIT + 2] += weight * here
    sums[FIT + 3] += weight * there * there
    sums[FIT + 4] += weight * here * here


@kernel(error_model="numpy", inline="always")
def _turn_add(q: Any, g: Any, error: Any, weight: Any, sums: Any) -> None:
    """One pixel's share in the normal equations: J = q × g."""
    (qx, qy, qz), (gx, gy, gz) = q, g
    a, b, d = qy * gz - qz * gy, qz * gx - qx * gz, qx * gy - qy * gx
    sums[0] += weight * a * a
    sums[1] += weight * a * b
    sums[2] += weight * a * d
    sums[3] += weight * b * b
    sums[4] += weight * b * d
    sums[5] += weight * d * d
    sums[B] += weight * a * error
    sums[B + 1] += weight * b * error
    sums[B + 2] += weight * d * error
    sums[COUNT] += 1
    sums[ABSOLUTE] += abs(error)


@kernel(error_model="numpy")
def _turn_learn(sums: Any, exposure: Any) -> None:
    if sums[FIT] > 0:
        moments = sums[FIT], sums[FIT + 1], sums[FIT + 2], sums[FIT + 3], sums[FIT + 4]
        exposure[0], exposure[1] = fit_exposure(moments, exposure[0])


@kernel(error_model="numpy")
def _solve(sums: Any) -> Any:
    """-H⁻¹ b as a twist (0, ω) (6,), by cofactors; H is damped a little, for a plain wall shows no turn."""
    damping = 1e-6 * (sums[0] + sums[3] + sums[5]) + 1e-9
    a, b, c, d, e, f = sums[0] + damping, sums[1], sums[2], sums[3] + damping, sums[4], sums[5] + damping
    A, B_, C, D, E, F = d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b
    x, y, z = sums[B], sums[B + 1], sums[B + 2]
    det = a * A + b * B_ + c * C
    change = np.zeros(6)
    change[3] = -(A * x + B_ * y + C * z) / det
    change[4] = -(B_ * x + D * y + E * z) / det
    change[5] = -(C * x + E * y + F * z) / det
    return change


# Compiled inner loops of what frame and reference both show of a motion: products of the one's and the other's.
#
# A pixel shows a motion by its plane's normal and by its slope of grey. Both come with noise, which shows motions
# that nothing shows; but the noise of two images is independent, so that in products of one's Jacobians with the
# other's it averages out, as does what only one of both shows.

# Columns of the sums of a row: upper triangle of the information, and how many points fell into the reference.
POINTS = 21
SHOWN = 22
# Beyond them, of slopes alone: the upper triangle of what the reference's show by themselves.
COMPARED = SHOWN + 21
# What each entry of `how` is: gate in metres a metre of depth, scale of plane residuals, σ of grey, gain, Huber's
# limit, weight of grey, σ of the colour camera's place in pixels.
_GATE, _SCALE, _SIGMA, _GAIN, _HUBER, _WEIGHT, _MISPLACED = range(7)
_LEAST_COSINE2 = 0.04


class BothViews(NamedTuple):
    """What a frame and its reference show, at one level.

    Attributes:
        depth_m: (h, w) float32 of the frame, 0 where unknown.
        own, reference: (h, w, CHANNELS) float32 of the frame and of the reference.
        grid: (4,) fx, fy, cx, cy of both.
    """

    depth_m: Float32Array
    own: Float32Array
    reference: Float32Array
    grid: FloatArray


@kernel(error_model="numpy")
def show_planes(both: BothViews, T: Any, noise: Any, how: Any, begin: int, end: int, sums: Any) -> None:
    """What planes of rows `begin` to `end` tell in both views, of the tangent (v, ω) from the left of T.

    Args:
        both: frame and reference.
        T: (4, 4) T_reference_frame.
        noise: depth's constant and quadratic σ, near and far limit in metres.
        how: see above.
        sums: (h, SHOWN or more) float64, written row by row.
    """
    depth_m, own, reference, grid = both.depth_m, both.own, both.reference, both.grid
    here, there = np.empty(6), np.empty(6)
    for r in range(begin, end):
        sums[r] = 0.0
        for c in range(depth_m.shape[1]):
            is_seen, px, py, pz, z, u, v = _moved(depth_m, r, c, reference, grid, T, noise)
            if not is_seen:
                continue
            sums[r, POINTS] += 1
            line, column = int(v + 0.5), int(u + 0.5)
            qz, error = reference[line, column, DEPTH], -reference[line, column, OFFSET]
            nx, ny, nz = reference[line, column, NX], reference[line, column, NY], reference[line, column, NZ]
            error += nx * px + ny * py + nz * pz
            ox, oy, oz = own[r, c, NX], own[r, c, NY], own[r, c, NZ]
            is_known = error + own[r, c, OFFSET] == error + own[r, c, OFFSET]  # not NaN
            if not (is_known and abs(qz - pz) <= how[_GATE] * (1 + pz)):
                continue
            cosine2 = max((nx * px + ny * py + nz * pz) ** 2 / (px * px + py * py + pz * pz), _LEAST_COSINE2)
            sigma2 = (noise[0] + noise[1] * z * z) ** 2 + (noise[0] + noise[1] * qz * qz) ** 2
            root = 1 / (how[_SCALE] * np.sqrt(sigma2 * cosine2))
            weight = root * root * how[_HUBER] / max(abs(error) * root, how[_HUBER])
            _jacobian(px, py, pz, nx, ny, nz, there)
            _shown_turn(T, ox, oy, oz, px, py, pz, here)
            _shown_add(here, there, weight, sums[r])


@kernel(error_model="numpy")
def show_slopes(both: BothViews, T: Any, noise: Any, how: Any, begin: int, end: int, sums: Any) -> None:
    """What slopes of grey tell in both views, of every n-th row.

    Args: as of `show_planes`, but for
        begin, end: of the rows' numbers; number k is row k · n.
        sums: (h // n, COMPARED) float64, written row by row.
    """
    depth_m, own, reference, grid = both.depth_m, both.own, both.reference, both.grid
    here, there = np.empty(6), np.empty(6)
    fx, fy, gain, stride = grid[0], grid[1], how[_GAIN], depth_m.shape[0] // len(sums)
    for k in range(begin, end):
        r, row = k * stride, sums[k]
        row[:] = 0.0
        y = (r - grid[3]) / fy
        for c in range(depth_m.shape[1]):
            is_seen, px, py, pz, z, u, v = _moved(depth_m, r, c, reference, grid, T, noise)
            if not is_seen:
                continue
            row[POINTS] += 1
            qz = _between(reference, u, v, DEPTH)
            du, dv = _between(reference, u, v, ALONG_U), _between(reference, u, v, ALONG_V)
            eu, ev = own[r, c, ALONG_U], own[r, c, ALONG_V]
            total = du + dv + eu + ev + _between(reference, u, v, GREY)
            if not (abs(qz - pz) <= how[_GATE] * (1 + pz) and total == total):
                continue
            x, slope2 = (c - grid[2]) / fx, du * du + dv * dv
            weight = how[_WEIGHT] ** 2 / (how[_SIGMA] ** 2 + how[_MISPLACED] ** 2 * slope2)
            gx, gy = gain * du * fx / pz, gain * dv * fy / pz
            _jacobian(px, py, pz, gx, gy, -(gx * px + gy * py) / pz, there)
            hx, hy = eu * fx / z, ev * fy / z
            _shown_turn(T, hx, hy, -(hx * x + hy * y), px, py, pz, here)
            _shown_add(here, there, weight, row)
            _shown_add(there, there, weight, row[SHOWN:])


@kernel(error_model="numpy", inline="always")
def _moved(depth_m: Any, r: Any, c: Any, reference: Any, grid: Any, T: Any, noise: Any) -> Any:
    """Whether a pixel's point falls into the reference, the point there, its depth here, and the pixel there."""
    z, fx, fy = float(depth_m[r, c]), grid[0], grid[1]
    x, y = z * (c - grid[2]) / fx, z * (r - grid[3]) / fy
    px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    is_seen = noise[2] <= z <= noise[3] and pz >= noise[2]
    u, v = (fx * px / pz + grid[2], fy * py / pz + grid[3]) if is_seen else (0.0, 0.0)
    is_inside = 1 <= u < reference.shape[1] - 2 and 1 <= v < reference.shape[0] - 2
    return is_seen and is_inside, px, py, pz, z, u, v


@kernel(error_model="numpy", inline="always")
def _between(reference: Any, u: Any, v: Any, channel: int) -> Any:
    """A channel between four pixels."""
    line, column = int(v), int(u)
    s, t = u - column, v - line
    above = (1 - s) * reference[line, column, channel] + s * reference[line, column + 1, channel]
    below = (1 - s) * reference[line + 1, column, channel] + s * reference[line + 1, column + 1, channel]
    return (1 - t) * above + t * below


@kernel(error_model="numpy", inline="always")
def _shown_turn(T: Any, gx: Any, gy: Any, gz: Any, px: Any, py: Any, pz: Any, out: Any) -> None:
    """The Jacobian of a gradient in the frame at the point p in the reference."""
    ax = T[0, 0] * gx + T[0, 1] * gy + T[0, 2] * gz
    ay = T[1, 0] * gx + T[1, 1] * gy + T[1, 2] * gz
    az = T[2, 0] * gx + T[2, 1] * gy + T[2, 2] * gz
    _jacobian(px, py, pz, ax, ay, az, out)


@kernel(error_model="numpy", inline="always")
def _jacobian(px: Any, py: Any, pz: Any, gx: Any, gy: Any, gz: Any, out: Any) -> None:
    """(g, p × g): of g·p by the tangent from the left."""
    out[0], out[1], out[2] = gx, gy, gz
    out[3], out[4], out[5] = py * gz - pz * gy, pz * gx - px * gz, px * gy - py * gx


@kernel(error_model="numpy", inline="always")
def _shown_add(here: Any, there: Any, weight: Any, row: Any) -> None:
    """Add the symmetric part of a product of Jacobians to the upper triangle."""
    at, half = 0, 0.5 * weight
    for i in range(6):
        for j in range(i, 6):
            row[at] += half * (here[i] * there[j] + here[j] * there[i])
            at += 1


# The largest distance of one point from a plane, in standard deviations of depth; a point is on another surface beyond
# this distance per metre of depth. Chosen.
MOST_SIGMAS, _OTHER_SURFACE = 8.0, 0.03


@kernel(error_model="numpy")
def add_regions(depth_m: Any, reference: Any, grid: Any, T: Any, noise: Any, sums: Any) -> None:
    """Add up the distances of points from the reference's planes, by regions of the frame.

    Args:
        depth_m: (h, w) float32 of the frame, 0 where unknown.
        reference: (h, w, CHANNELS) float32.
        grid: (4,) fx, fy, cx, cy of both.
        T: (4, 4) T_reference_frame.
        noise: depth's constant and quadratic σ, and its near limit in metres.
        sums: (3, rows, columns) number of compared points, sum of their distances in σ, and in metres.
    """
    height, width = depth_m.shape
    rows, columns = sums.shape[1], sums.shape[2]
    for r in range(height):
        for c in range(width):
            z = float(depth_m[r, c])
            x, y = z * (c - grid[2]) / grid[0], z * (r - grid[3]) / grid[1]
            px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
            py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
            pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            if z == 0 or pz <= noise[2]:
                continue
            u, v = np.rint(grid[0] * px / pz + grid[2]), np.rint(grid[1] * py / pz + grid[3])
            if not (0 <= u < width and 0 <= v < height):
                continue
            plane = reference[int(v), int(u)]
            here, there = noise[0] + noise[1] * z * z, noise[0] + noise[1] * pz * pz
            sigma = np.sqrt(here * here + there * there)
            off = abs(plane[NX] * px + plane[NY] * py + plane[NZ] * pz - plane[OFFSET]) / sigma
            if abs(plane[DEPTH] - pz) > MOST_SIGMAS * sigma + _OTHER_SURFACE * pz:
                off = MOST_SIGMAS
            if np.isnan(off):
                continue
            off = min(off, MOST_SIGMAS)
            row, column = r * rows // height, c * columns // width
            sums[0, row, column] += 1
            sums[1, row, column] += off
            sums[2, row, column] += off * sigma
