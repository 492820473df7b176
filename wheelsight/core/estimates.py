"""Estimates of motion and pose, by one odometry or by all sensors, with status and covariance.

`decide` derives the status, the flags and the reason of an estimate from `PoseEvidence`, by the table `DECISIONS`.
The evidence may replace the pose and the covariance. A localizer decides what becomes of the decision.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from itertools import repeat
from typing import Any, NamedTuple, TypeVar

import numpy as np

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore

# Scale of (v, ω) in `MotionEstimate.degenerate`: a rotation counts as the displacement of a point at 2 m.
DEGENERATE_SCALE = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
_IDENTITY = np.eye(4)
_IDENTITY.setflags(write=False)
_the_identity = repeat(_IDENTITY).__next__  # without a Python call for each estimate


class Reason(StrEnum):
    """Why a frame or a wheel reading yields no motion or no pose."""

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
    """The state of an estimate.

    initializing: no pose yet. In a loaded map there may be a pose in odom, but none in the map.
    unconfirmed: the pose in a loaded map follows from a given start, or from a place that no longer looks like the map.
    tracking: the pose is known.
    coasting: the pose comes from wheels alone, or from a camera after relocalization in odom only; its covariance
    grows.
    failing: this frame yields no pose, the next one may.
    lost: too many frames failed in a row, or all sensors were silent too long. Only place recognition helps.
    """

    INITIALIZING = "initializing"
    UNCONFIRMED = "unconfirmed"
    TRACKING = "tracking"
    COASTING = "coasting"
    FAILING = "failing"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class TrackingState:
    """The state of tracking: initializing, tracking, failing or lost (Zhang, Fig. 3).

    Attributes:
        lost_after: number of consecutive failed frames after which the state is lost, until a place is recognised.
        has_begun: whether any frame was tracked.
        failures: number of failed frames since the last tracked one.
    """

    lost_after: int
    has_begun: bool = False
    failures: int = 0

    @property
    def is_lost(self) -> bool:
        """Whether at least `lost_after` frames in a row failed."""
        return self.has_begun and self.failures >= self.lost_after

    @property
    def status(self) -> Status:
        """The status of the estimate at the last frame, by `DECISIONS`."""
        finding = PoseFinding.FRAME_FAILED if self.failures else PoseFinding.TRACKED
        if not self.has_begun:
            finding = PoseFinding.NOT_BEGUN
        elif self.is_lost:
            finding = PoseFinding.CAMERA_LOST
        return DECISIONS[finding].status or Status.INITIALIZING

    def tracked(self) -> TrackingState:
        """The state after a tracked frame."""
        return replace(self, has_begun=True, failures=0)

    def failed(self) -> TrackingState:
        """The state after a failed frame."""
        return replace(self, failures=self.failures + 1)


@dataclass(frozen=True, slots=True, eq=False)
class MotionEstimate:
    """The camera's motion against a reference frame, or the reason of the failure.

    Attributes:
        T_reference_current: (4, 4), or None on failure.
        covariance: (6, 6) of the left perturbation (v, ω) of `T_reference_current`, or None on failure.
        reason: None on success.
        matches: number of proposed point pairs.
        inliers: number of pairs that agree with the motion.
        degenerate: (K, 6) unit vectors of (v, ω · 2 m) that the images do not constrain; the prior fills them. Or None.
        fitting: share of the regions of the view that agree with known surfaces at this motion; None if unknown.
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
        """Return an estimate with a reason and no motion."""
        return cls(None, None, reason, matches, inliers)

    @property
    def shows_all(self) -> bool:
        """Whether no direction of motion is left to the prior."""
        return self.degenerate is None or not len(self.degenerate)


def with_frame_error(covariance: FloatArray, T_reference_frame: FloatArray, of_frame: FloatArray) -> FloatArray:
    """Covariance (6, 6) of a pose's (4, 4) left perturbation, plus the error `of_frame` (6, 6) in the frame's axes."""
    Ad = se3.adjoint(T_reference_frame)
    return np.asarray(covariance + Ad @ of_frame @ Ad.T)


def with_stamp_noise(motion: MotionEstimate, twist: FloatArray | None, noise_s: float) -> MotionEstimate:
    """Return a motion of the camera with a covariance for the time error of wheel readings, at a velocity (6,).

    Otherwise wrong stamps would look like slip.
    """
    if twist is None or motion.T_reference_current is None or motion.covariance is None or not noise_s:
        return motion
    apart = se3.adjoint(motion.T_reference_current) @ (twist * noise_s)
    return replace(motion, covariance=motion.covariance + np.outer(apart, apart))


def with_view_noise(motion: MotionEstimate, of_frame: FloatArray, walk_per_m: float) -> MotionEstimate:
    """Return a motion of the camera with a covariance for systematic errors `of_frame` (6, 6) that vary with the view.

    Distorted depth and a rolling shutter affect neighbouring views alike, so that their relative motion is exact. The
    errors show against a frame that is farther away.
    """
    from wheelsight.core.geometry import motion_kernels as motions

    T = motion.T_reference_current
    if T is None or motion.covariance is None:
        return motion
    walk = of_frame * (walk_per_m * motions.view_shift_m(T))
    return replace(motion, covariance=with_frame_error(motion.covariance, T, walk))


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The pose of the body at one stamp, with status and covariance.

    Attributes:
        stamp_s: time of the event, seconds.
        status: state of the estimate.
        T_odom_body: (4, 4) in the frame odom, or None if unknown. `body` is "camera" or "base". After a rejected wheel
            reading it is the previous pose with a larger covariance. A localizer's pose in odom is continuous. A filter
            gives T_filter_body here, which may jump when it corrects the past; `OdomFrame.framed` converts it to odom.
        covariance: (6, 6) of the left perturbation (v, ω) of `T_odom_body`, or None.
        reason: why the event yields no pose of its own, or None.
        matches: number of matches of this frame's alignment.
        inliers: number of inliers of this frame's alignment.
        T_map_odom: (4, 4) pose of the frame odom in the map (ROS REP 105); corrections of map and filter change it.
        covariance_map: (6, 6) of the left perturbation (v, ω) of `T_map_body`, or None without loop closures.
        T_filter_odom: (4, 4) pose of odom in the filter's frame, planar because height and tilt are the same in both.
            The identity if nothing jumps.
        keyframe: the keyframe that the pose refers to, or None; see `wheelsight.core.keyframes`.
        T_keyframe_body: (4, 4) pose of the body relative to that keyframe, or None. After keyframes move,
            `T_map_keyframe @ T_keyframe_body` is the corrected pose.
    """

    stamp_s: float
    status: Status
    T_odom_body: FloatArray | None = None
    covariance: FloatArray | None = None
    reason: Reason | None = None
    body: str = "camera"
    matches: int = 0
    inliers: int = 0
    T_map_odom: FloatArray = field(default_factory=_the_identity, kw_only=True)
    covariance_map: FloatArray | None = field(default=None, kw_only=True)
    T_filter_odom: FloatArray = field(default_factory=_the_identity, kw_only=True)
    keyframe: KeyframeId | None = field(default=None, kw_only=True)
    T_keyframe_body: FloatArray | None = field(default=None, kw_only=True)

    @property
    def T_map_body(self) -> FloatArray | None:
        """(4, 4) pose in the map, or None if unknown; it may jump."""
        if self.T_odom_body is None or self.status is Status.INITIALIZING:
            return None
        return self.T_map_odom @ self.T_odom_body

    @property
    def T_filter_body(self) -> FloatArray | None:
        """(4, 4) pose in the filter's frame, without loop closures, or None; it may jump. A trajectory holds it."""
        if self.T_odom_body is None or self.T_filter_odom is _IDENTITY:
            return self.T_odom_body
        return self.T_filter_odom @ self.T_odom_body

    @property
    def filter_covariance(self) -> FloatArray | None:
        """(6, 6) of the left perturbation (v, ω) of `T_filter_body`, which has no drift of odom; or None."""
        C = self.covariance
        if C is None or self.T_filter_odom is _IDENTITY:
            return C
        Ad = se3.adjoint(self.T_filter_odom)
        if isinstance(self, FusedEstimate):  # as `OdomFrame.framed` adds it
            C = C - _drift_covariance(se3.invert(self.T_filter_odom))
        return np.asarray(Ad @ C @ Ad.T)

    def pose_in(self, store: KeyframeStore) -> FloatArray | None:
        """Return T_map_body (4, 4) by the present pose of its keyframe, for instance after a loop closure.

        None if the estimate refers to no keyframe.
        """
        if self.keyframe is None or self.T_keyframe_body is None:
            return None
        return store.pose(self.keyframe) @ self.T_keyframe_body


@dataclass(frozen=True, slots=True, eq=False)
class MotionStep:
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

    def then(self, later: MotionStep) -> MotionStep:
        """Return the composition with a later step, for independent errors."""
        Ad = se3.adjoint(self.T_before_now)
        C = self.covariance + Ad @ later.covariance @ Ad.T
        return MotionStep(self.begin_s, later.end_s, self.T_before_now @ later.T_before_now, C)


@dataclass(frozen=True, eq=False)
class WheelEstimate(Estimate):
    """The estimate of wheel odometry at a reading, with the step that led there.

    Attributes:
        before: stamp, T_odom_body (4, 4) and covariance (6, 6) at the previous reading; None at the first reading, and
            at one whose stamp runs backwards.
    """

    before: tuple[float, FloatArray, FloatArray] | None = field(default=None, kw_only=True)

    @cached_property
    def step(self) -> MotionStep | None:
        """The motion since the previous reading; for a rejected reading the identity with a large covariance.

        None without a previous reading, or if numbers are not finite.
        """
        from wheelsight.core.geometry import motion_kernels as motions

        if self.before is None or self.T_odom_body is None or self.covariance is None:
            return None
        begin_s, T_before, C_before = self.before
        for numbers in (T_before, C_before, self.T_odom_body, self.covariance):
            if not np.isfinite(numbers).all():
                return None
        T_before_now, _ = motions.between(T_before, C_before, self.T_odom_body, self.covariance)
        _, covariance = motions.step_between(T_before, C_before, self.T_odom_body, self.covariance)
        return MotionStep(begin_s, self.stamp_s, T_before_now, covariance)


_NO_MOTION = MotionEstimate.failed(Reason.FRAME_UNUSABLE)


@dataclass(frozen=True, slots=True, eq=False)
class CameraEstimate(Estimate):
    """The estimate of a visual odometry at a frame: its pose, and the motion against a reference.

    The camera has no other frame than the map, so `T_odom_body` is T_map_camera, and `T_map_odom` the identity.

    Attributes:
        motion: of this frame against its reference, or the reason of the failure.
        shows_all: whether the last frames constrained every direction of motion; else part of the pose is predicted.
        relocation: (4, 4) from the left, the part of the change of the pose that is no motion: an older keyframe ended
            the drift since then. None without.
    """

    motion: MotionEstimate = field(default=_NO_MOTION, kw_only=True)
    shows_all: bool = field(default=True, kw_only=True)
    relocation: FloatArray | None = field(default=None, kw_only=True)


# Name of the cloned pose at the begin of a step in `odom`. No measurement may refer to it.
STEP_BEGIN = "step begin"


@dataclass(frozen=True, slots=True, eq=False)
class FusedEstimate(Estimate):
    """The base's pose by all sensors.

    Status of a filter's own estimate: initializing, before any event. tracking: the filter accepted vision within
    `coast_after_s`. coasting: the wheels alone give the pose, and the covariance grows. lost, without a pose: all
    sensors were silent for `lost_after_s`, the filter diverged, or the covariance is too large for a known pose. A
    measurement against a cloned pose ends it; a position does not, since it gives no heading.

    In a localizer, more evidence changes the status: a suspected sensor, a kidnapping, a poor restart, a jumping clock,
    or the place in a known map. `DECISIONS` has all of it.

    Attributes:
        slip: the filter ignores the wheels, because camera or gyroscope contradict them.
        degenerate: the last measurement of the camera did not constrain all directions.
        doubtful: camera and wheels contradict each other without a decision; the covariance covers both.
        twist: (3,) vx, vy, ωz of the base in its own frame, m/s and rad/s. Or None.
        twist_covariance: (3, 3), or None.
        nis: normalised innovation squared of the measurement, and its degrees of freedom; or None.
        wheel_errors: (3,) estimated errors of the wheels: the ratio by which distances are too short, the missing
            rotation in rad/m, the ratio by which rotations are too small. Or None.
    """

    slip: bool = False
    degenerate: bool = False
    doubtful: bool = False
    twist: FloatArray | None = None
    twist_covariance: FloatArray | None = None
    nis: tuple[float, int] | None = None
    wheel_errors: FloatArray | None = None


class PoseFinding(StrEnum):
    """What an odometry, a filter or a check finds about a pose. `DECISIONS` has the consequences."""

    NOT_BEGUN = "no sensor has measured a pose yet"
    TRACKED = "the camera measures the pose"
    DEAD_RECKONED = "the wheels measure the motion since a known pose"
    WHEELS_ALONE = "no camera measurement was accepted lately"
    READING_REFUSED = "the wheel reading yields no motion"
    FRAME_FAILED = "the frame yields no pose"
    CAMERA_LOST = "too many frames in a row yield no pose"
    NOT_LATER = "the stamp is not later than the one before"
    TOO_UNCERTAIN = "the covariance is larger than that of a known pose"
    SILENT = "all sensors were silent for too long, or the filter diverged"
    TURNS_CONTRADICTED = "wheels and gyroscope turn differently, and no other sensor shows which is wrong"
    SLIP = "the camera or the gyroscope contradicts the wheels, and is accepted"
    DEGENERATE = "the last image does not constrain all directions"
    FAULT_UNDECIDED = "camera and wheels contradict each other, without a decision"
    UNCOMPARED = "wheels and camera have not been compared over enough way"
    FLOOR_ELSEWHERE = "the camera sees the floor at a wrong distance"
    SENSOR_SUSPECTED = "a sensor may be wrong since a moment"
    SENSOR_WRONG = "wheels and camera contradict each other all along"
    UNCERTAIN_RESTART = "the camera restarted at a pose that the wheels know poorly"
    KIDNAPPED = "the view changed although the wheels stood"
    CLOCKS_APART = "the event is refused, since its clock jumped or has another epoch"
    PLACE_KNOWN = "the place in the map is as certain as the pose"
    PLACE_UNCERTAIN = "the place in the map is uncertain, or the submap is not joined"
    UNCONFIRMED = "the camera has not confirmed the place in an existing map yet, or does so no longer"
    NOT_RECOGNISED = "no place of an existing map is recognised yet"


class Consequence(NamedTuple):
    """What follows from a finding.

    Attributes:
        status: of the estimate; None for the one so far.
        slip: whether the wheels slip; None for the answer so far.
        is_degenerate, is_doubtful: whether the estimate gets that flag.
        reason: of an event that has none.
    """

    status: Status | None = None
    slip: bool | None = None
    is_degenerate: bool = False
    is_doubtful: bool = False
    reason: Reason | None = None


# `docs/fusion.md` shows this table.
DECISIONS = {
    PoseFinding.NOT_BEGUN: Consequence(Status.INITIALIZING),
    PoseFinding.TRACKED: Consequence(Status.TRACKING),
    PoseFinding.DEAD_RECKONED: Consequence(Status.TRACKING),
    PoseFinding.WHEELS_ALONE: Consequence(Status.COASTING),
    PoseFinding.READING_REFUSED: Consequence(Status.FAILING),
    PoseFinding.FRAME_FAILED: Consequence(Status.FAILING),
    PoseFinding.CAMERA_LOST: Consequence(Status.LOST),
    PoseFinding.NOT_LATER: Consequence(Status.FAILING, reason=Reason.CLOCK_BACKWARDS),
    PoseFinding.TOO_UNCERTAIN: Consequence(Status.LOST),
    PoseFinding.SILENT: Consequence(Status.LOST),
    PoseFinding.TURNS_CONTRADICTED: Consequence(Status.COASTING),
    PoseFinding.SLIP: Consequence(slip=True),
    PoseFinding.DEGENERATE: Consequence(is_degenerate=True),
    PoseFinding.FAULT_UNDECIDED: Consequence(is_doubtful=True),
    PoseFinding.UNCOMPARED: Consequence(),
    PoseFinding.FLOOR_ELSEWHERE: Consequence(),
    PoseFinding.SENSOR_SUSPECTED: Consequence(Status.COASTING, is_doubtful=True),
    PoseFinding.SENSOR_WRONG: Consequence(slip=False, is_doubtful=True, reason=Reason.CONTRADICTION),
    PoseFinding.UNCERTAIN_RESTART: Consequence(Status.COASTING, is_doubtful=True, reason=Reason.NOT_RECOGNISED),
    PoseFinding.KIDNAPPED: Consequence(Status.COASTING, is_doubtful=True, reason=Reason.CONTRADICTION),
    PoseFinding.CLOCKS_APART: Consequence(Status.COASTING, reason=Reason.CLOCKS_APART),
    PoseFinding.PLACE_KNOWN: Consequence(),
    PoseFinding.PLACE_UNCERTAIN: Consequence(Status.COASTING),
    PoseFinding.UNCONFIRMED: Consequence(Status.UNCONFIRMED),
    PoseFinding.NOT_RECOGNISED: Consequence(Status.INITIALIZING),
}


@dataclass(frozen=True, slots=True, eq=False)
class PoseEvidence:
    """A finding, and the pose that it calls for.

    Attributes:
        finding: what was found.
        by_wheels: estimate of the wheels alone, from which the decision starts; None for the fused one.
        T_filter_base: (4, 4) pose in the filter's frame, if it is not that of the estimate.
        covariance: (6, 6) that also covers what was found, in place of that of the estimate; or None.
        covariance_map: (6, 6) of the left perturbation of the pose in the map; or None.
    """

    finding: PoseFinding
    by_wheels: FusedEstimate | None = None
    T_filter_base: FloatArray | None = None
    covariance: FloatArray | None = None
    covariance_map: FloatArray | None = None


class PoseDecision(NamedTuple):
    """Status, flags, reason, pose and covariances of an estimate; the fields are those of `FusedEstimate`."""

    status: Status = Status.INITIALIZING
    slip: bool = False
    degenerate: bool = False
    doubtful: bool = False
    reason: Reason | None = None
    T_odom_body: FloatArray | None = None
    covariance: FloatArray | None = None
    covariance_map: FloatArray | None = None


NO_DECISION = PoseDecision()
"""Without evidence: no pose yet."""


def decide(evidence: Iterable[PoseEvidence | None], before: PoseDecision = NO_DECISION) -> PoseDecision:
    """Return what is decided of an estimate, by `DECISIONS`.

    Args:
        evidence: in the order in which it applies: the last status and covariance count, and the first reason. None
            where a check finds nothing.
        before: decided by earlier evidence.
    """
    status, slip, is_degenerate, is_doubtful, reason, T, C, C_map = before
    for one in evidence:
        if one is None:
            continue
        then = DECISIONS[one.finding]
        status, slip = then.status or status, slip if then.slip is None else then.slip
        is_degenerate, is_doubtful = is_degenerate or then.is_degenerate, is_doubtful or then.is_doubtful
        reason = reason or then.reason
        T = T if one.T_filter_base is None else one.T_filter_base
        C = C if one.covariance is None else one.covariance
        C_map = C_map if one.covariance_map is None else one.covariance_map
    return PoseDecision(status, slip, is_degenerate, is_doubtful, reason, T, C, C_map)


def status_of(finding: PoseFinding) -> Status:
    """Return the status of an estimate with one finding."""
    return decide([PoseEvidence(finding)]).status


@dataclass(frozen=True, slots=True, eq=False)
class FrameUpdate:
    """The result of a frame in the filter.

    Attributes:
        answer: the estimate.
        T_filter_base: (4, 4) pose in the filter's frame at the time of the image; None without a cloned pose.
        is_reference: whether the camera's next motions refer to this frame.
    """

    answer: FusedEstimate
    T_filter_base: FloatArray | None
    is_reference: bool


AnyEstimate = TypeVar("AnyEstimate", bound=Estimate)


class OdomFrame:
    """Transform between `odom` and the frame of a filter.

    The pose of a filter jumps when its estimate of the past changes, for instance after slip or with a new bias of the
    gyroscope. In `odom` the robot moves by the estimated motion alone, and this transform takes the jump (REP 105).

    It is planar: the filter estimates height and tilt of each pose directly.

    A pose of a fused estimate in `odom` is off by the filter's error and by all corrections that `odom` does not
    follow, or not yet. Their sum is this transform. It is known, so its covariance has one direction. It is not
    subtracted, since `odom` would jump.

    Attributes:
        T_odom_filter, T_filter_odom: (4, 4) pose of the filter's frame in `odom`, and its inverse.
        has_moved: whether `odom` is no longer the filter's frame.
    """

    def __init__(self) -> None:
        self.T_filter_odom: FloatArray = np.eye(4)
        self.T_odom_filter = self.T_filter_odom
        self.has_moved = False

    def T_odom_body(self, T_filter_body: FloatArray) -> FloatArray:
        """Convert a pose (4, 4) of the filter to `odom`."""
        from wheelsight.core.geometry import motion_kernels as motions

        return np.asarray(motions.times(self.T_odom_filter, T_filter_body))

    def align(self, T_filter_body: FloatArray, T_odom_body: FloatArray) -> None:
        """Set the transform by one pose in both frames, (4, 4) each; only x, y and yaw count."""
        from wheelsight.core.geometry import motion_kernels as motions

        self.T_filter_odom = motions.times(_planar(T_filter_body), motions.inverse(_planar(T_odom_body)))
        self.T_odom_filter, self.has_moved = motions.inverse(self.T_filter_odom), True

    def framed(self, answer: AnyEstimate) -> AnyEstimate:
        """Return a filter's estimate in `odom`; its poses in the map and in the filter's frame do not change."""
        from wheelsight.core.geometry import motion_kernels as motions

        if not self.has_moved:
            return answer
        T, C, Ad = answer.T_odom_body, answer.covariance, motions.adjoint(self.T_odom_filter)
        fields: dict[str, Any] = {
            "T_map_odom": motions.times(np.ascontiguousarray(answer.T_map_odom), self.T_filter_odom),
            "T_filter_odom": self.T_filter_odom,
            "T_odom_body": None if T is None else motions.times(self.T_odom_filter, T),
            "covariance": None if C is None else Ad @ C @ Ad.T,
        }
        if C is not None and isinstance(answer, FusedEstimate):
            fields["covariance"] += _drift_covariance(self.T_odom_filter)
        if isinstance(answer, WheelEstimate) and answer.before is not None:
            stamp_s, T_before, C_before = answer.before
            fields["before"] = (stamp_s, self.T_odom_body(T_before), Ad @ C_before @ Ad.T)
        return replace(answer, **fields)


def _drift_covariance(T_odom_filter: FloatArray) -> FloatArray:
    """Return (6, 6) of the left perturbation (v, ω) of poses in `odom` by the drift of `odom`."""
    from wheelsight.core.geometry import motion_kernels as motions

    drift = motions.log(T_odom_filter)
    return np.outer(drift, drift)


def _planar(T: FloatArray) -> FloatArray:
    """Return the planar part of a motion (4, 4): x, y and yaw."""
    planar, yaw_rad = np.eye(4), math.atan2(T[1, 0], T[0, 0])
    planar[0, 0] = planar[1, 1] = math.cos(yaw_rad)
    planar[1, 0] = math.sin(yaw_rad)
    planar[0, 1] = -planar[1, 0]
    planar[:2, 3] = T[:2, 3]
    return planar
