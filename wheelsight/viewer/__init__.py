"""A run in Rerun's viewer: written as it goes to a file, or to a viewer on this machine (extra `rerun`)."""

from wheelsight.viewer.rerun_log import RerunLog
from wheelsight.viewer.targets import SPAWN, is_file, open_rerun, start_viewer, why_no_rerun

__all__ = ["SPAWN", "RerunLog", "is_file", "open_rerun", "start_viewer", "why_no_rerun"]
