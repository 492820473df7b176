"""PathFollower: the common part of both controllers. It splits a path into segments, turns in place, and detects
arrival. Also the interface of controllers.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import pairwise
from typing import Protocol

import numpy as np

from wheelsight.core.checks import answer_of, array_of
from wheelsight.core.errors import ArgumentError, PartError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.core.robots import RobotLimits
from wheelsight.navigation.clearance_kernels import CostField, Outline, clearance_at, free_arc, people_apart
from wheelsight.navigation.footprint import Footprint, checked, outline_of
from wheelsight.navigation.settings import FollowSettings

_NO_POSES = np.empty((0, 3))
_NO_POSES.setflags(write=False)


class ControlReason(StrEnum):
    """Why a controller stops a robot."""

    ARRIVED = "arrived"
    MISSED = "stands at the end of the plan, and off the goal"
    BLOCKED = "no way on that keeps clear"
    OFF_PATH = "too far from the plan"
    NO_PATH = "a plan that cannot be driven"
    INVALID = "numbers that are not finite"


@dataclass(frozen=True, slots=True, eq=False)
class MotionState:
    """Pose and velocity of a robot.

    Attributes:
        pose: (3,) x, y, yaw of `base` in the frame of the plan.
        forward_m_s: measured forward speed.
        turn_rad_s: measured turn rate.
    """

    pose: FloatArray
    forward_m_s: float = 0.0
    turn_rad_s: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        pose = np.asarray(self.pose, float)
        return pose.shape == (3,) and bool(np.isfinite([*pose, self.forward_m_s, self.turn_rad_s]).all())


class DrivenPath(Protocol):
    """A plan as a controller needs it.

    The poses imply the directions: a section against its headings is driven backward, and two poses at one place are a
    turn in place.
    """

    @property
    def poses(self) -> FloatArray:
        """(N, 3) x, y, yaw."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ControlResult:
    """Command of a controller for one period.

    Attributes:
        command: velocity command; a stop if there is a reason.
        reason: why the robot must stop; None while it drives.
        predicted: (T, 3) predicted poses; (0, 3) for a stop.
    """

    command: VelocityCommand
    reason: ControlReason | None = None
    predicted: FloatArray = field(default_factory=lambda: _NO_POSES)

    @classmethod
    def standing(cls, reason: ControlReason | None) -> ControlResult:
        """Return a stop."""
        return cls(STOP, reason)

    @property
    def has_arrived(self) -> bool:
        """Whether the robot stands at the goal."""
        return self.reason is ControlReason.ARRIVED


class Controller(Protocol):
    """Follows a plan, as `MppiController` and `PurePursuitController` do. `Navigator` accepts any other one.

    Each command passes the limits of the robot and the collision monitor. An exception or an answer of another type
    stops the robot, and ends the task with `NavigationReason.CONTROLLER`.
    """

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        """Return the command for a period. The call is between two steps of the robot, so it must be fast.

        `ControlResult(command)` drives. `ControlResult.standing(reason)` stops: `ARRIVED` ends the plan, and counts
        within `follow.goal_m` and `goal_rad` of its end; `BLOCKED` waits; other reasons request another plan.

        Args:
            state: current pose and velocity.
            plan: the same object until the plan changes.
            field: costmap around the robot, in the frame of the plan.
            people: (P, 5) x, y, vx, vy, radius in that frame, with constant velocities.
        """
        ...


_TURN_STEP_RAD = 0.05
# Length of a segment in which its first nearest point is searched: a plan begins at the robot.
_FIRST_LOOK_M = 1.5
# Motion of the axle's centre per radian of a turn in place, as one wheel is faster than the other.
_SWAY_M = 0.15
# Obstacles deeper than this inside the outline are no pose errors, so a path may only lead away from them.
_DEEP_M = 0.15
# Least progress, in metres or radians.
_LEAST_WAY = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What a steering gets on a segment.

    Attributes:
        state: current pose and velocity.
        segment: the current segment.
        point: index of the segment's point at the robot.
        field: costmap around the robot.
        people: (P, 5) as in `Controller.command`.
        margin_m: least distance to obstacles of any command.
    """

    state: MotionState
    segment: Segment
    point: int
    field: CostField
    people: FloatArray
    margin_m: float

    @property
    def pose(self) -> tuple[float, float, float, float]:
        """Pose as x, y, cosine and sine of the heading."""
        x, y, yaw = map(float, self.state.pose)
        return x, y, float(np.cos(yaw)), float(np.sin(yaw))

    @property
    def rest_m(self) -> float:
        """Distance along the segment to its end; negative beyond."""
        x, y, c, s, along = self.segment.points[self.point]
        dx, dy = self.state.pose[0] - x, self.state.pose[1] - y
        return float(self.segment.length_m - along - self.segment.direction * (dx * c + dy * s))


class Steering(Protocol):
    """Computes commands along a segment."""

    def steer(self, situation: Situation) -> ControlResult:
        """Return the command of a period."""
        ...

    def forget(self) -> None:
        """Clear its state: the robot stands, or another segment begins."""
        ...


class PathFollower:
    """Drives a robot along the segments of a plan, with a steering for each, and turns it in place between them."""

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
        """Return the command of a period; see `Controller.command`."""
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
        """Split a new plan into segments; return whether it can be driven."""
        poses = np.asarray(plan.poses, float)
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses) or not np.isfinite(poses).all():
            self._poses = None
            return False
        if self._poses is None or not np.array_equal(poses, self._poses):
            self._poses = poses.copy()
            self._segments = cut(poses, self._settings.spacing_m, self._settings.turn_first_rad)
            self._index, self._is_turning, self._piece = 0, False, (-1, False)
            self._margin_m = float("nan")
            points = self._segments[0].points if self._segments else np.empty((0, 5))
            points = points[points[:, 4] <= _FIRST_LOOK_M]
            self._point = int(np.hypot(*(points[:, :2] - state.pose[:2]).T).argmin()) if len(points) else 0
        return True

    def _allow(self, state: MotionState, field: CostField) -> None:
        """Set the least distance to obstacles for this plan. It is below the margin only if the plan begins so.

        A path out of a tight place passes the obstacle, and a corner comes nearer before it becomes free. The distance
        is fixed per plan rather than per period; otherwise the robot would come nearer each period.
        """
        s, (x, y, yaw) = self._settings, map(float, state.pose)
        pose = (x, y, float(np.cos(yaw)), float(np.sin(yaw)))
        here = float(clearance_at(field, self._outline, pose, s.margin_m + s.nearer_m))
        if here > s.margin_m + s.nearer_m or here < -_DEEP_M:
            self._margin_m = s.margin_m
        elif np.isnan(self._margin_m):
            self._margin_m = min(s.margin_m, here - s.nearer_m)

    def _follow(self, state: MotionState, field: CostField, people: FloatArray) -> ControlResult:
        """Drive the current segment, or the next one once it is complete."""
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
        """Turn to the goal's heading, then report arrival, or that the goal was missed."""
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
        """Return the result, or `BLOCKED` if what is left, metres or radians, has not decreased for too long."""
        s = self._settings
        piece = (self._index, turns)
        if piece != self._piece or left < self._least_left - _LEAST_WAY:
            self._piece, self._least_left, self._stuck_s = piece, left, 0.0
        self._stuck_s += s.period_s
        is_stuck = self._stuck_s > s.stuck_s and result.reason is None
        return self._stand(ControlReason.BLOCKED) if is_stuck else result

    def _drive(self, situation: Situation) -> ControlResult | None:
        """Return a command along a segment; None at its end."""
        s, state = self._settings, situation.state
        points, direction = situation.segment.points, situation.segment.direction
        # The point of the segment that the robot has reached.
        while self._point < len(points) - 1:
            x, y, cos, sin, along = points[self._point]
            ahead_m = direction * ((state.pose[0] - x) * cos + (state.pose[1] - y) * sin)
            if ahead_m <= (points[self._point + 1, 4] - along) / 2:
                break
            self._point += 1
        situation = replace(situation, point=self._point)
        point = points[self._point]
        if np.hypot(*(state.pose[:2] - point[:2])) > s.off_path_m:
            return self._stand(ControlReason.OFF_PATH)
        stands = abs(state.forward_m_s) <= s.standing_m_s
        # Motors do not turn slowly enough for the last millimetres.
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

    def _turn_to(self, situation: Situation, yaw: float) -> ControlResult | None:
        """Return a turn in place; None once it is complete."""
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
                # The fastest turn that ends at the yaw, including the lag of the base.
                left = max(abs(way) - np.copysign(1.0, way) * state.turn_rad_s * s.lag_s, 0.0)
                speed = min(np.sqrt(2 * s.ends_turn_rad_s2 * left), self._limits.turn_rad_s)
                speed = float(np.copysign(max(speed, min(s.slowest_rad_s, self._limits.turn_rad_s)), way))
                result = ControlResult(VelocityCommand(0.0, speed), None, poses)
                return self._unless_stuck(abs(way), result, turns=True)
        return self._stand(ControlReason.BLOCKED)

    def _turns_freely(self, situation: Situation, way: float) -> bool:
        """Return whether a turn in place by an angle meets nothing."""
        steps = int(np.ceil(abs(way) / _TURN_STEP_RAD))
        seconds = _TURN_STEP_RAD / max(self._limits.turn_rad_s, 1e-3)
        arc = (0.0, way / steps, seconds, steps)
        margin, near = situation.margin_m, self._settings.people_margin_m
        people = situation.people + np.array([0, 0, 0, 0, near - margin])
        return bool(free_arc(situation.field, self._outline, people, situation.pose, arc, margin) == steps)

    def _stand(self, reason: ControlReason | None) -> ControlResult:
        """Stop, and reset the steering."""
        self._steering.forget()
        return ControlResult.standing(reason)


def clearances(situation: Situation, outline: Outline) -> tuple[float, float]:
    """Return the distances of obstacles and of people from the footprint."""
    clearance = clearance_at(situation.field, outline, situation.pose, situation.margin_m)
    return float(clearance), float(people_apart(situation.people, outline, situation.pose, 0.0))


class OwnController:
    """Wraps a user's controller and checks its answers.

    Args:
        part: the user's controller.
        goal_m, goal_rad: distance from the end of a plan that counts as arrived.

    Raises:
        PartError: in `command`, for an invalid answer.
    """

    def __init__(self, part: Controller, goal_m: float, goal_rad: float) -> None:
        self._part, self._goal_m, self._goal_rad = part, goal_m, goal_rad

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        """Return the checked answer of the controller. An arrival away from the goal becomes `MISSED`."""
        name = f"{type(self._part).__name__}.command"
        found = answer_of(self._part, "command", state, plan, field, people)
        if not isinstance(found, ControlResult) or not isinstance(found.command, VelocityCommand):
            fix = "ControlResult(VelocityCommand(...)), or ControlResult.standing(ControlReason....)"
            raise PartError(f"{name} answered {type(found).__name__}, not a ControlResult", fix=fix)
        try:
            predicted = array_of("predicted", found.predicted, (len(found.predicted), 3))
        except (ArgumentError, TypeError) as error:
            raise PartError(f"{name}: {error}", fix="predicted is (T, 3)") from error
        if found.reason is not None:
            x, y, yaw = state.pose - np.asarray(plan.poses, float)[-1]
            is_there = np.hypot(x, y) <= self._goal_m and abs(wrap_angle(yaw)) <= self._goal_rad
            return ControlResult.standing(found.reason if is_there or not found.has_arrived else ControlReason.MISSED)
        return ControlResult(found.command, None, predicted[np.isfinite(predicted).all(axis=1)])


# Poses closer than this are equal.
_SAME_M, _SAME_RAD = 1e-3, 1e-3
# Largest turn in one segment: the direction of half a turn and more is ambiguous.
_MOST_TURN_RAD = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Part of a path between two standstills.

    Attributes:
        direction: 1 forward, -1 backward, 0 a turn in place.
        points: (M, 5) x, y, cosine and sine of the robot's heading, metres along; (0, 5) for a turn.
        end: (3,) x, y, yaw of its end.
    """

    direction: int
    points: FloatArray
    end: FloatArray

    @property
    def length_m(self) -> float:
        """Length of the way; 0 for a turn."""
        return float(self.points[-1, 4]) if len(self.points) else 0.0


_NO_SEGMENT = Segment(0, np.empty((0, 5)), np.zeros(3))


def cut(poses: FloatArray, spacing_m: float, kink_rad: float) -> tuple[Segment, ...]:
    """Split a path into segments where the robot turns in place or changes its direction.

    Args:
        poses: (N, 3) x, y, yaw, finite.
        spacing_m: largest distance between points of a segment.
        kink_rad: a bend above this angle becomes a turn in place.
    """
    made = _Cutter(poses[0], spacing_m)
    for before, after in pairwise(poses):
        way = after[:2] - before[:2]
        if np.hypot(*way) >= _SAME_M:
            made.drive(way, before, after, kink_rad)
        elif abs(wrap_angle(after[2] - before[2])) > _SAME_RAD:
            made.turn(after)
    made.turn(poses[-1])
    return tuple(made.segments)


class _Cutter:
    """Joins parts of a path into segments."""

    def __init__(self, first: FloatArray, spacing_m: float) -> None:
        self.segments: list[Segment] = []
        self._spacing_m = spacing_m
        self._yaw = float(first[2])
        self._nodes = [first[:2]]
        self._headings: list[float] = []
        self._direction = 0
        self._turned = 0.0

    def drive(self, way: FloatArray, before: FloatArray, after: FloatArray, kink_rad: float) -> None:
        """Add a straight part; join it with the ones before unless the robot must stop between."""
        along = float(np.arctan2(way[1], way[0]))
        by_before, by_after = np.cos(along - before[2]), np.cos(along - after[2])
        # The heading at the start or at the goal may differ from that of the way, so the closer one decides.
        direction = 1 if (by_before if abs(by_before) > abs(by_after) else by_after) >= 0 else -1
        heading = along if direction > 0 else float(wrap_angle(along + np.pi))
        if self._direction and (direction != self._direction or abs(wrap_angle(heading - self._yaw)) > kink_rad):
            self.turn(np.array([*before[:2], heading]))
        self._nodes.append(after[:2])
        self._headings.append(heading)
        self._direction, self._yaw = direction, heading

    def turn(self, pose: FloatArray) -> None:
        """End the current segment, and add a turn to a pose's yaw if it differs."""
        if self._headings:
            self.segments.append(_driven(np.array(self._nodes), self._headings, self._direction, self._spacing_m))
        turn = float(wrap_angle(pose[2] - self._yaw))
        if abs(turn) > _SAME_RAD:
            # Consecutive turns to one side are one segment, while their direction is unambiguous.
            goes_on = bool(self.segments) and not self.segments[-1].direction and not self._headings
            if goes_on and turn * self._turned > 0 and abs(turn + self._turned) < _MOST_TURN_RAD:
                self.segments.pop()
                turn += self._turned
            self._turned = turn
            self.segments.append(Segment(0, np.empty((0, 5)), np.array([*self._nodes[-1], pose[2]])))
        self._yaw, self._nodes = float(pose[2]), [pose[:2]]
        self._headings, self._direction = [], 0


def _driven(nodes: FloatArray, headings: list[float], direction: int, spacing_m: float) -> Segment:
    """Return a segment along straight lines, with a limited spacing of its points."""
    rows = []
    along = 0.0
    for before, after, heading in zip(nodes[:-1], nodes[1:], headings, strict=True):
        length = float(np.hypot(*(after - before)))
        shares = np.arange(max(int(np.ceil(length / spacing_m)), 1)) / max(int(np.ceil(length / spacing_m)), 1)
        c, s = np.cos(heading), np.sin(heading)
        rows += [(*(before + share * (after - before)), c, s, along + share * length) for share in shares]
        along += length
    rows.append((*nodes[-1], np.cos(headings[-1]), np.sin(headings[-1]), along))
    return Segment(direction, np.array(rows), np.array([*nodes[-1], headings[-1]]))
