"""Where the numbers of a dead reckoning's state stand; numba over arrays.

The covariance is that of the left perturbation (vx, vy, ω) of T_odom_base: there, a step only adds to it, and what was
uncertain before stays as it is.
"""

from __future__ import annotations

from numba import njit

from wheelsight.geometry import FloatArray

X, Y, YAW = 0, 1, 2
COVARIANCE = 3  # xx, xy, xω, yy, yω, ωω
BIAS, BIAS_VARIANCE = 9, 10
WITH_BIAS = 11  # covariance of the errors of x, y, ω with the bias's; an error is what is true less what is thought
IS_STILL, SPEED, YAW_RATE = 14, 15, 16
# A stretch: what wheels and gyroscope told since both were last joined, and the wheels' noise since, all by their
# calibration. Its turns' noise moves the pose along (tx, ty, 1), that of its ways along (wx, wy, 0).
STRETCH_S, APART, SLIP = 17, 18, 19  # seconds, the gyroscope's turn less the wheels', variance of the wheels' turn
SLIP_COVARIANCE, SHARED_COVARIANCE = 20, 26  # of the pose by turns; by what turns and ways share
SLIP_WITH_TURN, SHARED_WITH_TURN = 32, 35  # of x, y, ω (of x, y) with the wheels' turn
IS_REST, FIRST_RATE, LAST_RATE = 37, 38, 39  # at its begin and end, by the gyroscope
# Two pieces in a row, of which the bias is the same: how noisy wheels are that differ so from the gyroscope.
PIECE_S, PIECE_APART, PIECE_SLIP, PIECE_FIRST_RATE = 40, 41, 42, 43
BEFORE_S, BEFORE_APART, BEFORE_SLIP, BEFORE_KNOWN = 44, 45, 46, 47  # of the piece before, and its other variance
PAIRS, RATIO, NATS = 48, 49, 50
RATIOS = 15
STATE_SIZE = NATS + RATIOS


@njit(cache=True, nogil=True)
def add_outer(state: FloatArray, at: int, variance: float, x: float, y: float, yaw: float) -> None:
    """Add the noise of something that moves the pose along (x, y, yaw) to the covariance that stands at a place."""
    state[at] += variance * x * x
    state[at + 1] += variance * x * y
    state[at + 2] += variance * x * yaw
    state[at + 3] += variance * y * y
    state[at + 4] += variance * y * yaw
    state[at + 5] += variance * yaw * yaw


@njit(cache=True, nogil=True)
def add_shared(state: FloatArray, at: int, shared: float, wx: float, wy: float, tx: float, ty: float) -> None:
    """Add what the noise of a way, that moves the pose along (wx, wy, 0), shares with a turn's, along (tx, ty, 1)."""
    state[at] += 2 * shared * wx * tx
    state[at + 1] += shared * (wx * ty + wy * tx)
    state[at + 2] += shared * wx
    state[at + 3] += 2 * shared * wy * ty
    state[at + 4] += shared * wy
