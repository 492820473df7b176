"""Navigation: costmap, planner, controller and collision monitor; from a map and a goal to velocity commands."""

from wheelsight.navigation.behaviours import Behaviour, Straight, Turn, Wait
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
from wheelsight.navigation.depth_viewer import DepthViewer
from wheelsight.navigation.exploration import Exploration
from wheelsight.navigation.fields import CostField
from wheelsight.navigation.floors import Floor, GrowingFloor, KnownFloor, SeenFloor
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.goals import Goals, Poses, Way
from wheelsight.navigation.grid_search import cost_to_go
from wheelsight.navigation.live_layer import LiveLayer, LiveObstacles
from wheelsight.navigation.localization import Localization, planar_pose
from wheelsight.navigation.monitor_settings import MonitorSettings, ViewSettings, WheelCheckSettings
from wheelsight.navigation.mppi import MppiController
from wheelsight.navigation.navigator import Navigator
from wheelsight.navigation.navigator_settings import (
    BehaviourSettings,
    ExplorationSettings,
    FootprintSettings,
    NavigationSettings,
    NavigatorSettings,
)
from wheelsight.navigation.navigator_values import (
    Feedback,
    NavigationReason,
    NavigationResult,
    NavigationState,
    Transition,
)
from wheelsight.navigation.people import PeopleTracker, Person
from wheelsight.navigation.people_settings import PeopleSettings
from wheelsight.navigation.plan_values import PathPlanner, Plan, PlanFailure, PlanReason
from wheelsight.navigation.planner import Planner
from wheelsight.navigation.planner_settings import PlannerSettings
from wheelsight.navigation.planning import Planned, Planning
from wheelsight.navigation.pure_pursuit import PurePursuitController
from wheelsight.navigation.surroundings import DepthView
from wheelsight.navigation.velocity_ramp import VelocityRamp
from wheelsight.navigation.workers import Worker, WorkerBeside, WorkerInStep
from wheelsight.robot_limits import RobotLimits

__all__ = [
    "Behaviour",
    "BehaviourSettings",
    "CellState",
    "CollisionMonitor",
    "ControlReason",
    "ControlResult",
    "Controller",
    "CostField",
    "Costmap",
    "CostmapSettings",
    "DepthView",
    "DepthViewer",
    "DrivenPath",
    "Exploration",
    "ExplorationSettings",
    "Feedback",
    "Floor",
    "FollowSettings",
    "Footprint",
    "FootprintSettings",
    "Goals",
    "GrowingFloor",
    "KnownFloor",
    "LiveLayer",
    "LiveLayerSettings",
    "LiveObstacles",
    "Localization",
    "MonitorReason",
    "MonitorResult",
    "MonitorSettings",
    "MonitorState",
    "MotionState",
    "MppiController",
    "MppiSettings",
    "NavigationReason",
    "NavigationResult",
    "NavigationSettings",
    "NavigationState",
    "Navigator",
    "NavigatorSettings",
    "PathPlanner",
    "PeopleSettings",
    "PeopleTracker",
    "Person",
    "Plan",
    "PlanFailure",
    "PlanReason",
    "Planned",
    "Planner",
    "PlannerSettings",
    "Planning",
    "Poses",
    "PurePursuitController",
    "PurePursuitSettings",
    "RobotLimits",
    "SeenFloor",
    "StaticLayer",
    "Straight",
    "Transition",
    "Turn",
    "VelocityRamp",
    "ViewSettings",
    "Wait",
    "Way",
    "WheelCheckSettings",
    "Worker",
    "WorkerBeside",
    "WorkerInStep",
    "cost_to_go",
    "planar_pose",
]
