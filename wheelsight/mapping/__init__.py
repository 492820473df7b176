"""Mapping: surfels that frames are fused into, views predicted from them, files; occupancy of the floor."""

from wheelsight.mapping.map_edits import EditKind, MapEdit, MapEdits, roomiest_place
from wheelsight.mapping.named_poses import NamedPose, NamedPoses
from wheelsight.mapping.occupancy import CellKind, OccupancyGrid, OccupancyMapper, OccupancySettings
from wheelsight.mapping.plan import colors_of
from wheelsight.mapping.storage import load_map, save_map
from wheelsight.mapping.surfels import ColoredView, FusedFrame, MapStatus, SurfelMap, Surfels, SurfelSettings

__all__ = [
    "CellKind",
    "ColoredView",
    "EditKind",
    "FusedFrame",
    "MapEdit",
    "MapEdits",
    "MapStatus",
    "NamedPose",
    "NamedPoses",
    "OccupancyGrid",
    "OccupancyMapper",
    "OccupancySettings",
    "SurfelMap",
    "SurfelSettings",
    "Surfels",
    "colors_of",
    "load_map",
    "roomiest_place",
    "save_map",
]
