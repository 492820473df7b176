"""A world of a floor plan: its walls, doors, furniture, areas, and a route that the wheelchair can drive."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import shapely
from shapely.geometry.polygon import orient

from wheelsight.io.ros_map import read_ros_map
from wheelsight_sim.robot import RobotModel
from wheelsight_sim.settings import FloorPlan
from wheelsight_sim.world import World
from wheelsight_sim.worlds.building import CEILING_M, LEAF_M, LEAF_TOP_M, POSTERS, Building, Face, Spot
from wheelsight_sim.worlds.floor_plan_rooms import Doorway, FreeSpace, Rooms, find_rooms, free_space_of, read_room_areas
from wheelsight_sim.worlds.floor_plan_route import SIDE_MARGIN_M, Body, plan_route, swept_by

# Between the robot's way and furniture: it is checked with SIDE_MARGIN_M beside the chair.
_FURNITURE_MARGIN_M = 0.15
_BESIDE_DOOR_M, _BEFORE_DOOR_M, _OFF_LEAF_M = 0.25, 1.0, 0.05
_STREAM = 0x100
_FURNISHED_M = 10.0  # from the route: a depth camera sees no farther


def build_floor_plan(
    plan: FloorPlan,
    seed: int,
    robot: RobotModel,
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
    route = plan_route(space, rooms.doorways, robot, seed, plan, least_m)
    building = Building(plan.name, seed, day)
    # Walls, doors and furniture, out of the robot's way.
    body = Body.of(robot)
    swept = swept_by(body, route, _FURNITURE_MARGIN_M)
    looks = Looks(np.random.default_rng([seed, _STREAM]))
    faces = build_shell(building, space, rooms, looks)
    material = str(building.rng.choice(MATERIALS))
    gaps, kept_free = [], [swept]
    for number, doorway in enumerate(rooms.doorways):
        door = choose_door(doorway, swept, space.shape, building.rng)
        build_door(building, str(number), door, looks.usual, material)
        gap = shapely.LineString([doorway.left, doorway.right])
        gaps.append(gap.buffer(doorway.thickness_m / 2 + _BESIDE_DOOR_M, cap_style="square"))
        kept_free += [door.footprint.buffer(_OFF_LEAF_M), shapely.Point(doorway.middle).buffer(_BEFORE_DOOR_M)]
    floor = shapely.intersection(space.shape, route.around(_FURNISHED_M))
    turning = body.turning_m + _FURNITURE_MARGIN_M
    left_out = shapely.Point() if begin is None else shapely.Point(begin[:2]).buffer(turning)
    dresser = Dresser(building, floor, shapely.union_all(kept_free), shapely.union_all(gaps), left_out)
    for face in faces:
        dresser.face(face)
    dresser.tables(dresser.table_places(min(int(floor.area / _TABLES_M2), _MOST_TABLES)))
    lap = "a lap" if route.is_loop else "a way"
    description = f"{space.shape.area:.0f} m² of {Path(plan.path).name}, {lap} of {route.length_m:.0f} m"
    world = building.world(description, areas, route.all_waypoints, is_loop=route.is_loop)
    return replace(world, warnings=tuple(warnings))


# The thickness of a wall shows only at its ends, which are faces of their own; what is thin leaves no room for two
# sides of one wall to come through each other.
SHELL_M = 0.006
_MARGIN_M = 0.4
_INSIDE_M = 0.12
_WALLS = ("plaster_white", "plaster_cream", "plaster_grey", "plaster_sage", "panelling", "brick_tiles", "wall_tiles")
_WALL_SHARES = (0.36, 0.22, 0.16, 0.14, 0.04, 0.04, 0.04)
_GROUNDS = ("tiles_grey", "tiles_light", "tiles_dark", "carpet_grey", "parquet")
_FLOORS = ("tiles_light", "carpet_blue", "carpet_brown", "carpet_grey", "parquet", "carpet_red")
# Scanners see cupboards and machines as they see walls.
_FRONT_M, _FRONT_SHARE = (0.3, 1.3), 0.4
_FRONTS = ("wood_light", "wood_dark", "locker", "panelling", "books", "door_white", "machine", "brick_tiles", "steel")
_RECTANGLE = 0.9  # share of the rectangle around a room that is room
_OFF_WALLS_M, _SMALLEST_M2 = 0.5, 1.0
_PILLAR_M2, _PIECE_M2, _PIECE_SHARE = 0.3, 3.0, 0.8
_HEIGHTS_M = (0.74, 1.1, 1.45, 1.9)
_PIECES = ("wood_light", "wood_dark", "plastic_grey", "steel", "locker")


class Looks:
    """What walls and floors of each room are of, by seed."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._walls: dict[int, str] = {}
        self.usual = str(rng.choice(_WALLS[:4]))

    def front(self, room: int, width_m: float) -> str:
        """The material of a face of that width: narrow ones are, some of them, fronts of what stands before a wall."""
        is_front = _FRONT_M[0] <= width_m <= _FRONT_M[1] and self._rng.random() < _FRONT_SHARE
        return str(self._rng.choice(_FRONTS)) if is_front else self.wall(room)

    def wall(self, room: int) -> str:
        """The material of a room's walls; most rooms of a building are alike."""
        if room not in self._walls:
            other = str(self._rng.choice(_WALLS, p=_WALL_SHARES))
            self._walls[room] = self.usual if self._rng.random() < 0.4 else other
        return self._walls[room]


def build_shell(building: Building, space: FreeSpace, rooms: Rooms, looks: Looks) -> list[Face]:
    """Build floor, ceiling and walls, pillars and furniture of the plan; answers the faces of walls."""
    x_min, y_min, x_max, y_max = space.shape.bounds
    ground, ceiling = str(building.rng.choice(_GROUNDS)), "ceiling_panels"
    size_m = (x_min - _MARGIN_M, y_min - _MARGIN_M, x_max + _MARGIN_M, y_max + _MARGIN_M)
    building.floor_and_ceiling(ground, ceiling, size_m)
    # Rooms that are rectangles have floors of their own. Cells away from walls show which are, since a room's cells
    # reach into its doorways; the floor is then laid up to the walls.
    away_m = space.distance_m()[::2, ::2]
    labels = np.where(away_m >= _OFF_WALLS_M, rooms.labels, -1)
    kinds = [floor for floor in _FLOORS if floor != ground]
    for room in np.unique(labels[labels >= 0]).tolist():
        cells = 2 * np.argwhere(labels == room)
        material = str(building.rng.choice(kinds))
        area_m2 = len(cells) * (2 * space.cell_m) ** 2
        middle, sides_m, angle_deg = cv2.minAreaRect(space.middle_of(cells).astype(np.float32))
        room_m = float(sides_m[0]) + 2 * space.cell_m, float(sides_m[1]) + 2 * space.cell_m
        if area_m2 < _SMALLEST_M2 or area_m2 < _RECTANGLE * room_m[0] * room_m[1]:
            continue
        spot = Spot(float(middle[0]), float(middle[1]), float(np.radians(angle_deg)))
        grown_m = 2 * _OFF_WALLS_M - space.cell_m
        # Each a hair higher than the last, so that no two lie in one plane where rooms are not quite rectangles.
        laid_m, top_m = (room_m[0] + grown_m, room_m[1] + grown_m), 0.003 + 1e-5 * room
        building.box(f"floor_{room}", material, spot, laid_m, -0.02, top_m, is_solid=False)
    shape = orient(space.shape)
    names: list[str] = []
    for number, ring in enumerate((shape.exterior, *shape.interiors)):
        if not number or not _is_piece(building, ring):
            names += _walls(building, f"{number}", ring, space, rooms, looks)
    return [building.faces[name] for name in names]


def _walls(
    building: Building, name: str, ring: shapely.LinearRing, space: FreeSpace, rooms: Rooms, looks: Looks
) -> list[str]:
    """Walls along a ring; names of their faces."""
    corners = shapely.get_coordinates(ring)[:-1]
    after = np.roll(corners, -1, axis=0)
    ahead = after - corners
    lengths = np.maximum(np.hypot(*ahead.T), 1e-9)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1) / lengths[:, None]
    inside = rooms.room_at(space, (corners + after) / 2 + _INSIDE_M * left).tolist()
    edges = [(f"{name}_{k}", looks.front(room, float(lengths[k]))) for k, room in enumerate(inside)]
    building.walls([(float(x), float(y)) for x, y in corners], edges, thickness_m=SHELL_M)
    return [edge[0] for edge in edges]


def _is_piece(building: Building, ring: shapely.LinearRing) -> bool:
    """Whether a hole in the floor is a pillar or a piece of furniture, which is then built: one box."""
    hole = shapely.Polygon(ring)
    box = shapely.oriented_envelope(hole)
    if hole.area > _PIECE_M2 or box.area < 1e-6 or (hole.area > _PILLAR_M2 and hole.area < _PIECE_SHARE * box.area):
        return False
    corners = shapely.get_coordinates(box)
    along, across = corners[1] - corners[0], corners[2] - corners[1]
    x_m, y_m = corners[:-1].mean(axis=0)
    spot = Spot(float(x_m), float(y_m), float(np.arctan2(along[1], along[0])))
    size_m = float(np.hypot(*along)), float(np.hypot(*across))
    is_pillar = hole.area <= _PILLAR_M2
    height_m = CEILING_M if is_pillar else float(building.rng.choice(_HEIGHTS_M))
    material = "concrete" if is_pillar else str(building.rng.choice(_PIECES))
    building.box("pillar" if is_pillar else "piece", material, spot, size_m, 0.0, height_m)
    return True


_CASING_M, _PROUD_M = 0.07, 0.015
_SHARE_CLOSED = 0.5
# Doors are pushed open to about these angles.
_OPEN_DEG = (88.0, 110.0)
# Of one that is shut in the plan: no more, as its hinge is at the wall's face and the leaf deeper in it.
_SWUNG_RAD = math.radians(88.0)
MATERIALS = ("door_oak", "door_white", "door_blue", "door_fire")


@dataclass(frozen=True, slots=True)
class PlanDoor:
    """How a doorway is furnished.

    Attributes:
        doorway: the gap.
        leaf: (x, y, yaw) of its middle in `map`, metres and radians; None where it has been taken off.
        is_closed: whether the leaf blocks the way.
        hinge: (x, y) that the leaf turns about when it swings, metres; None where there is no room to.
        turn_rad: how far it swings from where it is, anticlockwise.
    """

    doorway: Doorway
    leaf: tuple[float, float, float] | None
    is_closed: bool
    hinge: tuple[float, float] | None = None
    turn_rad: float = 0.0

    @property
    def footprint(self) -> shapely.Geometry:
        """Of the leaf, metres."""
        if self.leaf is None:
            return shapely.Polygon()
        x_m, y_m, yaw_rad = self.leaf
        half = self.doorway.width_m / 2
        along = half * math.cos(yaw_rad), half * math.sin(yaw_rad)
        line = shapely.LineString([(x_m - along[0], y_m - along[1]), (x_m + along[0], y_m + along[1])])
        return line.buffer(LEAF_M / 2, cap_style="flat")


def choose_door(doorway: Doorway, way: shapely.Geometry, floor: shapely.Geometry, rng: np.random.Generator) -> PlanDoor:
    """A door by seed: closed only off the route, else open to where its leaf blocks no way.

    `way` is what the robot sweeps, `floor` what is free.
    """
    gap = shapely.LineString([doorway.left, doorway.right])
    wants_closed = rng.random() < _SHARE_CLOSED
    angle_rad = math.radians(rng.uniform(*_OPEN_DEG))
    hinges = rng.permutation(4).tolist()
    if wants_closed and not shapely.intersects(gap, way):
        # A shut door; it swings to where its leaf stands on free floor, if there is such a side.
        leaf = (*doorway.middle, doorway.yaw_rad)
        for is_left, side in ((True, 1), (False, 1), (True, -1), (False, -1)):
            opened = _open(doorway, is_left, side, _SWUNG_RAD)
            if shapely.covers(floor, opened.footprint):
                jamb, out_m = doorway.left if is_left else doorway.right, side * doorway.thickness_m / 2
                hinge = jamb[0] + out_m * float(doorway.onward[0]), jamb[1] + out_m * float(doorway.onward[1])
                return PlanDoor(doorway, leaf, True, hinge, -opened.turn_rad)
        return PlanDoor(doorway, leaf, is_closed=True)
    for hinge in hinges:
        door = _open(doorway, hinge % 2 == 0, 1 if hinge < 2 else -1, angle_rad)
        is_clear = not shapely.intersects(door.footprint, way)
        if is_clear and shapely.covers(floor, door.footprint):
            return door
    return PlanDoor(doorway, None, is_closed=False)


def _open(doorway: Doorway, is_left: bool, side: int, angle_rad: float) -> PlanDoor:
    """A door whose leaf hangs on a jamb and is open to a side of the wall."""
    jamb = doorway.left if is_left else doorway.right
    yaw_rad = doorway.yaw_rad if is_left else doorway.yaw_rad + math.pi
    turn = angle_rad if (side > 0) == is_left else -angle_rad
    out_m = doorway.thickness_m / 2 + LEAF_M
    half = doorway.width_m / 2
    hinge = jamb[0] + side * out_m * float(doorway.onward[0]), jamb[1] + side * out_m * float(doorway.onward[1])
    x_m, y_m = hinge[0] + half * math.cos(yaw_rad + turn), hinge[1] + half * math.sin(yaw_rad + turn)
    return PlanDoor(doorway, (x_m, y_m, yaw_rad + turn), False, hinge, -turn)


def build_door(building: Building, name: str, door: PlanDoor, wall: str, material: str) -> None:
    """Put a door into its gap: what is over it of the material `wall`, the rest of `material`."""
    doorway = door.doorway
    middle = Spot(*doorway.middle, doorway.yaw_rad)
    width, deep = doorway.width_m, doorway.thickness_m
    building.box(f"lintel_{name}", wall, middle, (width + 0.04, deep + 0.004), LEAF_TOP_M, CEILING_M)
    for side in (-1, 1):
        casing = middle.offset(side * ((width + _CASING_M) / 2 - 0.004), 0.0)
        size_m = (_CASING_M, deep + 2 * _PROUD_M)
        building.box(f"casing_{name}", material, casing, size_m, 0.0, LEAF_TOP_M + _CASING_M, is_solid=False)
    head = (width, deep + 2 * _PROUD_M)
    building.box(f"casing_{name}", material, middle, head, LEAF_TOP_M, LEAF_TOP_M + _CASING_M, is_solid=False)
    if door.leaf is not None:
        x_m, y_m, yaw_rad = door.leaf
        building.leaf(f"leaf_{name}", material, Spot(x_m, y_m, yaw_rad), width, door.hinge, door.turn_rad)


_CORNER_M, _GAP_M = (0.06, 0.5), (0.15, 1.3)
_SHORTEST_M = 0.45
_INTO_WALL_M = 0.05  # furniture may touch walls, which are not quite straight
_APART_M = 0.05
_STANDS = 0.45  # share of places at walls where something stands
_CORRIDOR_M = 2.4  # what is no wider is a corridor
_TABLES_M2 = 14.0  # of floor for each table in the middle of a room
_MOST_TABLES = 30
_TABLE_ROOM_M = 1.15
_FABRICS = ("fabric_blue", "fabric_red", "fabric_dark", "fabric_beige")
_SHEETS_M = ((0.30, 0.42), (0.42, 0.30), (0.42, 0.59), (0.59, 0.84), (0.84, 1.19), (0.84, 0.59), (1.19, 0.84))


class _Furniture(NamedTuple):
    """What stands at a wall: the floor that it takes, its shares in a room and in a corridor, what puts it there."""

    width_m: float
    depth_m: float
    share: tuple[float, float]
    build: Callable[[Building, str, Spot], None]


def _cupboard(building: Building, name: str, wall: Spot) -> None:
    material = ("wood_light", "wood_dark", "locker", "door_white")[building.rng.integers(4)]
    height_m = float(building.rng.choice((0.85, 1.2, 1.9)))
    building.box(name, material, wall.offset(0, 0.23), (1.15, 0.44), 0.0, height_m)


def _chair(building: Building, name: str, wall: Spot) -> None:
    spot = wall.offset(0, 0.33)
    turn = building.loose(-0.25, 0.25)
    fabric = _FABRICS[building.rng.integers(len(_FABRICS))]
    building.chair(name, Spot(spot.x_m, spot.y_m, spot.yaw_rad + turn), fabric)


def _copier(building: Building, name: str, wall: Spot) -> None:
    building.box(name, "plastic_grey", wall.offset(0, 0.35), (1.1, 0.65), 0.0, 1.05)
    building.box(f"{name}_top", "plastic_black", wall.offset(0, 0.37), (0.9, 0.6), 1.05, 1.13)


_KINDS = {
    "shelf": _Furniture(1.4, 0.34, (0.14, 0.04), lambda b, n, s: b.shelf(n, s, 1.3, rows=3)),
    "desk": _Furniture(1.6, 1.35, (0.18, 0.0), Building.desk),
    "cupboard": _Furniture(1.2, 0.48, (0.16, 0.14), _cupboard),
    "radiator": _Furniture(
        1.3, 0.14, (0.10, 0.18), lambda b, n, s: b.box(n, "radiator", s.offset(0, 0.07), (1.2, 0.1), 0.15, 0.75)
    ),
    "bin": _Furniture(
        0.4, 0.4, (0.08, 0.14), lambda b, n, s: b.cylinder(n, "plastic_grey", s.offset(0, 0.2), 0.15, 0.0, 0.55)
    ),
    "chair": _Furniture(0.6, 0.7, (0.10, 0.14), _chair),
    "plant": _Furniture(0.7, 0.7, (0.08, 0.10), lambda b, n, s: b.plant(n, s.offset(0, 0.35), b.rng.uniform(1.0, 1.6))),
    "sofa": _Furniture(2.1, 0.95, (0.06, 0.02), Building.sofa),
    "bed": _Furniture(1.7, 2.15, (0.02, 0.0), Building.bed),
    "bench": _Furniture(1.6, 0.46, (0.02, 0.12), Building.bench),
    "table": _Furniture(1.5, 0.8, (0.06, 0.02), lambda b, n, s: b.table(n, s.offset(0, 0.42), (1.4, 0.7))),
    "copier": _Furniture(1.2, 0.75, (0.0, 0.06), _copier),
    "machine": _Furniture(
        1.05, 0.85, (0.0, 0.04), lambda b, n, s: b.box(n, "machine", s.offset(0, 0.4), (0.95, 0.78), 0.0, 1.85)
    ),
}


class Dresser:
    """Puts things where nothing else is.

    Args:
        building: in the making.
        floor: that is free, in `map`, metres.
        kept_free: what nothing may stand in.
        doorways: what nothing may hang in: the gaps, with what is beside them.
        left_out: what would stand in it is not built. Its place is taken all the same, so that all else stands where
            it does without.
    """

    def __init__(
        self,
        building: Building,
        floor: shapely.Geometry,
        kept_free: shapely.Geometry,
        doorways: shapely.Geometry,
        left_out: shapely.Geometry,
    ) -> None:
        self._building, self._doorways, self._left_out = building, doorways, left_out
        self._room = shapely.difference(floor.buffer(_INTO_WALL_M), shapely.union(kept_free, doorways))
        self._floor = floor
        self._taken: list[shapely.Geometry] = []
        self._count = 0
        for shape in (self._room, self._floor, self._doorways):
            shapely.prepare(shape)

    def face(self, face: Face) -> None:
        """Things along a wall, one after the other."""
        rng, at_m = self._building.rng, 0.0
        middle = face.spot(face.length_m / 2, 0.1)
        if face.length_m < _SHORTEST_M or not shapely.intersects_xy(self._floor, middle.x_m, middle.y_m):
            return
        # The width of the floor before the middle of the wall.
        begin, end = face.spot(face.length_m / 2, 0.05), face.spot(face.length_m / 2, 8.0)
        ray = shapely.LineString([(begin.x_m, begin.y_m), (end.x_m, end.y_m)])
        shape = shapely.intersection(ray, self._floor)
        place = shapely.Point(begin.x_m, begin.y_m)
        first = min(shapely.get_parts(shape), key=lambda part: float(part.distance(place)), default=shapely.Point())
        is_corridor = float(shapely.length(first)) < _CORRIDOR_M
        at_m = rng.uniform(_CORNER_M[0], min(_CORNER_M[1], face.length_m / 4))
        while at_m < face.length_m - _SHORTEST_M / 2:
            used_m = self._stand(face, at_m, is_corridor) if rng.random() < _STANDS else 0.0
            used_m = used_m or self._hang(face, at_m, is_corridor)
            at_m += used_m + rng.uniform(*_GAP_M)

    def tables(self, places: Sequence[tuple[float, float]]) -> None:
        """Tables with chairs at those places (x, y) that have room."""
        rng = self._building.rng
        for x_m, y_m in places:
            yaw_rad = float(rng.choice((0.0, np.pi / 2))) + rng.uniform(-0.1, 0.1)
            room = shapely.Point(x_m, y_m).buffer(_TABLE_ROOM_M)
            if not self._take(room):
                continue
            name, spot = self._name("group"), Spot(x_m, y_m, yaw_rad)
            with self._unless_left_out(room):
                self._building.four_legged_table(name, spot, (1.4, 0.8), 0.74)
                for side, turn in ((-1, 0.0), (1, np.pi)):
                    place = spot.offset(self._building.loose(-0.3, 0.3), side * 0.68)
                    turned = Spot(place.x_m, place.y_m, yaw_rad + turn + self._building.loose(-0.3, 0.3))
                    self._building.chair(f"{name}_chair", turned, _FABRICS[rng.integers(len(_FABRICS))])

    def table_places(self, count: int) -> list[tuple[float, float]]:
        """Places (x, y) for tables, by seed, where there is room for one; the floor decides how many."""
        rng = self._building.rng
        inner = self._room.buffer(-_TABLE_ROOM_M)
        if inner.is_empty:
            return []
        low, high = np.array(inner.bounds).reshape(2, 2)
        places = rng.uniform(low, high, (20 * count, 2))
        inside = places[shapely.intersects_xy(inner, *places.T)][:count]
        return [(float(x), float(y)) for x, y in inside]

    def _stand(self, face: Face, at_m: float, is_corridor: bool) -> float:
        """Furniture from `at_m` along a wall on, with something over it; how much of the wall it takes, 0 for none."""
        rng = self._building.rng
        shares = np.array([piece.share[int(is_corridor)] for piece in _KINDS.values()])
        kind = list(_KINDS)[rng.choice(len(shares), p=shares / shares.sum())]
        piece = _KINDS[kind]
        if at_m + piece.width_m > face.length_m - 0.05:
            return 0.0
        spot = face.spot(at_m + piece.width_m / 2)
        room = _rectangle(spot, piece.width_m, piece.depth_m)
        if not self._take(room):
            return 0.0
        with self._unless_left_out(room):
            piece.build(self._building, self._name(kind), spot)
        return piece.width_m

    def _hang(self, face: Face, at_m: float, is_corridor: bool) -> float:
        """A poster, a board, or now and then the leaf of a door that is closed; how much of the wall it takes."""
        rng, building = self._building.rng, self._building
        draw, room_m = rng.random(), face.length_m - 0.05 - at_m
        if draw < 0.6:
            sheets = [sheet for sheet in _SHEETS_M if sheet[0] <= room_m] or _SHEETS_M[:1]
            width_m, height_m = sheets[rng.integers(len(sheets))]
            bottom_m, material = rng.uniform(1.42, 1.62) - height_m / 2, POSTERS[rng.integers(len(POSTERS))]
        elif draw < 0.85 or not is_corridor:
            material = ("notice_cork", "notice_felt", "white_board")[rng.integers(3)]
            width_m, height_m, bottom_m = rng.uniform(1.0, 2.0), rng.uniform(0.9, 1.2), 0.9
        else:
            material = ("door_oak", "door_white", "door_blue")[rng.integers(3)]
            width_m, height_m, bottom_m = 0.95, 2.08, 0.0
        if width_m > room_m:
            return 0.2
        middle = at_m + width_m / 2
        spot = face.spot(middle)
        if shapely.intersects(self._doorways, _rectangle(spot, width_m, 0.05)):
            return width_m
        if bottom_m == 0.0 and not self._take(_rectangle(spot, width_m, 0.06), may_be_driven=True):
            return width_m
        building.hang(face.name, self._name("hung"), material, middle, width_m, bottom_m, bottom_m + height_m)
        return width_m

    def _take(self, shape: shapely.Geometry, *, may_be_driven: bool = False) -> bool:
        """Whether nothing is there; then it is taken."""
        if not may_be_driven and not shapely.covers(self._room, shape):
            return False
        if self._taken and shapely.dwithin(np.array(self._taken), shape, _APART_M).any():
            return False
        self._taken.append(shape)
        return True

    @contextmanager
    def _unless_left_out(self, room: shapely.Geometry) -> Iterator[None]:
        """Things that are built meanwhile are removed where their room is left out; random numbers go on as ever."""
        before = self._building.geom_count
        yield
        if shapely.intersects(self._left_out, room):
            self._building.remove_since(before)

    def _name(self, kind: str) -> str:
        self._count += 1
        return f"{kind}_{self._count}"


def _rectangle(wall: Spot, width_m: float, depth_m: float) -> shapely.Polygon:
    """Floor at a wall, around a spot on it."""
    half = width_m / 2
    corners = (wall.offset(*place) for place in ((-half, 0.01), (half, 0.01), (half, depth_m), (-half, depth_m)))
    return shapely.Polygon([(corner.x_m, corner.y_m) for corner in corners])
