"""Map folders, which persist between drives: keyframes, their poses, and the edges between them.

A map is written while driving, so that a kill loses the last seconds at most. The next drive opens it.
"""

from wheelsight.slam.maps.contents import (
    MAP_FOLDER,
    MapInfo,
    driven_way,
    find_map,
    in_largest_piece,
    info_of,
    is_map,
    occupancy_of,
    save_occupancy,
)
from wheelsight.slam.maps.folder import MapFolder, discard_map
from wheelsight.slam.maps.journal import DRIVE
from wheelsight.slam.maps.rebuilding import MergedMap, fuse_keyframes, merge, prune, rebuild
from wheelsight.slam.maps.writer import MapWriter, SeenKeyframe, odometry_edge
from wheelsight.slam.settings import SessionSettings

__all__ = [
    "DRIVE",
    "MAP_FOLDER",
    "MapFolder",
    "MapInfo",
    "MapWriter",
    "MergedMap",
    "SeenKeyframe",
    "SessionSettings",
    "discard_map",
    "driven_way",
    "find_map",
    "fuse_keyframes",
    "in_largest_piece",
    "info_of",
    "is_map",
    "merge",
    "occupancy_of",
    "odometry_edge",
    "prune",
    "rebuild",
    "save_occupancy",
]
