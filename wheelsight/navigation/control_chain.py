"""ControlChain: what a navigator asks for passes a ramp and the collision monitor, which decides on the command."""

from __future__ import annotations

import math

from wheelsight.commands import STOP, VelocityCommand
from wheelsight.estimates import Status
from wheelsight.navigation.collision_monitor import CollisionMonitor, MonitorReason, MonitorResult, MonitorState
from wheelsight.navigation.control_values import Controller, OwnController
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.localization import WhereNow
from wheelsight.navigation.mppi import MppiController
from wheelsight.navigation.navigator_settings import NavigationSettings
from wheelsight.navigation.pure_pursuit import PurePursuitController
from wheelsight.navigation.velocity_ramp import VelocityRamp


class ControlChain:
    """See the module.

    Args:
        settings: of the robot.

    Attributes:
        monitor: has the last word.
        checked: what it made of the last command.
        was_backward: whether the last command that it stopped led backward.
    """

    def __init__(self, settings: NavigationSettings) -> None:
        self.monitor = CollisionMonitor(
            settings.footprint.outline, settings.limits, settings.monitor, settings.wheel_check
        )
        self.checked = MonitorResult(STOP, MonitorState.FREE)
        self._stopped: tuple[float, MonitorReason | None] = (-math.inf, None)
        self.was_backward = False
        self._ramp, self._period_s = VelocityRamp(settings.limits), settings.follow.period_s

    @property
    def command(self) -> VelocityCommand:
        """What the robot is to be told."""
        return self.checked.command

    def ask(
        self,
        asked: VelocityCommand,
        now_s: float,
        where: WhereNow,
        *,
        stands_by_itself: bool,
        silent: MonitorReason | None = None,
    ) -> None:
        """Take the command of a period; a robot that stands by itself does not obey it.

        `silent` is the part that does not answer: the command is a stop.
        """
        if stands_by_itself:
            # Told less and less while it stands by itself, it would seem not to obey, and would not be told to stand.
            self._ramp.follow(STOP)
        ramped = self._ramp.step(asked.forward_m_s, asked.turn_rad_s, self._period_s)
        self.checked = self.monitor.check(ramped, now_s, _status_to_drive(where), silent)
        if self.checked.state is not MonitorState.FREE:
            self._ramp.follow(self.checked.command)
        if self.checked.state is MonitorState.STOPPED:
            self._stopped = now_s, self.checked.reason
            self.was_backward = asked.forward_m_s < 0

    def stopped_by(self, since_s: float) -> MonitorReason | None:
        """Why the monitor last stopped the robot since then: a controller knows no more than that it does not move."""
        return self._stopped[1] if self._stopped[0] >= since_s else None


def controller_of(footprint: Footprint, settings: NavigationSettings, own: Controller | None = None) -> Controller:
    """A user's own, else the one that settings name."""
    if own is not None:
        return OwnController(own, settings.follow.goal_m, settings.follow.goal_rad)
    if settings.controller == "mppi":
        return MppiController(footprint, settings.limits, settings.mppi, settings.follow)
    return PurePursuitController(footprint, settings.limits, settings.pure_pursuit, settings.follow)


def _status_to_drive(where: WhereNow) -> Status:
    """For the monitor: whoever does not know where in the map it is, but how it moves, may turn and look about."""
    is_searching = where.status is Status.INITIALIZING and where.is_rolling
    return Status.COASTING if is_searching else where.status
