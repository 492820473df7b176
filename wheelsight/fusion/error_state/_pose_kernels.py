"""How a PoseBelief goes on with the wheels, or without them, is corrected and answered; numba over arrays and numbers.

T (1 + K, 4, 4), rest (17,) and P (n, n) are as `_pose_belief` lays them out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import FloatArray, IntArray
from wheelsight.geometry.motion_kernels import adjoint, carried, chi_squared, exp, left_jacobian, log, times

_REST, _PLANE = 17, (0, 1, 5)


@kernel
def _depend(P: FloatArray, errors: int, to_pose: FloatArray, to_twist: FloatArray) -> None:
    """Add to the pose, and put in the twist's place, what the wheels' errors (3,) do to it: (6, 3) and (3, 3)."""
    twist = errors - 3
    old = P[errors : errors + 3].copy()
    P[:6] += times(to_pose, old)
    P[twist:errors] = times(to_twist, old)
    old = P[:, errors : errors + 3].copy()
    P[:, :6] += times(old, to_pose.T)
    P[:, twist:errors] = times(old, to_twist.T)


@kernel
def by_wheel_errors(raw: FloatArray, known_way: FloatArray) -> FloatArray:
    """How a step (6,) changes with the wheels' errors (6, 3), by the way (3,) that its speed before makes; NaN: none.

    By its own numbers, a step that is too long by chance would be one more that calls for a smaller scale, and the
    errors would be drawn towards those that leave no motion at all.
    """
    by_errors = np.zeros((6, 3))
    ahead, left, turn = raw[0], raw[1], raw[5]
    if not np.isnan(known_way[0]):
        ahead, left, turn = known_way[0], known_way[1], known_way[2]
    by_errors[0, 0], by_errors[1, 0] = ahead, left
    by_errors[5, 1], by_errors[5, 2] = ahead, turn
    return by_errors


class Step(NamedTuple):
    """A share of a step of the wheels.

    Attributes:
        xi: (6,) the whole step.
        noise: (6, 6) of its left perturbation.
        share: of the whole.
        dt_s: how long the share lasts.
        known_twist: (3,) as known before, NaN where it is not.
    """

    xi: FloatArray
    noise: FloatArray
    share: float
    dt_s: float
    known_twist: FloatArray


class Unseen(NamedTuple):
    """What happens on the way that no wheel tells.

    Attributes:
        unseen: (6, 6) noise that a metre of the way of a point `lever_m` aside adds.
        walks: (14,) that it adds to the variances of the errors of wheels and camera; the last is of the gyroscope's
            bias, in a second.
        fades: (14,) the share of them that it takes back.
        lever_m: see above.
    """

    unseen: FloatArray
    walks: FloatArray
    fades: FloatArray
    lever_m: float


@kernel
def wheel_step(
    T: FloatArray, rest: FloatArray, P: FloatArray, step: Step, unseen: Unseen
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """T, rest and P after a share of a step of the wheels.

    A part of a step has the twist of the whole, and is as uncertain of it; what is learned of that goes back over the
    part alone.

    Returns (6, 3), too: how the wheels' errors move the pose by this step, as a left perturbation; and the way.
    """
    T, rest, P, share, dt_s = T.copy(), rest.copy(), P.copy(), step.share, step.dt_s
    raw = step.xi * share
    way_m = unseen.lever_m * abs(raw[5]) + math.hypot(raw[0], raw[1])
    Q = step.noise * share + unseen.unseen * way_m
    by_errors = by_wheel_errors(raw, step.known_twist * dt_s)
    twist, errors = len(P) - _REST, len(P) - _REST + 3
    xi = raw + times(by_errors, rest[3:6].copy().reshape(3, 1))[:, 0]
    Ad, J = adjoint(T[0]), left_jacobian(xi)
    to_pose, to_twist = times(times(Ad, J), by_errors), by_errors[np.array([0, 1, 5])] / dt_s
    _depend(P, errors, to_pose, to_twist)
    G = np.zeros((9, 6))
    G[:6] = Ad
    G[6:] = np.linalg.inv(J)[np.array([0, 1, 5])] * (math.sqrt(share) / dt_s)
    grown = times(times(G, Q), G.T)
    P[:6, :6] += grown[:6, :6]
    P[:6, twist:errors] += grown[:6, 6:] * math.sqrt(share)
    P[twist:errors, :6] += grown[6:, :6] * math.sqrt(share)
    P[twist:errors, twist:errors] += grown[6:, 6:]
    _wander(rest, P, unseen, way_m, dt_s)
    T[0] = times(T[0], exp(xi))
    rest[0], rest[1], rest[2] = xi[0] / dt_s, xi[1] / dt_s, xi[5] / dt_s
    return T, rest, P, to_pose, way_m


@kernel
def _wander(rest: FloatArray, P: FloatArray, unseen: Unseen, way_m: float, dt_s: float) -> None:
    """Let the errors of wheels, camera and gyroscope wander, and fade, along a way and a time."""
    errors = len(P) - _REST + 3
    for i in range(len(unseen.walks)):
        k, far = errors + i, way_m if errors + i < len(P) - 1 else dt_s
        kept = math.exp(-unseen.fades[i] * far)
        rest[3 + i] *= kept
        P[k] *= kept
        P[:, k] *= kept
        P[k, k] += unseen.walks[i] * far


@kernel
def odometer(
    T: FloatArray, C: FloatArray, xi: FloatArray, Q: FloatArray, share: float
) -> tuple[FloatArray, FloatArray]:
    """A motion (4, 4) and its covariance (6, 6) after a share of a step ξ (6,) with covariance Q (6, 6)."""
    return times(T, exp(xi * share)), C + carried(T, Q * share)


@kernel
def coast(
    T: FloatArray, rest: FloatArray, P: FloatArray, q: FloatArray, Q: FloatArray, dt_s: float, walk: float
) -> tuple[FloatArray, FloatArray]:
    """T and P after the twist went on, with white noise of acceleration q (3,), and noise Q (6, 6) of the step."""
    T, P = T.copy(), P.copy()
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
    return T, P


@kernel
def speed(T: FloatArray, covariance: FloatArray, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Mean velocity (3,) in the plane of a motion (4, 4) that took so long, and its covariance (3, 3)."""
    xi, mean = log(T), np.zeros(3)
    for i in range(3):
        mean[i] = xi[_PLANE[i]] / seconds
    return mean, covariance / seconds**2


@kernel
def leap(
    now: FloatArray, C_now: FloatArray, before: FloatArray, C_before: FloatArray, usual: tuple[float, float, float]
) -> float:
    """χ² of a change of velocity (3,), known so well, where changes of `usual` standard deviations happen."""
    covariance = C_now + C_before
    for i in range(3):
        covariance[i, i] += usual[i] ** 2
    chi2: float = chi_squared(now - before, covariance)
    return chi2


@kernel
def answered(
    T: FloatArray, rest: FloatArray, P: FloatArray, clock_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The pose now (4, 4) and its covariance (6, 6), the twist (3,) and its own, with stamps that are uncertain so."""
    Ad, late, at = adjoint(T[0]), np.zeros((6, 1)), len(P) - _REST
    for i in range(6):
        for j in range(3):
            late[i, 0] += Ad[i, _PLANE[j]] * rest[j] * clock_s
    return T[0].copy(), P[:6, :6] + times(late, late.T), rest[:3].copy(), P[at : at + 3, at : at + 3].copy()


@kernel
def correct(
    T: FloatArray, rest: FloatArray, P: FloatArray, PHt: FloatArray, S: FloatArray, residual: FloatArray, kept: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """T, rest and P after the Kalman update, of which the numbers `kept` of the state (k,) learn nothing."""
    gain: FloatArray = np.linalg.solve(S, np.ascontiguousarray(PHt.T)).T.astype(np.float64)
    lost = times(gain, PHt.T)
    less = (P + P.T - lost - lost.T) / 2  # what rounding makes askew would grow
    x = np.zeros(len(P))
    for i in range(len(P)):
        for j in range(len(residual)):
            x[i] += gain[i, j] * residual[j]
    for i in kept:
        x[i] = 0.0
        for j in kept:
            less[i, j] = P[i, j]
    T, rest = perturb(T, rest, x)
    return T, rest, less


@kernel
def perturb(T: FloatArray, rest: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """All poses perturbed, and the rest shifted, by x (n,)."""
    moved = np.empty_like(T)
    for i in range(len(T)):
        moved[i] = times(exp(x[6 * i : 6 * i + 6]), T[i])
    return moved, rest + x[6 * len(T) :]
