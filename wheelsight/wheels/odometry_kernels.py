"""Compiled steps of dead reckoning, and the Kalman filter that fuses wheels and a gyroscope."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import ByteArray, FloatArray
from wheelsight.wheels import state_kernels as at
from wheelsight.wheels.state_kernels import add_outer, add_product, add_shared

# A state is an array of STATE_SIZE numbers (`state_kernels`). Steps of the wheels move it, and the gyroscope corrects
# it stretch by stretch, and begins a second state beside it.

TRACK, SLIP_SQUARED, SPEED_LIMIT, GAP_LIMIT, GYRO_VARIANCE, WALK_VARIANCE, LEFT_M, RIGHT_M, SPAN = range(9)
COUNT_VARIANCE = 9  # of a turn between two counts; 0 for speeds
INTEGRATION, PARAMETERS_SIZE = 10, 11  # EULER, MIDPOINT or ARC

EULER, MIDPOINT, ARC = 0, 1, 2
OK, BACKWARDS, GAP, AMBIGUOUS, IMPLAUSIBLE = 0, 1, 2, 3, 4

STAMP_JITTER_S = 0.05  # of stamps at arrival: a step may last longer by this
MOST_ACCELERATION = 20.0  # m/s², of wheels that spin in the air
MOST_REVERSAL = 7.0  # m/s², of a wheel that turns back; a counter that wraps leaps at full speed
_SERIES_BELOW = 0.1


class Log(NamedTuple):
    """Readings (N,) of a whole drive: stamps, cumulative ticks; yaw rates (N,), or empty."""

    stamps_s: FloatArray
    left: FloatArray
    right: FloatArray
    rates_rad_s: FloatArray


class LogPoses(NamedTuple):
    """Result of a log: x, y, yaw (N, 3), covariances (N, 6) as in `read_covariance`, and reasons (N,) or 0."""

    poses: FloatArray
    covariances: FloatArray
    reasons: ByteArray


@kernel
def unrolled(ticks: float, span: float) -> float:
    """Return the smallest step for a difference of counters that roll over after `span` (0: never)."""
    return ticks - span * math.floor(ticks / span + 0.5) if span > 0 else ticks


@kernel
def fault(state: FloatArray, parameters: FloatArray, left_m: float, right_m: float, dt_s: float) -> int:
    """Return why a step is refused, or OK.

    A step beyond the speed limit may still be the ticks of a longer time, if the robot was about as fast before; else
    the counter leaped.
    """
    if not 0 < dt_s < math.inf:
        return BACKWARDS
    if dt_s > parameters[GAP_LIMIT]:
        return GAP
    half_m = 0.5 * parameters[SPAN] * min(parameters[LEFT_M], parameters[RIGHT_M])
    if half_m > 0 and parameters[SPEED_LIMIT] * dt_s >= half_m:
        return AMBIGUOUS
    while_s, way_m = dt_s + STAMP_JITTER_S, max(abs(left_m), abs(right_m))
    pace_m_s = abs(state[at.SPEED]) + 0.5 * parameters[TRACK] * abs(state[at.YAW_RATE])
    by_pace_m = max(parameters[SPEED_LIMIT] * dt_s, (2 * pace_m_s + MOST_ACCELERATION * while_s) * while_s)
    is_known = pace_m_s > 0 or state[at.IS_STILL] > 0
    farthest_m = parameters[SPEED_LIMIT] * while_s
    if way_m > (min(farthest_m, by_pace_m) if is_known else farthest_m):
        return IMPLAUSIBLE
    turn_m_s = 0.5 * parameters[TRACK] * state[at.YAW_RATE]
    is_leap = _leaps_back(state[at.SPEED] - turn_m_s, left_m, while_s) or _leaps_back(
        state[at.SPEED] + turn_m_s, right_m, while_s
    )
    return IMPLAUSIBLE if is_leap else OK


@kernel
def _leaps_back(before_m_s: float, way_m: float, while_s: float) -> bool:
    """Return whether a wheel rolled back much faster than its speed before, and than it can reverse in that time."""
    return before_m_s * way_m < 0 and abs(way_m) > max(MOST_REVERSAL * while_s, 3 * abs(before_m_s)) * while_s


@kernel
def widen(state: FloatArray, parameters: FloatArray, dt_s: float) -> None:
    """Add the covariance of any motion that the wheels allow in `dt_s`, uniformly distributed."""
    end_stretch(state, parameters[GYRO_VARIANCE], parameters[COUNT_VARIANCE])
    reach_m = parameters[SPEED_LIMIT] * (dt_s + STAMP_JITTER_S)
    turn_rad = min(2 * reach_m / parameters[TRACK], math.pi)
    add_outer(state, at.COVARIANCE, turn_rad**2 / 3, state[at.Y], -state[at.X], 1.0)
    state[at.COVARIANCE] += reach_m**2 / 3
    state[at.COVARIANCE + 3] += reach_m**2 / 3
    state[at.BIAS_VARIANCE] += parameters[WALK_VARIANCE] * dt_s
    state[at.IS_STILL] = state[at.SPEED] = state[at.YAW_RATE] = 0.0


@kernel
def step(
    state: FloatArray, parameters: FloatArray, left_m: float, right_m: float, dt_s: float, rate_rad_s: float
) -> None:
    """Move the state by the travel of both wheels in `dt_s`; the gyroscope's mean rate is NaN for none."""
    track_m, slip_squared = parameters[TRACK], parameters[SLIP_SQUARED]
    left_variance, right_variance = slip_squared * abs(left_m), slip_squared * abs(right_m)
    way_m, turn_rad = (left_m + right_m) / 2, (right_m - left_m) / track_m
    way_variance = (left_variance + right_variance) / 4
    shared = (right_variance - left_variance) / (2 * track_m)
    state[at.TURNED] = turn_rad
    turn_rad += state[at.DRIFT] * way_m + state[at.SCALE] * turn_rad
    is_still, is_gyro_silent = left_m == 0 and right_m == 0, math.isnan(rate_rad_s)
    was_still, state[at.IS_STILL] = state[at.IS_STILL] > 0, 1.0 if is_still else 0.0
    of_gyro = (parameters[GYRO_VARIANCE], parameters[COUNT_VARIANCE])
    state[at.BIAS_VARIANCE] += parameters[WALK_VARIANCE] * dt_s
    state[at.SPEED], state[at.YAW_RATE] = way_m / dt_s, turn_rad / dt_s
    if is_gyro_silent and state[at.STRETCH_S] > 0:
        end_stretch(state, *of_gyro)
    if is_still:
        if was_still and not is_gyro_silent:
            add_rest(state, *of_gyro, dt_s, rate_rad_s * dt_s)
        return
    (wx, wy), (tx, ty) = move(state, int(parameters[INTEGRATION]), way_m, turn_rad)
    # As left perturbations: a turn at the robot's position is one about the origin, and a shift.
    along, slip = (wx, wy, tx + state[at.Y], ty - state[at.X]), (4 * way_variance / track_m**2, shared)
    state[at.COVARIANCE] += way_variance * wx * wx
    state[at.COVARIANCE + 1] += way_variance * wx * wy
    state[at.COVARIANCE + 3] += way_variance * wy * wy
    if is_gyro_silent:
        add_outer(state, at.COVARIANCE, slip[0], along[2], along[3], 1.0)
        add_shared(state, at.COVARIANCE, shared, *along)
    else:
        add_step(state, *of_gyro, GyroStep(dt_s, way_m, turn_rad, rate_rad_s, slip, along))


@kernel
def _step_each(
    states: FloatArray, parameters: FloatArray, left_m: float, right_m: float, dt_s: float, rate_rad_s: float
) -> None:
    """`step` of both states (2, STATE_SIZE); of one before the first rate of a gyroscope."""
    if states[at.OFF, at.BEGUN] == 0 and not math.isnan(rate_rad_s):
        begin_off(states)
    step(states[at.EXACT], parameters, left_m, right_m, dt_s, rate_rad_s)
    if states[at.OFF, at.BEGUN] > 0:
        step(states[at.OFF], parameters, left_m, right_m, dt_s, rate_rad_s)


@kernel
def _widen_each(states: FloatArray, parameters: FloatArray, dt_s: float) -> None:
    for i in range(len(states)):
        widen(states[i], parameters, dt_s)


@kernel
def _chord(turn_rad: float) -> tuple[float, float]:
    """Return the chord of an arc of length 1 and this turn, and its derivative by the turn."""
    h = turn_rad / 2
    if abs(h) < _SERIES_BELOW:
        q = h * h
        return 1 - q / 6 * (1 - q / 20 * (1 - q / 42)), -h / 6 * (1 - q / 10 * (1 - q / 28 * (1 - q / 54)))
    return math.sin(h) / h, (math.cos(h) - math.sin(h) / h) / h / 2


@kernel
def _shape(integration: int, turn_rad: float) -> tuple[float, float, float]:
    """Return the chord of an arc of length 1, its derivative by the turn, and its direction as a share of the turn."""
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
    """Move the pose; return the derivatives of (x, y) by distance and turn."""
    chord, slope, share = _shape(integration, turn_rad)
    heading_rad = state[at.YAW] + share * turn_rad
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    state[at.X] += chord * way_m * c
    state[at.Y] += chord * way_m * s
    yaw_rad = state[at.YAW] + turn_rad
    if abs(yaw_rad) > math.pi:
        yaw_rad = math.atan2(math.sin(yaw_rad), math.cos(yaw_rad))
    state[at.YAW] = yaw_rad
    bend, swing = way_m * slope, way_m * chord * share
    return (chord * c, chord * s), (bend * c - swing * s, bend * s + swing * c)


@kernel
def read_covariance(state: FloatArray, six: FloatArray) -> None:
    """Write xx, xy, xω, yy, yω, ωω into `six` (6,), with that of the current stretch."""
    root = math.sqrt(state[at.RATIO])
    for i in range(6):
        six[i] = state[at.COVARIANCE + i]
        if state[at.STRETCH_S] > 0 and state[at.IS_REST] == 0:
            six[i] += state[at.RATIO] * state[at.SLIP_COVARIANCE + i] + root * state[at.SHARED_COVARIANCE + i]


@kernel
def update(
    states: FloatArray,
    parameters: FloatArray,
    left_ticks: float,
    right_ticks: float,
    dt_s: float,
    rate_rad_s: float,
    T_odom_base: FloatArray,
    covariance: FloatArray,
) -> int:
    """Process a reading: step, or widen and return why; fill T (4, 4) and covariance (6, 6).

    `states` is (2, STATE_SIZE).
    """
    left_m = parameters[LEFT_M] * unrolled(left_ticks, parameters[SPAN])
    right_m = parameters[RIGHT_M] * unrolled(right_ticks, parameters[SPAN])
    state = states[likelier(states)]
    why = fault(state, parameters, left_m, right_m, dt_s)
    if why == OK:
        _step_each(states, parameters, left_m, right_m, dt_s, rate_rad_s)
    elif why != BACKWARDS:
        _widen_each(states, parameters, dt_s)
    state = states[likelier(states)]
    c, s = math.cos(state[at.YAW]), math.sin(state[at.YAW])
    T_odom_base[0, 0], T_odom_base[0, 1], T_odom_base[0, 3] = c, -s, state[at.X]
    T_odom_base[1, 0], T_odom_base[1, 1], T_odom_base[1, 3] = s, c, state[at.Y]
    six = np.empty(6)
    read_covariance(state, six)
    covariance[0, 0], covariance[1, 1], covariance[5, 5] = six[0], six[3], six[5]
    covariance[0, 1] = covariance[1, 0] = six[1]
    covariance[0, 5] = covariance[5, 0] = six[2]
    covariance[1, 5] = covariance[5, 1] = six[4]
    return why


@kernel
def integrate(states: FloatArray, parameters: FloatArray, log: Log, out: LogPoses) -> None:
    """Integrate a log into `out`."""
    stamps_s, left, right, rates_rad_s = log
    poses, covariances, reasons = out
    last, state = 0, states[at.EXACT]
    for i in range(len(stamps_s)):
        if i > 0:
            dt_s = stamps_s[i] - stamps_s[last]
            left_m = parameters[LEFT_M] * unrolled(left[i] - left[last], parameters[SPAN])
            right_m = parameters[RIGHT_M] * unrolled(right[i] - right[last], parameters[SPAN])
            reasons[i] = fault(state, parameters, left_m, right_m, dt_s)
            if reasons[i] == OK:
                rate = rates_rad_s[i] if len(rates_rad_s) else math.nan
                _step_each(states, parameters, left_m, right_m, dt_s, rate)
            elif reasons[i] != BACKWARDS:
                _widen_each(states, parameters, dt_s)
            if reasons[i] != BACKWARDS:
                last = i
        if len(rates_rad_s):
            state = states[likelier(states)]
        poses[i, 0], poses[i, 1], poses[i, 2] = state[at.X], state[at.Y], state[at.YAW]
        read_covariance(state, covariances[i])


# Fusion of wheels and gyroscope.
#
# A Kalman filter over the pose and constant errors: the gyroscope's bias b, the turn d per metre that the wheels miss
# (unequal radii), and the relative error s of their turns (track width). In a stretch of T seconds the gyroscope turns
# by Δ + b T + n, the wheels by Δ - d way - s turn + m. Their difference z ~ N(b T + d way + s turn, N² T + ρ M)
# measures these errors, and with them the noise m of the turn by which the wheels moved the pose. M is the wheels'
# variance by their calibration. Each stretch moves the pose by the known effect of the errors on it.
#
# The ratio ρ, the noise of the wheels on this floor, is estimated first, as a distribution over a few values (Magill
# 1965), by pairs of consecutive pieces: both have the same bias, so that their difference is noise alone. Otherwise a
# bias that is large for its calibration, with wheels better than theirs, would turn the pose. At rest the difference is
# the bias itself, and the pose stays.
#
# Two such filters run: one for wheels exactly as calibrated, one with unknown d and s. Unknown d and s would cost exact
# wheels accuracy, since a drive does not separate them from the bias; the likelihood decides.

PIECE_S = 0.2  # the noise exceeds a count, and the turn is still small
ENOUGH_PAIRS = 6  # determine the ratio within a factor of two: 2.4 s of driving
# From 2^-10, a thirtieth of the deviation, as of the simulator's wheels, to 2^10: symmetric, so that the calibration
# applies without pairs.
LOWEST_OCTAVE = -10
_NATS_AN_OCTAVE = 0.2  # prior of the ratio, per factor of two
_MOST_NATS = 4.0  # of one pair, such as that of spinning wheels
_KEPT = 0.98  # of the evidence of earlier pairs: a floor is forgotten in 20 s
_LATE_S = 0.01  # difference of the stamps, and delay of the base behind its tyres: a turn if the rate changes
_GATE = 10.83  # χ² of one number, 0.999: beyond it the wheels slip
_LONGEST_SLIP_S = 2.0  # in one direction without a break
_NATS_OF_LEAP = 12.0  # of an unexpected bias: wheels with a tenth of error are likelier
# Of wheels with errors: σ of drift and scale, and their random walk, as in the default filter.
_DRIFT_SIGMA_RAD_PER_M, _SCALE_SIGMA, _WALK = 0.02, 0.03, 0.0005
_DECISIVE = 4.0  # nats by which they must explain the drive better; noise reaches less


class GyroStep(NamedTuple):
    """A step of moving wheels: distance, turn, and the gyroscope's mean rate.

    `slip` is the variance of the turn, and its covariance with the distance; `along` is wx, wy, tx, ty, the directions
    in which the noise of distance and turn moves the pose.
    """

    dt_s: float
    way_m: float
    turn_rad: float
    rate_rad_s: float
    slip: tuple[float, float]
    along: tuple[float, float, float, float]


@kernel
def begin_off(states: FloatArray) -> None:
    """Begin the state of wheels with errors from that of exact ones: (2, STATE_SIZE)."""
    for k in range(states.shape[1]):
        states[at.OFF, k] = states[at.EXACT, k]
    states[at.OFF, at.DRIFT_VARIANCE], states[at.OFF, at.SCALE_VARIANCE] = _DRIFT_SIGMA_RAD_PER_M**2, _SCALE_SIGMA**2
    states[at.OFF, at.BEGUN] = 1.0


@kernel
def likelier(states: FloatArray) -> int:
    """Return the index of the likelier state."""
    lead = states[at.OFF, at.EVIDENCE] - states[at.EXACT, at.EVIDENCE]
    return at.OFF if states[at.OFF, at.BEGUN] > 0 and lead > _DECISIVE else at.EXACT


@kernel
def add_step(state: FloatArray, gyro_variance: float, count_variance: float, step: GyroStep) -> None:
    """Add a step of moving wheels to the stretch.

    The variances are those of the gyroscope in one second, and of a turn between two counts of the encoders.
    """
    dt_s, way_m, turn_rad, rate_rad_s, slip, along = step
    if state[at.STRETCH_S] > 0 and state[at.IS_REST] > 0:
        end_stretch(state, gyro_variance, count_variance)
    if state[at.STRETCH_S] == 0:
        state[at.FIRST_RATE] = rate_rad_s
    if state[at.PIECE_S] == 0:
        state[at.PIECE_FIRST_RATE] = rate_rad_s
    state[at.IS_REST], state[at.LAST_RATE] = 0.0, rate_rad_s
    apart_rad = rate_rad_s * dt_s - turn_rad
    for first in (at.STRETCH_S, at.PIECE_S):
        state[first] += dt_s
        state[first + 1] += apart_rad
        state[first + 2] += slip[0]
        state[first + 3] += way_m
        state[first + 4] += turn_rad
    wx, wy, tx, ty = along
    add_outer(state, at.SLIP_COVARIANCE, slip[0], tx, ty, 1.0)
    add_shared(state, at.SHARED_COVARIANCE, slip[1], wx, wy, tx, ty)
    state[at.SLIP_WITH_TURN] += slip[0] * tx
    state[at.SLIP_WITH_TURN + 1] += slip[0] * ty
    state[at.SLIP_WITH_TURN + 2] += slip[0]
    state[at.SHARED_WITH_TURN] += slip[1] * wx
    state[at.SHARED_WITH_TURN + 1] += slip[1] * wy
    for i in range(3):
        t = along[2 + i] if i < 2 else 1.0
        state[at.BY_DRIFT + i] += way_m * t
        state[at.BY_SCALE + i] += turn_rad * t
    if state[at.PIECE_S] >= PIECE_S:
        change = rate_rad_s - state[at.PIECE_FIRST_RATE]
        known = _known(gyro_variance, count_variance, state[at.PIECE_S], change)
        if state[at.BEFORE_S] > 0 and state[at.PIECE_SLIP] > 0 and state[at.BEFORE_SLIP] > 0:
            _learn_ratio(state, known)
            state[at.BEFORE_S] = 0.0
        else:
            for i in range(5):
                state[at.BEFORE_S + i] = state[at.PIECE_S + i]
            state[at.BEFORE_KNOWN] = known
        for i in range(5):
            state[at.PIECE_S + i] = 0.0
        if state[at.PAIRS] >= ENOUGH_PAIRS:
            end_stretch(state, gyro_variance, count_variance)


@kernel
def add_rest(state: FloatArray, gyro_variance: float, count_variance: float, dt_s: float, turn_rad: float) -> None:
    """Add a step of wheels at rest, in which the gyroscope turned."""
    if state[at.STRETCH_S] > 0 and state[at.IS_REST] == 0:
        end_stretch(state, gyro_variance, count_variance)
    state[at.IS_REST] = 1.0
    state[at.STRETCH_S] += dt_s
    state[at.APART] += turn_rad
    if state[at.STRETCH_S] >= PIECE_S:
        end_stretch(state, gyro_variance, count_variance)


@kernel
def end_stretch(state: FloatArray, gyro_variance: float, count_variance: float) -> None:
    """Update by the stretch; the pose follows the wheels alone while their noise is unknown."""
    if state[at.STRETCH_S] > 0 and state[at.IS_REST] > 0:
        # At rest the bias is measured: the pose stays, and its uncertainty by the bias shrinks.
        seconds = state[at.STRETCH_S]
        H = np.array([seconds, 0.0, 0.0])
        with_pose = seconds * state[at.WITH_ERRORS : at.WITH_ERRORS + 9 : 3]
        S = gyro_variance * seconds + seconds**2 * state[at.BIAS_VARIANCE]
        _learn(state, H, S, with_pose, state[at.APART] - state[at.BIAS] * seconds)
    elif state[at.STRETCH_S] > 0 and state[at.PAIRS] >= ENOUGH_PAIRS:
        _join(state, gyro_variance, count_variance)
    elif state[at.STRETCH_S] > 0:
        _settle(state, state[at.RATIO])
    for i in range(at.STRETCH_S, at.LAST_RATE + 1):
        state[i] = 0.0


@kernel
def _learn(state: FloatArray, H: FloatArray, S: float, with_pose: FloatArray, off: float) -> None:
    """Kalman update of the errors by a difference; `with_pose` (3,) is its covariance with the pose."""
    P = state[at.ERRORS_COVARIANCE : at.ERRORS_COVARIANCE + 9].reshape(3, 3)
    C = state[at.WITH_ERRORS : at.WITH_ERRORS + 9].reshape(3, 3)
    gain = np.zeros(3)
    for i in range(3):
        gain[i] = (P[i, 0] * H[0] + P[i, 1] * H[1] + P[i, 2] * H[2]) / S
    for i in range(3):
        state[at.BIAS + i] += gain[i] * off
        for j in range(3):
            P[i, j] -= gain[i] * gain[j] * S
            C[i, j] -= with_pose[i] * gain[j]


@kernel
def _settle(state: FloatArray, ratio: float) -> None:
    """Add the stretch's noise to the pose's, for wheels with `ratio` times the calibration's variance."""
    for i in range(6):
        state[at.COVARIANCE + i] += ratio * state[at.SLIP_COVARIANCE + i]
        state[at.COVARIANCE + i] += math.sqrt(ratio) * state[at.SHARED_COVARIANCE + i]


@kernel
def _add_errors(state: FloatArray) -> None:
    """Add the displacement of the pose by drift and scale in the stretch; both walk randomly with the distance."""
    P = state[at.ERRORS_COVARIANCE : at.ERRORS_COVARIANCE + 9].reshape(3, 3)
    C = state[at.WITH_ERRORS : at.WITH_ERRORS + 9].reshape(3, 3)
    for a in range(2):
        P[1 + a, 1 + a] += _WALK**2 * abs(state[at.WAY]) * state[at.BEGUN]
        by = state[at.BY_DRIFT + 3 * a : at.BY_DRIFT + 3 * a + 3]
        add_product(state, 1.0, by, C[:, 1 + a].copy())
        for i in range(3):
            for j in range(3):
                C[i, j] += by[i] * P[1 + a, j]
        add_product(state, 0.5 * P[1 + a, 1 + a], by, by)


@kernel
def _join(state: FloatArray, gyro_variance: float, count_variance: float) -> None:
    """Kalman update of pose and errors by the difference of wheels and gyroscope."""
    _add_errors(state)
    seconds, slip, ratio = state[at.STRETCH_S], state[at.SLIP], state[at.RATIO]
    H = np.array([seconds, state[at.WAY], state[at.TURN]])
    known = _known(gyro_variance, count_variance, seconds, state[at.LAST_RATE] - state[at.FIRST_RATE])
    known += _unsure(state, H)
    off = state[at.APART] - state[at.BIAS] * seconds
    if off**2 > _GATE * (known + ratio * slip) and slip > 0:
        went = state[at.SLIPPING_S] if off * state[at.SLIPPING_S] > 0 else 0.0
        state[at.SLIPPING_S] = went + math.copysign(seconds, off)
        if abs(state[at.SLIPPING_S]) > _LONGEST_SLIP_S:
            # No slip lasts that long: the bias is larger than stated.
            state[at.BIAS_VARIANCE] += (off / seconds) ** 2
            known += off**2
            state[at.SLIPPING_S] = 0.0
            state[at.EVIDENCE] -= _NATS_OF_LEAP
        else:
            # A slip beyond the usual noise: the ratio of this stretch explains it.
            ratio = (off**2 - known) / slip
    else:
        state[at.SLIPPING_S] = 0.0
    S = known + ratio * slip
    state[at.EVIDENCE] -= 0.5 * (off**2 / S + math.log(S))
    state[at.CORRECTION] = _covariance_of_turn(state, H, ratio) / S * off
    _settle(state, ratio)
    C = state[at.WITH_ERRORS : at.WITH_ERRORS + 9].reshape(3, 3)
    with_pose, gain = np.zeros(3), np.zeros(3)
    for i in range(3):
        with_pose[i] = C[i, 0] * H[0] + C[i, 1] * H[1] + C[i, 2] * H[2] + ratio * state[at.SLIP_WITH_TURN + i]
        # Distances stay, though they share noise with turns: a gain correlated with the travels that it weights would
        # shorten every distance.
        gain[i] = with_pose[i] / S
        if i < 2:
            with_pose[i] += math.sqrt(ratio) * state[at.SHARED_WITH_TURN + i]
    add_product(state, 0.5 * S, gain, gain)
    add_product(state, -1.0, gain, with_pose)
    _learn(state, H, S, with_pose, off)
    _perturb(state, gain[0] * off, gain[1] * off, gain[2] * off)


@kernel
def _covariance_of_turn(state: FloatArray, H: FloatArray, ratio: float) -> float:
    """Covariance of the stretch's own turn, without the path before, with the difference of wheels and gyroscope."""
    P = state[at.ERRORS_COVARIANCE : at.ERRORS_COVARIANCE + 9].reshape(3, 3)
    with_pose: float = ratio * state[at.SLIP_WITH_TURN + 2]
    for i in range(1, 3):
        with_pose += H[i] * (P[i, 0] * H[0] + P[i, 1] * H[1] + P[i, 2] * H[2])
    return with_pose


@kernel
def _unsure(state: FloatArray, H: FloatArray) -> float:
    """Variance of the errors along H (3,)."""
    P = state[at.ERRORS_COVARIANCE : at.ERRORS_COVARIANCE + 9].reshape(3, 3)
    variance = 0.0
    for i in range(3):
        for j in range(3):
            variance += H[i] * P[i, j] * H[j]
    return variance


@kernel
def _perturb(state: FloatArray, vx: float, vy: float, turn_rad: float) -> None:
    """T ← exp(vx, vy, ω) T."""
    half = turn_rad / 2
    chord = math.sin(half) / half if abs(half) > 1e-6 else 1.0
    ch, sh = math.cos(half), math.sin(half)
    c, s, x, y = math.cos(turn_rad), math.sin(turn_rad), state[at.X], state[at.Y]
    state[at.X] = c * x - s * y + chord * (ch * vx - sh * vy)
    state[at.Y] = s * x + c * y + chord * (sh * vx + ch * vy)
    yaw_rad = state[at.YAW] + turn_rad
    state[at.YAW] = math.atan2(math.sin(yaw_rad), math.cos(yaw_rad)) if abs(yaw_rad) > math.pi else yaw_rad


@kernel
def _known(gyro_variance: float, count_variance: float, seconds: float, change_rad_s: float) -> float:
    """Variance of the difference without bias and slip, for a change of the rate."""
    return gyro_variance * seconds + count_variance + (_LATE_S * change_rad_s) ** 2


@kernel
def _learn_ratio(state: FloatArray, known: float) -> None:
    """Update the distribution of the ratio by the difference of two pieces in their apparent bias."""
    one_s, other_s = state[at.PIECE_S], state[at.BEFORE_S]
    off2 = (state[at.PIECE_APART] / one_s - state[at.BEFORE_APART] / other_s) ** 2
    H = np.zeros(3)
    for i in range(1, 3):
        H[i] = state[at.PIECE_WAY + i - 1] / one_s - state[at.BEFORE_WAY + i - 1] / other_s
    known = known / one_s**2 + state[at.BEFORE_KNOWN] / other_s**2 + _unsure(state, H)
    slip = state[at.PIECE_SLIP] / one_s**2 + state[at.BEFORE_SLIP] / other_s**2
    nats, likely, best = state[at.NATS : at.NATS + at.RATIOS], np.empty(at.RATIOS), -math.inf
    for i in range(at.RATIOS):
        S = known + 2.0 ** (i + LOWEST_OCTAVE) * slip
        likely[i] = -0.5 * (off2 / S + math.log(S))
        best = max(best, likely[i])
    weight, octave, likeliest = 0.0, 0.0, -math.inf
    for i in range(at.RATIOS):
        nats[i] = _KEPT * nats[i] + max(likely[i] - best, -_MOST_NATS)
        likely[i] = nats[i] - _NATS_AN_OCTAVE * abs(i + LOWEST_OCTAVE)
        likeliest = max(likeliest, likely[i])
    for i in range(at.RATIOS):
        w = math.exp(likely[i] - likeliest)
        weight += w
        octave += w * (i + LOWEST_OCTAVE)
    state[at.PAIRS] += 1.0
    if state[at.PAIRS] >= ENOUGH_PAIRS:
        state[at.RATIO] = 2.0 ** (octave / weight)
