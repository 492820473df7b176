"""Where the numbers of a dead reckoning's state stand; numba over arrays.

The covariance is that of the left perturbation (vx, vy, ω) of T_odom_base: there, a step only adds to it, and what was
uncertain before stays as it is. An error is what is true less what is thought.
"""

from __future__ import annotations

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import FloatArray

X, Y, YAW = 0, 1, 2
COVARIANCE = 3  # xx, xy, xω, yy, yω, ωω
# What a gyroscope and wheels have wrong: its bias, the turn a metre that wheels miss, the ratio by which they turn too
# little; the covariance (3, 3) of their errors, and that (3, 3) of the pose's errors with them.
BIAS, DRIFT, SCALE = 9, 10, 11
BIAS_VARIANCE, DRIFT_VARIANCE, SCALE_VARIANCE = 12, 16, 20
ERRORS_COVARIANCE, WITH_ERRORS = 12, 21
IS_STILL, SPEED, YAW_RATE = 30, 31, 32
# A stretch: what wheels and gyroscope told since both were last joined; seconds, the gyroscope's turn less the wheels',
# variance of the wheels' turn by their calibration, way and turn.
STRETCH_S, APART, SLIP, WAY, TURN = 33, 34, 35, 36, 37
# Noise of its turns moves the pose along (tx, ty, 1), that of its ways along (wx, wy, 0): covariance of the pose by
# turns, and by what turns and ways share; covariance of (x, y, ω), (x, y) with the turn; what drift and scale move.
SLIP_COVARIANCE, SHARED_COVARIANCE = 38, 44
SLIP_WITH_TURN, SHARED_WITH_TURN = 50, 53
BY_DRIFT, BY_SCALE = 55, 58
IS_REST, FIRST_RATE, LAST_RATE = 61, 62, 63  # at its begin and end, by the gyroscope
# Two pieces in a row, of which the bias is the same: they tell how noisy wheels are that differ from the gyroscope.
PIECE_S, PIECE_APART, PIECE_SLIP, PIECE_WAY, PIECE_TURN, PIECE_FIRST_RATE = 64, 65, 66, 67, 68, 69
BEFORE_S, BEFORE_APART, BEFORE_SLIP, BEFORE_WAY, BEFORE_TURN, BEFORE_KNOWN = 70, 71, 72, 73, 74, 75
PAIRS, RATIO = 76, 77
EVIDENCE, BEGUN = 78, 79
TURNED = 80  # in the last step, by the calibration
ASTRAY_S = 81  # for so long in a row both were too far apart; its sign is which way
NATS, RATIOS = 82, 21
TOLD = NATS + RATIOS  # by how much more than `YAW_RATE` says the base has turned of late, as the last join found
STATE_SIZE = TOLD + 1
# One state for wheels that are as their calibration says, one for wheels whose drift and scale are off.
EXACT, OFF = 0, 1


@kernel
def add_outer(state: FloatArray, at: int, variance: float, x: float, y: float, yaw: float) -> None:
    """Add the noise of something that moves the pose along (x, y, yaw) to the covariance that stands at a place."""
    state[at] += variance * x * x
    state[at + 1] += variance * x * y
    state[at + 2] += variance * x * yaw
    state[at + 3] += variance * y * y
    state[at + 4] += variance * y * yaw
    state[at + 5] += variance * yaw * yaw


@kernel
def add_shared(state: FloatArray, at: int, shared: float, wx: float, wy: float, tx: float, ty: float) -> None:
    """Add what the noise of a way, that moves the pose along (wx, wy, 0), shares with a turn's, along (tx, ty, 1)."""
    state[at] += 2 * shared * wx * tx
    state[at + 1] += shared * (wx * ty + wy * tx)
    state[at + 2] += shared * wx
    state[at + 3] += 2 * shared * wy * ty
    state[at + 4] += shared * wy


@kernel
def add_product(state: FloatArray, factor: float, one: FloatArray, other: FloatArray) -> None:
    """Add `factor` (one otherᵀ + other oneᵀ), of (3,) each, to the pose's covariance."""
    place = COVARIANCE
    for i in range(3):
        for j in range(i, 3):
            state[place] += factor * (one[i] * other[j] + other[i] * one[j])
            place += 1
