"""Yaw rates of a gyroscope, brought to the times of wheel readings, which are others."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry import FloatArray
from wheelsight.odometry.wheels.settings import WheelSettings

_GAP_S = WheelSettings().gyro_gap_s


class YawRateMeter:
    """The mean yaw rate from one wheel reading to the next, as the readings of both sensors come in.

    Between readings the rate is taken to change evenly, after the newest to stay. What that guessed wrong is made good
    in the next mean, so that the yaw of many steps has no error from it.

    Args:
        gap_s: a gyroscope that is silent for longer tells no mean.
    """

    def __init__(self, gap_s: float = _GAP_S) -> None:
        self.gap_s = gap_s
        self._angles: deque[tuple[float, float, float]] = deque()  # stamp, yaw turned until then, rate
        self._before: tuple[float, float] | None = None

    def add(self, stamp_s: float, yaw_rate_rad_s: float) -> None:
        """Take a reading of the gyroscope; one that does not come after the last, or is no number, is left out."""
        if not (math.isfinite(stamp_s) and math.isfinite(yaw_rate_rad_s)):
            return
        if not self._angles:
            self._angles.append((stamp_s, 0.0, yaw_rate_rad_s))
            return
        last_s, angle_rad, rate_rad_s = self._angles[-1]
        if stamp_s > last_s:
            angle_rad += (stamp_s - last_s) * (rate_rad_s + yaw_rate_rad_s) / 2
            self._angles.append((stamp_s, angle_rad, yaw_rate_rad_s))

    def mean_until(self, stamp_s: float) -> float | None:
        """rad/s since the last call's stamp; None where the gyroscope was silent about there."""
        before, now_rad = self._before, self._angle_at(stamp_s)
        self._before = None if now_rad is None else (stamp_s, now_rad)
        if before is None or now_rad is None or not stamp_s > before[0]:
            return None
        return (now_rad - before[1]) / (stamp_s - before[0])

    def _angle_at(self, stamp_s: float) -> float | None:
        angles = self._angles
        while len(angles) > 1 and angles[1][0] <= stamp_s:
            angles.popleft()
        if not angles or stamp_s < angles[0][0]:
            return None
        start_s, angle_rad, rate_rad_s = angles[0]
        if len(angles) == 1:
            return angle_rad + rate_rad_s * (stamp_s - start_s) if stamp_s - start_s <= self.gap_s else None
        end_s, end_rad, _ = angles[1]
        if end_s - start_s > self.gap_s:
            return None
        return angle_rad + (end_rad - angle_rad) * (stamp_s - start_s) / (end_s - start_s)


def mean_yaw_rates(
    stamps_s: ArrayLike, gyro_stamps_s: ArrayLike, yaw_rates_rad_s: ArrayLike, gap_s: float = _GAP_S
) -> FloatArray:
    """Mean yaw rate (N,) from each wheel stamp (N,) to the next, at the later one; NaN where the gyroscope was silent.

    `yaw_rates_rad_s` (M,) were read at growing stamps (M,); it was silent where these are farther apart than `gap_s`.
    """
    stamps, at, rates = (np.asarray(values, float) for values in (stamps_s, gyro_stamps_s, yaw_rates_rad_s))
    means = np.full(len(stamps), np.nan)
    if len(at) < 2:
        return means
    angles = np.concatenate([[0.0], np.cumsum(np.diff(at) * (rates[1:] + rates[:-1]) / 2)])
    turned = np.interp(stamps, at, angles, left=np.nan, right=np.nan)
    after = np.searchsorted(at, stamps, side="right").clip(1, len(at) - 1)
    turned[at[after] - at[after - 1] > gap_s] = np.nan
    steps_s = np.diff(stamps)
    forward = steps_s > 0
    means[1:][forward] = np.diff(turned)[forward] / steps_s[forward]
    return means
