"""WheelCheck: whether a base does what it is told."""

from __future__ import annotations

from collections import deque

from wheelsight.commands import STOP, VelocityCommand
from wheelsight.navigation.monitor_settings import WheelCheckSettings
from wheelsight.robot_limits import RobotLimits


class WheelCheck:
    """Keeps the speeds between which a base may be, that follows its commands as quickly or as slowly as it can.

    The highest is that of a base that gains speed at once and quickly, and gives way late and slowly; the lowest the
    other way round. What is measured lies between them, or the base does something else.
    """

    def __init__(self, limits: RobotLimits, settings: WheelCheckSettings) -> None:
        self._limits, self._settings = limits, settings
        self._told: deque[tuple[float, VelocityCommand]] = deque()
        self._lowest, self._highest = (0.0, 0.0), (0.0, 0.0)
        self._stamp_s: float | None = None
        self._off_s = 0.0

    def tell(self, command: VelocityCommand, now_s: float) -> None:
        """What the base was sent."""
        self._told.append((now_s, command))

    def forget(self) -> None:
        """After a gap: begin from what is measured next."""
        self._stamp_s, self._off_s = None, 0.0

    def is_off(self, forward_m_s: float, turn_rad_s: float, stamp_s: float) -> bool:
        """Whether a base that moves so has not done for too long what it was told."""
        s, measured = self._settings, (forward_m_s, turn_rad_s)
        if self._stamp_s is None:
            self._lowest = self._highest = measured
            self._stamp_s = stamp_s
            return False
        step_s, self._stamp_s = stamp_s - self._stamp_s, stamp_s
        told = self._obeyed_at(stamp_s)
        self._lowest = self._next(self._lowest, (min(told[0]), min(told[1])), step_s, s.slow_share, s.fast_share)
        self._highest = self._next(self._highest, (max(told[0]), max(told[1])), step_s, s.fast_share, s.slow_share)
        bounds = zip(self._lowest, measured, self._highest, strict=True)
        off = [max(low - value, value - high, 0.0) for low, value, high in bounds]
        is_off = off[0] > s.off_m_s or off[1] > s.off_rad_s
        self._off_s = self._off_s + step_s if is_off else 0.0
        return self._off_s >= s.off_s

    def _obeyed_at(self, stamp_s: float) -> tuple[list[float], list[float]]:
        """Speeds ahead and turns that a base may be about to reach then: all that it was told since its lag."""
        s = self._settings
        late_s = stamp_s - s.lag_s
        ends = [self._told_at(stamp_s, s.held_s), self._told_at(late_s, s.watchdog_s)]
        told = ends + [command for told_s, command in self._told if late_s < told_s <= stamp_s]
        return [one.forward_m_s for one in told], [one.turn_rad_s for one in told]

    def _told_at(self, stamp_s: float, kept_s: float) -> VelocityCommand:
        """The command that was the last then; to stand where it was older than a base keeps it.

        Whoever commands may itself have stood still, and the base has stopped by itself, as it should.
        """
        oldest_s = stamp_s - self._settings.lag_s
        while len(self._told) > 1 and self._told[1][0] <= oldest_s:
            self._told.popleft()
        before = [(told_s, command) for told_s, command in self._told if told_s <= stamp_s]
        return before[-1][1] if before and stamp_s - before[-1][0] <= kept_s else STOP

    def _next(
        self, speeds: tuple[float, float], wanted: tuple[float, float], step_s: float, up: float, down: float
    ) -> tuple[float, float]:
        """After a step; `up` and `down` are shares of the limits' accelerations."""
        most, weighted_s = self._limits, (up * step_s, down * step_s)
        forward = _toward(speeds[0], wanted[0], (most.acceleration_m_s2, most.braking_m_s2), weighted_s)
        return forward, _toward(speeds[1], wanted[1], (most.turn_acceleration_rad_s2,) * 2, weighted_s)


def _toward(speed: float, wanted: float, rates: tuple[float, float], weighted_s: tuple[float, float]) -> float:
    """A speed after a step; `rates` are of gaining speed and of braking, `weighted_s` for rising and for falling."""
    rate = rates[0] if speed * (wanted - speed) >= 0 else rates[1]
    change = rate * weighted_s[0 if wanted > speed else 1]
    return speed + min(max(wanted - speed, -change), change)
