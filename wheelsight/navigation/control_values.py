"""What controllers take and answer: MotionState, ControlResult, and why there is no command."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np

from wheelsight.commands import STOP, VelocityCommand
from wheelsight.geometry import FloatArray
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
    """Follows a plan."""

    def command(self, state: MotionState, plan: DrivenPath, field: CostField, people: FloatArray) -> ControlResult:
        """What to do now; called once a period.

        Args:
            state: of now.
            plan: the same object until there is another plan.
            field: the surroundings, in the frame of the plan.
            people: (P, 5) x, y, vx, vy, radius in that frame; they go on as they go.
        """
        ...
