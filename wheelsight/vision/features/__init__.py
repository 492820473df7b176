"""Feature odometry: ORB keypoints, Hamming matches, 3D–3D alignment, and a tracking state (Zhang)."""

from wheelsight.vision.features.odometry import FeatureOdometry
from wheelsight.vision.features.tracking import FeatureEstimate, FeatureSettings, MatchedPixels

__all__ = ["FeatureEstimate", "FeatureOdometry", "FeatureSettings", "MatchedPixels"]
