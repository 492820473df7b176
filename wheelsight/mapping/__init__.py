"""Mapping: surfels that frames are fused into, views predicted from them, files and meshes; occupancy of the floor."""

from wheelsight.mapping.export import Mesh, colors_of, mesh_of, write_mesh_ply, write_ply
from wheelsight.mapping.map_edits import EditKind, MapEdit, MapEdits, roomiest_place
from wheelsight.mapping.named_poses import NamedPose, NamedPoses
from wheelsight.mapping.occupancy import CellKind, OccupancyGrid, OccupancyMapper, OccupancySettings
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
    "Mesh",
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
    "mesh_of",
    "roomiest_place",
    "save_map",
    "write_mesh_ply",
    "write_ply",
]
