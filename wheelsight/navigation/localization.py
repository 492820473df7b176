"""Localization as navigation uses it: its interface, the current pose between two estimates, and a short hold of it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import Estimate, FusedEstimate, Status
from wheelsight.core.geometry import FloatArray, se2, se3
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import Event, WheelSpeeds, WheelTicks
from wheelsight.navigation.path_following import MotionState
from wheelsight.navigation.settings import HoldSettings
from wheelsight.wheels import WheelOdometry

Answered = tuple[Event, Estimate | None]
# History of wheel odometry. Estimates of frames arrive within it, unless the localization hangs.
_TRACK_S = 3.0
# Without an estimate for `_COASTING_S`, wheels alone carry the pose, and the robot slows down. It stops after
# `_SILENT_S`, or after `_SILENT_M` of way: 0.5 s including the control period.
_COASTING_S, _SILENT_S, _SILENT_M = 0.2, 0.4, 0.25
# Window of a speed, and the least of it: until the first readings span that, the speed is 0.
_SPEED_S, _LEAST_S = 0.04, 0.01


class Localization(Protocol):
    """Source of the robot's pose, such as `LocalizerInStep` and `LocalizerBeside`."""

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Keyframes with their poses; None for wheels alone."""

    @property
    def recognised(self) -> int | None:
        """Number of recognitions of an earlier map so far; None if there is no recognition."""

    def hear(self, events: Sequence[Event]) -> Sequence[Answered]:
        """Process events in order; return all estimates that are ready, of this and earlier calls, in order.

        Raises what `Localizer.process` raises.
        """

    def close(self) -> None:
        """Stop the worker threads."""


@dataclass(frozen=True, slots=True)
class WheelSpeed:
    """Velocity of the base by its encoders.

    Attributes:
        stamp_s: time of the reading.
        forward_m_s, turn_rad_s: means over a short time until then.
        rolled: metres along the arc and radians since the reading before. Integrated means of speeds would lag behind
            by half of their window.
    """

    stamp_s: float
    forward_m_s: float
    turn_rad_s: float
    rolled: tuple[float, float] = (0.0, 0.0)


class WhereNow:
    """Current pose of the robot: the last estimate, or a slightly earlier one, carried on by wheel odometry.

    Wheels carry it for a limited time and way; `is_silent` becomes true if the localization does not answer by then.

    Args:
        wheels: wheels of the calibration.
        hold: for how long a more certain pose is held; None for the defaults.
    """

    def __init__(self, wheels: Wheels, hold: HoldSettings | None = None) -> None:
        self._wheels, self._hold = WheelOdometry(wheels), hold or HoldSettings()
        self._held: HeldPlace | None = None
        self._track: deque[tuple[float, FloatArray]] = deque()
        self._heard_s = self._answered_s = -math.inf
        self._unanswered_m = 0.0
        self._answer: Estimate | None = None
        self._known_sigma_m = 0.0
        self._unproven_m: float | None = None
        self._speed = WheelSpeed(-math.inf, 0.0, 0.0)

    def roll(self, reading: WheelTicks | WheelSpeeds) -> WheelSpeed | None:
        """Process a wheel reading. Return the speed of the base, or None if the reading gives none."""
        try:
            answer = self._wheels.process(reading)
        except ArgumentError:
            return None
        if answer.reason is not None:
            return None
        T_now = se2.from_parts(*self._wheels.pose)
        way = se2.log(se2.invert(self._track[-1][1]) @ T_now) if self._track else np.zeros(3)
        self._unanswered_m += abs(float(way[0]))
        if self._unproven_m is not None:
            self._unproven_m += abs(float(way[0]))
        self._track.append((answer.stamp_s, T_now))
        while len(self._track) > 2 and self._track[1][0] < answer.stamp_s - _TRACK_S:
            self._track.popleft()
        # A mean over a short time, as stamps jitter, and two may be 0.1 ms apart.
        before = [(then_s, T) for then_s, T in self._track if then_s <= answer.stamp_s - _SPEED_S]
        then_s, T_then = before[-1] if before else self._track[0]
        forward = turn = 0.0
        if answer.stamp_s - then_s >= _LEAST_S:
            speeds = se2.log(np.linalg.inv(T_then) @ T_now) / (answer.stamp_s - then_s)
            forward, turn = float(speeds[0]), float(speeds[2])
        self._speed = WheelSpeed(answer.stamp_s, forward, turn, rolled=(float(way[0]), float(way[2])))
        return self._speed

    def ask(self, stamp_s: float) -> None:
        """Record that the localization got an event with this stamp."""
        self._heard_s = max(self._heard_s, stamp_s)

    def processed(self, stamp_s: float) -> None:
        """Record that the localization has processed an event with this stamp, with or without an estimate."""
        if stamp_s > self._answered_s:
            self._answered_s = stamp_s
            self._unanswered_m = float(np.hypot(*self._since(stamp_s)[:2, 2]))

    @property
    def silent_s(self) -> float:
        """Seconds of events that the localization has not processed; 0 before its first answer."""
        return max(self._heard_s - self._answered_s, 0.0) if math.isfinite(self._answered_s) else 0.0

    @property
    def is_silent(self) -> bool:
        """Whether the localization is silent for longer, or for more way, than wheels may carry the pose."""
        return self.silent_s > _SILENT_S or (self.silent_s > _COASTING_S and self._unanswered_m > _SILENT_M)

    def answer(self, estimate: Estimate, recognised: int | None = None) -> None:
        """Process an estimate.

        Args:
            estimate: of the localization.
            recognised: number of recognitions of an earlier map; None if there is no recognition.
        """
        self._answer = estimate
        if recognised != 0:
            self._unproven_m = None
        elif self._unproven_m is None:
            self._unproven_m = 0.0
        if estimate.status is Status.TRACKING:
            self._known_sigma_m = _sigma_m(estimate)
        if estimate.T_map_body is None or estimate.status in (Status.LOST, Status.FAILING):
            self._held = None
            return
        T_wheels, sigma_m = self._rolled_at(estimate.stamp_s), math.inf
        if estimate.covariance_map is not None:
            sigma_m = _worse_sigma_m(estimate.T_map_body, estimate.covariance_map)
        slips = isinstance(estimate, FusedEstimate) and estimate.slip
        if self._held is None or slips or not self._held.holds(sigma_m, T_wheels, estimate.stamp_s, self._hold):
            self._held = HeldPlace(_planar(estimate.T_map_body), T_wheels, sigma_m, estimate.stamp_s)

    @property
    def estimate(self) -> Estimate | None:
        """Last estimate."""
        return self._answer

    @property
    def speed(self) -> WheelSpeed:
        """Speed by the last wheel reading."""
        return self._speed

    @property
    def status(self) -> Status:
        """Status of the last estimate, or `INITIALIZING` before it.

        Late estimates limit it to `COASTING`, and silence to `FAILING`.
        """
        if self._answer is None:
            return Status.INITIALIZING
        if self.is_silent:
            return Status.FAILING
        is_late = self.silent_s > _COASTING_S and self._answer.status is Status.TRACKING
        return Status.COASTING if is_late else self._answer.status

    @property
    def is_rolling(self) -> bool:
        """Whether the motion in `odom` is known, even without a place in the map."""
        return self._answer is not None and self._answer.T_odom_body is not None and self.status is not Status.LOST

    @property
    def grown_sigma_m(self) -> float:
        """Growth of the position's standard deviation since the last tracked estimate, metres."""
        known, answer = self._known_sigma_m, self._answer
        return 0.0 if answer is None else math.sqrt(max(_sigma_m(answer) ** 2 - known**2, 0.0))

    def is_known(self, unsure_m: float) -> bool:
        """Return whether the pose in the map is known, with at most `unsure_m` more deviation than when tracked."""
        return not self.why_unknown(unsure_m)

    def why_unknown(self, unsure_m: float) -> str:
        """Return why the pose in the map is unknown, as of `is_known`; empty if it is known.

        A start pose from the user is valid for a limited way: with a map of another place, nothing is ever recognized.
        """
        if self.is_silent:
            return f"the localization has not answered for {self.silent_s:.1f} s"
        if self.state is None:
            return "it is not known where it is"
        if self.grown_sigma_m > unsure_m:
            return f"its place is known to {self.grown_sigma_m:.1f} m only"
        if self._unproven_m is not None and self._unproven_m > self._hold.unproven_m:
            return f"nothing of the map was recognised in {self._unproven_m:.1f} m of way: is its start right?"
        return ""

    @property
    def odom_pose(self) -> FloatArray | None:
        """(3,) x, y, yaw of the base in `odom` now; None while unknown."""
        answer = self._answer
        if answer is None or answer.T_odom_body is None:
            return None
        return _pose(_planar(answer.T_odom_body) @ self._since(answer.stamp_s))

    @property
    def T_map_odom(self) -> FloatArray:
        """(3,) x, y, yaw of `odom` in `map`."""
        held, odom_pose = self._held, self.odom_pose
        if held is None or odom_pose is None:
            return np.zeros(3) if self._answer is None else _pose(_planar(self._answer.T_map_odom))
        return _pose(held.carried(self._rolled_at(math.inf)) @ se2.invert(se2.from_parts(*odom_pose)))

    @property
    def state(self) -> MotionState | None:
        """Pose and speed in the map now; None while the pose in the map is unknown."""
        if self._held is None:
            return None
        pose = _pose(self._held.carried(self._rolled_at(math.inf)))
        return MotionState(pose, self._speed.forward_m_s, self._speed.turn_rad_s)

    def _since(self, stamp_s: float) -> FloatArray:
        """Return (3, 3), the motion of the base since a stamp by the wheels; the identity if the stamp is too old."""
        return np.asarray(se2.invert(self._rolled_at(stamp_s)) @ self._rolled_at(math.inf))

    def _rolled_at(self, stamp_s: float) -> FloatArray:
        """Return (3, 3), the wheels' own pose at a stamp; the newest one if the stamp is too old."""
        before = [T for track_s, T in self._track if track_s <= stamp_s]
        if before:
            return before[-1]
        return self._track[-1][1] if self._track else np.eye(3)


def planar_pose(T: FloatArray) -> FloatArray:
    """Return (3,) x, y, yaw of a rigid motion (4, 4)."""
    return _pose(_planar(T))


def _planar(T: FloatArray) -> FloatArray:
    return se2.from_parts(T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0]))


def _pose(T: FloatArray) -> FloatArray:
    return np.array(se2.to_parts(T), float)


def _sigma_m(estimate: Estimate) -> float:
    """Return the horizontal standard deviation in `odom` along its larger axis; 0 if there is none."""
    if estimate.covariance is None or estimate.T_odom_body is None:
        return 0.0
    return _worse_sigma_m(estimate.T_odom_body, estimate.covariance)


def _worse_sigma_m(T: FloatArray, covariance: FloatArray) -> float:
    """Return the deviation along the larger horizontal axis, of a pose (4, 4) with covariance (6, 6)."""
    C = se3.position_covariance(T, covariance)
    # Rounding may make it negative.
    return float(np.sqrt(max(np.linalg.eigvalsh(C[:2, :2])[-1], 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class HeldPlace:
    """A pose in the map that wheels carry on for a moment, while the localization is less certain than it was.

    A person who passes close to the camera contradicts the wheels for a second. During that time the estimate has a
    deviation of tens of centimetres, and jumps as far. Wheels without slip are off by millimetres in that time.

    Attributes:
        T_map_base: (3, 3) pose of the base.
        T_wheels: (3, 3) the wheels' own pose at the same time, in a frame of its own.
        sigma_m: standard deviation along the larger horizontal axis, by the localization.
        stamp_s: time of the pose.
    """

    T_map_base: FloatArray
    T_wheels: FloatArray
    sigma_m: float
    stamp_s: float

    def carried(self, T_wheels: FloatArray) -> FloatArray:
        """Return (3, 3), the pose of the base when the wheels' own pose is (3, 3)."""
        return np.asarray(self.T_map_base @ se2.invert(self.T_wheels) @ T_wheels)

    def sigma_at(self, T_wheels: FloatArray, settings: HoldSettings) -> float:
        """Return the standard deviation in metres when the wheels' own pose is (3, 3)."""
        return float(np.hypot(self.sigma_m, settings.wheels_share * self._way_m(T_wheels)))

    def holds(self, sigma_m: float, T_wheels: FloatArray, stamp_s: float, settings: HoldSettings) -> bool:
        """Return whether it is still better than a new estimate with the deviation `sigma_m`."""
        s = settings
        is_late = stamp_s - self.stamp_s > s.seconds or self._way_m(T_wheels) > s.way_m
        is_sure = sigma_m <= max(self.sigma_at(T_wheels, s), s.sure_m)
        return not is_late and not is_sure and np.isfinite(sigma_m)

    def _way_m(self, T_wheels: FloatArray) -> float:
        """Return the straight distance since then."""
        x, y, _ = se2.to_parts(se2.invert(self.T_wheels) @ T_wheels)
        return float(np.hypot(x, y))
