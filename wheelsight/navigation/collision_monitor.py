"""CollisionMonitor: slows or stops a command before a collision, by a memory of the floor around the robot.

`ControlChain` is the way of each command: a velocity ramp, then the monitor. `WheelCheck` detects wheels that do not
follow their commands.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration_parts import NearbyMounts
from wheelsight.core.drive_model import DriveModel
from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray
from wheelsight.core.messages import STOP, NearbyReading, VelocityCommand
from wheelsight.core.robots import CONTROL_PERIOD_S, LimitedVelocity, RobotLimits
from wheelsight.navigation.clearance_kernels import (
    Memory,
    Outline,
    SeenSector,
    UnseenGround,
    all_outside_m,
    clear_share,
    deepest_m,
    mark_seen,
    mark_under,
    moved,
    remembered,
    seen_shares,
    store_hits,
    unseen,
    zone_share,
)
from wheelsight.navigation.perception import DepthView
from wheelsight.navigation.settings import (
    SILENT_S,
    Footprint,
    MonitorSettings,
    NavigationSettings,
    outline_of,
    sides_of,
)

# Least speeds of a base; a command below both is a stop.
_LEAST_M_S, _LEAST_RAD_S = 0.02, 0.02
_STATUS_TO_STAND = (Status.INITIALIZING, Status.FAILING, Status.LOST)
# Depth of a point inside the outline that stops the robot.
_INSIDE_M = 0.1
# Way since the newest usable frame beyond which it stops: at 1 m/s a control period adds 0.05 m, and 0.3 m may be
# driven blind (issue 32).
_FRAME_WAY_M = 0.24
# How far a stamp may be in the future; clocks err by less.
_AHEAD_S = 0.05
# Least share of bearings with depth in a usable frame.
_SEEN_SHARE = 0.3
# Depth of the front in unseen floor up to which the floor that it crosses counts as seen: a corner precedes the view of
# 60° by 0.04 m in a turn.
_LEAD_M = 0.1
# Share of `reaction_s` that is the base's lag: that of the simulator's motors.
ASSUMED_LAG_S = 0.1
# Gap between wheel readings that invalidates the memory.
_GAP_S = 0.5
# Motion of the outline between two poses of an arc that are checked.
_STEP_M = 0.02


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
    NEARBY_SILENT = "bumpers or rangers do not answer"
    BUMPER = "a bumper is pressed"
    WHEELS_OFF = "the wheels do not follow their commands"
    INSIDE = "something where the robot is"
    NEAR = "something nearer than the margin"
    IN_ZONE = "something within the slow-down zone"
    OBSTACLE = "something in the way"
    NEVER_SEEN = "floor that was never seen"
    NOT_SEEN_LATELY = "floor that was not seen lately"
    COASTING = "the wheels alone lead"
    UNCONFIRMED = "the camera has not confirmed the place in the map"


# Reasons for which a robot that only stops stands instead of going slower.
_STOP_FOR = (MonitorReason.OBSTACLE, MonitorReason.NEVER_SEEN)


@dataclass(frozen=True, slots=True)
class MonitorResult:
    """Result of a check.

    Attributes:
        command: the requested command, a slower one along the same arc, or a stop.
        reason: why it is slower; None if it is free.
    """

    command: VelocityCommand
    state: MonitorState
    reason: MonitorReason | None = None


class ControlChain:
    """Passes each requested command through a velocity ramp and the collision monitor.

    Attributes:
        checked: the monitor's result for the last command.
        was_backward: whether the last command that the monitor stopped was backward.
    """

    def __init__(
        self, settings: NavigationSettings, drive: DriveModel | None = None, nearby: NearbyMounts | None = None
    ) -> None:
        self.monitor = CollisionMonitor(settings.footprint.outline, settings.limits, settings.monitor, drive, nearby)
        self.checked = MonitorResult(STOP, MonitorState.FREE)
        self._stopped: tuple[float, MonitorReason | None] = (-math.inf, None)
        self.was_backward = False
        self._ramp = VelocityRamp(settings.limits)

    @property
    def command(self) -> VelocityCommand:
        """Command for the robot."""
        return self.checked.command

    def ask(
        self,
        asked: VelocityCommand,
        now_s: float,
        status: Status,
        *,
        stands_by_itself: bool,
        silent: MonitorReason | None = None,
        is_unchecked: bool = False,
        stops_only: bool = False,
    ) -> None:
        """Compute the command of a period.

        Args:
            stands_by_itself: whether the robot has stopped by itself, and does not obey.
            silent: the part that does not answer; with one the command is a stop.
            is_unchecked: whether a person drives past obstacles on his own responsibility.
            stops_only: whether the robot stands where it would have to go slower for an obstacle or unseen floor.
        """
        if stands_by_itself:
            # A ramp down during its own stop would look like disobedience, and would delay the stop command.
            self._ramp.follow(STOP)
        ramped = self._ramp.step(asked.forward_m_s, asked.turn_rad_s, CONTROL_PERIOD_S)
        self.checked = self.monitor.check(
            ramped, now_s, status, silent, is_unchecked=is_unchecked, stops_only=stops_only
        )
        if self.checked.state is not MonitorState.FREE:
            self._ramp.follow(self.checked.command)
        if self.checked.state is MonitorState.STOPPED:
            self._stopped = now_s, self.checked.reason
            self.was_backward = asked.forward_m_s < 0

    def clear_fault(self) -> None:
        """Permit driving again after a person has checked the wheels."""
        self.monitor.clear_fault()
        if self.checked.reason is MonitorReason.WHEELS_OFF:
            self.checked = MonitorResult(STOP, MonitorState.FREE)

    def stopped_by(self, since_s: float) -> MonitorReason | None:
        """Return why the monitor last stopped the robot since a time. A controller only knows that it does not move."""
        return self._stopped[1] if self._stopped[0] >= since_s else None


class CollisionMonitor:
    """Reduces commands so that the robot does not collide. No later part may make a command faster.

    It knows no plans, maps and controllers. It checks the arcs that the robot drives until it stands against obstacles
    and unseen floor. It also stops the robot if any of its data are old or inconsistent.

    With a drive model, the way to a standstill includes what earlier commands still cause (`PendingMotion`). Without
    one, the reaction time of the settings includes a lag of `ASSUMED_LAG_S`.

    Attributes:
        has_wheel_fault: whether wheels did not follow their commands; it stays so until `clear_fault`.
    """

    def __init__(
        self,
        footprint: Footprint,
        limits: RobotLimits | None = None,
        settings: MonitorSettings | None = None,
        drive: DriveModel | None = None,
        nearby: NearbyMounts | None = None,
    ) -> None:
        self._mounts, self._nearby = nearby or NearbyMounts(), NearbyReading(-np.inf, (), ())
        self._outline = outline_of(footprint)
        self._limits, self._settings = limits or RobotLimits(), settings or MonitorSettings()
        self._pending = None if drive is None else PendingMotion(self._limits, drive)
        self._wheels = WheelCheck(self._limits, drive)
        self.memory = FloorMemory(self._outline, self._settings.fresh_s)
        # Points (K, 2) along the outline.
        sides = self._outline.sides
        self._edge = np.array([side[:2] + d * side[2:4] for side in sides for d in np.arange(0.0, side[4], _CELL_M)])
        self._reach_m = float(np.linalg.norm(footprint.corners, axis=1).max())
        self._frame_s, self._wheels_s = -np.inf, -np.inf
        self._any_frame_s, self._blind_way_m = -np.inf, 0.0
        self._measured = (0.0, 0.0)
        self._is_frame_sound, self._are_wheels_sound = True, True
        self.has_wheel_fault = False

    def clear_fault(self) -> None:
        """Permit driving again after a person has checked the wheels."""
        self.has_wheel_fault = False
        self._wheels.reset()

    def trust_floor(self, radius_m: float) -> None:
        """Mark the floor within a radius of the axle as seen, because a person has looked at it.

        Obstacles in frames still count there. It applies to the robot's current place, and ends as other memory does.
        """
        self.memory.trust(radius_m)

    def add_reading(
        self, stamp_s: float, forward_m_s: float, turn_rad_s: float, rolled: tuple[float, float] | None = None
    ) -> None:
        """Process the measured speeds of the base; each reading once, in order.

        Args:
            rolled: metres along the arc and radians since the last reading; None to integrate the speeds.
        """
        self._are_wheels_sound = bool(np.isfinite([stamp_s, forward_m_s, turn_rad_s, *(rolled or ())]).all())
        if not self._are_wheels_sound or stamp_s <= self._wheels_s:
            return
        if stamp_s - self._wheels_s > _GAP_S:
            self.memory.forget()
            self._wheels.reset()
            self._frame_s = -np.inf
        self._blind_way_m += abs(forward_m_s) * min(stamp_s - self._wheels_s, _GAP_S)
        self.memory.add_reading(stamp_s, forward_m_s, turn_rad_s, rolled)
        self._wheels_s, self._measured = stamp_s, (forward_m_s, turn_rad_s)
        self.has_wheel_fault |= self._wheels.is_off(forward_m_s, turn_rad_s, stamp_s)

    def add_view(self, view: DepthView) -> None:
        """Process a depth frame, in order. A frame with too little depth does not count."""
        self._is_frame_sound = view.is_sound
        if view.is_sound:
            self._any_frame_s = max(self._any_frame_s, view.stamp_s)
        if not view.is_sound or view.stamp_s <= self._frame_s or view.share < _SEEN_SHARE:
            return
        if self.memory.add_view(view):
            self._frame_s, self._blind_way_m = view.stamp_s, 0.0

    def add_nearby(self, reading: NearbyReading | None) -> None:
        """Process the newest reading of bumpers and rangers; None for none. Readings may repeat."""
        if reading is None or reading.stamp_s <= self._nearby.stamp_s:
            return
        pose = self.memory.pose_at(reading.stamp_s)
        self._nearby = reading
        for (x, y, yaw), range_m in zip(self._mounts.rangers, reading.ranges_m, strict=False):
            if pose is not None and not math.isnan(range_m):
                self.memory.add_echo(pose, (x, y, yaw), range_m)

    def is_camera_silent(self, now_s: float) -> bool:
        """Return whether no frame came for `SILENT_S`, as of a failed camera; a covered lens still sends frames."""
        return bool(np.isfinite(self._any_frame_s) and now_s - self._any_frame_s > SILENT_S)

    def check(
        self,
        asked: VelocityCommand,
        now_s: float,
        status: Status,
        silent: MonitorReason | None = None,
        *,
        is_unchecked: bool = False,
        stops_only: bool = False,
    ) -> MonitorResult:
        """Return the command that may be driven. Call it once per period, even for a stop.

        With `is_unchecked` only invalid numbers and disobedient wheels stop the robot. With `stops_only` it stands
        where it would have to go slower for an obstacle or unseen floor.
        """
        if self._pending is not None:
            self._pending.update(self._measured, now_s)
        reason = silent or self._why_stand(asked, now_s, status)
        if is_unchecked and reason not in (MonitorReason.INVALID, MonitorReason.WHEELS_OFF):
            reason = None
        if reason is not None:
            result = MonitorResult(STOP, MonitorState.STOPPED, reason)
        elif asked.is_stop or is_unchecked:
            result = MonitorResult(asked, MonitorState.FREE)
        else:
            share, reason = self._share(asked, now_s, status)
            forward, turn = share * asked.forward_m_s, share * asked.turn_rad_s
            is_stop = abs(forward) < _LEAST_M_S and abs(turn) < _LEAST_RAD_S
            if share >= 1.0:
                result = MonitorResult(asked, MonitorState.FREE)
            elif is_stop or (stops_only and reason in _STOP_FOR):
                result = MonitorResult(STOP, MonitorState.STOPPED, reason)
            else:
                result = MonitorResult(VelocityCommand(forward, turn), MonitorState.SLOWED, reason)
        self._wheels.record(result.command, now_s)
        if self._pending is not None:
            self._pending.record(result.command, now_s)
        return result

    def _why_stand(self, asked: VelocityCommand, now_s: float, status: Status) -> MonitorReason | None:
        """Return why any command is unsafe; None if none is."""
        s, newest_s = self._settings, max(self._frame_s, self._wheels_s)
        age_s = now_s - self._frame_s
        is_old = age_s > s.frame_age_s or abs(self._measured[0]) * age_s > _FRAME_WAY_M
        # It may back up a little from an obstacle too near for its camera, while that sends frames.
        is_alive = now_s - self._any_frame_s <= s.frame_age_s
        backs_up = is_alive and asked.forward_m_s < 0 and asked.turn_rad_s == 0 and self._blind_way_m < s.blind_m
        wrong = {
            MonitorReason.INVALID: not (np.isfinite(now_s) and self._is_frame_sound and self._are_wheels_sound),
            MonitorReason.FROM_AHEAD: newest_s > now_s + _AHEAD_S,
            MonitorReason.NO_WHEELS: now_s - self._wheels_s > s.encoder_age_s,
            MonitorReason.NO_FRAME: is_old and not backs_up,
            MonitorReason.NEARBY_SILENT: not self._mounts.have_answered(self._nearby, now_s - SILENT_S),
            MonitorReason.BUMPER: self._mounts.are_bumped(self._nearby, asked.forward_m_s),
            MonitorReason.WHEELS_OFF: self.has_wheel_fault,
            MonitorReason.STATUS: status in _STATUS_TO_STAND,
        }
        return next((reason for reason, is_so in wrong.items() if is_so), None)

    def _share(self, asked: VelocityCommand, now_s: float, status: Status) -> tuple[float, MonitorReason | None]:
        """Return the share of a command that may be driven, and what limits it."""
        s = self._settings
        pose = self.memory.pose_at(now_s)
        if pose is None:
            return 0.0, MonitorReason.NO_WHEELS
        twist = (asked.forward_m_s, asked.turn_rad_s)
        points = self.memory.points_at(pose, now_s, self._look_m(twist))
        away = all_outside_m(self._outline.sides, points)
        if (away < -_INSIDE_M).any():
            return 0.0, MonitorReason.INSIDE
        shares = [(1.0, None), *self._by_things(twist, points, bool((away < s.margin_m).any()))]
        shares += self._by_floor(twist, pose, now_s)
        if status in (Status.COASTING, Status.UNCONFIRMED):
            why = MonitorReason.COASTING if status is Status.COASTING else MonitorReason.UNCONFIRMED
            shares.append((_within(twist, s.coasting_m_s, s.coasting_rad_s), why))
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
        if self._pending is not None:
            # The way to a standstill if it is stopped now. Nothing stops it sooner.
            arc, steps = self._arc(self._pending.velocity)
            if clear_share(sides, points, arc, steps, s.margin_m) < 1.0:
                shares.append((0.0, MonitorReason.OBSTACLE))
            return shares
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
        ground, hidden_m = self.memory.unseen_about(pose, now_s, self._look_m(twist))
        # It moves forward or turns, and its front is no deeper in unseen floor than a corner's lead. Floor that the
        # robot has crossed counts as seen, which alone would let it drive on and on. So its front must also stay within
        # `blind_m` of floor that a camera has seen.
        forward, turn = self._measured
        is_led_by_its_front = forward >= _LEAST_M_S or (forward >= -_LEAST_M_S and abs(turn) >= _LEAST_RAD_S)
        front = self._edge[self._edge[:, 0] >= 0]
        hidden = ground._replace(deep_m=hidden_m)
        if is_led_by_its_front and deepest_m(front, ground) <= _LEAD_M and deepest_m(front, hidden) <= s.blind_m:
            self.memory.cover(pose, now_s)
        arc, steps = self._arc(twist)
        # Distances between cell centres are off by up to a diagonal.
        deep_m = max(s.blind_m - 1.5 * _CELL_M, 0.0)
        deep, lately = seen_shares(self._edge, self._outline.sides, ground, arc, steps, deep_m)
        blind = _within(twist, s.blind_m_s, s.blind_rad_s)
        lately = 0.0 if twist[0] < 0 else self._stops_within(twist, lately)
        return [
            (self._stops_within(twist, deep), MonitorReason.NEVER_SEEN),
            (max(lately, blind), MonitorReason.NOT_SEEN_LATELY),
        ]

    def _slowing_s(self, twist: tuple[float, float]) -> float:
        """Return the time from a twist to a stop, along its arc."""
        most, share = self._limits, self._settings.braking_share
        return max(abs(twist[0]) / most.braking_m_s2, abs(twist[1]) / most.turn_acceleration_rad_s2) / share

    @property
    def _reaction_s(self) -> float:
        """Time for which the robot counts as moving on by a command before it slows down."""
        reaction_s = self._settings.reaction_s
        return reaction_s if self._pending is None else max(reaction_s - ASSUMED_LAG_S, 0.0)

    def _arc(self, twist: tuple[float, float]) -> tuple[tuple[float, float], int]:
        """Return way and turn until the robot stands, and the number of steps for the check."""
        seconds = self._reaction_s + self._slowing_s(twist) / 2
        way, turn = twist[0] * seconds, twist[1] * seconds
        if self._pending is not None:
            way, turn = way + self._pending.way_m, turn + self._pending.turned_rad
        return (way, turn), max(int(np.ceil(self._rate((way, turn)) / _STEP_M)), 1)

    def _stops_within(self, twist: tuple[float, float], share: float) -> float:
        """Return the share of a twist whose arc ends within a share of the whole twist's arc."""
        slowing_s, reaction_s = self._slowing_s(twist), self._reaction_s
        if share >= 1.0 or slowing_s == 0.0:
            return 1.0
        seconds = share * (reaction_s + slowing_s / 2)
        if self._pending is not None:
            # The way that earlier commands still cause is a part of the arc, and no share of the twist.
            pending = self._rate((self._pending.way_m, self._pending.turned_rad))
            seconds = max(seconds - (1 - share) * pending / self._rate(twist), 0.0)
        return float((np.sqrt(reaction_s**2 + 2 * slowing_s * seconds) - reaction_s) / slowing_s)

    def _rate(self, twist: tuple[float, float]) -> float:
        """Return an upper bound of the speed of the farthest corner."""
        return abs(twist[0]) + self._reach_m * abs(twist[1])

    def _look_m(self, twist: tuple[float, float]) -> float:
        """Return the distance from the axle within which obstacles may matter."""
        s = self._settings
        driven = self._measured
        ways = [self._rate(self._arc(one)[0]) for one in (twist, driven)]
        return self._reach_m + max(ways) + s.slow_zone_m + s.margin_m


def _within(twist: tuple[float, float], most_m_s: float, most_rad_s: float) -> float:
    """Return the share of a twist that keeps two limits."""
    shares = [most / abs(speed) for speed, most in zip(twist, (most_m_s, most_rad_s), strict=True) if speed]
    return min(1.0, *shares)


# Speed errors beyond what acceleration explains (a blocked wheel is off by half the speed), and the time of such an
# error until it is a fault (issue 32).
OFF_M_S, OFF_RAD_S, _OFF_S = 0.15, 0.3, 0.3
# Longest lag of a base's response to a command, without a drive model.
_LAG_S = 0.3
# Least and largest time that a base keeps a command before it stops by itself: as `robots.HOLD_S`, and the firmware's
# watchdog (docs/serial-link.md).
_HELD_S, _WATCHDOG_S = 0.2, 0.25
# Shares of the limits' accelerations of the slowest and the fastest base.
_SLOW_SHARE, _FAST_SHARE = 0.5, 1.5


class WheelCheck:
    """Detects wheels that do not follow their commands.

    It keeps the range of speeds of a base that follows its commands as fast or as slowly as it can. The upper end gains
    speed early and quickly, and loses it late and slowly; the lower end does the opposite.
    """

    def __init__(self, limits: RobotLimits, drive: DriveModel | None = None) -> None:
        self._limits = limits
        self._lag_s = _LAG_S if drive is None else max(_LAG_S, drive.longest_lag_s)
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
        measured = (forward_m_s, turn_rad_s)
        if self._stamp_s is None:
            self._lowest = self._highest = measured
            self._stamp_s = stamp_s
            return False
        step_s, self._stamp_s = stamp_s - self._stamp_s, stamp_s
        # All commands that the base may follow at this time, with its lag.
        late_s = stamp_s - self._lag_s
        sent = [self._command_at(stamp_s, _HELD_S), self._command_at(late_s, _WATCHDOG_S)]
        sent += [command for sent_s, command in self._sent if late_s < sent_s <= stamp_s]
        ahead, turns = [one.forward_m_s for one in sent], [one.turn_rad_s for one in sent]
        self._lowest = self._next(self._lowest, (min(ahead), min(turns)), step_s, _SLOW_SHARE, _FAST_SHARE)
        self._highest = self._next(self._highest, (max(ahead), max(turns)), step_s, _FAST_SHARE, _SLOW_SHARE)
        bounds = zip(self._lowest, measured, self._highest, strict=True)
        off = [max(low - value, value - high, 0.0) for low, value, high in bounds]
        is_off = off[0] > OFF_M_S or off[1] > OFF_RAD_S
        self._off_s = self._off_s + step_s if is_off else 0.0
        return self._off_s >= _OFF_S

    def _command_at(self, stamp_s: float, kept_s: float) -> VelocityCommand:
        """Return the last command at a time; a stop if it is older than a base keeps it.

        The program may have hung, and the base has then stopped by itself, as it should.
        """
        oldest_s = stamp_s - self._lag_s
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


class PendingMotion:
    """The way that a base still covers by the commands that it got, whatever comes next.

    A drive of unit gain goes, in all, the integral of its commands. By a dead time and a lag of first order, the part
    that it has not gone yet is the integral of the commands on their way, and its speed times the time constant. Both
    times together are those of the model at its 95 % worst. The base limits its commands (`LimitedVelocity`).

    Attributes:
        way_m, turned_rad: the way ahead and the turn, by the last update.
    """

    def __init__(self, limits: RobotLimits, drive: DriveModel) -> None:
        axes = [drive.straight or drive.turn, drive.turn or drive.straight]
        self._times_s = [(axis.dead_time_s, axis.stop_s() - axis.dead_time_s) for axis in axes if axis is not None]
        self._longest_s = max(dead_s for dead_s, _ in self._times_s)
        self._limited = LimitedVelocity(limits)
        self._sent: deque[tuple[float, tuple[float, float]]] = deque()
        self.way_m = self.turned_rad = 0.0

    @property
    def velocity(self) -> tuple[float, float]:
        """The last command as the base limits it, forward and turn."""
        return self._limited.now.forward_m_s, self._limited.now.turn_rad_s

    def record(self, command: VelocityCommand, now_s: float) -> None:
        """Record a command that the base was sent."""
        since_s = min(now_s - self._sent[-1][0], _GAP_S) if self._sent else CONTROL_PERIOD_S
        if since_s <= 0:
            return
        self._limited.towards(command, since_s)
        self._sent.append((now_s, self.velocity))
        while len(self._sent) > 1 and self._sent[1][0] <= now_s - self._longest_s:
            self._sent.popleft()

    def update(self, measured: tuple[float, float], now_s: float) -> None:
        """Compute the way by measured speeds, forward and turn, at a time."""
        ways = []
        ends_s = [*(sent_s for sent_s, _ in self._sent), now_s][1:]
        for index, (dead_s, lag_s) in enumerate(self._times_s):
            spans = [
                (max(end_s - max(sent_s, now_s - dead_s), 0.0), speeds[index])
                for (sent_s, speeds), end_s in zip(self._sent, ends_s, strict=True)
            ]
            ways.append(measured[index] * lag_s + sum(span_s * speed for span_s, speed in spans))
        self.way_m, self.turned_rad = ways


# Pose in the plane of a `FloorMemory`: x, y, cosine and sine of the yaw.
Pose = tuple[float, float, float, float]
_MOST_POINTS, _MOST_ECHOES = 20_000, 400
# Side of the memory's cells, and of its square around the robot: twice what a stop needs.
_CELL_M, _WINDOW_M = 0.03, 6.0
# Least distance from the camera at which it observes the air over unseen floor: an obstacle up to its lowest ray would
# be visible there. A Kinect measures nothing nearer.
AIR_M = 0.5
# Longest time that an obstacle out of sight is remembered, as one that has left is cleared sooner; and the longest way
# of the farthest corner until then: wheels err by 1 % of it, which is 0.1 m, as `_INSIDE_M`.
_REMEMBER_S, _REMEMBER_M = 600.0, 10.0
_BEAM_RAD, _ECHO_M = 0.26, 0.1  # half of the width of a ranger's beam, and the error of its range
# History of wheel poses, for late frames.
_HISTORY_S = 1.0


@dataclass(frozen=True, slots=True)
class _TimedPose:
    """A wheel reading, with the pose of the base in the plane."""

    stamp_s: float
    pose: Pose
    forward_m_s: float
    turn_rad_s: float


class FloorMemory:
    """Obstacles and seen floor in a plane where wheel odometry gives the robot's pose.

    The plane has a frame of its own, which drifts. Its content is never older than the robot needs to leave it.
    """

    def __init__(self, outline: Outline, fresh_s: float) -> None:
        self._outline, self._fresh_s = outline, fresh_s
        self._readings: deque[_TimedPose] = deque()
        self._newest = np.empty((0, 2))
        self._newest_s, self._trusted_m, self._way_m = -np.inf, 0.0, 0.0
        # Depth of cells in floor that no camera has seen, for the last reading; None after a change.
        self._hidden: tuple[Float32Array, tuple[int, int]] | None = None
        self._reach_m = float(np.linalg.norm(outline.sides[:, :2], axis=1).max())
        self.forget()

    def forget(self) -> None:
        """Clear everything but the robot's own place."""
        self._hidden = None
        n = int(np.ceil(_WINDOW_M / _CELL_M))
        never = np.full((n, n), -np.inf)
        nowhere = np.full((n, n, 2), np.iinfo(np.int64).min)
        hits = np.zeros((n, n, 5))
        self._memory = Memory(nowhere, never, never.copy(), never.copy(), hits, _CELL_M)
        self._readings.clear()
        self._echoes = np.empty((0, 3))  # place in the plane, and the way driven until then
        self._newest, self._newest_s = np.empty((0, 2)), -np.inf

    def add_reading(
        self, stamp_s: float, forward_m_s: float, turn_rad_s: float, rolled: tuple[float, float] | None = None
    ) -> None:
        """Process a wheel reading; stamps must be in order. `rolled` as in `CollisionMonitor.add_reading`."""
        self._hidden = None
        if not self._readings:
            pose = (0.0, 0.0, 1.0, 0.0)
            mark_under(self._memory, self._outline.sides, pose, stamp_s, -np.inf)
            if self._trusted_m > 0:
                mark_under(self._memory, sides_of(Footprint.circle(self._trusted_m)), pose, stamp_s, -np.inf)
        else:
            last = self._readings[-1]
            step_s = stamp_s - last.stamp_s
            if rolled is None:
                rolled = (step_s * (last.forward_m_s + forward_m_s) / 2, step_s * (last.turn_rad_s + turn_rad_s) / 2)
            pose = moved(last.pose, *rolled)
            self._way_m += abs(rolled[0]) + self._reach_m * abs(rolled[1])
        self._readings.append(_TimedPose(stamp_s, pose, forward_m_s, turn_rad_s))
        while len(self._readings) > 1 and self._readings[1].stamp_s < stamp_s - _HISTORY_S:
            self._readings.popleft()

    def trust(self, radius_m: float) -> None:
        """Mark the floor within a radius of the axle as seen, now or at the first reading."""
        self._hidden = None
        self._trusted_m = 0.0 if self._readings else radius_m
        if self._readings and radius_m > 0:
            last = self._readings[-1]
            mark_under(self._memory, sides_of(Footprint.circle(radius_m)), last.pose, last.stamp_s, -np.inf)

    def forget_near(self, xy_base: ArrayLike, radius_m: float) -> None:
        """Remove remembered obstacles near a place (2,) in the current base. The next frames show real ones again."""
        if self._readings:
            at = _placed(np.asarray(xy_base, float).reshape(1, 2), self._readings[-1].pose)[0]
            is_near = np.hypot(*np.moveaxis(self._memory.hits[..., :2] - at, -1, 0)) <= radius_m
            self._memory.hit_s[is_near] = -np.inf

    def pose_at(self, stamp_s: float) -> Pose | None:
        """Return the pose of the base at a time, extrapolated if it is later than the readings; None if too early."""
        before = [reading for reading in self._readings if reading.stamp_s <= stamp_s]
        if not before:
            return None
        last, step_s = before[-1], stamp_s - before[-1].stamp_s
        x, y, c, s = moved(last.pose, last.forward_m_s * step_s, last.turn_rad_s * step_s)
        return float(x), float(y), float(c), float(s)

    def cover(self, pose: Pose, stamp_s: float) -> None:
        """Mark the floor under the robot ahead of its axle as seen, as its front covers that before its sides do."""
        self._hidden = None
        mark_under(self._memory, self._outline.sides, pose, stamp_s, 0.0)

    def add_view(self, view: DepthView) -> bool:
        """Add a frame; return False if the pose at its time is unknown."""
        self._hidden = None
        pose = self.pose_at(view.stamp_s)
        if pose is None:
            return False
        points = _placed(np.asarray(view.points, float), pose)
        camera = _placed(np.array([view.camera], float), pose)[0]
        first_rad = view.first_rad + float(np.arctan2(pose[3], pose[2]))
        seen_m = np.ascontiguousarray(view.seen_m, float)
        near_far = (min(AIR_M, view.near_m), view.near_m, float(seen_m.max()))
        at = float(camera[0]), float(camera[1])
        sight = SeenSector(*at, first_rad, view.step_rad, *near_far, seen_m, view.stamp_s)
        mark_seen(self._memory, sight, pose[0], pose[1])
        # Points become visible again where they were visible, and nearer if they are high enough.
        shows_m = np.asarray(np.hypot(*(np.asarray(view.points, float) - view.camera).T) - _CELL_M)
        if view.shows_m is not None:
            shows_m = np.asarray(np.minimum(shows_m, np.maximum(view.shows_m, AIR_M)))
        solid, points = len(points), np.concatenate([points, _placed(view.voids, pose)])
        shows_m = np.concatenate([shows_m, np.full(len(view.voids), view.near_m)])
        store_hits(self._memory, points, shows_m, view.stamp_s, (pose[0], pose[1]), self._way_m, solid)
        self._newest, self._newest_s = points, view.stamp_s
        return True

    def add_echo(self, pose: Pose, mount: tuple[float, float, float], range_m: float) -> None:
        """Add what a ranger at x, y, yaw (3,) in `base` measured; nearer echoes in its beam are removed.

        A camera does not clear echoes, as it sees through glass.
        """
        x, y, yaw = mount
        at, heading = _placed(np.array([[x, y]]), pose)[0], yaw + math.atan2(pose[3], pose[2])
        away = self._echoes[:, :2] - at
        away_m, off_rad = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0]) - heading
        is_nearer = (np.cos(off_rad) > math.cos(_BEAM_RAD)) & (away_m < range_m - _ECHO_M)
        self._echoes = self._echoes[~is_nearer & (self._echoes[:, 2] > self._way_m - _REMEMBER_M)]
        if range_m < math.inf:
            place = at + range_m * np.array([math.cos(heading), math.sin(heading)])
            self._echoes = np.vstack([self._echoes, [*place, self._way_m]])[-_MOST_ECHOES:]

    def _echoes_at(self, pose: Pose, reach_m: float) -> FloatArray:
        """Return the echoes (N, 2) within reach, in the frame of a pose, but those deep under the robot."""
        apart = in_frame(self._echoes[:, :2], pose)
        is_clear = all_outside_m(self._outline.sides, apart) > -_INSIDE_M
        return np.asarray(apart[(np.hypot(*apart.T) < reach_m) & is_clear])

    def points_at(self, pose: Pose, now_s: float, reach_m: float) -> FloatArray:
        """Return obstacles (N, 2) within reach, in the frame of a pose: all of the newest frame, and remembered ones.

        Memory ends after a distance driven, as wheels drift with it, rather than after a time: beside a robot that
        stands, an obstacle stays. Remembered obstacles under the robot are removed.
        """
        old = self._all_remembered(pose, now_s, reach_m)
        newest = in_frame(self._newest, pose)
        newest = newest[np.hypot(*newest.T) < reach_m]
        return np.ascontiguousarray(np.concatenate([newest, old[:, :2], self._echoes_at(pose, reach_m)]))

    def remembered(self, reach_m: float) -> FloatArray:
        """Return remembered obstacles (N, 2) in the current base: within reach those that the newest frame lacks.

        Floor without depth is among them wherever it is remembered.
        """
        if not self._readings:
            return np.empty((0, 2))
        last = self._readings[-1]
        old = self._all_remembered(last.pose, last.stamp_s, 2 * _WINDOW_M)
        is_near = (np.hypot(old[:, 0], old[:, 1]) < reach_m) & (old[:, 2] < self._newest_s)
        return np.concatenate([old[is_near | (old[:, 3] > 0), :2], self._echoes_at(last.pose, _WINDOW_M)])

    def _all_remembered(self, pose: Pose, now_s: float, reach_m: float) -> FloatArray:
        """Return (N, 4) as `remembered` of the kernels writes them."""
        out = np.empty((_MOST_POINTS, 4))
        since = (now_s - _REMEMBER_S, self._way_m - _REMEMBER_M)
        old = out[: remembered(self._memory, pose, since, reach_m, out)]
        within = all_outside_m(self._outline.sides, np.ascontiguousarray(old[:, :2])) < -_INSIDE_M
        return np.asarray(old[~(within & (old[:, 2] < now_s - self._fresh_s))])

    def hidden(self, reach_m: float, deep_m: float) -> FloatArray:
        """Return the centres (N, 2), in the current base, of cells within reach that lie deep in unseen floor.

        The monitor cannot forbid all of it, as in a turn the corners precede the view; planners should avoid it.
        Driving over unseen floor shows that there is floor, but not what is beside it: that keeps its depth.

        Args:
            deep_m: depth in metres beyond which cells count.
        """
        if not self._readings:
            return np.empty((0, 2))
        last = self._readings[-1]
        if np.isfinite(reach_m):  # cells up to `deep_m` beyond the reach affect the depth within it
            deep, first = self._hidden_within(reach_m + deep_m)
        else:
            self._hidden = deep, first = self._hidden or self._hidden_within(_WINDOW_M / 2)
        away = in_frame(np.asarray((np.argwhere(deep > deep_m) + first + 0.5) * _CELL_M, float), last.pose)
        return np.asarray(away[np.hypot(*away.T) < reach_m])

    def _hidden_within(self, reach_m: float) -> tuple[Float32Array, tuple[int, int]]:
        """Return (m, m), the depth in metres into unseen floor, 0 where it was seen, and i and j of the first cell."""
        last = self._readings[-1]
        out, first = self._unseen(last.pose, last.stamp_s, reach_m)
        return np.where(out[..., 0] > 0, _deep_m(out[..., 2]), 0), first

    def unseen_about(self, pose: Pose, now_s: float, reach_m: float) -> tuple[UnseenGround, Float32Array]:
        """Return the unseen floor within reach of a pose, and (m, m) the depth in floor that no camera has seen."""
        out, first = self._unseen(pose, now_s, reach_m)
        ground = UnseenGround(_deep_m(out[..., 0]), np.ascontiguousarray(out[..., 1]), first, _CELL_M, pose)
        return ground, _deep_m(out[..., 2])

    def _unseen(self, pose: Pose, now_s: float, reach_m: float) -> tuple[ByteArray, tuple[int, int]]:
        """Return (m, m, 3), 1 for floor never driven or seen, not seen lately, and never seen; and the first cell."""
        half = min(int(np.ceil(reach_m / _CELL_M)) + 1, len(self._memory.seen_s) // 2)
        first = (int(np.floor(pose[0] / _CELL_M)) - half, int(np.floor(pose[1] / _CELL_M)) - half)
        out = np.empty((2 * half, 2 * half, 3), np.uint8)
        unseen(self._memory, first, now_s - self._fresh_s, out)
        return out, first


def _deep_m(is_none: ByteArray) -> Float32Array:
    """Return (m, m), the distance in metres from cells that are 1 to the nearest that is 0."""
    deep = cv2.distanceTransform(np.ascontiguousarray(is_none), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(deep * _CELL_M, np.float32)


def _placed(points: FloatArray, pose: Pose) -> FloatArray:
    """Return points (N, 2) of the frame of a pose, in the plane."""
    x, y, c, s = pose
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + np.array([x, y]))


def in_frame(points: FloatArray, pose: Pose) -> FloatArray:
    """Return points (N, 2) of the plane in the frame of a pose."""
    x, y, c, s = pose
    return np.asarray((points - np.array([x, y])) @ np.array([[c, -s], [s, c]]))


class VelocityRamp:
    """Keeps the limits on speed, acceleration and jerk (`RobotLimits`) from one command to the next.

    Acceleration rises with limited jerk, and falls with it near the requested speed. Deceleration is not limited by
    jerk: a stop or a lower requested speed ends acceleration at once. Turns have a limit on acceleration only.
    """

    def __init__(self, limits: RobotLimits | None = None) -> None:
        self._limits = limits or RobotLimits()
        self.given = STOP
        self._acceleration_m_s2 = 0.0

    def follow(self, driven: VelocityCommand) -> None:
        """Continue from a command that was reduced after the ramp."""
        self.given, self._acceleration_m_s2 = driven, 0.0

    def step(self, forward_m_s: float, turn_rad_s: float, period_s: float) -> VelocityCommand:
        """Return the command one period after the last one.

        Args:
            forward_m_s: requested speed; a value that is not finite requests a stop of both.
            period_s: time since the last command, above 0.

        Raises ArgumentError if the period is not a positive number.
        """
        if not (math.isfinite(period_s) and period_s > 0):
            raise ArgumentError(f"a period of {period_s} s", fix="give seconds since the last command, above 0")
        if not (math.isfinite(forward_m_s) and math.isfinite(turn_rad_s)):
            forward_m_s, turn_rad_s = 0.0, 0.0
        most = self._limits
        turn = min(max(turn_rad_s, -most.turn_rad_s), most.turn_rad_s)
        change = most.turn_acceleration_rad_s2 * period_s
        before = self.given.turn_rad_s
        turn = before + min(max(turn - before, -change), change)
        wanted = min(max(forward_m_s, -most.backward_m_s), most.forward_m_s)
        speed = self.given.forward_m_s
        if speed * (wanted - speed) < 0:  # it slows down
            # Stop at zero: the other direction begins with its own acceleration.
            wanted = wanted if wanted * speed > 0 else 0.0
            change = most.braking_m_s2 * period_s
            self._acceleration_m_s2 = 0.0
            self.given = VelocityCommand(speed + min(max(wanted - speed, -change), change), turn)
            return self.given
        sign = math.copysign(1.0, wanted - speed)
        # Speed gained while acceleration falls to zero with limited jerk: a² / 2j + a period / 2, in discrete steps.
        # Only the step that reaches the speed may exceed the jerk, by an eighth.
        half = most.jerk_m_s3 * period_s / 2
        highest = math.sqrt(half * half + 2 * most.jerk_m_s3 * abs(wanted - speed)) - half
        highest = min(most.acceleration_m_s2, highest)
        grown = max(self._acceleration_m_s2 * sign, 0.0) + most.jerk_m_s3 * period_s
        change = min(min(highest, grown) * period_s, abs(wanted - speed))
        self._acceleration_m_s2 = sign * change / period_s
        forward = wanted if change == abs(wanted - speed) else speed + sign * change
        self.given = VelocityCommand(forward, turn)
        return self.given
