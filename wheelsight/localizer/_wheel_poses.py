"""WheelPoses: where the wheels alone had the base in the last seconds, and how a gyroscope turned meanwhile."""

from __future__ import annotations

from collections import deque

import numpy as np

from wheelsight.geometry import FloatArray, interpolate_at


class WheelPoses:
    """Poses T_odom_base (4, 4) as they come.

    Args:
        kept_s: how long they are kept.
        gyro_after_s: how old the gyroscope's last reading may be when a turn is asked for.

    Attributes:
        way_m: how far the wheels rolled until now.
    """

    def __init__(self, kept_s: float, gyro_after_s: float) -> None:
        self.way_m = 0.0
        self._kept_s, self._gyro_after_s = kept_s, gyro_after_s
        self._poses: deque[tuple[float, FloatArray]] = deque()
        self._turned: deque[tuple[float, float]] = deque()  # stamps and angles of the gyroscope

    @property
    def newest(self) -> FloatArray | None:
        """T_odom_base (4, 4) at the last reading."""
        return self._poses[-1][1] if self._poses else None

    def add(self, stamp_s: float, T_odom_base: FloatArray, way_m: float) -> bool:
        """Take a pose and the way since the last; False where it does not come after that, which is then forgotten."""
        goes_on = not self._poses or stamp_s > self._poses[-1][0]
        if not goes_on:
            self._poses.clear()
        if self._poses:
            self.way_m += way_m
        self._poses.append((stamp_s, T_odom_base))
        while self._poses[0][0] < stamp_s - self._kept_s:
            self._poses.popleft()
        return goes_on

    def forget(self) -> None:
        """The way does not go on from the last pose."""
        self._poses.clear()

    def at(self, stamp_s: float) -> FloatArray | None:
        """T_odom_base (4, 4) at a stamp that the wheels tell of."""
        (T,) = interpolate_at([told_s for told_s, _ in self._poses], [T for _, T in self._poses], stamp_s)
        return None if np.isnan(T).any() else np.asarray(T)

    def turn(self, stamp_s: float, yaw_rate_rad_s: float) -> None:
        """Take a reading of a gyroscope, the mean since its last one; one that does not come after it is left out."""
        if not np.isfinite([stamp_s, yaw_rate_rad_s]).all():
            return
        last_s, angle_rad = self._turned[-1] if self._turned else (stamp_s, 0.0)
        if stamp_s < last_s:
            return
        self._turned.append((stamp_s, angle_rad + yaw_rate_rad_s * (stamp_s - last_s)))
        while self._turned[0][0] < stamp_s - self._kept_s:
            self._turned.popleft()

    def turned_between(self, begin_s: float, end_s: float) -> float | None:
        """By what angle the gyroscope turned, in radians; None where it does not tell of all that time."""
        turned = self._turned
        if not turned or not (turned[0][0] <= begin_s and end_s <= turned[-1][0] + self._gyro_after_s):
            return None
        stamps_s, angles_rad = np.array(turned).T
        return float(np.interp(end_s, stamps_s, angles_rad) - np.interp(begin_s, stamps_s, angles_rad))
