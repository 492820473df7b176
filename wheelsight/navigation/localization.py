"""Localization interface of navigation. WhereNow: the pose between two estimates. HeldPlace: a short hold of the
pose by the wheels.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
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

# Localization as navigation asks for it, and WhereNow: where the robot is between two of its answers.


Answered = tuple[Event, Estimate | None]
# How long the wheels' own way is kept: answers to frames come later than that only where nothing goes on.
_TRACK_S = 3.0
# Without an answer of the localization for `_COASTING_S` wheels lead alone, and the robot goes slower. It stops after
# `_SILENT_S`, or `_SILENT_M` of way: 0.5 s with the control period in which that shows.
_COASTING_S, _SILENT_S, _SILENT_M = 0.2, 0.4, 0.25
# Speeds are taken over so much time; of the first readings over what there is, and of less than the second over none.
_SPEED_S, _LEAST_S = 0.04, 0.01


class Localization(Protocol):
    """Says where the robot is. `localizer.LocalizerInStep` and `LocalizerBeside` are such."""

    @property
    def keyframes(self) -> KeyframeStore | None:
        """What the camera remembers, and where; None of wheels alone."""

    @property
    def recognised(self) -> int | None:
        """How often something of a map of before was recognised so far; None where nobody looks for that."""

    def hear(self, events: Sequence[Event]) -> Sequence[Answered]:
        """Take what came, in order; what is answered by now, of this and of earlier calls, in order.

        Raises what `Localizer.process` raises.
        """

    def close(self) -> None:
        """End the threads that work for it."""


@dataclass(frozen=True, slots=True)
class WheelSpeed:
    """How a base moves by its encoders, at a stamp.

    Attributes:
        stamp_s: of the reading.
        forward_m_s, turn_rad_s: over a little time until then.
        rolled: metres along the arc and radians since the reading before. Means of speeds come late: added up, they
            lag behind where the base is by half of the time that they are taken over.
    """

    stamp_s: float
    forward_m_s: float
    turn_rad_s: float
    rolled: tuple[float, float] = (0.0, 0.0)


class WhereNow:
    """The last answer of the localization, carried on by the wheels' own way since; or one of a moment before.

    The wheels carry it on for a limited time and way: `is_silent` is true where the localization does not answer.

    Args:
        wheels: of the calibration.
        hold: for how long a place that was surer is held; or the defaults.
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
        """Go on by a reading; the base's speed, or None where the reading tells none."""
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
        self._speed = replace(self._speed_now(), rolled=(float(way[0]), float(way[2])))
        return self._speed

    def _speed_now(self) -> WheelSpeed:
        """Over a little time: stamps jitter, and two readings may be told a tenth of a millisecond apart."""
        stamp_s, T_now = self._track[-1]
        before = [(then_s, T) for then_s, T in self._track if then_s <= stamp_s - _SPEED_S]
        then_s, T_then = before[-1] if before else self._track[0]
        if stamp_s - then_s < _LEAST_S:
            return WheelSpeed(stamp_s, 0.0, 0.0)
        forward, _, turn = se2.log(np.linalg.inv(T_then) @ T_now) / (stamp_s - then_s)
        return WheelSpeed(stamp_s, float(forward), float(turn))

    def ask(self, stamp_s: float) -> None:
        """Note that the localization got an event with this stamp."""
        self._heard_s = max(self._heard_s, stamp_s)

    def processed(self, stamp_s: float) -> None:
        """Note that the localization has processed an event with this stamp, with an estimate or without."""
        if stamp_s > self._answered_s:
            self._answered_s = stamp_s
            self._unanswered_m = float(np.hypot(*self._since(stamp_s)[:2, 2]))

    @property
    def silent_s(self) -> float:
        """Seconds of events that the localization has not processed; 0 before its first answer."""
        return max(self._heard_s - self._answered_s, 0.0) if math.isfinite(self._answered_s) else 0.0

    @property
    def is_silent(self) -> bool:
        """Whether the localization has not answered for longer, or for more way, than wheels may lead alone."""
        return self.silent_s > _SILENT_S or (self.silent_s > _COASTING_S and self._unanswered_m > _SILENT_M)

    def answer(self, estimate: Estimate, recognised: int | None = None) -> None:
        """Take what the localization says, and how often it has recognised something of a map of before."""
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
        T_wheels, sigma_m = self._rolled_at(estimate.stamp_s), _sigma_map_m(estimate)
        slips = isinstance(estimate, FusedEstimate) and estimate.slip
        if self._held is None or slips or not self._held.holds(sigma_m, T_wheels, estimate.stamp_s, self._hold):
            self._held = HeldPlace(_planar(estimate.T_map_body), T_wheels, sigma_m, estimate.stamp_s)

    @property
    def estimate(self) -> Estimate | None:
        """The last answer."""
        return self._answer

    @property
    def speed(self) -> WheelSpeed:
        """By the last reading."""
        return self._speed

    @property
    def status(self) -> Status:
        """Of the last answer; before any, `INITIALIZING`. Where answers are late it is `COASTING` at best, where none
        come `FAILING`.
        """
        if self._answer is None:
            return Status.INITIALIZING
        if self.is_silent:
            return Status.FAILING
        is_late = self.silent_s > _COASTING_S and self._answer.status is Status.TRACKING
        return Status.COASTING if is_late else self._answer.status

    @property
    def is_rolling(self) -> bool:
        """Whether it is known at least how the robot moves, be it not where in the map it is."""
        return self._answer is not None and self._answer.T_odom_body is not None and self.status is not Status.LOST

    @property
    def grown_sigma_m(self) -> float:
        """By how much the position became less certain since it was last tracked, metres."""
        known, answer = self._known_sigma_m, self._answer
        return 0.0 if answer is None else math.sqrt(max(_sigma_m(answer) ** 2 - known**2, 0.0))

    def is_known(self, unsure_m: float) -> bool:
        """Whether it is known where in the map the robot is, at most `unsure_m` less surely than when tracked."""
        return not self.why_unknown(unsure_m)

    def why_unknown(self, unsure_m: float) -> str:
        """Why it is not known where in the map the robot is; empty where it is, as of `is_known`.

        A start that somebody said is believed for a while: of a map of another place nothing is ever recognised.
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
        """(3,) x, y, yaw of the base in `odom` now; None while it is not known."""
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
        """In the map, now; None while it is not known where in the map the robot is."""
        if self._held is None:
            return None
        pose = _pose(self._held.carried(self._rolled_at(math.inf)))
        return MotionState(pose, self._speed.forward_m_s, self._speed.turn_rad_s)

    def _since(self, stamp_s: float) -> FloatArray:
        """(3, 3) how the wheels moved the base since a stamp; the identity where that is not remembered."""
        return np.asarray(se2.invert(self._rolled_at(stamp_s)) @ self._rolled_at(math.inf))

    def _rolled_at(self, stamp_s: float) -> FloatArray:
        """(3, 3) where the wheels alone have the base at a stamp; now, where that is not remembered."""
        before = [T for track_s, T in self._track if track_s <= stamp_s]
        if before:
            return before[-1]
        return self._track[-1][1] if self._track else np.eye(3)


def planar_pose(T: FloatArray) -> FloatArray:
    """(3,) x, y, yaw of a rigid motion (4, 4)."""
    return _pose(_planar(T))


def _planar(T: FloatArray) -> FloatArray:
    return se2.from_parts(T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0]))


def _pose(T: FloatArray) -> FloatArray:
    return np.array(se2.to_parts(T), float)


def _sigma_m(estimate: Estimate) -> float:
    """Of the horizontal position, the larger one."""
    if estimate.covariance is None or estimate.T_odom_body is None:
        return 0.0
    return _worse_sigma_m(estimate.T_odom_body, estimate.covariance)


def _sigma_map_m(estimate: Estimate) -> float:
    """Of where an answer has the robot in the map, along the worse axis; infinite where it does not say."""
    if estimate.covariance_map is None or estimate.T_map_body is None:
        return math.inf
    return _worse_sigma_m(estimate.T_map_body, estimate.covariance_map)


def _worse_sigma_m(T: FloatArray, covariance: FloatArray) -> float:
    """Along the worse horizontal axis, of a pose (4, 4) with covariance (6, 6); 0 where rounding made it less."""
    C = se3.position_covariance(T, covariance)
    return float(np.sqrt(max(np.linalg.eigvalsh(C[:2, :2])[-1], 0.0)))


# HeldPlace: a place in the map that the wheels carry on for a moment, while the localization is less sure than it
# was.
#
# Somebody who walks past close to the camera contradicts the wheels for a second; until it is settled who was right,
# the localization states tens of centimetres, and its place leaps by as much. Wheels are off by millimetres in that
# time, unless it is they that slip.


@dataclass(frozen=True, slots=True, eq=False)
class HeldPlace:
    """As the localization had it.

    Attributes:
        T_map_base: (3, 3) where the base was.
        T_wheels: (3, 3) where the wheels alone had it then, in a frame of their own.
        sigma_m: standard deviation along the worse axis, as the localization stated.
        stamp_s: when.
    """

    T_map_base: FloatArray
    T_wheels: FloatArray
    sigma_m: float
    stamp_s: float

    def carried(self, T_wheels: FloatArray) -> FloatArray:
        """(3, 3) where the base is once the wheels have it at (3, 3)."""
        return np.asarray(self.T_map_base @ se2.invert(self.T_wheels) @ T_wheels)

    def sigma_at(self, T_wheels: FloatArray, settings: HoldSettings) -> float:
        """Metres: as sure as wheels leave it, once they have the base at (3, 3)."""
        return float(np.hypot(self.sigma_m, settings.wheels_share * self._way_m(T_wheels)))

    def holds(self, sigma_m: float, T_wheels: FloatArray, stamp_s: float, settings: HoldSettings) -> bool:
        """Whether it is better still than what the localization states to be known to `sigma_m` now."""
        s = settings
        is_late = stamp_s - self.stamp_s > s.seconds or self._way_m(T_wheels) > s.way_m
        is_sure = sigma_m <= max(self.sigma_at(T_wheels, s), s.sure_m)
        return not is_late and not is_sure and np.isfinite(sigma_m)

    def _way_m(self, T_wheels: FloatArray) -> float:
        """As the crow flies, since."""
        x, y, _ = se2.to_parts(se2.invert(self.T_wheels) @ T_wheels)
        return float(np.hypot(x, y))
