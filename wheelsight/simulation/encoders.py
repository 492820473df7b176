"""What a wheel controller and a gyroscope tell of a drive: whole counts every 20 ms, and a noisy yaw rate."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from wheelsight.calibration import Gyro, Wheels
from wheelsight.events import WheelTicks, YawRate
from wheelsight.geometry import FloatArray, se3
from wheelsight.simulation.robot import Robot, WheelFaults

GYRO_PERIOD_S = 0.01
_SAME_MOMENT_S = 1e-6


class Encoders:
    """Incremental encoders on the motors' shafts, counted since the controller was switched on.

    A count is a whole step of the shaft, so an angle is rounded down; where in a step a shaft stands at the start is
    chance. While a cable is out the pulses of its time are lost for good; while readings drop out counting goes on.
    """

    def __init__(self, robot: Robot, faults: WheelFaults, rng: np.random.Generator) -> None:
        self._counts_per_rad = robot.gear_ratio * robot.counts_per_turn / (2 * math.pi)
        self._faults = faults
        self._phase = rng.random(2)
        self._steps = np.zeros(2, np.int64)
        self._counts = np.zeros(2, np.int64)

    def turn(self, stamp_s: float, wheels_rad: FloatArray) -> None:
        """Counts on to the angles (2,) of left and right wheel since the start; to be called more often than read."""
        steps = np.floor(wheels_rad * self._counts_per_rad + self._phase).astype(np.int64)
        if not is_during(stamp_s, self._faults.unplugged_s):
            self._counts += steps - self._steps
        self._steps = steps

    @property
    def counts(self) -> tuple[int, int]:
        """Of the left and right encoder, as the controller has them."""
        return int(self._counts[0]), int(self._counts[1])

    def read(self, stamp_s: float) -> WheelTicks | None:
        """The counts, or None where the reading does not arrive."""
        if is_during(stamp_s, self._faults.dropouts_s):
            return None
        return WheelTicks(stamp_s, *self.counts)


class Gyroscope:
    """White noise on the yaw rate, and a bias that is there from the start and wanders."""

    def __init__(self, gyro: Gyro, rng: np.random.Generator) -> None:
        self._rng = rng
        self._bias_rad_s = gyro.bias_rad_s + gyro.bias_sigma_rad_s * rng.standard_normal()
        self._walk_rad_s = gyro.bias_walk_rad_s_per_sqrt_s * math.sqrt(GYRO_PERIOD_S)
        self._noise_rad_s = gyro.noise_rad_per_sqrt_s / math.sqrt(GYRO_PERIOD_S)

    def read(self, stamp_s: float, yaw_rate_rad_s: float) -> YawRate:
        """The reading of a true rate; to be called every `GYRO_PERIOD_S`."""
        self._bias_rad_s += self._walk_rad_s * self._rng.standard_normal()
        noise_rad_s = self._noise_rad_s * self._rng.standard_normal()
        return YawRate(stamp_s, float(yaw_rate_rad_s + self._bias_rad_s + noise_rad_s))


class Reckoning:
    """Where the wheelchair's own controller takes itself to be, by counts alone: what a blind driver steers by."""

    def __init__(self, nominal: Wheels, T_world_start: FloatArray) -> None:
        self._nominal = nominal
        self._x_m, self._y_m = float(T_world_start[0, 3]), float(T_world_start[1, 3])
        self._yaw_rad = math.atan2(T_world_start[1, 0], T_world_start[0, 0])
        self._last = (0, 0)

    def update(self, left: int, right: int) -> FloatArray:
        """T_world_base (4, 4) as believed, from cumulative counts; each step is taken along its middle direction."""
        left_m = self._nominal.left_m_per_tick * (left - self._last[0])
        right_m = self._nominal.right_m_per_tick * (right - self._last[1])
        turn_rad = (right_m - left_m) / self._nominal.track_width_m
        middle_rad = self._yaw_rad + turn_rad / 2
        self._x_m += (left_m + right_m) / 2 * math.cos(middle_rad)
        self._y_m += (left_m + right_m) / 2 * math.sin(middle_rad)
        self._yaw_rad += turn_rad
        self._last = (left, right)
        return se3.from_plane(self._x_m, self._y_m, self._yaw_rad)


def is_during(stamp_s: float, spans_s: Sequence[tuple[float, float]]) -> bool:
    """Whether a time lies in one of the spans (from, to), the end of which is outside."""
    return any(start - _SAME_MOMENT_S <= stamp_s < end - _SAME_MOMENT_S for start, end in spans_s)
