"""Controllers: model predictive path integral control (MPPI) and regulated pure pursuit.

`PathFollower` is their common part: it splits a path into segments, turns in place, and detects arrival.
`OwnController` checks a user's controller.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import pairwise
from typing import Protocol

import numpy as np

from wheelsight.core.checks import answer_of, array_of
from wheelsight.core.errors import ArgumentError, PartError
from wheelsight.core.geometry import Float32Array, FloatArray
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.core.robots import CONTROL_PERIOD_S, RobotLimits
from wheelsight.navigation.clearance_kernels import (
    CostField,
    Outline,
    clearance_at,
    cost_and_speed_at,
    free_arc,
    moved,
    people_apart,
)
from wheelsight.navigation.mppi_kernels import (
    Begin,
    Dynamics,
    PathAhead,
    RolloutWeights,
    blend,
    costs_of,
    draw,
    roll_out,
)
from wheelsight.navigation.settings import FollowSettings, Footprint, MppiSettings, checked, outline_of

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
            plan: the same object until the plan changes.
            people: (P, 5) x, y, vx, vy, radius in that frame, with constant velocities.
        """
        ...


# Steps of a control period each (Nav2's default): 2.8 s ahead, more than a stop takes.
_STEPS = 56
# Seed of the noise, which is drawn once; steps between independent draws, linear between them, as white noise hardly
# moves a robot.
_SEED, _KNOT_STEPS = 20, 7
# Share of rollouts with a quarter of the noise, for exact driving near the last commands; and of rollouts with three
# draws in all, as a detour around a person turns for a second and more (found on kinematic drives of the tests alone).
_FINE_SHARE, _LONG_SHARE = 0.5, 0.25
# Standard deviations of sampled speeds, m/s and rad/s.
_SPREAD = (0.25, 0.5)
# Cost difference that reduces a rollout's weight to 1/e: lower follows the best, higher is smoother (kinematic drives).
_TEMPERATURE = 0.2


class Rollouts:
    """Steering by rollouts of command sequences."""

    def __init__(self, outline: Outline, limits: RobotLimits, rollouts: int, follow: FollowSettings) -> None:
        self._follow, self._limits = follow, limits
        self._dynamics = dynamics_of(outline, limits, follow.lag_s)
        self._weights = RolloutWeights(follow.margin_m, follow.people_margin_m)
        self._noise = noise_of(rollouts)
        self._drawn = np.empty_like(self._noise)
        self._costs = np.empty(rollouts)
        self._nominal = np.zeros((_STEPS, 2))

    def forget(self) -> None:
        """Reset the nominal commands to a standstill."""
        self._nominal[:] = 0.0

    def steer(self, situation: Situation) -> ControlResult:
        """Return the mean of all rollouts, or the best one if that collides, or a stop if both collide."""
        given = self.given(situation)
        self._nominal[:-1] = self._nominal[1:]
        costs, drawn = self.costs(given)
        mean = np.empty_like(self._nominal)
        best = blend(costs, drawn, _TEMPERATURE, mean)
        poses = np.empty((len(mean), 3))
        for commands in (mean.astype(np.float32), drawn[best]):
            _, contact = roll_out(*given, commands, poses)
            if contact == len(mean):
                self._nominal[:] = commands
                v, w = float(commands[0][0]), float(commands[0][1])
                # Speed zones and the distance to the segment's end limit the first command.
                at_end = _speed_to_stop(situation.rest_m, self._follow.lag_s)
                zone = cost_and_speed_at(situation.field, situation.pose[0], situation.pose[1])[1]
                most = max(min(at_end, zone), min(_SLOWEST_M_S, zone))
                if abs(v) > most:
                    v, w = float(np.copysign(most, v)), w * most / abs(v)
                return ControlResult(VelocityCommand(v, w), None, poses.copy())
        self.forget()
        return ControlResult.standing(ControlReason.BLOCKED)

    def given(self, situation: Situation) -> tuple[Begin, PathAhead, CostField, FloatArray, Dynamics, RolloutWeights]:
        """Return everything that a rollout needs besides its commands."""
        state, segment = situation.state, situation.segment
        # The segment from the robot on, as far as rollouts reach.
        ahead_m = self._limits.forward_m_s * _STEPS * CONTROL_PERIOD_S + 1.0
        points = segment.points[situation.point :]
        points = points[points[:, 4] <= points[0, 4] + ahead_m]
        most = np.sqrt(2 * _ENDS_M_S2 * (segment.length_m - points[:, 4]))
        way = PathAhead(np.ascontiguousarray(np.column_stack([points, most])), float(segment.direction))
        x, y, yaw = map(float, state.pose)
        near = clearances(situation, self._dynamics.outline)
        begin = Begin(x, y, yaw, float(state.forward_m_s), float(state.turn_rad_s), 0, *near)
        weights = self._weights._replace(margin_m=situation.margin_m)
        return begin, way, situation.field, situation.people, self._dynamics, weights

    def costs(
        self, given: tuple[Begin, PathAhead, CostField, FloatArray, Dynamics, RolloutWeights]
    ) -> tuple[FloatArray, Float32Array]:
        """Return costs (K,) of commands (K, T, 2) around the nominal ones. The next call overwrites both arrays."""
        draw(self._nominal, self._noise, _SPREAD, self._dynamics, self._drawn)
        costs_of(*given, self._drawn, self._costs)
        return self._costs, self._drawn


def noise_of(rollouts: int) -> Float32Array:
    """Return standard noise (K, T, 2), linear between knots, each row followed by its negative."""
    rng = np.random.default_rng(_SEED)
    pairs = (rollouts + 1) // 2
    fine, long = int(_FINE_SHARE * pairs), int(_LONG_SHARE * pairs)
    smooth = _between_knots(rng, pairs, _STEPS, _KNOT_STEPS)
    smooth[:fine] /= 4
    smooth[fine : fine + long] = _between_knots(rng, len(smooth[fine : fine + long]), _STEPS, _STEPS // 2)
    both = np.stack([smooth, -smooth], axis=1).reshape(-1, _STEPS, 2)
    return np.ascontiguousarray(both[:rollouts], np.float32)


def _between_knots(rng: np.random.Generator, rows: int, steps: int, knot_steps: int) -> FloatArray:
    """Return (rows, steps, 2) standard noise at knots, interpolated between them."""
    drawn = rng.standard_normal((rows, steps // knot_steps + 2, 2))
    at = np.arange(steps) / knot_steps
    before, share = at.astype(int), (at % 1)[:, None]
    return np.asarray(drawn[:, before] * (1 - share) + drawn[:, before + 1] * share)


def dynamics_of(outline: Outline, limits: RobotLimits, lag_s: float) -> Dynamics:
    """Return the dynamics of a base for steps of a control period."""
    step_s = CONTROL_PERIOD_S
    return Dynamics(
        outline,
        limits.forward_m_s,
        limits.backward_m_s,
        limits.turn_rad_s,
        limits.acceleration_m_s2 * step_s,
        limits.braking_m_s2 * step_s,
        limits.turn_acceleration_rad_s2 * step_s,
        float(1 - np.exp(-step_s / lag_s)),
        step_s,
        float(np.linalg.norm(outline.sides[:, :2], axis=1).max()),
    )


# Time at the current speed to the lookahead point, and limits of its distance: below the least a base with lag
# oscillates (kinematic drives of the tests); the largest is Nav2's default.
_LOOKAHEAD_S, _LEAST_LOOKAHEAD_M, _MOST_LOOKAHEAD_M = 0.8, 0.5, 0.9
# Curve radius (Nav2's default) and clearance below which the speed decreases in proportion, and the least speed by
# both.
_CURVE_M, _NEAR_M, _NEAR_M_S = 0.9, 0.2, 0.15
# Of the check of the free way: reaction time before it brakes, the share of the base's braking that is assumed, and the
# spacing of the poses of an arc, a cell of most maps.
_AHEAD_S, _BRAKING_SHARE, _STEP_M = 0.3, 0.5, 0.05
# The base's lag that the reaction time includes: the default of `FollowSettings.lag_s`.
_USUAL_LAG_S = 0.15


class _Arcs:
    """Steering along arcs."""

    def __init__(self, outline: Outline, limits: RobotLimits, follow: FollowSettings) -> None:
        self._outline, self._limits, self._follow = outline, limits, follow

    def forget(self) -> None:
        """Do nothing: it has no state."""

    def steer(self, situation: Situation) -> ControlResult:
        """Return the command along an arc to the point ahead, at the highest permitted speed."""
        # The curvature of the arc to the point ahead. Beyond a segment's end the path goes straight on.
        segment, direction = situation.segment, situation.segment.direction
        ahead_m = abs(situation.state.forward_m_s) * _LOOKAHEAD_S
        ahead_m = min(max(ahead_m, _LEAST_LOOKAHEAD_M), _MOST_LOOKAHEAD_M)
        along = segment.length_m - situation.rest_m + ahead_m
        points = segment.points
        target = np.array([np.interp(along, points[:, 4], points[:, k]) for k in (0, 1)])
        beyond = max(along - segment.length_m, 0.0) * direction
        dx, dy = target + beyond * points[-1, 2:4] - situation.state.pose[:2]
        _, _, c, s = situation.pose
        x, y = c * dx + s * dy, -s * dx + c * dy
        curvature = float(2 * y / max(x * x + y * y, _LEAST_LOOKAHEAD_M**2 / 4))
        most = self._limits.forward_m_s if direction > 0 else self._limits.backward_m_s
        clearance = min(clearances(situation, self._outline))
        by_curve = most / max(_CURVE_M * abs(curvature), 1.0)
        by_nearness = most * min(max(clearance - self._follow.margin_m, 0.0) / _NEAR_M, 1.0)
        regulated = max(min(by_curve, by_nearness), min(_NEAR_M_S, most))
        speed = min(most, regulated, _speed_to_stop(situation.rest_m, self._follow.lag_s))
        if curvature:
            speed = min(speed, self._limits.turn_rad_s / abs(curvature))
        speed = min(speed, cost_and_speed_at(situation.field, situation.pose[0], situation.pose[1])[1])
        # The free length of the arc, as far as it matters at this speed.
        # A lag that exceeds the reaction time is that of a measured drive.
        t = max(_AHEAD_S, self._follow.lag_s + _AHEAD_S - _USUAL_LAG_S)
        b, margin_m = _BRAKING_SHARE * self._limits.braking_m_s2, situation.margin_m
        fastest = max(speed, abs(situation.state.forward_m_s))
        steps = 2 + int(np.ceil((fastest**2 / (2 * b) + fastest * t) / _STEP_M))
        step_m = direction * _STEP_M
        people = situation.people + np.array([0, 0, 0, 0, self._follow.people_margin_m - margin_m])
        arc = (step_m, step_m * curvature, _STEP_M / max(fastest, _SLOWEST_M_S), steps)
        free_m = float(free_arc(situation.field, self._outline, people, situation.pose, arc, margin_m)) * _STEP_M
        # The speed from which it stops within the free way, after it has driven on for a time.
        speed = min(speed, float(np.sqrt((b * t) ** 2 + 2 * b * max(free_m, 0.0)) - b * t))
        if free_m <= 0 or speed <= 0:
            return ControlResult.standing(ControlReason.BLOCKED)
        speed = min(max(speed, _SLOWEST_M_S), most)
        command = VelocityCommand(direction * speed, direction * speed * curvature)
        pose, poses = situation.pose, []
        for _ in range(max(int(min(free_m, situation.rest_m) / _STEP_M), 1)):
            pose = moved(pose, step_m, step_m * curvature)
            poses.append((pose[0], pose[1], np.arctan2(pose[3], pose[2])))
        return ControlResult(command, None, np.array(poses))


def _speed_to_stop(rest_m: float, lag_s: float) -> float:
    """Return the speed from which the robot stops at a segment's end, including the lag of the base."""
    a = _ENDS_M_S2
    return float(np.sqrt((a * lag_s) ** 2 + 2 * a * max(rest_m, 0.0)) - a * lag_s)


# Spacing of points along a path: a cell of most maps.
_SPACING_M = 0.05
# How much nearer a plan may lead that begins nearer to an obstacle than the margin: how much a corner approaches in a
# turn away from a wall, and the error of following it.
_NEARER_M = 0.02
# Deviation from the path's heading at which a standing robot first turns in place (Nav2: 0.785), and at which such a
# turn ends.
_TURN_FIRST_RAD, _TURNED_RAD = 0.8, 0.05
# Decelerations toward the end of a turn in place, below what the base can do, as it lags; and of a segment: more is
# rough for a rider.
_ENDS_TURN_RAD_S2, _ENDS_M_S2 = 0.6, 0.3
# Least speeds of a command besides a stop: motors do not turn at less.
_SLOWEST_M_S, _SLOWEST_RAD_S = 0.04, 0.06
# Distance before a segment's end, and angle before a turn's end, at which it is complete.
_AT_END_M, _AT_YAW_RAD = 0.01, 0.015
# Distance from the path beyond which a new plan is needed; detours around people are less.
_OFF_PATH_M = 1.5
# Time without progress before a robot counts as blocked.
STUCK_S = 3.0
# Speeds below which a robot stands: the encoders' resolution.
_STANDING_M_S, _STANDING_RAD_S = 0.02, 0.05
_TURN_STEP_RAD = 0.05
# Length of a segment in which its first nearest point is searched: a plan begins at the robot.
_FIRST_LOOK_M = 1.5
# Motion of the axle's centre per radian of a turn in place, as one wheel is faster than the other.
_SWAY_M = 0.15
# Obstacles deeper than this inside the outline are no pose errors, so a path may only lead away from them.
_DEEP_M = 0.15
# Least progress, in metres or radians.
_LEAST_WAY = 0.02


def stands(forward_m_s: float, turn_rad_s: float) -> bool:
    """Return whether a robot with these speeds stands."""
    return abs(forward_m_s) <= _STANDING_M_S and abs(turn_rad_s) <= _STANDING_RAD_S


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What a steering gets on a segment.

    Attributes:
        point: index of the segment's point at the robot.
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


class PathFollower:
    """Drives a robot along the segments of a plan, with a steering for each, and turns it in place between them."""

    def __init__(
        self, footprint: Footprint, limits: RobotLimits, settings: FollowSettings, steering: Rollouts | _Arcs
    ) -> None:
        self._outline, self._limits = outline_of(footprint), limits
        self._settings, self._steering = settings, steering
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
        poses = np.asarray(plan.poses, float)
        if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses) or not np.isfinite(poses).all():
            self._poses = None
            return self._stand(ControlReason.NO_PATH)
        if self._poses is None or not np.array_equal(poses, self._poses):
            self._poses = poses.copy()
            self._segments = cut(poses)
            self._index, self._is_turning, self._piece = 0, False, (-1, False)
            self._margin_m = float("nan")
            points = self._segments[0].points if self._segments else np.empty((0, 5))
            points = points[points[:, 4] <= _FIRST_LOOK_M]
            self._point = int(np.hypot(*(points[:, :2] - state.pose[:2]).T).argmin()) if len(points) else 0
        # The least distance to obstacles for this plan is below the margin only if the plan begins so: a path out of a
        # tight place passes the obstacle, and a corner comes nearer before it becomes free. It is fixed per plan rather
        # than per period; otherwise the robot would come nearer each period.
        s, (x, y, yaw) = self._settings, map(float, state.pose)
        pose = (x, y, float(np.cos(yaw)), float(np.sin(yaw)))
        here = float(clearance_at(field, self._outline, pose, s.margin_m + _NEARER_M))
        if here > s.margin_m + _NEARER_M or here < -_DEEP_M:
            self._margin_m = s.margin_m
        elif np.isnan(self._margin_m):
            self._margin_m = min(s.margin_m, here - _NEARER_M)
        return self._follow(state, field, np.ascontiguousarray(people))

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
        # Turn to the goal's heading, then report arrival, or that the goal was missed.
        assert self._poses is not None
        goal, s = self._poses[-1], self._settings
        if np.hypot(*(state.pose[:2] - goal[:2])) > s.goal_m:
            return self._stand(ControlReason.MISSED)
        if abs(wrap_angle(state.pose[2] - goal[2])) > s.goal_rad / 2 or abs(state.turn_rad_s) > _STANDING_RAD_S:
            situation = Situation(state, _NO_SEGMENT, 0, field, people, self._margin_m)
            turning = self._turn_to(situation, float(goal[2]))
            if turning is not None:
                return turning
        return self._stand(ControlReason.ARRIVED)

    def _unless_stuck(self, left: float, result: ControlResult, turns: bool = False) -> ControlResult:
        """Return the result, or `BLOCKED` if what is left, metres or radians, has not decreased for too long."""
        piece = (self._index, turns)
        if piece != self._piece or left < self._least_left - _LEAST_WAY:
            self._piece, self._least_left, self._stuck_s = piece, left, 0.0
        self._stuck_s += CONTROL_PERIOD_S
        is_stuck = self._stuck_s > STUCK_S and result.reason is None
        return self._stand(ControlReason.BLOCKED) if is_stuck else result

    def _drive(self, situation: Situation) -> ControlResult | None:
        """Return a command along a segment; None at its end."""
        state = situation.state
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
        if np.hypot(*(state.pose[:2] - point[:2])) > _OFF_PATH_M:
            return self._stand(ControlReason.OFF_PATH)
        stands = abs(state.forward_m_s) <= _STANDING_M_S
        # Motors do not turn slowly enough for the last millimetres.
        if situation.rest_m <= _AT_END_M or (stands and situation.rest_m <= 2 * _AT_END_M):
            return None if stands and abs(state.turn_rad_s) <= _STANDING_RAD_S else self._stand(None)
        heading = float(np.arctan2(point[3], point[2]))
        off = abs(float(wrap_angle(heading - state.pose[2])))
        if self._is_turning or (stands and off > _TURN_FIRST_RAD):
            self._is_turning = bool(off > _TURNED_RAD)
            turning = self._turn_to(situation, heading)
            if turning is not None:
                return turning
        return self._unless_stuck(situation.rest_m, self._steering.steer(situation))

    def _turn_to(self, situation: Situation, yaw: float) -> ControlResult | None:
        """Return a turn in place; None once it is complete."""
        s, state = self._settings, situation.state
        off = float(wrap_angle(yaw - state.pose[2]))
        turns = abs(state.turn_rad_s) > _STANDING_RAD_S
        if abs(off) <= _AT_YAW_RAD:
            return self._stand(None) if turns else None
        if abs(state.forward_m_s) > _STANDING_M_S + _SWAY_M * abs(state.turn_rad_s):
            return self._stand(None)
        for way in (off, off - np.copysign(2 * np.pi, off)):
            # Whether the turn meets nothing.
            steps = int(np.ceil(abs(way) / _TURN_STEP_RAD))
            arc = (0.0, way / steps, _TURN_STEP_RAD / max(self._limits.turn_rad_s, 1e-3), steps)
            margin, near = situation.margin_m, s.people_margin_m
            people = situation.people + np.array([0, 0, 0, 0, near - margin])
            if free_arc(situation.field, self._outline, people, situation.pose, arc, margin) == steps:
                yaws = float(state.pose[2]) + np.linspace(0, way, 1 + int(np.ceil(abs(way) / _TURN_STEP_RAD)))
                poses = np.stack([np.full(len(yaws), state.pose[0]), np.full(len(yaws), state.pose[1]), yaws], axis=-1)
                # The fastest turn that ends at the yaw, including the lag of the base.
                left = max(abs(way) - np.copysign(1.0, way) * state.turn_rad_s * s.lag_s, 0.0)
                speed = min(np.sqrt(2 * _ENDS_TURN_RAD_S2 * left), self._limits.turn_rad_s)
                speed = float(np.copysign(max(speed, min(_SLOWEST_RAD_S, self._limits.turn_rad_s)), way))
                result = ControlResult(VelocityCommand(0.0, speed), None, poses)
                return self._unless_stuck(abs(way), result, turns=True)
        return self._stand(ControlReason.BLOCKED)

    def _stand(self, reason: ControlReason | None) -> ControlResult:
        """Stop, and reset the steering."""
        self._steering.forget()
        return ControlResult.standing(reason)


def clearances(situation: Situation, outline: Outline) -> tuple[float, float]:
    """Return the distances of obstacles and of people from the footprint."""
    clearance = clearance_at(situation.field, outline, situation.pose, situation.margin_m)
    return float(clearance), float(people_apart(situation.people, outline, situation.pose, 0.0))


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


def cut(poses: FloatArray) -> tuple[Segment, ...]:
    """Split a path (N, 3) into segments where the robot turns in place, as at sharp bends, or changes its direction."""
    made = _Cutter(poses[0])
    for before, after in pairwise(poses):
        way = after[:2] - before[:2]
        if np.hypot(*way) >= _SAME_M:
            made.drive(way, before, after)
        elif abs(wrap_angle(after[2] - before[2])) > _SAME_RAD:
            made.turn(after)
    made.turn(poses[-1])
    return tuple(made.segments)


class _Cutter:
    """Joins parts of a path into segments."""

    def __init__(self, first: FloatArray) -> None:
        self.segments: list[Segment] = []
        self._yaw = float(first[2])
        self._nodes = [first[:2]]
        self._headings: list[float] = []
        self._direction = 0
        self._turned = 0.0

    def drive(self, way: FloatArray, before: FloatArray, after: FloatArray) -> None:
        """Add a straight part; join it with the ones before unless the robot must stop between."""
        along = float(np.arctan2(way[1], way[0]))
        by_before, by_after = np.cos(along - before[2]), np.cos(along - after[2])
        # The heading at the start or at the goal may differ from that of the way, so the closer one decides.
        direction = 1 if (by_before if abs(by_before) > abs(by_after) else by_after) >= 0 else -1
        heading = along if direction > 0 else float(wrap_angle(along + np.pi))
        if self._direction and (direction != self._direction or abs(wrap_angle(heading - self._yaw)) > _TURN_FIRST_RAD):
            self.turn(np.array([*before[:2], heading]))
        self._nodes.append(after[:2])
        self._headings.append(heading)
        self._direction, self._yaw = direction, heading

    def turn(self, pose: FloatArray) -> None:
        """End the current segment, and add a turn to a pose's yaw if it differs."""
        if self._headings:
            # Straight lines, with points at most `_SPACING_M` apart.
            rows, along = [], 0.0
            for before, after, heading in zip(self._nodes[:-1], self._nodes[1:], self._headings, strict=True):
                length = float(np.hypot(*(after - before)))
                count = max(int(np.ceil(length / _SPACING_M)), 1)
                shares, c, s = np.arange(count) / count, np.cos(heading), np.sin(heading)
                rows += [(*(before + share * (after - before)), c, s, along + share * length) for share in shares]
                along += length
            end, yaw = self._nodes[-1], self._headings[-1]
            rows.append((*end, np.cos(yaw), np.sin(yaw), along))
            self.segments.append(Segment(self._direction, np.array(rows), np.array([*end, yaw])))
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


class MppiController(PathFollower):
    """A `Controller` by model predictive path integral control (Williams et al. 2017).

    It looks some seconds ahead, and drives around obstacles and where people go. It draws command sequences around the
    last one, rolls each out through the robot's dynamics, and takes their mean by exp(-cost). If that mean collides,
    as between sequences that pass an obstacle on either side, it takes the cheapest sequence instead.

    Equal inputs in equal order give equal commands, as the noise is drawn once.
    """

    def __init__(
        self,
        footprint: Footprint,
        limits: RobotLimits | None = None,
        settings: MppiSettings | None = None,
        follow: FollowSettings | None = None,
    ) -> None:
        limits, follow = limits or RobotLimits(), follow or FollowSettings()
        steering = Rollouts(outline_of(footprint), limits, (settings or MppiSettings()).rollouts, follow)
        super().__init__(footprint, limits, follow, steering)


class PurePursuitController(PathFollower):
    """A `Controller` by regulated pure pursuit, which steers along arcs to a point ahead on the path.

    From Macenski, Singh, Martín, Ginés: Regulated pure pursuit for robot path tracking, Autonomous Robots 2023. It
    slows down in curves, near obstacles and toward the end of a segment. Here it also drives no faster than it can
    stop before an obstacle on its arc.
    """

    def __init__(
        self, footprint: Footprint, limits: RobotLimits | None = None, follow: FollowSettings | None = None
    ) -> None:
        limits, follow = limits or RobotLimits(), follow or FollowSettings()
        steering = _Arcs(outline_of(footprint), limits, follow)
        super().__init__(footprint, limits, follow, steering)


class OwnController:
    """Wraps a user's controller and checks its answers.

    Args:
        goal_m, goal_rad: distance from the end of a plan that counts as arrived.

    Raises PartError in `command`, for an invalid answer.
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
