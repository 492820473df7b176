"""Readings of wheel controller and gyroscope along a drive, with true times and stamps of readings and frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from wheelsight.core.calibration_parts import Gyro, Wheels
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import WheelReading, WheelTicks, YawRate
from wheelsight_sim.robot import RobotModel, WheelFaults

GYRO_PERIOD_S = 0.01
_SAME_MOMENT_S = 1e-6


class Encoders:
    """Incremental encoders on the motors' shafts, counted since the controller was switched on.

    A count is a whole step of the shaft, so an angle is rounded down; where in a step a shaft stands at the start is
    chance. While a cable is out the pulses of its time are lost for good; while readings drop out counting goes on.
    """

    def __init__(self, robot: RobotModel, faults: WheelFaults, rng: np.random.Generator) -> None:
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


class DeadReckoning:
    """Where the wheelchair's own controller takes itself to be, by counts alone: what a blind driver steers by."""

    def __init__(self, nominal: Wheels, T_world_start: FloatArray) -> None:
        self._nominal = nominal
        self._x_m, self._y_m = float(T_world_start[0, 3]), float(T_world_start[1, 3])
        self._yaw_rad = math.atan2(T_world_start[1, 0], T_world_start[0, 0])
        self._last = (0, 0)

    def update(self, left: int, right: int) -> FloatArray:
        """T_world_base (4, 4) by dead reckoning, from cumulative counts; each step goes along its middle direction."""
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


SHORTEST_S = 1e-4
STAMP_DECIMALS = 6

Reading = TypeVar("Reading", bound=WheelReading | YawRate)


@dataclass(frozen=True, slots=True)
class StampSettings:
    """How stamps differ from true times.

    Attributes:
        camera_late_s: (least, most) mean delay of the camera's stamps, one a drive. Chosen: a frame of 30 Hz at most.
        camera_jitter_s: deviation of a stamp; steps between colour images of freiburg1_desk deviate by 1.9 ms, those
            of freiburg1_rpy by 2.9 ms, each of two stamps.
        dropped: share of frames that are lost. 18 of 613 have no partner in freiburg1_desk.
        dropped_together: mean number of frames lost at a time. Chosen.
        wheel_jitter_s: deviation of a wheel reading's stamp: steps between readings of `skid_steer_run20` (40 Hz)
            deviate by 3.7 ms in all; half of them by no more than 1.5 ms.
        burst_share, burst_s: share of the readings that a busy bus holds back, and for how long at most; the readings
            behind arrive together with them. The same steps go down to 3 and up to 51 ms.
    """

    camera_late_s: tuple[float, float] = (0.0, 0.02)
    camera_jitter_s: float = 0.0017
    dropped: float = 0.02
    dropped_together: float = 1.5
    wheel_jitter_s: float = 0.001
    burst_share: float = 0.01
    burst_s: float = 0.025


@dataclass(frozen=True, slots=True, eq=False)
class FrameTimes:
    """Of the frames that arrive.

    Attributes:
        taken_s: (N,) when the middle row is exposed, by the true clock.
        reported_s: (N,) the stamps, growing strictly.
    """

    taken_s: FloatArray
    reported_s: FloatArray

    def __len__(self) -> int:
        return len(self.taken_s)


def exact_times(count: int, rate_hz: float) -> FrameTimes:
    """Frames at their rate from 0 s on, stamped when they are taken."""
    stamps_s = np.round(np.arange(count) / rate_hz, STAMP_DECIMALS)
    return FrameTimes(stamps_s, stamps_s)


def frame_times(count: int, rate_hz: float, settings: StampSettings, rng: np.random.Generator) -> FrameTimes:
    """Frames at their rate, with losses, delays and jitter of stamps. The first one always arrives."""
    taken_s = exact_times(count, rate_hz).taken_s
    late_s = rng.uniform(*settings.camera_late_s) + settings.camera_jitter_s * rng.standard_normal(count)
    reported_s = _growing(taken_s + late_s)
    begins = rng.random(count) < settings.dropped / settings.dropped_together
    lengths = rng.geometric(1 / settings.dropped_together, count)
    is_lost = np.zeros(count, bool)
    for begin in np.flatnonzero(begins):
        is_lost[begin : begin + lengths[begin]] = True
    is_lost[0] = False
    kept = np.flatnonzero(~is_lost)
    return FrameTimes(taken_s[kept], reported_s[kept])


def as_stamped(readings: Sequence[Reading], settings: StampSettings, rng: np.random.Generator) -> tuple[Reading, ...]:
    """Readings with the stamps of the host, in their order."""
    if not readings:
        return ()
    taken_s = np.array([reading.stamp_s for reading in readings])
    late_s = np.abs(settings.wheel_jitter_s * rng.standard_normal(len(taken_s)))
    is_held = rng.random(len(taken_s)) < settings.burst_share
    late_s += is_held * rng.uniform(0, settings.burst_s, len(taken_s))
    times_s = _growing(taken_s + late_s)
    return tuple(replace(reading, stamp_s=stamp_s) for reading, stamp_s in zip(readings, times_s.tolist(), strict=True))


def _growing(stamps_s: FloatArray) -> FloatArray:
    """What is held back holds back what is behind it: each is at least `SHORTEST_S` after the one before."""
    steps_s = SHORTEST_S * np.arange(len(stamps_s))
    return np.asarray(np.round(np.maximum.accumulate(stamps_s - steps_s) + steps_s, STAMP_DECIMALS), float)


class Delays:
    """Stamps readings one by one as `as_stamped` does those of a whole drive; None leaves them exact."""

    def __init__(self, settings: StampSettings | None, rng: np.random.Generator) -> None:
        self._settings, self._rng = settings, rng
        self._last_s = -np.inf

    def stamped(self, reading: Reading) -> Reading:
        """The reading with the stamp of the host; stamps grow."""
        settings = self._settings
        if settings is None:
            return reading
        late_s = abs(settings.wheel_jitter_s * self._rng.standard_normal())
        if self._rng.random() < settings.burst_share:
            late_s += self._rng.uniform(0, settings.burst_s)
        self._last_s = max(reading.stamp_s + late_s, self._last_s + SHORTEST_S)
        return replace(reading, stamp_s=round(float(self._last_s), STAMP_DECIMALS))
