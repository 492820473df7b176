"""MppiController: model predictive path integral control (Williams et al. 2017).

Sequences of commands are drawn about the last ones, each is rolled out through the robot's dynamics, and their mean by
exp(-cost) is the next. Where that mean would touch something, though single ones pass it on either side, the cheapest
alone is driven.
"""

from __future__ import annotations

import numpy as np

from wheelsight.commands import VelocityCommand
from wheelsight.geometry import Float32Array, FloatArray
from wheelsight.navigation._field_kernels import cost_and_speed_at
from wheelsight.navigation._mppi_kernels import (
    Begin,
    Dynamics,
    Way,
    Weights,
    blend,
    costs_of,
    draw,
    roll_out,
)
from wheelsight.navigation.control_settings import FollowSettings, MppiSettings
from wheelsight.navigation.control_values import ControlReason, ControlResult, DrivenPath, MotionState
from wheelsight.navigation.fields import CostField, Outline, outline_of
from wheelsight.navigation.following import PathFollower, Situation, clearances
from wheelsight.navigation.footprint import Footprint
from wheelsight.robot_limits import RobotLimits

__all__ = ["Begin", "Dynamics", "MppiController", "Rollouts", "Way", "Weights", "dynamics_of", "noise_of", "weights_of"]


class MppiController:
    """A `Controller` that looks some seconds ahead, around what is in the way, and where people go.

    Equal inputs in equal order give equal commands: its noise is drawn once.
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
    """A steering by rollouts."""

    def __init__(self, outline: Outline, limits: RobotLimits, settings: MppiSettings, follow: FollowSettings) -> None:
        self._settings, self._follow, self._limits = settings, follow, limits
        self._dynamics = dynamics_of(outline, limits, follow)
        self._weights = weights_of(settings, follow)
        self._noise = noise_of(settings)
        self._drawn = np.empty_like(self._noise)
        self._costs = np.empty(settings.rollouts)
        self._nominal = np.zeros((settings.steps, 2))

    def forget(self) -> None:
        """Begin from standing."""
        self._nominal[:] = 0.0

    def steer(self, situation: Situation) -> ControlResult:
        """The mean of all rollouts, or the best of them, or a stop where that one touches something too."""
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
        """What rollouts are judged by."""
        begin, way = self._begin(situation), self._way(situation)
        weights = self._weights._replace(margin_m=situation.margin_m)
        return begin, way, situation.field, situation.people, self._dynamics, weights

    def costs(
        self, given: tuple[Begin, Way, CostField, FloatArray, Dynamics, Weights]
    ) -> tuple[FloatArray, Float32Array]:
        """Costs (K,) of commands (K, T, 2) about the nominal ones; both are overwritten by the next call."""
        s = self._settings
        draw(self._nominal, self._noise, (s.spread_m_s, s.spread_rad_s), self._dynamics, self._drawn)
        costs_of(*given, self._drawn, self._costs)
        return self._costs, self._drawn

    def _begin(self, situation: Situation) -> Begin:
        state = situation.state
        x, y, yaw = map(float, state.pose)
        near = clearances(situation, self._dynamics.outline)
        return Begin(x, y, yaw, float(state.forward_m_s), float(state.turn_rad_s), 0, *near)

    def _way(self, situation: Situation) -> Way:
        """The segment from where the robot is, as far as rollouts reach."""
        segment = situation.segment
        ahead_m = self._limits.forward_m_s * self._settings.steps * self._follow.period_s + 1.0
        points = segment.points[situation.point :]
        points = points[points[:, 4] <= points[0, 4] + ahead_m]
        rest_m = segment.length_m - points[:, 4]
        most = np.sqrt(2 * self._follow.ends_m_s2 * rest_m)
        return Way(np.ascontiguousarray(np.column_stack([points, most])), float(segment.direction))

    def _result(self, situation: Situation, first: Float32Array, poses: FloatArray) -> ControlResult:
        """The first command, no faster than a zone allows and the segment's end is near."""
        v, w = float(first[0]), float(first[1])
        a, lag_s = self._follow.ends_m_s2, self._follow.lag_s
        at_end = float(np.sqrt((a * lag_s) ** 2 + 2 * a * max(situation.rest_m, 0.0)) - a * lag_s)
        zone = cost_and_speed_at(situation.field, situation.pose[0], situation.pose[1])[1]
        most = max(min(at_end, zone), min(self._follow.slowest_m_s, zone))
        if abs(v) > most:
            v, w = float(np.copysign(most, v)), w * most / abs(v)
        return ControlResult(VelocityCommand(v, w), None, poses.copy())


def noise_of(settings: MppiSettings) -> Float32Array:
    """(K, T, 2) standard noise, linear between knots, each row's negative behind it; three kinds, see MppiSettings."""
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
    drawn = rng.standard_normal((rows, steps // knot_steps + 2, 2))
    at = np.arange(steps) / knot_steps
    before, share = at.astype(int), (at % 1)[:, None]
    return np.asarray(drawn[:, before] * (1 - share) + drawn[:, before + 1] * share)


def dynamics_of(outline: Outline, limits: RobotLimits, follow: FollowSettings) -> Dynamics:
    """How a base follows commands, for a step of a period."""
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
    """Of settings, by their names."""
    own = {name: getattr(settings, name) for name in Weights._fields if hasattr(settings, name)}
    return Weights(**own, margin_m=follow.margin_m, people_margin_m=follow.people_margin_m)
