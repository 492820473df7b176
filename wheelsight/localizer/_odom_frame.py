"""OdomFrame: where `odom` lies in the frame in which a filter has its poses.

A filter's pose leaps where it thinks better of the past: wheels had slipped, the gyroscope's bias was another. The
robot has not leapt. In `odom` it moves by what is known of the motion alone, and the rest is where `odom` lies (REP
105).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from wheelsight.estimates import Estimate, WheelEstimate
from wheelsight.events import Event, RgbdFrame, SkippedFrame, WheelReading
from wheelsight.fusion import STEP_BEGIN, ErrorStateFilter, FusedEstimate
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions

AnyEstimate = TypeVar("AnyEstimate", bound=Estimate)
_IDENTITY = np.eye(4)
_READINGS = 256  # whose stamps are kept: a frame that comes later than so many is a rare thing


class OdomFrame:
    """See the module. It lies in the plane of the filter's frame: height and tilt are known of each pose.

    Attributes:
        T_odom_filter: (4, 4) where the filter's frame lies in it.
    """

    def __init__(self) -> None:
        self._T_filter_odom: FloatArray = _IDENTITY
        self.T_odom_filter: FloatArray = _IDENTITY

    def T_odom_body(self, T_filter_body: FloatArray) -> FloatArray:
        """(4, 4) of a pose of the filter."""
        return np.asarray(motions.times(self.T_odom_filter, T_filter_body))

    def rethink(self, T_before: FloatArray, T_now: FloatArray) -> None:
        """The filter has one and the same pose elsewhere (4, 4) than before; in odom it stays."""
        if (T_before != T_now).any():
            self.lay(T_now, self.T_odom_body(T_before))

    def lay(self, T_filter_body: FloatArray, T_odom_body: FloatArray) -> None:
        """Lie so that a pose of the filter (4, 4) is there in odom (4, 4), as far as both are in the plane."""
        self._T_filter_odom = motions.times(_planar(T_filter_body), motions.inverse(_planar(T_odom_body)))
        self.T_odom_filter = motions.inverse(self._T_filter_odom)

    def framed(self, answer: AnyEstimate) -> AnyEstimate:
        """A filter's answer in odom: in the map and in the filter's frame its pose is as it was."""
        if self._T_filter_odom is _IDENTITY:
            return answer
        T, C, Ad = answer.T_odom_body, answer.covariance, motions.adjoint(self.T_odom_filter)
        told: dict[str, Any] = {
            "T_map_odom": motions.times(np.ascontiguousarray(answer.T_map_odom), self._T_filter_odom),
            "T_filter_odom": self._T_filter_odom,
            "T_odom_body": None if T is None else self.T_odom_body(T),
            "covariance": None if C is None else Ad @ C @ Ad.T,
        }
        if isinstance(answer, WheelEstimate) and answer.before is not None:
            stamp_s, T_before, C_before = answer.before
            told["before"] = (stamp_s, self.T_odom_body(T_before), Ad @ C_before @ Ad.T)
        return replace(answer, **told)


class FusedOdom:
    """`odom` beside the default filter: it moves by the motion since a pose that the filter remembers.

    That is the motion by all that is known by now, of which what moves the remembered pose, too, is no part. The pose
    is that of the last reading before the last frame: up to there the wheels have told all of the way.

    Args:
        keep_s: after so long without a frame a pose is remembered all the same.

    Attributes:
        answered: by which the last pose was answered.
    """

    def __init__(self, keep_s: float) -> None:
        self._frame, self._keep_s = OdomFrame(), keep_s
        self.answered = self._frame
        self._begin: tuple[float, FloatArray, ErrorStateFilter] | None = None  # of the step; as the filter had it last
        self._last: tuple[float, FloatArray] | None = None  # that was answered, in odom
        self._readings_s: deque[float] = deque(maxlen=_READINGS)

    def framed(self, answer: AnyEstimate, fusion: ErrorStateFilter, event: Event | None = None) -> AnyEstimate:
        """The answer of this filter in odom, to an event with a stamp that means something."""
        own = fusion.estimate
        if own.T_odom_body is None or answer.T_odom_body is None:
            return self.answered.framed(answer)
        self._follow(own, own.T_odom_body, fusion)
        T_odom_body = self._frame.T_odom_body(own.T_odom_body)
        self._last = own.stamp_s, T_odom_body
        self._remember(own.stamp_s, fusion, event)
        # While sensors are being checked the answer is not always the filter's own.
        self.answered = self._frame
        if not np.array_equal(answer.T_odom_body, own.T_odom_body):
            self.answered = OdomFrame()
            self.answered.lay(answer.T_odom_body, T_odom_body)
        return self.answered.framed(answer)

    def _follow(self, own: FusedEstimate, T_filter_body: FloatArray, fusion: ErrorStateFilter) -> None:
        """Lie where the remembered pose stays in odom; of another filter, which knows none, where the twist goes on."""
        known = fusion.remembered(STEP_BEGIN)
        if self._begin is not None and known is not None and self._begin[2] is fusion:
            self._frame.rethink(self._begin[1], known)
            self._begin = self._begin[0], known, fusion
        elif self._last is not None and own.twist is not None:
            vx, vy, turn = own.twist * max(own.stamp_s - self._last[0], 0.0)
            T_before_now = motions.exp(np.array([vx, vy, 0.0, 0.0, 0.0, turn]))
            self._frame.lay(T_filter_body, motions.times(self._last[1], T_before_now))

    def _remember(self, stamp_s: float, fusion: ErrorStateFilter, event: Event | None) -> None:
        """Begin a step anew at the last reading up to a frame; or here, where no frame comes."""
        begin_s = -math.inf if self._begin is None or self._begin[2] is not fusion else self._begin[0]
        due_s = stamp_s if stamp_s - begin_s > self._keep_s else -math.inf
        if isinstance(event, WheelReading):
            self._readings_s.append(stamp_s)
        if isinstance(event, RgbdFrame | SkippedFrame):
            told_s = (read_s for read_s in self._readings_s if event.stamp_s - self._keep_s < read_s <= event.stamp_s)
            due_s = max(told_s, default=min(event.stamp_s, stamp_s))
        if due_s > begin_s:
            fusion.clone(due_s, STEP_BEGIN)
            known = fusion.remembered(STEP_BEGIN)
            self._begin = None if known is None else (due_s, known, fusion)


def _planar(T: FloatArray) -> FloatArray:
    """What of a motion (4, 4) is in the plane: x, y and yaw."""
    planar, yaw_rad = np.eye(4), math.atan2(T[1, 0], T[0, 0])
    planar[0, 0] = planar[1, 1] = math.cos(yaw_rad)
    planar[1, 0] = math.sin(yaw_rad)
    planar[0, 1] = -planar[1, 0]
    planar[:2, 3] = T[:2, 3]
    return planar
