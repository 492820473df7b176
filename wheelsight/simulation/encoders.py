"""What a wheel controller and a gyroscope tell of a drive: whole counts every 20 ms, and a noisy yaw rate."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from wheelsight.calibration import Gyro
from wheelsight.events import WheelTicks, YawRate
from wheelsight.geometry import FloatArray
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

    def read(self, stamp_s: float) -> WheelTicks | None:
        """The counts, or None where the reading does not arrive."""
        if is_during(stamp_s, self._faults.dropouts_s):
            return None
        return WheelTicks(stamp_s, int(self._counts[0]), int(self._counts[1]))


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


def is_during(stamp_s: float, spans_s: Sequence[tuple[float, float]]) -> bool:
    """Whether a time lies in one of the spans (from, to), the end of which is outside."""
    return any(start - _SAME_MOMENT_S <= stamp_s < end - _SAME_MOMENT_S for start, end in spans_s)
