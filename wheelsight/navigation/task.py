"""Values of a navigator: its states, transitions, feedback and results, in words for page and command line."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.navigation.collision_monitor import MonitorResult, MonitorState
from wheelsight.navigation.controllers import stands
from wheelsight.navigation.planner import Plan


class NavigationState(StrEnum):
    """State of a navigator."""

    IDLE = "idle"
    PLANNING = "planning"
    DRIVING = "driving"
    RECOVERING = "recovering"
    ARRIVED = "arrived"
    FAILED = "failed"


class NavigationReason(StrEnum):
    """Why a task ended without arrival."""

    INVALID = "the goal is not a pose"
    NO_PLAN = "no way leads there"
    BLOCKED = "it found no way on"
    BESIDE = "it stopped beside the goal"
    LOST = "it does not know where it is"
    DISOBEYS = "the wheels do not follow their commands"
    ROBOT_STOPPED = "the robot stopped by itself"
    LOCALIZATION = "the localization failed"
    SILENT = "a part of the program hangs"
    CONTROLLER = "the controller failed"
    CANCELED = "the task was canceled"


@dataclass(frozen=True, slots=True)
class Transition:
    """A change of state."""

    stamp_s: float
    before: NavigationState
    after: NavigationState
    why: str

    def __str__(self) -> str:
        return f"{self.before} → {self.after}: {self.why}"


def stays_words(at: FloatArray | None) -> str:
    """Return a message about an obstacle at (2,) without depth behind it, which may be gone; empty for None."""
    if at is None:
        return ""
    return f"what stood at ({at[0]:.2f}, {at[1]:.2f}) m is not seen through: no depth behind it"


@dataclass(frozen=True, slots=True, eq=False)
class Feedback:
    """State and progress of a task after a step.

    Attributes:
        pose: (3,) x, y, yaw of the base in the map; None if unknown.
        forward_m_s, turn_rad_s: velocity by the wheels.
        goal: (3,) current goal; None without a plan.
        to_go_m: distance left along the plan; None without one.
        predicted: (T, 3) poses that the controller predicts.
        monitor: result of the collision monitor for the last command.
        goals_left: number of goals left, including this one.
        robot_stop: why the robot stopped by itself; empty if it did not.
        stays_at: (2,) in the map of an obstacle that may be gone, but has no depth behind it to clear it; None without
            any. A person who sees that nothing is there can call `Navigator.clear_obstacles`.
        has_wheel_fault: whether wheels did not follow their commands. A person who has checked them can call
            `Navigator.clear_fault`; until then every task fails.
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
    has_wheel_fault: bool = False

    @property
    def stands(self) -> bool:
        """Whether the wheels stand still."""
        return stands(self.forward_m_s, self.turn_rad_s)

    @property
    def stays(self) -> str:
        """Message about `stays_at`; empty without any."""
        return stays_words(self.stays_at)


@dataclass(frozen=True, slots=True, eq=False)
class NavigationResult:
    """Result of a task.

    Attributes:
        has_arrived: whether all goals were reached, within `follow.goal_m` and `goal_rad`.
        reason: why the task ended otherwise; None on arrival.
        goal_change: why the end of the last plan differs from the requested goal; empty if it does not.
        time_s: duration, by the clock of the stamps.
        way_m: distance driven, by the wheels.
        planned_m: length of the first plan; 0 without one.
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
        """Return whether the robot arrived."""
        return self.has_arrived


# Words for pages and the command line.
STATUS_WORDS = {
    Status.INITIALIZING: "looks for its place in the map",
    Status.TRACKING: "knows where it is",
    Status.COASTING: "by its wheels alone",
    Status.FAILING: "does not trust where it is",
    Status.LOST: "lost",
}


def monitor_words(feedback: Feedback) -> str:
    """Return what the collision monitor does and why, and which obstacle stays without depth behind it."""
    found, stays = feedback.monitor, f"; {feedback.stays}" if feedback.stays else ""
    if found is None or found.state is MonitorState.FREE:
        return f"lets it drive{stays}"
    does = "slows it down" if found.state is MonitorState.SLOWED else "holds it"
    return f"{does}: {found.reason}{stays}" if found.reason is not None else f"{does}{stays}"
