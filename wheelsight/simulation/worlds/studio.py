"""`studio`: a furnished home of two rooms, small enough to be explored within minutes."""

from __future__ import annotations

import numpy as np

from wheelsight.areas import Area
from wheelsight.simulation.world import World
from wheelsight.simulation.worlds._building import Building, Opening, Spot
from wheelsight.simulation.worlds._furniture import bed, bin_beside, loose_chair, plant, shelf, sofa

EAST_M, NORTH_M = 8.2, 4.8
MIDDLE_M, DOORWAY_M = 4.7, 2.4  # where the wall between the rooms stands, and how far along it its doorway is
ROUTE = ((1.3, 2.3), (3.6, 2.4), (5.6, 2.4), (6.0, 1.7))


def build_studio(seed: int, day: int = 0) -> World:
    """The home; the robot starts in the living room, heading east."""
    building = Building("studio", seed, day)
    building.floor_and_ceiling("parquet", "ceiling_plain", (-0.4, -0.4, EAST_M + 0.4, NORTH_M + 0.4))
    _walls(building)
    _living(building)
    _bedroom(building)
    areas = [_area("living room", 0.0, MIDDLE_M), _area("bedroom", MIDDLE_M, EAST_M)]
    return building.world("a furnished home of two rooms", areas, ROUTE, is_loop=False)


def _walls(building: Building) -> None:
    building.walls(
        [(0.0, 0.0), (EAST_M, 0.0), (EAST_M, NORTH_M), (0.0, NORTH_M)],
        [
            ("south", "plaster_cream", ()),
            ("east", "plaster_white", [Opening(1.6, 1.2, 0.9, 2.2, "glass")]),
            ("north", "plaster_sage", ()),
            ("west", "plaster_cream", [Opening(NORTH_M - 3.5, 1.2, 0.9, 2.2, "glass")]),
        ],
    )
    through = [Opening(DOORWAY_M, 1.2)]  # as homes for wheelchairs have them
    building.partition("middle", "plaster_white", (MIDDLE_M, 0.0), (MIDDLE_M, NORTH_M), through)


def _living(building: Building) -> None:
    south, north = building.faces["south"], building.faces["north"]
    building.box("counter", "wood_light", south.spot(2.6, 0.3), (2.2, 0.6), 0.0, 0.87)
    building.box("worktop", "steel", south.spot(2.6, 0.31), (2.2, 0.62), 0.87, 0.91)
    building.hang("south", "splashback", "wall_tiles", 2.6, 2.2, 0.95, 1.5)
    building.box("fridge", "white_board", south.spot(4.2, 0.32), (0.62, 0.62), 0.0, 1.8)
    building.doors("south", "door_oak", 0.8)
    sofa(building, "sofa", north.spot(EAST_M - 1.5), 2.0)
    loose_chair(building, "chair", "north", EAST_M - 3.9, EAST_M - 3.2)
    shelf(building, "shelf", building.faces["west"].spot(NORTH_M - 1.0), 1.2)
    building.posters("north", (EAST_M - 2.4, EAST_M - 1.4), (EAST_M - 4.4, EAST_M - 3.2))
    building.posters("middle", (0.3, 1.5), (3.3, 4.6))
    building.posters("west", (NORTH_M - 2.8, NORTH_M - 1.8))
    building.cover("rug", "carpet_red", (0.8, 2.6), (2.0, 3.6))
    building.lamps((2.4, 2.4))


def _bedroom(building: Building) -> None:
    north, south = building.faces["north"], building.faces["south"]
    bed(building, "bed", north.spot(EAST_M - 7.35), 1.4)
    building.box("nightstand", "wood_light", north.spot(EAST_M - 6.35, 0.22), (0.45, 0.4), 0.0, 0.5)
    building.box("wardrobe", "door_white", south.spot(7.5, 0.3), (1.3, 0.6), 0.0, 2.1)
    plant(building, "plant", Spot(5.15, 4.4), 1.4)
    building.posters("middle_back", (0.2, 1.4), (3.3, 4.5))
    building.posters("north", (EAST_M - 6.4, EAST_M - 5.4), (EAST_M - 8.0, EAST_M - 6.8))
    building.posters("east", (2.6, 3.8))
    building.posters("south", (5.0, 6.4))
    bin_beside(building, "south", 5.2, 5.7)
    building.cover("carpet", "carpet_grey", (5.2, 7.6), (0.9, 2.6))
    building.lamps((6.4, 2.4))


def _area(name: str, west_m: float, east_m: float) -> Area:
    polygon = np.array([(west_m, 0.0), (east_m, 0.0), (east_m, NORTH_M), (west_m, NORTH_M)])
    return Area(name, polygon, (west_m + east_m) / 2, NORTH_M / 2)
