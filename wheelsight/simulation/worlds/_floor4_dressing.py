"""What stands and hangs on `floor4`, area by area."""

from __future__ import annotations

import math

from wheelsight.simulation.worlds._building import Building, Spot
from wheelsight.simulation.worlds._furniture import (
    bench,
    bin_beside,
    chair,
    desk,
    loose_chair,
    plant,
    shelf,
    table,
)


def dress(building: Building) -> None:
    """Everything but walls and floors."""
    for part in (_corridor_1, _lifts, _corridor_3, _stairs, _hall, _kitchen, _corridor_7, _corridor_8, _rooms):
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


def _rooms(building: Building) -> None:
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
