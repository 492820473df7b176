"""What a run, a map or a recording holds, in the formats of other programs: bags, trajectories, images with poses."""

from wheelsight.exports.bag import DEFAULT_VOXEL_M, BagParts, BagReport, export_bag
from wheelsight.exports.colmap import export_colmap
from wheelsight.exports.nerfstudio import export_nerfstudio
from wheelsight.exports.octomaps import export_octomap
from wheelsight.exports.sources import Exported, exported_at
from wheelsight.exports.trajectories import TRAJECTORY_FORMATS, export_trajectory

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
