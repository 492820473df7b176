"""Exports of runs, maps and recordings in formats of other programs: bags, trajectories, images with poses."""

from wheelsight.app.exports.bag import DEFAULT_VOXEL_M, BagParts, BagReport, export_bag
from wheelsight.app.exports.reconstruction import (
    TRAJECTORY_FORMATS,
    export_colmap,
    export_nerfstudio,
    export_octomap,
    export_trajectory,
)
from wheelsight.app.exports.sources import Exported, exported_at

__all__ = [
    "DEFAULT_VOXEL_M",
    "TRAJECTORY_FORMATS",
    "BagParts",
    "BagReport",
    "Exported",
    "export_bag",
    "export_colmap",
    "export_nerfstudio",
    "export_octomap",
    "export_trajectory",
    "exported_at",
]
