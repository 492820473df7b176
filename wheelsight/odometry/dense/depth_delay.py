"""DepthDelay: how much later than colour a camera measures depth, beyond what stamps say."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.odometry.dense.settings_parts import DelaySettings


class DepthDelay:
    """Learns a constant delay from turns: what depth shows of them is then behind what keypoints show in colour.

    A Kinect's two images are taken by two sensors that nobody synchronises, and depth is computed before it is stamped.
    At 150 degrees a second 20 ms are 3 degrees. A filter with one state; each frame that turns measures it.

    Args:
        seconds: as a calibration knows it.
        settings: how well that is known, and what a frame tells.

    Attributes:
        seconds: as it is known by now.
    """

    def __init__(self, seconds: float, settings: DelaySettings) -> None:
        self.seconds = seconds
        self._settings = settings
        self._variance = settings.sigma_s**2

    def learn(self, ahead_rad: FloatArray, turning_rad_s: FloatArray) -> None:
        """Take one frame as an example.

        Args:
            ahead_rad: (3,) by how much keypoints see the frame turned further than surfaces, in the reference's frame.
            turning_rad_s: (3,) how much faster the camera turned at the frame than at its reference, likewise.
        """
        limits = self._settings
        squared = float(turning_rad_s @ turning_rad_s)
        if squared < limits.least_rad_s**2 or np.linalg.norm(ahead_rad) > limits.most_rad:
            return
        self._variance += limits.walk_s**2
        measured, variance = -float(turning_rad_s @ ahead_rad) / squared, limits.turn_sigma_rad**2 / squared
        gain = self._variance / (self._variance + variance)
        self.seconds = float(np.clip(self.seconds + gain * measured, -limits.most_s, limits.most_s))
        self._variance *= 1 - gain
