"""Navigation: costmap, planner, controller and collision monitor; from a map and a goal to velocity commands."""

from wheelsight.navigation.costmap import CellState, Costmap, StaticLayer
from wheelsight.navigation.costmap_settings import CostmapSettings, LiveLayerSettings
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.grid_search import cost_to_go
from wheelsight.navigation.limits import RobotLimits
from wheelsight.navigation.live_layer import LiveLayer, LiveObstacles
from wheelsight.navigation.plan_values import Plan, PlanFailure, PlanReason
from wheelsight.navigation.planner import Planner
from wheelsight.navigation.planner_settings import PlannerSettings

__all__ = [
    "CellState",
    "Costmap",
    "CostmapSettings",
    "Footprint",
    "LiveLayer",
    "LiveLayerSettings",
    "LiveObstacles",
    "Plan",
    "PlanFailure",
    "PlanReason",
    "Planner",
    "PlannerSettings",
    "RobotLimits",
    "StaticLayer",
    "cost_to_go",
]
