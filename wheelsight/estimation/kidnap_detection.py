"""Where nobody knows the place: Carried, while the wheels stood, and UnsureStart, where wheels did not know it well."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from wheelsight.core.estimates import FusedEstimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.settings.fusion import JoiningSettings

# People turn a robot any way, as a standard deviation.
_TURNED_RAD = np.pi / np.sqrt(3)
# Of a heading that may be any, a way of r ends within 2 r of where it seems to: three standard deviations.
_ASTRAY = 2 / 3


class Carried:
    """Another view than before, though the wheels stood all the while, contradicts them: something carried the robot.

    Somebody did while the camera was dark; or an elevator, whose cabin looks the same as long as its doors are closed.
    Whoever steps before a robot that stands hides what was known, too: where the wheels stand on, that may end, and
    the camera waits for it.

    Attributes:
        is_so: whether what the last frames showed says so, or nobody knows yet where the robot was put.
    """

    def __init__(self, settings: JoiningSettings) -> None:
        self._settings = settings
        self._away_s = self._up_m = 0.0
        self._known_s = -np.inf  # of the last frame that showed what was known, believed or not
        self._stands: tuple[float, FloatArray] | None = None  # since when the wheels stand, and where
        self._stood_s = 0.0  # for how long they had stood at the last known view
        self._from: FloatArray | None = None  # x, y where the wheels had it
        self._was_dark = self._is_scattered = self._is_apart = False

    @property
    def is_so(self) -> bool:
        """See the class."""
        return self._from is not None

    @property
    def is_suspected(self) -> bool:
        """Whether the view became another, and the camera has not begun again yet."""
        return self.is_so and not self._is_scattered

    @property
    def is_by_dark(self) -> bool:
        """Whether it did so in the dark.

        A view that is taken for a known one then, and contradicts the wheels, speaks for it: rooms look alike. Beside a
        robot that stood in the light it is as likely somebody who walks past.
        """
        return self.is_suspected and self._was_dark

    def roll(self, stamp_s: float, T_odom_base: FloatArray) -> None:
        """Take where the wheels alone have the base (4, 4) at a reading."""
        if self._stands is not None and stamp_s >= self._stands[0]:
            T_stand_base = motions.times(motions.inverse(self._stands[1]), T_odom_base)
            if motions.view_shift_m(T_stand_base) <= self._settings.stands_m:
                return
        self._stands = stamp_s, T_odom_base

    def begin(self) -> None:
        """The camera begins again: no cabin of an elevator that it has known for long."""
        self._stands, self._stood_s = None, 0.0

    def unknown(self, stamp_s: float, T_last_now: FloatArray | None, T_odom_base: FloatArray) -> None:
        """Take the first frame that shows nothing known.

        Args:
            stamp_s: of the frame.
            T_last_now: (4, 4) how the camera moved by the wheels since the last frame that showed what was known; None
                where that is forgotten.
            T_odom_base: (4, 4) where the wheels have the base.
        """
        of, stood_s = self._settings, self._stood_s if self._stood_s > self._settings.stands_s else 0.0
        dark_s = stamp_s - self._known_s
        was_dark = dark_s > of.dark_s
        if self.is_so or not (was_dark or stood_s):
            return
        if not _is_within(of.recognised_m if was_dark else of.same_view_m, T_last_now):
            return
        self._away_s, self._up_m = dark_s + stood_s, of.floor_m if stood_s else 0.0
        self._was_dark = was_dark
        self._from = T_odom_base[:2, 3].copy()

    def known(self, stamp_s: float) -> None:
        """The frame shows what was known before: nobody has carried anything."""
        self._known_s = stamp_s
        self._stood_s = 0.0 if self._stands is None else stamp_s - self._stands[0]
        if not self._is_scattered:
            self._from = None

    def found(self) -> None:
        """Loops have joined the piece of map that began where the robot was put, so it is known where that is."""
        if self._is_apart:
            self._from, self._is_scattered, self._is_apart = None, False, False

    def begin_piece(self) -> None:
        """Where the robot was put another piece of map begins, which loops are to join."""
        self._is_apart = True

    def waits(self, T_last_now: FloatArray | None) -> bool:
        """Whether what hides the known view may go away: the wheels (4, 4) have not moved the camera from it yet."""
        return self.is_suspected and _is_within(self._settings.same_view_m, T_last_now)

    def scatter(self, T_odom_base: FloatArray, covariance: FloatArray) -> FloatArray:
        """The covariance (6, 6) of a pose from which the camera starts again, by all that may have happened."""
        self._is_scattered = True
        return covariance + self._spread(T_odom_base)

    def answered(self, answer: FusedEstimate) -> FusedEstimate:
        """The answer, doubtful until areas have told where the robot was put."""
        T, C = answer.T_odom_body, answer.covariance
        if self._from is None or T is None or C is None:
            return answer
        if self.is_suspected:
            C = C + self._spread(T)
        elif C[5, 5] < self._settings.known_turn_rad**2:
            self._from, self._is_scattered, self._is_apart = None, False, False
            return answer
        astray_m = _ASTRAY * float(np.linalg.norm(T[:2, 3] - self._from))
        C = C + np.diag(np.square([astray_m, astray_m, 0, 0, 0, 0]))
        reason = answer.reason or Reason.CONTRADICTION
        return replace(answer, status=Status.COASTING, covariance=C, doubtful=True, reason=reason)

    def _spread(self, T_odom_base: FloatArray) -> FloatArray:
        """Of a base (6, 6) that was carried on and put down turned any way, perhaps on another floor."""
        carried_m = self._settings.carried_m_s * self._away_s
        Ad = motions.adjoint(T_odom_base)
        return np.asarray(Ad @ np.diag(np.square([carried_m, carried_m, self._up_m, 0, 0, _TURNED_RAD])) @ Ad.T)


class UnsureStart:
    """A camera that begins again where wheels have it knows that place no better than they, however well it tracks.

    After a silence of all sensors, or a long way in the dark, that may be half a metre; and so it may where the camera
    is followed after it was taken for failing. Its measurements are of motions, so that tells nobody where the robot
    is; places, known views and loops do.

    Attributes:
        since: the number of the first keyframe that the camera made since; None where the place is known.
    """

    def __init__(self, settings: JoiningSettings) -> None:
        self._settings = settings
        self._known: FusedEstimate | None = None
        self.since: int | None = None
        self._enough_m2 = 0.0  # below so much variance the place is known again

    def known(self, answer: FusedEstimate, keyframe: int = 0) -> None:
        """Take the answer to a frame that was believed; if wheels slip, it may be by a camera that failed for long.

        `keyframe` is the number of the next one.
        """
        if self._known is not None and answer.slip:
            self.begin(math.sqrt(max(_variance_m2(answer) - _variance_m2(self._known), 0.0)), keyframe)
        self._known = answer

    def begin(self, spread_m: float | None, keyframe: int) -> None:
        """The camera goes on with a keyframe, `spread_m` (σ, in the plane) from the last frame that was believed."""
        if spread_m is None or spread_m <= self._settings.unsure_m or self.since is not None:
            return
        before_m2 = 0.0 if self._known is None else _variance_m2(self._known)
        self._enough_m2, self.since = before_m2 + self._settings.unsure_m**2, keyframe

    def found(self) -> None:
        """Loops tie what the camera has seen since to what it saw before."""
        self.since = None

    def answered(self, answer: FusedEstimate) -> FusedEstimate:
        """The answer, doubtful until it is known again where the robot is."""
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
