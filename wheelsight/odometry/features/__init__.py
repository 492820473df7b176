"""Feature odometry: ORB keypoints, Hamming matches, 3D–3D alignment, and a state that knows when it is lost (Zhang)."""

from wheelsight.odometry.features.estimate import FeatureEstimate, MatchedPixels
from wheelsight.odometry.features.odometry import FeatureOdometry
from wheelsight.odometry.features.settings import FeatureSettings

__all__ = ["FeatureEstimate", "FeatureOdometry", "FeatureSettings", "MatchedPixels"]
