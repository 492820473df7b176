"""Navigation: costmap, planner, controller and collision monitor; from a map and a goal to velocity commands."""

from wheelsight.navigation.collision_monitor import CollisionMonitor, MonitorReason, MonitorResult, MonitorState
from wheelsight.navigation.control_settings import FollowSettings, MppiSettings, PurePursuitSettings
from wheelsight.navigation.control_values import (
    Controller,
    ControlReason,
    ControlResult,
    DrivenPath,
    MotionState,
)
from wheelsight.navigation.fields import CostField
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.limits import RobotLimits
from wheelsight.navigation.monitor_settings import MonitorSettings, WheelCheckSettings
from wheelsight.navigation.mppi import MppiController
from wheelsight.navigation.pure_pursuit import PurePursuitController
from wheelsight.navigation.surroundings import DepthView
from wheelsight.navigation.velocity_ramp import VelocityRamp

__all__ = [
    "CollisionMonitor",
    "ControlReason",
    "ControlResult",
    "Controller",
    "CostField",
    "DepthView",
    "DrivenPath",
    "FollowSettings",
    "Footprint",
    "MonitorReason",
    "MonitorResult",
    "MonitorSettings",
    "MonitorState",
    "MotionState",
    "MppiController",
    "MppiSettings",
    "PurePursuitController",
    "PurePursuitSettings",
    "RobotLimits",
    "VelocityRamp",
    "WheelCheckSettings",
]
