"""What a navigator tells: its state, why it changed, how far it is, and what became of a task."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from wheelsight.estimates import Status
from wheelsight.geometry import FloatArray
from wheelsight.navigation.collision_monitor import MonitorResult
from wheelsight.navigation.plan_values import Plan


class NavigationState(StrEnum):
    """What a navigator is about."""

    IDLE = "idle"
    PLANNING = "planning"
    DRIVING = "driving"
    RECOVERING = "recovering"
    ARRIVED = "arrived"
    FAILED = "failed"


class NavigationReason(StrEnum):
    """Why a task ended without arrival."""

    INVALID = "the goal is no pose"
    NO_PLAN = "no way leads there"
    BLOCKED = "it found no way on"
    BESIDE = "it stopped beside the goal"
    LOST = "it does not know where it is"
    DISOBEYS = "the wheels do not do what they are told"
    ROBOT_STOPPED = "the robot stopped by itself"
    LOCALIZATION = "the localization failed"
    SILENT = "a part of the program hangs"
    CONTROLLER = "the controller failed"
    CANCELED = "it was called off"


@dataclass(frozen=True, slots=True)
class Transition:
    """A change of state.

    Attributes:
        stamp_s: when.
        before, after: the states.
        why: in words.
    """

    stamp_s: float
    before: NavigationState
    after: NavigationState
    why: str

    def __str__(self) -> str:
        return f"{self.before} → {self.after}: {self.why}"


def stays_words(at: FloatArray | None) -> str:
    """Of a thing at (2,) that is not seen through; empty for None."""
    if at is None:
        return ""
    return f"what stood at ({at[0]:.2f}, {at[1]:.2f}) m is not seen through: no depth behind it"


@dataclass(frozen=True, slots=True, eq=False)
class Feedback:
    """How a task goes on, after a step.

    Attributes:
        stamp_s: of now.
        state: of the navigator.
        status: of the localization.
        pose: (3,) x, y, yaw of the base in the map, or None while it is not known.
        forward_m_s, turn_rad_s: as the wheels measure them.
        goal: (3,) that is driven to now, or None.
        to_go_m: along the plan; None without one.
        plan: that is driven, or None.
        predicted: (T, 3) poses that the controller expects to go through.
        monitor: what the collision monitor made of the last command.
        doing: in words, what it does now.
        goals_left: how many goals are left, this one included.
        robot_stop: why the robot stopped by itself, in words; empty where it obeys.
        stays_at: (2,) in the map of a thing that has maybe gone, but is not seen through: no depth is behind it. None
            without any. A person who sees that nothing is there can say so by `Navigator.clear_obstacles`.
    """

    stamp_s: float
    state: NavigationState
    status: Status
    pose: FloatArray | None
    forward_m_s: float
    turn_rad_s: float
    goal: FloatArray | None
    to_go_m: float | None
    plan: Plan | None
    predicted: FloatArray
    monitor: MonitorResult | None
    doing: str
    goals_left: int
    robot_stop: str = ""
    stays_at: FloatArray | None = None

    @property
    def stays(self) -> str:
        """The same in words; empty without any."""
        return stays_words(self.stays_at)


@dataclass(frozen=True, slots=True, eq=False)
class NavigationResult:
    """What became of a task.

    Attributes:
        has_arrived: whether all its goals were reached, within `follow.goal_m` and `goal_rad`.
        reason: why it ended else.
        detail: the same for people.
        goal_change: why the place where the last plan ended is not the goal asked for; empty where it is.
        transitions: all changes of state, in order.
        time_s: from begin to end, by the clock of the stamps.
        way_m: driven, by the wheels.
        planned_m: length of the first plan; 0 without one.
        plans: how many were made.
        recoveries: how often the robot had to get itself out.
    """

    has_arrived: bool
    reason: NavigationReason | None
    detail: str
    goal_change: str
    transitions: tuple[Transition, ...]
    time_s: float
    way_m: float
    planned_m: float
    plans: int
    recoveries: int

    def __bool__(self) -> bool:
        """Whether it arrived."""
        return self.has_arrived
