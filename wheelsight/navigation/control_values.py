"""What controllers take and answer: MotionState, ControlResult, and why there is no command."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np

from wheelsight.checks import answer_of, array_of
from wheelsight.commands import STOP, VelocityCommand
from wheelsight.errors import ArgumentError, PartError
from wheelsight.geometry import FloatArray
from wheelsight.geometry.se2 import wrap_angle
from wheelsight.navigation.fields import CostField

_NO_POSES = np.empty((0, 3))
_NO_POSES.setflags(write=False)


class ControlReason(StrEnum):
    """Why a controller tells a robot to stand."""

    ARRIVED = "arrived"
    MISSED = "stands at the end of the plan, and off the goal"
    BLOCKED = "no way on that keeps clear"
    OFF_PATH = "too far from the plan"
    NO_PATH = "a plan that cannot be driven"
    INVALID = "numbers that are none"


@dataclass(frozen=True, slots=True, eq=False)
class MotionState:
    """Where a robot is and how it moves.

    Attributes:
        pose: (3,) x, y, yaw of `base` in the frame of the plan.
        forward_m_s: measured.
        turn_rad_s: measured.
    """

    pose: FloatArray
    forward_m_s: float = 0.0
    turn_rad_s: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all of it can be reckoned with."""
        pose = np.asarray(self.pose, float)
        return pose.shape == (3,) and bool(np.isfinite([*pose, self.forward_m_s, self.turn_rad_s]).all())


class DrivenPath(Protocol):
    """What a controller needs of a plan.

    Its directions are in its poses: a piece that leads against its headings is driven backward, and two poses at one
    place are a turn there.
    """

    @property
    def poses(self) -> FloatArray:
        """(N, 3) x, y, yaw."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ControlResult:
    """What a robot is to do now.

    Attributes:
        command: to be sent; a stop where there is a reason.
        reason: why it is to stand; None where it drives.
        predicted: (T, 3) poses that it will go through, as far as is reckoned; (0, 3) where it stands.
    """

    command: VelocityCommand
    reason: ControlReason | None = None
    predicted: FloatArray = field(default_factory=lambda: _NO_POSES)

    @classmethod
    def standing(cls, reason: ControlReason | None) -> ControlResult:
        """A stop."""
        return cls(STOP, reason)

    @property
    def has_arrived(self) -> bool:
        """Whether it stands at the goal."""
        return self.reason is ControlReason.ARRIVED


class Controller(Protocol):
    """Follows a plan: `MppiController` and `PurePursuitController`; `Navigator` takes another as `controller`.

    Its command passes the limits of the robot and the collision monitor, whoever computed it. An exception and another
    type stop the robot, and end the task with `NavigationReason.CONTROLLER`.
    """

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        """What to do now; called once a period, between two steps of the robot: it must be quick.

        `ControlResult(command)` drives; `ControlResult.standing(reason)` stops: `ARRIVED` where the plan is done, which
        counts within `follow.goal_m` and `goal_rad` of its end; `BLOCKED` is waited for; others ask for another plan.

        Args:
            state: of now.
            plan: the same object until there is another plan.
            field: the surroundings, in the frame of the plan.
            people: (P, 5) x, y, vx, vy, radius in that frame; they go on as they go.
        """
        ...


class OwnController:
    """A `Controller` whose answers are checked; raises PartError for what is none.

    Args:
        part: of a user's own.
        goal_m, goal_rad: how far from the end of a plan counts as arrived.
    """

    def __init__(self, part: Controller, goal_m: float, goal_rad: float) -> None:
        self._part, self._goal_m, self._goal_rad = part, goal_m, goal_rad

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        """See `Controller`. One that says it has arrived elsewhere has missed the goal."""
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
