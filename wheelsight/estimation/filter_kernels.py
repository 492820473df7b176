"""Compiled prediction, correction and measurement models of a PoseBelief."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import FloatArray, IntArray
from wheelsight.core.geometry.motion_kernels import (
    adjoint,
    carried,
    chi_squared,
    exp,
    inverse,
    left_jacobian,
    log,
    sandwiched,
    times,
    times_transposed,
)

# Prediction and correction.
#
# T (1 + K, 4, 4), aux (17,) and P (n, n) are those of a `PoseBelief`. Loops over numbers: numba compiles them in a
# fraction of the time of expressions of arrays, and one form of a kernel where views would have several layouts.

_AUX_SIZE, _PLANE = 17, (0, 1, 5)


@kernel
def _block(P: FloatArray, row: int, column: int, rows: int, columns: int) -> FloatArray:
    block = np.empty((rows, columns))
    for i in range(rows):
        for j in range(columns):
            block[i, j] = P[row + i, column + j]
    return block


@kernel
def _set(P: FloatArray, row: int, column: int, block: FloatArray) -> None:
    for i in range(block.shape[0]):
        for j in range(block.shape[1]):
            P[row + i, column + j] = block[i, j]


@kernel
def _add(P: FloatArray, row: int, column: int, block: FloatArray) -> None:
    for i in range(block.shape[0]):
        for j in range(block.shape[1]):
            P[row + i, column + j] += block[i, j]


@kernel
def _in_plane(A: FloatArray, factor: float) -> FloatArray:
    """Return the columns (n, 3) of motion in the plane, times a factor."""
    columns = np.empty((len(A), 3))
    for i in range(len(A)):
        for j in range(3):
            columns[i, j] = A[i, _PLANE[j]] * factor
    return columns


@kernel
def _depend(P: FloatArray, errors: int, to_pose: FloatArray, to_twist: FloatArray) -> None:
    """Add the effect of the wheels' errors (3,) to the pose, by (6, 3), and set that on the twist, by (3, 3)."""
    old = _block(P, errors, 0, 3, len(P))
    _add(P, 0, 0, times(to_pose, old))
    _set(P, errors - 3, 0, times(to_twist, old))
    old = _block(P, 0, errors, len(P), 3)
    _add(P, 0, 0, times_transposed(old, to_pose))
    _set(P, 0, errors - 3, times_transposed(old, to_twist))


@kernel
def by_wheel_errors(raw: FloatArray, known_way: FloatArray) -> FloatArray:
    """Return the derivative (6, 3) of a step (6,) by the wheels' errors, at the motion (3,) by the known speed; or NaN.

    At its own motion, a step that is too long by chance would indicate a smaller scale, and the errors would tend to
    values that leave no motion at all.
    """
    by_errors = np.zeros((6, 3))
    ahead, left, turn = raw[0], raw[1], raw[5]
    if not np.isnan(known_way[0]):
        ahead, left, turn = known_way[0], known_way[1], known_way[2]
    by_errors[0, 0], by_errors[1, 0] = ahead, left
    by_errors[5, 1], by_errors[5, 2] = ahead, turn
    return by_errors


class StepPart(NamedTuple):
    """A share of a step of the wheels.

    Attributes:
        xi: (6,) the whole step.
        noise: (6, 6) covariance of its left perturbation.
        share: of the whole.
        dt_s: duration of the share.
        known_twist: (3,) as known before the step; NaN if unknown.
    """

    xi: FloatArray
    noise: FloatArray
    share: float
    dt_s: float
    known_twist: FloatArray


class UnmeasuredMotion(NamedTuple):
    """Noise of motion that wheels do not measure, and random walks of the errors.

    Attributes:
        unseen: (6, 6) covariance per metre of a point `lever_m` beside the base.
        walks: (14,) growth per metre of the variances of the errors; the last is of the gyroscope's bias, per second.
        fades: (14,) share of the errors that fades, likewise.
        lever_m: see above.
    """

    unseen: FloatArray
    walks: FloatArray
    fades: FloatArray
    lever_m: float


@kernel
def wheel_step(
    T: FloatArray, aux: FloatArray, P: FloatArray, step: StepPart, unseen: UnmeasuredMotion
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Return T, aux and P after a share of a step, its derivative (6, 3) by the wheels' errors, and its way.

    A part of a step has the twist of the whole, and the same uncertainty. Updates of the twist move the part alone.
    """
    T, aux, P, share, dt_s = T.copy(), aux.copy(), P.copy(), step.share, step.dt_s
    raw = step.xi * share
    way_m = unseen.lever_m * abs(raw[5]) + math.hypot(raw[0], raw[1])
    Q = step.noise * share + unseen.unseen * way_m
    by_errors = by_wheel_errors(raw, step.known_twist * dt_s)
    twist, errors = len(P) - _AUX_SIZE, len(P) - _AUX_SIZE + 3
    xi = raw.copy()
    for i in range(6):
        xi[i] += by_errors[i, 0] * aux[3] + by_errors[i, 1] * aux[4] + by_errors[i, 2] * aux[5]
    Ad, J, G, to_twist = adjoint(T[0]), left_jacobian(xi), np.empty((9, 6)), np.empty((3, 3))
    to_pose, by_step = times(times(Ad, J), by_errors), np.linalg.inv(J)
    _set(G, 0, 0, Ad)
    for i in range(3):
        for j in range(6):
            G[6 + i, j] = by_step[_PLANE[i], j] * (math.sqrt(share) / dt_s)
        for j in range(3):
            to_twist[i, j] = by_errors[_PLANE[i], j] / dt_s
    _depend(P, errors, to_pose, to_twist)
    grown = sandwiched(G, Q)
    for i in range(9):
        for j in range(9):
            shared = math.sqrt(share) if (i < 6) != (j < 6) else 1.0
            P[i if i < 6 else twist + i - 6, j if j < 6 else twist + j - 6] += grown[i, j] * shared
    _wander(aux, P, unseen, way_m, dt_s)
    _set(T[0], 0, 0, times(T[0], exp(xi)))
    aux[0], aux[1], aux[2] = xi[0] / dt_s, xi[1] / dt_s, xi[5] / dt_s
    return T, aux, P, to_pose, way_m


@kernel
def _wander(aux: FloatArray, P: FloatArray, unseen: UnmeasuredMotion, way_m: float, dt_s: float) -> None:
    """Apply random walk and fading of the errors of wheels, camera and gyroscope, over a way and a time."""
    errors = len(P) - _AUX_SIZE + 3
    for i in range(len(unseen.walks)):
        k, far = errors + i, way_m if errors + i < len(P) - 1 else dt_s
        kept = math.exp(-unseen.fades[i] * far)
        aux[3 + i] *= kept
        for j in range(len(P)):
            P[k, j] *= kept
        for j in range(len(P)):
            P[j, k] *= kept
        P[k, k] += unseen.walks[i] * far


@kernel
def odometer_kernel(
    T: FloatArray, C: FloatArray, xi: FloatArray, Q: FloatArray, share: float
) -> tuple[FloatArray, FloatArray]:
    """Return a motion (4, 4) and its covariance (6, 6) after a share of a step ξ (6,) with covariance Q (6, 6)."""
    return times(T, exp(xi * share)), C + carried(T, Q * share)


@kernel
def coast(
    T: FloatArray, aux: FloatArray, P: FloatArray, q: FloatArray, Q: FloatArray, dt_s: float, walk: float
) -> tuple[FloatArray, FloatArray]:
    """Return T and P at constant twist, with white noise of acceleration q (3,) and covariance Q (6, 6) of the step."""
    T, P = T.copy(), P.copy()
    n = len(P)
    twist, xi = n - _AUX_SIZE, np.zeros(6)
    xi[0], xi[1], xi[5] = aux[0] * dt_s, aux[1] * dt_s, aux[2] * dt_s
    Ad = adjoint(T[0])
    to_pose = _in_plane(times(Ad, left_jacobian(xi)), dt_s)
    _add(P, 0, 0, times(to_pose, _block(P, twist, 0, 3, n)))
    _add(P, 0, 0, times_transposed(_block(P, 0, twist, n, 3), to_pose))
    by_twist = _in_plane(Ad, 1.0)
    pushed = by_twist * q
    shaken, grown = times_transposed(pushed, by_twist), sandwiched(Ad, Q)
    for i in range(6):
        for j in range(6):
            P[i, j] += shaken[i, j] * (dt_s**3 / 3) + grown[i, j]
        for j in range(3):
            P[i, twist + j] += pushed[i, j] * (dt_s**2 / 2)
            P[twist + j, i] += pushed[i, j] * (dt_s**2 / 2)
    for i in range(3):
        P[twist + i, twist + i] += q[i] * dt_s
    P[n - 1, n - 1] += walk
    _set(T[0], 0, 0, times(T[0], exp(xi)))
    return T, P


@kernel
def answered(
    T: FloatArray, aux: FloatArray, P: FloatArray, clock_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return pose (4, 4), covariance (6, 6), twist (3,) and its covariance, for stamps with a σ of `clock_s`."""
    Ad, late, at = adjoint(T[0]), np.zeros((6, 1)), len(P) - _AUX_SIZE
    for i in range(6):
        for j in range(3):
            late[i, 0] += Ad[i, _PLANE[j]] * aux[j] * clock_s
    covariance = _block(P, 0, 0, 6, 6)
    _add(covariance, 0, 0, times_transposed(late, late))
    return T[0].copy(), covariance, aux[:3].copy(), _block(P, at, at, 3, 3)


@kernel
def correct(
    T: FloatArray, aux: FloatArray, P: FloatArray, PHt: FloatArray, S: FloatArray, residual: FloatArray, kept: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return T, aux and P after a Kalman update that leaves the numbers `kept` (k,) of the state as they are."""
    solved, gain = np.linalg.solve(S, PHt.T.copy()), np.empty(PHt.shape)
    less, x = np.empty(P.shape), np.zeros(len(P))
    for i in range(len(P)):
        for j in range(len(residual)):
            gain[i, j] = solved[j, i]
            x[i] += gain[i, j] * residual[j]
    lost = times_transposed(gain, PHt)
    for i in range(len(P)):
        for j in range(len(P)):  # rounding makes it asymmetric, and that would grow
            less[i, j] = (P[i, j] + P[j, i] - lost[i, j] - lost[j, i]) / 2
    for i in kept:
        x[i] = 0.0
        for j in kept:
            less[i, j] = P[i, j]
    T, aux = perturb(T, aux, x)
    return T, aux, less


@kernel
def perturb(T: FloatArray, aux: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return all poses perturbed, and `aux` shifted, by x (n,)."""
    moved = np.empty_like(T)
    for i in range(len(T)):
        _set(moved[i], 0, 0, times(exp(x[6 * i : 6 * i + 6]), T[i]))
    shifted = aux.copy()
    for i in range(len(aux)):
        shifted[i] += x[6 * len(T) + i]
    return moved, shifted


# Measurements of the camera.
#
# T (1 + K, 4, 4), aux (17,) and P (n, n) are those of a `PoseBelief`.

# Of `aux`: twist 3, the wheels' errors 3, the camera's 9, how late its stamps are, the gyroscope's bias.
_CAMERA, _LAG = 9, 15
_MOUNT = (0, 1, 3, 4, 5)  # on a floor, the height of the camera is unobservable
_UNSEEN_SIGMA_M = 10.0
_LEAST_TWIST = 1e-3  # m/s and rad/s: standing wheels have no noise


@kernel
def by_camera_errors(Z: FloatArray, by_wheels: FloatArray) -> FloatArray:
    """Return the derivative (6, 9) of a motion Z (4, 4) of the camera, as a left perturbation, by the camera's errors.

    These are the ratio by which distances are too short, the missing turn per metre, the ratio by which turns are too
    small, the missing pitch per metre, and the errors of the mount: position ahead and to the left on the base, which
    looks like a motion in turns, and rotation (3,). A pitch that grows along the way moves the end by half.

    The first three are as those of the wheels, with the same derivative `by_wheels` (6, 3). With different ones, errors
    that wheels and camera share, which are unobservable, would drift.
    """
    B, Ad = np.zeros((6, _CAMERA)), adjoint(Z)
    _set(B, 0, 0, by_wheels)
    for j in range(len(_MOUNT)):
        for i in range(6):
            B[i, 4 + j] = -Ad[i, _MOUNT[j]]
        B[_MOUNT[j], 4 + j] += 1.0
    way = math.sqrt(Z[0, 3] ** 2 + Z[1, 3] ** 2 + Z[2, 3] ** 2)
    B[0, 3], B[2, 3], B[4, 3] = -way * Z[2, 3] / 2, way * Z[0, 3] / 2, way
    return B


@kernel
def imaged_at(T_now: FloatArray, aux: FloatArray) -> FloatArray:
    """Return the pose (4, 4) when the image with the current stamp was taken; the camera's stamps are delayed."""
    xi = np.zeros(6)
    for i in range(3):
        xi[_PLANE[i]] = -aux[_LAG] * aux[i]
    return times(T_now, exp(xi))


@kernel
def imaged(P: FloatArray, T_imaged: FloatArray, lag_s: float, twist: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the covariance (6, n) of the pose of the image with the state, and its own (6, 6).

    Lag and twist are both uncertain; the second-order term of their product is part of its own covariance.
    """
    at, lag = len(P) - _AUX_SIZE, len(P) - _AUX_SIZE + _LAG
    G = _in_plane(adjoint(T_imaged), 1.0)
    by_lag, rows, spread = np.zeros(6), times(G, _block(P, at, 0, 3, len(P))), np.empty((6, 6))
    for i in range(6):
        for j in range(3):
            by_lag[i] += G[i, j] * twist[j]
        for j in range(len(P)):
            rows[i, j] = P[i, j] - lag_s * rows[i, j] - by_lag[i] * P[lag, j]
    by_twist, together = times_transposed(_block(rows, 0, at, 6, 3), G), _block(P, at, at, 3, 3)
    of_both = sandwiched(G, P[lag, lag] * together)
    for i in range(6):
        for j in range(6):
            spread[i, j] = rows[i, j] - lag_s * by_twist[i, j] - rows[i, lag] * by_lag[j] + of_both[i, j]
    return rows, spread


@kernel
def imaged_now(T_now: FloatArray, aux: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the pose (4, 4) when the current image was taken, and its covariances as of `imaged`."""
    T_imaged = imaged_at(T_now, aux)
    rows, spread = imaged(P, T_imaged, aux[_LAG], aux[:3].copy())
    return T_imaged, rows, spread


@kernel
def _apart(P: FloatArray, place: int, rows: FloatArray, spread: FloatArray) -> FloatArray:
    """Return the covariance (6, 6) of the pose of the image, as of `imaged`, minus the pose at a place."""
    apart = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            apart[i, j] = spread[i, j] - rows[i, place + j] - rows[j, place + i] + P[place + i, place + j]
    return apart


@kernel
def seen_from(
    T: FloatArray, aux: FloatArray, P: FloatArray, at: int, T_base_camera: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the camera's motion (4, 4) since the pose at an index, in its frame, and its covariance (6, 6)."""
    T_imaged, rows, spread = imaged_now(T[0], aux, P)
    T_camera_filter = inverse(times(T[at], T_base_camera))
    apart = _apart(P, 6 * at, rows, spread)
    return times(times(T_camera_filter, T_imaged), T_base_camera), carried(T_camera_filter, apart)


@kernel
def _change_of_twist(aux: FloatArray, P: FloatArray, before: FloatArray) -> float:
    """Return χ² of the change from an earlier twist (3,), by the wheels' noise in both, with a least noise."""
    at = len(P) - _AUX_SIZE
    noise = 2 * _block(P, at, at, 3, 3)
    for i in range(3):
        noise[i, i] += _LEAST_TWIST**2
    chi2: float = chi_squared(aux[:3] - before, noise)
    return chi2


@kernel
def expected(
    T_imaged: FloatArray, T_reference: FloatArray, by_wheels: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The motion (4, 4) between two poses, how the camera's errors change it (6, 9), and how perturbations do (6, 6).

    `by_wheels` (6, 3) is the derivative of the motion by the wheels' errors, as left perturbations in odom.
    """
    T_reference_odom = inverse(T_reference)
    Z, Ad = times(T_reference_odom, T_imaged), adjoint(T_reference_odom)
    return Z, by_camera_errors(Z, times(Ad, by_wheels)), Ad


@kernel
def residual_kernel(
    T_imaged: FloatArray, T_reference: FloatArray, by_wheels: FloatArray, Z: FloatArray, camera_errors: FloatArray
) -> FloatArray:
    """Return log(Z Ẑ⁻¹) (6,) of a motion Z (4, 4), corrected by the camera's errors (9,), and the predicted one."""
    Z_expected, B, _ = expected(T_imaged, T_reference, by_wheels)
    xi = log(times(Z, inverse(Z_expected)))
    for i in range(6):
        for j in range(_CAMERA):
            xi[i] += B[i, j] * camera_errors[j]
    return xi


class ReferencePoses(NamedTuple):
    """The current pose and a remembered one.

    Attributes:
        T_now, T_reference: (4, 4).
        by_wheel_errors: (6, 3) derivative of the motion by the wheels' errors, as left perturbations in odom.
        place: of the remembered pose in the covariance.
        twist_then: (3,) at that pose.
    """

    T_now: FloatArray
    T_reference: FloatArray
    by_wheel_errors: FloatArray
    place: int
    twist_then: FloatArray


class ObservedMotion(NamedTuple):
    """A motion Z (4, 4), its observed directions `seen` (m, 6), and their covariance R (m, m)."""

    Z: FloatArray
    seen: FloatArray
    R: FloatArray


@kernel
def measured(
    poses: ReferencePoses, aux: FloatArray, P: FloatArray, observed: ObservedMotion
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float, float]:
    """Return the innovation of a motion against a remembered pose.

    It is the residual (m,), its covariance S (m, m), its covariance with the state P Hᵀ (n, m), H (m, 6) of the current
    pose, the residual's χ², and that of the change of twist since then.
    """
    T_imaged, seen, R, place = imaged_at(poses.T_now, aux), observed.seen, observed.R, poses.place
    _, B, Ad = expected(T_imaged, poses.T_reference, poses.by_wheel_errors)
    H, by_errors = times(seen, Ad), times(seen, B)
    residual = _rows(
        seen, residual_kernel(T_imaged, poses.T_reference, poses.by_wheel_errors, observed.Z, aux[6 : 6 + _CAMERA])
    )
    twist = aux[:3].copy()
    PHt, S = _innovation(P, place, H, by_errors, R, T_imaged, aux[_LAG], twist)
    # The delay counts by the twist after this measurement. The wheels' noise is in their twist and in the residual, and
    # the product of both would bias each measurement alike.
    weighed = np.linalg.solve(S, residual)
    for i in range(3):
        for j in range(len(residual)):
            twist[i] += PHt[len(P) - _AUX_SIZE + i, j] * weighed[j]
    PHt, S = _innovation(P, place, H, by_errors, R, T_imaged, aux[_LAG], twist)
    return residual, S, PHt, H, chi_squared(residual, S), _change_of_twist(aux, P, poses.twist_then)


@kernel
def shown_kernel(
    R: FloatArray,
    seen: FloatArray,
    unseen: FloatArray,
    scale: FloatArray,
    to_camera: FloatArray,
    from_camera: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the covariance (m, m) of the observed directions `seen` (m, 6), scaled, for R (6, 6) of a camera's motion.

    Also these directions (m, 6) for the base's motion, and its covariance (6, 6), very large where it is `unseen`.
    """
    scaled = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            scaled[i, j] = (R[i, j] + R[j, i]) / 2 * (scale[i] * scale[j])
    covariance = sandwiched(seen, scaled)
    wide = sandwiched(seen.T.copy(), covariance) + _UNSEEN_SIGMA_M**2 * times(unseen.T.copy(), unseen)
    return covariance, times(seen, to_camera), sandwiched(from_camera, wide)


@kernel
def _rows(seen: FloatArray, xi: FloatArray) -> FloatArray:
    shown = np.zeros(seen.shape[0])
    for i in range(seen.shape[0]):
        for j in range(6):
            shown[i] += seen[i, j] * xi[j]
    return shown


@kernel
def _innovation(
    P: FloatArray,
    place: int,
    H: FloatArray,
    by_errors: FloatArray,
    R: FloatArray,
    T_imaged: FloatArray,
    lag_s: float,
    twist: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    n, errors = len(P), len(P) - _AUX_SIZE + 6
    rows, spread = imaged(P, T_imaged, lag_s, twist)
    S = sandwiched(H, _apart(P, place, rows, spread))
    for i in range(6):
        for j in range(n):
            rows[i, j] -= P[place + i, j]
    PHt, of_state = times_transposed(_block(P, 0, errors, n, _CAMERA), by_errors), times(H, rows)
    for i in range(n):
        for j in range(len(H)):
            PHt[i, j] = of_state[j, i] - PHt[i, j]
    crossed = times_transposed(times(H, _block(rows, 0, errors, 6, _CAMERA)), by_errors)
    of_errors = sandwiched(by_errors, _block(P, errors, errors, _CAMERA, _CAMERA))
    for i in range(len(H)):
        for j in range(len(H)):
            S[i, j] = S[i, j] - crossed[i, j] - crossed[j, i] + of_errors[i, j] + R[i, j]
    return PHt, S
