"""Mapping: surfels that frames are fused into, views predicted from them, files and meshes."""

from wheelsight.mapping.export import Mesh, mesh_of, write_mesh_ply, write_ply
from wheelsight.mapping.settings import SurfelSettings
from wheelsight.mapping.storage import load_map, save_map
from wheelsight.mapping.surfels import SurfelMap
from wheelsight.mapping.values import ColoredView, FusedFrame, MapStatus, Surfels

__all__ = [
    "ColoredView",
    "FusedFrame",
    "MapStatus",
    "Mesh",
    "SurfelMap",
    "SurfelSettings",
    "Surfels",
    "load_map",
    "mesh_of",
    "save_map",
    "write_mesh_ply",
    "write_ply",
]
