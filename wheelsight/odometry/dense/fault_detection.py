"""Fault detection: which poses keypoints must verify, because surfaces alone may be wrong about them."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.odometry.dense.prediction import Prediction
from wheelsight.odometry.dense.settings_parts import FaultSettings
from wheelsight.odometry.dense.tracked import Tracked
from wheelsight.odometry.velocity import LONGEST_STEP_S

# The mean residual of a perfect fit, in standard deviations of the sensor.
_PERFECT = 1.0


class FaultDetector:
    """Suspects poses that nothing but surfaces speak for.

    Args:
        settings: what is suspected.
        max_unseen_s: for how long part of the motion may go unseen.

    Attributes:
        unseen_s: for how long some direction of motion has not been seen.
    """

    def __init__(self, settings: FaultSettings, max_unseen_s: float) -> None:
        self._settings, self._max_unseen_s = settings, max_unseen_s
        self._usual = _PERFECT
        self.unseen_s = 0.0

    @property
    def is_blind(self) -> bool:
        """Whether part of the motion has gone unseen for so long that the pose is a guess."""
        return self.unseen_s > self._max_unseen_s

    def count(self, seconds: float, *, shows_all: bool) -> None:
        """Count a frame that showed all motion or not; noise shows a direction now and then, which counts half."""
        self.unseen_s = max(self.unseen_s - 0.5 * seconds, 0.0) if shows_all else self.unseen_s + seconds

    def learn(self, found: Tracked) -> None:
        """Take a pose that was accepted as an example of how well surfaces fit here."""
        better = min(found.residual, self._settings.poor_fit * self._usual)
        self._usual = max(self._usual + self._settings.fit_learned * (better - self._usual), _PERFECT)

    def fits(self, found: Tracked) -> bool:
        """Whether surfaces fit about as well as usual."""
        return found.residual <= self._settings.poor_fit * self._usual

    def is_bridged(self, found: Tracked, ahead: Prediction, seconds: float) -> bool:
        """Whether a pose after a gap fits, just where another sensor expects it, as near as wheels know after so long.

        Surfaces alone may fit in another place, but hardly there.
        """
        T = se3.invert(ahead.T_map_camera[0]) @ found.T_map_camera
        near_m, near_rad = self._settings.bridged_off_m, self._settings.bridged_off_rad
        is_near = float(np.linalg.norm(T[:3, 3])) < near_m and float(so3.angle(T[:3, :3])) < near_rad
        return LONGEST_STEP_S < seconds <= self._settings.bridged_s and is_near and self.fits(found)

    def suspects(self, found: Tracked, seconds: float, *, is_alone: bool, is_steady: bool) -> bool:
        """Whether keypoints are to verify a pose so long after the one before.

        Args:
            found: the pose.
            seconds: since the one before.
            is_alone: no other sensor tells the motion; else it stands in for what surfaces do not show or fit.
            is_steady: the speed before is known, so that a leap can be told.
        """
        is_unsure = is_alone and (self.is_blind or not self.fits(found))
        return seconds > LONGEST_STEP_S or is_unsure or (is_steady and self._is_leap(found, seconds))

    def is_off_prior(self, found: Tracked) -> bool:
        """Whether a pose is so far off the one expected that the sensor that expects it, or the surfaces, are wrong."""
        limits = np.array([self._settings.off_prior_m_s, self._settings.off_prior_rad_s])
        return bool((_gained(found) > limits).any())

    def _is_leap(self, found: Tracked, seconds: float) -> bool:
        """Whether the camera would have had to gain more speed or turning, against what was expected, than one does."""
        at_once = np.array([self._settings.leap_m_s, self._settings.leap_rad_s])
        a_second = np.array([self._settings.leap_m_s2, self._settings.leap_rad_s2])
        return bool((_gained(found) > at_once + a_second * seconds).any())


def _gained(found: Tracked) -> FloatArray:
    change = found.twist - found.frame.twist
    return np.array([np.linalg.norm(change[:3]), np.linalg.norm(change[3:])])
