"""Furniture, and what hangs on walls, by seed: along the faces of walls, out of the robot's way."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import shapely

from wheelsight.simulation.worlds._building import Building, Face, Spot
from wheelsight.simulation.worlds._furniture import (
    bed,
    bench,
    chair,
    desk,
    four_legged_table,
    plant,
    shelf,
    sofa,
    table,
)
from wheelsight.simulation.worlds._surfaces import POSTERS

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


@dataclass(frozen=True, slots=True)
class _Piece:
    """A kind of furniture that stands at a wall.

    Attributes:
        width_m, depth_m: of the floor that it takes.
        height_m: what hangs over it begins above.
        share: how often it stands in a room, and in a corridor.
        build: puts one there.
    """

    width_m: float
    depth_m: float
    height_m: float
    share: tuple[float, float]
    build: Callable[[Building, str, Spot], None]


def _cupboard(building: Building, name: str, wall: Spot) -> None:
    material = ("wood_light", "wood_dark", "locker", "door_white")[building.rng.integers(4)]
    height_m = float(building.rng.choice((0.85, 1.2, 1.9)))
    building.box(name, material, wall.offset(0, 0.23), (1.15, 0.44), 0.0, height_m)


def _radiator(building: Building, name: str, wall: Spot) -> None:
    building.box(name, "radiator", wall.offset(0, 0.07), (1.2, 0.1), 0.15, 0.75)


def _bin(building: Building, name: str, wall: Spot) -> None:
    building.cylinder(name, "plastic_grey", wall.offset(0, 0.2), 0.15, 0.0, 0.55)


def _chair(building: Building, name: str, wall: Spot) -> None:
    spot = wall.offset(0, 0.33)
    turn = building.loose(-0.25, 0.25)
    fabric = _FABRICS[building.rng.integers(len(_FABRICS))]
    chair(building, name, Spot(spot.x_m, spot.y_m, spot.yaw_rad + turn), fabric)


def _plant(building: Building, name: str, wall: Spot) -> None:
    plant(building, name, wall.offset(0, 0.35), building.rng.uniform(1.0, 1.6))


def _copier(building: Building, name: str, wall: Spot) -> None:
    building.box(name, "plastic_grey", wall.offset(0, 0.35), (1.1, 0.65), 0.0, 1.05)
    building.box(f"{name}_top", "plastic_black", wall.offset(0, 0.37), (0.9, 0.6), 1.05, 1.13)


def _machine(building: Building, name: str, wall: Spot) -> None:
    building.box(name, "machine", wall.offset(0, 0.4), (0.95, 0.78), 0.0, 1.85)


_KINDS = {
    "shelf": _Piece(1.4, 0.34, 1.95, (0.14, 0.04), lambda b, n, s: shelf(b, n, s, 1.3, rows=3)),
    "desk": _Piece(1.6, 1.35, 1.2, (0.18, 0.0), desk),
    "cupboard": _Piece(1.2, 0.48, 1.95, (0.16, 0.14), _cupboard),
    "radiator": _Piece(1.3, 0.14, 0.8, (0.10, 0.18), _radiator),
    "bin": _Piece(0.4, 0.4, 0.6, (0.08, 0.14), _bin),
    "chair": _Piece(0.6, 0.7, 0.9, (0.10, 0.14), _chair),
    "plant": _Piece(0.7, 0.7, 1.6, (0.08, 0.10), _plant),
    "sofa": _Piece(2.1, 0.95, 0.9, (0.06, 0.02), sofa),
    "bed": _Piece(1.7, 2.15, 1.05, (0.02, 0.0), bed),
    "bench": _Piece(1.6, 0.46, 0.5, (0.02, 0.12), bench),
    "table": _Piece(1.5, 0.8, 0.8, (0.06, 0.02), lambda b, n, s: table(b, n, s.offset(0, 0.42), (1.4, 0.7))),
    "copier": _Piece(1.2, 0.75, 1.15, (0.0, 0.06), _copier),
    "machine": _Piece(1.05, 0.85, 1.9, (0.0, 0.04), _machine),
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
        if face.length_m < _SHORTEST_M or not self._is_furnished(face):
            return
        is_corridor = self._width_m(face) < _CORRIDOR_M
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
                four_legged_table(self._building, name, spot, (1.4, 0.8), 0.74)
                for side, turn in ((-1, 0.0), (1, np.pi)):
                    place = spot.offset(self._building.loose(-0.3, 0.3), side * 0.68)
                    turned = Spot(place.x_m, place.y_m, yaw_rad + turn + self._building.loose(-0.3, 0.3))
                    chair(self._building, f"{name}_chair", turned, _FABRICS[rng.integers(len(_FABRICS))])

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

    def _is_furnished(self, face: Face) -> bool:
        """Whether there is floor before the middle of a wall."""
        middle = face.spot(face.length_m / 2, 0.1)
        return bool(shapely.intersects_xy(self._floor, middle.x_m, middle.y_m))

    def _width_m(self, face: Face) -> float:
        """How far it is from the middle of a wall to what is opposite."""
        begin, end = face.spot(face.length_m / 2, 0.05), face.spot(face.length_m / 2, 8.0)
        ray = shapely.LineString([(begin.x_m, begin.y_m), (end.x_m, end.y_m)])
        return float(shapely.length(_first_part(shapely.intersection(ray, self._floor), begin)))

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
    corners = [
        wall.offset(-width_m / 2, 0.01),
        wall.offset(width_m / 2, 0.01),
        wall.offset(width_m / 2, depth_m),
        wall.offset(-width_m / 2, depth_m),
    ]
    return shapely.Polygon([(corner.x_m, corner.y_m) for corner in corners])


def _first_part(shape: shapely.Geometry, begin: Spot) -> shapely.Geometry:
    """The part of a line that begins nearest to a place."""
    place = shapely.Point(begin.x_m, begin.y_m)
    return min(shapely.get_parts(shape), key=lambda part: float(part.distance(place)), default=shapely.Point())


def table_count(area_m2: float) -> int:
    """How many tables stand in the middle of so much floor, at most."""
    return min(int(area_m2 / _TABLES_M2), _MOST_TABLES)
