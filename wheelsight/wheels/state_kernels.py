"""Layout of the state of dead reckoning, an array of STATE_SIZE numbers.

The covariance is that of the left perturbation (vx, vy, ω) of T_odom_base, to which a step only adds. An error is the
true value minus the estimate.
"""

from __future__ import annotations

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import FloatArray

X, Y, YAW = 0, 1, 2
COVARIANCE = 3  # xx, xy, xω, yy, yω, ωω
# Bias of the gyroscope, turn per metre that the wheels miss (drift), relative error of their turns (scale); covariance
# (3, 3) of their errors, and (3, 3) of the pose's errors with them.
BIAS, DRIFT, SCALE = 9, 10, 11
BIAS_VARIANCE, DRIFT_VARIANCE, SCALE_VARIANCE = 12, 16, 20
ERRORS_COVARIANCE, WITH_ERRORS = 12, 21
IS_STILL, SPEED, YAW_RATE = 30, 31, 32
# A stretch: readings since the last update by the gyroscope: seconds, the gyroscope's turn minus the wheels', variance
# of the wheels' turn by their calibration, distance and turn.
STRETCH_S, APART, SLIP, WAY, TURN = 33, 34, 35, 36, 37
# Noise of its turns moves the pose along (tx, ty, 1), that of its distances along (wx, wy, 0): covariance of the pose
# by turns, and by the common noise of both; covariance of (x, y, ω), (x, y) with the turn; motion by drift and scale.
SLIP_COVARIANCE, SHARED_COVARIANCE = 38, 44
SLIP_WITH_TURN, SHARED_WITH_TURN = 50, 53
BY_DRIFT, BY_SCALE = 55, 58
IS_REST, FIRST_RATE, LAST_RATE = 61, 62, 63  # at its begin and end, by the gyroscope
# Two consecutive pieces with the same bias, whose difference shows the noise of the wheels.
PIECE_S, PIECE_APART, PIECE_SLIP, PIECE_WAY, PIECE_TURN, PIECE_FIRST_RATE = 64, 65, 66, 67, 68, 69
BEFORE_S, BEFORE_APART, BEFORE_SLIP, BEFORE_WAY, BEFORE_TURN, BEFORE_KNOWN = 70, 71, 72, 73, 74, 75
PAIRS, RATIO = 76, 77
EVIDENCE, BEGUN = 78, 79
TURNED = 80  # in the last step, by the calibration
SLIPPING_S = 81  # time in a row of differences beyond the gate; its sign is their direction
NATS, RATIOS = 82, 21
CORRECTION = NATS + RATIOS  # of the turn in the last stretch, by the last update
STATE_SIZE = CORRECTION + 1
# One state for wheels as calibrated, one for wheels with errors of drift and scale.
EXACT, OFF = 0, 1


@kernel
def add_outer(state: FloatArray, at: int, variance: float, x: float, y: float, yaw: float) -> None:
    """Add noise that moves the pose along (x, y, yaw) to the covariance at an index."""
    state[at] += variance * x * x
    state[at + 1] += variance * x * y
    state[at + 2] += variance * x * yaw
    state[at + 3] += variance * y * y
    state[at + 4] += variance * y * yaw
    state[at + 5] += variance * yaw * yaw


@kernel
def add_shared(state: FloatArray, at: int, shared: float, wx: float, wy: float, tx: float, ty: float) -> None:
    """Add the common noise of a distance, along (wx, wy, 0), and a turn, along (tx, ty, 1)."""
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
