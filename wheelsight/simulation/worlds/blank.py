"""`blank`: a corridor whose middle shows a camera nothing: 28 m of plain paint, plain floor and plain ceiling."""

from __future__ import annotations

import numpy as np

from wheelsight.areas import Area
from wheelsight.geometry import FloatArray
from wheelsight.simulation.world import World
from wheelsight.simulation.worlds._building import CEILING_M, Building, Opening, Spot
from wheelsight.simulation.worlds._furniture import bench, bin_beside, loose_chair, plant

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
        _area("west end", 0.0, begin, x_m=begin / 2),
        _area("blank", begin, end, x_m=None),
        _area("east end", end, LENGTH_M, x_m=(end + LENGTH_M) / 2),
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


def _area(name: str, begin_m: float, end_m: float, x_m: float | None) -> Area:
    polygon: FloatArray = np.array([(begin_m, 0.0), (end_m, 0.0), (end_m, WIDTH_M), (begin_m, WIDTH_M)])
    return Area(name, polygon, x_m, WIDTH_M / 2)
