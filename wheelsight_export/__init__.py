"""Exports of runs, maps and recordings for other programs: bags, meshes, images with poses, Rerun's viewer, traces.

Each name is loaded at its first use.
"""

from typing import TYPE_CHECKING, Any

from wheelsight.core.runtime import public_name

if TYPE_CHECKING:
    from wheelsight_export.bag import DEFAULT_VOXEL_M, BagParts, BagReport, export_bag
    from wheelsight_export.meshes import Mesh, mesh_of, write_mesh_ply, write_ply
    from wheelsight_export.reconstruction import (
        TRAJECTORY_FORMATS,
        export_colmap,
        export_nerfstudio,
        export_octomap,
        export_trajectory,
    )
    from wheelsight_export.rerun_logs import (
        SPAWN,
        DriveLog,
        RerunLog,
        is_file,
        open_drive_log,
        open_rerun,
        start_viewer,
    )
    from wheelsight_export.sources import Exported, exported_at
    from wheelsight_export.trace import trace_to

__all__ = [
    "DEFAULT_VOXEL_M",
    "SPAWN",
    "TRAJECTORY_FORMATS",
    "BagParts",
    "BagReport",
    "DriveLog",
    "Exported",
    "Mesh",
    "RerunLog",
    "export_bag",
    "export_colmap",
    "export_nerfstudio",
    "export_octomap",
    "export_trajectory",
    "exported_at",
    "is_file",
    "mesh_of",
    "open_drive_log",
    "open_rerun",
    "start_viewer",
    "trace_to",
    "write_mesh_ply",
    "write_ply",
]


def __getattr__(name: str) -> Any:
    return public_name(__name__, name, __all__, ("bag", "meshes", "reconstruction", "rerun_logs", "sources", "trace"))
