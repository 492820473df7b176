"""Estimates: where the robot is by one odometry, and by all sensors joined, with status and covariance."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore

# What odometry and localization answer: a motion or a pose with its covariance, or why there is none.


# Of (v, ω) in `MotionEstimate.degenerate`: turns count as the way of a point 2 m off, to be compared with ways.
DEGENERATE_SCALE = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
_IDENTITY = np.eye(4)
_IDENTITY.setflags(write=False)


class Reason(StrEnum):
    """Why a frame or a wheel reading gave no motion, or no pose."""

    FRAME_UNUSABLE = "frame unusable"
    REPEATED = "the same image as before"
    TOO_FEW_KEYPOINTS = "too few keypoints with depth"
    TOO_FEW_MATCHES = "too few matches"
    TOO_FEW_INLIERS = "too few inliers"
    DEGENERATE = "matches do not determine the motion"
    TOO_LITTLE_DEPTH = "too little depth"
    TOO_LITTLE_OVERLAP = "too little overlap with what is known"
    POOR_FIT = "surfaces do not fit what is known"
    NOT_RECOGNISED = "no view seen before is recognised"
    SURFACES_CONTRADICTED = "keypoints contradict what surfaces say"
    IMPLAUSIBLE_MOTION = "implausible motion"
    CLOCK_BACKWARDS = "clock ran backwards"
    GAP = "gap between readings"
    COUNTER_AMBIGUOUS = "counters may have rolled over unseen"
    INVALID = "numbers that are no measurement"
    TOO_LATE = "older than the window of fusion"
    CLOCKS_APART = "clocks of the sensors are apart"
    UNKNOWN_REFERENCE = "reference is not remembered"
    CONTRADICTION = "camera and wheels contradict each other"
    OUTLIER = "too far from what is expected"


class Status(StrEnum):
    """What the estimate at a frame can be used for.

    initializing: no pose yet; in a map of before there may be one in odom, while none is known in the map.
    tracking: pose known.
    coasting: pose by wheels alone, or by a camera that was lost and sees again, while it is not known yet where in the
    map that is; ever less certain.
    failing: this frame gave no pose, the next may.
    lost: so many frames failed in a row, or all sensors were silent so long, that only recognising a known place helps.
    """

    INITIALIZING = "initializing"
    TRACKING = "tracking"
    COASTING = "coasting"
    FAILING = "failing"
    LOST = "lost"


@dataclass(frozen=True, slots=True, eq=False)
class MotionEstimate:
    """The camera's motion against a reference frame, or the reason why there is none.

    Attributes:
        T_reference_current: (4, 4), or None on failure.
        covariance: (6, 6) of the left perturbation (v, ω) of `T_reference_current`, or None on failure.
        reason: None on success.
        matches: how many point pairs were proposed.
        inliers: how many of them agree with the motion.
        degenerate: (K, 6) unit vectors of (v, ω · 2 m) that the images do not show; there the prior stands. Or None.
        fitting: share of the regions of the view that lie at this motion where they are known, each with one vote,
            however much of it matches; None where that is not told.
    """

    T_reference_current: FloatArray | None
    covariance: FloatArray | None
    reason: Reason | None = None
    matches: int = 0
    inliers: int = 0
    degenerate: FloatArray | None = None
    fitting: float | None = None

    @classmethod
    def failed(cls, reason: Reason, matches: int = 0, inliers: int = 0) -> MotionEstimate:
        """An estimate that says only why there is none."""
        return cls(None, None, reason, matches, inliers)

    @property
    def shows_all(self) -> bool:
        """Whether no direction of motion is left to the prior."""
        return self.degenerate is None or not len(self.degenerate)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Where the body is at one stamp, and how far to trust it.

    Attributes:
        stamp_s: time of the event answered, seconds.
        status: what the pose can be used for.
        T_odom_body: (4, 4) in the frame that never jumps, or None while it is not known. `body` is "camera" or "base".
            Where a wheel reading was refused it is the pose before, and the covariance has grown by what may have
            happened since. A localizer's moves only as the body does; a filter's own leaps where it thinks better of
            the past.
        covariance: (6, 6) of the left perturbation (v, ω) of `T_odom_body`, or None.
        reason: why the event gave no pose of its own, or None.
        matches: of this frame's alignment.
        inliers: likewise.
        T_map_odom: (4, 4) where the frame odom lies in the map (ROS REP 105); it moves where the map or the filter
            knows better.
        covariance_map: (6, 6) of the left perturbation (v, ω) of `T_map_body`, where loops tell how surely it is known.
        T_filter_odom: (4, 4) where odom lies in the frame in which the filter has its poses: in the plane, for height
            and tilt are the same in both. The identity where nothing leaps.
        keyframe: by which this pose is remembered, or None; see `wheelsight.core.keyframes`.
        T_keyframe_body: (4, 4) where the body is relative to that keyframe, or None. When keyframes move,
            `T_map_keyframe @ T_keyframe_body` is where the body has been.
    """

    stamp_s: float
    status: Status
    T_odom_body: FloatArray | None = None
    covariance: FloatArray | None = None
    reason: Reason | None = None
    body: str = "camera"
    matches: int = 0
    inliers: int = 0
    T_map_odom: FloatArray = field(default_factory=lambda: _IDENTITY, kw_only=True)
    covariance_map: FloatArray | None = field(default=None, kw_only=True)
    T_filter_odom: FloatArray = field(default_factory=lambda: _IDENTITY, kw_only=True)
    keyframe: KeyframeId | None = field(default=None, kw_only=True)
    T_keyframe_body: FloatArray | None = field(default=None, kw_only=True)

    @property
    def T_map_body(self) -> FloatArray | None:
        """(4, 4) in the map, or None while it is not known: what was seen lies there, and poses may jump."""
        if self.T_odom_body is None or self.status is Status.INITIALIZING:
            return None
        return self.T_map_odom @ self.T_odom_body

    @property
    def T_filter_body(self) -> FloatArray | None:
        """(4, 4) by all that was known at the stamp but loops, or None: a run's trajectory holds it, and it leaps."""
        if self.T_odom_body is None or self.T_filter_odom is _IDENTITY:
            return self.T_odom_body
        return self.T_filter_odom @ self.T_odom_body

    @property
    def filter_covariance(self) -> FloatArray | None:
        """(6, 6) of the left perturbation (v, ω) of `T_filter_body`, or None."""
        if self.covariance is None or self.T_filter_odom is _IDENTITY:
            return self.covariance
        Ad = se3.adjoint(self.T_filter_odom)
        return np.asarray(Ad @ self.covariance @ Ad.T)

    def remembered_in(self, store: KeyframeStore) -> FloatArray | None:
        """T_map_body (4, 4) by where its keyframe is by now; None where no keyframe remembers it.

        Where keyframes have moved since, as by a loop closure, this is where the body has been.
        """
        if self.keyframe is None or self.T_keyframe_body is None:
            return None
        return store.pose(self.keyframe) @ self.T_keyframe_body


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A motion of the body from one instant to a later one.

    Attributes:
        begin_s, end_s: the instants, seconds.
        T_before_now: (4, 4) the body at the end, in its own frame at the begin.
        covariance: (6, 6) of the left perturbation (v, ω) of `T_before_now`.
    """

    begin_s: float
    end_s: float
    T_before_now: FloatArray
    covariance: FloatArray

    def then(self, later: Step) -> Step:
        """Both, one after the other; errors are taken for independent."""
        Ad = se3.adjoint(self.T_before_now)
        C = self.covariance + Ad @ later.covariance @ Ad.T
        return Step(self.begin_s, later.end_s, self.T_before_now @ later.T_before_now, C)


@dataclass(frozen=True, eq=False)
class WheelEstimate(Estimate):
    """What wheel odometry answers at a reading: the pose, and the step that led there.

    Attributes:
        before: stamp, T_odom_body (4, 4) and covariance (6, 6) at the reading before; None where the first one, or one
            whose stamp runs backwards, tells no step.
    """

    before: tuple[float, FloatArray, FloatArray] | None = field(default=None, kw_only=True)

    @cached_property
    def step(self) -> Step | None:
        """From the reading before; of one that was refused no way, but as uncertain as all that may have been.

        None where there was no reading before, or numbers are not finite.
        """
        from wheelsight.core.geometry import motion_kernels as motions

        if self.before is None or self.T_odom_body is None or self.covariance is None:
            return None
        begin_s, T_before, C_before = self.before
        if not all(np.isfinite(told).all() for told in (T_before, C_before, self.T_odom_body, self.covariance)):
            return None
        T_before_now, _ = motions.between(T_before, C_before, self.T_odom_body, self.covariance)
        _, covariance = motions.step_between(T_before, C_before, self.T_odom_body, self.covariance)
        return Step(begin_s, self.stamp_s, T_before_now, covariance)


_NO_MOTION = MotionEstimate.failed(Reason.FRAME_UNUSABLE)


@dataclass(frozen=True, slots=True, eq=False)
class CameraEstimate(Estimate):
    """What an odometry by a camera answers at a frame: its pose, and the motion that it was found by.

    The camera has no other frame than the map, so `T_odom_body` is T_map_camera, and `T_map_odom` the identity.

    Attributes:
        motion: of this frame against its reference, or why there is none.
        shows_all: whether the last frames showed every direction of motion; else part of the pose is what was expected.
    """

    motion: MotionEstimate = field(default=_NO_MOTION, kw_only=True)
    shows_all: bool = field(default=True, kw_only=True)


# FusedEstimate: what the default filter answers.


# Name of the remembered pose since which motions in `odom` are told. Nothing may be measured against it.
STEP_BEGIN = "step begin"


@dataclass(frozen=True, slots=True, eq=False)
class FusedEstimate(Estimate):
    """The base's pose by all sensors.

    Status: initializing, before any event. tracking: vision was believed within `coast_after_s`. coasting: the wheels
    alone lead, and the covariance grows. lost: nothing was heard for `lost_after_s`, and no measurement against a
    remembered pose has told where the base is since (a position does not tell the heading); there is no pose.

    Attributes:
        slip: the wheels are not believed, because camera or gyroscope contradict them.
        degenerate: the last measurement of the camera did not show all directions.
        doubtful: camera and wheels contradict each other and who is right is not settled; the covariance covers both.
        twist: (3,) vx, vy, ωz of the base in its own frame, m/s and rad/s. Or None.
        twist_covariance: (3, 3), or None.
        nis: normalised innovation squared of the measurement that is answered, and its degrees of freedom; or None.
        wheel_errors: (3,) what is thought to be wrong with the wheels: the ratio by which ways are too short, the turn
            a metre that is missing in rad/m, the ratio by which turns are too small. Or None.
    """

    slip: bool = False
    degenerate: bool = False
    doubtful: bool = False
    twist: FloatArray | None = None
    twist_covariance: FloatArray | None = None
    nis: tuple[float, int] | None = None
    wheel_errors: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FrameUpdate:
    """What came of a frame.

    Attributes:
        answer: to it.
        T_odom_base: (4, 4) when its image was taken, by all that is known; None where nothing is remembered.
        is_reference: whether the camera's next motions are told against it.
    """

    answer: FusedEstimate
    T_odom_base: FloatArray | None
    is_reference: bool

    @property
    def is_believed(self) -> bool:
        """Whether wheels and camera agree on it."""
        return self.answer.reason is None and not self.answer.doubtful
