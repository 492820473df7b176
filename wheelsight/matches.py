"""Match: two instants of one drive at which somebody took a place for the same."""

from __future__ import annotations

from dataclasses import dataclass

from wheelsight.geometry import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """What place recognition from outside says; it may well be wrong.

    Attributes:
        stamp_a_s, stamp_b_s: the instants, seconds.
        T_a_b: (4, 4) where the body is at b, seen from where it is at a; None where only the place is the same.
        covariance: (6, 6) of the left perturbation (v, ω) of `T_a_b`; None where nobody says.
        score: how probable it is that the places are the same, 0 to 1; None where nobody says.
    """

    stamp_a_s: float
    stamp_b_s: float
    T_a_b: FloatArray | None = None
    covariance: FloatArray | None = None
    score: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SpeedVariances:
    """What a recording states of the errors of its own odometry, reading by reading.

    Attributes:
        stamps_s: (N,) from when on each holds, until the next.
        variances: (N, 3) of the speed ahead and to the left, (m/s)², and of the yaw rate, (rad/s)².
    """

    stamps_s: FloatArray
    variances: FloatArray
