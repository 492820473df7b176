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
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration_parts import Gyro
from wheelsight.core.checks import need_number
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import (
    FrameUpdate,
    FusedEstimate,
    MotionEstimate,
    MotionStep,
    Reason,
    Status,
    WheelEstimate,
)
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.settings.fusion import ErrorStateSettings, FilterParameters
from wheelsight.estimation.fault_detection import Fault, FaultDetection
from wheelsight.estimation.filter_kernels import answered
from wheelsight.estimation.filter_state import FilterEvent, FusionState, after, moved_to
from wheelsight.estimation.pose_belief import (
    Mount,
    PoseBelief,
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


class ErrorStateFilter:
    """The default filter; see the module. Each method returns the estimate right after the event.

    A rejected event has no effect: the estimate is that of the newest event, and `reason` says why. Invalid motions
    (`INVALID`) and events before the window (`TOO_LATE`) are rejected. Measurements outside the gates have the reason
    `CONTRADICTION` or `OUTLIER`. The filter trusts stamps; a `SessionClock` detects jumps of clocks.

    Args:
        T_base_camera: (4, 4), or None without a camera.
        T_odom_base: (4, 4) at the first event; None for the identity, in a frame `odom` with z up.
        covariance: (6, 6) of its left perturbation; None for zero.
        settings: of the filter; None for the defaults.
        gyro: noise of the gyroscope; None for the defaults of `Gyro`.

    Raises:
        ConfigError: an invalid motion or covariance.
        ArgumentError: in its methods, a stamp or rate that is not a number.
    """

    def __init__(
        self,
        T_base_camera: ArrayLike | None = None,
        T_odom_base: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        settings: ErrorStateSettings | None = None,
        gyro: Gyro | None = None,
    ) -> None:
        self.settings = settings or ErrorStateSettings()
        self.gyro = gyro or Gyro()
        self._parameters = FilterParameters.of(self.settings, self.gyro)
        begin = np.eye(4) if T_odom_base is None else motion_of(T_odom_base)
        spread = np.zeros((6, 6)) if covariance is None else covariance_of(covariance, 6)
        T_base_camera = np.eye(4) if T_base_camera is None else motion_of(T_base_camera)
        if begin is None or spread is None or T_base_camera is None:
            raise ConfigError("the start pose, its covariance or T_base_camera is invalid", fix="(4, 4) and (6, 6)")
        self._mount = Mount(T_base_camera)
        state = FusionState(FaultDetection(PoseBelief.begin(begin, spread, self._parameters)))
        self._history: History[FilterEvent, FusionState] = History(state, self._parameters.window_s, self._after)
        self._waiting: MotionStep | None = None  # wheel step that is too short for a velocity
        self._kept: list[str] = []  # names of keyframes whose motions are not settled
        self._kept_ever = 0
        self._reading_stamps_s: deque[float] = deque(maxlen=self._parameters.rate_readings)
        # The state of the last prediction, and that prediction: the predicted frame usually follows.
        self._moved: tuple[FusionState, FusionState] | None = None

    @property
    def state(self) -> FusionState:
        """State after the newest event; immutable."""
        return self._history.newest

    def begun_at(self, T_odom_base: ArrayLike, covariance: ArrayLike) -> ErrorStateFilter:
        """Return a new filter of the same sensors that starts at a pose. Raises ConfigError."""
        return ErrorStateFilter(self._mount.T_base_camera, T_odom_base, covariance, self.settings, self.gyro)

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
        if step.end_s - step.begin_s > self.settings.even_s:
            spread = spread + of_unknown_path(xi, self.settings.swing_rad)
        return self._take(FilterEvent(step.end_s, wheels=WheelStep(step.begin_s, step.end_s, xi, spread)))

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
        T_odom_base = self.remembered(FRAME)
        self.clone(stamp_s, REFERENCE, covariance)
        return FrameUpdate(answer, T_odom_base, is_reference=True)

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
        T_odom_base, is_reference = self.remembered(FRAME), is_far or answer.reason is not None or answer.doubtful
        if is_reference:
            self.clone(stamp_s, REFERENCE, covariance)
        return FrameUpdate(answer, T_odom_base, is_reference)

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

    def settled_motions(self) -> list[tuple[FloatArray, FloatArray] | None] | None:
        """Return the motions of `keep_frame` by the current state, for all kept frames since the last call.

        None while the filter has two hypotheses and enough room to remember the frames. Until a decision, estimates of
        the motions lie between both hypotheses.
        """
        detection = self._history.newest.detection
        if detection.alternative is not None and len(self._kept) + _OTHERS < self.settings.max_clones:
            return None
        belief, at = detection.answer(self._parameters), self._mount.T_base_camera
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
        """Return T_odom_base (4, 4) when the image with a stamp was taken; the camera's stamps are delayed."""
        self.clone(stamp_s, _IMAGED)
        T_odom_base = self.remembered(_IMAGED)
        assert T_odom_base is not None
        return T_odom_base

    def last_frame(self) -> FloatArray | None:
        """Return the current estimate of T_odom_base (4, 4) at the last frame; None without one."""
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
        return self._take(FilterEvent(stamp_s, yaw_rate_rad_s=float(yaw_rate_rad_s) - self._parameters.gyro.bias_rad_s))

    def update_gyro_bias(self, stamp_s: float, bias_rad_s: float, sigma_rad_s: float) -> FusedEstimate:
        """Update by an external estimate of the gyroscope's bias, and its standard deviation.

        That estimate started from the prior of the settings, which must not count twice: its information is removed.
        """
        prior, variance = self._parameters.gyro.bias_sigma_rad_s**2, sigma_rad_s**2
        if not (np.isfinite(bias_rad_s) and 0 < variance < prior):
            return self._refused(Reason.INVALID)
        more = prior / (prior - variance)
        bias = (more * (bias_rad_s - self._parameters.gyro.bias_rad_s), more * variance)
        return self._take(FilterEvent(stamp_s, gyro_bias=bias))

    def remembered(self, name: str) -> FloatArray | None:
        """Return the current estimate of T_odom_base (4, 4) remembered as `name`; None if there is none.

        The time of the pose is when the image with that stamp was taken, by the estimated delay of stamps.
        """
        belief = self._history.newest.detection.answer(self._parameters)
        return belief.T[belief.reference(name)].copy() if name in belief.names else None

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
        if name not in known.detection.primary.names:
            return None
        late = known.stamp_s is not None and stamp_s < known.stamp_s
        then = known if late else moved_to(known, stamp_s, self._history.events, self._parameters)
        self._moved = known, then
        return then.detection.answer(self._parameters).seen_from(name, self._mount.T_base_camera)

    def _after(self, state: FusionState, event: FilterEvent, events: Sequence[FilterEvent]) -> FusionState:
        if self._moved is not None and self._moved[0] is state and self._moved[1].stamp_s == event.stamp_s:
            state = self._moved[1]
        try:
            then = after(state, event, events, self._parameters)
        except np.linalg.LinAlgError:
            return _diverged(state, event, self._parameters)
        detection = then.detection
        beliefs = (detection.primary,) if detection.alternative is None else (detection.primary, detection.alternative)
        is_finite = all(bool(np.isfinite(b.T).all() and np.isfinite(b.covariance).all()) for b in beliefs)
        return then if is_finite else _diverged(state, event, self._parameters)

    def _take(
        self, event: FilterEvent, motion: MotionEstimate | None = None, reason: Reason | None = None
    ) -> FusedEstimate:
        if not np.isfinite(need_number("stamp_s", event.stamp_s)):
            return self._refused(Reason.INVALID)
        if self._history.is_too_late(event):
            return self._refused(Reason.TOO_LATE)
        if event.wheels is not None:
            self._moved = None  # the step may cover that time
        state = self._history.take(event)
        counts = (0, 0) if motion is None else (motion.matches, motion.inliers)
        return self._answer(reason or state.reason, state.detection.nis, counts)

    def _refused(self, reason: Reason) -> FusedEstimate:
        return self._answer(reason, self._history.newest.detection.nis)

    def _answer(
        self, reason: Reason | None, nis: tuple[float, int] | None, counts: tuple[int, int] = (0, 0)
    ) -> FusedEstimate:
        """Return the estimate after the newest event, with reason, NIS and counts of the current one."""
        state, s = self._history.newest, self._parameters
        if state.stamp_s is None:
            return FusedEstimate(-np.inf, Status.INITIALIZING, reason=reason, body="base")
        detection = state.detection
        turns_off = state.stamp_s - detection.turn_slip_s <= s.coast_after_s
        flags = (
            detection.fault is Fault.WHEEL_SLIP or turns_off,
            state.is_degenerate,
            detection.fault is Fault.UNDECIDED,
        )
        belief = detection.answer(self._parameters)
        T, C, *moving = answered(belief.T, belief.rest, belief.covariance, s.clock_sigma_s)
        status = Status.TRACKING if state.stamp_s - state.vision_s <= s.coast_after_s else Status.COASTING
        if state.is_lost or (status is Status.TRACKING and not _is_known(T, C, s)):
            return FusedEstimate(state.stamp_s, Status.LOST, None, None, reason, "base", *counts, *flags, nis=nis)
        pose, twist = (T, C, reason, "base", *counts), (moving[0], moving[1])
        return FusedEstimate(state.stamp_s, status, *pose, *flags, *twist, nis=nis, wheel_errors=belief.wheel_errors)


def _diverged(before: FusionState, event: FilterEvent, settings: FilterParameters) -> FusionState:
    """Return the state after an event that makes the filter diverge: the state before it, lost."""
    belief = before.detection.primary.scattered(settings)
    scattered = changed(before.detection, primary=belief, alternative=None, fault=Fault.NONE, nis=None)
    stamp_s = event.stamp_s if before.stamp_s is None else max(before.stamp_s, event.stamp_s)
    return changed(before, detection=scattered, stamp_s=stamp_s, is_lost=True, reason=Reason.INVALID)


def _is_known(T: FloatArray, covariance: FloatArray, settings: ErrorStateSettings) -> bool:
    """Whether the covariance (6, 6) of a pose's left perturbation is within the limits of a known pose."""
    of_position, of_rotation = np.diag(se3.position_covariance(T, covariance)), np.diag(covariance)[3:]
    most_rad2, most_m2 = settings.largest_sigma_rad**2, settings.largest_sigma_m**2
    return bool((of_rotation < most_rad2).all() and (of_position < most_m2).all())


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


class History(Generic[Event, State]):
    """Events within a window, in the order of their stamps, and the state after each.

    After a delayed event, the states of all later ones are computed again.

    Args:
        begin: the state before all events.
        window_s: how far `since_s` of an event may be behind the newest event.
        apply: returns the state after an event, from the state before it, the event, and all known events.
    """

    def __init__(self, begin: State, window_s: float, apply: Callable[[State, Event, Sequence[Event]], State]) -> None:
        self._begin, self._window_s, self._apply = begin, window_s, apply
        self._events: list[Event] = []
        self._keys: list[tuple[float, int]] = []
        self._states: list[State] = []

    def __len__(self) -> int:
        return len(self._events)

    @property
    def newest(self) -> State:
        """State after the last event."""
        return self._states[-1] if self._states else self._begin

    def known_at(self, stamp_s: float) -> State:
        """Return the state after the last event up to a stamp; the oldest state for a stamp before the window."""
        place = bisect_right(self._keys, (stamp_s, _LAST_RANK))
        return self._states[place - 1] if place else self._begin

    @property
    def events(self) -> Sequence[Event]:
        """All known events, in order."""
        return self._events

    def is_too_late(self, event: Event) -> bool:
        """Whether the event would change states before the window."""
        return bool(self._keys) and event.since_s < self._keys[-1][0] - self._window_s

    def take(self, event: Event) -> State:
        """Add an event that is not too late; return the state right after it. States that follow are computed again."""
        key = (event.stamp_s, event.rank)
        place = bisect_right(self._keys, key)
        first = min(place, bisect_right(self._keys, (event.since_s, _LAST_RANK)))
        self._keys.insert(place, key)
        self._events.insert(place, event)
        del self._states[first:]
        for again in self._events[first:]:
            self._states.append(self._apply(self.newest, again, self._events))
        state = self._states[place]
        passed = bisect_left(self._keys, (self._keys[-1][0] - self._window_s, -1))
        if passed:
            self._begin = self._states[passed - 1]
            del self._keys[:passed], self._events[:passed], self._states[:passed]
        return state
