"""One step of dead reckoning, and whole logs of them; numba over arrays and numbers.

A state is an array of STATE_SIZE numbers, its places named below. The covariance is that of the left perturbation
(vx, vy, ω) of T_odom_base: there, a step only adds to it, and what was uncertain before stays as it is.
The gyroscope's bias is considered, not estimated, while the robot drives: `SENSITIVITY` is how far the pose would move
per unit of it, so that its error counts for the whole way it lasts. It is estimated while the wheels stand still.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from wheelsight.geometry import ByteArray, FloatArray

X, Y, YAW = 0, 1, 2
COVARIANCE = 3  # xx, xy, xω, yy, yω, ωω
BIAS, BIAS_VARIANCE, SENSITIVITY, IS_STILL = 9, 10, 11, 14
SPEED, YAW_RATE = 15, 16
STATE_SIZE = 17

TRACK, SLIP_SQUARED, SPEED_LIMIT, GAP_LIMIT, GYRO_VARIANCE, WALK_VARIANCE, LEFT_M, RIGHT_M, SPAN = range(9)
PARAMETERS_SIZE = 9

EULER, MIDPOINT, ARC = 0, 1, 2
OK, BACKWARDS, GAP, AMBIGUOUS, IMPLAUSIBLE = 0, 1, 2, 3, 4

# Stamps given on arrival jitter: ticks of a long while may come stamped as those of a short one.
STAMP_JITTER_S = 0.05
# m/s², of wheels that spin up in the air.
MOST_ACCELERATION = 20.0
# m/s², of a wheel that turns back: its whole way since it stood still, where a counter that wraps leaps at full speed.
MOST_REVERSAL = 7.0
_SERIES_BELOW = 0.1


@njit(cache=True, nogil=True)
def unrolled(ticks: float, span: float) -> float:
    """A difference of counters that roll over after `span` (0: never), as the least step that explains it."""
    return ticks - span * math.floor(ticks / span + 0.5) if span > 0 else ticks


@njit(cache=True, nogil=True)
def fault(state: FloatArray, parameters: FloatArray, left_m: float, right_m: float, dt_s: float) -> int:
    """Why a step is refused, or OK.

    More than the fastest wheel rolls in the time that stamps tell may still be the ticks of a longer while, if the
    robot went about so fast before; else it is a counter that leaped.
    """
    if not 0 < dt_s < math.inf:
        return BACKWARDS
    if dt_s > parameters[GAP_LIMIT]:
        return GAP
    half_m = 0.5 * parameters[SPAN] * min(parameters[LEFT_M], parameters[RIGHT_M])
    if half_m > 0 and parameters[SPEED_LIMIT] * dt_s >= half_m:
        return AMBIGUOUS
    while_s, way_m = dt_s + STAMP_JITTER_S, max(abs(left_m), abs(right_m))
    pace_m_s = abs(state[SPEED]) + 0.5 * parameters[TRACK] * abs(state[YAW_RATE])
    by_pace_m = max(parameters[SPEED_LIMIT] * dt_s, (2 * pace_m_s + MOST_ACCELERATION * while_s) * while_s)
    is_known = pace_m_s > 0 or state[IS_STILL] > 0
    farthest_m = parameters[SPEED_LIMIT] * while_s
    if way_m > (min(farthest_m, by_pace_m) if is_known else farthest_m):
        return IMPLAUSIBLE
    turn_m_s = 0.5 * parameters[TRACK] * state[YAW_RATE]
    is_leap = _leaps_back(state[SPEED] - turn_m_s, left_m, while_s) or _leaps_back(
        state[SPEED] + turn_m_s, right_m, while_s
    )
    return IMPLAUSIBLE if is_leap else OK


@njit(cache=True, nogil=True)
def _leaps_back(before_m_s: float, way_m: float, while_s: float) -> bool:
    """Whether a wheel that went at some speed rolled back much faster than that, and than it could within the while."""
    return before_m_s * way_m < 0 and abs(way_m) > max(MOST_REVERSAL * while_s, 3 * abs(before_m_s)) * while_s


@njit(cache=True, nogil=True)
def widen(state: FloatArray, parameters: FloatArray, dt_s: float) -> None:
    """Let the covariance say that in `dt_s` the robot may have gone anywhere its wheels could take it, evenly so."""
    reach_m = parameters[SPEED_LIMIT] * (dt_s + STAMP_JITTER_S)
    turn_rad = min(2 * reach_m / parameters[TRACK], math.pi)
    _add_outer(state, turn_rad**2 / 3, state[Y], -state[X], 1.0)
    state[COVARIANCE] += reach_m**2 / 3
    state[COVARIANCE + 3] += reach_m**2 / 3
    state[BIAS_VARIANCE] += parameters[WALK_VARIANCE] * dt_s
    state[IS_STILL] = state[SPEED] = state[YAW_RATE] = 0.0


@njit(cache=True, nogil=True)
def step(
    state: FloatArray,
    parameters: FloatArray,
    integration: int,
    left_m: float,
    right_m: float,
    dt_s: float,
    rate_rad_s: float,
) -> None:
    """Move the state by the travel of both wheels in `dt_s`; the gyroscope's mean rate may be NaN for none."""
    track_m, slip_squared = parameters[TRACK], parameters[SLIP_SQUARED]
    left_variance, right_variance = slip_squared * abs(left_m), slip_squared * abs(right_m)
    way_m, turn_rad = (left_m + right_m) / 2, (right_m - left_m) / track_m
    way_variance = (left_variance + right_variance) / 4
    turn_variance = 4 * way_variance / track_m**2
    shared = (right_variance - left_variance) / (2 * track_m)
    state[BIAS_VARIANCE] += parameters[WALK_VARIANCE] * dt_s
    is_still, turn_per_bias = left_m == 0 and right_m == 0, 0.0
    if not math.isnan(rate_rad_s) and is_still and state[IS_STILL] > 0:
        _learn_bias(state, rate_rad_s, parameters[GYRO_VARIANCE] / dt_s)
    elif not math.isnan(rate_rad_s) and not is_still:
        gyro_variance = parameters[GYRO_VARIANCE] * dt_s
        gain = turn_variance / (turn_variance + gyro_variance + state[BIAS_VARIANCE] * dt_s**2)
        # The way is left as it is, though it shares noise with the turn: how much it shares is told by the same
        # noisy travels, and a gain that goes along with what it weighs shortens every way.
        turn_rad += gain * ((rate_rad_s - state[BIAS]) * dt_s - turn_rad)
        shared *= 1 - gain
        turn_variance = (1 - gain) ** 2 * turn_variance + gain**2 * gyro_variance
        turn_per_bias = -gain * dt_s
    state[IS_STILL] = 1.0 if is_still else 0.0
    state[SPEED], state[YAW_RATE] = way_m / dt_s, turn_rad / dt_s
    if is_still:
        return
    (wx, wy), (tx, ty) = move(state, integration, way_m, turn_rad)
    # as left perturbations: a turn where the robot now stands is one about the origin, and a shift
    tx, ty = tx + state[Y], ty - state[X]
    _add_pair(state, way_variance, shared, turn_variance, wx, wy, tx, ty)
    state[SENSITIVITY] += turn_per_bias * tx
    state[SENSITIVITY + 1] += turn_per_bias * ty
    state[SENSITIVITY + 2] += turn_per_bias


@njit(cache=True, nogil=True)
def _learn_bias(state: FloatArray, rate_rad_s: float, rate_variance: float) -> None:
    variance = state[BIAS_VARIANCE]
    x, y, yaw = state[SENSITIVITY : SENSITIVITY + 3]
    _add_outer(state, variance, x, y, yaw)  # what the old bias did is done; the new one's error is another
    state[SENSITIVITY : SENSITIVITY + 3] = 0.0
    gain = variance / (variance + rate_variance)
    state[BIAS] += gain * (rate_rad_s - state[BIAS])
    state[BIAS_VARIANCE] = (1 - gain) * variance


@njit(cache=True, nogil=True)
def _chord(turn_rad: float) -> tuple[float, float]:
    """Length of the chord of an arc of length 1 that turns so far, and its derivative by the turn."""
    h = turn_rad / 2
    if abs(h) < _SERIES_BELOW:
        q = h * h
        return 1 - q / 6 * (1 - q / 20 * (1 - q / 42)), -h / 6 * (1 - q / 10 * (1 - q / 28 * (1 - q / 54)))
    return math.sin(h) / h, (math.cos(h) - math.sin(h) / h) / h / 2


@njit(cache=True, nogil=True)
def _shape(integration: int, turn_rad: float) -> tuple[float, float, float]:
    """Chord of an arc of length 1, its derivative by the turn, and the share of the turn at which it points."""
    if integration == EULER:
        return 1.0, 0.0, 0.0
    if integration == MIDPOINT:
        return 1.0, 0.0, 0.5
    chord, slope = _chord(turn_rad)
    return chord, slope, 0.5


@njit(cache=True, nogil=True)
def move(
    state: FloatArray, integration: int, way_m: float, turn_rad: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Move the pose; answers the derivatives of (x, y) by the way and by the turn."""
    chord, slope, share = _shape(integration, turn_rad)
    heading_rad = state[YAW] + share * turn_rad
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    state[X] += chord * way_m * c
    state[Y] += chord * way_m * s
    yaw_rad = state[YAW] + turn_rad
    if abs(yaw_rad) > math.pi:
        yaw_rad = math.atan2(math.sin(yaw_rad), math.cos(yaw_rad))
    state[YAW] = yaw_rad
    bend, swing = way_m * slope, way_m * chord * share
    return (chord * c, chord * s), (bend * c - swing * s, bend * s + swing * c)


@njit(cache=True, nogil=True)
def _add_outer(state: FloatArray, variance: float, x: float, y: float, yaw: float) -> None:
    state[COVARIANCE] += variance * x * x
    state[COVARIANCE + 1] += variance * x * y
    state[COVARIANCE + 2] += variance * x * yaw
    state[COVARIANCE + 3] += variance * y * y
    state[COVARIANCE + 4] += variance * y * yaw
    state[COVARIANCE + 5] += variance * yaw * yaw


@njit(cache=True, nogil=True)
def _add_pair(
    state: FloatArray,
    way_variance: float,
    shared: float,
    turn_variance: float,
    wx: float,
    wy: float,
    tx: float,
    ty: float,
) -> None:
    """Add the noise of way and turn, that move the pose along (wx, wy, 0) and (tx, ty, 1)."""
    _add_outer(state, turn_variance, tx, ty, 1.0)
    state[COVARIANCE] += way_variance * wx * wx + 2 * shared * wx * tx
    state[COVARIANCE + 1] += way_variance * wx * wy + shared * (wx * ty + wy * tx)
    state[COVARIANCE + 2] += shared * wx
    state[COVARIANCE + 3] += way_variance * wy * wy + 2 * shared * wy * ty
    state[COVARIANCE + 4] += shared * wy


@njit(cache=True, nogil=True)
def read_covariance(state: FloatArray, six: FloatArray) -> None:
    """Write xx, xy, xω, yy, yω, ωω into `six` (6,), the bias's part included."""
    variance = state[BIAS_VARIANCE]
    x, y, yaw = state[SENSITIVITY], state[SENSITIVITY + 1], state[SENSITIVITY + 2]
    six[0] = state[COVARIANCE] + variance * x * x
    six[1] = state[COVARIANCE + 1] + variance * x * y
    six[2] = state[COVARIANCE + 2] + variance * x * yaw
    six[3] = state[COVARIANCE + 3] + variance * y * y
    six[4] = state[COVARIANCE + 4] + variance * y * yaw
    six[5] = state[COVARIANCE + 5] + variance * yaw * yaw


@njit(cache=True, nogil=True)
def update(
    state: FloatArray,
    parameters: FloatArray,
    integration: int,
    left_ticks: float,
    right_ticks: float,
    dt_s: float,
    rate_rad_s: float,
    T_odom_base: FloatArray,
    covariance: FloatArray,
) -> int:
    """One reading of the stream: step, or widen and say why; fills T (4, 4) and covariance (6, 6)."""
    left_m = parameters[LEFT_M] * unrolled(left_ticks, parameters[SPAN])
    right_m = parameters[RIGHT_M] * unrolled(right_ticks, parameters[SPAN])
    why = fault(state, parameters, left_m, right_m, dt_s)
    if why == OK:
        step(state, parameters, integration, left_m, right_m, dt_s, rate_rad_s)
    elif why != BACKWARDS:
        widen(state, parameters, dt_s)
    c, s = math.cos(state[YAW]), math.sin(state[YAW])
    T_odom_base[0, 0], T_odom_base[0, 1], T_odom_base[0, 3] = c, -s, state[X]
    T_odom_base[1, 0], T_odom_base[1, 1], T_odom_base[1, 3] = s, c, state[Y]
    six = np.empty(6)
    read_covariance(state, six)
    covariance[0, 0], covariance[1, 1], covariance[5, 5] = six[0], six[3], six[5]
    covariance[0, 1] = covariance[1, 0] = six[1]
    covariance[0, 5] = covariance[5, 0] = six[2]
    covariance[1, 5] = covariance[5, 1] = six[4]
    return why


@njit(cache=True, nogil=True)
def integrate(
    state: FloatArray,
    parameters: FloatArray,
    integration: int,
    stamps_s: FloatArray,
    left: FloatArray,
    right: FloatArray,
    rates_rad_s: FloatArray,
    poses: FloatArray,
    covariances: FloatArray,
    reasons: ByteArray,
) -> None:
    """A log of ticks (N,); `rates_rad_s` is (N,) or empty. Fills poses (N, 3), covariances (N, 6), reasons (N,)."""
    last = 0
    for i in range(len(stamps_s)):
        if i > 0:
            dt_s = stamps_s[i] - stamps_s[last]
            left_m = parameters[LEFT_M] * unrolled(left[i] - left[last], parameters[SPAN])
            right_m = parameters[RIGHT_M] * unrolled(right[i] - right[last], parameters[SPAN])
            reasons[i] = fault(state, parameters, left_m, right_m, dt_s)
            if reasons[i] == OK:
                rate = rates_rad_s[i] if len(rates_rad_s) else math.nan
                step(state, parameters, integration, left_m, right_m, dt_s, rate)
            elif reasons[i] != BACKWARDS:
                widen(state, parameters, dt_s)
            if reasons[i] != BACKWARDS:
                last = i
        poses[i, 0], poses[i, 1], poses[i, 2] = state[X], state[Y], state[YAW]
        read_covariance(state, covariances[i])
