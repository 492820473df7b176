"""ErrorStateFilter: an error-state Kalman filter on SE(3) for wheels, camera, gyroscope and areas.

Perturbations are from the left (`pose_belief`). The state is the base's pose, its twist, the errors of the wheels, the
bias of the gyroscope, and remembered poses (stochastic cloning, Roumeliotis & Burdick, ICRA 2002). The camera measures
relative motions against these.

- The twist is planar (vx, vy, ωz in the base's frame), as wheels and gyroscope measure it. On a ramp the pose is
  tilted, not the twist. The twist predicts the pose without wheel readings.
- The errors of the wheels (scale of distances, turn per metre, scale of turns) are part of the state because they are
  systematic: a radius that is 2 % wrong stays 2 % wrong. The camera observes them.
- The floor is only softly level: height, roll and pitch drift with the distance, and roll and pitch are pulled back.
- A camera measurement excludes the directions that the camera does not observe.
- `fault_detection` decides between sensors that contradict each other.

Events may arrive late and in any order, within a window (`History`). The filter then repeats what followed, so that the
result is that of the events in order. The same events give the same estimates bit for bit.

A gyroscope may give a thousand readings per second, while steps of the wheels take a fiftieth of a second. Its readings
are integrated up to the end of such a step, or up to a frame. The mean rate is one measurement, of the twist over the
same time as that of the wheels. Single readings would each be tested, and some of a thousand always fail a gate. They
would also count as if the wheels had independent errors each time.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from operator import attrgetter
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration_parts import WHEEL_SIGMAS, Gyro
from wheelsight.core.checks import need_number
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import (
    NO_DECISION,
    STEP_BEGIN,
    FrameUpdate,
    FusedEstimate,
    MotionEstimate,
    MotionStep,
    PoseDecision,
    PoseEvidence,
    PoseFinding,
    Reason,
    Status,
    WheelEstimate,
    decide,
)
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.settings.fusion import ErrorStateSettings
from wheelsight.estimation import fault_detection as faults
from wheelsight.estimation.agreement import WHEEL_SENSORS, Exclusion, RobotSensor
from wheelsight.estimation.fault_detection import Fault, FaultDetection
from wheelsight.estimation.filter_kernels import answered
from wheelsight.estimation.pose_belief import (
    ERRORS,
    FilterEvent,
    FilterParameters,
    Mount,
    PoseBelief,
    Preintegration,
    WheelStep,
    changed,
    covariance_of,
    is_pose,
    motion_of,
    numbers_of,
    of_unknown_path,
)

# Names of remembered poses: of the last frame, of the reference of camera motions, and of a requested frame. Those of
# keyframes have their numbers.
FRAME, REFERENCE, _IMAGED = "frame", "reference", "imaged"
# Number of remembered poses other than keyframes: these, and the begin of a step.
_OTHERS = 4
_SAME_S = 1e-6  # rounding of computed stamps


class ErrorStateFilter:
    """The default filter; see the module. Each method returns the estimate right after the event.

    A rejected event has no effect: the estimate is that of the newest event, and `reason` says why. Invalid motions
    (`INVALID`) and events before the window (`TOO_LATE`) are rejected. Measurements outside the gates have the reason
    `CONTRADICTION` or `OUTLIER`. The filter trusts stamps; a `SessionClock` detects jumps of clocks.

    Args:
        T_base_camera: (4, 4), or None without a camera.
        T_odom_base: (4, 4) at the first event, in the filter's frame, whose z is up; None for the identity.
        covariance: (6, 6) of its left perturbation; None for zero.
        settings: of the filter, or all its parameters; None for the defaults.
        gyro: noise of the gyroscope; None for the defaults of `Gyro`, or those of the parameters.

    Raises:
        ConfigError: an invalid motion or covariance.
        ArgumentError: in its methods, a stamp or rate that is not a number.
    """

    def __init__(
        self,
        T_base_camera: ArrayLike | None = None,
        T_odom_base: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        settings: ErrorStateSettings | FilterParameters | None = None,
        gyro: Gyro | None = None,
    ) -> None:
        if not isinstance(settings, FilterParameters):
            settings = FilterParameters.of(settings, gyro)
        self.parameters = settings
        begin = np.eye(4) if T_odom_base is None else motion_of(T_odom_base)
        spread = np.zeros((6, 6)) if covariance is None else covariance_of(covariance, 6)
        T_base_camera = np.eye(4) if T_base_camera is None else motion_of(T_base_camera)
        if begin is None or spread is None or T_base_camera is None:
            raise ConfigError("the start pose, its covariance or T_base_camera is invalid", fix="(4, 4) and (6, 6)")
        self._mount = Mount(T_base_camera)
        state = FusionState(FaultDetection(PoseBelief.begin(begin, spread, self.parameters)))
        self._history: History[FilterEvent, FusionState] = History(state, self.parameters.window_s, self._after)
        self._waiting: MotionStep | None = None  # wheel step that is too short for a velocity
        self._kept: list[str] = []  # names of keyframes whose motions are not settled
        self._kept_ever = 0
        self._reading_stamps_s: deque[float] = deque(maxlen=self.parameters.rate_readings)
        # The state of the last prediction, and that prediction: the predicted frame usually follows.
        self._moved: tuple[FusionState, FusionState] | None = None
        self.current: CurrentPose | None = None
        self._exclusions: tuple[Exclusion, ...] = ()

    @property
    def state(self) -> FusionState:
        """State after the newest event; immutable."""
        return self._history.newest

    def begun_at(
        self, T_filter_base: ArrayLike, covariance: ArrayLike, parameters: FilterParameters | None = None
    ) -> ErrorStateFilter:
        """Return a new filter of the same sensors that starts at a pose; default the same parameters.

        Raises ConfigError.
        """
        return ErrorStateFilter(self._mount.T_base_camera, T_filter_base, covariance, parameters or self.parameters)

    def with_unknown_wheels(self) -> ErrorStateFilter:
        """Return a new filter at the current pose, of wheels that are as uncertain as those without calibration."""
        now, sizes = self.current, ErrorStateSettings()
        assert now is not None
        larger = {name: max(getattr(sizes, name), getattr(self.parameters, name)) for name in WHEEL_SIGMAS}
        return self.begun_at(now.T, now.covariance, replace(self.parameters, **larger))

    def predict(self, stamp_s: float, T_prev_now: ArrayLike, covariance: ArrayLike, begin_s: float) -> FusedEstimate:
        """Predict by a step of the wheels, from `begin_s` to `stamp_s`.

        Args:
            stamp_s: end of the step.
            T_prev_now: (4, 4) pose of the base at the end, in the frame of the base at the begin; `T_before_now` of
                `WheelEstimate.step`, which also has the covariance and `begin_s`.
            covariance: (6, 6) of its left perturbation, by the wheels' model.
            begin_s: begin of the step.
        """
        T, Q, begin_s = motion_of(T_prev_now), covariance_of(covariance, 6), need_number("begin_s", begin_s)
        if T is None or Q is None or not (np.isfinite(begin_s) and begin_s < need_number("stamp_s", stamp_s)):
            return self._refused(Reason.INVALID)
        return self._take(FilterEvent(stamp_s, wheels=WheelStep(begin_s, stamp_s, motions.log(T), Q)))

    def predict_to(self, wheels: WheelEstimate) -> FusedEstimate:
        """Predict by the next estimate of wheel odometry, in order. The first one is the start; its step is ignored."""
        step, begins = wheels.step, not self._reading_stamps_s
        motion = (wheels.T_odom_body, wheels.covariance) if step is None else (step.T_before_now, step.covariance)
        if wheels.reason is Reason.CLOCK_BACKWARDS or not is_pose(*motion):
            return self._refused(wheels.reason or Reason.INVALID)
        self._reading_stamps_s.append(wheels.stamp_s)
        if begins or step is None or wheels.reason is not None:
            # It starts the clock, or has no motion: the twist predicts the pose.
            self._waiting = None
            return self._take(FilterEvent(wheels.stamp_s, drop=""), reason=wheels.reason)
        step = step if self._waiting is None else self._waiting.then(step)
        if not step.begin_s < step.end_s:
            return self._refused(Reason.INVALID)
        # Readings that arrive together have stamps that are too close for a velocity. The distance counts with that of
        # the next reading: half of the mean interval of readings is enough.
        stamps_s = self._reading_stamps_s
        shortest_s = 0.5 * (stamps_s[-1] - stamps_s[0]) / (len(stamps_s) - 1) if len(stamps_s) > 2 else 0.0
        if step.end_s - step.begin_s < shortest_s:
            self._waiting = step
            return self._take(FilterEvent(wheels.stamp_s, drop=""))
        self._waiting = None
        xi, spread = motions.log(step.T_before_now), step.covariance
        if step.end_s - step.begin_s > self.parameters.even_s:
            spread = spread + of_unknown_path(xi, self.parameters.swing_rad)
        return self._take(FilterEvent(step.end_s, wheels=WheelStep(step.begin_s, step.end_s, xi, spread)))

    def exclude(self, exclusions: Sequence[Exclusion], since_s: float) -> bool:
        """Leave out sensors in some times, and compute the state again since a stamp, as if it had been so.

        Returns whether events are remembered as far back; else the exclusions count from now on.
        """
        self._exclusions = tuple(exclusions)
        self._moved = None
        if not self._history.repeat(since_s, self._used):
            return False
        self.current = CurrentPose.of(self._history.newest, self.parameters)
        return True

    def _used(self, event: FilterEvent) -> FilterEvent:
        """Return an event, without the measurement of a sensor that is left out."""
        event = event.original or event
        for sensor, begin_s, end_s, _ in self._exclusions:
            if not begin_s <= event.since_s < end_s:
                continue
            if sensor is RobotSensor.CAMERA and event.measurement is not None:
                return replace(event, measurement=None, failure=Reason.CONTRADICTION, original=event)
            of_wheels = event.wheels is not None and sensor in WHEEL_SENSORS
            if of_wheels or (event.yaw_rate_rad_s is not None and sensor is RobotSensor.GYRO):
                return FilterEvent(event.stamp_s, drop="", original=event)
        return event

    def clone(self, stamp_s: float, name: str, covariance: ArrayLike | None = None) -> FusedEstimate:
        """Remember the pose at a stamp as `name`, for later measurements. It replaces an earlier one of that name.

        Args:
            stamp_s: of the pose.
            name: of the pose.
            covariance: (6, 6) of the left perturbation of camera odometry's pose, in the camera's frame: an error that
                all later measurements against it share. None for no error.
        """
        if covariance is None:
            return self._take(FilterEvent(stamp_s, clone=name))
        spread = covariance_of(covariance, 6)
        if spread is None:
            return self._refused(Reason.INVALID)
        return self._take(FilterEvent(stamp_s, clone=name, spread=self._mount.spread(spread)))

    def drop(self, stamp_s: float, name: str) -> FusedEstimate:
        """Marginalise a remembered pose."""
        return self._take(FilterEvent(stamp_s, drop=name))

    def update_relative(
        self, stamp_s: float, motion: MotionEstimate, name: str, remember: str | None = None
    ) -> FusedEstimate:
        """Update by the camera's motion since the pose remembered as `name`, or by its failure.

        Args:
            stamp_s: of the frame.
            motion: T_reference_current of the camera, with the covariance of its left perturbation. Directions in
                `degenerate` are left out.
            name: of the reference.
            remember: name by which to remember the pose right afterwards, as `clone` does.
        """
        measurement = self._mount.measurement(motion, name)
        if isinstance(measurement, Reason):
            return self._take(FilterEvent(stamp_s, failure=measurement, clone=remember), motion)
        return self._take(FilterEvent(stamp_s, measurement=measurement, clone=remember), motion)

    def begin_frame(self, stamp_s: float, covariance: ArrayLike) -> FrameUpdate:
        """Remember the pose at a frame at which the camera starts, as that of the last frame and of the reference.

        Args:
            stamp_s: of the frame.
            covariance: (6, 6) of the camera's left perturbation, in its own frame; see `clone`.
        """
        answer = self.clone(stamp_s, FRAME)
        T_filter_base = self.remembered(FRAME)
        self.clone(stamp_s, REFERENCE, covariance)
        return FrameUpdate(answer, T_filter_base, is_reference=True)

    def update_frame(
        self, stamp_s: float, motion: MotionEstimate, covariance: ArrayLike, *, is_far: bool
    ) -> FrameUpdate:
        """Update by the camera's motion since the reference, and remember the pose as that of the last frame.

        The frame becomes the next reference if it is far from the previous one, or was rejected. Then an error of the
        camera does not affect the next frame, and slip shows as a repeated contradiction.

        Args:
            stamp_s: of the frame.
            motion: T_reference_current of the camera, with the covariance of its left perturbation.
            covariance: as of `begin_frame`, for the next reference.
            is_far: whether the frame is far from the reference.
        """
        answer = self.update_relative(stamp_s, motion, REFERENCE, remember=FRAME)
        T_filter_base, is_reference = self.remembered(FRAME), is_far or answer.reason is not None or answer.doubtful
        if is_reference:
            self.clone(stamp_s, REFERENCE, covariance)
        return FrameUpdate(answer, T_filter_base, is_reference)

    def miss_frame(self, stamp_s: float, motion: MotionEstimate) -> FusedEstimate:
        """Add a frame without a motion; `motion` has the reason."""
        return self.update_relative(stamp_s, motion, REFERENCE)

    def keep_frame(self, stamp_s: float) -> tuple[FloatArray, FloatArray] | None:
        """Remember the pose at a frame as that of a keyframe; return the camera's motion from the previous one.

        The motion is (4, 4), with the covariance (6, 6) of its left perturbation; None at the first keyframe.
        """
        motion = self.expect(stamp_s, self._kept[-1]) if self._kept else None
        self._kept.append(f"keyframe {self._kept_ever}")
        self._kept_ever += 1
        self.clone(stamp_s, self._kept[-1])
        return motion

    def settled_motions(self, *, waits: bool = False) -> list[tuple[FloatArray, FloatArray] | None] | None:
        """Return the motions of `keep_frame` by the current state, for all kept frames since the last call.

        None while the filter has two hypotheses, or a sensor is suspected (`waits`), and enough room to remember the
        frames. Until a decision, estimates of the motions lie between both hypotheses.
        """
        detection = self._history.newest.detection
        if (waits or detection.alternative is not None) and len(self._kept) + _OTHERS < self.parameters.max_clones:
            return None
        belief, at = detection.answer(self.parameters), self._mount.T_base_camera
        found = [belief.between(*ends, at) for ends in pairwise(self._kept)]
        for name in self._kept[:-1]:
            self.drop(self.estimate.stamp_s, name)
        self._kept = self._kept[-1:]
        return found

    def expect_frame(self, stamp_s: float) -> FloatArray | None:
        """Return the predicted T_last_current (4, 4) of the camera since the last frame; None without one."""
        expected = self.expect(stamp_s, FRAME)
        return None if expected is None else expected[0]

    def spread_since_frame_m(self, stamp_s: float) -> float | None:
        """Return σ of the base's motion in the plane since the last frame, metres; None without one."""
        expected = self.expect(stamp_s, FRAME)
        if expected is None:
            return None
        T_camera_base = se3.invert(self._mount.T_base_camera)
        T = self._mount.T_base_camera @ expected[0] @ T_camera_base
        Ad = se3.adjoint(self._mount.T_base_camera)
        return float(np.sqrt(np.trace(se3.position_covariance(T, Ad @ expected[1] @ Ad.T)[:2, :2])))

    def when_imaged(self, stamp_s: float) -> FloatArray:
        """Return T_filter_base (4, 4) when the image with a stamp was taken; the camera's stamps are delayed."""
        self.clone(stamp_s, _IMAGED)
        T_filter_base = self.remembered(_IMAGED)
        assert T_filter_base is not None
        return T_filter_base

    def last_frame(self) -> FloatArray | None:
        """Return the current estimate of T_filter_base (4, 4) at the last frame; None without one."""
        return self.remembered(FRAME)

    def update_position(self, stamp_s: float, xy: ArrayLike, covariance: ArrayLike) -> FusedEstimate:
        """Update by a position (2,) in the map, metres, with its covariance (2, 2), as areas give it."""
        position, spread = numbers_of(xy), covariance_of(covariance, 2)
        if (
            position is None
            or position.shape != (2,)
            or not np.isfinite(position).all()
            or spread is None
            or not motions.is_definite(spread)
        ):
            return self._refused(Reason.INVALID)
        return self._take(FilterEvent(stamp_s, position=(position, spread)))

    def update_yaw_rate(self, stamp_s: float, yaw_rate_rad_s: float) -> FusedEstimate:
        """Update by a gyroscope's yaw rate, counter-clockwise from above, the mean since its last one.

        Wheel odometry must not use the gyroscope then. The measurement is the mean over a wheel step, or over 0.05 s.
        """
        if not np.isfinite(need_number("yaw_rate_rad_s", yaw_rate_rad_s)):
            return self._refused(Reason.INVALID)
        return self._take(FilterEvent(stamp_s, yaw_rate_rad_s=float(yaw_rate_rad_s) - self.parameters.gyro.bias_rad_s))

    def update_gyro_bias(self, stamp_s: float, bias_rad_s: float, sigma_rad_s: float) -> FusedEstimate:
        """Update by an external estimate of the gyroscope's bias, and its standard deviation.

        That estimate started from the prior of the settings, which must not count twice: its information is removed.
        """
        prior, variance = self.parameters.gyro.bias_sigma_rad_s**2, sigma_rad_s**2
        if not (np.isfinite(bias_rad_s) and 0 < variance < prior):
            return self._refused(Reason.INVALID)
        more = prior / (prior - variance)
        bias = (more * (bias_rad_s - self.parameters.gyro.bias_rad_s), more * variance)
        return self._take(FilterEvent(stamp_s, gyro_bias=bias))

    def remembered(self, name: str) -> FloatArray | None:
        """Return the current estimate of T_filter_base (4, 4) remembered as `name`; None if there is none.

        The time of the pose is when the image with that stamp was taken, by the estimated delay of stamps.
        """
        if self.current is None:
            return None
        belief = self.current.belief
        index = belief.find_index(name)
        return None if index is None else belief.T[index].copy()

    @property
    def estimate(self) -> FusedEstimate:
        """Estimate after the newest event."""
        newest = self._history.newest
        return self._answer(newest.reason, newest.detection.nis)

    def expect(self, stamp_s: float, name: str) -> tuple[FloatArray, FloatArray] | None:
        """Return the predicted T_reference_current (4, 4) of the camera, and its covariance (6, 6).

        The prediction uses events up to the stamp; None if `name` is not remembered. It replaces the directions that
        the camera does not observe.
        """
        if not np.isfinite(stamp_s):
            return None
        known = self._history.known_at(stamp_s)
        if known.detection.primary.find_index(name) is None:
            return None
        late = known.stamp_s is not None and stamp_s < known.stamp_s
        then = known if late else moved_to(known, stamp_s, self._history.events, self.parameters)
        self._moved = known, then
        return then.detection.answer(self.parameters).seen_from(name, self._mount.T_base_camera)

    def _after(self, state: FusionState, event: FilterEvent, events: Sequence[FilterEvent]) -> FusionState:
        if self._moved is not None and self._moved[0] is state and self._moved[1].stamp_s == event.stamp_s:
            state = self._moved[1]
        try:
            then = after(state, event, events, self.parameters)
        except np.linalg.LinAlgError:
            return _diverged(state, event, self.parameters)
        for belief in (then.detection.primary, then.detection.alternative):
            if belief is not None and not (np.isfinite(belief.T).all() and np.isfinite(belief.covariance).all()):
                return _diverged(state, event, self.parameters)
        return then

    def _take(
        self, event: FilterEvent, motion: MotionEstimate | None = None, reason: Reason | None = None
    ) -> FusedEstimate:
        stamp_s = event.stamp_s
        if not np.isfinite(stamp_s if type(stamp_s) is float else need_number("stamp_s", stamp_s)):
            return self._refused(Reason.INVALID)
        if event.wheels is not None:
            self._moved = None  # the step may cover that time
        state = self._history.take(self._used(event) if self._exclusions else event)
        if state is None:
            return self._refused(Reason.TOO_LATE)
        self.current = CurrentPose.of(self._history.newest, self.parameters)
        counts = (0, 0) if motion is None else (motion.matches, motion.inliers)
        return self._answer(reason or state.reason, state.detection.nis, counts)

    def _refused(self, reason: Reason) -> FusedEstimate:
        return self._answer(reason, self._history.newest.detection.nis)

    def _answer(
        self, reason: Reason | None, nis: tuple[float, int] | None, counts: tuple[int, int] = (0, 0)
    ) -> FusedEstimate:
        """Return the estimate after the newest event, with reason, NIS and counts of the current one."""
        now = self.current
        if now is None:
            return FusedEstimate(-np.inf, NO_DECISION.status, reason=reason, body="base")
        status, flags = now.decision.status, now.decision[1:4]  # slip, degenerate and doubtful
        if status is Status.LOST:
            return FusedEstimate(now.stamp_s, status, None, None, reason, "base", *counts, *flags, nis=nis)
        pose = (now.T, now.covariance, reason, "base", *counts)
        errors = now.belief.aux[ERRORS].copy()
        return FusedEstimate(now.stamp_s, status, *pose, *flags, *now.twist, nis=nis, wheel_errors=errors)


class StepBegin(NamedTuple):
    """A pose that a filter remembers as the begin of a step; `fusion` is that filter."""

    stamp_s: float
    T_filter_base: FloatArray
    fusion: ErrorStateFilter


_TRACKED, _WHEELS_ALONE = PoseEvidence(PoseFinding.TRACKED), PoseEvidence(PoseFinding.WHEELS_ALONE)
_TOO_UNCERTAIN, _SILENT = PoseEvidence(PoseFinding.TOO_UNCERTAIN), PoseEvidence(PoseFinding.SILENT)
_SLIP, _DEGENERATE = PoseEvidence(PoseFinding.SLIP), PoseEvidence(PoseFinding.DEGENERATE)
_FAULT_UNDECIDED = PoseEvidence(PoseFinding.FAULT_UNDECIDED)
_decided = cache(decide)  # evidence of the filter has no poses, so equal findings give equal decisions


class CurrentPose(NamedTuple):
    """Parts of the estimate after a state: pose (4, 4), covariance (6, 6), and twist with its covariance.

    The pose is that of `belief`, which covers all hypotheses. `decide` makes the decision from the filter's evidence:
    the age of vision, the largest standard deviation, silence, and faults.
    """

    stamp_s: float
    belief: PoseBelief
    decision: PoseDecision
    T: FloatArray
    covariance: FloatArray
    twist: tuple[FloatArray, FloatArray]

    @classmethod
    def of(cls, state: FusionState, settings: FilterParameters) -> CurrentPose:
        """Return those of a state."""
        detection, s = state.detection, settings
        belief = detection.primary if detection.alternative is None else detection.answer(s)
        T, C, *moving = answered(belief.T, belief.aux, belief.covariance, s.clock_sigma_s)
        stamp_s = -np.inf if state.stamp_s is None else state.stamp_s
        evidence = [_WHEELS_ALONE]
        if stamp_s - state.vision_s <= s.coast_after_s:
            evidence = [_TRACKED]
            # Whether the covariance is within the limits of a known pose.
            x, y, z = T[:3, 3]
            J = np.array([[1.0, 0, 0, 0, z, -y], [0, 1.0, 0, -z, 0, x], [0, 0, 1.0, y, -x, 0]])
            of_position, of_rotation = np.einsum("ij,jk,ik->i", J, C, J), np.diag(C)[3:]
            most_rad2, most_m2 = s.largest_sigma_rad**2, s.largest_sigma_m**2
            if not ((of_rotation < most_rad2).all() and (of_position < most_m2).all()):
                evidence.append(_TOO_UNCERTAIN)
        if state.is_lost:
            evidence.append(_SILENT)
        if detection.fault is Fault.WHEEL_SLIP or stamp_s - detection.turn_slip_s <= s.coast_after_s:
            evidence.append(_SLIP)
        if state.is_degenerate:
            evidence.append(_DEGENERATE)
        if detection.fault is Fault.UNDECIDED:
            evidence.append(_FAULT_UNDECIDED)
        return cls(stamp_s, belief, _decided(tuple(evidence)), T, C, (moving[0], moving[1]))


def _diverged(before: FusionState, event: FilterEvent, settings: FilterParameters) -> FusionState:
    """Return the state after an event that makes the filter diverge: the state before it, lost."""
    belief = before.detection.primary.inflated_as_lost(settings)
    scattered = changed(before.detection, primary=belief, alternative=None, fault=Fault.NONE, nis=None)
    stamp_s = event.stamp_s if before.stamp_s is None else max(before.stamp_s, event.stamp_s)
    return changed(before, detection=scattered, stamp_s=stamp_s, is_lost=True, reason=Reason.INVALID)


@dataclass(frozen=True, eq=False)
class FusionState:
    """State of the filter after an event.

    Attributes:
        detection: fault detection, with the hypotheses.
        stamp_s: of the event; None before any.
        measured_s: end of the last wheel step, or stamp of the last camera measurement.
        vision_s: stamp of the last accepted camera measurement.
        is_lost: no sensor has measured for too long, and no measurement has been accepted since.
        is_degenerate: the last measurement did not show all directions.
        reason: why the event was rejected, or None.
    """

    detection: FaultDetection
    stamp_s: float | None = None
    measured_s: float = -np.inf
    vision_s: float = -np.inf
    is_lost: bool = False
    is_degenerate: bool = False
    reason: Reason | None = None


def after(
    state: FusionState, event: FilterEvent, events: Sequence[FilterEvent], settings: FilterParameters
) -> FusionState:
    """Return the state after an event: predict to its stamp, then update. `events` are all that are known."""
    if event.yaw_rate_rad_s is not None:
        return _add_yaw_rate(state, event.yaw_rate_rad_s, event.stamp_s, events, settings)
    now = state if state.stamp_s == event.stamp_s else moved_to(state, event.stamp_s, events, settings)
    detection = now.detection
    if detection.gyro_s is not None:
        detection = _update_turn_until(detection, detection.gyro_s, event.stamp_s, settings)
    if detection.fault in (Fault.UNDECIDED, Fault.WHEEL_SLIP):
        detection = faults.end_undecided(detection, event.stamp_s, settings)
    detection = detection if detection.nis is None else changed(detection, nis=None)
    if detection is not now.detection or now.reason is not None:
        now = changed(now, detection=detection, reason=None)
    if event.measurement is not None or event.failure is not None:
        now = _update_relative(now, event, settings)
    if event.gyro_bias is not None:
        bias = event.gyro_bias
        return changed(now, detection=_each(now.detection, lambda belief: belief.updated(belief.gyro_bias(*bias))))
    if event.position is not None:
        return _update_position(now, *event.position, settings)
    if event.clone is not None:
        return changed(now, detection=_remember(now.detection, event.clone, event.stamp_s, event.spread, settings))
    if event.drop is not None:
        name = event.drop
        return changed(now, detection=_each(now.detection, lambda belief: belief.dropped(name)))
    return now


def moved_to(
    state: FusionState, stamp_s: float, events: Sequence[FilterEvent], settings: FilterParameters
) -> FusionState:
    """Predict the state at a stamp: by the wheel steps among all known events, else at constant twist."""
    detection, measured_s, begin_s, is_lost = state.detection, state.measured_s, state.stamp_s, state.is_lost
    if begin_s is None:
        begin_s = measured_s = min([stamp_s, *[event.wheels.begin_s for event in events if event.wheels is not None]])
    covering = sorted(_steps_between(begin_s, stamp_s, events), key=attrgetter("begin_s"))
    borders = {begin_s, stamp_s}
    for step in covering:
        for border in (step.begin_s, step.end_s):
            if begin_s + _SAME_S < border < stamp_s - _SAME_S:
                borders.add(border)
    for start_s, end_s in pairwise(sorted(borders)):
        covers = None
        for one in covering:
            if one.begin_s <= start_s + _SAME_S and end_s <= one.end_s + _SAME_S:
                covers = one
                break
        # Once the base is lost, it keeps its pose: an old twist would carry it anywhere.
        until_s = end_s if covers is not None else max(start_s, min(end_s, measured_s + settings.lost_after_s))
        detection = _predict(detection, covers, start_s, until_s, settings)
        measured_s = measured_s if covers is None else end_s
        if not is_lost and end_s - measured_s > settings.lost_after_s:
            detection, is_lost = _each(detection, lambda belief: belief.inflated_as_lost(settings)), True
    return changed(state, detection=detection, stamp_s=stamp_s, measured_s=measured_s, is_lost=is_lost)


def _steps_between(after_s: float, before_s: float, events: Sequence[FilterEvent]) -> list[WheelStep]:
    """Return the wheel steps that end after a stamp and begin before another. Events are in the order of stamps."""
    found: list[WheelStep] = []
    for event in reversed(events):
        if event.stamp_s <= after_s:
            break
        if event.wheels is not None and event.wheels.begin_s < before_s:
            found.append(event.wheels)
    found.reverse()
    return found


def _predict(
    detection: FaultDetection, step: WheelStep | None, start_s: float, end_s: float, settings: FilterParameters
) -> FaultDetection:
    """Predict all hypotheses over an interval: by a share of a wheel step, or at constant twist."""
    primary, alternative, seconds = detection.primary, detection.alternative, end_s - start_s
    if step is None:
        primary = primary.predicted_at_constant_twist(seconds, settings)
        alternative = None if alternative is None else alternative.predicted_at_constant_twist(seconds, settings)
        return changed(detection, primary=primary, alternative=alternative)
    share = seconds / (step.end_s - step.begin_s)
    odometer = detection.odometer.moved_by_wheels(step, share)
    step = WheelStep(step.begin_s, step.end_s, step.xi, step.covariance * detection.noise.ratio)
    primary = primary.moved_by_wheels(step, share, settings, detection.fault is Fault.WHEEL_SLIP)
    alternative = None if alternative is None else alternative.moved_by_wheels(step, share, settings, True)
    return changed(detection, primary=primary, alternative=alternative, odometer=odometer)


def _update_relative(state: FusionState, event: FilterEvent, settings: FilterParameters) -> FusionState:
    """Update by a camera measurement, or by its failure."""
    measurement, stamp_s = event.measurement, event.stamp_s
    if measurement is None:
        detection = faults.vision_failed(state.detection, stamp_s, settings)
        return changed(state, detection=detection, reason=event.failure)
    if state.detection.primary.find_index(measurement.name) is None:
        return changed(state, reason=Reason.UNKNOWN_REFERENCE)
    is_degenerate = len(measurement.covariance) < 6
    detection, reason = faults.updated(state.detection, stamp_s, measurement, settings)
    accepted = {} if reason is not None else {"vision_s": stamp_s, "is_lost": False}
    found = {"detection": detection, "reason": reason, "is_degenerate": is_degenerate, "measured_s": stamp_s}
    return changed(state, **found, **accepted)


def _update_position(
    state: FusionState, xy: FloatArray, covariance: FloatArray, settings: FilterParameters
) -> FusionState:
    """Update by a position (2,) in the map. It also changes the odds of the hypotheses."""
    detection = state.detection
    by = detection.primary.position(xy, covariance)
    of_alternative = None if detection.alternative is None else detection.alternative.position(xy, covariance)
    most, detection = faults.gate(settings, 2), changed(detection, nis=(by.nis, 2))
    if by.nis > most and (of_alternative is None or of_alternative.nis > most):
        return changed(state, detection=detection, reason=Reason.OUTLIER)
    if detection.alternative is not None and of_alternative is not None:
        cap = settings.leap_chi2_cap
        log_ratio = detection.log_ratio + (min(by.nis, cap) - min(of_alternative.nis, cap)) / 2
        alternative = (
            detection.alternative.updated(of_alternative) if of_alternative.nis <= most else detection.alternative
        )
        detection = changed(detection, alternative=alternative, log_ratio=log_ratio)
    belief = detection.primary.updated(by) if by.nis <= most else detection.primary
    return changed(state, detection=changed(detection, primary=belief))


def _remember(
    detection: FaultDetection, name: str, stamp_s: float, spread: FloatArray | None, settings: FilterParameters
) -> FaultDetection:
    """Remember the current pose. If the camera measures against it, preintegration of the wheels restarts here."""
    last, preintegration = detection.last, detection.preintegration
    measurement = None if last is None or last.measurement.name != name else last.measurement
    is_known = detection.primary.find_index(name) is not None
    begins = measurement is not None or preintegration is None or preintegration.name == name
    if begins and name != STEP_BEGIN:
        is_current = last is not None and last.stamp_s == stamp_s and detection.agreed > 0
        is_sound = is_known and detection.fault is Fault.NONE
        noise, is_of_start = detection.noise, preintegration is not None and preintegration.name == name
        if measurement is not None and preintegration is not None and is_of_start and is_current and is_sound:
            # A measurement against the start of the preintegration updates the wheels' noise.
            rolled = detection.odometer.since(preintegration.begin)
            if preintegration.is_covered(rolled, stamp_s, settings.wheel_noise_covered_share):
                noise = noise.after(preintegration, rolled, measurement, detection.primary, settings)
        begin = Preintegration.of(name, stamp_s, detection.odometer, spread, detection.primary)
        detection = changed(detection, noise=noise, preintegration=begin)
    given, alternative = (name, stamp_s, settings.max_clones, spread), detection.alternative
    alternative = None if alternative is None else alternative.cloned(*given)
    return changed(detection, primary=detection.primary.cloned(*given), alternative=alternative)


def _add_yaw_rate(
    state: FusionState, rate_rad_s: float, stamp_s: float, events: Sequence[FilterEvent], settings: FilterParameters
) -> FusionState:
    """Add a reading of the gyroscope, the mean rate since the one before.

    The part before the state's stamp updates the state. The rest is integrated until the wheels cover that time, and
    the state keeps its stamp.
    """
    detection, before_s = changed(state.detection, nis=None), state.detection.gyro_s
    state = changed(state, reason=None)
    if before_s is None or not 0 < stamp_s - before_s <= settings.coast_after_s:
        detection = changed(detection, gyro_s=stamp_s, gyro_rad=0.0, gyro_sum_s=0.0)
        added = changed(state, detection=detection)
        return added if state.stamp_s is not None else moved_to(added, stamp_s, events, settings)
    if state.stamp_s is not None and before_s < state.stamp_s <= stamp_s:
        detection = _update_turn(_integrate(detection, rate_rad_s, state.stamp_s), state.stamp_s, settings)
    detection = detection if detection.gyro_s == stamp_s else _integrate(detection, rate_rad_s, stamp_s)
    added = changed(state, detection=detection)
    if detection.gyro_sum_s < settings.gyro_mean_s - _SAME_S:
        return added
    if _steps_between(stamp_s, stamp_s, events):  # a wheel step covers the stamp
        return added
    now = moved_to(added, stamp_s, events, settings)
    detection = faults.end_undecided(now.detection, stamp_s, settings)
    return changed(now, detection=_update_turn(detection, stamp_s, settings))


def _integrate(detection: FaultDetection, rate_rad_s: float, stamp_s: float) -> FaultDetection:
    """Integrate a yaw rate up to a stamp."""
    assert detection.gyro_s is not None
    seconds = stamp_s - detection.gyro_s
    turn_rad = rate_rad_s * seconds
    odometer = detection.odometer.turned(turn_rad - detection.primary.gyro_bias_rad_s * seconds, seconds)
    sums = {"gyro_rad": detection.gyro_rad + turn_rad, "gyro_sum_s": detection.gyro_sum_s + seconds}
    return changed(detection, odometer=odometer, gyro_s=stamp_s, **sums)


def _update_turn_until(
    detection: FaultDetection, gyro_s: float, stamp_s: float, settings: FilterParameters
) -> FaultDetection:
    """Update by the gyroscope if its readings up to `gyro_s` cover most of the time up to a stamp, as if all of it."""
    seconds = stamp_s - gyro_s + detection.gyro_sum_s
    if not detection.gyro_sum_s > settings.gyro_covered_share * seconds:
        return detection
    return changed(_update_turn(detection, stamp_s, settings), gyro_s=stamp_s)


def _update_turn(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """Update by the gyroscope's mean rate since the last such update, if there is any."""
    seconds = detection.gyro_sum_s
    if not seconds > 0:
        return detection
    rate_rad_s, variance = detection.gyro_rad / seconds, settings.gyro.noise_rad_per_sqrt_s**2 / seconds
    most = faults.gate_of((1 - settings.confidence) * min(seconds / settings.gyro_test_s, 1.0))

    def turned(belief: PoseBelief) -> tuple[PoseBelief, float]:
        by = belief.yaw_rate(rate_rad_s, variance)
        if by.nis <= most:
            return belief.updated(by).turn_known(), by.nis
        freed = belief.turn_slipped(settings)
        return freed.updated(freed.yaw_rate(rate_rad_s, variance)).turn_known(), by.nis

    belief, nis = turned(detection.primary)
    alternative = None if detection.alternative is None else turned(detection.alternative)[0]
    now = changed(detection, primary=belief, alternative=alternative, nis=(nis, 1), gyro_rad=0.0, gyro_sum_s=0.0)
    return changed(now, turn_slip_s=stamp_s) if nis > most else now


def _each(detection: FaultDetection, change: Callable[[PoseBelief], PoseBelief]) -> FaultDetection:
    """Apply a change to the beliefs of all hypotheses."""
    return changed(
        detection,
        primary=change(detection.primary),
        alternative=None if detection.alternative is None else change(detection.alternative),
    )


class Dated(Protocol):
    """An event at `stamp_s`, which changes states from `since_s` on; at equal stamps, lower `rank` first."""

    @property
    def stamp_s(self) -> float:
        """Time of the event."""

    @property
    def since_s(self) -> float:
        """Time from which on it changes states."""

    @property
    def rank(self) -> int:
        """Order among events at the same stamp."""


Event = TypeVar("Event", bound=Dated)
State = TypeVar("State")
_LAST_RANK = 1 << 30
# How far back states are kept for a correction of the past, and how often, seconds.
_KEPT_FOR_S, _KEPT_EVERY_S = 20.0, 1.0
# Events before and after an event that can matter to it: wheel steps that cover its time.
_NEAR_EVENTS = 100


class History(Generic[Event, State]):
    """Events within a window, in the order of their stamps, and the state after each.

    After a delayed event, the states of all later ones are computed again. Older events are archived, with a state a
    second, for a correction of the past (`repeat`).

    Args:
        begin: the state before all events.
        window_s: how far `since_s` of an event may be behind the newest event.
        apply: returns the state after an event, from the state before it, the event, and all known events.

    Attributes:
        newest: state after the last event.
        events: all known events within the window, in order.
    """

    def __init__(self, begin: State, window_s: float, apply: Callable[[State, Event, Sequence[Event]], State]) -> None:
        self.newest: State = begin
        self.events: list[Event] = []
        self._begin, self._window_s, self._apply = begin, window_s, apply
        self._keys: list[tuple[float, int]] = []
        self._states: list[State] = []
        self._archive: deque[Event] = deque()
        self._archived = 0  # number of all events that were archived, also of those that are gone
        # Stamp, number of events archived by then, state.
        self._kept: deque[tuple[float, int, State]] = deque([(-math.inf, 0, begin)])

    def __len__(self) -> int:
        return len(self.events)

    def repeat(self, since_s: float, change: Callable[[Event], Event]) -> bool:
        """Apply a change to all events since a stamp, and compute their states again.

        Begins at the last state kept up to the stamp. Returns False, and does nothing, if none is kept.
        """
        if self._kept[0][0] > since_s:
            return False
        while self._kept[-1][0] > since_s:
            self._kept.pop()
        _, count, state = self._kept[-1]
        first = len(self._archive) - (self._archived - count)
        events = [*self._archive]
        events[first:] = map(change, events[first:])
        self._archive = deque(events)
        self.events = list(map(change, self.events))
        events += self.events
        for place in range(first, len(self._archive)):
            event = events[place]
            state = self._apply(state, event, events[max(place - _NEAR_EVENTS, 0) : place + _NEAR_EVENTS])
            self._keep(event.stamp_s, count + place + 1 - first, state)
        self._begin, self._states = state, []
        for event in self.events:
            state = self._apply(state, event, events[-len(self.events) - _NEAR_EVENTS :])
            self._states.append(state)
        self.newest = state
        return True

    def _keep(self, stamp_s: float, count: int, state: State) -> None:
        if stamp_s - self._kept[-1][0] >= _KEPT_EVERY_S:
            self._kept.append((stamp_s, count, state))

    def known_at(self, stamp_s: float) -> State:
        """Return the state after the last event up to a stamp; the oldest state for a stamp before the window."""
        place = bisect_right(self._keys, (stamp_s, _LAST_RANK))
        return self._states[place - 1] if place else self._begin

    def take(self, event: Event) -> State | None:
        """Add an event; return the state right after it. States that follow are computed again.

        None if the event would change states before the window; then it has no effect.
        """
        since_s = event.since_s
        if self._keys and since_s < self._keys[-1][0] - self._window_s:
            return None
        key = (event.stamp_s, event.rank)
        place = bisect_right(self._keys, key)
        first = min(place, bisect_right(self._keys, (since_s, _LAST_RANK)))
        self._keys.insert(place, key)
        self.events.insert(place, event)
        del self._states[first:]
        state = self._states[-1] if first else self._begin
        for again in self.events[first:]:
            state = self._apply(state, again, self.events)
            self._states.append(state)
        self.newest, state = state, self._states[place]
        passed = bisect_left(self._keys, (self._keys[-1][0] - self._window_s, -1))
        if passed:
            self._begin = self._states[passed - 1]
            for event, kept in zip(self.events[:passed], self._states[:passed], strict=True):
                self._archive.append(event)
                self._archived += 1
                self._keep(event.stamp_s, self._archived, kept)
            while len(self._kept) > 1 and self._kept[1][0] < self._keys[0][0] - _KEPT_FOR_S:
                self._kept.popleft()
            while len(self._archive) > self._archived - self._kept[0][1]:
                self._archive.popleft()
            del self._keys[:passed], self.events[:passed], self._states[:passed]
        return state
