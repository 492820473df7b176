"""WheelCheck: whether a base does what it is told."""

from __future__ import annotations

from collections import deque

from wheelsight.commands import STOP, VelocityCommand
from wheelsight.navigation.monitor_settings import WheelCheckSettings
from wheelsight.robot_limits import RobotLimits


class WheelCheck:
    """Keeps the speeds between which a base may be, that follows its commands as quickly or as slowly as it can.

    Two bases are reckoned along: a quick one, which follows at once, and a slow one, which follows late. What is
    measured lies between them, or the base does something else.
    """

    def __init__(self, limits: RobotLimits, settings: WheelCheckSettings) -> None:
        self._limits, self._settings = limits, settings
        self._told: deque[tuple[float, VelocityCommand]] = deque()
        self._quick, self._slow = (0.0, 0.0), (0.0, 0.0)
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
            self._quick = self._slow = measured
            self._stamp_s = stamp_s
            return False
        step_s, self._stamp_s = stamp_s - self._stamp_s, stamp_s
        self._quick = self._next(self._quick, self._told_at(stamp_s, s.held_s), s.fast_share * step_s)
        self._slow = self._next(self._slow, self._told_at(stamp_s - s.lag_s, s.watchdog_s), s.slow_share * step_s)
        bounds = zip(self._quick, self._slow, strict=True)
        off = [max(min(pair) - value, value - max(pair), 0.0) for pair, value in zip(bounds, measured, strict=True)]
        is_off = off[0] > s.off_m_s or off[1] > s.off_rad_s
        self._off_s = self._off_s + step_s if is_off else 0.0
        return self._off_s >= s.off_s

    def _told_at(self, stamp_s: float, kept_s: float) -> VelocityCommand:
        """The command that was the last then; to stand where it was older than a base keeps it.

        Whoever commands may itself have stood still, and the base has stopped by itself, as it should.
        """
        oldest_s = stamp_s - self._settings.lag_s
        while len(self._told) > 1 and self._told[1][0] <= oldest_s:
            self._told.popleft()
        before = [(told_s, command) for told_s, command in self._told if told_s <= stamp_s]
        return before[-1][1] if before and stamp_s - before[-1][0] <= kept_s else STOP

    def _next(self, speeds: tuple[float, float], told: VelocityCommand, weighted_s: float) -> tuple[float, float]:
        most = self._limits
        forward = _toward(
            speeds[0], told.forward_m_s, most.acceleration_m_s2 * weighted_s, most.braking_m_s2 * weighted_s
        )
        change = most.turn_acceleration_rad_s2 * weighted_s
        return forward, _toward(speeds[1], told.turn_rad_s, change, change)


def _toward(speed: float, wanted: float, faster: float, slower: float) -> float:
    change = faster if speed * (wanted - speed) >= 0 else slower
    return speed + min(max(wanted - speed, -change), change)
