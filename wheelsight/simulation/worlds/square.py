"""`square`: a hall with the square of 4 m by 4 m that UMBmark drives (Borenstein and Feng 1996), both ways round."""

from __future__ import annotations

from wheelsight.simulation.world import World
from wheelsight.simulation.worlds._building import Building, Opening
from wheelsight.simulation.worlds._furniture import bench, bin_beside, loose_chair, plant, shelf, table

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
