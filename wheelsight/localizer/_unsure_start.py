"""UnsureStart: whether the camera began again at a place that wheels did not know well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.estimates import Reason, Status
from wheelsight.fusion import FusedEstimate, JoiningSettings
from wheelsight.geometry import se3


class UnsureStart:
    """A camera that begins again where wheels have it knows that place no better than they, however well it tracks.

    After a silence of all sensors, or a long way in the dark, that may be half a metre. Its measurements are of
    motions, so that tells nobody where the robot is; places and known views do.
    """

    def __init__(self, settings: JoiningSettings) -> None:
        self._settings = settings
        self._known: FusedEstimate | None = None
        self._enough_m2: float | None = None  # below so much variance the place is known again

    def known(self, answer: FusedEstimate) -> None:
        """Take the answer to a frame that was believed."""
        self._known = answer

    def begin(self, spread_m: float | None) -> None:
        """The camera begins again, `spread_m` (σ, in the plane) from the last frame that was believed."""
        if spread_m is None or spread_m <= self._settings.unsure_m or self._enough_m2 is not None:
            return
        before_m2 = 0.0 if self._known is None else _variance_m2(self._known)
        self._enough_m2 = before_m2 + self._settings.unsure_m**2

    def answered(self, answer: FusedEstimate) -> FusedEstimate:
        """The answer, doubtful until it is known again where the robot is."""
        if self._enough_m2 is None or answer.T_odom_body is None:
            return answer
        if _variance_m2(answer) < self._enough_m2:
            self._enough_m2 = None
            return answer
        reason = answer.reason or Reason.NOT_RECOGNISED
        return replace(answer, status=Status.COASTING, doubtful=True, reason=reason)


def _variance_m2(answer: FusedEstimate) -> float:
    assert answer.T_odom_body is not None
    assert answer.covariance is not None
    return float(np.trace(se3.position_covariance(answer.T_odom_body, answer.covariance)[:2, :2]))
