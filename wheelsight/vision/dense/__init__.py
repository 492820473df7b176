"""Dense odometry: every pixel of depth and grey, aligned with an earlier frame or with what a map predicts."""

from wheelsight.vision.dense.alignment import DEPTH_JUMP, GridFrame, halved_depth
from wheelsight.vision.dense.odometry import DenseOdometry
from wheelsight.vision.dense.settings import DenseSettings
from wheelsight.vision.dense.tracking import DenseEstimate

__all__ = ["DEPTH_JUMP", "DenseEstimate", "DenseOdometry", "DenseSettings", "GridFrame", "halved_depth"]
