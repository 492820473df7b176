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
from wheelsight.navigation.costmap import CellState, Costmap, StaticLayer
from wheelsight.navigation.costmap_settings import CostmapSettings, LiveLayerSettings
from wheelsight.navigation.fields import CostField
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.grid_search import cost_to_go
from wheelsight.navigation.live_layer import LiveLayer, LiveObstacles
from wheelsight.navigation.monitor_settings import MonitorSettings, WheelCheckSettings
from wheelsight.navigation.mppi import MppiController
from wheelsight.navigation.plan_values import Plan, PlanFailure, PlanReason
from wheelsight.navigation.planner import Planner
from wheelsight.navigation.planner_settings import PlannerSettings
from wheelsight.navigation.pure_pursuit import PurePursuitController
from wheelsight.navigation.surroundings import DepthView
from wheelsight.navigation.velocity_ramp import VelocityRamp
from wheelsight.robot_limits import RobotLimits

__all__ = [
    "CellState",
    "CollisionMonitor",
    "ControlReason",
    "ControlResult",
    "Controller",
    "CostField",
    "Costmap",
    "CostmapSettings",
    "DepthView",
    "DrivenPath",
    "FollowSettings",
    "Footprint",
    "LiveLayer",
    "LiveLayerSettings",
    "LiveObstacles",
    "MonitorReason",
    "MonitorResult",
    "MonitorSettings",
    "MonitorState",
    "MotionState",
    "MppiController",
    "MppiSettings",
    "Plan",
    "PlanFailure",
    "PlanReason",
    "Planner",
    "PlannerSettings",
    "PurePursuitController",
    "PurePursuitSettings",
    "RobotLimits",
    "StaticLayer",
    "VelocityRamp",
    "WheelCheckSettings",
    "cost_to_go",
]
