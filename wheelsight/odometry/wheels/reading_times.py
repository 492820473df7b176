"""ReadingTimes: when wheel readings were taken, though they are stamped when they arrive.

Wheels tell ways, and a count is right whenever it arrives; its stamp is off by what host and wire were busy with. A
step took about as long as its way takes at the speed there was. By how much steps last more or less than their ways
take tells how far off stamps are, beyond what slip and a change of speed would make of it; the time of a reading lies
between both, the nearer to its stamp the better stamps are. One that comes late, after a gap in which those behind it
waited too, was taken when its way says.
"""

from __future__ import annotations

import math
from collections import deque

from wheelsight.calibration import HolonomicWheels, Wheels
from wheelsight.calibration_parts import least_step
from wheelsight.events import OdometryReading, WheelCounts, WheelTicks
from wheelsight.odometry.wheels.settings import ReadingTimesSettings

Timed = WheelTicks | WheelCounts | OdometryReading
"""Readings whose ways say how long they took; speeds have none of their own."""


class ReadingTimes:
    """Tells when a robot's readings were taken, one after another.

    Args:
        wheels: of the robot.
        settings: of None, the defaults.

    Attributes:
        late: how many readings were taken well before their stamp says.
    """

    def __init__(self, wheels: Wheels | HolonomicWheels, settings: ReadingTimesSettings | None = None) -> None:
        self.settings = settings or ReadingTimesSettings()
        self._wheels, self._slip_m_per_sqrt_m = wheels, wheels.slip_m_per_sqrt_m
        self._last: Timed | None = None
        self._time_s = -math.inf
        self._steps: deque[tuple[float, float]] = deque(maxlen=self.settings.speed_steps)  # seconds, and way in metres
        self._variance_s2 = self.settings.least_noise_s**2
        self._patience = self.late = 0

    @property
    def noise_s(self) -> float:
        """Standard deviation of the stamps, beyond what may be a change of speed; 0 where they are exact."""
        return math.sqrt(self._variance_s2) if self._variance_s2 > self.settings.exact_s**2 else 0.0

    def time_of(self, reading: Timed) -> float:
        """When a reading was taken, in seconds; times grow where stamps do."""
        last, self._last = self._last, reading
        step_s = math.inf if last is None else reading.stamp_s - last.stamp_s
        if last is None or not 0 < step_s < self.settings.latest_s:
            self._steps.clear()
            self._time_s, self._patience = reading.stamp_s, 0
            return reading.stamp_s
        way_m, before_s = self._way_between(last, reading), self._time_s
        self._time_s = max(self._told(reading.stamp_s, step_s, way_m), before_s + 1e-6)
        self._steps.append((self._time_s - before_s, way_m))
        return self._time_s

    def _told(self, stamp_s: float, step_s: float, way_m: float) -> float:
        """The time of a reading: by its stamp and its way, or by that alone where it waited."""
        of = self.settings
        speed_m_s, period_s = self._speed_m_s, sum(seconds for seconds, _ in self._steps) / of.speed_steps
        if speed_m_s < of.slowest_m_s or way_m < of.stopping_share * period_s * speed_m_s:
            self._patience = 0
            return stamp_s
        took_s, lag_s = way_m / speed_m_s, period_s * of.speed_steps / 2
        of_slip_s = self._slip_m_per_sqrt_m * math.sqrt(way_m / 2) / speed_m_s
        unsure_s = math.hypot(took_s * min(of.acceleration_m_s2 * lag_s / speed_m_s, 1.0), of_slip_s)
        due_s = self._time_s + took_s
        if self._waited(stamp_s - due_s, step_s, took_s, (unsure_s, period_s)):
            return due_s
        self._learn(((step_s - took_s) ** 2 - unsure_s**2) / 2)  # both ends of a step are off
        noise_s = self.noise_s
        if noise_s == 0:
            return stamp_s
        told_s = due_s + unsure_s / (unsure_s + noise_s / 2) * (stamp_s - due_s)
        return told_s if abs(stamp_s - told_s) < of.latest_s else stamp_s

    def _waited(self, late_s: float, step_s: float, took_s: float, usual: tuple[float, float]) -> bool:
        of, (unsure_s, period_s) = self.settings, usual
        off_s = of.gap_sigmas * math.hypot(math.sqrt(2) * self.noise_s, unsure_s)
        begins = step_s > of.gap_factor * period_s and step_s - took_s > off_s
        if begins:
            self._patience = of.patience
        elif step_s > of.pace_share * took_s:
            self._patience -= 1
        if not of.waiting_share * period_s < late_s < of.latest_s:
            self._patience = 0
        self.late += self._patience > 0
        return self._patience > 0

    def _learn(self, found_s2: float) -> None:
        # None counts as more than three times what was known: a speed that changes at once is no noise.
        counted_s2 = min(max(found_s2, self.settings.least_noise_s**2), 9 * self._variance_s2)
        self._variance_s2 += (counted_s2 - self._variance_s2) / self.settings.memory_steps

    @property
    def _speed_m_s(self) -> float:
        """The mean over the last steps; 0 where too few are known."""
        if len(self._steps) < self.settings.speed_steps:
            return 0.0
        return sum(way_m for _, way_m in self._steps) / sum(seconds for seconds, _ in self._steps)

    def _way_between(self, before: Timed, now: Timed) -> float:
        """Mean of all wheels' ways, in metres; of a base's own odometry, that of a wheel, about."""
        of = self._wheels
        if isinstance(of, Wheels) and isinstance(before, WheelTicks) and isinstance(now, WheelTicks):
            steps = (now.left - before.left, now.right - before.right)
            sizes_m = (of.left_m_per_tick, of.right_m_per_tick)
            return sum(abs(least_step(n, of.counter_span) * m) for n, m in zip(steps, sizes_m, strict=True)) / 2
        if not isinstance(of, HolonomicWheels):
            return 0.0  # no reading of these wheels, as odometry says
        if isinstance(before, OdometryReading) and isinstance(now, OdometryReading):
            turn_rad = abs(math.remainder(now.yaw_rad - before.yaw_rad, 2 * math.pi))
            return math.hypot(now.x_m - before.x_m, now.y_m - before.y_m) + of.lever_m * turn_rad
        if not (isinstance(before, WheelCounts) and isinstance(now, WheelCounts)):
            return 0.0
        span = 1 << of.counter_bits if of.counter_bits else 0
        counts = [abs(least_step(a - b, span)) for a, b in zip(now.counts, before.counts, strict=False)]
        return of.m_per_tick * sum(counts) / max(len(counts), 1)
