"""RobotLimits under the name that navigation has for it; devices and simulation, which use it too, stand above."""

from __future__ import annotations

from wheelsight.robot_limits import RobotLimits

__all__ = ["RobotLimits"]
