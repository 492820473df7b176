"""Small worlds: the homes `flat` and `studio`, the hall `square` for UMBmark, and the corridor `blank` that shows a
camera nothing.
"""

from __future__ import annotations

import math

import numpy as np

from wheelsight.core.areas import Area
from wheelsight.core.geometry import FloatArray
from wheelsight_sim.world import World
from wheelsight_sim.worlds.building import (
    CEILING_M,
    LEAF_M,
    Building,
    Opening,
    Spot,
    bed,
    bench,
    bin_beside,
    chair,
    four_legged_table,
    loose_chair,
    plant,
    shelf,
    sofa,
    table,
)

# `flat`: a furnished home of four rooms, with a lap through all of them that a wheelchair can drive.


EAST_M, NORTH_M = 11.0, 9.6
LIVING_EAST_M, LIVING_NORTH_M, KITCHEN_NORTH_M = 6.0, 5.0, 4.4  # where the walls between rooms stand
ROUTE = ((2.4, 3.4), (4.6, 3.4), (4.6, 1.7), (7.6, 1.7), (7.6, 6.4), (1.6, 6.4), (1.6, 3.4))
_DOORWAY_M = 1.2  # as homes for wheelchairs have them


def build_flat(seed: int, day: int = 0, *, has_leaves: bool = False) -> World:
    """The home; the robot starts in the living room, heading east. Its doorways have leaves where that is wanted."""
    building = Building("flat", seed, day)
    building.floor_and_ceiling("parquet", "ceiling_plain", (-0.4, -0.4, EAST_M + 0.4, NORTH_M + 0.4))
    _walls(building)
    _living(building)
    _kitchen(building)
    _hall(building)
    _bedroom(building)
    for face, at in (("south", 4.4), ("west", NORTH_M - 2.4), ("west", NORTH_M - 6.0)):
        building.hang(face, "radiator", "radiator", at, 1.4, 0.15, 0.75, 0.1, is_solid=True)
    if has_leaves:
        _leaves(building)
    areas = [
        _area("living room", 0.0, 0.0, LIVING_EAST_M, LIVING_NORTH_M),
        _area("kitchen", LIVING_EAST_M, 0.0, EAST_M, KITCHEN_NORTH_M),
        _area("hall", LIVING_EAST_M, KITCHEN_NORTH_M, EAST_M, NORTH_M),
        _area("bedroom", 0.0, LIVING_NORTH_M, LIVING_EAST_M, NORTH_M),
    ]
    return building.world("a furnished home of four rooms", areas, ROUTE, is_loop=True)


def _walls(building: Building) -> None:
    def window(at_m: float) -> Opening:
        return Opening(at_m, 1.6, 0.9, 2.2, "glass")

    building.walls(
        [(0.0, 0.0), (EAST_M, 0.0), (EAST_M, NORTH_M), (0.0, NORTH_M)],
        [
            ("south", "plaster_cream", [window(4.4), window(8.8)]),
            ("east", "plaster_white", ()),
            ("north", "plaster_sage", [window(EAST_M - 0.9)]),
            ("west", "plaster_cream", [window(NORTH_M - 2.4), window(NORTH_M - 6.0)]),
        ],
    )
    x, y = LIVING_EAST_M, LIVING_NORTH_M
    through = [Opening(1.7, _DOORWAY_M), Opening(6.4, _DOORWAY_M)]
    building.partition("middle", "plaster_white", (x, 0.0), (x, NORTH_M), through)
    building.partition("bedroom_south", "plaster_sage", (x - 0.06, y), (0.0, y), [Opening(x - 0.06 - 1.6, _DOORWAY_M)])
    start, end = (x + 0.06, KITCHEN_NORTH_M), (EAST_M, KITCHEN_NORTH_M)
    building.partition("hall_south", "plaster_white", start, end, [Opening(7.6 - x - 0.06, _DOORWAY_M)])


def _living(building: Building) -> None:
    building.cover("rug", "carpet_red", (0.9, 3.1), (1.1, 2.7))
    sofa(building, "sofa", building.faces["south"].spot(1.9), 2.2)
    four_legged_table(building, "coffee_table", Spot(1.9, 1.8), (1.1, 0.6), 0.45)
    turn = building.loose(-0.2, 0.2)
    chair(building, "armchair", Spot(3.4, 1.1, turn), "fabric_red")
    building.box("sideboard", "wood_dark", building.faces["west"].spot(NORTH_M - 1.0, 0.22), (1.3, 0.42), 0.0, 0.55)
    building.box("television", "screen", building.faces["west"].spot(NORTH_M - 1.0, 0.2), (1.1, 0.05), 0.60, 1.25)
    shelf(building, "shelf", building.faces["bedroom_south"].spot(2.4), 1.8)
    building.posters("bedroom_south", (0.1, 1.4))
    building.posters("south", (1.2, 2.6), (5.3, 5.9))
    building.posters("middle", (2.5, 3.5), (3.6, 4.8))
    building.posters("west", (NORTH_M - 4.6, NORTH_M - 3.4))
    plant(building, "plant", Spot(5.5, 4.5), 1.5)
    building.lamps((3.0, 2.5))


def _kitchen(building: Building) -> None:
    building.cover("floor_kitchen", "tiles_light", (6.06, EAST_M), (0.0, KITCHEN_NORTH_M - 0.06))
    south, east = building.faces["south"], building.faces["east"]
    building.box("counter_south", "wood_light", south.spot(9.1, 0.3), (3.2, 0.6), 0.0, 0.87)
    building.box("worktop_south", "steel", south.spot(9.1, 0.31), (3.2, 0.62), 0.87, 0.91)
    building.hang("south", "splashback", "wall_tiles", 7.75, 0.5, 0.95, 1.5)
    building.box("counter_east", "wood_light", east.spot(1.8, 0.3), (2.3, 0.6), 0.0, 0.87)
    building.box("worktop_east", "steel", east.spot(1.8, 0.31), (2.3, 0.62), 0.87, 0.91)
    building.hang("east", "cupboard", "door_white", 1.8, 2.3, 1.45, 2.15, 0.34, is_solid=True)
    building.hang("east", "splash_tiles", "wall_tiles", 1.8, 2.3, 0.95, 1.4)
    building.box("fridge", "white_board", east.spot(3.4, 0.32), (0.62, 0.62), 0.0, 1.8)
    four_legged_table(building, "kitchen_table", Spot(9.4, 2.6), (1.0, 0.8), 0.75)
    for side, yaw in ((-1, 0.0), (1, math.pi)):
        place = Spot(9.4 + building.loose(-0.15, 0.15), 2.6 + side * 0.65, yaw + building.loose(-0.3, 0.3))
        chair(building, "kitchen_chair", place)
    building.posters("middle_back", (NORTH_M - 4.2, NORTH_M - 2.8))
    building.posters("hall_south_back", (0.4, 1.6), (1.6, 2.6))
    building.lamps((8.5, 2.2))


def _hall(building: Building) -> None:
    building.doors("east", "door_oak", 6.4)
    building.box("wardrobe", "door_white", building.faces["north"].spot(1.6, 0.3), (2.4, 0.6), 0.0, 2.1)
    building.hang("east", "mirror", "glass", 8.2, 0.6, 0.4, 1.9)
    bench(building, "bench", building.faces["hall_south"].spot(3.6), 1.2)
    building.posters("hall_south", (2.9, 4.6))
    building.posters("north", (3.0, 4.4))
    building.posters("middle_back", (0.4, 1.6), (1.6, 2.5))
    building.posters("east", (4.6, 5.8))
    loose_chair(building, "chair_hall", "east", 8.4, 8.8)
    building.cover("doormat", "carpet_brown", (10.1, 10.9), (5.9, 6.9))
    building.lamps((8.5, 7.0))


def _bedroom(building: Building) -> None:
    building.cover("bedroom_carpet", "carpet_grey", (2.0, 5.0), (5.6, 8.4))
    bed(building, "bed", building.faces["north"].spot(EAST_M - 3.2))
    for at in (-1.1, 1.1):
        spot = building.faces["north"].spot(EAST_M - 3.2 + at, 0.22)
        building.box("nightstand", "wood_light", spot, (0.45, 0.4), 0.0, 0.5)
    building.box("chest", "wood_dark", building.faces["middle"].spot(8.6, 0.24), (1.2, 0.45), 0.0, 0.85)
    building.posters("north", (EAST_M - 5.6, EAST_M - 4.5))
    building.posters("middle", (7.2, 8.2), (8.2, 9.3))
    building.posters("bedroom_south_back", (2.4, 3.8), (4.0, 5.6))
    bin_beside(building, "west", 0.4, 1.2)
    building.lamps((3.2, 7.2))


def _leaves(building: Building) -> None:
    """Leaves of the four doorways, open to where neither furniture nor the lap is."""
    out_m, x, y, z = 0.06 + LEAF_M, LIVING_EAST_M, LIVING_NORTH_M, KITCHEN_NORTH_M
    half, at_wall_rad, by_chairs_rad = _DOORWAY_M / 2 + 0.02, math.radians(175.0), math.radians(100.0)
    # Where a leaf hangs, which way it leads when it is shut, and by which turn it has been opened.
    for hinge, yaw_rad, turn_rad in (
        ((x + out_m, 1.7 + half), -math.pi / 2, at_wall_rad),
        ((x + out_m, 6.4 - half), math.pi / 2, -at_wall_rad),
        ((1.6 + half, y + out_m), math.pi, -at_wall_rad),
        ((7.6 + half, z - out_m), math.pi, by_chairs_rad),
    ):
        middle = Spot(*hinge, yaw_rad + turn_rad).offset(half, 0.0)
        building.leaf("leaf", "door_white", middle, 2 * half, hinge, -turn_rad)


def _area(name: str, x_min: float, y_min: float, x_max: float, y_max: float) -> Area:
    polygon: FloatArray = np.array([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)])
    return Area(name, polygon, (x_min + x_max) / 2, (y_min + y_max) / 2)


# `studio`: a furnished home of two rooms, small enough to be explored within minutes.


STUDIO_EAST_M, STUDIO_NORTH_M = 8.2, 4.8
MIDDLE_M, DOORWAY_M = 4.7, 2.4  # where the wall between the rooms stands, and how far along it its doorway is
STUDIO_ROUTE = ((1.3, 2.3), (3.6, 2.4), (5.6, 2.4), (6.0, 1.7))


def build_studio(seed: int, day: int = 0) -> World:
    """The home; the robot starts in the living room, heading east."""
    building = Building("studio", seed, day)
    building.floor_and_ceiling("parquet", "ceiling_plain", (-0.4, -0.4, STUDIO_EAST_M + 0.4, STUDIO_NORTH_M + 0.4))
    _studio_walls(building)
    _studio_living(building)
    _studio_bedroom(building)
    areas = [_studio_area("living room", 0.0, MIDDLE_M), _studio_area("bedroom", MIDDLE_M, STUDIO_EAST_M)]
    return building.world("a furnished home of two rooms", areas, STUDIO_ROUTE, is_loop=False)


def _studio_walls(building: Building) -> None:
    building.walls(
        [(0.0, 0.0), (STUDIO_EAST_M, 0.0), (STUDIO_EAST_M, STUDIO_NORTH_M), (0.0, STUDIO_NORTH_M)],
        [
            ("south", "plaster_cream", ()),
            ("east", "plaster_white", [Opening(1.6, 1.2, 0.9, 2.2, "glass")]),
            ("north", "plaster_sage", ()),
            ("west", "plaster_cream", [Opening(STUDIO_NORTH_M - 3.5, 1.2, 0.9, 2.2, "glass")]),
        ],
    )
    through = [Opening(DOORWAY_M, 1.2)]  # as homes for wheelchairs have them
    building.partition("middle", "plaster_white", (MIDDLE_M, 0.0), (MIDDLE_M, STUDIO_NORTH_M), through)


def _studio_living(building: Building) -> None:
    south, north = building.faces["south"], building.faces["north"]
    building.box("counter", "wood_light", south.spot(2.6, 0.3), (2.2, 0.6), 0.0, 0.87)
    building.box("worktop", "steel", south.spot(2.6, 0.31), (2.2, 0.62), 0.87, 0.91)
    building.hang("south", "splashback", "wall_tiles", 2.6, 2.2, 0.95, 1.5)
    building.box("fridge", "white_board", south.spot(4.2, 0.32), (0.62, 0.62), 0.0, 1.8)
    building.doors("south", "door_oak", 0.8)
    sofa(building, "sofa", north.spot(STUDIO_EAST_M - 1.5), 2.0)
    loose_chair(building, "chair", "north", STUDIO_EAST_M - 3.9, STUDIO_EAST_M - 3.2)
    shelf(building, "shelf", building.faces["west"].spot(STUDIO_NORTH_M - 1.0), 1.2)
    building.posters("north", (STUDIO_EAST_M - 2.4, STUDIO_EAST_M - 1.4), (STUDIO_EAST_M - 4.4, STUDIO_EAST_M - 3.2))
    building.posters("middle", (0.3, 1.5), (3.3, 4.6))
    building.posters("west", (STUDIO_NORTH_M - 2.8, STUDIO_NORTH_M - 1.8))
    building.cover("rug", "carpet_red", (0.8, 2.6), (2.0, 3.6))
    building.lamps((2.4, 2.4))


def _studio_bedroom(building: Building) -> None:
    north, south = building.faces["north"], building.faces["south"]
    bed(building, "bed", north.spot(STUDIO_EAST_M - 7.35), 1.4)
    building.box("nightstand", "wood_light", north.spot(STUDIO_EAST_M - 6.35, 0.22), (0.45, 0.4), 0.0, 0.5)
    building.box("wardrobe", "door_white", south.spot(7.5, 0.3), (1.3, 0.6), 0.0, 2.1)
    plant(building, "plant", Spot(5.15, 4.4), 1.4)
    building.posters("middle_back", (0.2, 1.4), (3.3, 4.5))
    building.posters("north", (STUDIO_EAST_M - 6.4, STUDIO_EAST_M - 5.4), (STUDIO_EAST_M - 8.0, STUDIO_EAST_M - 6.8))
    building.posters("east", (2.6, 3.8))
    building.posters("south", (5.0, 6.4))
    bin_beside(building, "south", 5.2, 5.7)
    building.cover("carpet", "carpet_grey", (5.2, 7.6), (0.9, 2.6))
    building.lamps((6.4, 2.4))


def _studio_area(name: str, west_m: float, east_m: float) -> Area:
    polygon = np.array([(west_m, 0.0), (east_m, 0.0), (east_m, STUDIO_NORTH_M), (west_m, STUDIO_NORTH_M)])
    return Area(name, polygon, (west_m + east_m) / 2, STUDIO_NORTH_M / 2)


# `square`: a hall with the square of 4 m by 4 m that UMBmark drives (Borenstein and Feng 1996), both ways round.


SIDE_M = 4.0
_MARGIN_M = 2.5


def build_square(seed: int, day: int = 0) -> World:
    """The hall; its corner (0, 0) is where the robot starts, heading along x."""
    building = Building("square", seed, day)
    low, high = -_MARGIN_M, SIDE_M + _MARGIN_M
    building.floor_and_ceiling("tiles_grey", "ceiling_panels", (low - 0.4, low - 0.4, high + 0.4, high + 0.4))
    building.walls(
        [(low, low), (high, low), (high, high), (low, high)],
        [
            ("south", "plaster_white", ()),
            ("east", "plaster_cream", [Opening(at, 1.8, 0.9, 2.2, "glass") for at in (2.2, 6.8)]),
            ("north", "plaster_white", ()),
            ("west", "plaster_sage", ()),
        ],
    )
    _dress(building)
    route = [(0, 0), (SIDE_M, 0), (SIDE_M, SIDE_M), (0, SIDE_M)]
    return building.world("the square of 4 m by 4 m that UMBmark drives, in a hall", (), route, is_loop=True)


def _dress(building: Building) -> None:
    building.cover("carpet", "carpet_blue", (1.0, 3.0), (1.0, 3.0))
    building.doors("south", "door_oak", 1.6)
    building.posters("south", (2.4, 3.7), (3.7, 5.0), (6.9, 8.2))
    building.hang("south", "notice_board", "notice_cork", 5.95, 1.6, 0.9, 2.1)
    loose_chair(building, "chair_south", "south", 7.0, 8.2)
    building.posters("east", (0.2, 1.2), (3.3, 4.5), (4.5, 5.7), (7.8, 8.8))
    bench(building, "bench", building.faces["east"].spot(4.5))
    building.doors("north", "door_fire", 4.0, 5.02)
    building.posters("north", (0.5, 1.8), (1.8, 3.1), (6.0, 7.3), (7.3, 8.6))
    bin_beside(building, "north", 5.9, 7.2)
    shelf(building, "shelf", building.faces["west"].spot(2.0), 1.6)
    building.hang("west", "notice_board", "notice_felt", 4.6, 2.0, 0.9, 2.1)
    building.posters("west", (5.8, 7.1), (7.1, 8.4))
    table(building, "table", building.faces["west"].spot(6.6, 0.45), (1.4, 0.7))
    plant(building, "plant", building.faces["west"].spot(8.5, 0.5))


# `blank`: a corridor whose middle shows a camera nothing: 28 m of plain paint, plain floor and plain ceiling.


LENGTH_M, WIDTH_M = 44.0, 2.4
BLANK_M = (8.0, 36.0)  # along x: where there is nothing to see


def build_blank(seed: int, day: int = 0) -> World:
    """The corridor; the robot starts at its west end and drives to the other."""
    building = Building("blank", seed, day)
    building.floor_and_ceiling("screed_plain", "ceiling_plain", (-0.4, -0.4, LENGTH_M + 0.4, WIDTH_M + 0.4))
    begin, end = BLANK_M
    window = Opening(4.0, 1.8, 0.9, 2.2, "glass")
    building.walls(
        [
            (0, 0),
            (begin, 0),
            (end, 0),
            (LENGTH_M, 0),
            (LENGTH_M, WIDTH_M),
            (end, WIDTH_M),
            (begin, WIDTH_M),
            (0, WIDTH_M),
        ],
        [
            ("south_west", "plaster_cream", ()),
            ("south", "paint_plain", ()),
            ("south_east", "plaster_white", [window]),
            ("east", "plaster_white", ()),
            ("north_east", "plaster_white", ()),
            ("north", "paint_plain", ()),
            ("north_west", "plaster_cream", ()),
            ("west", "plaster_cream", ()),
        ],
    )
    _dress_ends(building)
    middle = WIDTH_M / 2
    areas = [
        _blank_area("west end", 0.0, begin, x_m=begin / 2),
        _blank_area("blank", begin, end, x_m=None),
        _blank_area("east end", end, LENGTH_M, x_m=(end + LENGTH_M) / 2),
    ]
    description = f"a corridor of {LENGTH_M:g} m, {end - begin:g} m of which show nothing"
    return building.world(description, areas, [(2.0, middle), (LENGTH_M - 1.6, middle)], is_loop=False)


def _dress_ends(building: Building) -> None:
    begin, end = BLANK_M
    ends = {"west": (0.0, begin), "east": (end, LENGTH_M)}
    for side, x in ends.items():
        spot = Spot((x[0] + x[1]) / 2, WIDTH_M / 2)
        size = (x[1] - x[0], WIDTH_M)
        building.box(
            f"ceiling_{side}", "ceiling_panels", spot, size, CEILING_M - 0.01, CEILING_M + 0.02, is_solid=False
        )
    building.cover("floor_west", "carpet_blue", ends["west"], (0.0, WIDTH_M))
    building.cover("floor_east", "tiles_dark", ends["east"], (0.0, WIDTH_M))
    building.doors("south_west", "door_oak", 2.0, 5.6)
    building.posters("south_west", (0.2, 1.4), (2.8, 4.8), (6.4, 7.8))
    building.doors("north_west", "door_oak", 4.2)
    building.hang("north_west", "notice_board", "notice_cork", 1.8, 1.8, 0.9, 2.1)
    building.posters("north_west", (5.0, 6.4), (6.6, 7.8))
    building.posters("west", (0.5, 1.9))
    bin_beside(building, "north_west", 5.2, 6.4)
    building.posters("south_east", (0.3, 1.4), (1.5, 2.8), (5.2, 6.6))
    building.hang("south_east", "radiator", "radiator", 4.0, 1.5, 0.15, 0.75, 0.1, is_solid=True)
    building.doors("north_east", "door_blue", 1.4, 4.6)
    building.posters("north_east", (2.2, 3.8), (5.4, 6.8))
    loose_chair(building, "chair", "north_east", 6.2, 7.0)
    building.doors("east", "door_fire", 0.7, 1.7, width_m=0.98)
    bench(building, "bench", building.faces["south_east"].spot(2.0), 1.2)
    plant(building, "plant", Spot(0.45, 0.45))


def _blank_area(name: str, begin_m: float, end_m: float, x_m: float | None) -> Area:
    polygon: FloatArray = np.array([(begin_m, 0.0), (end_m, 0.0), (end_m, WIDTH_M), (begin_m, WIDTH_M)])
    return Area(name, polygon, x_m, WIDTH_M / 2)
