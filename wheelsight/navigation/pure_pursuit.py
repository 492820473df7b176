"""PurePursuitController: regulated pure pursuit.

Macenski, Singh, Martín, Ginés: Regulated pure pursuit for robot path tracking, Autonomous Robots 2023. It is slower in
curves, near obstacles and toward the end of a segment; here also no faster than it can stop before what its arc would
touch.
"""

from __future__ import annotations

import numpy as np

from wheelsight.commands import VelocityCommand
from wheelsight.geometry import FloatArray
from wheelsight.navigation._field_kernels import cost_and_speed_at, free_arc, moved
from wheelsight.navigation.control_settings import FollowSettings, PurePursuitSettings
from wheelsight.navigation.control_values import ControlReason, ControlResult, DrivenPath, MotionState
from wheelsight.navigation.fields import CostField, Outline, outline_of
from wheelsight.navigation.following import PathFollower, Situation, clearances
from wheelsight.navigation.footprint import Footprint
from wheelsight.robot_limits import RobotLimits


class PurePursuitController:
    """A `Controller` that steers along arcs to a point of the path ahead."""

    def __init__(
        self,
        footprint: Footprint,
        limits: RobotLimits | None = None,
        settings: PurePursuitSettings | None = None,
        follow: FollowSettings | None = None,
    ) -> None:
        limits, follow = limits or RobotLimits(), follow or FollowSettings()
        steering = _Arcs(outline_of(footprint), limits, settings or PurePursuitSettings(), follow)
        self._follower = PathFollower(footprint, limits, follow, steering)

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        """See `Controller.command`."""
        return self._follower.command(state, plan, field, people)


class _Arcs:
    def __init__(
        self, outline: Outline, limits: RobotLimits, settings: PurePursuitSettings, follow: FollowSettings
    ) -> None:
        self._outline, self._limits, self._settings, self._follow = outline, limits, settings, follow

    def forget(self) -> None:
        """It remembers nothing."""

    def steer(self, situation: Situation) -> ControlResult:
        """An arc to the point ahead, as fast as all rules allow."""
        curvature = self._curvature(situation)
        direction = situation.segment.direction
        most = self._limits.forward_m_s if direction > 0 else self._limits.backward_m_s
        clearance = min(clearances(situation, self._outline))
        speed = min(most, self._regulated(most, curvature, clearance), self._to_end(situation.rest_m))
        if curvature:
            speed = min(speed, self._limits.turn_rad_s / abs(curvature))
        speed = min(speed, cost_and_speed_at(situation.field, situation.pose[0], situation.pose[1])[1])
        free_m = self._free_m(situation, curvature, max(speed, abs(situation.state.forward_m_s)))
        speed = min(speed, self._stopping(free_m))
        if free_m <= 0 or speed <= 0:
            return ControlResult.standing(ControlReason.BLOCKED)
        speed = min(max(speed, self._follow.slowest_m_s), most)
        command = VelocityCommand(direction * speed, direction * speed * curvature)
        return ControlResult(command, None, self._arc(situation, curvature, min(free_m, situation.rest_m)))

    def _curvature(self, situation: Situation) -> float:
        """Of the arc from the base to the point ahead; beyond a segment's end it goes straight on."""
        s, segment = self._settings, situation.segment
        ahead_m = abs(situation.state.forward_m_s) * s.lookahead_s
        ahead_m = min(max(ahead_m, s.least_lookahead_m), s.most_lookahead_m)
        along = segment.length_m - situation.rest_m + ahead_m
        points = segment.points
        target = np.array([np.interp(along, points[:, 4], points[:, k]) for k in (0, 1)])
        beyond = max(along - segment.length_m, 0.0) * segment.direction
        dx, dy = target + beyond * points[-1, 2:4] - situation.state.pose[:2]
        _, _, c, s_ = situation.pose
        x, y = c * dx + s_ * dy, -s_ * dx + c * dy
        return float(2 * y / max(x * x + y * y, s.least_lookahead_m**2 / 4))

    def _regulated(self, most: float, curvature: float, clearance: float) -> float:
        s = self._settings
        by_curve = most / max(s.curve_m * abs(curvature), 1.0)
        by_nearness = most * min(max(clearance - self._follow.margin_m, 0.0) / s.near_m, 1.0)
        return max(min(by_curve, by_nearness), min(s.near_m_s, most))

    def _to_end(self, rest_m: float) -> float:
        """So that it stands at the segment's end, by what is left when the base has followed."""
        a, lag_s = self._follow.ends_m_s2, self._follow.lag_s
        return float(np.sqrt((a * lag_s) ** 2 + 2 * a * max(rest_m, 0.0)) - a * lag_s)

    def _stopping(self, free_m: float) -> float:
        """The speed from which it stops within so many metres, after it went on for a time."""
        b, t = self._settings.braking_share * self._limits.braking_m_s2, self._settings.ahead_s
        return float(np.sqrt((b * t) ** 2 + 2 * b * max(free_m, 0.0)) - b * t)

    def _free_m(self, situation: Situation, curvature: float, speed: float) -> float:
        """How far the arc goes before it touches something, as far as matters at a speed."""
        s, margin = self._settings, situation.margin_m
        b = s.braking_share * self._limits.braking_m_s2
        steps = 2 + int(np.ceil((speed**2 / (2 * b) + speed * s.ahead_s) / s.step_m))
        way = situation.segment.direction * s.step_m
        people = situation.people + np.array([0, 0, 0, 0, self._follow.people_margin_m - margin])
        arc = (way, way * curvature, s.step_m / max(speed, self._follow.slowest_m_s), steps)
        return float(free_arc(situation.field, self._outline, people, situation.pose, arc, margin)) * s.step_m

    def _arc(self, situation: Situation, curvature: float, length_m: float) -> FloatArray:
        pose, poses = situation.pose, []
        way = situation.segment.direction * self._settings.step_m
        for _ in range(max(int(length_m / self._settings.step_m), 1)):
            pose = moved(pose, way, way * curvature)
            poses.append((pose[0], pose[1], np.arctan2(pose[3], pose[2])))
        return np.array(poses)
