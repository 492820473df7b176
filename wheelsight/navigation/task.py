"""Task: the navigator's memory of one task. Also its states, transitions, feedback and results."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.navigation.behaviours import Behaviour, OpenWay, Wait, when_blocked, when_lost, when_unseen
from wheelsight.navigation.collision_monitor import MonitorReason, MonitorResult, MonitorState
from wheelsight.navigation.goals import Goals
from wheelsight.navigation.localization import WhereNow
from wheelsight.navigation.planner import Plan, PlanReason
from wheelsight.navigation.planning import to_go_m
from wheelsight.navigation.settings import BehaviourSettings, NavigationSettings, NavigatorSettings


class Task:
    """Goals, plan, recovery attempts and timers of one task.

    Args:
        goals: goals of the task.
        now_s: start time.

    Attributes:
        plan: the plan that is driven; None until there is one for the next goal.
        planned_s, checked_s: when the plan was made, and when it was last checked against the surroundings.
        T_map_odom: (3,) x, y, yaw of `odom` in `map` at the request of the plan.
        replan_reason: why another plan was requested while this one is driven.
        wants_replan: whether another plan is still to be requested.
        goal_change: why the last goal reached differs from the requested one.
        beside: the same for the first goal where the robot stopped outside the tolerance; empty without any.
        behaviour: current recovery behaviour; None without any.
        is_lost: whether the behaviour searches for the robot's pose.
        awaits_way: whether the behaviour waits for a blocked path to become free.
        is_refused: whether the map forbids the behaviour's command, because an obstacle is too near.
        tries: recovery attempts since the last progress.
        passes_hidden: whether plans may cross unseen floor, as no other path was found since the last progress.
        skips: goals skipped since the last plan or recovery.
        searches: searches for the pose since it was last known.
        known_s: when the pose was last known.
        why_first: reason of the first failed plan since the last plan or progress; empty without any.
        transitions: all changes of state.
    """

    def __init__(self, goals: Goals, now_s: float) -> None:
        self.goals, self._why_lost = goals, ""
        self.plan: Plan | None = None
        self.planned_s = self.checked_s = -math.inf
        self.T_map_odom: FloatArray = np.zeros(3)
        self.replan_reason = self.goal_change = self.beside = ""
        self.wants_replan = False
        self.behaviour: Behaviour | None = None
        self.is_lost = self.awaits_way = self.is_refused = False
        self.tries, self.skips, self.searches = 0, 0, 0
        self.passes_hidden = self._has_waited = self._has_awaited_way = self._has_met_people = False
        self.known_s = now_s
        self.why_first = ""
        self.transitions: list[Transition] = []
        self._begun_s = self._rolled_s = self._tried_s = now_s
        self._way_m = 0.0
        self._here = self._from = np.full(2, math.nan)
        self._now_s = self._since_s = now_s
        self._planned_m, self._plans, self._recoveries = 0.0, 0, 0
        self._held, self._stopped, self._silent = _Stopwatch(), _Stopwatch(), _Stopwatch()

    @property
    def doing(self) -> str:
        """Name of the current behaviour or goal."""
        return self.goals.name if self.behaviour is None else self.behaviour.name

    def roll(self, now_s: float, where: WhereNow, settings: NavigatorSettings, *, meets_people: bool) -> None:
        """Update distance and progress. Progress resets the recovery attempts, even if the robot goes to and fro."""
        self._now_s = now_s
        self._has_met_people |= meets_people
        # Integrated over readings: failed encoders add no distance.
        speed = where.speed
        if speed.stamp_s > self._rolled_s:
            self._way_m += abs(speed.forward_m_s) * (speed.stamp_s - self._rolled_s)
            self._rolled_s = speed.stamp_s
        if where.odom_pose is not None:
            self._here = where.odom_pose[:2]
            if not np.hypot(*(self._here - self._from)) <= settings.progress_m:
                self.tries, self.passes_hidden, self._has_awaited_way = 0, False, False
                self._has_met_people, self._tried_s, self.why_first = False, now_s, ""
                self.restart_progress()
        self._why_lost = where.why_unknown(settings.unsure_m)
        if not self._why_lost:
            self.known_s, self.searches = now_s, 0

    def restart_progress(self) -> None:
        """Measure progress from here and now."""
        self._from, self._since_s = self._here, self._now_s

    @property
    def loiters_s(self) -> float:
        """Seconds without progress, even if the robot moved."""
        return self._now_s - self._since_s

    def take(self, plan: Plan, now_s: float, T_map_odom: FloatArray) -> None:
        """Drive a new plan."""
        self._plans += 1
        self._planned_m = self._planned_m or plan.length_m
        self.plan, self.planned_s, self.checked_s, self.T_map_odom = plan, now_s, now_s, T_map_odom
        self.behaviour, self.skips, self._held, self.wants_replan = None, 0, _Stopwatch(), False
        self.why_first = ""

    def recover(self, behaviour: Behaviour, *, is_lost: bool) -> None:
        """Start a recovery behaviour."""
        self.behaviour, self.is_lost, self._held, self.skips = behaviour, is_lost, _Stopwatch(), 0
        self.awaits_way = self.is_refused = False
        self._recoveries += 1
        if is_lost:
            self.searches += 1
        else:
            self.tries += 1
        self.restart_progress()

    def may_try(self, settings: NavigatorSettings) -> bool:
        """Return whether another recovery may start. Near people the limit is a time, else a number of attempts."""
        has_time = self._now_s - self._tried_s < settings.patience_s
        return self.tries < settings.tries or (self._has_met_people and has_time)

    def get_out(self, settings: NavigationSettings, stopped_by: MonitorReason | None, *, was_backward: bool) -> None:
        """Start the next recovery behaviour after a stop by the monitor.

        Waiting does not help at unseen floor: only another path does.
        """
        b, tries = settings.behaviours, self.tries
        self.passes_hidden = stopped_by is not MonitorReason.NEVER_SEEN
        if tries >= settings.navigator.tries:
            self.recover(Wait(b.wait_s, "wait until people have gone"), is_lost=False)
        elif self.passes_hidden:
            self.recover(when_blocked(tries, b), is_lost=False)
        else:
            self.recover(when_unseen(tries, b, was_backward=was_backward), is_lost=False)

    def why_over(self, now_s: float, settings: NavigationSettings) -> tuple[NavigationReason, str] | None:
        """Return why the task cannot succeed: a limit of zero, or a pose unknown for too long. None if it can."""
        limits, lost_s = settings.limits, now_s - self.known_s
        if limits.forward_m_s == 0 and limits.backward_m_s == 0:
            return NavigationReason.NO_PLAN, f"{PlanReason.STANDS}: forward_m_s and backward_m_s are 0"
        if limits.turn_rad_s == 0 and lost_s > settings.behaviours.wait_s:
            return NavigationReason.LOST, "nor can it look about: turn_rad_s is 0"
        most_s = settings.navigator.lost_s
        return (NavigationReason.LOST, f"for {most_s:g} s: {self._why_lost}") if lost_s > most_s else None

    def search(
        self, settings: NavigationSettings, status: Status, checked: MonitorResult, open_way: OpenWay | None
    ) -> None:
        """Start a behaviour that searches for the pose; see `when_lost`.

        A robot that may not turn waits: it must not drive before a whole turn has shown its surroundings.
        """
        s = settings.behaviours
        if settings.limits.turn_rad_s == 0:
            self.recover(Wait(s.wait_s, "wait to see where it is"), is_lost=True)
            return
        is_held = self.is_refused or checked.state is MonitorState.STOPPED
        sees = checked.reason is not MonitorReason.NO_FRAME
        self.recover(when_lost(self.searches, s, status, open_way, is_held=is_held, sees=sees), is_lost=True)

    @property
    def may_wait(self) -> bool:
        """Return whether to wait for a person at the goal, once per goal."""
        return bool(self._change) and not self._has_waited

    def await_goal(self, behaviour: Behaviour) -> None:
        """Wait for a person at the goal."""
        self.recover(behaviour, is_lost=False)
        self._has_waited = True

    def await_way(self, plan: Plan, where: WhereNow, settings: BehaviourSettings) -> bool:
        """Wait, once per place, instead of driving a long detour; return whether it does so.

        A person in the way usually leaves sooner than the detour takes (cf. Nav2's `PathLongerOnApproach`).
        """
        if self.plan is None or where.state is None or self._has_awaited_way:
            return False
        left_m = to_go_m(self.plan, where.state.pose)
        if plan.length_m <= settings.round_times * left_m + settings.round_m:
            return False
        self.recover(Wait(settings.wait_s, f"wait, rather than go {plan.length_m - left_m:.1f} m round"), is_lost=False)
        self.awaits_way = self._has_awaited_way = True
        return True

    @property
    def _change(self) -> str:
        """Why the plan's goal differs from the requested one; empty if it does not, or if no place was requested."""
        return self.plan.goal_change if self.plan is not None and self.goals.is_asked_for else ""

    def reached(self, tolerance: tuple[float, float]) -> None:
        """Record that the plan's goal is reached, and why it differs from the requested one.

        Args:
            tolerance: distance in metres and angle in radians that still count as an arrival.
        """
        self.goal_change, plan = self._change, self.plan
        if self.goal_change and plan is not None and not self.beside:
            is_beside = plan.goal_off_m > tolerance[0] or plan.goal_off_rad > tolerance[1]
            self.beside = self.goal_change if is_beside else ""
        self.plan = None
        self.goals.reached()
        self.restart_progress()
        self._has_waited = False

    def held_for_s(self, now_s: float, is_held: bool) -> float:
        """Return the seconds since the robot is held; 0 if it is not."""
        return self._held.for_s(now_s, is_held)

    def stopped_for_s(self, now_s: float, is_stopped: bool) -> float:
        """Return the seconds since the robot stopped by itself; 0 if it did not."""
        return self._stopped.for_s(now_s, is_stopped)

    def silent_for_s(self, now_s: float, is_silent: bool) -> float:
        """Return the seconds since a part of the program is silent; 0 if none is."""
        return self._silent.for_s(now_s, is_silent)

    def result(self, has_arrived: bool, reason: NavigationReason | None, detail: str, now_s: float) -> NavigationResult:
        """Return the result of the task."""
        return NavigationResult(
            has_arrived,
            reason,
            detail,
            self.goal_change,
            tuple(self.transitions),
            now_s - self._begun_s,
            self._way_m,
            self._planned_m,
            self._plans,
            self._recoveries,
        )


class _Stopwatch:
    """Measures for how long a condition has held without a break."""

    def __init__(self) -> None:
        self._since_s: float | None = None

    def for_s(self, now_s: float, is_so: bool) -> float:
        if not is_so:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = now_s
        return 0.0 if self._since_s is None else now_s - self._since_s


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
    """A change of state.

    Attributes:
        stamp_s: time of the change.
        before, after: the states.
        why: reason in words.
    """

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
        stamp_s: time of the step.
        state: state of the navigator.
        status: status of the localization.
        pose: (3,) x, y, yaw of the base in the map; None if unknown.
        forward_m_s, turn_rad_s: velocity by the wheels.
        goal: (3,) current goal; None without a plan.
        to_go_m: distance left along the plan; None without one.
        plan: current plan, or None.
        predicted: (T, 3) poses that the controller predicts.
        monitor: result of the collision monitor for the last command.
        doing: current activity in words.
        goals_left: number of goals left, including this one.
        robot_stop: why the robot stopped by itself; empty if it did not.
        stays_at: (2,) in the map of an obstacle that may be gone, but has no depth behind it to clear it; None without
            any. A person who sees that nothing is there can call `Navigator.clear_obstacles`.
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
        """Message about `stays_at`; empty without any."""
        return stays_words(self.stays_at)


@dataclass(frozen=True, slots=True, eq=False)
class NavigationResult:
    """Result of a task.

    Attributes:
        has_arrived: whether all goals were reached, within `follow.goal_m` and `goal_rad`.
        reason: why the task ended otherwise; None on arrival.
        detail: the same in words.
        goal_change: why the end of the last plan differs from the requested goal; empty if it does not.
        transitions: all changes of state, in order.
        time_s: duration, by the clock of the stamps.
        way_m: distance driven, by the wheels.
        planned_m: length of the first plan; 0 without one.
        plans: number of plans.
        recoveries: number of recovery behaviours.
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
