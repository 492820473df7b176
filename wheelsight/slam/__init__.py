"""Simultaneous localization and mapping: the pose graph, loop closing, and place recognition."""

from wheelsight.slam.graph import PoseGraph, Prior, RelativePose
from wheelsight.slam.loop_closing import Correction, Unused, correct
from wheelsight.slam.loop_gate import LoopCloser, LoopDecision, LoopReport
from wheelsight.slam.settings import LoopSettings
from wheelsight.slam.solvers import GtsamPoseGraph, OwnPoseGraph, new_pose_graph

__all__ = [
    "Correction",
    "GtsamPoseGraph",
    "LoopCloser",
    "LoopDecision",
    "LoopReport",
    "LoopSettings",
    "OwnPoseGraph",
    "PoseGraph",
    "Prior",
    "RelativePose",
    "Unused",
    "correct",
    "new_pose_graph",
]
