"""A world of a floor plan: its walls, doors, furniture, areas, and a route that the wheelchair can drive."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely

from wheelsight.ros_map import read_ros_map
from wheelsight.simulation.robot import Robot
from wheelsight.simulation.world import World
from wheelsight.simulation.worlds._building import Building
from wheelsight.simulation.worlds.floor_plan import _doors as doors
from wheelsight.simulation.worlds.floor_plan._areas import read_room_areas
from wheelsight.simulation.worlds.floor_plan._doorways import Rooms, find_rooms
from wheelsight.simulation.worlds.floor_plan._dressing import Dresser, table_count
from wheelsight.simulation.worlds.floor_plan._free_space import FreeSpace, free_space_of
from wheelsight.simulation.worlds.floor_plan._route import SIDE_MARGIN_M, Body, Route, Wishes, plan_route, swept_by
from wheelsight.simulation.worlds.floor_plan._shell import Looks, build_shell
from wheelsight.simulation.worlds.floor_plan.settings import FloorPlan

# Between the robot's way and furniture: it is checked with SIDE_MARGIN_M beside the chair.
_FURNITURE_MARGIN_M = 0.15
_BESIDE_DOOR_M, _BEFORE_DOOR_M, _OFF_LEAF_M = 0.25, 1.0, 0.05
_STREAM = 0x100
_FURNISHED_M = 10.0  # from the route: a depth camera sees no farther


def build_floor_plan(
    plan: FloorPlan,
    seed: int,
    robot: Robot,
    least_m: float = 0.0,
    *,
    day: int = 0,
    begin: tuple[float, float, float] | None = None,
) -> World:
    """The world of a floor plan.

    Walls stand where free floor ends, be it at occupied cells or at unknown ones, and reach to the ceiling. Far from
    the route there is no furniture.

    Args:
        plan: which one.
        seed: of the route, and of materials, doors and furniture.
        robot: that is to drive there.
        least_m: how far the route leads at least: a tour that is shorter is driven again.
        day: another one has chairs elsewhere.
        begin: x, y, yaw in `map` where a robot begins that does not drive the route. Furniture that would stand where
            it turns there is left out, and all else stands where it does without it.

    Raises:
        MapError, AreaError: a file that cannot be read or does not fit.
        ConfigError: a plan in which the robot fits nowhere, or a start where it does not fit.
    """
    warnings: list[str] = []
    read = read_ros_map(plan.path, plan.resolution_m, warnings.append)
    areas = [] if plan.areas is None else read_room_areas(Path(plan.areas), read)
    space = free_space_of(read, robot.width_m + 2 * SIDE_MARGIN_M)
    rooms = find_rooms(space)
    route = plan_route(space, rooms.doorways, robot, seed, Wishes(plan.way_m, least_m, plan.start))
    building = Building(plan.name, seed, day)
    _furnish(building, space, rooms, route, robot, seed, begin)
    lap = "a lap" if route.is_loop else "a way"
    description = f"{space.shape.area:.0f} m² of {Path(plan.path).name}, {lap} of {route.length_m:.0f} m"
    world = building.world(description, areas, route.all_waypoints, is_loop=route.is_loop)
    return replace(world, warnings=tuple(warnings))


def _furnish(
    building: Building,
    space: FreeSpace,
    rooms: Rooms,
    route: Route,
    robot: Robot,
    seed: int,
    begin: tuple[float, float, float] | None,
) -> None:
    """Walls, doors and furniture, out of the robot's way."""
    body = Body.of(robot)
    swept = swept_by(body, route, _FURNITURE_MARGIN_M)
    looks = Looks(np.random.default_rng([seed, _STREAM]))
    faces = build_shell(building, space, rooms, looks)
    material = str(building.rng.choice(doors.MATERIALS))
    gaps, kept_free = [], [swept]
    for number, doorway in enumerate(rooms.doorways):
        door = doors.choose_door(doorway, swept, space.shape, building.rng)
        doors.build_door(building, str(number), door, looks.usual, material)
        gap = shapely.LineString([doorway.left, doorway.right])
        gaps.append(gap.buffer(doorway.thickness_m / 2 + _BESIDE_DOOR_M, cap_style="square"))
        kept_free += [door.footprint.buffer(_OFF_LEAF_M), shapely.Point(doorway.middle).buffer(_BEFORE_DOOR_M)]
    floor = shapely.intersection(space.shape, route.around(_FURNISHED_M))
    turning = body.turning_m + _FURNITURE_MARGIN_M
    left_out = shapely.Point() if begin is None else shapely.Point(begin[:2]).buffer(turning)
    dresser = Dresser(building, floor, shapely.union_all(kept_free), shapely.union_all(gaps), left_out)
    for face in faces:
        dresser.face(face)
    dresser.tables(dresser.table_places(table_count(floor.area)))
