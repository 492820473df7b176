"""Wheels and gyroscope joined: the bias, how noisy the wheels are, and the turn by both; numba over arrays.

A Kalman filter over the pose and the gyroscope's bias b. Over a stretch of T seconds the gyroscope turns by Δ + b T + n
and the wheels by Δ + m, so that their difference z measures b, and with it the noise m of the turn by which the wheels
have moved the pose: z ~ N(b T, N² T + ρ M), with M the wheels' variance by their calibration. What a stretch tells
moves the pose by all that it knows of how that turn, and the bias before, went into it.

The ratio ρ, how noisy the wheels are on this floor, is told by pairs of pieces that follow each other: of them the bias
is the same, so that their difference tells of noise alone, as a distribution over a few values (Magill 1965). It comes
first: a bias that is large for its calibration, against wheels that hold better than theirs says, would turn the pose.
While the wheels stand still the difference is the bias itself, and the pose stays.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from wheelsight.geometry import FloatArray
import wheelsight.odometry.wheels._state_kernels as at
from wheelsight.odometry.wheels._state_kernels import add_outer, add_shared

_COMPILED_IN = 0x3F183CF3

# Long enough that noise is more than a count, short enough that a turn is not far off meanwhile.
PIECE_S = 0.2
# So many pairs tell the ratio within a factor of two: 2.4 s of driving.
ENOUGH_PAIRS = 6
# 2^-10, a thirtieth of the deviation, to 2^4, four times it: the simulator's wheels hold thirty times as well as stated.
LOWEST_OCTAVE = -10
_NATS_AN_OCTAVE = 0.2  # by which a calibration that is wrong by a factor of two is less likely
_MOST_NATS = 4.0  # of one pair: wheels that spun are one
_KEPT = 0.98  # of what pairs have told, after the next: a floor is left behind in 20 s
# The stamps of both may be so far apart, and a base follows its tyres late: where the rate changes, that is a turn.
_LATE_S = 0.02
_GATE = 10.83  # χ² of one number, 0.999: beyond it the wheels have slipped


@njit(cache=True, nogil=True)
def add_step(
    state: FloatArray,
    gyro_variance: float,
    count_variance: float,
    dt_s: float,
    turn_rad: float,
    rate_rad_s: float,
    slip: tuple[float, float],
    along: tuple[float, float, float, float],
) -> None:
    """Take a step of moving wheels into the stretch, with their turn and the gyroscope's rate.

    slip: variance of the turn, and what it shares with the way. along: wx, wy, tx, ty. The variances are those of the
    gyroscope in one second, and of a turn between two counts of the encoders.
    """
    if state[at.STRETCH_S] > 0 and state[at.IS_REST] > 0:
        end_stretch(state, gyro_variance, count_variance)
    turn_variance, shared = slip
    wx, wy, tx, ty = along
    apart_rad = rate_rad_s * dt_s - turn_rad
    if state[at.STRETCH_S] == 0:
        state[at.FIRST_RATE] = rate_rad_s
    if state[at.PIECE_S] == 0:
        state[at.PIECE_FIRST_RATE] = rate_rad_s
    state[at.IS_REST], state[at.LAST_RATE] = 0.0, rate_rad_s
    state[at.STRETCH_S] += dt_s
    state[at.APART] += apart_rad
    state[at.SLIP] += turn_variance
    add_outer(state, at.SLIP_COVARIANCE, turn_variance, tx, ty, 1.0)
    add_shared(state, at.SHARED_COVARIANCE, shared, wx, wy, tx, ty)
    state[at.SLIP_WITH_TURN] += turn_variance * tx
    state[at.SLIP_WITH_TURN + 1] += turn_variance * ty
    state[at.SLIP_WITH_TURN + 2] += turn_variance
    state[at.SHARED_WITH_TURN] += shared * wx
    state[at.SHARED_WITH_TURN + 1] += shared * wy
    state[at.PIECE_S] += dt_s
    state[at.PIECE_APART] += apart_rad
    state[at.PIECE_SLIP] += turn_variance
    if state[at.PIECE_S] >= PIECE_S:
        _end_piece(state, _known(gyro_variance, count_variance, state[at.PIECE_S], rate_rad_s - state[at.PIECE_FIRST_RATE]))
        if state[at.PAIRS] >= ENOUGH_PAIRS:
            end_stretch(state, gyro_variance, count_variance)


@njit(cache=True, nogil=True)
def add_rest(state: FloatArray, gyro_variance: float, count_variance: float, dt_s: float, turn_rad: float) -> None:
    """Take a step of wheels that stand still, in which the gyroscope turned."""
    if state[at.STRETCH_S] > 0 and state[at.IS_REST] == 0:
        end_stretch(state, gyro_variance, count_variance)
    state[at.IS_REST] = 1.0
    state[at.STRETCH_S] += dt_s
    state[at.APART] += turn_rad
    if state[at.STRETCH_S] >= PIECE_S:
        end_stretch(state, gyro_variance, count_variance)


@njit(cache=True, nogil=True)
def end_stretch(state: FloatArray, gyro_variance: float, count_variance: float) -> None:
    """Join what both have told; the pose as the wheels alone have it where nothing is known of their noise yet."""
    if state[at.STRETCH_S] > 0 and state[at.IS_REST] > 0:
        _learn_bias(state, gyro_variance)
    elif state[at.STRETCH_S] > 0 and state[at.PAIRS] >= ENOUGH_PAIRS:
        _join(state, gyro_variance, count_variance)
    elif state[at.STRETCH_S] > 0:
        _settle(state, state[at.RATIO])
    for i in range(at.STRETCH_S, at.LAST_RATE + 1):
        state[i] = 0.0


@njit(cache=True, nogil=True)
def _learn_bias(state: FloatArray, gyro_variance: float) -> None:
    """By a gyroscope at rest: the pose stays, which is then less uncertain by the bias."""
    seconds, variance = state[at.STRETCH_S], state[at.BIAS_VARIANCE]
    gain = variance * seconds / (variance * seconds**2 + gyro_variance * seconds)
    state[at.BIAS] += gain * (state[at.APART] - state[at.BIAS] * seconds)
    state[at.BIAS_VARIANCE] = (1 - gain * seconds) * variance
    for i in range(at.WITH_BIAS, at.WITH_BIAS + 3):
        state[i] *= 1 - gain * seconds


@njit(cache=True, nogil=True)
def _settle(state: FloatArray, ratio: float) -> None:
    """Add the stretch's noise to the pose's, of wheels whose variance is `ratio` times the calibration's."""
    for i in range(6):
        state[at.COVARIANCE + i] += ratio * state[at.SLIP_COVARIANCE + i]
        state[at.COVARIANCE + i] += math.sqrt(ratio) * state[at.SHARED_COVARIANCE + i]


@njit(cache=True, nogil=True)
def _join(state: FloatArray, gyro_variance: float, count_variance: float) -> None:
    seconds, variance, ratio = state[at.STRETCH_S], state[at.BIAS_VARIANCE], state[at.RATIO]
    known = variance * seconds**2
    known += _known(gyro_variance, count_variance, seconds, state[at.LAST_RATE] - state[at.FIRST_RATE])
    off = state[at.APART] - state[at.BIAS] * seconds
    if off**2 > _GATE * (known + ratio * state[at.SLIP]) and state[at.SLIP] > 0:
        # Wheels slip now and then by more than they do all the time: as far as they did here.
        ratio = (off**2 - known) / state[at.SLIP]
    S = known + ratio * state[at.SLIP]
    _settle(state, ratio)
    told, gain = np.zeros(3), np.zeros(3)  # of the pose with the difference; the gain leaves ways as they are, as a gain
    # that goes along with the very travels it weighs by shortens every way
    for i in range(3):
        gain[i] = (seconds * state[at.WITH_BIAS + i] + ratio * state[at.SLIP_WITH_TURN + i]) / S
        told[i] = gain[i] * S + (math.sqrt(ratio) * state[at.SHARED_WITH_TURN + i] if i < 2 else 0.0)
    place = at.COVARIANCE
    for i in range(3):
        for j in range(i, 3):
            state[place] += gain[i] * gain[j] * S - gain[i] * told[j] - told[i] * gain[j]
            place += 1
    of_bias = variance * seconds / S
    for i in range(3):
        state[at.WITH_BIAS + i] -= told[i] * of_bias
    state[at.BIAS] += of_bias * off
    state[at.BIAS_VARIANCE] = variance * (1 - of_bias * seconds)
    _perturb(state, gain[0] * off, gain[1] * off, gain[2] * off)


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _known(gyro_variance: float, count_variance: float, seconds: float, change_rad_s: float) -> float:
    """Variance of what both turn apart, but for the bias and the wheels' slip, while the rate changes so much."""
    return gyro_variance * seconds + count_variance + (_LATE_S * change_rad_s) ** 2


@njit(cache=True, nogil=True)
def _end_piece(state: FloatArray, known: float) -> None:
    if state[at.BEFORE_S] > 0 and state[at.PIECE_SLIP] > 0 and state[at.BEFORE_SLIP] > 0:
        _learn_ratio(state, known)
        state[at.BEFORE_S] = 0.0
    else:
        for i in range(3):
            state[at.BEFORE_S + i] = state[at.PIECE_S + i]
        state[at.BEFORE_KNOWN] = known
    for i in range(4):
        state[at.PIECE_S + i] = 0.0


@njit(cache=True, nogil=True)
def _learn_ratio(state: FloatArray, known: float) -> None:
    """By how two pieces differ in what seems to be the bias."""
    one_s, other_s = state[at.PIECE_S], state[at.BEFORE_S]
    off2 = (state[at.PIECE_APART] / one_s - state[at.BEFORE_APART] / other_s) ** 2
    known = known / one_s**2 + state[at.BEFORE_KNOWN] / other_s**2
    slip = state[at.PIECE_SLIP] / one_s**2 + state[at.BEFORE_SLIP] / other_s**2
    likely = np.empty(at.RATIOS)
    for i in range(at.RATIOS):
        S = known + 2.0 ** (i + LOWEST_OCTAVE) * slip
        likely[i] = -0.5 * (off2 / S + math.log(S))
    nats = state[at.NATS : at.NATS + at.RATIOS]
    for i in range(at.RATIOS):
        nats[i] = _KEPT * nats[i] + max(likely[i] - likely.max(), -_MOST_NATS)
    weight = octave = 0.0
    most = _prior(0) + nats[0]
    for i in range(at.RATIOS):
        most = max(most, _prior(i) + nats[i])
    for i in range(at.RATIOS):
        w = math.exp(_prior(i) + nats[i] - most)
        weight += w
        octave += w * (i + LOWEST_OCTAVE)
    state[at.PAIRS] += 1.0
    if state[at.PAIRS] >= ENOUGH_PAIRS:
        state[at.RATIO] = 2.0 ** (octave / weight)


@njit(cache=True, nogil=True)
def _prior(i: int) -> float:
    return -_NATS_AN_OCTAVE * abs(i + LOWEST_OCTAVE)
