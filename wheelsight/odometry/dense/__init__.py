"""Dense odometry: every pixel of depth and grey, aligned with an earlier frame or with what a map predicts."""

from wheelsight.odometry.dense.grid import GridFrame, halved_depth
from wheelsight.odometry.dense.odometry import DenseOdometry
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.odometry.dense.tracked import DenseEstimate

__all__ = ["DenseEstimate", "DenseOdometry", "DenseSettings", "GridFrame", "halved_depth"]
