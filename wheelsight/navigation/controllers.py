"""Controllers: model predictive path integral control (MPPI) and regulated pure pursuit."""

from __future__ import annotations

import numpy as np

from wheelsight.core.geometry import Float32Array, FloatArray
from wheelsight.core.messages import VelocityCommand
from wheelsight.core.robots import RobotLimits
from wheelsight.navigation.clearance_kernels import CostField, Outline, cost_and_speed_at, free_arc, moved
from wheelsight.navigation.footprint import Footprint, outline_of
from wheelsight.navigation.mppi_kernels import Begin, Dynamics, Way, Weights, blend, costs_of, draw, roll_out
from wheelsight.navigation.path_following import (
    ControlReason,
    ControlResult,
    DrivenPath,
    MotionState,
    PathFollower,
    Situation,
    clearances,
)
from wheelsight.navigation.settings import FollowSettings, MppiSettings, PurePursuitSettings


class MppiController:
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
        steering = Rollouts(outline_of(footprint), limits, settings or MppiSettings(), follow)
        self._follower = PathFollower(footprint, limits, follow, steering)

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        """See `Controller.command`."""
        return self._follower.command(state, plan, field, people)


class Rollouts:
    """Steering by rollouts of command sequences."""

    def __init__(self, outline: Outline, limits: RobotLimits, settings: MppiSettings, follow: FollowSettings) -> None:
        self._settings, self._follow, self._limits = settings, follow, limits
        self._dynamics = dynamics_of(outline, limits, follow)
        self._weights = weights_of(settings, follow)
        self._noise = noise_of(settings)
        self._drawn = np.empty_like(self._noise)
        self._costs = np.empty(settings.rollouts)
        self._nominal = np.zeros((settings.steps, 2))

    def forget(self) -> None:
        """Reset the nominal commands to a standstill."""
        self._nominal[:] = 0.0

    def steer(self, situation: Situation) -> ControlResult:
        """Return the mean of all rollouts, or the best one if that collides, or a stop if both collide."""
        given = self.given(situation)
        self._nominal[:-1] = self._nominal[1:]
        costs, drawn = self.costs(given)
        mean = np.empty_like(self._nominal)
        best = blend(costs, drawn, self._settings.temperature, mean)
        poses = np.empty((len(mean), 3))
        for commands in (mean.astype(np.float32), drawn[best]):
            _, contact = roll_out(*given, commands, poses)
            if contact == len(mean):
                self._nominal[:] = commands
                return self._result(situation, commands[0], poses)
        self.forget()
        return ControlResult.standing(ControlReason.BLOCKED)

    def given(self, situation: Situation) -> tuple[Begin, Way, CostField, FloatArray, Dynamics, Weights]:
        """Return everything that a rollout needs besides its commands."""
        state, way = situation.state, self._way(situation)
        x, y, yaw = map(float, state.pose)
        near = clearances(situation, self._dynamics.outline)
        begin = Begin(x, y, yaw, float(state.forward_m_s), float(state.turn_rad_s), 0, *near)
        weights = self._weights._replace(margin_m=situation.margin_m)
        return begin, way, situation.field, situation.people, self._dynamics, weights

    def costs(
        self, given: tuple[Begin, Way, CostField, FloatArray, Dynamics, Weights]
    ) -> tuple[FloatArray, Float32Array]:
        """Return costs (K,) of commands (K, T, 2) around the nominal ones. The next call overwrites both arrays."""
        s = self._settings
        draw(self._nominal, self._noise, (s.spread_m_s, s.spread_rad_s), self._dynamics, self._drawn)
        costs_of(*given, self._drawn, self._costs)
        return self._costs, self._drawn

    def _way(self, situation: Situation) -> Way:
        """Return the segment from the robot on, as far as rollouts reach."""
        segment = situation.segment
        ahead_m = self._limits.forward_m_s * self._settings.steps * self._follow.period_s + 1.0
        points = segment.points[situation.point :]
        points = points[points[:, 4] <= points[0, 4] + ahead_m]
        rest_m = segment.length_m - points[:, 4]
        most = np.sqrt(2 * self._follow.ends_m_s2 * rest_m)
        return Way(np.ascontiguousarray(np.column_stack([points, most])), float(segment.direction))

    def _result(self, situation: Situation, first: Float32Array, poses: FloatArray) -> ControlResult:
        """Return the first command, limited by speed zones and by the distance to the segment's end."""
        v, w = float(first[0]), float(first[1])
        at_end = _speed_to_stop(situation.rest_m, self._follow)
        zone = cost_and_speed_at(situation.field, situation.pose[0], situation.pose[1])[1]
        most = max(min(at_end, zone), min(self._follow.slowest_m_s, zone))
        if abs(v) > most:
            v, w = float(np.copysign(most, v)), w * most / abs(v)
        return ControlResult(VelocityCommand(v, w), None, poses.copy())


def noise_of(settings: MppiSettings) -> Float32Array:
    """Return standard noise (K, T, 2), linear between knots, each row followed by its negative; see MppiSettings."""
    rng = np.random.default_rng(settings.seed)
    pairs = (settings.rollouts + 1) // 2
    fine, long = int(settings.fine_share * pairs), int(settings.long_share * pairs)
    smooth = _between_knots(rng, pairs, settings.steps, settings.knot_steps)
    smooth[:fine] /= 4
    smooth[fine : fine + long] = _between_knots(
        rng, len(smooth[fine : fine + long]), settings.steps, settings.steps // 2
    )
    both = np.stack([smooth, -smooth], axis=1).reshape(-1, settings.steps, 2)
    return np.ascontiguousarray(both[: settings.rollouts], np.float32)


def _between_knots(rng: np.random.Generator, rows: int, steps: int, knot_steps: int) -> FloatArray:
    """Return (rows, steps, 2) standard noise at knots, interpolated between them."""
    drawn = rng.standard_normal((rows, steps // knot_steps + 2, 2))
    at = np.arange(steps) / knot_steps
    before, share = at.astype(int), (at % 1)[:, None]
    return np.asarray(drawn[:, before] * (1 - share) + drawn[:, before + 1] * share)


def dynamics_of(outline: Outline, limits: RobotLimits, follow: FollowSettings) -> Dynamics:
    """Return the dynamics of a base for steps of a control period."""
    step_s = follow.period_s
    return Dynamics(
        outline,
        limits.forward_m_s,
        limits.backward_m_s,
        limits.turn_rad_s,
        limits.acceleration_m_s2 * step_s,
        limits.braking_m_s2 * step_s,
        limits.turn_acceleration_rad_s2 * step_s,
        float(1 - np.exp(-step_s / follow.lag_s)),
        step_s,
        float(np.linalg.norm(outline.sides[:, :2], axis=1).max()),
    )


def weights_of(settings: MppiSettings, follow: FollowSettings) -> Weights:
    """Return the weights that the settings have by the same names."""
    own = {name: getattr(settings, name) for name in Weights._fields if hasattr(settings, name)}
    return Weights(**own, margin_m=follow.margin_m, people_margin_m=follow.people_margin_m)


class PurePursuitController:
    """A `Controller` by regulated pure pursuit, which steers along arcs to a point ahead on the path.

    From Macenski, Singh, Martín, Ginés: Regulated pure pursuit for robot path tracking, Autonomous Robots 2023. It
    slows down in curves, near obstacles and toward the end of a segment. Here it also drives no faster than it can
    stop before an obstacle on its arc.
    """

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
    """Steering along arcs."""

    def __init__(
        self, outline: Outline, limits: RobotLimits, settings: PurePursuitSettings, follow: FollowSettings
    ) -> None:
        self._outline, self._limits, self._settings, self._follow = outline, limits, settings, follow

    def forget(self) -> None:
        """Do nothing: it has no state."""

    def steer(self, situation: Situation) -> ControlResult:
        """Return the command along an arc to the point ahead, at the highest permitted speed."""
        curvature = self._curvature(situation)
        direction = situation.segment.direction
        most = self._limits.forward_m_s if direction > 0 else self._limits.backward_m_s
        clearance = min(clearances(situation, self._outline))
        s = self._settings
        by_curve = most / max(s.curve_m * abs(curvature), 1.0)
        by_nearness = most * min(max(clearance - self._follow.margin_m, 0.0) / s.near_m, 1.0)
        regulated = max(min(by_curve, by_nearness), min(s.near_m_s, most))
        speed = min(most, regulated, _speed_to_stop(situation.rest_m, self._follow))
        if curvature:
            speed = min(speed, self._limits.turn_rad_s / abs(curvature))
        speed = min(speed, cost_and_speed_at(situation.field, situation.pose[0], situation.pose[1])[1])
        free_m = self._free_m(situation, curvature, max(speed, abs(situation.state.forward_m_s)))
        # The speed from which it stops within the free way, after it has driven on for a time.
        b, t = s.braking_share * self._limits.braking_m_s2, s.ahead_s
        speed = min(speed, float(np.sqrt((b * t) ** 2 + 2 * b * max(free_m, 0.0)) - b * t))
        if free_m <= 0 or speed <= 0:
            return ControlResult.standing(ControlReason.BLOCKED)
        speed = min(max(speed, self._follow.slowest_m_s), most)
        command = VelocityCommand(direction * speed, direction * speed * curvature)
        pose, poses = situation.pose, []
        step_m = direction * s.step_m
        for _ in range(max(int(min(free_m, situation.rest_m) / s.step_m), 1)):
            pose = moved(pose, step_m, step_m * curvature)
            poses.append((pose[0], pose[1], np.arctan2(pose[3], pose[2])))
        return ControlResult(command, None, np.array(poses))

    def _curvature(self, situation: Situation) -> float:
        """Return the curvature of the arc to the point ahead. Beyond a segment's end the path goes straight on."""
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

    def _free_m(self, situation: Situation, curvature: float, speed: float) -> float:
        """Return the free length of the arc, as far as it matters at a speed."""
        s, margin = self._settings, situation.margin_m
        b = s.braking_share * self._limits.braking_m_s2
        steps = 2 + int(np.ceil((speed**2 / (2 * b) + speed * s.ahead_s) / s.step_m))
        way = situation.segment.direction * s.step_m
        people = situation.people + np.array([0, 0, 0, 0, self._follow.people_margin_m - margin])
        arc = (way, way * curvature, s.step_m / max(speed, self._follow.slowest_m_s), steps)
        return float(free_arc(situation.field, self._outline, people, situation.pose, arc, margin)) * s.step_m


def _speed_to_stop(rest_m: float, follow: FollowSettings) -> float:
    """Return the speed from which the robot stops at a segment's end, including the lag of the base."""
    a, lag_s = follow.ends_m_s2, follow.lag_s
    return float(np.sqrt((a * lag_s) ** 2 + 2 * a * max(rest_m, 0.0)) - a * lag_s)
