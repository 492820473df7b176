"""CollisionMonitor: slows or stops a command before a collision. WheelCheck: detects wheels that do not follow it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.core.robots import RobotLimits
from wheelsight.navigation.clearance_kernels import (
    Ground,
    all_outside_m,
    clear_share,
    deepest_m,
    seen_shares,
    zone_share,
)
from wheelsight.navigation.footprint import Footprint, outline_of
from wheelsight.navigation.settings import MonitorSettings, WheelCheckSettings
from wheelsight.navigation.surroundings import DepthView, Pose, Surroundings

# Least speeds of a base; a command below both is a stop.
_LEAST_M_S, _LEAST_RAD_S = 0.02, 0.02
# Without any frame for this time the camera, its cable or its driver has failed, and the motors stop at once. A frame
# older than `frame_age_s` only brakes.
CAMERA_SILENT_S = 0.4
_STATUS_TO_STAND = (Status.INITIALIZING, Status.FAILING, Status.LOST)


class MonitorState(StrEnum):
    """Effect on a command."""

    FREE = "free"
    SLOWED = "slowed"
    STOPPED = "stopped"


class MonitorReason(StrEnum):
    """Why a command was reduced."""

    INVALID = "numbers that are not finite"
    FROM_AHEAD = "stamps ahead of now"
    NO_FRAME = "no fresh depth frame"
    NO_WHEELS = "no fresh wheel reading"
    CAMERA_SILENT = "the camera sends no frames"
    LOCALIZATION_SILENT = "the localization does not answer"
    PLANNER_SILENT = "the planner does not answer"
    FLOOR_SILENT = "the map of the floor is not made"
    STATUS = "the robot does not know where it is"
    WHEELS_OFF = "the wheels do not follow their commands"
    INSIDE = "something where the robot is"
    NEAR = "something nearer than the margin"
    IN_ZONE = "something within the slow-down zone"
    OBSTACLE = "something in the way"
    NEVER_SEEN = "floor that was never seen"
    NOT_SEEN_LATELY = "floor that was not seen lately"
    COASTING = "the wheels alone lead"


@dataclass(frozen=True, slots=True)
class MonitorResult:
    """Result of a check.

    Attributes:
        command: the requested command, a slower one along the same arc, or a stop.
        state: which of these.
        reason: why it is slower; None if it is free.
    """

    command: VelocityCommand
    state: MonitorState
    reason: MonitorReason | None = None


class CollisionMonitor:
    """Reduces commands so that the robot does not collide. No later part may make a command faster.

    It knows no plans, maps and controllers. It checks the arcs that the robot drives until it stands against obstacles
    and unseen floor. It also stops the robot if any of its data are old or inconsistent.
    """

    def __init__(
        self,
        footprint: Footprint,
        limits: RobotLimits | None = None,
        settings: MonitorSettings | None = None,
        wheel_settings: WheelCheckSettings | None = None,
    ) -> None:
        self._outline = outline_of(footprint)
        self._limits, self._settings = limits or RobotLimits(), settings or MonitorSettings()
        self._wheels = WheelCheck(self._limits, wheel_settings or WheelCheckSettings())
        self._surroundings = Surroundings(self._outline, self._settings)
        sides, cell_m = self._outline.sides, self._settings.cell_m
        # Points (K, 2) along the outline.
        self._edge = np.array([side[:2] + d * side[2:4] for side in sides for d in np.arange(0.0, side[4], cell_m)])
        self._reach_m = float(np.linalg.norm(footprint.corners, axis=1).max())
        self._frame_s, self._wheels_s = -np.inf, -np.inf
        self._any_frame_s, self._blind_way_m = -np.inf, 0.0
        self._measured = (0.0, 0.0)
        self._is_frame_sound, self._are_wheels_sound = True, True
        self._are_wheels_off = False

    def clear_fault(self) -> None:
        """Permit driving again after a person has checked the wheels."""
        self._are_wheels_off = False
        self._wheels.reset()

    def trust_floor(self, radius_m: float) -> None:
        """Mark the floor within a radius of the axle as seen, because a person has looked at it.

        Obstacles in frames still count there. It applies to the robot's current place, and ends as other memory does.
        """
        self._surroundings.trust(radius_m)

    def hear(
        self, stamp_s: float, forward_m_s: float, turn_rad_s: float, rolled: tuple[float, float] | None = None
    ) -> None:
        """Process the measured speeds of the base; each reading once, in order.

        Args:
            stamp_s: time of the reading.
            forward_m_s, turn_rad_s: speeds at that time.
            rolled: metres along the arc and radians since the last reading; None to integrate the speeds.
        """
        self._are_wheels_sound = bool(np.isfinite([stamp_s, forward_m_s, turn_rad_s, *(rolled or ())]).all())
        if not self._are_wheels_sound or stamp_s <= self._wheels_s:
            return
        if stamp_s - self._wheels_s > self._settings.gap_s:
            self._surroundings.forget()
            self._wheels.reset()
            self._frame_s = -np.inf
        self._blind_way_m += abs(forward_m_s) * min(stamp_s - self._wheels_s, self._settings.gap_s)
        self._surroundings.hear(stamp_s, forward_m_s, turn_rad_s, rolled)
        self._wheels_s, self._measured = stamp_s, (forward_m_s, turn_rad_s)
        self._are_wheels_off |= self._wheels.is_off(forward_m_s, turn_rad_s, stamp_s)

    def see(self, view: DepthView) -> None:
        """Process a depth frame, in order. A frame with too little depth does not count."""
        self._is_frame_sound = view.is_sound
        if view.is_sound:
            self._any_frame_s = max(self._any_frame_s, view.stamp_s)
        if not view.is_sound or view.stamp_s <= self._frame_s or view.share < self._settings.seen_share:
            return
        if self._surroundings.see(view):
            self._frame_s, self._blind_way_m = view.stamp_s, 0.0

    def hidden(self, reach_m: float, deep_m: float) -> FloatArray:
        """Return (N, 2) in the base: floor within reach that lies deeper than `deep_m` in unseen floor.

        The monitor cannot forbid all of it, as in a turn the corners precede the view. Planners should avoid it.
        """
        return self._surroundings.hidden_about(reach_m, deep_m)

    def forget_near(self, xy_base: ArrayLike, radius_m: float) -> None:
        """Remove remembered obstacles near a place (2,) in the base, because a person sees none there.

        Obstacles in later frames still count.
        """
        self._surroundings.forget_near(xy_base, radius_m)

    def remembered(self, reach_m: float) -> FloatArray:
        """Return (N, 2) in the base: obstacles within reach that it remembers, but that the newest frame lacks."""
        return self._surroundings.out_of_sight(reach_m)

    def is_camera_silent(self, now_s: float) -> bool:
        """Return whether no frame came for `CAMERA_SILENT_S` since the last one; a covered lens still sends frames."""
        return bool(np.isfinite(self._any_frame_s) and now_s - self._any_frame_s > CAMERA_SILENT_S)

    def check(
        self, asked: VelocityCommand, now_s: float, status: Status, silent: MonitorReason | None = None
    ) -> MonitorResult:
        """Return the command that may be driven. Call it once per period, even for a stop.

        Args:
            asked: command of a controller or behaviour.
            now_s: current time, by the clock of the stamps.
            status: of the localization.
            silent: a part that does not answer; the robot stops.
        """
        reason = silent or self._why_stand(asked, now_s, status)
        if reason is not None:
            result = MonitorResult(STOP, MonitorState.STOPPED, reason)
        elif asked.is_stop:
            result = MonitorResult(asked, MonitorState.FREE)
        else:
            share, reason = self._share(asked, now_s, status)
            forward, turn = share * asked.forward_m_s, share * asked.turn_rad_s
            if share >= 1.0:
                result = MonitorResult(asked, MonitorState.FREE)
            elif abs(forward) < _LEAST_M_S and abs(turn) < _LEAST_RAD_S:
                result = MonitorResult(STOP, MonitorState.STOPPED, reason)
            else:
                result = MonitorResult(VelocityCommand(forward, turn), MonitorState.SLOWED, reason)
        self._wheels.record(result.command, now_s)
        return result

    def _why_stand(self, asked: VelocityCommand, now_s: float, status: Status) -> MonitorReason | None:
        """Return why any command is unsafe; None if none is."""
        s, newest_s = self._settings, max(self._frame_s, self._wheels_s)
        age_s = now_s - self._frame_s
        is_old = age_s > s.frame_age_s or abs(self._measured[0]) * age_s > s.frame_way_m
        # It may back up a little from an obstacle too near for its camera, while that sends frames.
        is_alive = now_s - self._any_frame_s <= s.frame_age_s
        backs_up = is_alive and asked.forward_m_s < 0 and asked.turn_rad_s == 0 and self._blind_way_m < s.blind_m
        wrong = {
            MonitorReason.INVALID: not (np.isfinite(now_s) and self._is_frame_sound and self._are_wheels_sound),
            MonitorReason.FROM_AHEAD: newest_s > now_s + s.ahead_s,
            MonitorReason.NO_WHEELS: now_s - self._wheels_s > s.encoder_age_s,
            MonitorReason.NO_FRAME: is_old and not backs_up,
            MonitorReason.WHEELS_OFF: self._are_wheels_off,
            MonitorReason.STATUS: status in _STATUS_TO_STAND,
        }
        return next((reason for reason, is_so in wrong.items() if is_so), None)

    def _share(self, asked: VelocityCommand, now_s: float, status: Status) -> tuple[float, MonitorReason | None]:
        """Return the share of a command that may be driven, and what limits it."""
        s = self._settings
        pose = self._surroundings.pose_at(now_s)
        if pose is None:
            return 0.0, MonitorReason.NO_WHEELS
        twist = (asked.forward_m_s, asked.turn_rad_s)
        points = self._surroundings.points_at(pose, now_s, self._look_m(twist))
        away = all_outside_m(self._outline.sides, points)
        if (away < -s.inside_m).any():
            return 0.0, MonitorReason.INSIDE
        shares = [(1.0, None), *self._by_things(twist, points, bool((away < s.margin_m).any()))]
        shares += self._by_floor(twist, pose, now_s)
        if status is Status.COASTING:
            shares.append((_within(twist, s.coasting_m_s, s.coasting_rad_s), MonitorReason.COASTING))
        return min(shares, key=lambda share: share[0])

    def _by_things(
        self, twist: tuple[float, float], points: FloatArray, is_near: bool
    ) -> list[tuple[float, MonitorReason | None]]:
        """Judge obstacles along the requested arc, the current one, and the one between, as the base changes over."""
        s, sides = self._settings, self._outline.sides
        arc, steps = self._arc(twist)
        clear = clear_share(sides, points, arc, steps, s.margin_m)
        shares: list[tuple[float, MonitorReason | None]] = [(self._stops_within(twist, clear), MonitorReason.OBSTACLE)]
        zone = zone_share(sides, points, arc, steps, s.slow_zone_m)
        slow = _within(twist, s.slow_m_s, s.slow_rad_s)
        shares.append((max(self._stops_within(twist, zone), slow), MonitorReason.IN_ZONE))
        if is_near:
            shares.append((_within(twist, s.blind_m_s, s.blind_rad_s), MonitorReason.NEAR))
        for part in (0.5, 1.0):
            driven = (
                (1 - part) * twist[0] + part * self._measured[0],
                (1 - part) * twist[1] + part * self._measured[1],
            )
            arc, steps = self._arc(driven)
            clear = clear_share(sides, points, arc, steps, s.margin_m)
            if clear < 1.0:
                share = self._stops_within(driven, clear) * self._rate(driven) / self._rate(twist)
                shares.append((share, MonitorReason.OBSTACLE))
        return shares

    def _by_floor(
        self, twist: tuple[float, float], pose: Pose, now_s: float
    ) -> list[tuple[float, MonitorReason | None]]:
        """Judge unseen floor along the requested arc."""
        s = self._settings
        about = self._surroundings.unseen_about(pose, now_s, self._look_m(twist))
        ground = Ground(about.never_m, about.is_old, about.first, s.cell_m, pose)
        if self._is_led_by_its_front(ground, ground._replace(deep_m=about.hidden_m)):
            self._surroundings.cover(pose, now_s)
        arc, steps = self._arc(twist)
        # Distances between cell centres are off by up to a diagonal.
        deep_m = max(s.blind_m - 1.5 * s.cell_m, 0.0)
        deep, lately = seen_shares(self._edge, self._outline.sides, ground, arc, steps, deep_m)
        blind = _within(twist, s.blind_m_s, s.blind_rad_s)
        lately = 0.0 if twist[0] < 0 else self._stops_within(twist, lately)
        return [
            (self._stops_within(twist, deep), MonitorReason.NEVER_SEEN),
            (max(lately, blind), MonitorReason.NOT_SEEN_LATELY),
        ]

    def _is_led_by_its_front(self, ground: Ground, hidden: Ground) -> bool:
        """Return whether it moves forward or turns, and its front is no deeper in unseen floor than a corner's lead.

        Floor that the robot has crossed counts as seen, which alone would let it drive on and on. So its front must
        also stay within `blind_m` of floor that a camera has seen.
        """
        forward, turn = self._measured
        if forward < -_LEAST_M_S or (forward < _LEAST_M_S and abs(turn) < _LEAST_RAD_S):
            return False
        front = self._edge[self._edge[:, 0] >= 0]
        s = self._settings
        return bool(deepest_m(front, ground) <= s.lead_m and deepest_m(front, hidden) <= s.blind_m)

    def _slowing_s(self, twist: tuple[float, float]) -> float:
        """Return the time from a twist to a stop, along its arc."""
        most, share = self._limits, self._settings.braking_share
        return max(abs(twist[0]) / most.braking_m_s2, abs(twist[1]) / most.turn_acceleration_rad_s2) / share

    def _arc(self, twist: tuple[float, float]) -> tuple[tuple[float, float], int]:
        """Return way and turn until the robot stands, and the number of steps for the check."""
        seconds = self._settings.reaction_s + self._slowing_s(twist) / 2
        way = self._rate(twist) * seconds
        return (twist[0] * seconds, twist[1] * seconds), max(int(np.ceil(way / self._settings.step_m)), 1)

    def _stops_within(self, twist: tuple[float, float], share: float) -> float:
        """Return the share of a twist whose arc ends within a share of the whole twist's arc."""
        slowing_s, reaction_s = self._slowing_s(twist), self._settings.reaction_s
        if share >= 1.0 or slowing_s == 0.0:
            return 1.0
        seconds = share * (reaction_s + slowing_s / 2)
        return float((np.sqrt(reaction_s**2 + 2 * slowing_s * seconds) - reaction_s) / slowing_s)

    def _rate(self, twist: tuple[float, float]) -> float:
        """Return an upper bound of the speed of the farthest corner."""
        return abs(twist[0]) + self._reach_m * abs(twist[1])

    def _look_m(self, twist: tuple[float, float]) -> float:
        """Return the distance from the axle within which obstacles may matter."""
        s = self._settings
        driven = self._measured
        ways = [self._rate(one) * (s.reaction_s + self._slowing_s(one) / 2) for one in (twist, driven)]
        return self._reach_m + max(ways) + s.slow_zone_m + s.margin_m


def _within(twist: tuple[float, float], most_m_s: float, most_rad_s: float) -> float:
    """Return the share of a twist that keeps two limits."""
    shares = [most / abs(speed) for speed, most in zip(twist, (most_m_s, most_rad_s), strict=True) if speed]
    return min(1.0, *shares)


class WheelCheck:
    """Detects wheels that do not follow their commands.

    It keeps the range of speeds of a base that follows its commands as fast or as slowly as it can. The upper end gains
    speed early and quickly, and loses it late and slowly; the lower end does the opposite.
    """

    def __init__(self, limits: RobotLimits, settings: WheelCheckSettings) -> None:
        self._limits, self._settings = limits, settings
        self._sent: deque[tuple[float, VelocityCommand]] = deque()
        self._lowest, self._highest = (0.0, 0.0), (0.0, 0.0)
        self._stamp_s: float | None = None
        self._off_s = 0.0

    def record(self, command: VelocityCommand, now_s: float) -> None:
        """Record a command that the base was sent."""
        self._sent.append((now_s, command))

    def reset(self) -> None:
        """Start again from the next reading, after a gap."""
        self._stamp_s, self._off_s = None, 0.0

    def is_off(self, forward_m_s: float, turn_rad_s: float, stamp_s: float) -> bool:
        """Return whether the measured speeds have been out of range for too long."""
        s, measured = self._settings, (forward_m_s, turn_rad_s)
        if self._stamp_s is None:
            self._lowest = self._highest = measured
            self._stamp_s = stamp_s
            return False
        step_s, self._stamp_s = stamp_s - self._stamp_s, stamp_s
        # All commands that the base may follow at this time, with its lag.
        late_s = stamp_s - s.lag_s
        sent = [self._command_at(stamp_s, s.held_s), self._command_at(late_s, s.watchdog_s)]
        sent += [command for sent_s, command in self._sent if late_s < sent_s <= stamp_s]
        ahead, turns = [one.forward_m_s for one in sent], [one.turn_rad_s for one in sent]
        self._lowest = self._next(self._lowest, (min(ahead), min(turns)), step_s, s.slow_share, s.fast_share)
        self._highest = self._next(self._highest, (max(ahead), max(turns)), step_s, s.fast_share, s.slow_share)
        bounds = zip(self._lowest, measured, self._highest, strict=True)
        off = [max(low - value, value - high, 0.0) for low, value, high in bounds]
        is_off = off[0] > s.off_m_s or off[1] > s.off_rad_s
        self._off_s = self._off_s + step_s if is_off else 0.0
        return self._off_s >= s.off_s

    def _command_at(self, stamp_s: float, kept_s: float) -> VelocityCommand:
        """Return the last command at a time; a stop if it is older than a base keeps it.

        The program may have hung, and the base has then stopped by itself, as it should.
        """
        oldest_s = stamp_s - self._settings.lag_s
        while len(self._sent) > 1 and self._sent[1][0] <= oldest_s:
            self._sent.popleft()
        before = [(sent_s, command) for sent_s, command in self._sent if sent_s <= stamp_s]
        return before[-1][1] if before and stamp_s - before[-1][0] <= kept_s else STOP

    def _next(
        self, speeds: tuple[float, float], wanted: tuple[float, float], step_s: float, up: float, down: float
    ) -> tuple[float, float]:
        """Return the speeds after a step; `up` and `down` are shares of the limits' accelerations."""
        most, weighted_s = self._limits, (up * step_s, down * step_s)
        forward = _toward(speeds[0], wanted[0], (most.acceleration_m_s2, most.braking_m_s2), weighted_s)
        return forward, _toward(speeds[1], wanted[1], (most.turn_acceleration_rad_s2,) * 2, weighted_s)


def _toward(speed: float, wanted: float, rates: tuple[float, float], weighted_s: tuple[float, float]) -> float:
    """Return a speed after a step; `rates` are of acceleration and braking, `weighted_s` of rising and falling."""
    rate = rates[0] if speed * (wanted - speed) >= 0 else rates[1]
    change = rate * weighted_s[0 if wanted > speed else 1]
    return speed + min(max(wanted - speed, -change), change)
