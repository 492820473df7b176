"""One rigid motion's exp, log, adjoint and left Jacobian, and the steps of a PoseBelief; numba over arrays and numbers.

`geometry.se3` has the first four for batches of motions; one motion takes it a hundred times as long.
The steps change the arrays they are given: T (1 + K, 4, 4), rest (15,) and P (n, n), as `_pose_belief` lays them out.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from wheelsight.geometry import FloatArray

_MOST_TERMS = 40
_REST, _CAMERA = 15, 8  # twist 3, the wheels' errors 3, the camera's 8, the gyroscope's bias
_PLANE = (0, 1, 5)


@njit(cache=True, nogil=True)
def times(A: FloatArray, B: FloatArray) -> FloatArray:
    """The product of small matrices of any layout."""
    C = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            for j in range(B.shape[1]):
                C[i, j] += A[i, k] * B[k, j]
    return C


@njit(cache=True, nogil=True)
def _hat(x: float, y: float, z: float) -> FloatArray:
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@njit(cache=True, nogil=True)
def _square(W: FloatArray, i: int, j: int) -> float:
    """Entry of W @ W for W (3, 3)."""
    entry: float = W[i, 0] * W[0, j] + W[i, 1] * W[1, j] + W[i, 2] * W[2, j]
    return entry


@njit(cache=True, nogil=True)
def exp(xi: FloatArray) -> FloatArray:
    """T (4, 4) of a tangent (6,), (v, ω)."""
    W = _hat(xi[3], xi[4], xi[5])
    angle = math.sqrt(xi[3] ** 2 + xi[4] ** 2 + xi[5] ** 2)
    a, b, c = 1 - angle**2 / 6, 0.5 - angle**2 / 24, 1 / 6 - angle**2 / 120
    if angle > 1e-3:
        half = math.sin(angle / 2) / angle
        a, b, c = math.sin(angle) / angle, 2 * half**2, (angle - math.sin(angle)) / angle**3
    T = np.eye(4)
    for i in range(3):
        for j in range(3):
            W2 = _square(W, i, j)
            T[i, j] += a * W[i, j] + b * W2
            T[i, 3] += (b * W[i, j] + c * W2 + (1.0 if i == j else 0.0)) * xi[j]
    return T


@njit(cache=True, nogil=True)
def log(T: FloatArray) -> FloatArray:
    """Tangent (6,) of T (4, 4); the angle is at most π."""
    x, y, z, w = _quaternion(T)
    sine = math.sqrt(x * x + y * y + z * z)
    angle = 2 * math.atan2(sine, w)
    scale = angle / sine if sine > 1e-12 else 2.0
    xi = np.zeros(6)
    xi[3], xi[4], xi[5] = scale * x, scale * y, scale * z
    W = _hat(xi[3], xi[4], xi[5])
    b = 1 / 12 + angle**2 / 720
    if angle > 1e-2:
        b = (1 - angle / 2 / math.tan(angle / 2)) / angle**2 if angle < math.pi else 1 / math.pi**2
    for i in range(3):
        for j in range(3):
            xi[i] += ((1.0 if i == j else 0.0) - 0.5 * W[i, j] + b * _square(W, i, j)) * T[j, 3]
    return xi


@njit(cache=True, nogil=True)
def _quaternion(T: FloatArray) -> tuple[float, float, float, float]:
    """x, y, z, w with w ≥ 0 of the rotation of T, from its largest part (Shepperd 1978)."""
    trace = T[0, 0] + T[1, 1] + T[2, 2]
    if trace > max(T[0, 0], T[1, 1], T[2, 2]):
        q = np.array([T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1], 1 + trace])
    elif T[0, 0] >= T[1, 1] and T[0, 0] >= T[2, 2]:
        q = np.array([1 + 2 * T[0, 0] - trace, T[0, 1] + T[1, 0], T[0, 2] + T[2, 0], T[2, 1] - T[1, 2]])
    elif T[1, 1] >= T[2, 2]:
        q = np.array([T[0, 1] + T[1, 0], 1 + 2 * T[1, 1] - trace, T[1, 2] + T[2, 1], T[0, 2] - T[2, 0]])
    else:
        q = np.array([T[0, 2] + T[2, 0], T[1, 2] + T[2, 1], 1 + 2 * T[2, 2] - trace, T[1, 0] - T[0, 1]])
    q /= math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2) * (1.0 if q[3] >= 0 else -1.0)
    return q[0], q[1], q[2], q[3]


@njit(cache=True, nogil=True)
def adjoint(T: FloatArray) -> FloatArray:
    """Ad (6, 6) of T (4, 4)."""
    Ad = np.zeros((6, 6))
    W = _hat(T[0, 3], T[1, 3], T[2, 3])
    for i in range(3):
        for j in range(3):
            Ad[i, j] = Ad[i + 3, j + 3] = T[i, j]
            Ad[i, j + 3] = W[i, 0] * T[0, j] + W[i, 1] * T[1, j] + W[i, 2] * T[2, j]
    return Ad


@njit(cache=True, nogil=True)
def inverse_adjoint(T: FloatArray) -> FloatArray:
    """Ad (6, 6) of the inverse of T (4, 4)."""
    return adjoint(inverse(T))


@njit(cache=True, nogil=True)
def is_motion(T: FloatArray) -> bool:
    """Whether T (4, 4) is a rigid motion, and finite."""
    if not np.isfinite(T).all():
        return False
    worst = max(abs(T[3, 0]), abs(T[3, 1]), abs(T[3, 2]), abs(T[3, 3] - 1))
    turned = 0.0  # the determinant
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        turned += T[0, i] * (T[1, j] * T[2, k] - T[1, k] * T[2, j])
    for i in range(3):
        for j in range(3):
            product = T[i, 0] * T[j, 0] + T[i, 1] * T[j, 1] + T[i, 2] * T[j, 2]
            worst = max(worst, abs(product - (1.0 if i == j else 0.0)))
    return worst < 1e-6 and turned > 0


@njit(cache=True, nogil=True)
def is_covariance(C: FloatArray) -> bool:
    """Whether C (n, n) is finite, symmetric, and has no negative eigenvalue, to rounding."""
    if not np.isfinite(C).all():
        return False
    most = np.abs(C).max()
    least: float = np.linalg.eigvalsh((C + C.T) / 2)[0]
    is_symmetric: bool = np.abs(C - C.T).max() <= 1e-6 * most
    return is_symmetric and least >= -1e-9 * most


@njit(cache=True, nogil=True)
def chi_squared(residual: FloatArray, S: FloatArray) -> float:
    """rᵀ S⁻¹ r of a residual (m,) with its covariance (m, m)."""
    weighed = np.linalg.solve(S, residual)
    chi2 = 0.0
    for i in range(len(residual)):
        chi2 += residual[i] * weighed[i]
    return chi2


@njit(cache=True, nogil=True)
def step_between(
    T_before: FloatArray, C_before: FloatArray, T_now: FloatArray, C_now: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """ξ (6,) from one pose to the next, and what their covariances (6, 6) grew by, in the frame before."""
    T_before_odom = inverse(T_before)
    Ad = adjoint(T_before_odom)
    grown = times(times(Ad, C_now - C_before), Ad.T)
    strength, axes = np.linalg.eigh((grown + grown.T) / 2)
    return log(times(T_before_odom, T_now)), times(axes * np.maximum(strength, 0.0), axes.T)


@njit(cache=True, nogil=True)
def left_jacobian(xi: FloatArray) -> FloatArray:
    """J (6, 6) with exp(ξ + δ) ≈ exp(J δ) exp(ξ): the series of ad(ξ)ⁿ / (n + 1)!, which converges for every ξ."""
    ad = np.zeros((6, 6))
    ad[:3, :3] = _hat(xi[3], xi[4], xi[5])
    ad[3:, 3:] = ad[:3, :3]
    ad[:3, 3:] = _hat(xi[0], xi[1], xi[2])
    J, term = np.eye(6), np.eye(6)
    for n in range(1, _MOST_TERMS):
        term = times(term, ad) / (n + 1)
        J += term
        if np.abs(term).max() < 1e-15:
            break
    return J


@njit(cache=True, nogil=True)
def _depend(P: FloatArray, errors: int, to_pose: FloatArray, to_twist: FloatArray) -> None:
    """Add to the pose, and put in the twist's place, what the wheels' errors (3,) do to it: (6, 3) and (3, 3)."""
    twist = errors - 3
    old = P[errors : errors + 3].copy()
    P[:6] += times(to_pose, old)
    P[twist:errors] = times(to_twist, old)
    old = P[:, errors : errors + 3].copy()
    P[:, :6] += times(old, to_pose.T)
    P[:, twist:errors] = times(old, to_twist.T)


@njit(cache=True, nogil=True)
def roll(
    T: FloatArray,
    rest: FloatArray,
    P: FloatArray,
    raw: FloatArray,
    by_errors: FloatArray,
    Q: FloatArray,
    dt_s: float,
    share: float,
    walks: FloatArray,
) -> FloatArray:
    """A step ξ (6,) of the wheels, which changes by `by_errors` (6, 3), with noise Q (6, 6) of its left perturbation.

    `walks` (12,) is added to the variances of the errors of wheels and camera and the gyroscope's bias. A part of a
    step, `share` below 1, has the twist of the whole, and is as uncertain of it.

    Returns (6, 3) how the errors move the pose by this step, as a left perturbation.
    """
    n = len(P)
    twist, errors = n - _REST, n - _REST + 3
    xi = raw.copy()
    for i in range(6):
        for j in range(3):
            xi[i] += by_errors[i, j] * rest[3 + j]
    Ad, J = adjoint(T[0]), left_jacobian(xi)
    to_pose, to_twist = times(times(Ad, J), by_errors), by_errors[np.array([0, 1, 5])] / dt_s
    _depend(P, errors, to_pose, to_twist)
    G = np.zeros((9, 6))
    G[:6] = Ad
    G[6:] = np.linalg.inv(J)[np.array([0, 1, 5])] * (math.sqrt(share) / dt_s)
    grown = times(times(G, Q), G.T)
    P[:6, :6] += grown[:6, :6]
    P[:6, twist:errors] += grown[:6, 6:]
    P[twist:errors, :6] += grown[6:, :6]
    P[twist:errors, twist:errors] += grown[6:, 6:]
    for i in range(len(walks)):
        P[errors + i, errors + i] += walks[i]
    T[0] = times(T[0], exp(xi))
    rest[0], rest[1], rest[2] = xi[0] / dt_s, xi[1] / dt_s, xi[5] / dt_s
    return to_pose


@njit(cache=True, nogil=True)
def ride_on(T: FloatArray, C: FloatArray, xi: FloatArray, Q: FloatArray, share: float) -> tuple[FloatArray, FloatArray]:
    """A motion (4, 4) and its covariance (6, 6) after a share of a step ξ (6,) with covariance Q (6, 6)."""
    Ad = adjoint(T)
    return times(T, exp(xi * share)), C + times(times(Ad, Q * share), Ad.T)


@njit(cache=True, nogil=True)
def glide(
    T: FloatArray, rest: FloatArray, P: FloatArray, q: FloatArray, Q: FloatArray, dt_s: float, walk: float
) -> None:
    """The twist goes on for a time, with white noise of acceleration q (3,) and noise Q (6, 6) of the step besides."""
    n = len(P)
    twist, errors = n - _REST, n - _REST + 3
    xi = np.zeros(6)
    xi[0], xi[1], xi[5] = rest[0] * dt_s, rest[1] * dt_s, rest[2] * dt_s
    Ad = adjoint(T[0])
    plane = np.array([0, 1, 5])
    to_pose = times(Ad, left_jacobian(xi)[:, plane]) * dt_s
    P[:6] += times(to_pose, P[twist:errors].copy())
    P[:, :6] += times(P[:, twist:errors].copy(), to_pose.T)
    pushed = Ad[:, plane] * q
    P[:6, :6] += times(pushed, Ad[:, plane].T) * (dt_s**3 / 3) + times(times(Ad, Q), Ad.T)
    P[:6, twist:errors] += pushed * (dt_s**2 / 2)
    P[twist:errors, :6] += pushed.T * (dt_s**2 / 2)
    for i in range(3):
        P[twist + i, twist + i] += q[i] * dt_s
    P[n - 1, n - 1] += walk
    T[0] = times(T[0], exp(xi))


@njit(cache=True, nogil=True)
def inverse(T: FloatArray) -> FloatArray:
    """T_b_a (4, 4) of T_a_b (4, 4)."""
    back = np.eye(4)
    for i in range(3):
        for j in range(3):
            back[i, j] = T[j, i]
            back[i, 3] -= T[j, i] * T[j, 3]
    return back


@njit(cache=True, nogil=True)
def by_camera_errors(Z: FloatArray, told: FloatArray, twists: FloatArray) -> FloatArray:
    """How a motion Z (4, 4) that the camera saw changes, as a left perturbation, with the camera's errors (6, 8).

    They are the ratio by which its ways are too short, the turn a metre that it misses, the ratio by which its turns
    are too small, the pitch a metre that it misses, by what rotation (3,) of the base it is mounted otherwise: what it
    takes for ahead may be aside or up; and by how many seconds its stamps are late, of a base that moved by `twists`
    (2, 3) at the begin and the end (Li & Mourikis, IJRR 2014). A pitch that grows along the way moves the end by half.

    The first three are as those of the wheels, so they change it as these do, which is what `told` (6, 3) says. Told
    from each other by how steps are reckoned, and not by the drive, they would drift: what both err by alike nobody
    sees, so nothing would ever mend it.
    """
    B, Ad = np.zeros((6, _CAMERA)), adjoint(Z)
    B[:, :3], B[:, 4:7] = told, -Ad[:, 3:]
    for i in range(3):
        B[3 + i, 4 + i] += 1.0
        B[_PLANE[i], 7] -= twists[0, i]
        B[:, 7] += Ad[:, _PLANE[i]] * twists[1, i]
    way = math.sqrt(Z[0, 3] ** 2 + Z[1, 3] ** 2 + Z[2, 3] ** 2)
    B[0, 3], B[2, 3], B[4, 3] = -way * Z[2, 3] / 2, way * Z[0, 3] / 2, way
    return B


@njit(cache=True, nogil=True)
def expected(
    T_now: FloatArray, T_reference: FloatArray, told: FloatArray, twists: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The motion (4, 4) between two poses, how the camera's errors change it (6, 8), and how perturbations do (6, 6).

    `told` (6, 3) is how the wheels' errors moved the pose now since the other, as left perturbations in the world;
    `twists` (2, 3) are the other's and that of now.
    """
    T_reference_world = inverse(T_reference)
    Z, Ad = times(T_reference_world, T_now), adjoint(T_reference_world)
    return Z, by_camera_errors(Z, times(Ad, told), twists), Ad


@njit(cache=True, nogil=True)
def apart(
    T_now: FloatArray,
    T_reference: FloatArray,
    told: FloatArray,
    twists: FloatArray,
    Z: FloatArray,
    camera_errors: FloatArray,
) -> FloatArray:
    """log(Z Ẑ⁻¹) (6,) of a motion Z (4, 4), mended by the camera's errors (8,), and the one that two poses tell."""
    Z_expected, B, _ = expected(T_now, T_reference, told, twists)
    xi = log(times(Z, inverse(Z_expected)))
    for i in range(6):
        for j in range(_CAMERA):
            xi[i] += B[i, j] * camera_errors[j]
    return xi


@njit(cache=True, nogil=True)
def look(
    rest: FloatArray,
    P: FloatArray,
    place: int,
    T_now: FloatArray,
    T_reference: FloatArray,
    told: FloatArray,
    twists: FloatArray,
    Z: FloatArray,
    seen: FloatArray,
    R: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """What a motion Z (4, 4) says of directions `seen` (m, 6), with noise R (m, m), against the pose at `place`.

    Returns the residual (m,), its covariance S (m, m), that with the state P Hᵀ (n, m), and H (m, 6) of the pose now.
    """
    _, B, Ad = expected(T_now, T_reference, told, twists)
    H, camera = times(seen, Ad), len(P) - _REST + 6
    errors = rest[6 : 6 + _CAMERA]
    residual = _shown(seen, apart(T_now, T_reference, told, twists, Z, errors))
    by_poses = times(P[:, :6] - P[:, place : place + 6], H.T)
    PHt, S = _with_errors(by_poses, P, place, camera, H, times(seen, B), R)
    # What is late counts by the twist as this look tells it: the wheels' noise is in theirs and in the residual, and
    # their product would go one way at every look.
    told_twist = twists.copy()
    weighed = np.linalg.solve(S, residual)
    for i in range(3):
        for j in range(len(residual)):
            told_twist[1, i] += PHt[len(P) - _REST + i, j] * weighed[j]
    B = by_camera_errors(Z, B[:, :3].copy(), told_twist)
    PHt, S = _with_errors(by_poses, P, place, camera, H, times(seen, B), R)
    return _shown(seen, apart(T_now, T_reference, told, told_twist, Z, errors)), S, PHt, H


@njit(cache=True, nogil=True)
def _shown(seen: FloatArray, xi: FloatArray) -> FloatArray:
    shown = np.zeros(seen.shape[0])
    for i in range(seen.shape[0]):
        for j in range(6):
            shown[i] += seen[i, j] * xi[j]
    return shown


@njit(cache=True, nogil=True)
def _with_errors(
    by_poses: FloatArray, P: FloatArray, place: int, camera: int, H: FloatArray, by_errors: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray]:
    PHt = by_poses - times(P[:, camera : camera + _CAMERA], by_errors.T)
    HPHt = times(H, PHt[:6] - PHt[place : place + 6]) - times(by_errors, PHt[camera : camera + _CAMERA])
    return PHt, HPHt + R


@njit(cache=True, nogil=True)
def correct(
    T: FloatArray, rest: FloatArray, P: FloatArray, PHt: FloatArray, S: FloatArray, residual: FloatArray
) -> None:
    """The Kalman update."""
    gain: FloatArray = np.linalg.solve(S, np.ascontiguousarray(PHt.T)).T.astype(np.float64)
    lost = times(gain, PHt.T)
    for i in range(len(P)):
        for j in range(i + 1):
            P[i, j] -= (lost[i, j] + lost[j, i]) / 2
            P[j, i] = P[i, j]
    x = np.zeros(len(P))
    for i in range(len(P)):
        for j in range(len(residual)):
            x[i] += gain[i, j] * residual[j]
    perturb(T, rest, x)


@njit(cache=True, nogil=True)
def perturb(T: FloatArray, rest: FloatArray, x: FloatArray) -> None:
    """Perturb all poses, and shift the rest, by x (n,)."""
    for i in range(len(T)):
        T[i] = times(exp(x[6 * i : 6 * i + 6]), T[i])
    for i in range(len(rest)):
        rest[i] += x[6 * len(T) + i]
