"""Task: the navigator's state during one task. The module also holds its states, transitions, feedback and results."""

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

# Task: what a navigator remembers of the task it has: goals, plan, tries, and since when something is so.


class Task:
    """See the module.

    Args:
        goals: of it.
        now_s: when it begins.

    Attributes:
        plan: that is driven; None until there is one to the goal that is next.
        planned_s, checked_s: when it was made, and when it was last held against the surroundings.
        T_map_odom: (3,) of when it was asked for.
        why_anew: why another was asked for, while it is driven.
        wants_anew: whether another is yet to be asked for.
        goal_change: of the last goal that was reached.
        beside: of the first goal at which it stopped, but not within the tolerance of an arrival; empty without any.
        behaviour: that is done while it recovers.
        is_lost: whether that is to find out where it is.
        awaits_way: whether that is to see whether a way gets free again.
        is_refused: whether the map holds it up in what it does: something is too near.
        tries: to get itself out, since it last made way.
        passes_hidden: whether no way was found beside floor that no camera has looked at, since it last made way.
        skips: goals left out, since it last had a plan or got itself out.
        searches: to find out where it is, since it last knew.
        known_s: when it last knew where it is.
        why_first: why there was no plan first, since it last had one or made way; empty where there was one.
        transitions: all of them.
    """

    def __init__(self, goals: Goals, now_s: float) -> None:
        self.goals, self._why_lost = goals, ""
        self.plan: Plan | None = None
        self.planned_s = self.checked_s = -math.inf
        self.T_map_odom: FloatArray = np.zeros(3)
        self.why_anew = self.goal_change = self.beside = ""
        self.wants_anew = False
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
        """In words."""
        return self.goals.name if self.behaviour is None else self.behaviour.name

    def roll(self, now_s: float, where: WhereNow, settings: NavigatorSettings, *, meets_people: bool) -> None:
        """Count the way made; once it has come so far, tries begin anew: to and fro it may go for ever."""
        self._now_s = now_s
        self._has_met_people |= meets_people
        # By readings: wheels that are not heard any more made no way.
        speed = where.speed
        if speed.stamp_s > self._rolled_s:
            self._way_m += abs(speed.forward_m_s) * (speed.stamp_s - self._rolled_s)
            self._rolled_s = speed.stamp_s
        if where.odom_pose is not None:
            self._here = where.odom_pose[:2]
            if not np.hypot(*(self._here - self._from)) <= settings.progress_m:
                self.tries, self.passes_hidden, self._has_awaited_way = 0, False, False
                self._has_met_people, self._tried_s, self.why_first = False, now_s, ""
                self.come_on()
        self._why_lost = where.why_unknown(settings.unsure_m)
        if not self._why_lost:
            self.known_s, self.searches = now_s, 0

    def come_on(self) -> None:
        """From here and now on it is to make way."""
        self._from, self._since_s = self._here, self._now_s

    @property
    def loiters_s(self) -> float:
        """For how long it has come no farther, though it may have driven."""
        return self._now_s - self._since_s

    def take(self, plan: Plan, now_s: float, T_map_odom: FloatArray) -> None:
        """Drive a plan from now on."""
        self._plans += 1
        self._planned_m = self._planned_m or plan.length_m
        self.plan, self.planned_s, self.checked_s, self.T_map_odom = plan, now_s, now_s, T_map_odom
        self.behaviour, self.skips, self._held, self.wants_anew = None, 0, _Stopwatch(), False
        self.why_first = ""

    def recover(self, behaviour: Behaviour, *, is_lost: bool) -> None:
        """Do something to get on."""
        self.behaviour, self.is_lost, self._held, self.skips = behaviour, is_lost, _Stopwatch(), 0
        self.awaits_way = self.is_refused = False
        self._recoveries += 1
        if is_lost:
            self.searches += 1
        else:
            self.tries += 1
        self.come_on()

    def may_try(self, settings: NavigatorSettings) -> bool:
        """Whether it may get itself out once more: people who walk about go in time, not in so many tries."""
        has_time = self._now_s - self._tried_s < settings.patience_s
        return self.tries < settings.tries or (self._has_met_people and has_time)

    def get_out(self, settings: NavigationSettings, stopped_by: MonitorReason | None, *, was_backward: bool) -> None:
        """Do something to get on.

        Floor that was never seen stays so, however long it waits: only another way leads past it.
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
        """Why the robot cannot do it, wherever it is, or finds out no more where that is; None while it may."""
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
        """Do something to find out where it is; see `when_lost`.

        Who may not turn stands: nobody drives on before a whole turn has shown what is about it.
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
        """Whether somebody may yet make room where its goal is."""
        return bool(self._change) and not self._has_waited

    def await_goal(self, behaviour: Behaviour) -> None:
        """Wait for that, once a goal."""
        self.recover(behaviour, is_lost=False)
        self._has_waited = True

    def await_way(self, plan: Plan, where: WhereNow, settings: BehaviourSettings) -> bool:
        """Wait, once here, rather than go a long way round what may go away; whether it does so.

        As Nav2's `PathLongerOnApproach` does: somebody who stands in the way is gone sooner than a way round is driven.
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
        """Why the plan's goal is not what somebody asked for; empty where it is, or nobody did."""
        return self.plan.goal_change if self.plan is not None and self.goals.is_asked_for else ""

    def reached(self, tolerance: tuple[float, float]) -> None:
        """The goal of the plan; why it is another one than was asked for is kept.

        Args:
            tolerance: metres and radians beside the goal that are an arrival.
        """
        self.goal_change, plan = self._change, self.plan
        if self.goal_change and plan is not None and not self.beside:
            is_beside = plan.goal_off_m > tolerance[0] or plan.goal_off_rad > tolerance[1]
            self.beside = self.goal_change if is_beside else ""
        self.plan = None
        self.goals.reached()
        self.come_on()
        self._has_waited = False

    def held_for_s(self, now_s: float, is_held: bool) -> float:
        """For how long it has been held; 0 where it is not."""
        return self._held.for_s(now_s, is_held)

    def stopped_for_s(self, now_s: float, is_stopped: bool) -> float:
        """For how long the robot has stood by itself; 0 where it does not."""
        return self._stopped.for_s(now_s, is_stopped)

    def silent_for_s(self, now_s: float, is_silent: bool) -> float:
        """For how long a part of the program has not answered; 0 where all do."""
        return self._silent.for_s(now_s, is_silent)

    def result(self, has_arrived: bool, reason: NavigationReason | None, detail: str, now_s: float) -> NavigationResult:
        """What became of it."""
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
    """For how long something has been so without a break."""

    def __init__(self) -> None:
        self._since_s: float | None = None

    def for_s(self, now_s: float, is_so: bool) -> float:
        if not is_so:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = now_s
        return 0.0 if self._since_s is None else now_s - self._since_s


# What a navigator tells: its state, why it changed, how far it is, and what became of a task.


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


# What a navigator's feedback is called where people read it.


STATUS_WORDS = {
    Status.INITIALIZING: "looks for its place in the map",
    Status.TRACKING: "knows where it is",
    Status.COASTING: "by its wheels alone",
    Status.FAILING: "does not trust where it is",
    Status.LOST: "lost",
}


def monitor_words(feedback: Feedback) -> str:
    """What the collision monitor does and why, and what stays in the way without depth behind it."""
    found, stays = feedback.monitor, f"; {feedback.stays}" if feedback.stays else ""
    if found is None or found.state is MonitorState.FREE:
        return f"lets it drive{stays}"
    does = "slows it down" if found.state is MonitorState.SLOWED else "holds it"
    return f"{does}: {found.reason}{stays}" if found.reason is not None else f"{does}{stays}"
