"""The worst controller, and a ride whose collision monitor lets everything pass."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from navigation.rooms import Ride

from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import VelocityCommand
from wheelsight.core.robots import RobotLimits
from wheelsight.navigation import MonitorResult, MonitorState
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.controllers import ControlResult, DrivenPath, MotionState

FULL = VelocityCommand(RobotLimits().forward_m_s, 0.0)


@dataclass
class Asks:
    """A controller that asks for the same whatever it is shown."""

    result: ControlResult

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        return self.result


def without_monitor(patch: pytest.MonkeyPatch, ride: Ride) -> None:
    """What is asked is driven."""
    free = MonitorState.FREE
    patch.setattr(ride.navigator.monitor, "check", lambda asked, *now, **how: MonitorResult(asked, free))
