"""One step of dead reckoning, and whole logs of them; numba over arrays and numbers.

A state is an array of STATE_SIZE numbers, its places named in `_state_kernels`. Steps move it by what the wheels tell;
a gyroscope corrects it stretch by stretch, and begins a second one beside it (`_gyro_kernels`).
"""

from __future__ import annotations

import math

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import ByteArray, FloatArray
from wheelsight.odometry.wheels._gyro_kernels import add_rest, add_step, begin_off, end_stretch, likelier
from wheelsight.odometry.wheels._state_kernels import (
    BEGUN,
    BIAS_VARIANCE,
    COVARIANCE,
    DRIFT,
    EXACT,
    IS_REST,
    IS_STILL,
    OFF,
    RATIO,
    SCALE,
    SHARED_COVARIANCE,
    SLIP_COVARIANCE,
    SPEED,
    STRETCH_S,
    TURNED,
    YAW,
    YAW_RATE,
    X,
    Y,
    add_outer,
    add_shared,
)

TRACK, SLIP_SQUARED, SPEED_LIMIT, GAP_LIMIT, GYRO_VARIANCE, WALK_VARIANCE, LEFT_M, RIGHT_M, SPAN = range(9)
COUNT_VARIANCE, PARAMETERS_SIZE = 9, 10  # of a turn between two counts; 0 where wheels tell no counts

EULER, MIDPOINT, ARC = 0, 1, 2
OK, BACKWARDS, GAP, AMBIGUOUS, IMPLAUSIBLE = 0, 1, 2, 3, 4

# Stamps given on arrival jitter: ticks of a long while may come stamped as those of a short one.
STAMP_JITTER_S = 0.05
# m/s², of wheels that spin up in the air.
MOST_ACCELERATION = 20.0
# m/s², of a wheel that turns back: its whole way since it stood still, where a counter that wraps leaps at full speed.
MOST_REVERSAL = 7.0
_SERIES_BELOW = 0.1


@kernel
def unrolled(ticks: float, span: float) -> float:
    """A difference of counters that roll over after `span` (0: never), as the least step that explains it."""
    return ticks - span * math.floor(ticks / span + 0.5) if span > 0 else ticks


@kernel
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


@kernel
def _leaps_back(before_m_s: float, way_m: float, while_s: float) -> bool:
    """Whether a wheel that went at some speed rolled back much faster than that, and than it could within the while."""
    return before_m_s * way_m < 0 and abs(way_m) > max(MOST_REVERSAL * while_s, 3 * abs(before_m_s)) * while_s


@kernel
def widen(state: FloatArray, parameters: FloatArray, dt_s: float) -> None:
    """Let the covariance say that in `dt_s` the robot may have gone anywhere its wheels could take it, evenly so."""
    end_stretch(state, parameters[GYRO_VARIANCE], parameters[COUNT_VARIANCE])
    reach_m = parameters[SPEED_LIMIT] * (dt_s + STAMP_JITTER_S)
    turn_rad = min(2 * reach_m / parameters[TRACK], math.pi)
    add_outer(state, COVARIANCE, turn_rad**2 / 3, state[Y], -state[X], 1.0)
    state[COVARIANCE] += reach_m**2 / 3
    state[COVARIANCE + 3] += reach_m**2 / 3
    state[BIAS_VARIANCE] += parameters[WALK_VARIANCE] * dt_s
    state[IS_STILL] = state[SPEED] = state[YAW_RATE] = 0.0


@kernel
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
    shared = (right_variance - left_variance) / (2 * track_m)
    state[TURNED] = turn_rad
    turn_rad += state[DRIFT] * way_m + state[SCALE] * turn_rad
    is_still, is_gyro_silent = left_m == 0 and right_m == 0, math.isnan(rate_rad_s)
    was_still, state[IS_STILL] = state[IS_STILL] > 0, 1.0 if is_still else 0.0
    of_gyro = (parameters[GYRO_VARIANCE], parameters[COUNT_VARIANCE])
    state[BIAS_VARIANCE] += parameters[WALK_VARIANCE] * dt_s
    state[SPEED], state[YAW_RATE] = way_m / dt_s, turn_rad / dt_s
    if is_gyro_silent and state[STRETCH_S] > 0:
        end_stretch(state, *of_gyro)
    if is_still:
        if was_still and not is_gyro_silent:
            add_rest(state, *of_gyro, dt_s, rate_rad_s * dt_s)
        return
    (wx, wy), (tx, ty) = move(state, integration, way_m, turn_rad)
    # as left perturbations: a turn where the robot now stands is one about the origin, and a shift
    along, slip = (wx, wy, tx + state[Y], ty - state[X]), (4 * way_variance / track_m**2, shared)
    state[COVARIANCE] += way_variance * wx * wx
    state[COVARIANCE + 1] += way_variance * wx * wy
    state[COVARIANCE + 3] += way_variance * wy * wy
    if is_gyro_silent:
        add_outer(state, COVARIANCE, slip[0], along[2], along[3], 1.0)
        add_shared(state, COVARIANCE, shared, *along)
    else:
        add_step(state, *of_gyro, dt_s, way_m, turn_rad, rate_rad_s, slip, along)


@kernel
def _step_each(
    states: FloatArray,
    parameters: FloatArray,
    integration: int,
    left_m: float,
    right_m: float,
    dt_s: float,
    rate_rad_s: float,
) -> None:
    """`step` of both states (2, STATE_SIZE); of one, where no gyroscope was heard yet."""
    if states[OFF, BEGUN] == 0 and not math.isnan(rate_rad_s):
        begin_off(states)
    step(states[EXACT], parameters, integration, left_m, right_m, dt_s, rate_rad_s)
    if states[OFF, BEGUN] > 0:
        step(states[OFF], parameters, integration, left_m, right_m, dt_s, rate_rad_s)


@kernel
def _widen_each(states: FloatArray, parameters: FloatArray, dt_s: float) -> None:
    for i in range(len(states)):
        widen(states[i], parameters, dt_s)


@kernel
def _chord(turn_rad: float) -> tuple[float, float]:
    """Length of the chord of an arc of length 1 that turns so far, and its derivative by the turn."""
    h = turn_rad / 2
    if abs(h) < _SERIES_BELOW:
        q = h * h
        return 1 - q / 6 * (1 - q / 20 * (1 - q / 42)), -h / 6 * (1 - q / 10 * (1 - q / 28 * (1 - q / 54)))
    return math.sin(h) / h, (math.cos(h) - math.sin(h) / h) / h / 2


@kernel
def _shape(integration: int, turn_rad: float) -> tuple[float, float, float]:
    """Chord of an arc of length 1, its derivative by the turn, and the share of the turn at which it points."""
    if integration == EULER:
        return 1.0, 0.0, 0.0
    if integration == MIDPOINT:
        return 1.0, 0.0, 0.5
    chord, slope = _chord(turn_rad)
    return chord, slope, 0.5


@kernel
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


@kernel
def read_covariance(state: FloatArray, six: FloatArray) -> None:
    """Write xx, xy, xω, yy, yω, ωω into `six` (6,), that of the stretch which the gyroscope has not joined included."""
    root = math.sqrt(state[RATIO])
    for i in range(6):
        six[i] = state[COVARIANCE + i]
        if state[STRETCH_S] > 0 and state[IS_REST] == 0:
            six[i] += state[RATIO] * state[SLIP_COVARIANCE + i] + root * state[SHARED_COVARIANCE + i]


@kernel
def update(
    states: FloatArray,
    parameters: FloatArray,
    integration: int,
    left_ticks: float,
    right_ticks: float,
    dt_s: float,
    rate_rad_s: float,
    T_odom_base: FloatArray,
    covariance: FloatArray,
) -> int:
    """One reading of the stream: step, or widen and say why; fills T (4, 4) and covariance (6, 6).

    `states` is (2, STATE_SIZE).
    """
    left_m = parameters[LEFT_M] * unrolled(left_ticks, parameters[SPAN])
    right_m = parameters[RIGHT_M] * unrolled(right_ticks, parameters[SPAN])
    state = states[likelier(states)]
    why = fault(state, parameters, left_m, right_m, dt_s)
    if why == OK:
        _step_each(states, parameters, integration, left_m, right_m, dt_s, rate_rad_s)
    elif why != BACKWARDS:
        _widen_each(states, parameters, dt_s)
    state = states[likelier(states)]
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


@kernel
def integrate(
    states: FloatArray,
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
    last, state = 0, states[EXACT]
    for i in range(len(stamps_s)):
        if i > 0:
            dt_s = stamps_s[i] - stamps_s[last]
            left_m = parameters[LEFT_M] * unrolled(left[i] - left[last], parameters[SPAN])
            right_m = parameters[RIGHT_M] * unrolled(right[i] - right[last], parameters[SPAN])
            reasons[i] = fault(state, parameters, left_m, right_m, dt_s)
            if reasons[i] == OK:
                rate = rates_rad_s[i] if len(rates_rad_s) else math.nan
                _step_each(states, parameters, integration, left_m, right_m, dt_s, rate)
            elif reasons[i] != BACKWARDS:
                _widen_each(states, parameters, dt_s)
            if reasons[i] != BACKWARDS:
                last = i
        if len(rates_rad_s):
            state = states[likelier(states)]
        poses[i, 0], poses[i, 1], poses[i, 2] = state[X], state[Y], state[YAW]
        read_covariance(state, covariances[i])
