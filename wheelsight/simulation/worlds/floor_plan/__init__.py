"""Worlds of floor plans: any building of which there is a map in ROS map_server's format, or an image."""

from wheelsight.simulation.worlds.floor_plan.build import build_floor_plan
from wheelsight.simulation.worlds.floor_plan.settings import FloorPlan

__all__ = ["FloorPlan", "build_floor_plan"]
