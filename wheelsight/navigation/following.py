"""PathFollower: what all controllers share: segments one after another, turns in place, and arrival."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from wheelsight.commands import VelocityCommand
from wheelsight.errors import ArgumentError
from wheelsight.geometry import FloatArray
from wheelsight.geometry.se2 import wrap_angle
from wheelsight.navigation._field_kernels import clearance_at, free_arc, people_apart
from wheelsight.navigation.control_settings import FollowSettings
from wheelsight.navigation.control_values import ControlReason, ControlResult, DrivenPath, MotionState
from wheelsight.navigation.fields import CostField, Outline, checked, outline_of
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.segments import Segment, cut
from wheelsight.robot_limits import RobotLimits

_TURN_STEP_RAD = 0.05
# How far along a segment its nearest point is looked for at first: a plan begins where the robot is.
_FIRST_LOOK_M = 1.5
# The axle's middle moves by so much a radian while the base turns in place, since one wheel is quicker than the other.
_SWAY_M = 0.15
# Things deeper than so in the outline are no error of places: from them a way may only lead away.
_DEEP_M = 0.15
# Metres, or radians, that are a way made.
_LEAST_WAY = 0.02
_NO_SEGMENT = Segment(0, np.empty((0, 5)), np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What a robot has before it on a segment.

    Attributes:
        state: of now.
        segment: that it drives.
        point: of the segment, that it is at.
        field: the surroundings.
        people: (P, 5).
        margin_m: nearer than this to an obstacle no command leads.
    """

    state: MotionState
    segment: Segment
    point: int
    field: CostField
    people: FloatArray
    margin_m: float

    @property
    def pose(self) -> tuple[float, float, float, float]:
        """x, y, cosine and sine of the heading."""
        x, y, yaw = map(float, self.state.pose)
        return x, y, float(np.cos(yaw)), float(np.sin(yaw))

    @property
    def rest_m(self) -> float:
        """Along the segment to its end; negative beyond."""
        x, y, c, s, along = self.segment.points[self.point]
        dx, dy = self.state.pose[0] - x, self.state.pose[1] - y
        return float(self.segment.length_m - along - self.segment.direction * (dx * c + dy * s))


class Steering(Protocol):
    """Drives along a segment."""

    def steer(self, situation: Situation) -> ControlResult:
        """A command on the way."""
        ...

    def forget(self) -> None:
        """The robot stands, or follows another segment: what was before is none of that."""
        ...


class PathFollower:
    """Leads a robot through the segments of a plan, and asks a steering on each."""

    def __init__(self, footprint: Footprint, limits: RobotLimits, settings: FollowSettings, steering: Steering) -> None:
        self._outline = outline_of(footprint)
        self._limits = limits
        self._settings = settings
        self._steering = steering
        self._poses: FloatArray | None = None
        self._segments: tuple[Segment, ...] = ()
        self._index, self._point = 0, 0
        self._is_turning = False
        self._margin_m = float("nan")
        self._piece, self._least_left, self._stuck_s = (-1, False), float("inf"), 0.0

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        """See `Controller.command`."""
        people = np.asarray(people, float).reshape(-1, 5) if np.size(people) % 5 == 0 else np.full((1, 5), np.nan)
        try:
            field = checked(field)
        except (ArgumentError, TypeError, ValueError):
            return self._stand(ControlReason.INVALID)
        if not state.is_finite or not np.isfinite(people).all():
            return self._stand(ControlReason.INVALID)
        if not self._take(plan, state):
            return self._stand(ControlReason.NO_PATH)
        self._allow(state, field)
        return self._follow(state, field, np.ascontiguousarray(people))

    def _take(self, plan: DrivenPath, state: MotionState) -> bool:
        """Cut a plan, if it is another than before; whether it can be driven."""
        poses = np.asarray(plan.poses, float)
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses) or not np.isfinite(poses).all():
            self._poses = None
            return False
        if self._poses is None or not np.array_equal(poses, self._poses):
            self._poses = poses.copy()
            self._segments = cut(poses, self._settings.spacing_m, self._settings.turn_first_rad)
            self._index, self._is_turning, self._piece = 0, False, (-1, False)
            self._margin_m = float("nan")
            self._point = self._nearest(state)
        return True

    def _allow(self, state: MotionState, field: CostField) -> None:
        """Say how near things may come while this plan is driven: nearer than the margin only where it begins so.

        A planner's way out of what is too near leads past it, and a corner comes nearer before it comes free. It is
        by the plan, not by the period: else it would come nearer each time.
        """
        s, (x, y, yaw) = self._settings, map(float, state.pose)
        pose = (x, y, float(np.cos(yaw)), float(np.sin(yaw)))
        here = float(clearance_at(field, self._outline, pose, s.margin_m + s.nearer_m))
        if here > s.margin_m + s.nearer_m or here < -_DEEP_M:
            self._margin_m = s.margin_m
        elif np.isnan(self._margin_m):
            self._margin_m = min(s.margin_m, here - s.nearer_m)

    def _nearest(self, state: MotionState) -> int:
        points = self._segments[0].points if self._segments else np.empty((0, 5))
        points = points[points[:, 4] <= _FIRST_LOOK_M]
        return int(np.hypot(*(points[:, :2] - state.pose[:2]).T).argmin()) if len(points) else 0

    def _follow(self, state: MotionState, field: CostField, people: FloatArray) -> ControlResult:
        while self._index < len(self._segments):
            segment = self._segments[self._index]
            situation = Situation(state, segment, self._point, field, people, self._margin_m)
            result = self._drive(situation) if segment.direction else self._turn_to(situation, float(segment.end[2]))
            if result is not None:
                return result
            self._index, self._point, self._is_turning = self._index + 1, 0, False
            self._steering.forget()
        return self._at_goal(Situation(state, _NO_SEGMENT, 0, field, people, self._margin_m))

    def _at_goal(self, situation: Situation) -> ControlResult:
        """The last turn to the goal's heading, then what has become of it."""
        assert self._poses is not None
        goal, s, state = self._poses[-1], self._settings, situation.state
        if np.hypot(*(state.pose[:2] - goal[:2])) > s.goal_m:
            return self._stand(ControlReason.MISSED)
        if abs(wrap_angle(state.pose[2] - goal[2])) > s.goal_rad / 2 or abs(state.turn_rad_s) > s.standing_rad_s:
            turning = self._turn_to(situation, float(goal[2]))
            if turning is not None:
                return turning
        return self._stand(ControlReason.ARRIVED)

    def _unless_stuck(self, left: float, result: ControlResult, turns: bool = False) -> ControlResult:
        """The same, unless what is left, metres or radians, has become no less for too long."""
        s = self._settings
        piece = (self._index, turns)
        if piece != self._piece or left < self._least_left - _LEAST_WAY:
            self._piece, self._least_left, self._stuck_s = piece, left, 0.0
        self._stuck_s += s.period_s
        is_stuck = self._stuck_s > s.stuck_s and result.reason is None
        return self._stand(ControlReason.BLOCKED) if is_stuck else result

    def _drive(self, situation: Situation) -> ControlResult | None:
        """A command on a segment's way; None at its end."""
        s, state = self._settings, situation.state
        situation = self._advanced(situation)
        point = situation.segment.points[situation.point]
        if np.hypot(*(state.pose[:2] - point[:2])) > s.off_path_m:
            return self._stand(ControlReason.OFF_PATH)
        stands = abs(state.forward_m_s) <= s.standing_m_s
        # Slower than motors turn, the last millimetres are not driven.
        if situation.rest_m <= s.at_end_m or (stands and situation.rest_m <= 2 * s.at_end_m):
            return None if stands and abs(state.turn_rad_s) <= s.standing_rad_s else self._stand(None)
        heading = float(np.arctan2(point[3], point[2]))
        off = abs(float(wrap_angle(heading - state.pose[2])))
        if self._is_turning or (stands and off > s.turn_first_rad):
            self._is_turning = bool(off > s.turned_rad)
            turning = self._turn_to(situation, heading)
            if turning is not None:
                return turning
        return self._unless_stuck(situation.rest_m, self._steering.steer(situation))

    def _advanced(self, situation: Situation) -> Situation:
        """At the point of the segment that the robot is at now."""
        points, direction = situation.segment.points, situation.segment.direction
        xy = situation.state.pose[:2]
        while self._point < len(points) - 1:
            x, y, c, s, along = points[self._point]
            if direction * ((xy[0] - x) * c + (xy[1] - y) * s) <= (points[self._point + 1, 4] - along) / 2:
                break
            self._point += 1
        return replace(situation, point=self._point)

    def _turn_to(self, situation: Situation, yaw: float) -> ControlResult | None:
        """A turn in place; None where it is turned."""
        s, state = self._settings, situation.state
        off = float(wrap_angle(yaw - state.pose[2]))
        turns = abs(state.turn_rad_s) > s.standing_rad_s
        if abs(off) <= s.at_yaw_rad:
            return self._stand(None) if turns else None
        if abs(state.forward_m_s) > s.standing_m_s + _SWAY_M * abs(state.turn_rad_s):
            return self._stand(None)
        for way in (off, off - np.copysign(2 * np.pi, off)):
            if self._turns_freely(situation, way):
                yaws = float(state.pose[2]) + np.linspace(0, way, 1 + int(np.ceil(abs(way) / _TURN_STEP_RAD)))
                poses = np.stack([np.full(len(yaws), state.pose[0]), np.full(len(yaws), state.pose[1]), yaws], axis=-1)
                result = ControlResult(VelocityCommand(0.0, self._turn_rad_s(way, state.turn_rad_s)), None, poses)
                return self._unless_stuck(abs(way), result, turns=True)
        return self._stand(ControlReason.BLOCKED)

    def _turn_rad_s(self, way: float, turning: float) -> float:
        """The fastest turn that ends there, by what is left when the base has followed."""
        s = self._settings
        left = max(abs(way) - np.copysign(1.0, way) * turning * s.lag_s, 0.0)
        speed = min(np.sqrt(2 * s.ends_turn_rad_s2 * left), self._limits.turn_rad_s)
        return float(np.copysign(max(speed, min(s.slowest_rad_s, self._limits.turn_rad_s)), way))

    def _turns_freely(self, situation: Situation, way: float) -> bool:
        steps = int(np.ceil(abs(way) / _TURN_STEP_RAD))
        seconds = _TURN_STEP_RAD / max(self._limits.turn_rad_s, 1e-3)
        arc = (0.0, way / steps, seconds, steps)
        margin, near = situation.margin_m, self._settings.people_margin_m
        people = situation.people + np.array([0, 0, 0, 0, near - margin])
        return bool(free_arc(situation.field, self._outline, people, situation.pose, arc, margin) == steps)

    def _stand(self, reason: ControlReason | None) -> ControlResult:
        self._steering.forget()
        return ControlResult.standing(reason)


def clearances(situation: Situation, outline: Outline) -> tuple[float, float]:
    """How far obstacles and people are from the footprint now."""
    clearance = clearance_at(situation.field, outline, situation.pose, situation.margin_m)
    return float(clearance), float(people_apart(situation.people, outline, situation.pose, 0.0))
