"""Walls, floors and ceiling of a building: thin boxes along the outline of its free space, a look for each room."""

from __future__ import annotations

import cv2
import numpy as np
import shapely
from shapely.geometry.polygon import orient

from wheelsight.simulation.worlds._building import CEILING_M, Building, Face, Spot
from wheelsight.simulation.worlds.floor_plan._doorways import Rooms
from wheelsight.simulation.worlds.floor_plan._free_space import FreeSpace

# Nobody sees how thick a wall is but at its ends, which are faces of their own; what is thin leaves no room for two
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
    _floors(building, space, rooms, ground)
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
    edges = [(f"{name}_{k}", looks.front(room, float(lengths[k])), ()) for k, room in enumerate(inside)]
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


def _floors(building: Building, space: FreeSpace, rooms: Rooms, ground: str) -> None:
    """Floors of their own for rooms that are rectangles."""
    # Told by cells away from walls, since a room's cells reach into its doorways; then laid up to the walls.
    away_m = space.distance_m()[::2, ::2]
    labels = np.where(away_m >= _OFF_WALLS_M, rooms.labels, -1)
    kinds = [floor for floor in _FLOORS if floor != ground]
    for room in np.unique(labels[labels >= 0]).tolist():
        cells = 2 * np.argwhere(labels == room)
        material = str(building.rng.choice(kinds))
        area_m2 = len(cells) * (2 * space.cell_m) ** 2
        middle, sides_m, angle_deg = cv2.minAreaRect(space.middle_of(cells).astype(np.float32))
        size_m = float(sides_m[0]) + 2 * space.cell_m, float(sides_m[1]) + 2 * space.cell_m
        if area_m2 < _SMALLEST_M2 or area_m2 < _RECTANGLE * size_m[0] * size_m[1]:
            continue
        spot = Spot(float(middle[0]), float(middle[1]), float(np.radians(angle_deg)))
        grown_m = 2 * _OFF_WALLS_M - space.cell_m
        # Each a hair higher than the last, so that no two lie in one plane where rooms are not quite rectangles.
        size_m, top_m = (size_m[0] + grown_m, size_m[1] + grown_m), 0.003 + 1e-5 * room
        building.box(f"floor_{room}", material, spot, size_m, -0.02, top_m, is_solid=False)
