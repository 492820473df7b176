"""What the camera says of a PoseBelief; numba over arrays and numbers.

T (1 + K, 4, 4), rest (17,) and P (n, n) are as `_pose_belief` lays them out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import FloatArray
from wheelsight.geometry.motion_kernels import adjoint, carried, chi_squared, exp, inverse, log, times

# Of `rest`: twist 3, the wheels' errors 3, the camera's 9, how late its stamps are, the gyroscope's bias.
_REST, _CAMERA, _LAG = 17, 9, 15
_PLANE = (0, 1, 5)
_MOUNT = (0, 1, 3, 4, 5)  # on a floor nothing tells how high a camera sits
_UNSEEN_SIGMA_M = 10.0
_LEAST_TWIST = 1e-3  # m/s and rad/s: wheels that stand still tell no noise at all


@kernel
def by_camera_errors(Z: FloatArray, told: FloatArray) -> FloatArray:
    """How a motion Z (4, 4) that the camera saw changes, as a left perturbation, with the camera's errors (6, 9).

    They are the ratio by which its ways are too short, the turn a metre that it misses, the ratio by which its turns
    are too small, the pitch a metre that it misses, and how it is mounted otherwise: so far ahead and to the left on
    the base, which in turns it takes for a way, and by what rotation (3,), so that what it takes for ahead may be aside
    or up. A pitch that grows along the way moves the end by half.

    The first three are as those of the wheels, so they change it as these do, which is what `told` (6, 3) says. Told
    from each other by how steps are reckoned, and not by the drive, they would drift: what both err by alike nobody
    sees, so nothing would ever mend it.
    """
    B = np.zeros((6, _CAMERA))
    B[:, :3], Ad = told, adjoint(Z)
    for i in range(len(_MOUNT)):
        B[:, 4 + i] = -Ad[:, _MOUNT[i]]
        B[_MOUNT[i], 4 + i] += 1.0
    way = math.sqrt(Z[0, 3] ** 2 + Z[1, 3] ** 2 + Z[2, 3] ** 2)
    B[0, 3], B[2, 3], B[4, 3] = -way * Z[2, 3] / 2, way * Z[0, 3] / 2, way
    return B


@kernel
def imaged_at(T_now: FloatArray, rest: FloatArray) -> FloatArray:
    """The pose (4, 4) when the image was taken that has the stamp of now: the camera's stamps are late."""
    xi = np.zeros(6)
    for i in range(3):
        xi[_PLANE[i]] = -rest[_LAG] * rest[i]
    return times(T_now, exp(xi))


@kernel
def imaged(P: FloatArray, T_imaged: FloatArray, lag_s: float, twist: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance (6, n) of the pose when the image was taken with the state, and its own (6, 6).

    Lag and twist are both uncertain; what they do together, which no first order shows, is added to its own.
    """
    rest = len(P) - _REST
    G = np.zeros((6, 3))
    Ad = adjoint(T_imaged)
    for j in range(3):
        G[:, j] = Ad[:, _PLANE[j]]
    by_lag = times(G, twist.reshape(3, 1))
    rows = P[:6] - lag_s * times(G, P[rest : rest + 3]) - by_lag * P[rest + _LAG]
    spread = (
        rows[:, :6]
        - lag_s * times(rows[:, rest : rest + 3], G.T)
        - rows[:, rest + _LAG].copy().reshape(6, 1) * by_lag.T
    )
    together = P[rest + _LAG, rest + _LAG] * P[rest : rest + 3, rest : rest + 3]
    return rows, spread + times(times(G, together), G.T)


@kernel
def imaged_now(T_now: FloatArray, rest: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The pose (4, 4) when the image of now was taken, and its covariances as `imaged` has them."""
    T_imaged = imaged_at(T_now, rest)
    rows, spread = imaged(P, T_imaged, rest[_LAG], rest[:3].copy())
    return T_imaged, rows, spread


@kernel
def seen_from(
    T: FloatArray, rest: FloatArray, P: FloatArray, at: int, T_base_camera: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The camera's motion (4, 4) since the pose at a place, in that one's frame, and its covariance (6, 6)."""
    here = slice(6 * at, 6 * at + 6)
    T_imaged, rows, spread = imaged_now(T[0], rest, P)
    T_camera_odom = inverse(times(T[at], T_base_camera))
    apart = spread - rows[:, here] - rows[:, here].T + P[here, here]
    return times(times(T_camera_odom, T_imaged), T_base_camera), carried(T_camera_odom, apart)


@kernel
def _change_of_twist(rest: FloatArray, P: FloatArray, before: FloatArray) -> float:
    """χ² of the change from a twist (3,) before, by the noise that both have of the wheels, and never less than so."""
    at = len(P) - _REST
    noise = 2 * P[at : at + 3, at : at + 3]
    for i in range(3):
        noise[i, i] += _LEAST_TWIST**2
    chi2: float = chi_squared(rest[:3] - before, noise)
    return chi2


@kernel
def expected(
    T_imaged: FloatArray, T_reference: FloatArray, told: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The motion (4, 4) between two poses, how the camera's errors change it (6, 9), and how perturbations do (6, 6).

    `told` (6, 3) is how the wheels' errors moved the one since the other, as left perturbations in odom.
    """
    T_reference_odom = inverse(T_reference)
    Z, Ad = times(T_reference_odom, T_imaged), adjoint(T_reference_odom)
    return Z, by_camera_errors(Z, times(Ad, told)), Ad


@kernel
def apart(
    T_imaged: FloatArray, T_reference: FloatArray, told: FloatArray, Z: FloatArray, camera_errors: FloatArray
) -> FloatArray:
    """log(Z Ẑ⁻¹) (6,) of a motion Z (4, 4), mended by the camera's errors (9,), and the one that two poses tell."""
    Z_expected, B, _ = expected(T_imaged, T_reference, told)
    xi = log(times(Z, inverse(Z_expected)))
    for i in range(6):
        for j in range(_CAMERA):
            xi[i] += B[i, j] * camera_errors[j]
    return xi


class Poses(NamedTuple):
    """The pose now and one that is remembered.

    Attributes:
        T_now, T_reference: (4, 4).
        by_wheel_errors: (6, 3) how the wheels' errors moved the one since the other, as left perturbations in odom.
        place: of the remembered pose in the covariance.
        twist_then: (3,) at that pose.
    """

    T_now: FloatArray
    T_reference: FloatArray
    by_wheel_errors: FloatArray
    place: int
    twist_then: FloatArray


class Told(NamedTuple):
    """A motion Z (4, 4), of which directions `seen` (m, 6) were seen, with noise R (m, m)."""

    Z: FloatArray
    seen: FloatArray
    R: FloatArray


@kernel
def measured(
    poses: Poses, rest: FloatArray, P: FloatArray, told: Told
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float, float]:
    """What a motion that was told says, against a pose that is remembered.

    Returns the residual (m,), its covariance S (m, m), that with the state P Hᵀ (n, m), H (m, 6) of the pose now, the
    residual's χ², and that of how the twist changed since.
    """
    T_imaged, seen, R, place = imaged_at(poses.T_now, rest), told.seen, told.R, poses.place
    _, B, Ad = expected(T_imaged, poses.T_reference, poses.by_wheel_errors)
    H, by_errors = times(seen, Ad), times(seen, B)
    residual = _rows(seen, apart(T_imaged, poses.T_reference, poses.by_wheel_errors, told.Z, rest[6 : 6 + _CAMERA]))
    twist = rest[:3].copy()
    PHt, S = _innovation(P, place, H, by_errors, R, T_imaged, rest[_LAG], twist)
    # What is late counts by the twist as this measurement tells it: the wheels' noise is in theirs and in the residual,
    # and their product would go one way at every measurement.
    weighed = np.linalg.solve(S, residual)
    for i in range(3):
        for j in range(len(residual)):
            twist[i] += PHt[len(P) - _REST + i, j] * weighed[j]
    PHt, S = _innovation(P, place, H, by_errors, R, T_imaged, rest[_LAG], twist)
    return residual, S, PHt, H, chi_squared(residual, S), _change_of_twist(rest, P, poses.twist_then)


@kernel
def shown(
    R: FloatArray,
    seen: FloatArray,
    unseen: FloatArray,
    scale: FloatArray,
    to_camera: FloatArray,
    from_camera: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What a covariance R (6, 6) of the camera's motion is in the directions `seen` (m, 6) of it, scaled: (m, m).

    Then these directions (m, 6) as the base's, and the covariance (6, 6) of the base's, very wide where it is `unseen`.
    """
    scaled = (R + R.T) / 2
    for i in range(6):
        for j in range(6):
            scaled[i, j] *= scale[i] * scale[j]
    covariance = times(times(seen, scaled), seen.T)
    wide = times(times(seen.T, covariance), seen) + _UNSEEN_SIGMA_M**2 * times(unseen.T, unseen)
    return covariance, times(seen, to_camera), times(times(from_camera, wide), from_camera.T)


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
    errors, at = slice(len(P) - _REST + 6, len(P) - _REST + 6 + _CAMERA), slice(place, place + 6)
    rows, spread = imaged(P, T_imaged, lag_s, twist)
    apart = spread - rows[:, at] - rows[:, at].T + P[at, at]
    PHt = times(H, rows - P[at]).T - times(P[:, errors], by_errors.T)
    crossed = times(times(H, rows[:, errors] - P[at, errors]), by_errors.T)
    of_errors = times(times(by_errors, P[errors, errors]), by_errors.T)
    return PHt, times(times(H, apart), H.T) - crossed - crossed.T + of_errors + R
