"""Doubt: which poses need keypoints to say the same, because surfaces alone may be wrong about them."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.odometry._velocity import LONGEST_STEP_S
from wheelsight.odometry.dense._tracked import Expected, Tracked
from wheelsight.odometry.dense.settings import DenseSettings

# A change of velocity at once, and that many times a second, which is a leap rather than the camera's motion.
_LEAP = np.array([0.5, 1.5])
_LEAP_S = np.array([10.0, 30.0])
# Off what another sensor expects by so much speed, m/s and rad/s: more than wheels err that do not slip.
_ASTRAY = np.array([0.2, 0.2])
# So long a gap wheels bridge, and come out no farther off.
_BRIDGED_S, _NEAR_M, _NEAR_RAD = 10.0, 0.05, 0.03
# A pose fits poorly whose planes lie so many times as far off as usual; that is learned by so much a frame, and is no
# less than a perfect fit's.
_POORLY, _LEARNED, _PERFECT = 2.0, 0.1, 1.0


class Doubt:
    """Weighs poses that nothing but surfaces speak for.

    Args:
        settings: for how long part of the motion may go unseen.

    Attributes:
        unseen_s: for how long some direction of motion has not been seen.
    """

    def __init__(self, settings: DenseSettings) -> None:
        self._max_unseen_s = settings.max_unseen_s
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
        """Take a pose that was believed as an example of how well surfaces fit here."""
        better = min(found.residual, _POORLY * self._usual)
        self._usual = max(self._usual + _LEARNED * (better - self._usual), _PERFECT)

    def fits(self, found: Tracked) -> bool:
        """Whether surfaces fit about as well as usual."""
        return found.residual <= _POORLY * self._usual

    def is_bridged(self, found: Tracked, ahead: Expected, seconds: float) -> bool:
        """Whether a pose after a gap fits, just where another sensor expects it, as near as wheels know after so long.

        Surfaces alone may fit in another place, but hardly there.
        """
        T = se3.invert(ahead.T_map_camera[0]) @ found.T_map_camera
        is_near = float(np.linalg.norm(T[:3, 3])) < _NEAR_M and float(so3.angle(T[:3, :3])) < _NEAR_RAD
        return LONGEST_STEP_S < seconds <= _BRIDGED_S and is_near and self.fits(found)

    def falls_on(self, found: Tracked, seconds: float, *, is_alone: bool, is_steady: bool) -> bool:
        """Whether keypoints are to be asked about a pose so long after the one before.

        Args:
            is_alone: no other sensor tells the motion; else it stands in for what surfaces do not show or fit.
            is_steady: the speed before is known, so that a leap can be told.
        """
        is_unsure = is_alone and (self.is_blind or not self.fits(found))
        return seconds > LONGEST_STEP_S or is_unsure or (is_steady and _is_leap(found, seconds))


def is_astray(found: Tracked) -> bool:
    """Whether a pose is so far off the one expected that the sensor that expects it, or the surfaces, must be wrong."""
    return bool((_gained(found) > _ASTRAY).any())


def _is_leap(found: Tracked, seconds: float) -> bool:
    """Whether the camera would have had to gain more speed, or turning, against what was expected, than one does."""
    return bool((_gained(found) > _LEAP + _LEAP_S * seconds).any())


def _gained(found: Tracked) -> FloatArray:
    change = found.twist - found.frame.twist
    return np.array([np.linalg.norm(change[:3]), np.linalg.norm(change[3:])])
