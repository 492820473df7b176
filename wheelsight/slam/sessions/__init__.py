"""Maps that outlast a drive: a folder of keyframes, where they are and how they hang together.

Written while driving so that a kill at any moment loses the last seconds at most; opened by the next drive.
"""

from wheelsight.slam.sessions.edges import SeenKeyframe, odometry_edge
from wheelsight.slam.sessions.hanging import lie_together
from wheelsight.slam.sessions.header import DRIVE, MapCamera, MapHeader
from wheelsight.slam.sessions.info import MAP_FOLDER, MapInfo, find_map, info_of, is_map
from wheelsight.slam.sessions.kept import KeptKeyframes
from wheelsight.slam.sessions.map_folder import MapFolder, discard_map
from wheelsight.slam.sessions.merging import MergedMap, merge
from wheelsight.slam.sessions.occupancy import driven_way, occupancy_of, save_occupancy
from wheelsight.slam.sessions.pruning import PrunedMap, prune
from wheelsight.slam.sessions.reading import FolderContents, Health
from wheelsight.slam.sessions.rebuilding import fused_anew, rebuild
from wheelsight.slam.sessions.records import Place
from wheelsight.slam.sessions.settings import PruneSettings, SessionSettings
from wheelsight.slam.sessions.writer import MapWriter

__all__ = [
    "DRIVE",
    "MAP_FOLDER",
    "FolderContents",
    "Health",
    "KeptKeyframes",
    "MapCamera",
    "MapFolder",
    "MapHeader",
    "MapInfo",
    "MapWriter",
    "MergedMap",
    "Place",
    "PruneSettings",
    "PrunedMap",
    "SeenKeyframe",
    "SessionSettings",
    "discard_map",
    "driven_way",
    "find_map",
    "fused_anew",
    "info_of",
    "is_map",
    "lie_together",
    "merge",
    "occupancy_of",
    "odometry_edge",
    "prune",
    "rebuild",
    "save_occupancy",
]
