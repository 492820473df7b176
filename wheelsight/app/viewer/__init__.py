"""Shows a run or a drive in Rerun's viewer: in a file, or in a viewer on this machine (extra `rerun`)."""

from wheelsight.app.viewer.logs import (
    SPAWN,
    DriveLog,
    RerunLog,
    is_file,
    open_drive_log,
    open_rerun,
    start_viewer,
    why_no_rerun,
)

__all__ = ["SPAWN", "DriveLog", "RerunLog", "is_file", "open_drive_log", "open_rerun", "start_viewer", "why_no_rerun"]
