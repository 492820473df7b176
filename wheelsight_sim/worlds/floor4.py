"""`floor4`: a floor after Trinh et al., Figs. 5 and 7: corridors round a core, eight areas, a lap of 115 m."""

from __future__ import annotations

import math

import numpy as np

from wheelsight.core.areas import Area
from wheelsight.core.geometry import FloatArray
from wheelsight_sim.world import World
from wheelsight_sim.worlds.building import (
    CEILING_M,
    Building,
    Opening,
    Spot,
    bench,
    bin_beside,
    chair,
    desk,
    loose_chair,
    plant,
    shelf,
    table,
)

# `floor4`: a floor after Trinh et al., Figs. 5 and 7: corridors round a core, eight areas, a lap of 115 m.
#
# The lap runs anticlockwise from the south-west: corridor 1 eastwards, the lift lobby 2, corridor 3 northwards, the
# stairs 4, the entrance hall 5, the kitchen 6, corridor 7 westwards and corridor 8 southwards.


ROUTE = (
    (4.0, 1.4),
    (39.7, 1.4),
    (39.7, 20.6),
    (21.8, 20.6),
    (21.8, 15.9),
    (1.2, 15.9),
    (1.2, 1.4),
)


def build_floor4(seed: int, day: int = 0) -> World:
    """The floor; the robot starts in corridor 1, heading east."""
    building = Building("floor4", seed, day)
    building.floor_and_ceiling("tiles_grey", "ceiling_panels", (-0.4, -0.4, 41.4, 26.8))
    _outer_walls(building)
    _core_walls(building)
    _rooms(building)
    _floors(building)
    dress(building)
    description = "a building's floor after Trinh et al.: corridors round a core, eight areas, a lap of 115 m"
    return building.world(description, _areas(), ROUTE, is_loop=True)


def _window(at_m: float, width_m: float = 1.6) -> Opening:
    return Opening(at_m, width_m, 0.9, 2.2, "glass")


def _outer_walls(building: Building) -> None:
    """Anticlockwise from the south-west corner."""
    corners = [
        (0.0, 0.0),
        (35.0, 0.0),
        (41.0, 0.0),
        (41.0, 6.0),
        (41.0, 17.0),
        (41.0, 23.0),
        (35.0, 23.0),
        (35.0, 25.0),
        (25.0, 25.0),
        (25.0, 22.6),
        (18.5, 22.6),
        (18.5, 17.2),
        (0.0, 17.2),
    ]
    building.walls(
        corners,
        [
            ("south", "plaster_white", ()),
            ("lifts_south", "plaster_grey", ()),
            ("lifts_east", "plaster_grey", ()),
            ("east", "plaster_cream", [_window(at) for at in (2.0, 5.5, 9.0)]),
            ("stairs_east", "plaster_sage", [_window(3.0, 2.4)]),
            ("stairs_north", "plaster_sage", [Opening(3.7, 2.6, 0.0, CEILING_M)]),
            ("hall_east", "plaster_white", ()),
            ("hall_north", "plaster_white", [_window(at, 2.0) for at in (2.0, 5.0, 8.0)]),
            ("hall_west", "plaster_white", ()),
            ("kitchen_north", "plaster_cream", ()),
            ("kitchen_west", "wall_tiles", ()),
            ("north", "plaster_white", [Opening(18.5 - 9.2)]),
            ("west", "plaster_grey", [_window(17.2 - y) for y in (4.5, 7.5, 10.5, 13.5)]),
        ],
    )


def _core_walls(building: Building) -> None:
    """Clockwise from the south-west corner, so that corridors are on the left."""
    corners = [
        (2.4, 2.8),
        (2.4, 14.6),
        (18.5, 14.6),
        (25.0, 14.6),
        (25.0, 16.0),
        (35.0, 16.0),
        (35.0, 17.0),
        (38.4, 17.0),
        (38.4, 6.0),
        (35.0, 6.0),
        (35.0, 2.8),
    ]
    meeting_room = [Opening(17 - 10.0), Opening(17 - 12.2, 2.0, 0.9, 2.1, "glass")]
    alcove = Opening(35 - 23.5, 3.0, 0.0, CEILING_M)
    building.walls(
        corners,
        [
            ("core_west", "plaster_white", [Opening(8.5 - 2.8)]),
            ("core_north", "plaster_white", ()),
            ("core_kitchen", "plaster_cream", ()),
            ("core_kitchen_east", "plaster_cream", ()),
            ("core_hall", "panelling", ()),
            ("core_hall_east", "panelling", ()),
            ("core_stairs", "plaster_sage", ()),
            ("core_east", "plaster_cream", meeting_room),
            ("core_lifts", "plaster_grey", ()),
            ("core_lifts_west", "plaster_grey", ()),
            ("core_south", "plaster_white", [Opening(35 - 9.5), alcove]),
        ],
    )


def _rooms(building: Building) -> None:
    """Rooms behind the doorways, to be looked into: three walls each, anticlockwise."""
    rooms = {
        "office": ("plaster_sage", [(12.0, 3.0), (12.0, 6.6), (7.0, 6.6), (7.0, 3.0)]),
        "alcove": ("plaster_cream", [(25.0, 3.0), (25.0, 4.4), (22.0, 4.4), (22.0, 3.0)]),
        "meeting": ("plaster_white", [(38.2, 13.5), (34.4, 13.5), (34.4, 9.0), (38.2, 9.0)]),
        "laboratory": ("plaster_white", [(2.6, 7.0), (6.2, 7.0), (6.2, 10.5), (2.6, 10.5)]),
        "studio": ("brick_tiles", [(11.5, 17.4), (11.5, 20.6), (7.0, 20.6), (7.0, 17.4)]),
        "stairs": ("plaster_sage", [(38.6, 23.2), (38.6, 26.4), (36.0, 26.4), (36.0, 23.2)]),
    }
    for room, (material, corners) in rooms.items():
        sides = [(f"{room}_{side}", material, ()) for side in ("first", "back", "last")]
        building.walls(corners, sides, is_closed=False, thickness_m=0.1)


def _floors(building: Building) -> None:
    """Tiles are laid everywhere; carpets and other tiles over them."""
    building.cover("floor_lifts", "tiles_dark", (35.0, 41.0), (0.0, 6.0))
    building.cover("floor_corridor_3", "carpet_blue", (38.4, 41.0), (6.0, 17.0))
    building.cover("floor_hall", "tiles_light", (25.0, 35.0), (16.0, 25.0))
    building.cover("floor_kitchen", "parquet", (18.5, 25.0), (14.6, 22.6))
    building.cover("floor_corridor_7", "carpet_grey", (2.4, 18.5), (14.6, 17.2))
    building.cover("floor_meeting", "carpet_brown", (34.4, 38.4), (9.0, 13.5))
    building.cover("floor_office", "carpet_brown", (7.0, 12.0), (2.8, 6.6))
    building.cover("floor_studio", "parquet", (7.0, 11.5), (17.2, 20.6))


def _areas() -> list[Area]:
    """Areas as in the paper: 2, 4, 5 and 6 give both coordinates, corridors the one across."""
    return [
        _area("1", 0.0, 0.0, 35.0, 2.8, axes="y"),
        _area("2", 35.0, 0.0, 41.0, 6.0, axes="xy"),
        _area("3", 38.4, 6.0, 41.0, 17.0, axes="x"),
        _area("4", 35.0, 17.0, 41.0, 23.0, axes="xy"),
        _area("5", 25.0, 16.0, 35.0, 25.0, axes="xy"),
        _area("6", 18.5, 14.6, 25.0, 22.6, axes="xy"),
        _area("7", 2.4, 14.6, 18.5, 17.2, axes="y"),
        _area("8", 0.0, 2.8, 2.4, 17.2, axes="x"),
    ]


def _area(name: str, x_min: float, y_min: float, x_max: float, y_max: float, axes: str) -> Area:
    """A rectangle that gives some coordinates of its centre."""
    polygon: FloatArray = np.array([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)])
    x_m, y_m = (x_min + x_max) / 2, (y_min + y_max) / 2
    return Area(name, polygon, x_m if "x" in axes else None, y_m if "y" in axes else None)


# What stands and hangs on `floor4`, area by area.


def dress(building: Building) -> None:
    """Everything but walls and floors."""
    for part in (
        _corridor_1,
        _lifts,
        _corridor_3,
        _stairs,
        _hall,
        _kitchen,
        _corridor_7,
        _corridor_8,
        _floor4_dressing_rooms,
    ):
        part(building)


def _corridor_1(building: Building) -> None:
    """Doors in even rhythm on both sides, notices between them."""
    building.doors("south", "door_oak", 1.2, 4.5, 11.0, 17.5, 24.0, 30.5)
    building.doors("core_south", "door_oak", 35 - 4.5, 35 - 14.5, 35 - 18.5, 35 - 28.0, 35 - 32.0)
    building.hang("south", "notice_board", "notice_felt", 2.9, 1.6, 0.75, 1.95)
    building.hang("south", "notice_board", "notice_cork", 14.2, 2.4, 0.9, 2.1)
    building.posters("south", (6.0, 8.0), (8.5, 10.2), (19.0, 21.0), (21.2, 23.2), (26.0, 28.0), (32.0, 34.0))
    building.posters("core_south", (0.6, 2.2), (4.2, 5.9), (8.0, 9.8), (14.0, 16.0), (17.4, 19.6), (27.0, 29.6))
    bin_beside(building, "south", 19.0, 22.5)
    loose_chair(building, "chair_corridor_1", "core_south", 17.6, 19.4)


def _lifts(building: Building) -> None:
    """A lobby with two lifts."""
    building.doors("core_lifts", "door_lift", 0.95, 2.45, width_m=1.1, height_m=2.2)
    building.hang("core_lifts_west", "sign", "sign", 1.6, 0.5, 1.5, 2.2)
    building.posters("lifts_south", (0.8, 2.8), (3.4, 5.4))
    building.doors("lifts_east", "door_fire", 1.7)
    building.posters("lifts_east", (2.6, 4.4), (4.6, 5.8))
    bench(building, "bench_lifts", building.faces["lifts_east"].spot(3.6))
    plant(building, "plant_lifts", Spot(35.6, 5.3))


def _corridor_3(building: Building) -> None:
    """Carpet, windows to the east, a meeting room behind glass."""
    building.doors("core_east", "door_blue", 1.6, 9.9)
    building.posters("core_east", (2.4, 3.6), (8.0, 9.2))
    building.posters("east", (3.0, 4.5), (6.5, 8.0))
    for at in (2.0, 5.5, 9.0):
        building.hang("east", "radiator", "radiator", at, 1.4, 0.15, 0.75, 0.1, is_solid=True)


def _stairs(building: Building) -> None:
    """Stairs that climb northwards from an alcove, a fire door opposite."""
    building.doors("core_stairs", "door_fire", 1.2, 2.22, width_m=1.0)
    for step in range(8):
        building.box(f"step_{step + 1}", "concrete", Spot(37.3, 23.9 + 0.3 * step), (2.6, 0.3), 0.0, 0.17 * (step + 1))
    building.posters("stairs_east", (0.2, 1.6), (4.4, 5.8))
    building.hang("stairs_north", "sign", "sign", 5.55, 0.4, 1.5, 2.1)
    building.posters("stairs_north", (0.2, 2.2))
    bin_beside(building, "stairs_east", 4.6, 5.6)


def _hall(building: Building) -> None:
    """Pillars, a counter before panelling, places to sit under the windows."""
    for x in (27.4, 32.6):
        for y in (18.3, 23.0):
            building.cylinder("pillar", "concrete", Spot(x, y), 0.28, 0.0, 2.8)
    building.box("counter", "wood_dark", Spot(30.0, 17.3), (3.2, 0.6), 0.0, 1.08)
    building.box("counter_top", "white_board", Spot(30.0, 17.32), (3.4, 0.7), 1.08, 1.12)
    building.posters("core_hall", (0.6, 2.2), (3.4, 4.8), (5.4, 6.8), (7.8, 9.4))
    building.hang("hall_east", "notice_board", "notice_felt", 1.0, 1.7, 0.8, 2.2)
    building.hang("hall_west", "notice_board", "notice_cork", 1.5, 2.4, 0.8, 2.2)
    for at in (2.0, 8.0):
        bench(building, "bench_hall", building.faces["hall_north"].spot(at), 1.8)
    loose_chair(building, "chair_hall", "hall_north", 4.2, 4.7)
    loose_chair(building, "chair_hall", "hall_north", 5.3, 5.8)
    building.posters("hall_north", (3.1, 3.9), (6.1, 6.9))
    plant(building, "plant_hall", Spot(25.6, 16.6), 1.6)
    plant(building, "plant_hall", Spot(34.4, 16.6), 1.6)


def _kitchen(building: Building) -> None:
    """A counter with cupboards before tiles, vending machines, a table."""
    counter = building.faces["kitchen_west"]
    building.box("kitchen_counter", "wood_light", counter.spot(2.9, 0.3), (3.2, 0.6), 0.0, 0.88)
    building.box("kitchen_top", "steel", counter.spot(2.9, 0.31), (3.24, 0.64), 0.88, 0.92)
    building.box("kitchen_cupboard", "door_white", counter.spot(2.9, 0.18), (3.2, 0.36), 1.45, 2.1)
    machines = building.faces["kitchen_north"]
    building.box("machine", "machine", machines.spot(1.3, 0.4), (0.95, 0.78), 0.0, 1.85)
    building.box("machine_dark", "screen", machines.spot(2.35, 0.38), (0.8, 0.74), 0.0, 1.8)
    building.posters("kitchen_north", (3.4, 5.0))
    table(building, "kitchen_table", Spot(24.0, 16.6), (0.8, 1.2))
    chair(building, "kitchen_chair", Spot(23.9, 15.65, building.loose(-0.3, 0.3)), "fabric_red")
    chair(building, "kitchen_chair", Spot(24.0, 17.6, math.pi + building.loose(-0.3, 0.3)), "fabric_red")
    building.doors("core_kitchen", "door_oak", 2.3)
    building.hang("core_kitchen", "notice_board", "notice_cork", 3.9, 1.8, 0.9, 2.1)
    building.posters("core_kitchen", (0.4, 1.7), (4.9, 5.7))
    bin_beside(building, "core_kitchen", 0.5, 1.6)


def _corridor_7(building: Building) -> None:
    """Lockers on one side, blue doors on the other."""
    for number in range(3):
        building.hang(
            "north", f"locker_{number + 1}", "locker", 2.2 + 1.6 * number, 1.58, 0.0, 1.8, 0.42, is_solid=True
        )
    building.doors("core_north", "door_blue", 3.0, 8.0, 13.0)
    building.doors("north", "door_blue", 12.6, 16.0)
    building.posters("north", (7.2, 8.4), (10.3, 11.8), (13.4, 15.2))
    building.posters("core_north", (0.8, 2.2), (4.2, 5.6), (9.0, 10.4), (14.2, 15.8))
    building.hang("core_north", "notice_board", "notice_felt", 6.5, 1.2, 0.9, 2.1)
    bin_beside(building, "core_north", 9.4, 11.6)


def _corridor_8(building: Building) -> None:
    """Windows over radiators, few doors."""
    building.doors("core_west", "door_oak", 1.8, 9.6)
    building.posters("core_west", (2.8, 4.6), (6.9, 8.6), (10.4, 11.6))
    building.hang("west", "notice_board", "notice_cork", 0.95, 1.6, 0.8, 2.0)
    building.doors("west", "door_oak", 2.35)
    building.hang("west", "notice_board", "notice_felt", 15.9, 1.4, 0.9, 2.1)
    for y in (4.5, 7.5, 10.5, 13.5):
        building.hang("west", "radiator", "radiator", 17.2 - y, 1.4, 0.15, 0.75, 0.1, is_solid=True)
    building.posters("west", (4.7, 5.7), (7.7, 8.7), (10.7, 11.7))
    bin_beside(building, "west", 13.9, 14.3)


def _floor4_dressing_rooms(building: Building) -> None:
    """Behind the doorways, where a camera that passes looks in."""
    desk(building, "office_desk", building.faces["office_back"].spot(2.6))
    shelf(building, "office_shelf", building.faces["office_last"].spot(1.8), 1.6, rows=3)
    building.posters("office_back", (3.4, 4.8))
    building.box("copier", "plastic_grey", building.faces["alcove_back"].spot(0.9, 0.35), (1.1, 0.65), 0.0, 1.05)
    building.box("copier_top", "plastic_black", building.faces["alcove_back"].spot(0.9, 0.37), (0.9, 0.6), 1.05, 1.13)
    building.hang("alcove_back", "notice_board", "notice_cork", 2.2, 1.2, 1.0, 2.0)
    table(building, "meeting_table", Spot(36.4, 11.3), (1.2, 2.4))
    for y in (10.6, 11.9):
        chair(building, "meeting_chair", Spot(35.5, y, -math.pi / 2 + building.loose(-0.3, 0.3)))
    building.hang("meeting_back", "white_board", "white_board", 2.2, 2.4, 0.9, 2.1)
    desk(building, "laboratory_desk", building.faces["laboratory_back"].spot(2.2))
    building.box("cupboard", "wood_light", building.faces["laboratory_last"].spot(1.2, 0.25), (1.6, 0.5), 0.0, 1.95)
    building.posters("laboratory_back", (0.2, 1.4))
    shelf(building, "studio_shelf", building.faces["studio_back"].spot(2.3), 2.0, rows=3)
    table(building, "studio_table", Spot(8.4, 19.0), (1.2, 0.8))
