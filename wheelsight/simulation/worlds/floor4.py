"""`floor4`: a floor after Trinh et al., Figs. 5 and 7: corridors round a core, eight areas, a lap of 115 m.

The lap runs anticlockwise from the south-west: corridor 1 eastwards, the lift lobby 2, corridor 3 northwards, the
stairs 4, the entrance hall 5, the kitchen 6, corridor 7 westwards and corridor 8 southwards.
"""

from __future__ import annotations

import numpy as np

from wheelsight.areas import Area
from wheelsight.geometry import FloatArray
from wheelsight.simulation.world import World
from wheelsight.simulation.worlds import _floor4_dressing as dressing
from wheelsight.simulation.worlds._building import CEILING_M, Building, Opening

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
    dressing.dress(building)
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
    """Named as in the paper: 2, 4, 5 and 6 tell both coordinates, the corridors the one that they do not run along."""
    return [
        _area("1", 0.0, 0.0, 35.0, 2.8, tells="y"),
        _area("2", 35.0, 0.0, 41.0, 6.0, tells="xy"),
        _area("3", 38.4, 6.0, 41.0, 17.0, tells="x"),
        _area("4", 35.0, 17.0, 41.0, 23.0, tells="xy"),
        _area("5", 25.0, 16.0, 35.0, 25.0, tells="xy"),
        _area("6", 18.5, 14.6, 25.0, 22.6, tells="xy"),
        _area("7", 2.4, 14.6, 18.5, 17.2, tells="y"),
        _area("8", 0.0, 2.8, 2.4, 17.2, tells="x"),
    ]


def _area(name: str, x_min: float, y_min: float, x_max: float, y_max: float, tells: str) -> Area:
    """A rectangle; the coordinates it tells are those of its centre."""
    polygon: FloatArray = np.array([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)])
    x_m, y_m = (x_min + x_max) / 2, (y_min + y_max) / 2
    return Area(name, polygon, x_m if "x" in tells else None, y_m if "y" in tells else None)
