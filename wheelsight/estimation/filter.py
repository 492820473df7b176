"""ErrorStateFilter: an error-state Kalman filter on SE(3) for wheels, camera, gyroscope and areas. A history sorts
delayed events by their stamps.
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
from wheelsight.core.estimates import FrameUpdate, FusedEstimate, MotionEstimate, Reason, Status, Step, WheelEstimate
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

# ErrorStateFilter: wheels, camera, gyroscope and places joined into one pose that says how far to trust it.
#
# An error-state Kalman filter on SE(3) with perturbations from the left (`_pose_belief`). Its state is the base's
# pose, its twist, what is wrong with the wheels, the gyroscope's bias, and remembered past poses (stochastic cloning,
# Roumeliotis & Burdick, ICRA 2002), against which the camera's relative motions are measurements.
#
# - The twist is planar (vx, vy, ωz in the base's frame): that is what wheels and gyroscope tell, and on a ramp it is
# the pose that is tilted, not the twist. It carries the pose on while no wheel tells, and is what a gyroscope
# measures. - The wheels' errors (scale of ways, turn a metre, scale of turns) are in the state because they are no
# noise: radii 2 % wrong stay 2 % wrong, and the camera tells them. - The floor is level only softly: height, roll and
# pitch wander with the way; roll and pitch are drawn back to level. - Directions that the camera does not see are no
# part of its measurement. - Whom to believe when sensors contradict each other: `_fault_detection`.
#
# Events may come late and in any order, within a window: what followed is then taken again (`_history`), and the
# outcome is that of the events in order. The same events give the same answer to the last bit.


# Poses that are remembered: of the camera's last frame, of the one that its motions are told against, and of one that
# is asked for; those of keyframes are named by their numbers.
FRAME, REFERENCE, _IMAGED = "frame", "reference", "imaged"
# Beside keyframes, so many are remembered: those, and the begin of a step.
_OTHERS = 4


class ErrorStateFilter:
    """The default filter; see the module. Each event is answered with the estimate right after it.

    An event that is refused moves nothing: the answer is that of the newest event, and `reason` says why. Numbers that
    are no motion (`INVALID`) and events from before the window (`TOO_LATE`) are refused so; what the gates refuse has
    `CONTRADICTION` or `OUTLIER`. Stamps are believed: whether a clock leaps is for a `SessionClock` to say.

    Args:
        T_base_camera: (4, 4), or None where no camera is used.
        T_odom_base: (4, 4) at the first event; None for the identity, in a frame `odom` with z up.
        covariance: (6, 6) of its left perturbation; None for zero.
        settings: see there.
        gyro: what its yaw rates are worth; None for the defaults of `Gyro`.

    Raises:
        ConfigError: a motion or covariance that is none.
        ArgumentError: of its methods: a stamp or rate that is no number.
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
            raise ConfigError("a pose at the start, its covariance or T_base_camera is none", fix="(4, 4) and (6, 6)")
        self._mount = Mount(T_base_camera)
        state = FusionState(FaultDetection(PoseBelief.begin(begin, spread, self._parameters)))
        self._history: History[FilterEvent, FusionState] = History(state, self._parameters.window_s, self._after)
        self._waiting: Step | None = None  # of the wheels, too short to tell a speed
        self._kept: list[str] = []  # frames, from the last of which the way there is settled
        self._kept_ever = 0
        self._reading_stamps_s: deque[float] = deque(maxlen=self._parameters.rate_readings)
        # The last state that was asked what to expect, and as it is by then: what is expected mostly comes.
        self._moved: tuple[FusionState, FusionState] | None = None

    @property
    def state(self) -> FusionState:
        """All that it believes at the newest event; the next one makes another."""
        return self._history.newest

    def begun_at(self, T_odom_base: ArrayLike, covariance: ArrayLike) -> ErrorStateFilter:
        """Another one of the same sensors, that knows nothing yet but where it begins. Raises ConfigError."""
        return ErrorStateFilter(self._mount.T_base_camera, T_odom_base, covariance, self.settings, self.gyro)

    def predict(self, stamp_s: float, T_prev_now: ArrayLike, covariance: ArrayLike, begin_s: float) -> FusedEstimate:
        """Take a step of the wheels, from `begin_s` to `stamp_s`.

        Args:
            T_prev_now: (4, 4) the base at its end, in the frame of the base at its begin; `WheelEstimate.step` has it
                as `T_before_now`, beside its covariance and `begin_s`.
            covariance: (6, 6) of its left perturbation, by the wheels' model.
        """
        T, Q, begin_s = motion_of(T_prev_now), covariance_of(covariance, 6), need_number("begin_s", begin_s)
        if T is None or Q is None or not (np.isfinite(begin_s) and begin_s < need_number("stamp_s", stamp_s)):
            return self._refused(Reason.INVALID)
        return self._take(FilterEvent(stamp_s, wheels=WheelStep(begin_s, stamp_s, motions.log(T), Q)))

    def predict_to(self, wheels: WheelEstimate) -> FusedEstimate:
        """Take the next estimate of wheel odometry, in order; the first is the start, whatever step it tells."""
        step, begins = wheels.step, not self._reading_stamps_s
        told = (wheels.T_odom_body, wheels.covariance) if step is None else (step.T_before_now, step.covariance)
        if wheels.reason is Reason.CLOCK_BACKWARDS or not is_pose(*told):
            return self._refused(wheels.reason or Reason.INVALID)
        self._reading_stamps_s.append(wheels.stamp_s)
        if begins or step is None or wheels.reason is not None:
            # It begins the clock, or tells no way: the pose goes on as if none had come.
            self._waiting = None
            return self._take(FilterEvent(wheels.stamp_s, drop=""), reason=wheels.reason)
        step = step if self._waiting is None else self._waiting.then(step)
        if not step.begin_s < step.end_s:
            return self._refused(Reason.INVALID)
        if step.end_s - step.begin_s < self._shortest_step_s():
            self._waiting = step  # its way counts with the next reading's
            return self._take(FilterEvent(wheels.stamp_s, drop=""))
        self._waiting = None
        xi, spread = motions.log(step.T_before_now), step.covariance
        if step.end_s - step.begin_s > self.settings.even_s:
            spread = spread + of_unknown_path(xi, self.settings.swing_rad)
        return self._take(FilterEvent(step.end_s, wheels=WheelStep(step.begin_s, step.end_s, xi, spread)))

    def _shortest_step_s(self) -> float:
        """Over less no speed is formed: readings that arrive together have stamps that tell of no time between them.

        Wheels tell ways, and a count is right whenever it arrives; half of what readings take on average is enough.
        """
        stamps_s = self._reading_stamps_s
        return 0.5 * (stamps_s[-1] - stamps_s[0]) / (len(stamps_s) - 1) if len(stamps_s) > 2 else 0.0

    def clone(self, stamp_s: float, name: str, covariance: ArrayLike | None = None) -> FusedEstimate:
        """Remember the pose at a stamp as `name`, for later measurements; one of that name before is forgotten.

        Args:
            covariance: (6, 6) of the camera's left perturbation in its own frame, by which camera odometry has it
                elsewhere: an error that all later measurements against it share. None for none.
        """
        if covariance is None:
            return self._take(FilterEvent(stamp_s, clone=name))
        spread = covariance_of(covariance, 6)
        if spread is None:
            return self._refused(Reason.INVALID)
        return self._take(FilterEvent(stamp_s, clone=name, spread=self._mount.spread(spread)))

    def drop(self, stamp_s: float, name: str) -> FusedEstimate:
        """Forget a remembered pose: it is marginalised."""
        return self._take(FilterEvent(stamp_s, drop=name))

    def update_relative(
        self, stamp_s: float, motion: MotionEstimate, name: str, remember: str | None = None
    ) -> FusedEstimate:
        """Take what the camera saw of its motion since the pose remembered as `name`, or that it saw nothing.

        Args:
            motion: T_reference_current of the camera, with the covariance of its left perturbation; directions named
                `degenerate` are left out.
            remember: as what to remember the pose then, as `clone` would right afterwards.
        """
        measurement = self._mount.measurement(motion, name)
        if isinstance(measurement, Reason):
            return self._take(FilterEvent(stamp_s, failure=measurement, clone=remember), motion)
        return self._take(FilterEvent(stamp_s, measurement=measurement, clone=remember), motion)

    def begin_frame(self, stamp_s: float, covariance: ArrayLike) -> FrameUpdate:
        """Remember the pose at a frame at which the camera begins, as its last frame and as its reference.

        Args:
            covariance: (6, 6) of the camera's left perturbation, in its own frame; see `clone`.
        """
        answer = self.clone(stamp_s, FRAME)
        T_odom_base = self.remembered(FRAME)
        self.clone(stamp_s, REFERENCE, covariance)
        return FrameUpdate(answer, T_odom_base, is_reference=True)

    def update_frame(
        self, stamp_s: float, motion: MotionEstimate, covariance: ArrayLike, *, is_far: bool
    ) -> FrameUpdate:
        """Take what the camera saw of its motion since the reference, and remember the pose as that of the last frame.

        It is the next reference if it is far from the one before, or was not believed: one mistake of the camera is
        none of the next frame's, and slip is told by contradicting again and again.

        Args:
            motion: T_reference_current of the camera, with the covariance of its left perturbation.
            covariance: as `begin_frame` takes it, for the case that it is.
        """
        answer = self.update_relative(stamp_s, motion, REFERENCE, remember=FRAME)
        T_odom_base, is_reference = self.remembered(FRAME), is_far or answer.reason is not None or answer.doubtful
        if is_reference:
            self.clone(stamp_s, REFERENCE, covariance)
        return FrameUpdate(answer, T_odom_base, is_reference)

    def miss_frame(self, stamp_s: float, motion: MotionEstimate) -> FusedEstimate:
        """Take a frame that gave no motion, whose `motion` says why."""
        return self.update_relative(stamp_s, motion, REFERENCE)

    def keep_frame(self, stamp_s: float) -> tuple[FloatArray, FloatArray] | None:
        """Remember the pose at a frame as that of a keyframe; how the camera went there from the one before.

        (4, 4), and the covariance (6, 6) of its left perturbation, by all that is known now; None at the first.
        """
        motion = self.expect(stamp_s, self._kept[-1]) if self._kept else None
        self._kept.append(f"keyframe {self._kept_ever}")
        self._kept_ever += 1
        self.clone(stamp_s, self._kept[-1])
        return motion

    def settled_motions(self) -> list[tuple[FloatArray, FloatArray] | None] | None:
        """As `keep_frame`, of all kept frames since this told any, by what is known now; they are told once.

        None while two hypotheses go on, and there is room to remember where each has the frames: what is known of the
        way meanwhile lies between both.
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
        """T_last_current (4, 4) of the camera since the last frame, to be expected at a stamp; None where none was."""
        expected = self.expect(stamp_s, FRAME)
        return None if expected is None else expected[0]

    def spread_since_frame_m(self, stamp_s: float) -> float | None:
        """σ of how far the base has gone in the plane since the last frame, metres; None where none is remembered."""
        expected = self.expect(stamp_s, FRAME)
        if expected is None:
            return None
        T_camera_base = se3.invert(self._mount.T_base_camera)
        T = self._mount.T_base_camera @ expected[0] @ T_camera_base
        Ad = se3.adjoint(self._mount.T_base_camera)
        return float(np.sqrt(np.trace(se3.position_covariance(T, Ad @ expected[1] @ Ad.T)[:2, :2])))

    def when_imaged(self, stamp_s: float) -> FloatArray:
        """T_odom_base (4, 4) when the image of a stamp was taken: it may have come late, by its stamp and beside it."""
        self.clone(stamp_s, _IMAGED)
        T_odom_base = self.remembered(_IMAGED)
        assert T_odom_base is not None
        return T_odom_base

    def last_frame(self) -> FloatArray | None:
        """T_odom_base (4, 4) when the last frame was imaged, by all that is known now; None where there is none."""
        return self.remembered(FRAME)

    def update_position(self, stamp_s: float, xy: ArrayLike, covariance: ArrayLike) -> FusedEstimate:
        """Take a position (2,) in the map, metres, with its covariance (2, 2), as places tell."""
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
        """Take a gyroscope's yaw rate, counter-clockwise from above, the mean since its last one.

        Wheels must then be reckoned without it. Measured by is the mean over a step of theirs, or 0.05 s.
        """
        if not np.isfinite(need_number("yaw_rate_rad_s", yaw_rate_rad_s)):
            return self._refused(Reason.INVALID)
        return self._take(FilterEvent(stamp_s, yaw_rate_rad_s=float(yaw_rate_rad_s) - self._parameters.gyro.bias_rad_s))

    def update_gyro_bias(self, stamp_s: float, bias_rad_s: float, sigma_rad_s: float) -> FusedEstimate:
        """Take what the gyroscope shows at rest, and its standard deviation, where they were found elsewhere.

        The finder started from what the settings believe of it, which counts once.
        """
        first, told = self._parameters.gyro.bias_sigma_rad_s**2, sigma_rad_s**2
        if not (np.isfinite(bias_rad_s) and 0 < told < first):
            return self._refused(Reason.INVALID)
        more = first / (first - told)
        bias = (more * (bias_rad_s - self._parameters.gyro.bias_rad_s), more * told)
        return self._take(FilterEvent(stamp_s, gyro_bias=bias))

    def remembered(self, name: str) -> FloatArray | None:
        """T_odom_base (4, 4) at the instant remembered as `name`, by all that is known now; None where none is.

        The camera's instant: when the image was taken that has the stamp, by what is known of how late its stamps are.
        """
        belief = self._history.newest.detection.answer(self._parameters)
        return belief.T[belief.reference(name)].copy() if name in belief.names else None

    @property
    def estimate(self) -> FusedEstimate:
        """As of the newest event."""
        newest = self._history.newest
        return self._answer(newest.reason, newest.detection.nis)

    def expect(self, stamp_s: float, name: str) -> tuple[FloatArray, FloatArray] | None:
        """T_reference_current (4, 4) of the camera that is to be expected, and its covariance (6, 6).

        By what is known up to the stamp; None where `name` is not remembered. Where vision
        sees a direction not at all, this is what stands there.
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
        except np.linalg.LinAlgError:  # numbers beyond what can be solved for
            return _gone_astray(state, event, self._parameters)
        return then if _is_finite(then) else _gone_astray(state, event, self._parameters)

    def _take(
        self, event: FilterEvent, motion: MotionEstimate | None = None, reason: Reason | None = None
    ) -> FusedEstimate:
        if not np.isfinite(need_number("stamp_s", event.stamp_s)):
            return self._refused(Reason.INVALID)
        if self._history.is_too_late(event):
            return self._refused(Reason.TOO_LATE)
        if event.wheels is not None:
            self._moved = None  # they may tell of that time
        state = self._history.take(event)
        counts = (0, 0) if motion is None else (motion.matches, motion.inliers)
        return self._answer(reason or state.reason, state.detection.nis, counts)

    def _refused(self, reason: Reason) -> FusedEstimate:
        return self._answer(reason, self._history.newest.detection.nis)

    def _answer(
        self, reason: Reason | None, nis: tuple[float, int] | None, counts: tuple[int, int] = (0, 0)
    ) -> FusedEstimate:
        """What is known after the newest event, and what came of the one that is answered."""
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
        if state.is_lost or (status is Status.TRACKING and not _has_meaning(T, C, s)):
            return FusedEstimate(state.stamp_s, Status.LOST, None, None, reason, "base", *counts, *flags, nis=nis)
        pose, twist = (T, C, reason, "base", *counts), (moving[0], moving[1])
        return FusedEstimate(state.stamp_s, status, *pose, *flags, *twist, nis=nis, wheel_errors=belief.wheel_errors)


def _is_finite(state: FusionState) -> bool:
    detection = state.detection
    beliefs = (detection.primary,) if detection.alternative is None else (detection.primary, detection.alternative)
    return all(bool(np.isfinite(b.T).all() and np.isfinite(b.covariance).all()) for b in beliefs)


def _gone_astray(before: FusionState, event: FilterEvent, settings: FilterParameters) -> FusionState:
    """The state after an event whose numbers cannot be reckoned with: that before it, lost."""
    belief = before.detection.primary.scattered(settings)
    scattered = changed(before.detection, primary=belief, alternative=None, fault=Fault.NONE, nis=None)
    stamp_s = event.stamp_s if before.stamp_s is None else max(before.stamp_s, event.stamp_s)
    return changed(before, detection=scattered, stamp_s=stamp_s, is_lost=True, reason=Reason.INVALID)


def _has_meaning(T: FloatArray, covariance: FloatArray, settings: ErrorStateSettings) -> bool:
    """Whether the covariance (6, 6) of a pose's left perturbation still says where it is."""
    of_position, of_rotation = np.diag(se3.position_covariance(T, covariance)), np.diag(covariance)[3:]
    most_rad2, most_m2 = settings.largest_sigma_rad**2, settings.largest_sigma_m**2
    return bool((of_rotation < most_rad2).all() and (of_position < most_m2).all())


# History: events in the order of their stamps, whatever order they came in, and the state after each.


class Dated(Protocol):
    """Something that happened: at `stamp_s`, changing states from `since_s` on; at one stamp, lower `rank` first."""

    @property
    def stamp_s(self) -> float:
        """When it is taken."""

    @property
    def since_s(self) -> float:
        """From when on it matters."""

    @property
    def rank(self) -> int:
        """Its place among events at the same stamp."""


Event = TypeVar("Event", bound=Dated)
State = TypeVar("State")
_LAST_RANK = 1 << 30


class History(Generic[Event, State]):
    """States that do not change, one an event, within a window; after an event that comes late others are taken again.

    Args:
        begin: the state before all events.
        window_s: how far behind the newest event one may begin to matter.
        apply: the state after an event, of the state before it and all events that are known.
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
        """The state after the last event."""
        return self._states[-1] if self._states else self._begin

    def known_at(self, stamp_s: float) -> State:
        """The state after the last event up to a stamp; of one before the window, the oldest."""
        place = bisect_right(self._keys, (stamp_s, _LAST_RANK))
        return self._states[place - 1] if place else self._begin

    @property
    def newest_s(self) -> float | None:
        """The stamp of the last event."""
        return self._keys[-1][0] if self._keys else None

    @property
    def events(self) -> Sequence[Event]:
        """All that are known, in order."""
        return self._events

    def is_too_late(self, event: Event) -> bool:
        """Whether the event would matter from before the window on."""
        return bool(self._keys) and event.since_s < self._keys[-1][0] - self._window_s

    def take(self, event: Event) -> State:
        """The state right after an event that is not too late; all that follow it are taken again."""
        key = (event.stamp_s, event.rank)
        place = bisect_right(self._keys, key)
        first = min(place, bisect_right(self._keys, (event.since_s, _LAST_RANK)))
        self._keys.insert(place, key)
        self._events.insert(place, event)
        del self._states[first:]
        for again in self._events[first:]:
            self._states.append(self._apply(self.newest, again, self._events))
        state = self._states[place]
        self._forget()
        return state

    def _forget(self) -> None:
        passed = bisect_left(self._keys, (self._keys[-1][0] - self._window_s, -1))
        if passed:
            self._begin = self._states[passed - 1]
            del self._keys[:passed], self._events[:passed], self._states[:passed]
