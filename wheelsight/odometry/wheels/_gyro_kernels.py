"""Wheels and gyroscope joined: the bias, how noisy the wheels are, and the turn by both; numba over arrays.

A Kalman filter over the pose and what is wrong all the time: the gyroscope's bias b, and of the wheels the turn d that
they miss in a metre (unequal radii) and the ratio s by which they turn too little (track width). Over a stretch of T
seconds the gyroscope turns by Δ + b T + n, the wheels by Δ - d way - s turn + m, so that their difference
z ~ N(b T + d way + s turn, N² T + ρ M) measures these, and with them the noise m of the turn by which the wheels have
moved the pose; M is the wheels' variance by their calibration. Each stretch moves the pose by all that is known of how
such errors went into it.

The ratio ρ, how noisy the wheels are on this floor, is told by pairs of pieces that follow each other: of them the bias
is the same, so that their difference tells of noise alone, as a distribution over a few values (Magill 1965). It comes
first: a bias that is large for its calibration, against wheels that hold better than theirs says, would turn the pose.
While the wheels stand still the difference is the bias itself, and the pose stays.

Two such filters run: one of wheels that are exactly as calibrated, one in which d and s are unknown. Were these always
reckoned with, exact wheels would lose by what a drive cannot tell from the bias; the evidence decides.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

import wheelsight.odometry.wheels._state_kernels as at
from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import FloatArray
from wheelsight.odometry.wheels._state_kernels import add_outer, add_product, add_shared

# Long enough that noise is more than a count, short enough that a turn is not far off meanwhile.
PIECE_S = 0.2
# So many pairs tell the ratio within a factor of two: 2.4 s of driving.
ENOUGH_PAIRS = 6
# From 2^-10, a thirtieth of the deviation (so much better than stated the simulator's wheels hold), to 2^10: alike to
# both sides, so that the calibration stands where nothing is told of it.
LOWEST_OCTAVE = -10
_NATS_AN_OCTAVE = 0.2  # by which a calibration that is wrong by a factor of two is less likely
_MOST_NATS = 4.0  # of one pair: wheels that spun are one
_KEPT = 0.98  # of what pairs have told, after the next: a floor is left behind in 20 s
# The stamps of both may be so far apart, and a base follows its tyres late: where the rate changes, that is a turn.
_LATE_S = 0.01
_GATE = 10.83  # χ² of one number, 0.999: beyond it the wheels have slipped
_LONGEST_SLIP_S = 2.0  # to one side without a break
_NATS_OF_LEAP = 12.0  # of a bias that is none of those expected: wheels that are a tenth off are likelier
# Of wheels that are off: the turn that they miss in a metre, the ratio they turn too little by, how both wander.
_DRIFT_SIGMA_RAD_PER_M, _SCALE_SIGMA, _WALK = 0.02, 0.03, 0.0005  # as the default filter has it
# Nats by which they must explain the drive better: less is what noise does, and exact wheels are the better for it.
_DECISIVE = 4.0


class Step(NamedTuple):
    """A step of moving wheels: their way and turn, and the gyroscope's mean rate meanwhile.

    `slip` is the variance of the turn, and what it shares with the way; `along` is wx, wy, tx, ty, where the noise of
    way and turn moves the pose.
    """

    dt_s: float
    way_m: float
    turn_rad: float
    rate_rad_s: float
    slip: tuple[float, float]
    along: tuple[float, float, float, float]


@kernel
def begin_off(states: FloatArray) -> None:
    """Go on for wheels that are off, too, from where exact ones are: (2, STATE_SIZE)."""
    states[at.OFF] = states[at.EXACT]
    states[at.OFF, at.DRIFT_VARIANCE], states[at.OFF, at.SCALE_VARIANCE] = _DRIFT_SIGMA_RAD_PER_M**2, _SCALE_SIGMA**2
    states[at.OFF, at.BEGUN] = 1.0


@kernel
def likelier(states: FloatArray) -> int:
    """Which of both states the drive speaks for."""
    lead = states[at.OFF, at.EVIDENCE] - states[at.EXACT, at.EVIDENCE]
    return at.OFF if states[at.OFF, at.BEGUN] > 0 and lead > _DECISIVE else at.EXACT


@kernel
def add_step(state: FloatArray, gyro_variance: float, count_variance: float, step: Step) -> None:
    """Take a step of moving wheels into the stretch.

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
    _add_noise(state, slip, along)
    for i in range(3):
        t = along[2 + i] if i < 2 else 1.0
        state[at.BY_DRIFT + i] += way_m * t
        state[at.BY_SCALE + i] += turn_rad * t
    if state[at.PIECE_S] >= PIECE_S:
        change = rate_rad_s - state[at.PIECE_FIRST_RATE]
        _end_piece(state, _known(gyro_variance, count_variance, state[at.PIECE_S], change))
        if state[at.PAIRS] >= ENOUGH_PAIRS:
            end_stretch(state, gyro_variance, count_variance)


@kernel
def _add_noise(state: FloatArray, slip: tuple[float, float], along: tuple[float, float, float, float]) -> None:
    turn_variance, shared = slip
    wx, wy, tx, ty = along
    add_outer(state, at.SLIP_COVARIANCE, turn_variance, tx, ty, 1.0)
    add_shared(state, at.SHARED_COVARIANCE, shared, wx, wy, tx, ty)
    state[at.SLIP_WITH_TURN] += turn_variance * tx
    state[at.SLIP_WITH_TURN + 1] += turn_variance * ty
    state[at.SLIP_WITH_TURN + 2] += turn_variance
    state[at.SHARED_WITH_TURN] += shared * wx
    state[at.SHARED_WITH_TURN + 1] += shared * wy


@kernel
def add_rest(state: FloatArray, gyro_variance: float, count_variance: float, dt_s: float, turn_rad: float) -> None:
    """Take a step of wheels that stand still, in which the gyroscope turned."""
    if state[at.STRETCH_S] > 0 and state[at.IS_REST] == 0:
        end_stretch(state, gyro_variance, count_variance)
    state[at.IS_REST] = 1.0
    state[at.STRETCH_S] += dt_s
    state[at.APART] += turn_rad
    if state[at.STRETCH_S] >= PIECE_S:
        end_stretch(state, gyro_variance, count_variance)


@kernel
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


@kernel
def _learn_bias(state: FloatArray, gyro_variance: float) -> None:
    """By a gyroscope at rest: the pose stays, which is then less uncertain by the bias."""
    seconds = state[at.STRETCH_S]
    H = np.array([seconds, 0.0, 0.0])
    told = seconds * state[at.WITH_ERRORS : at.WITH_ERRORS + 9 : 3]
    S = gyro_variance * seconds + seconds**2 * state[at.BIAS_VARIANCE]
    _learn(state, H, S, told, state[at.APART] - state[at.BIAS] * seconds)


@kernel
def _learn(state: FloatArray, H: FloatArray, S: float, told: FloatArray, off: float) -> None:
    """The Kalman update of the errors, by a difference of which `told` (3,) is the covariance with the pose."""
    P = state[at.ERRORS_COVARIANCE : at.ERRORS_COVARIANCE + 9].reshape(3, 3)
    C = state[at.WITH_ERRORS : at.WITH_ERRORS + 9].reshape(3, 3)
    gain = np.zeros(3)
    for i in range(3):
        gain[i] = (P[i, 0] * H[0] + P[i, 1] * H[1] + P[i, 2] * H[2]) / S
    for i in range(3):
        state[at.BIAS + i] += gain[i] * off
        for j in range(3):
            P[i, j] -= gain[i] * gain[j] * S
            C[i, j] -= told[i] * gain[j]


@kernel
def _settle(state: FloatArray, ratio: float) -> None:
    """Add the stretch's noise to the pose's, of wheels whose variance is `ratio` times the calibration's."""
    for i in range(6):
        state[at.COVARIANCE + i] += ratio * state[at.SLIP_COVARIANCE + i]
        state[at.COVARIANCE + i] += math.sqrt(ratio) * state[at.SHARED_COVARIANCE + i]


@kernel
def _go_astray(state: FloatArray) -> None:
    """Let the pose err by what drift and scale have moved it in the stretch; both wander with the way."""
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
    """The Kalman update of pose and errors by how far wheels and gyroscope are apart."""
    _go_astray(state)
    seconds, slip, ratio = state[at.STRETCH_S], state[at.SLIP], state[at.RATIO]
    H = np.array([seconds, state[at.WAY], state[at.TURN]])
    known = _known(gyro_variance, count_variance, seconds, state[at.LAST_RATE] - state[at.FIRST_RATE])
    known += _unsure(state, H)
    off = state[at.APART] - state[at.BIAS] * seconds
    if off**2 > _GATE * (known + ratio * slip) and slip > 0:
        went = state[at.ASTRAY_S] if off * state[at.ASTRAY_S] > 0 else 0.0
        state[at.ASTRAY_S] = went + math.copysign(seconds, off)
        if abs(state[at.ASTRAY_S]) > _LONGEST_SLIP_S:
            # That is no slip: a bias is but expected to be as small as stated.
            state[at.BIAS_VARIANCE] += (off / seconds) ** 2
            known += off**2
            state[at.ASTRAY_S] = 0.0
            state[at.EVIDENCE] -= _NATS_OF_LEAP
        else:
            # Wheels slip now and then by more than they do all the time: as far as they did here.
            ratio = (off**2 - known) / slip
    else:
        state[at.ASTRAY_S] = 0.0
    S = known + ratio * slip
    state[at.EVIDENCE] -= 0.5 * (off**2 / S + math.log(S))
    state[at.TOLD] = _told_of_stretch(state, H, ratio) / S * off
    _settle(state, ratio)
    C = state[at.WITH_ERRORS : at.WITH_ERRORS + 9].reshape(3, 3)
    told, gain = np.zeros(3), np.zeros(3)
    for i in range(3):
        told[i] = C[i, 0] * H[0] + C[i, 1] * H[1] + C[i, 2] * H[2] + ratio * state[at.SLIP_WITH_TURN + i]
        # Ways are left as they are, though they share noise with turns: a gain that goes along with the very travels it
        # weighs by shortens every way.
        gain[i] = told[i] / S
        if i < 2:
            told[i] += math.sqrt(ratio) * state[at.SHARED_WITH_TURN + i]
    add_product(state, 0.5 * S, gain, gain)
    add_product(state, -1.0, gain, told)
    _learn(state, H, S, told, off)
    _perturb(state, gain[0] * off, gain[1] * off, gain[2] * off)


@kernel
def _told_of_stretch(state: FloatArray, H: FloatArray, ratio: float) -> float:
    """Covariance of the stretch's own turn, without the way before, with how far wheels and gyroscope are apart."""
    P = state[at.ERRORS_COVARIANCE : at.ERRORS_COVARIANCE + 9].reshape(3, 3)
    told: float = ratio * state[at.SLIP_WITH_TURN + 2]
    for i in range(1, 3):
        told += H[i] * (P[i, 0] * H[0] + P[i, 1] * H[1] + P[i, 2] * H[2])
    return told


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
    """Variance of what both turn apart, but for the bias and the wheels' slip, while the rate changes so much."""
    return gyro_variance * seconds + count_variance + (_LATE_S * change_rad_s) ** 2


@kernel
def _end_piece(state: FloatArray, known: float) -> None:
    if state[at.BEFORE_S] > 0 and state[at.PIECE_SLIP] > 0 and state[at.BEFORE_SLIP] > 0:
        _learn_ratio(state, known)
        state[at.BEFORE_S] = 0.0
    else:
        for i in range(5):
            state[at.BEFORE_S + i] = state[at.PIECE_S + i]
        state[at.BEFORE_KNOWN] = known
    for i in range(5):
        state[at.PIECE_S + i] = 0.0


@kernel
def _learn_ratio(state: FloatArray, known: float) -> None:
    """By how two pieces differ in what seems to be the bias."""
    one_s, other_s = state[at.PIECE_S], state[at.BEFORE_S]
    off2 = (state[at.PIECE_APART] / one_s - state[at.BEFORE_APART] / other_s) ** 2
    H = np.zeros(3)
    for i in range(1, 3):
        H[i] = state[at.PIECE_WAY + i - 1] / one_s - state[at.BEFORE_WAY + i - 1] / other_s
    known = known / one_s**2 + state[at.BEFORE_KNOWN] / other_s**2 + _unsure(state, H)
    slip = state[at.PIECE_SLIP] / one_s**2 + state[at.BEFORE_SLIP] / other_s**2
    nats, likely = state[at.NATS : at.NATS + at.RATIOS], np.empty(at.RATIOS)
    for i in range(at.RATIOS):
        S = known + 2.0 ** (i + LOWEST_OCTAVE) * slip
        likely[i] = -0.5 * (off2 / S + math.log(S))
    best = likely.max()
    for i in range(at.RATIOS):
        nats[i] = _KEPT * nats[i] + max(likely[i] - best, -_MOST_NATS)
        likely[i] = nats[i] - _NATS_AN_OCTAVE * abs(i + LOWEST_OCTAVE)
    weight, octave, best = 0.0, 0.0, likely.max()
    for i in range(at.RATIOS):
        w = math.exp(likely[i] - best)
        weight += w
        octave += w * (i + LOWEST_OCTAVE)
    state[at.PAIRS] += 1.0
    if state[at.PAIRS] >= ENOUGH_PAIRS:
        state[at.RATIO] = 2.0 ** (octave / weight)
