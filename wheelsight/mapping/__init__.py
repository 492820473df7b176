"""Mapping: surfels that frames are fused into, views predicted from them, files and meshes."""

from wheelsight.mapping.settings import SurfelSettings
from wheelsight.mapping.surfels import ColoredView, FusedFrame, MapStatus, SurfelMap, Surfels

__all__ = ["ColoredView", "FusedFrame", "MapStatus", "SurfelMap", "SurfelSettings", "Surfels"]
