"""Carried: whether somebody carried the robot while its camera saw nothing, and what is known of its pose then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.estimates import Reason, Status
from wheelsight.fusion import FusedEstimate, JoiningSettings
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions

# People turn a robot any way, as a standard deviation.
_TURNED_RAD = np.pi / np.sqrt(3)
# Of a heading that may be any, a way of r ends within 2 r of where it seems to: three standard deviations.
_ASTRAY = 2 / 3


class Carried:
    """Wheels that stood in the dark, and another view after it, contradict each other: somebody carried the robot.

    Attributes:
        is_so: whether what the last frames showed says so, or nobody knows yet where the robot was put.
    """

    def __init__(self, settings: JoiningSettings) -> None:
        self._settings = settings
        self._dark_s = 0.0
        self._from: FloatArray | None = None  # x, y where the wheels had it
        self._is_scattered = False

    @property
    def is_so(self) -> bool:
        """See the class."""
        return self._from is not None

    def unknown(self, dark_s: float, T_last_now: FloatArray | None, T_odom_base: FloatArray) -> None:
        """Take a frame that shows nothing known, the first one after so long a dark.

        Args:
            dark_s: since the last frame that was believed.
            T_last_now: (4, 4) how the camera moved since then by the wheels, or None where that is forgotten.
            T_odom_base: (4, 4) where the wheels have the base.
        """
        if self.is_so or T_last_now is None or motions.view_shift_m(T_last_now) > self._settings.same_view_m:
            return
        self._dark_s, self._from = dark_s, T_odom_base[:2, 3].copy()

    def known(self) -> None:
        """The frame shows what was known before: nobody has carried anything."""
        if not self._is_scattered:
            self._from = None

    def scatter(self, T_odom_base: FloatArray, covariance: FloatArray) -> FloatArray:
        """The covariance (6, 6) of a pose from which the camera starts again, by all that may have happened."""
        self._is_scattered = True
        return covariance + self._spread(T_odom_base)

    def answered(self, answer: FusedEstimate) -> FusedEstimate:
        """The answer, doubtful until areas have told where the robot was put."""
        T, C = answer.T_odom_body, answer.covariance
        if self._from is None or T is None or C is None:
            return answer
        if not self._is_scattered:
            C = C + self._spread(T)
        elif C[5, 5] < self._settings.known_turn_rad**2:
            self._from, self._is_scattered = None, False
            return answer
        astray_m = _ASTRAY * float(np.linalg.norm(T[:2, 3] - self._from))
        C = C + np.diag(np.square([astray_m, astray_m, 0, 0, 0, 0]))
        reason = answer.reason or Reason.CONTRADICTION
        return replace(answer, status=Status.COASTING, covariance=C, doubtful=True, reason=reason)

    def _spread(self, T_odom_base: FloatArray) -> FloatArray:
        """Of a base (6, 6) that was carried on and put down turned any way, in the plane."""
        carried_m = self._settings.carried_m_s * self._dark_s
        Ad = motions.adjoint(T_odom_base)
        return np.asarray(Ad @ np.diag(np.square([carried_m, carried_m, 0, 0, 0, _TURNED_RAD])) @ Ad.T)
