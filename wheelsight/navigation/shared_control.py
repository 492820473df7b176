"""`Assist` drives a robot by the stick of the person in it, and helps: it slows, stops, and steers toward a free way.

`SharedControl` chooses the command beside the person's intention. The collision monitor checks each command after it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from wheelsight.core.drive_model import DriveModel
from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import STOP, StickPosition, VelocityCommand
from wheelsight.core.robots import CONTROL_PERIOD_S, Robot, RobotLimits, nearby_of
from wheelsight.core.threads import OneCaller, one_at_a_time
from wheelsight.navigation.clearance_kernels import can_pass, clear_share, moved
from wheelsight.navigation.collision_monitor import (
    CollisionMonitor,
    ControlChain,
    MonitorResult,
    MonitorState,
    in_frame,
)
from wheelsight.navigation.perception import DepthViewer
from wheelsight.navigation.senses import WhereNow, watch_floor
from wheelsight.navigation.settings import NavigationSettings, outline_of

# Age of a stick's position beyond which it counts as released: five positions of a stick that sends at 20 Hz.
STICK_AGE_S = 0.25
# Turn rates that steering may add to the person's in the first part of the way ahead, rad/s, and their number. At 0.5
# m/s the outermost one leaves the person's way by 0.4 m after a metre. More would be another way than the one that the
# person asks for. Those of the second part, relative to the person's, let the robot straighten in a door. Chosen.
MOST_ADDED_RAD_S, _FIRST, _SECOND_RAD_S = 0.4, 9, (0.0, -0.4, 0.4, -0.8, 0.8)
# Time that both parts take at the intended speed, least and greatest length, and the first part's share. Chosen.
_AHEAD_S, _LEAST_M, _MOST_M, _FIRST_SHARE = 3.5, 1.0, 1.8, 0.45
# Clearances at which ways are compared: a greater one counts where there is room. Chosen.
_MARGINS_M = (0.05, 0.12)
# Help waits while a free way of three arcs begins with the person's own command. Clearances of that way: help ends at
# the first, begins at the second, and takes the greatest that some way has. Share of the first arc, and turn rates of
# both others relative to the person's, rad/s. Chosen.
_CLEAR_M, _WAITING_S = (0.11, 0.08, 0.05), 0.6
# Turn rates that a slower speed, and a metre less of clearance, are worth, rad/s. Chosen.
_SLOWER_RAD_S, _NARROWER_RAD_S_M = 0.4, 3.0
_HELPED_RAD_S = (0.0, -0.1, 0.1, -0.2, 0.2, -0.3, 0.3, -0.4, 0.4)
# Time for which a turn goes on as it is, of a robot without a drive model: the monitor's ramp and a quick motor's lag.
_LAG_S = 0.2
# Shares of the intended speed that are tried: slower, the same turn rates bend the way more. Chosen.
_SPEEDS = (1.0, 0.4)
# Share of a free way that a lower speed must gain, and the largest turn rate added in the first part, or in the second.
# Chosen.
_OWN_SPEED, _OWN_WAY, _OWN_WAY_LATER = 0.15, 0.2, 0.05
# Spacing of checked poses along an arc, metres.
_STEP_M = 0.05
# Largest slow-down zone beside the way: a chair in the middle of a door of 0.80 m has 0.1 m on each side. Chosen.
_SLOW_ZONE_M = 0.07
# Floor beyond the nearest that the camera sees, which the person sees beside the chair when help begins. Chosen: a
# corner of the front leaves the view by as much in a first turn.
_TRUSTED_M = 0.5
# Speed of an override, the time that its switch must be held, and the longest time that it lasts.
OVERRIDE_M_S, _OVERRIDE_RAD_S, OVERRIDE_HELD_S, OVERRIDE_S = 0.2, 0.4, 1.0, 20.0
# Difference of a command from the person's, as a share of the limits, from which it counts as changed.
_CHANGED = 0.05


class AssistLevel(StrEnum):
    """How much the robot helps."""

    OFF = "off"
    STOP = "stop"
    SLOW = "slow"
    STEER = "steer"


@dataclass(frozen=True, slots=True)
class AssistFeedback:
    """State of a period.

    Attributes:
        stamp_s: the robot's time.
        intended: the person's command.
        command: what the robot gets.
        monitor: the collision monitor's result for it.
        added_rad_s: turn rate that steering added.
        override_s: rest of an override; 0 without one.
        words: why the command differs from the intended one, for display and speech; empty if it does not.
    """

    stamp_s: float
    intended: VelocityCommand
    command: VelocityCommand
    monitor: MonitorResult
    added_rad_s: float
    override_s: float
    words: str


@dataclass
class AssistRecord:
    """Shares of help over a drive, for the person's judgement of it.

    Attributes:
        periods: number of periods in which the stick was moved.
        changed: those in which the command differed by more than `_CHANGED` of the limits.
        stopped: those in which the robot stood although the stick was moved.
        contradicted: those in which it turned to the other side.
        difference: sum of the differences, as shares of the limits.
        overrides: number of overrides.
        reasons: periods by reason of a change.
    """

    periods: int = 0
    changed: int = 0
    stopped: int = 0
    contradicted: int = 0
    difference: float = 0.0
    overrides: int = 0
    reasons: dict[str, int] = field(default_factory=dict)

    def add(self, feedback: AssistFeedback, limits: RobotLimits) -> None:
        """Count a period; those with a stick at rest do not count."""
        wanted, got = feedback.intended, feedback.command
        if wanted.is_stop:
            return
        forward = abs(wanted.forward_m_s - got.forward_m_s) / max(limits.forward_m_s, 1e-9)
        turn = abs(wanted.turn_rad_s - got.turn_rad_s) / max(limits.turn_rad_s, 1e-9)
        self.periods += 1
        self.difference += max(forward, turn)
        self.stopped += got.is_stop
        self.contradicted += wanted.turn_rad_s * got.turn_rad_s < 0
        if feedback.words:
            self.changed += max(forward, turn) > _CHANGED
            self.reasons[feedback.words] = self.reasons.get(feedback.words, 0) + 1

    def to_dict(self) -> dict[str, Any]:
        """Return the shares for a JSON file."""
        count = max(self.periods, 1)
        return {
            "periods": self.periods,
            "changed_share": self.changed / count,
            "stopped_share": self.stopped / count,
            "contradicted_share": self.contradicted / count,
            "mean_difference": self.difference / count,
            "overrides": self.overrides,
            "reasons": dict(sorted(self.reasons.items(), key=lambda item: -item[1])),
        }


def intended_by(forward: float, left: float, limits: RobotLimits) -> VelocityCommand:
    """Return the command of a stick's position, by shares of its way from -1 to 1."""
    return VelocityCommand(
        forward * (limits.forward_m_s if forward > 0 else limits.backward_m_s), left * limits.turn_rad_s
    )


def steering_words(added_rad_s: float, limits: RobotLimits) -> str:
    """Return what steering does; empty for no noticeable change."""
    if abs(added_rad_s) <= _CHANGED * limits.turn_rad_s:
        return ""
    return "steers to the left" if added_rad_s > 0 else "steers to the right"


class SharedControl:
    """Chooses a turn rate near the person's one, along which more of the way ahead is free.

    The person's command stays while some free way begins with it. Otherwise commands around it are tried, the smallest
    change first, until a free way begins with one (as viability in the dynamic window approach: Fox, Burgard & Thrun,
    1997; with the person's command in place of a goal: Carlson & Demiris, 2012). If none has a free way, ways of two
    arcs are compared by their free share. The speed is never raised, and only forward commands are steered.
    """

    def __init__(
        self, monitor: CollisionMonitor, settings: NavigationSettings, drive: DriveModel | None = None
    ) -> None:
        self._monitor, self._most_rad_s = monitor, settings.limits.turn_rad_s
        self._sides = outline_of(settings.footprint.outline).sides
        self._margins_m = tuple(max(margin_m, settings.monitor.margin_m) for margin_m in _MARGINS_M)
        self._helps, self._lag_s = False, _LAG_S if drive is None or drive.turn is None else drive.turn.stop_s(0.0)
        added = np.linspace(-MOST_ADDED_RAD_S, MOST_ADDED_RAD_S, _FIRST)
        # The person's turn rate first, then by the size of the change: the first of equal ways is chosen.
        self._added_rad_s: list[float] = added[np.argsort(np.abs(added), kind="stable")].tolist()
        tries = [(speed, margin_m, added) for speed in _SPEEDS for margin_m in _CLEAR_M for added in self._added_rad_s]

        def cost(one: tuple[float, float, float]) -> float:
            speed, margin_m, added = one
            return _SLOWER_RAD_S * (speed < 1.0) + abs(added) + _NARROWER_RAD_S_M * (_CLEAR_M[0] - margin_m)

        self._tries = sorted(tries, key=cost)

    def steer(self, intended: VelocityCommand, now_s: float, driven: VelocityCommand = STOP) -> VelocityCommand:
        """Return a command of at most the intended speed, whose turn rate differs by at most `MOST_ADDED_RAD_S`.

        `driven` is the measured motion, which goes on for the drive's lag.
        """
        forward, pose = intended.forward_m_s, self._monitor.memory.pose_at(now_s)
        if forward <= 0 or pose is None:
            return intended
        ahead_m = min(max(forward * _AHEAD_S, _LEAST_M), _MOST_M)
        reach_m = ahead_m + float(np.abs(self._sides[:, :2]).max()) + self._margins_m[-1]
        points = self._monitor.memory.points_at(pose, now_s, reach_m)
        points = _seen_from(points, (driven.forward_m_s * self._lag_s, driven.turn_rad_s * self._lag_s))
        margin_m = _CLEAR_M[0 if self._helps else 1]
        self._helps = not self._is_viable(points, intended, intended.turn_rad_s, ahead_m, margin_m)
        if not self._helps:
            return intended
        for speed, margin_m, added in self._tries:
            turn = min(max(intended.turn_rad_s + added, -self._most_rad_s), self._most_rad_s)
            tried = VelocityCommand(speed * forward, turn)
            if self._is_viable(points, tried, intended.turn_rad_s, ahead_m, margin_m):
                return tried
        best, chosen = -math.inf, intended
        for speed in _SPEEDS:
            for added in self._added_rad_s:
                turn = min(max(intended.turn_rad_s + added, -self._most_rad_s), self._most_rad_s)
                tried = VelocityCommand(speed * forward, turn)
                own = _OWN_SPEED * (speed < 1.0) + _OWN_WAY * abs(added) / MOST_ADDED_RAD_S
                value = self._free(points, tried, intended.turn_rad_s, ahead_m) - own
                if value > best + 1e-9:
                    best, chosen = value, tried
                if value >= 1.0:
                    return chosen
            if best >= 1.0 - _OWN_SPEED:
                break
        return chosen

    def _is_viable(
        self, points: FloatArray, tried: VelocityCommand, turn_rad_s: float, ahead_m: float, margin_m: float
    ) -> bool:
        """Return whether a free way of three arcs begins with a command, the others with help as `_HELPED_RAD_S`."""
        first_m, forward = _WAITING_S * tried.forward_m_s, tried.forward_m_s
        arc, steps = (first_m, tried.turn_rad_s / forward * first_m), math.ceil(first_m / _STEP_M)
        if clear_share(self._sides, points, arc, steps, margin_m) < 1.0:
            return False
        beyond = _seen_from(points, arc)
        length_m = (ahead_m - first_m) / 2
        bends = (turn_rad_s + np.array(_HELPED_RAD_S)) / forward
        return bool(can_pass(self._sides, beyond, length_m, math.ceil(length_m / _STEP_M), bends, margin_m))

    def _free(self, points: FloatArray, tried: VelocityCommand, turn_rad_s: float, ahead_m: float) -> float:
        """Return the free share of the best way ahead that begins with a command, as a mean over the margins.

        Args:
            points: (N, 2) of obstacles in `base`.
            turn_rad_s: the person's turn rate, around which those of the second part lie.
        """
        first_m = _FIRST_SHARE * ahead_m
        arc, steps = (first_m, tried.turn_rad_s * first_m / tried.forward_m_s), math.ceil(first_m / _STEP_M)
        free = [clear_share(self._sides, points, arc, steps, margin_m) for margin_m in self._margins_m]
        if free[0] < 1.0:
            return float(_FIRST_SHARE * sum(free) / len(free))
        beyond = _seen_from(points, arc)
        second_m, best = ahead_m - first_m, 0.0
        for later in _SECOND_RAD_S:
            arc = (second_m, (turn_rad_s + later) * second_m / tried.forward_m_s)
            steps = math.ceil(second_m / _STEP_M)
            shares = [
                clear_share(self._sides, beyond, arc, steps, margin_m) if share >= 1.0 else 0.0
                for margin_m, share in zip(self._margins_m, free, strict=True)
            ]
            own = 1 - _OWN_WAY_LATER * abs(later) / _SECOND_RAD_S[-1]
            best = max(best, own * sum(shares) / len(shares))
            if best >= 1.0:
                break
        return float(_FIRST_SHARE * sum(free) / len(free) + (1 - _FIRST_SHARE) * best)


def _seen_from(points: FloatArray, arc: tuple[float, float]) -> FloatArray:
    """Points (N, 2) from the end of an arc."""
    return np.ascontiguousarray(in_frame(points, moved((0.0, 0.0, 1.0, 0.0), *arc)))


class Assist(OneCaller):
    """Drives one robot by a stick; call `step` once per control period, and `move` for each position of the stick.

    It needs wheels and a depth camera, neither a map nor a place in one. A released stick, or one whose positions do
    not come, stops the robot. It never drives backward by itself.

    Args:
        robot: the robot to drive; the caller opens and closes it.
        level: how much it helps. Off leaves obstacles to the person; stale sensor data and disobedient wheels still
            stop the robot at every level.

    Attributes:
        record: shares of help over the drive.

    Raises ArgumentError, CalibrationError, MapError as `DepthViewer`, or for a robot without two driven wheels.
    """

    def __init__(
        self, robot: Robot, settings: NavigationSettings | None = None, level: AssistLevel = AssistLevel.STEER
    ) -> None:
        self.settings = s = settings or NavigationSettings()
        calibration = robot.calibration
        if calibration.wheels is None:
            fix = "a robot with two driven wheels, calibrated: docs/wheel-calibration.md"
            raise ArgumentError(f"the calibration {calibration.lacks_two_wheels}", fix=fix)
        self.level, self.record, self._robot = level, AssistRecord(), robot
        # A person leads, and chooses the speed in a door himself: only what is nearer slows him down.
        zone_m = min(s.monitor.slow_zone_m, _SLOW_ZONE_M)
        watched = s.model_copy(update={"monitor": s.monitor.model_copy(update={"slow_zone_m": zone_m})})
        self._chain = ControlChain(watched, calibration.drive_model, calibration.nearby)
        self.monitor = self._chain.monitor
        self._shared = SharedControl(self.monitor, s, calibration.drive_model)
        self._viewer = DepthViewer(calibration, s.footprint.outline, s.live)
        self.monitor.trust_floor(self._viewer.near_m + _TRUSTED_M)
        self._where = WhereNow(calibration.wheels)
        self._stick = StickPosition(-math.inf)
        self._held_since_s, self._override_until_s = math.inf, -math.inf

    @one_at_a_time
    def move(self, position: StickPosition) -> None:
        """Take a position of the stick. One that is not sound counts as released."""
        self._stick = position if position.is_sound else StickPosition(self._robot.now_s)

    @property
    def speed(self) -> tuple[float, float]:
        """Measured speed in m/s, and turn rate in rad/s."""
        return self._where.speed.forward_m_s, self._where.speed.turn_rad_s

    @one_at_a_time
    def clear_fault(self) -> None:
        """Permit driving again after a person has checked wheels that did not follow their commands."""
        self._chain.clear_fault()

    @one_at_a_time
    def step(self) -> AssistFeedback:
        """Run one period: send the command, read the sensors, choose the next command. Raises what the robot raises."""
        events = self._robot.step(self._chain.command)
        now_s = self._robot.now_s
        self.monitor.add_nearby(nearby_of(self._robot))
        watch_floor(self.monitor, events, self._where, self._viewer)
        intended = self.intended(now_s)
        override_s = self._override_s(now_s, intended)
        asked = intended
        if override_s > 0:
            share = min(1.0, OVERRIDE_M_S / max(abs(intended.forward_m_s), 1e-9))
            share = min(share, _OVERRIDE_RAD_S / max(abs(intended.turn_rad_s), 1e-9))
            asked = VelocityCommand(share * intended.forward_m_s, share * intended.turn_rad_s)
        elif self.level is AssistLevel.STEER and not self._robot.stop_reason:
            asked = self._shared.steer(intended, now_s, VelocityCommand(*self.speed))
        is_unchecked = override_s > 0 or self.level is AssistLevel.OFF
        self._chain.ask(
            asked,
            now_s,
            Status.TRACKING,
            stands_by_itself=bool(self._robot.stop_reason),
            is_unchecked=is_unchecked,
            stops_only=self.level is AssistLevel.STOP,
        )
        added = asked.turn_rad_s - intended.turn_rad_s if override_s == 0 else 0.0
        words = self._words(added, override_s)
        feedback = AssistFeedback(now_s, intended, self._chain.command, self._chain.checked, added, override_s, words)
        self.record.add(feedback, self.settings.limits)
        return feedback

    def intended(self, now_s: float) -> VelocityCommand:
        """Return the person's command; a stop if the stick is released, or its newest position is old."""
        stick, limits = self._stick, self.settings.limits
        if stick.is_released or not -CONTROL_PERIOD_S <= now_s - stick.stamp_s <= STICK_AGE_S:
            return STOP
        return intended_by(stick.forward, stick.left, limits)

    def _override_s(self, now_s: float, intended: VelocityCommand) -> float:
        """Return the rest of an override. It begins once its switch was held, and ends with it, or after its time."""
        if not self._stick.has_override or now_s - self._stick.stamp_s > STICK_AGE_S:
            self._held_since_s, self._override_until_s = math.inf, -math.inf
            return 0.0
        self._held_since_s = min(self._held_since_s, now_s)
        if now_s - self._held_since_s >= OVERRIDE_HELD_S and self._override_until_s == -math.inf:
            self._override_until_s = now_s + OVERRIDE_S
            self.record.overrides += 1
        return max(self._override_until_s - now_s, 0.0)

    def _words(self, added_rad_s: float, override_s: float) -> str:
        """Return why the command differs from the intended one."""
        if self._robot.stop_reason:
            return f"stands: {self._robot.stop_reason}"
        if override_s > 0:
            return f"full control at {OVERRIDE_M_S:g} m/s"
        checked = self._chain.checked
        if checked.state is not MonitorState.FREE:
            return f"{checked.state}: {checked.reason}"
        return steering_words(added_rad_s, self.settings.limits)
