"""Kidnap detection, and the uncertainty of a camera that restarts where the pose is poorly known.

Both inflate the covariance of an estimate, or mark it as doubtful, until the place is known again.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from wheelsight.core.estimates import FusedEstimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.settings.fusion import JoiningSettings

# Standard deviation of a heading that may have any value (uniform over a circle), radians.
_TURNED_RAD = np.pi / np.sqrt(3)
# With an unknown heading, a way of r ends within 2 r of its estimated end: three standard deviations.
_ASTRAY = 2 / 3


class KidnapDetection:
    """Detects that the robot was moved: the view changed although the wheels stood.

    It may have been carried while the camera was dark, or by an elevator, whose cabin looks the same while its doors
    are closed. A person who steps in front of a standing robot also changes the view. While the wheels stand, the
    camera therefore waits for the known view to return.

    Attributes:
        is_kidnapped: whether the last frames show a kidnapping, or the pose after one is still unknown.
    """

    def __init__(self, settings: JoiningSettings) -> None:
        self._settings = settings
        self._away_s = self._up_m = 0.0
        self._known_s = -np.inf  # stamp of the last frame that showed a known view, accepted by the filter or not
        self._stands: tuple[float, FloatArray] | None = None  # since when the wheels stand, and where
        self._stood_s = 0.0  # how long they had stood at the last known view
        self._from: FloatArray | None = None  # x, y of the wheels at the kidnapping
        self._was_dark = self._is_inflated = self._is_apart = False

    @property
    def is_kidnapped(self) -> bool:
        """See the class."""
        return self._from is not None

    @property
    def is_suspected(self) -> bool:
        """Whether the view changed and the camera has not restarted yet."""
        return self.is_kidnapped and not self._is_inflated

    @property
    def is_in_dark(self) -> bool:
        """Whether the view changed in the dark.

        Rooms look alike: after the dark, a view that matches a known one but contradicts the wheels confirms a
        kidnapping. In the light it may as well be a person who walks past.
        """
        return self.is_suspected and self._was_dark

    def add_wheels(self, stamp_s: float, T_odom_base: FloatArray) -> None:
        """Add the pose (4, 4) of the base by the wheels alone."""
        if self._stands is not None and stamp_s >= self._stands[0]:
            T_stand_base = motions.times(motions.inverse(self._stands[1]), T_odom_base)
            if motions.view_shift_m(T_stand_base) <= self._settings.stands_m:
                return
        self._stands = stamp_s, T_odom_base

    def add_known_view(self, stamp_s: float) -> None:
        """Add a frame that shows a known view: the robot was not moved."""
        self._known_s = stamp_s
        self._stood_s = 0.0 if self._stands is None else stamp_s - self._stands[0]
        if not self._is_inflated:
            self._from = None

    def add_unknown_view(self, stamp_s: float, T_last_now: FloatArray | None, T_odom_base: FloatArray) -> None:
        """Add the first frame that shows nothing known.

        Args:
            stamp_s: of the frame.
            T_last_now: (4, 4) motion of the camera, by the wheels, since the last frame with a known view; None if the
                filter no longer remembers that.
            T_odom_base: (4, 4) pose of the base by the wheels.
        """
        of, stood_s = self._settings, self._stood_s if self._stood_s > self._settings.stands_s else 0.0
        dark_s = stamp_s - self._known_s
        was_dark = dark_s > of.dark_s
        if self.is_kidnapped or not (was_dark or stood_s):
            return
        if not _is_within(of.recognised_m if was_dark else of.same_view_m, T_last_now):
            return
        self._away_s, self._up_m = dark_s + stood_s, of.floor_m if stood_s else 0.0
        self._was_dark = was_dark
        self._from = T_odom_base[:2, 3].copy()

    def waits(self, T_last_now: FloatArray | None) -> bool:
        """Whether the known view may return: by the wheels (4, 4), the camera has not moved away from it."""
        return self.is_suspected and _is_within(self._settings.same_view_m, T_last_now)

    def inflate(self, T_odom_base: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return the covariance (6, 6) at a restart of the camera, for any motion that is possible meanwhile."""
        self._is_inflated = True
        return covariance + self._spread(T_odom_base)

    def restart(self) -> None:
        """Forget how long the wheels stood: the camera restarts, so its view is not that of an elevator's cabin."""
        self._stands, self._stood_s = None, 0.0

    def begin_piece(self) -> None:
        """Note that a separate piece of map begins, which loops are to join."""
        self._is_apart = True

    def relocalized(self) -> None:
        """Note that loops have joined the piece of map that began after the kidnapping, so the pose is known."""
        if self._is_apart:
            self._from, self._is_inflated, self._is_apart = None, False, False

    def apply(self, answer: FusedEstimate) -> FusedEstimate:
        """Return the estimate, doubtful and with a larger covariance until the heading is known again."""
        T, C = answer.T_odom_body, answer.covariance
        if self._from is None or T is None or C is None:
            return answer
        if self.is_suspected:
            C = C + self._spread(T)
        elif C[5, 5] < self._settings.known_turn_rad**2:
            self._from, self._is_inflated, self._is_apart = None, False, False
            return answer
        astray_m = _ASTRAY * float(np.linalg.norm(T[:2, 3] - self._from))
        C = C + np.diag(np.square([astray_m, astray_m, 0, 0, 0, 0]))
        reason = answer.reason or Reason.CONTRADICTION
        return replace(answer, status=Status.COASTING, covariance=C, doubtful=True, reason=reason)

    def _spread(self, T_odom_base: FloatArray) -> FloatArray:
        """Return the covariance (6, 6) of a base that was carried and turned by any angle, perhaps to another floor."""
        carried_m = self._settings.carried_m_s * self._away_s
        Ad = motions.adjoint(T_odom_base)
        return np.asarray(Ad @ np.diag(np.square([carried_m, carried_m, self._up_m, 0, 0, _TURNED_RAD])) @ Ad.T)


class UncertainRestart:
    """Marks estimates as doubtful after the camera restarts at a pose that the wheels know poorly.

    After a gap of all sensors, or a long way in the dark, the error may be half a metre, however well the camera tracks
    from there. The same holds when the filter accepts a camera again that it took for failing. Camera measurements are
    relative motions, so they do not reduce this error. Places, known views and loops do.

    Attributes:
        since: number of the first keyframe after the restart; None if the pose is known.
    """

    def __init__(self, settings: JoiningSettings) -> None:
        self._settings = settings
        self._known: FusedEstimate | None = None
        self.since: int | None = None
        self._enough_m2 = 0.0  # variance below which the pose counts as known again

    def add_believed(self, answer: FusedEstimate, keyframe: int = 0) -> None:
        """Add the estimate at a frame that the filter accepted. With slip, that camera may have failed for long.

        `keyframe` is the number of the next one.
        """
        if self._known is not None and answer.slip:
            self.begin(math.sqrt(max(_variance_m2(answer) - _variance_m2(self._known), 0.0)), keyframe)
        self._known = answer

    def begin(self, spread_m: float | None, keyframe: int) -> None:
        """Note a restart at a keyframe, `spread_m` (σ, in the plane) after the last accepted frame."""
        if spread_m is None or spread_m <= self._settings.unsure_m or self.since is not None:
            return
        before_m2 = 0.0 if self._known is None else _variance_m2(self._known)
        self._enough_m2, self.since = before_m2 + self._settings.unsure_m**2, keyframe

    def relocalized(self) -> None:
        """Note that loops connect keyframes since the restart to older ones."""
        self.since = None

    def apply(self, answer: FusedEstimate) -> FusedEstimate:
        """Return the estimate, doubtful until its position is known again."""
        if self.since is None or answer.T_odom_body is None:
            return answer
        if _variance_m2(answer) < self._enough_m2:
            self.since = None
            return answer
        reason = answer.reason or Reason.NOT_RECOGNISED
        return replace(answer, status=Status.COASTING, doubtful=True, reason=reason)


def _is_within(way_m: float, T_last_now: FloatArray | None) -> bool:
    return T_last_now is not None and motions.view_shift_m(T_last_now) <= way_m


def _variance_m2(answer: FusedEstimate) -> float:
    assert answer.T_odom_body is not None
    assert answer.covariance is not None
    return float(np.trace(se3.position_covariance(answer.T_odom_body, answer.covariance)[:2, :2]))
