"""ControlChain: what a navigator asks for passes a ramp and the collision monitor, which decides on the command."""

from __future__ import annotations

from wheelsight.commands import STOP, VelocityCommand
from wheelsight.estimates import Status
from wheelsight.navigation.collision_monitor import CollisionMonitor, MonitorResult, MonitorState
from wheelsight.navigation.localization import WhereNow
from wheelsight.navigation.navigator_settings import NavigationSettings
from wheelsight.navigation.velocity_ramp import VelocityRamp


class ControlChain:
    """See the module.

    Args:
        settings: of the robot.

    Attributes:
        monitor: has the last word.
        checked: what it made of the last command.
    """

    def __init__(self, settings: NavigationSettings) -> None:
        self.monitor = CollisionMonitor(
            settings.footprint.outline, settings.limits, settings.monitor, settings.wheel_check
        )
        self.checked = MonitorResult(STOP, MonitorState.FREE)
        self._ramp, self._period_s = VelocityRamp(settings.limits), settings.follow.period_s

    @property
    def command(self) -> VelocityCommand:
        """What the robot is to be told."""
        return self.checked.command

    def ask(self, asked: VelocityCommand, now_s: float, where: WhereNow, *, stands_by_itself: bool) -> None:
        """Take what is asked for in a period; a robot that stands by itself does not do it."""
        if stands_by_itself:
            # Told less and less while it stands by itself, it would seem not to obey, and would not be told to stand.
            self._ramp.follow(STOP)
        ramped = self._ramp.step(asked.forward_m_s, asked.turn_rad_s, self._period_s)
        self.checked = self.monitor.check(ramped, now_s, _status_to_drive(where))
        if self.checked.state is not MonitorState.FREE:
            self._ramp.follow(self.checked.command)


def _status_to_drive(where: WhereNow) -> Status:
    """For the monitor: whoever does not know where in the map it is, but how it moves, may turn and look about."""
    is_searching = where.status is Status.INITIALIZING and where.is_rolling
    return Status.COASTING if is_searching else where.status
