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
    """

    def __init__(self, seconds: float, settings: DelaySettings) -> None:
        self._settings = settings
        self._expected_s = self._estimate_s = seconds
        self._variance = settings.sigma_s**2

    @property
    def seconds(self) -> float:
        """As it is known by now; as the calibration says until frames clearly tell otherwise."""
        is_clear = abs(self._estimate_s - self._expected_s) > self._settings.clear_sigmas * self._variance**0.5
        return self._estimate_s if is_clear else self._expected_s

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
        # Frames are brought to colour's time by the delay in use, so what they show is what is missing to that.
        measured = self.seconds - float(turning_rad_s @ ahead_rad) / squared - self._estimate_s
        variance = limits.turn_sigma_rad**2 / squared
        gain = self._variance / (self._variance + variance)
        self._estimate_s = float(np.clip(self._estimate_s + gain * measured, -limits.most_s, limits.most_s))
        self._variance *= 1 - gain
