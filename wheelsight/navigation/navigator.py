"""Navigator: drives a robot to its goals, one control period after another.

`Navigator.step` is the whole of a period: a state machine over planner, controller and recovery behaviours. A
`ControlChain` passes each requested command through a velocity ramp and the collision monitor. The monitor's command
is the one that the robot gets. `NavigationTask` is the navigator's memory of one task. `Feedback`, `Transition` and
`NavigationResult` are what it reports.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.checks import need_method
from wheelsight.core.errors import ArgumentError, PartError, WheelsightError
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry.se2 import wrap_angle
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.core.robots import STOPPED, Localization, Robot, nearby_of
from wheelsight.core.threads import OneCaller, Worker, one_at_a_time
from wheelsight.navigation.behaviours import (
    Behaviour,
    OpenWay,
    Wait,
    beside_goal,
    unsure_at_goal,
    when_blocked,
    when_lost,
    when_unseen,
)
from wheelsight.navigation.collision_monitor import ControlChain, MonitorReason, MonitorResult, MonitorState
from wheelsight.navigation.controllers import (
    STUCK_S,
    Controller,
    ControlReason,
    ControlResult,
    MppiController,
    OwnController,
    PurePursuitController,
    stands,
)
from wheelsight.navigation.costmap import Floor
from wheelsight.navigation.exploration import Exploration
from wheelsight.navigation.perception import discs_of
from wheelsight.navigation.planner import PathPlanner, Plan, PlanFailure, PlanReason
from wheelsight.navigation.planning import (
    ONWARD_M,
    ByHand,
    Goals,
    PlannerClient,
    PlanningResult,
    PoseGoals,
    RecordedPath,
    checked_goal,
    to_go_m,
)
from wheelsight.navigation.senses import Senses, WhereNow
from wheelsight.navigation.settings import NavigationSettings, NavigatorSettings
from wheelsight.navigation.shared_control import SharedControl, intended_by, steering_words


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
    UNSURE = "it may be farther from the goal than asked"
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
        warnings: sentences of the localization about faults of sensors.
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
    warnings: tuple[str, ...] = ()

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


# Time between checks of the path ahead, and the least time between plans while it drives.
_CHECK_S, _REPLAN_S = 0.5, 1.0
# Distance from the last recovery that is progress; and the time without it before it recovers: a path with many turns
# in a narrow place takes 20 s. Consecutive plans may lead to and fro.
_PROGRESS_M, _LOITER_S = 1.0, 30.0
# A robot waits before a detour longer than this factor times the rest of the old path, plus this addition: the way that
# a wait takes at walking speed among people.
_ROUND_TIMES, _ROUND_M = 1.5, 1.0
# Least rest of a plan on which the robot drives on past a goal that it has met: below it brakes already.
_PASSING_M = 0.5
# The time in which `Navigator.run` waits for a standstill after the task is complete.
_STOPPING_S = 5.0
# Consecutive goals to skip before the robot recovers instead: then it is the robot that is blocked.
_SKIPS = 2


class Navigator(OneCaller):
    """Drives one robot: call `step` once per period, or `run`.

    Args:
        robot: the robot to drive; the caller opens and closes it.
        planning: worker that computes plans, in step (for simulators) or in a thread; None for in step. The caller
            closes it.
        planner, controller: replacements of the built-in ones; limits and collision monitor still apply.
        trusts_floor: whether the floor near the robot, below the camera's view, is free at the start. Set it only if a
            person has looked. Otherwise a robot whose camera sees the floor farther away only does not move.
        on_transition: callback for each change of state.

    Attributes:
        result: of the last task; None until it is complete.

    Raises ArgumentError, MapError, CalibrationError as `Senses`; ArgumentError also for a part without its method.
    """

    def __init__(
        self,
        robot: Robot,
        localization: Localization,
        floor: Floor,
        settings: NavigationSettings | None = None,
        *,
        planning: Worker[PlanningResult] | None = None,
        planner: PathPlanner | None = None,
        controller: Controller | None = None,
        trusts_floor: bool = False,
        on_transition: Callable[[Transition], None] = lambda transition: None,
    ) -> None:
        self.settings = s = settings or NavigationSettings()
        for name, part, method in (("planner", planner, "plan"), ("controller", controller, "command")):
            if part is not None:
                need_method(name, part, method)
        self.footprint = s.footprint.outline
        self._robot = robot
        drive = robot.calibration.drive_model
        self._chain = ControlChain(s, drive, robot.calibration.nearby)
        self.monitor = self._chain.monitor
        self._shared, self._helps = SharedControl(self.monitor, s, drive), ""
        self.senses = Senses(robot.calibration, localization, floor, self.monitor, self.footprint, s)
        self.monitor.trust_floor(self.senses.near_m if trusts_floor else 0.0)
        self._planner = PlannerClient(self.senses, self.footprint, s, planning, planner)
        self._controller: Controller
        if controller is not None:
            self._controller = OwnController(controller, s.follow.goal_m, s.follow.goal_rad)
        elif s.controller == "mppi":
            self._controller = MppiController(self.footprint, s.limits, s.mppi, s.follow.of_drive(drive))
        else:
            self._controller = PurePursuitController(self.footprint, s.limits, s.follow.of_drive(drive))
        self._on_transition = on_transition
        self.state = NavigationState.IDLE
        self._task: NavigationTask | None = None
        self._predicted: FloatArray = np.empty((0, 3))
        self.result: NavigationResult | None = None
        self._stepped_s, self._is_halted = -math.inf, False

    def go_to_pose(self, goal: ArrayLike, name: str = "") -> None:
        """Start to drive to x, y, yaw (3,) in the map, or to x and y (2,). Raises ArgumentError if it is not a pose."""
        self.begin(PoseGoals([goal], name))

    def go_through_poses(self, goals: Sequence[ArrayLike], name: str = "") -> None:
        """Start to drive to several poses, with a stop at each. Raises ArgumentError."""
        self.begin(PoseGoals(goals, name))

    def follow_way(self, way: ArrayLike, name: str = "a recorded way") -> None:
        """Start to drive along a recorded path (N, 3). Raises ArgumentError."""
        self.begin(RecordedPath(way, name))

    def explore(self) -> None:
        """Start to explore all reachable floor of a growing map."""
        margin_m, senses = self.settings.planner.margin_m, self.senses
        self.begin(Exploration(self.footprint, margin_m, senses.near_m, senses.half_view_rad))

    @one_at_a_time
    def why_no_goal(self, goal: ArrayLike) -> str:
        """Return why no plan can end at a goal, such as a wall there; empty if one can.

        Only a map from an earlier session gives a reason. This takes as long as the costmap of a plan: call it before a
        drive, not during one. Raises ArgumentError.

        Args:
            goal: (3,) x, y, yaw in the map, or (2,) x and y.
        """
        return self._planner.why_no_goal(checked_goal(goal))

    @one_at_a_time
    def begin(self, goals: Goals) -> None:
        """Start a task. Cancels the current one. One `ByHand` ends without a result: `step` on until it is complete."""
        self.cancel_task()
        self.result = None
        self._planner.drop()
        self._task, self._stepped_s = NavigationTask(goals, self._robot.now_s), self._robot.now_s
        if isinstance(goals, ByHand):
            self._set_state(NavigationState.DRIVING, goals.name)
            return
        self._set_state(NavigationState.PLANNING, f"to {goals.name}")
        if self.senses.where.is_known:
            # The plan is ready a period earlier if it is requested now.
            self._planner.ask(goals, self._robot.now_s)

    def cancel_task(self) -> None:
        """Cancel the task; the robot brakes during the next steps."""
        if not self.is_task_complete():
            self._fail(NavigationReason.CANCELED, "by the caller")

    @one_at_a_time
    def clear_obstacles(self, xy: ArrayLike, radius_m: float = 1.0) -> None:
        """Remove the obstacles that the camera detected near x and y (2,) in the map, because a person sees none there.

        Real obstacles return with the next image that shows them. Obstacles of the map stay. Without a known pose,
        nothing happens. Raises ArgumentError for an invalid place or radius.
        """
        at = checked_goal(np.asarray(xy, float).ravel()[:2])
        if not 0 < radius_m < math.inf:
            raise ArgumentError(f"a radius of {radius_m} m", fix="over 0, finite")
        self.senses.clear_near(at[:2], radius_m)
        if self._task is not None:
            self._task.checked_s = -math.inf

    @one_at_a_time
    def clear_fault(self) -> None:
        """Permit driving again after a person has checked wheels that did not follow their commands."""
        self._chain.clear_fault()

    def is_task_complete(self) -> bool:
        """Return whether no task is active."""
        return self.state in (NavigationState.IDLE, NavigationState.ARRIVED, NavigationState.FAILED)

    def go_to(self, goal: ArrayLike, on_step: Callable[[Feedback], None] = lambda feedback: None) -> NavigationResult:
        """Drive to a goal and stop; `on_step` gets each period's feedback. Raises as `go_to_pose` and the robot do."""
        self.go_to_pose(goal)
        return self.run(on_step)

    def run(self, on_step: Callable[[Feedback], None] = lambda feedback: None) -> NavigationResult:
        """Run steps until the task is complete and the robot stands. Begin a task first. Raises what the robot raises.

        If no reading confirms the standstill, as with failed encoders, it waits for at most `_STOPPING_S`.
        """
        while not self.is_task_complete():
            on_step(self.step())
        until_s = self._robot.now_s + _STOPPING_S
        while not self._stands() and self._robot.now_s < until_s:
            on_step(self.step())
        assert self.result is not None
        return self.result

    @one_at_a_time
    def step(self) -> Feedback:
        """Run one period: send the command, read the sensors, decide, and check the next command.

        A part that does not answer stops the motors at once. The task continues if the part answers within
        `navigator.held_s`, and fails otherwise. Raises what the robot raises.
        """
        events = self._robot.step(self._chain.command)
        now_s, before_s = self._robot.now_s, self._stepped_s
        self._stepped_s, most_s = now_s, self.settings.navigator.held_s
        silent = None
        self.monitor.add_nearby(nearby_of(self._robot))
        try:
            self.senses.update(events, now_s)
        except WheelsightError as error:
            silent = MonitorReason.LOCALIZATION_SILENT
            self._fail(NavigationReason.LOCALIZATION, str(error))
        if now_s - before_s > most_s and math.isfinite(before_s):
            self._fail(NavigationReason.SILENT, f"the program stood still for {now_s - before_s:.1f} s")
        silent = silent or self._silent_part(now_s)
        if self._task is not None and self._task.seconds("silent", now_s, is_met=silent is not None) > most_s:
            self._fail(NavigationReason.SILENT, f"{silent}, for {most_s:g} s")
        asked = STOP if silent else self._decide(now_s)
        # A part that is silent while the robot moves removes the motors' voltage until the part answers again.
        self._is_halted = silent is not None and (self._is_halted or self._is_moving())
        if self._is_halted and not self._robot.stop_reason:
            with suppress(WheelsightError):  # a controller that does not confirm stops by its own watchdog
                self._robot.stop()
        status, stands_by_itself = self.senses.where.driving_status, bool(self._robot.stop_reason)
        self._chain.ask(asked, now_s, status, stands_by_itself=stands_by_itself, silent=silent)
        return self.feedback

    def _silent_part(self, now_s: float) -> MonitorReason | None:
        """Return the part whose answer is overdue. The planner counts only while the robot drives or brakes."""
        if self.senses.where.is_silent:
            return MonitorReason.LOCALIZATION_SILENT
        if self.monitor.is_camera_silent(now_s):
            return MonitorReason.CAMERA_SILENT
        if self.senses.floor.is_silent(now_s):
            return MonitorReason.FLOOR_SILENT
        is_driving = self.state is NavigationState.DRIVING or self._is_moving()
        return MonitorReason.PLANNER_SILENT if is_driving and self._planner.is_silent(now_s) else None

    def _is_moving(self) -> bool:
        """Return whether the robot moves or has a command to move."""
        return not (self._chain.command.is_stop and self._stands())

    @property
    def feedback(self) -> Feedback:
        """State and progress of the task."""
        where, state, task = self.senses.where, self.senses.where.state, self._task
        plan = task.plan if task is not None and not self.is_task_complete() else None
        return Feedback(
            stamp_s=self._robot.now_s,
            state=self.state,
            status=where.status,
            pose=None if state is None else state.pose,
            forward_m_s=where.speed.forward_m_s,
            turn_rad_s=where.speed.turn_rad_s,
            goal=None if plan is None else plan.goal,
            to_go_m=None if plan is None or state is None else to_go_m(plan, state.pose),
            plan=plan,
            predicted=self._predicted,
            monitor=self._chain.checked,
            doing="" if task is None else self._helps or task.doing,
            goals_left=0 if task is None else task.goals.left,
            # For a stop by the navigator itself, the monitor has the reason.
            robot_stop="" if self._is_halted and self._robot.stop_reason == STOPPED else self._robot.stop_reason,
            stays_at=None if self.is_task_complete() else self.senses.what_stays(),
            has_wheel_fault=self.monitor.has_wheel_fault,
            warnings=self.senses.warnings,
        )

    def _decide(self, now_s: float) -> VelocityCommand:
        """Return the requested command, by state."""
        self._predicted, self._helps = np.empty((0, 3)), ""
        task = self._task
        if task is None or self.is_task_complete():
            return STOP
        task.update_progress(now_s, self.senses.where, meets_people=bool(self.senses.people(now_s)))
        if self._chain.checked.reason is MonitorReason.WHEELS_OFF:
            return self._fail(NavigationReason.DISOBEYS, "look at the wheels, then clear the fault")
        if task.seconds("stopped", now_s, is_met=bool(self._robot.stop_reason)) > self.settings.navigator.held_s:
            return self._fail(NavigationReason.ROBOT_STOPPED, self._robot.stop_reason)
        if isinstance(task.goals, ByHand):
            command = task.goals.commands()
            if command is None:
                self._set_state(NavigationState.IDLE, "no more commands come")
            elif task.goals.is_stick:
                command = self._help(command, now_s)
            return command if command is not None and self.senses.keeps_clear(command) else STOP
        why_over = task.why_over(now_s, self.settings)
        if why_over is not None:
            return self._fail(*why_over)
        if self._robot.stop_reason:
            return STOP
        self.senses.avoids_hidden = not task.passes_hidden and self.state is not NavigationState.RECOVERING
        if self.state is NavigationState.RECOVERING:
            return self._run_recovery(task, now_s)
        return self._drive(task, now_s) if self.state is NavigationState.DRIVING else self._plan(task, now_s)

    def _help(self, stick: VelocityCommand, now_s: float) -> VelocityCommand:
        """Return the command of a stick's position with the help of `SharedControl`."""
        limits, speed = self.settings.limits, self.senses.where.speed
        intended = intended_by(stick.forward_m_s, stick.turn_rad_s, limits)
        command = self._shared.steer(intended, now_s, VelocityCommand(speed.forward_m_s, speed.turn_rad_s))
        self._helps = steering_words(command.turn_rad_s - intended.turn_rad_s, limits)
        return command

    def _plan(self, task: NavigationTask, now_s: float) -> VelocityCommand:
        """Wait for a plan and drive it, or recover if there is none."""
        if not self.senses.where.is_known:
            return self._start_relocalization(task, self.senses.where.why_unknown)
        if not self._planner.is_asked:
            self._planner.ask(task.goals, now_s)
        planned = self._planner.answer(now_s)
        if self._planner.is_lost(now_s, self.settings.navigator.held_s):
            self._planner.drop()
            return self._fail(NavigationReason.SILENT, MonitorReason.PLANNER_SILENT)
        command = STOP if planned is None else self._take(task, planned, now_s)
        # In the same period, so that the caller does not wait for another one.
        return self._drive(task, now_s) if self.state is NavigationState.DRIVING else command

    def _take(self, task: NavigationTask, planned: PlanningResult, now_s: float) -> VelocityCommand:
        """Act on the answer of the planner."""
        task.goals.taken()
        task.passes_hidden |= planned.passes_hidden
        if planned.found is None and task.missed is not None:
            return self._fail(*task.missed)
        if planned.found is None:
            self._set_state(NavigationState.ARRIVED, task.goals.name)
            self.result = task.result(True, None, task.goals.name, self._robot.now_s)
            return STOP
        if isinstance(planned.found, PlanFailure):
            return self._without_plan(task, planned.found)
        wait_s = self.settings.behaviours.wait_s
        if self.senses.floor.is_fixed and task.await_way(planned.found, self.senses.where, wait_s):
            self._set_state(NavigationState.RECOVERING, task.doing)
            return STOP
        task.take(planned.found, now_s, planned.T_map_odom)
        self._set_state(NavigationState.DRIVING, f"{planned.found.length_m:.1f} m to go")
        return STOP

    def _without_plan(self, task: NavigationTask, failure: PlanFailure) -> VelocityCommand:
        """Skip the goal, recover or give up. A plan may exist once people have left or more floor is visible."""
        why = f"{failure.reason}: {failure.detail}"
        if not failure.reason.is_for_good and (stays := stays_words(self.senses.what_stays())):
            why = f"{why}; {stays}"
        is_blocked = failure.reason is PlanReason.IN_THE_WAY
        task.why_first, task.may_clear = task.why_first or why, task.may_clear or is_blocked
        if failure.reason.is_of_goal and task.goals.left > 1 and task.skips < _SKIPS and task.goals.missed():
            task.skips += 1
            return STOP
        if not failure.reason.is_for_good and task.may_try(self.settings.navigator):
            return self._start_recovery(task, why)
        # If the last reason differs, the recovery itself, such as backing up, may have caused it.
        is_same = task.why_first.startswith(failure.reason)
        reason = NavigationReason.BLOCKED if is_blocked else NavigationReason.NO_PLAN
        return self._give_up(task, reason, why if is_same else f"{task.why_first}; at last {why}")

    def _drive(self, task: NavigationTask, now_s: float) -> VelocityCommand:
        """Follow the plan while it is valid."""
        where = self.senses.where
        state, local, plan = where.state, self.senses.local(), task.plan
        if (why := where.why_unknown) or state is None or local is None or plan is None:
            return self._start_relocalization(task, why)
        if now_s - task.checked_s >= _CHECK_S:
            task.checked_s = now_s
            is_met = not self._planner.is_asked and task.goals.is_met(state.pose, self.senses.floor.layer)
            if is_met and not self._passes_goal(task, plan, now_s):
                return self._reached(task)
            if not self._check_plan(task, plan, now_s):
                self._set_state(NavigationState.PLANNING, task.replan_reason)
                return STOP
        planned = self._planner.answer(now_s) if self._planner.is_asked else None
        if planned is not None:
            self._set_state(NavigationState.PLANNING, task.replan_reason)
            command = self._take(task, planned, now_s)
            if self.state is not NavigationState.DRIVING or task.plan is None:
                return command
        people = discs_of(self.senses.people(now_s))
        try:
            result = self._controller.command(state, plan if task.plan is None else task.plan, local.field, people)
        except PartError as error:
            return self._fail(NavigationReason.CONTROLLER, error.problem)
        self._predicted = result.predicted
        return self._follow(task, result, now_s)

    def _check_plan(self, task: NavigationTask, plan: Plan, now_s: float) -> bool:
        """Check the plan, and request another if needed; return whether the path is free.

        The request follows a period after the check, as both take long.
        """
        if self._planner.is_asked:
            return self._planner.is_free(plan, ONWARD_M)
        if task.wants_replan:
            task.wants_replan = False
            self._planner.ask(task.goals, now_s)
        if self._planner.is_asked or now_s - task.planned_s < _REPLAN_S:
            return True
        task.replan_reason, is_free = self._planner.look(plan, task.T_map_odom)
        if not is_free:
            self._planner.ask(task.goals, now_s)
        elif task.replan_reason:
            task.wants_replan, task.checked_s = True, -math.inf
        return is_free

    def _passes_goal(self, task: NavigationTask, plan: Plan, now_s: float) -> bool:
        """Drive on past a goal that needs no stop while the next plan is computed; return whether the robot does."""
        state = self.senses.where.state
        is_short = state is None or to_go_m(plan, state.pose) < _PASSING_M
        if task.goals.is_asked_for or is_short or self._planner.is_busy or not self._planner.is_free(plan, ONWARD_M):
            return False
        task.goals.reached()
        task.restart_progress()
        task.replan_reason = "its goal is met on the way"
        self._planner.ask(task.goals, now_s)
        return True

    def _follow(self, task: NavigationTask, result: ControlResult, now_s: float) -> VelocityCommand:
        """Act on the result of the controller."""
        if result.reason is ControlReason.ARRIVED:
            return self._reached(task)
        if result.reason in (ControlReason.MISSED, ControlReason.OFF_PATH, ControlReason.NO_PATH):
            if not task.may_try(self.settings.navigator):
                return self._give_up(task, NavigationReason.BLOCKED, str(result.reason))
            task.tries += 1
            self._set_state(NavigationState.PLANNING, str(result.reason))
            return STOP
        is_held = result.reason is not None or self._chain.checked.state is MonitorState.STOPPED
        if task.seconds("held", now_s, is_met=is_held) > self.settings.navigator.held_s:
            stopped_by = self._chain.stopped_by(now_s - self.settings.navigator.held_s - STUCK_S)
            stays = stays_words(self.senses.what_stays())
            why = f"{stopped_by or result.reason}{f'; {stays}' if stays else ''}"
            return self._start_recovery(task, why, stopped_by)
        if now_s - task.since_s > _LOITER_S:
            return self._start_recovery(task, "it comes no farther")
        return result.command

    def _reached(self, task: NavigationTask) -> VelocityCommand:
        """Continue with the next goal. If the plan ended beside the goal because of a person, wait there once.

        If the pose is not within the tolerance with 95 %, it looks around once, and corrects itself.
        """
        self._planner.drop()
        why_unsure = self._why_unsure(task.plan) if task.goals.is_asked_for else ""
        if why_unsure and self.settings.limits.turn_rad_s > 0 and not task.has_looked:
            task.start_recovery(unsure_at_goal(), is_lost=False)
            task.has_looked = True
            self._set_state(NavigationState.RECOVERING, f"{why_unsure}; {task.doing}")
            return STOP
        if self._planner.is_busy:
            return STOP
        if task.change and not task.has_waited:
            task.start_recovery(beside_goal(self.settings.behaviours.wait_s), is_lost=False)
            task.has_waited = True
            self._set_state(NavigationState.RECOVERING, task.doing)
            return STOP
        task.reached((self.settings.follow.goal_m, self.settings.follow.goal_rad), why_unsure)
        self._set_state(NavigationState.PLANNING, "a goal is reached")
        return STOP

    def _why_unsure(self, plan: Plan | None) -> str:
        """Return how far off the end of a plan the robot may be, if that is more than the tolerance; else ""."""
        where, s = self.senses.where, self.settings.follow
        accuracy, state = where.accuracy, where.state
        if plan is None or accuracy is None or state is None:
            return ""
        off_m = float(np.hypot(*(state.pose - plan.goal)[:2])) + accuracy[0]
        off_rad = abs(float(wrap_angle(state.pose[2] - plan.goal[2]))) + accuracy[1]
        if off_m <= s.goal_m and off_rad <= s.goal_rad:
            return ""
        if math.isinf(off_m):
            return "nothing has confirmed its place in the map"
        return f"it may be {off_m:.2f} m and {math.degrees(off_rad):.0f}° off the goal"

    def _run_recovery(self, task: NavigationTask, now_s: float) -> VelocityCommand:
        """Run the recovery behaviour until it ends, then plan again."""
        where = self.senses.where
        is_known = where.is_known
        if task.is_lost and is_known:
            self._set_state(NavigationState.PLANNING, "it knows where it is")
            return STOP
        assert task.behaviour is not None
        command = task.behaviour.command(now_s, where.odom_pose)
        if command is not None:
            task.is_refused = not self.senses.keeps_clear(command)
            return STOP if task.is_refused else command
        if task.is_lost and not is_known:
            return self._start_relocalization(task, f"still {where.why_unknown}")
        self.senses.clear(only_ahead=task.awaits_way)
        self._set_state(NavigationState.PLANNING, f"after it has done so: {task.behaviour.name}")
        return STOP

    def _start_recovery(
        self, task: NavigationTask, why: str, stopped_by: MonitorReason | None = None
    ) -> VelocityCommand:
        """Start a recovery behaviour, or give up."""
        if not task.may_try(self.settings.navigator):
            return self._give_up(task, NavigationReason.BLOCKED, why)
        self._planner.drop()
        task.start_next_recovery(self.settings, stopped_by, was_backward=self._chain.was_backward)
        self._set_state(NavigationState.RECOVERING, f"{why}; {task.doing}")
        return STOP

    def _give_up(self, task: NavigationTask, reason: NavigationReason, why: str) -> VelocityCommand:
        """Continue without an unreachable goal; fail if the task requires it."""
        self._planner.drop()
        if self._planner.is_busy:
            return STOP
        if not task.goals.missed():
            return self._fail(reason, why)
        task.tries = 0
        if self.state is not NavigationState.PLANNING:
            self._set_state(NavigationState.PLANNING, f"{why}; on without what is there")
        return STOP

    def _start_relocalization(self, task: NavigationTask, why: str) -> VelocityCommand:
        """Start a behaviour that finds the robot's pose."""
        self._planner.drop()
        task.start_relocalization(self.settings, self.senses.where.status, self._chain.checked, self.senses.open_way())
        self._set_state(NavigationState.RECOVERING, f"{why}; {task.doing}")
        return STOP

    def _fail(self, reason: NavigationReason, detail: str) -> VelocityCommand:
        """End the task with a reason, and stop."""
        task = self._task
        if task is not None and not self.is_task_complete():
            self._set_state(NavigationState.FAILED, f"{reason}: {detail}")
            self.result = task.result(False, reason, detail, self._robot.now_s)
        return STOP

    def _set_state(self, state: NavigationState, why: str) -> None:
        """Change the state and report the transition."""
        transition = Transition(self._robot.now_s, self.state, state, why)
        self.state = state
        if self._task is not None:
            self._task.transitions.append(transition)
        self._on_transition(transition)

    def _stands(self) -> bool:
        """Return whether the wheels stand still, or have given no reading yet."""
        speed = self.senses.where.speed
        return stands(speed.forward_m_s, speed.turn_rad_s) or not math.isfinite(speed.stamp_s)


class NavigationTask:
    """Goals, plan, recovery attempts and timers of one task.

    Attributes:
        planned_s, checked_s: when the plan was made, and when it was last checked against the surroundings.
        T_map_odom: (3,) x, y, yaw of `odom` in `map` at the request of the plan.
        replan_reason: why another plan was requested while this one is driven.
        goal_change: why the last reached goal differs from the requested one; empty if it does not.
        wants_replan: whether another plan is still to be requested.
        missed: reason and detail of the first goal at which the robot was, or may have been, beyond the tolerance.
        has_looked: whether it has looked around at the current goal to know its pose better.
        behaviour: current recovery behaviour; None without any.
        awaits_way: whether the behaviour waits for a blocked path to become free.
        is_refused: whether the map forbids the behaviour's command, because an obstacle is too near.
        passes_hidden: whether plans may cross unseen floor, as no other path was found since the last progress.
        may_clear: whether people were near, or what the map lacks in the only way, since the last progress.
        why_first: reason of the first failed plan since the last plan or progress; empty without any.
    """

    def __init__(self, goals: Goals, now_s: float) -> None:
        self.goals = goals
        self.plan: Plan | None = None
        self.planned_s = self.checked_s = -math.inf
        self.T_map_odom: FloatArray = np.zeros(3)
        self.wants_replan = False
        self.replan_reason = ""
        self.why_first = ""
        self.passes_hidden = False
        self.goal_change = ""
        self.missed: tuple[NavigationReason, str] | None = None
        self.has_waited = False
        self.has_looked = False
        # Recovery: the behaviour, and the numbers of attempts, of skipped goals and of searches for the pose.
        self.behaviour: Behaviour | None = None
        self.is_lost = self.awaits_way = self.is_refused = False
        self.tries = self.skips = self.searches = 0
        self._tried_s = now_s
        self._has_awaited_way = self.may_clear = False
        self._why_lost = ""
        self.known_s = now_s
        # Progress: where and when the robot last made some, and where it is.
        self._from = np.full(2, math.nan)
        self.since_s = now_s
        self._here = self._from
        self._now_s = now_s
        self._since: dict[str, float] = {}  # begin of each condition that is met
        # For the result.
        self.transitions: list[Transition] = []
        self._begun_s = now_s
        self._rolled_s = now_s
        self._way_m = 0.0
        self._planned_m = 0.0
        self._plans = self._recoveries = 0

    @property
    def doing(self) -> str:
        """Name of the current behaviour or goal."""
        return self.goals.name if self.behaviour is None else self.behaviour.name

    def update_progress(self, now_s: float, where: WhereNow, *, meets_people: bool) -> None:
        """Update distance and progress. Progress resets the recovery attempts, even if the robot goes to and fro."""
        self._now_s = now_s
        self.may_clear |= meets_people
        # Integrated over readings: failed encoders add no distance.
        speed = where.speed
        if speed.stamp_s > self._rolled_s:
            self._way_m += abs(speed.forward_m_s) * (speed.stamp_s - self._rolled_s)
            self._rolled_s = speed.stamp_s
        if where.odom_pose is not None:
            self._here = where.odom_pose[:2]
            if not np.hypot(*(self._here - self._from)) <= _PROGRESS_M:
                self.tries, self.passes_hidden, self._has_awaited_way = 0, False, False
                self.may_clear, self._tried_s, self.why_first = False, now_s, ""
                self.restart_progress()
        self._why_lost = where.why_unknown
        if not self._why_lost:
            self.known_s, self.searches = now_s, 0

    def restart_progress(self) -> None:
        """Measure progress from here and now."""
        self._from, self.since_s = self._here, self._now_s

    def take(self, plan: Plan, now_s: float, T_map_odom: FloatArray) -> None:
        """Drive a new plan."""
        self._plans += 1
        self._planned_m = self._planned_m or plan.length_m
        self.plan, self.planned_s, self.checked_s, self.T_map_odom = plan, now_s, now_s, T_map_odom
        self.behaviour, self.skips, self.wants_replan, self.why_first = None, 0, False, ""
        self._since.pop("held", None)

    def start_recovery(self, behaviour: Behaviour, *, is_lost: bool) -> None:
        """Start a recovery behaviour."""
        self.behaviour, self.is_lost, self.skips = behaviour, is_lost, 0
        self._since.pop("held", None)
        self.awaits_way = self.is_refused = False
        self._recoveries += 1
        if is_lost:
            self.searches += 1
        else:
            self.tries += 1
        self.restart_progress()

    def may_try(self, settings: NavigatorSettings) -> bool:
        """Return whether another recovery may start. If what is near may leave, the limit is a time, else a number."""
        return self.tries < settings.tries or (self.may_clear and self._now_s - self._tried_s < settings.patience_s)

    def start_next_recovery(
        self, settings: NavigationSettings, stopped_by: MonitorReason | None, *, was_backward: bool
    ) -> None:
        """Start the next recovery behaviour after a stop by the monitor.

        Waiting does not help at unseen floor: only another path does.
        """
        wait_s, tries = settings.behaviours.wait_s, self.tries
        self.passes_hidden = stopped_by is not MonitorReason.NEVER_SEEN
        if tries >= settings.navigator.tries:
            self.start_recovery(Wait(wait_s, "wait until people have gone, or things"), is_lost=False)
        elif self.passes_hidden:
            self.start_recovery(when_blocked(tries, wait_s), is_lost=False)
        else:
            self.start_recovery(when_unseen(tries, was_backward=was_backward), is_lost=False)

    def why_over(self, now_s: float, settings: NavigationSettings) -> tuple[NavigationReason, str] | None:
        """Return why the task cannot succeed: a limit of zero, or a pose unknown for too long. None if it can."""
        limits, lost_s = settings.limits, now_s - self.known_s
        if limits.forward_m_s == 0 and limits.backward_m_s == 0:
            return NavigationReason.NO_PLAN, f"{PlanReason.STANDS}: forward_m_s and backward_m_s are 0"
        if limits.turn_rad_s == 0 and lost_s > settings.behaviours.wait_s:
            return NavigationReason.LOST, "nor can it look about: turn_rad_s is 0"
        most_s = settings.navigator.lost_s
        return (NavigationReason.LOST, f"for {most_s:g} s: {self._why_lost}") if lost_s > most_s else None

    def start_relocalization(
        self, settings: NavigationSettings, status: Status, checked: MonitorResult, open_way: OpenWay | None
    ) -> None:
        """Start a behaviour that searches for the pose; see `when_lost`.

        A robot that may not turn waits: it must not drive before a whole turn has shown its surroundings.
        """
        s = settings.behaviours
        if settings.limits.turn_rad_s == 0:
            self.start_recovery(Wait(s.wait_s, "wait to see where it is"), is_lost=True)
            return
        is_held = self.is_refused or checked.state is MonitorState.STOPPED
        sees = checked.reason is not MonitorReason.NO_FRAME
        self.start_recovery(when_lost(self.searches, s, status, open_way, is_held=is_held, sees=sees), is_lost=True)

    def await_way(self, plan: Plan, where: WhereNow, wait_s: float) -> bool:
        """Wait, once per place, instead of driving a long detour; return whether it does so.

        A person in the way usually leaves sooner than the detour takes (cf. Nav2's `PathLongerOnApproach`).
        """
        if self.plan is None or where.state is None or self._has_awaited_way:
            return False
        left_m = to_go_m(self.plan, where.state.pose)
        if plan.length_m <= _ROUND_TIMES * left_m + _ROUND_M:
            return False
        self.start_recovery(Wait(wait_s, f"wait, rather than go {plan.length_m - left_m:.1f} m round"), is_lost=False)
        self.awaits_way = self._has_awaited_way = True
        return True

    @property
    def change(self) -> str:
        """Why the plan's goal differs from the requested one; empty if it does not, or if no place was requested."""
        return self.plan.goal_change if self.plan is not None and self.goals.is_asked_for else ""

    def reached(self, tolerance: tuple[float, float], why_unsure: str) -> None:
        """Record that the plan's goal is reached, and why it differs from the requested one.

        Args:
            tolerance: distance in metres and angle in radians that still count as an arrival.
            why_unsure: how far off the robot may be, if that is more; else "".
        """
        self.goal_change, plan = self.change, self.plan
        off = (0.0, 0.0) if plan is None or not self.goal_change else (plan.goal_off_m, plan.goal_off_rad)
        if off[0] > tolerance[0] or off[1] > tolerance[1]:
            self.missed = self.missed or (NavigationReason.BESIDE, self.goal_change)
        elif why_unsure:
            self.missed = self.missed or (NavigationReason.UNSURE, why_unsure)
        self.plan = None
        self.goals.reached()
        self.restart_progress()
        self.has_waited = self.has_looked = False

    def seconds(self, condition: str, now_s: float, *, is_met: bool) -> float:
        """Return for how long a named condition has been met without a break; 0 if it is not."""
        if is_met:
            return now_s - self._since.setdefault(condition, now_s)
        self._since.pop(condition, None)
        return 0.0

    def result(self, has_arrived: bool, reason: NavigationReason | None, detail: str, now_s: float) -> NavigationResult:
        """Return the result of the task."""
        counts = self._way_m, self._planned_m, self._plans, self._recoveries
        steps, time_s = tuple(self.transitions), now_s - self._begun_s
        return NavigationResult(has_arrived, reason, detail, self.goal_change, steps, time_s, *counts)
