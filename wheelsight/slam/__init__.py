"""Where keyframes are by all that is known of them: the pose graph, and which loops it takes in."""

from wheelsight.slam.correction import Correction, Unused, correct
from wheelsight.slam.graph import PoseGraph, Prior, RelativePose
from wheelsight.slam.loops import JudgedLoop, LoopCloser, LoopReport
from wheelsight.slam.own_solver import OwnPoseGraph
from wheelsight.slam.pose_graph import GtsamPoseGraph, new_pose_graph
from wheelsight.slam.settings import LoopSettings, MatchSettings

__all__ = [
    "Correction",
    "GtsamPoseGraph",
    "JudgedLoop",
    "LoopCloser",
    "LoopReport",
    "LoopSettings",
    "MatchSettings",
    "OwnPoseGraph",
    "PoseGraph",
    "Prior",
    "RelativePose",
    "Unused",
    "correct",
    "new_pose_graph",
]
