"""Navigation: costmap, planner, controller and collision monitor; from a map and a goal to velocity commands."""

from wheelsight.core.robots import RobotLimits
from wheelsight.navigation.behaviours import Behaviour, Straight, Turn, Wait
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.collision_monitor import CollisionMonitor, MonitorReason, MonitorResult, MonitorState
from wheelsight.navigation.controllers import MppiController, PurePursuitController
from wheelsight.navigation.costmap import CellState, Costmap, LiveLayer, LiveObstacles, StaticLayer
from wheelsight.navigation.exploration import Exploration
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.goals import Goals, Poses, Way
from wheelsight.navigation.localization import Localization, planar_pose
from wheelsight.navigation.navigator import Navigator, VelocityRamp
from wheelsight.navigation.path_following import Controller, ControlReason, ControlResult, DrivenPath, MotionState
from wheelsight.navigation.people import PeopleTracker, Person
from wheelsight.navigation.planner import PathPlanner, Plan, PlanFailure, Planner, PlanReason, cost_to_go
from wheelsight.navigation.planning import Planned, Planning
from wheelsight.navigation.settings import (
    BehaviourSettings,
    CostmapSettings,
    ExplorationSettings,
    FollowSettings,
    FootprintSettings,
    LiveLayerSettings,
    MonitorSettings,
    MppiSettings,
    NavigationSettings,
    NavigatorSettings,
    PeopleSettings,
    PlannerSettings,
    PurePursuitSettings,
    ViewSettings,
    WheelCheckSettings,
)
from wheelsight.navigation.static_map import Floor, GrowingFloor, KnownFloor, SeenFloor
from wheelsight.navigation.surroundings import DepthView, DepthViewer
from wheelsight.navigation.task import Feedback, NavigationReason, NavigationResult, NavigationState, Transition
from wheelsight.navigation.workers import Worker, WorkerBeside, WorkerInStep

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
