"""Navigation: costmap, planner, controller and collision monitor; from a map and a goal to velocity commands."""

from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.limits import RobotLimits

__all__ = ["Footprint", "RobotLimits"]
