"""Navigation: costmap, planner, controller and collision monitor; from a map and a goal to velocity commands."""

from wheelsight.core.robots import Localization, RobotLimits
from wheelsight.core.threads import Worker, WorkerBeside, WorkerInStep
from wheelsight.navigation.behaviours import Behaviour, Straight, Turn, Wait
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.collision_monitor import (
    CollisionMonitor,
    MonitorReason,
    MonitorResult,
    MonitorState,
    VelocityRamp,
)
from wheelsight.navigation.controllers import (
    Controller,
    ControlReason,
    ControlResult,
    DrivenPath,
    MotionState,
    MppiController,
    PurePursuitController,
)
from wheelsight.navigation.costmap import (
    CellState,
    Costmap,
    Floor,
    GrowingFloor,
    KnownFloor,
    LiveObstacles,
    SeenFloor,
    StaticLayer,
)
from wheelsight.navigation.exploration import Exploration
from wheelsight.navigation.navigator import Navigator
from wheelsight.navigation.perception import DepthViewer, LiveLayer, PeopleTracker, Person
from wheelsight.navigation.planner import PathPlanner, Plan, PlanFailure, Planner, PlanReason, cost_to_go
from wheelsight.navigation.planning import Goals, Planned, PoseGoals
from wheelsight.navigation.senses import planar_pose
from wheelsight.navigation.settings import (
    BehaviourSettings,
    CostmapSettings,
    FollowSettings,
    Footprint,
    FootprintSettings,
    LiveLayerSettings,
    MonitorSettings,
    MppiSettings,
    NavigationSettings,
    NavigatorSettings,
    PeopleSettings,
    PlannerSettings,
)
from wheelsight.navigation.task import Feedback, NavigationReason, NavigationResult, NavigationState, Transition

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
    "DepthViewer",
    "DrivenPath",
    "Exploration",
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
    "PoseGoals",
    "PurePursuitController",
    "RobotLimits",
    "SeenFloor",
    "StaticLayer",
    "Straight",
    "Transition",
    "Turn",
    "VelocityRamp",
    "Wait",
    "Worker",
    "WorkerBeside",
    "WorkerInStep",
    "cost_to_go",
    "planar_pose",
]
