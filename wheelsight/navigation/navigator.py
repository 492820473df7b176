"""Navigator: drives a robot to its goals, one control period after another.

`Navigator.step` is the whole of a period: a state machine over planner, controller and recovery behaviours. A
`ControlChain` passes each requested command through a velocity ramp and the collision monitor. The monitor's command
is the one that the robot gets.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.checks import need_method
from wheelsight.core.errors import ArgumentError, PartError, WheelsightError
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.core.robots import STOPPED, Robot, RobotLimits
from wheelsight.core.threads import OneCaller, one_at_a_time
from wheelsight.navigation.behaviours import beside_goal
from wheelsight.navigation.collision_monitor import CollisionMonitor, MonitorReason, MonitorResult, MonitorState
from wheelsight.navigation.controllers import MppiController, PurePursuitController
from wheelsight.navigation.exploration import Exploration
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.goals import Goals, Poses, Way, checked_goal
from wheelsight.navigation.localization import Localization, WhereNow
from wheelsight.navigation.path_following import Controller, ControlReason, ControlResult, OwnController
from wheelsight.navigation.people import discs_of
from wheelsight.navigation.planner import PathPlanner, Plan, PlanFailure
from wheelsight.navigation.planning import Planned, Planning, to_go_m
from wheelsight.navigation.senses import Senses
from wheelsight.navigation.settings import NavigationSettings
from wheelsight.navigation.static_map import Floor
from wheelsight.navigation.task import (
    Feedback,
    NavigationReason,
    NavigationResult,
    NavigationState,
    Task,
    Transition,
    stays_words,
)
from wheelsight.navigation.workers import Worker

# The time in which `Navigator.run` waits for a standstill after the task is complete.
_STOPPING_S = 5.0
# Consecutive goals to skip before the robot recovers instead: then it is the robot that is blocked.
_SKIPS = 2


class Navigator(OneCaller):
    """Drives one robot: call `step` once per period, or `run`.

    Args:
        robot: the robot to drive; the caller opens and closes it.
        localization: source of the pose.
        floor: the known part of the building.
        settings: all settings of navigation; None for the defaults.
        planning: worker that computes plans, in step (for simulators) or in a thread; None for in step. The caller
            closes it.
        planner, controller: replacements of the built-in ones; limits and collision monitor still apply.
        trusts_floor: whether the floor near the robot, below the camera's view, is free at the start. Set it only if a
            person has looked. Otherwise a robot whose camera sees the floor farther away only does not move.
        on_transition: callback for each change of state.

    Attributes:
        state: current state.
        monitor: the collision monitor, which decides on the final command.

    Raises:
        ArgumentError, MapError, CalibrationError: as `Senses`; ArgumentError also for a part without its method.
    """

    def __init__(
        self,
        robot: Robot,
        localization: Localization,
        floor: Floor,
        settings: NavigationSettings | None = None,
        *,
        planning: Worker[Planned] | None = None,
        planner: PathPlanner | None = None,
        controller: Controller | None = None,
        trusts_floor: bool = False,
        on_transition: Callable[[Transition], None] = lambda transition: None,
    ) -> None:
        self.settings = s = settings or NavigationSettings()
        for name, part, method in (("planner", planner, "plan"), ("controller", controller, "command")):
            if part is not None:
                need_method(name, part, method)
        self._footprint = s.footprint.outline
        self._robot = robot
        self._chain = ControlChain(s)
        self.monitor = self._chain.monitor
        self._senses = Senses(robot.calibration, localization, floor, self.monitor, self._footprint, s)
        self.monitor.trust_floor(self._senses.near_m if trusts_floor else 0.0)
        self._planning = Planning(self._senses, self._footprint, s, planning, planner)
        self._controller = controller_of(self._footprint, s, controller)
        self._on_transition = on_transition
        self.state = NavigationState.IDLE
        self._task: Task | None = None
        self._predicted: FloatArray = np.empty((0, 3))
        self._result: NavigationResult | None = None
        self._stepped_s, self._is_halted = -math.inf, False

    @property
    def footprint(self) -> Footprint:
        """Outline of the robot."""
        return self._footprint

    @property
    def senses(self) -> Senses:
        """Sensor data and the surroundings derived from it."""
        return self._senses

    def go_to_pose(self, goal: ArrayLike, name: str = "") -> None:
        """Start to drive to x, y, yaw (3,) in the map, or to x and y (2,). Raises ArgumentError if it is not a pose."""
        self.begin(Poses([goal], name))

    def go_through_poses(self, goals: Sequence[ArrayLike], name: str = "") -> None:
        """Start to drive to several poses, with a stop at each. Raises ArgumentError."""
        self.begin(Poses(goals, name))

    def follow_way(self, way: ArrayLike, name: str = "a recorded way") -> None:
        """Start to drive along a recorded path (N, 3). Raises ArgumentError."""
        self.begin(Way(way, self.settings.navigator.through_m, name))

    def explore(self) -> None:
        """Start to explore all reachable floor of a growing map."""
        self.begin(Exploration(self._footprint, self.settings, self._senses.near_m, self._senses.half_view_rad))

    @one_at_a_time
    def why_no_goal(self, goal: ArrayLike) -> str:
        """Return why no plan can end at a goal, such as a wall there; empty if one can.

        Only a map from an earlier session gives a reason. This takes as long as the costmap of a plan: call it before a
        drive, not during one. Raises ArgumentError.

        Args:
            goal: (3,) x, y, yaw in the map, or (2,) x and y.
        """
        return self._planning.why_no_goal(checked_goal(goal))

    @one_at_a_time
    def begin(self, goals: Goals) -> None:
        """Start a task. Cancels the current one."""
        if not self.is_task_complete():
            self.cancel_task()
        self._result = None
        self._planning.drop()
        self._task, self._stepped_s = Task(goals, self._robot.now_s), self._robot.now_s
        self._become(NavigationState.PLANNING, f"to {goals.name}")
        if self._senses.where.is_known(self.settings.navigator.unsure_m):
            # The plan is ready a period earlier if it is requested now.
            self._planning.ask(goals, self._robot.now_s)

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
        self._senses.clear_near(at[:2], radius_m)
        if self._task is not None:
            self._task.checked_s = -math.inf

    def is_task_complete(self) -> bool:
        """Return whether no task is active."""
        return self.state in (NavigationState.IDLE, NavigationState.ARRIVED, NavigationState.FAILED)

    @property
    def result(self) -> NavigationResult | None:
        """Result of the last task; None until it is complete."""
        return self._result

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
        assert self._result is not None
        return self._result

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
        try:
            self._senses.hear(events, now_s)
        except WheelsightError as error:
            silent = MonitorReason.LOCALIZATION_SILENT
            self._fail(NavigationReason.LOCALIZATION, str(error))
        if now_s - before_s > most_s and math.isfinite(before_s):
            self._fail(NavigationReason.SILENT, f"the program stood still for {now_s - before_s:.1f} s")
        silent = silent or self._silent_part(now_s)
        if self._task is not None and self._task.silent_for_s(now_s, silent is not None) > most_s:
            self._fail(NavigationReason.SILENT, f"{silent}, for {most_s:g} s")
        asked = STOP if silent else self._decide(now_s)
        # A part that is silent while the robot moves removes the motors' voltage until the part answers again.
        self._is_halted = silent is not None and (self._is_halted or self._is_moving())
        if self._is_halted and not self._robot.stop_reason:
            with suppress(WheelsightError):  # a controller that does not confirm stops by its own watchdog
                self._robot.stop()
        stands_by_itself = bool(self._robot.stop_reason)
        self._chain.ask(asked, now_s, self._senses.where, stands_by_itself=stands_by_itself, silent=silent)
        return self.feedback

    def _silent_part(self, now_s: float) -> MonitorReason | None:
        """Return the part whose answer is overdue. The planner counts only while the robot drives or brakes."""
        if self._senses.where.is_silent:
            return MonitorReason.LOCALIZATION_SILENT
        if self.monitor.is_camera_silent(now_s):
            return MonitorReason.CAMERA_SILENT
        if self._senses.floor.is_silent(now_s):
            return MonitorReason.FLOOR_SILENT
        is_driving = self.state is NavigationState.DRIVING or self._is_moving()
        return MonitorReason.PLANNER_SILENT if is_driving and self._planning.is_silent(now_s) else None

    def _is_moving(self) -> bool:
        """Return whether the robot moves or has a command to move."""
        return not (self._chain.command.is_stop and self._stands())

    @property
    def feedback(self) -> Feedback:
        """State and progress of the task."""
        where, state, task = self._senses.where, self._senses.where.state, self._task
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
            doing="" if task is None else task.doing,
            goals_left=0 if task is None else task.goals.left,
            # For a stop by the navigator itself, the monitor has the reason.
            robot_stop="" if self._is_halted and self._robot.stop_reason == STOPPED else self._robot.stop_reason,
            stays_at=None if self.is_task_complete() else self._senses.what_stays(),
        )

    def _decide(self, now_s: float) -> VelocityCommand:
        """Return the requested command, by state."""
        self._predicted = np.empty((0, 3))
        task = self._task
        if task is None or self.is_task_complete():
            return STOP
        meets_people = bool(self._senses.people(now_s))
        task.roll(now_s, self._senses.where, self.settings.navigator, meets_people=meets_people)
        if self._chain.checked.reason is MonitorReason.WHEELS_OFF:
            return self._fail(NavigationReason.DISOBEYS, "look at the wheels, then clear the fault")
        if task.stopped_for_s(now_s, bool(self._robot.stop_reason)) > self.settings.navigator.held_s:
            return self._fail(NavigationReason.ROBOT_STOPPED, self._robot.stop_reason)
        why_over = task.why_over(now_s, self.settings)
        if why_over is not None:
            return self._fail(*why_over)
        if self._robot.stop_reason:
            return STOP
        self._senses.avoids_hidden = not task.passes_hidden and self.state is not NavigationState.RECOVERING
        ways = {
            NavigationState.PLANNING: self._plan,
            NavigationState.DRIVING: self._drive,
            NavigationState.RECOVERING: self._recover,
        }
        return ways[self.state](task, now_s)

    def _plan(self, task: Task, now_s: float) -> VelocityCommand:
        """Wait for a plan and drive it, or recover if there is none."""
        if not self._senses.where.is_known(self.settings.navigator.unsure_m):
            return self._look_about(task, self._senses.where.why_unknown(self.settings.navigator.unsure_m))
        if not self._planning.is_asked:
            self._planning.ask(task.goals, now_s)
        planned = self._planning.answer(now_s)
        if self._planning.is_lost(now_s, self.settings.navigator.held_s):
            self._planning.drop()
            return self._fail(NavigationReason.SILENT, MonitorReason.PLANNER_SILENT)
        command = STOP if planned is None else self._take(task, planned, now_s)
        # In the same period, so that the caller does not wait for another one.
        return self._drive(task, now_s) if self.state is NavigationState.DRIVING else command

    def _take(self, task: Task, planned: Planned, now_s: float) -> VelocityCommand:
        """Act on the answer of the planner."""
        task.goals.taken()
        task.passes_hidden |= planned.passes_hidden
        if planned.found is None and task.beside:
            return self._fail(NavigationReason.BESIDE, task.beside)
        if planned.found is None:
            self._become(NavigationState.ARRIVED, task.goals.name)
            self._result = task.result(True, None, task.goals.name, self._robot.now_s)
            return STOP
        if isinstance(planned.found, PlanFailure):
            return self._without_plan(task, planned.found)
        if self._senses.floor.is_fixed and task.await_way(planned.found, self._senses.where, self.settings.behaviours):
            self._become(NavigationState.RECOVERING, task.doing)
            return STOP
        task.take(planned.found, now_s, planned.T_map_odom)
        self._become(NavigationState.DRIVING, f"{planned.found.length_m:.1f} m to go")
        return STOP

    def _without_plan(self, task: Task, failure: PlanFailure) -> VelocityCommand:
        """Skip the goal, recover or give up. A plan may exist once people have left or more floor is visible."""
        why = f"{failure.reason}: {failure.detail}"
        if not failure.reason.is_for_good and (stays := stays_words(self._senses.what_stays())):
            why = f"{why}; {stays}"
        task.why_first = task.why_first or why
        if failure.reason.is_of_goal and task.goals.left > 1 and task.skips < _SKIPS and task.goals.missed():
            task.skips += 1
            return STOP
        if not failure.reason.is_for_good and task.may_try(self.settings.navigator):
            return self._get_out(task, why)
        # If the last reason differs, the recovery itself, such as backing up, may have caused it.
        is_same = task.why_first.startswith(failure.reason)
        return self._give_up(task, NavigationReason.NO_PLAN, why if is_same else f"{task.why_first}; at last {why}")

    def _drive(self, task: Task, now_s: float) -> VelocityCommand:
        """Follow the plan while it is valid."""
        s, where = self.settings.navigator, self._senses.where
        state, local, plan = where.state, self._senses.local(), task.plan
        if (why := where.why_unknown(s.unsure_m)) or state is None or local is None or plan is None:
            return self._look_about(task, why)
        if now_s - task.checked_s >= s.check_s:
            task.checked_s = now_s
            if task.goals.is_met(state.pose, self._senses.floor.layer):
                return self._reached(task)
            if not self._may_go_on(task, plan, now_s):
                self._become(NavigationState.PLANNING, task.replan_reason)
                return STOP
        planned = self._planning.answer(now_s) if self._planning.is_asked else None
        if planned is not None:
            self._become(NavigationState.PLANNING, task.replan_reason)
            command = self._take(task, planned, now_s)
            if self.state is not NavigationState.DRIVING or task.plan is None:
                return command
        people = discs_of(self._senses.people(now_s))
        try:
            result = self._controller.command(state, task.plan or plan, local.field, people)
        except PartError as error:
            return self._fail(NavigationReason.CONTROLLER, error.problem)
        self._predicted = result.predicted
        return self._follow(task, result, now_s)

    def _may_go_on(self, task: Task, plan: Plan, now_s: float) -> bool:
        """Return whether the plan is free. A new plan is requested a period after the check, as both take long."""
        if self._planning.is_asked:
            return self._planning.is_free(plan, self.settings.navigator.onward_m)
        if task.wants_replan:
            task.wants_replan = False
            self._planning.ask(task.goals, now_s)
        if self._planning.is_asked or now_s - task.planned_s < self.settings.navigator.anew_s:
            return True
        look = self._planning.look(plan, task.T_map_odom, now_s)
        if not look.is_free:
            self._planning.ask(task.goals, now_s)
        elif look.why:
            task.wants_replan, task.checked_s = True, -math.inf
        task.replan_reason = look.why
        return look.is_free

    def _follow(self, task: Task, result: ControlResult, now_s: float) -> VelocityCommand:
        """Act on the result of the controller."""
        if result.reason is ControlReason.ARRIVED:
            return self._reached(task)
        if result.reason in (ControlReason.MISSED, ControlReason.OFF_PATH, ControlReason.NO_PATH):
            if not task.may_try(self.settings.navigator):
                return self._give_up(task, NavigationReason.BLOCKED, str(result.reason))
            task.tries += 1
            self._become(NavigationState.PLANNING, str(result.reason))
            return STOP
        is_held = result.reason is not None or self._chain.checked.state is MonitorState.STOPPED
        if task.held_for_s(now_s, is_held) > self.settings.navigator.held_s:
            stopped_by = self._chain.stopped_by(now_s - self.settings.navigator.held_s - self.settings.follow.stuck_s)
            stays = stays_words(self._senses.what_stays())
            why = f"{stopped_by or result.reason}{f'; {stays}' if stays else ''}"
            return self._get_out(task, why, stopped_by)
        if task.loiters_s > self.settings.navigator.loiter_s:
            return self._get_out(task, "it comes no farther")
        return result.command

    def _reached(self, task: Task) -> VelocityCommand:
        """Continue with the next goal. If the plan ended beside the goal because of a person, wait there once."""
        self._planning.drop()
        if self._planning.is_busy:
            return STOP
        if task.may_wait:
            task.await_goal(beside_goal(self.settings.behaviours))
            self._become(NavigationState.RECOVERING, task.doing)
            return STOP
        task.reached((self.settings.follow.goal_m, self.settings.follow.goal_rad))
        self._become(NavigationState.PLANNING, "a goal is reached")
        return STOP

    def _recover(self, task: Task, now_s: float) -> VelocityCommand:
        """Continue the recovery behaviour, then plan again."""
        where = self._senses.where
        if task.is_lost and (is_known := where.is_known(self.settings.navigator.unsure_m)):
            self._become(NavigationState.PLANNING, "it knows where it is")
            return STOP
        assert task.behaviour is not None
        command = task.behaviour.command(now_s, where.odom_pose)
        if command is not None:
            task.is_refused = not self._senses.keeps_clear(command)
            return STOP if task.is_refused else command
        if task.is_lost and not is_known:
            return self._look_about(task, f"still {where.why_unknown(self.settings.navigator.unsure_m)}")
        self._senses.clear(only_ahead=task.awaits_way)
        self._become(NavigationState.PLANNING, f"after it has done so: {task.behaviour.name}")
        return STOP

    def _get_out(self, task: Task, why: str, stopped_by: MonitorReason | None = None) -> VelocityCommand:
        """Start a recovery behaviour, or give up."""
        if not task.may_try(self.settings.navigator):
            return self._give_up(task, NavigationReason.BLOCKED, why)
        self._planning.drop()
        task.get_out(self.settings, stopped_by, was_backward=self._chain.was_backward)
        self._become(NavigationState.RECOVERING, f"{why}; {task.doing}")
        return STOP

    def _give_up(self, task: Task, reason: NavigationReason, why: str) -> VelocityCommand:
        """Continue without an unreachable goal; fail if the task requires it."""
        self._planning.drop()
        if self._planning.is_busy:
            return STOP
        if not task.goals.missed():
            return self._fail(reason, why)
        task.tries = 0
        if self.state is not NavigationState.PLANNING:
            self._become(NavigationState.PLANNING, f"{why}; on without what is there")
        return STOP

    def _look_about(self, task: Task, why: str) -> VelocityCommand:
        """Start a behaviour that finds the robot's pose."""
        self._planning.drop()
        task.search(self.settings, self._senses.where.status, self._chain.checked, self._senses.open_way())
        self._become(NavigationState.RECOVERING, f"{why}; {task.doing}")
        return STOP

    def _fail(self, reason: NavigationReason, detail: str) -> VelocityCommand:
        """End the task with a reason, and stop."""
        task = self._task
        if task is not None and not self.is_task_complete():
            self._become(NavigationState.FAILED, f"{reason}: {detail}")
            self._result = task.result(False, reason, detail, self._robot.now_s)
        return STOP

    def _become(self, state: NavigationState, why: str) -> None:
        """Change the state and report the transition."""
        transition = Transition(self._robot.now_s, self.state, state, why)
        self.state = state
        if self._task is not None:
            self._task.transitions.append(transition)
        self._on_transition(transition)

    def _stands(self) -> bool:
        """Return whether the wheels stand still, or have given no reading yet."""
        speed = self._senses.where.speed
        return self.settings.follow.stands(speed.forward_m_s, speed.turn_rad_s) or not math.isfinite(speed.stamp_s)


class ControlChain:
    """Passes each requested command through a velocity ramp and the collision monitor.

    Args:
        settings: limits, footprint and monitor of the robot.

    Attributes:
        monitor: decides on the final command.
        checked: the monitor's result for the last command.
        was_backward: whether the last command that the monitor stopped was backward.
    """

    def __init__(self, settings: NavigationSettings) -> None:
        self.monitor = CollisionMonitor(
            settings.footprint.outline, settings.limits, settings.monitor, settings.wheel_check
        )
        self.checked = MonitorResult(STOP, MonitorState.FREE)
        self._stopped: tuple[float, MonitorReason | None] = (-math.inf, None)
        self.was_backward = False
        self._ramp, self._period_s = VelocityRamp(settings.limits), settings.follow.period_s

    @property
    def command(self) -> VelocityCommand:
        """Command for the robot."""
        return self.checked.command

    def ask(
        self,
        asked: VelocityCommand,
        now_s: float,
        where: WhereNow,
        *,
        stands_by_itself: bool,
        silent: MonitorReason | None = None,
    ) -> None:
        """Compute the command of a period.

        Args:
            asked: command that the navigator requests.
            now_s: time of the period.
            where: pose and its status.
            stands_by_itself: whether the robot has stopped by itself, and does not obey.
            silent: the part that does not answer; with one the command is a stop.
        """
        if stands_by_itself:
            # A ramp down during its own stop would look like disobedience, and would delay the stop command.
            self._ramp.follow(STOP)
        ramped = self._ramp.step(asked.forward_m_s, asked.turn_rad_s, self._period_s)
        # Without a place in the map, but with a known motion, the robot may turn to search for it.
        is_searching = where.status is Status.INITIALIZING and where.is_rolling
        status = Status.COASTING if is_searching else where.status
        self.checked = self.monitor.check(ramped, now_s, status, silent)
        if self.checked.state is not MonitorState.FREE:
            self._ramp.follow(self.checked.command)
        if self.checked.state is MonitorState.STOPPED:
            self._stopped = now_s, self.checked.reason
            self.was_backward = asked.forward_m_s < 0

    def stopped_by(self, since_s: float) -> MonitorReason | None:
        """Return why the monitor last stopped the robot since a time. A controller only knows that it does not move."""
        return self._stopped[1] if self._stopped[0] >= since_s else None


def controller_of(footprint: Footprint, settings: NavigationSettings, own: Controller | None = None) -> Controller:
    """Return a user's own controller, else the one that the settings name."""
    if own is not None:
        return OwnController(own, settings.follow.goal_m, settings.follow.goal_rad)
    if settings.controller == "mppi":
        return MppiController(footprint, settings.limits, settings.mppi, settings.follow)
    return PurePursuitController(footprint, settings.limits, settings.pure_pursuit, settings.follow)


class VelocityRamp:
    """Keeps the limits on speed, acceleration and jerk (`RobotLimits`) from one command to the next.

    Acceleration rises with limited jerk, and falls with it near the requested speed. Deceleration is not limited by
    jerk: a stop or a lower requested speed ends acceleration at once. Turns have a limit on acceleration only.
    """

    def __init__(self, limits: RobotLimits | None = None) -> None:
        self._limits = limits or RobotLimits()
        self._given = STOP
        self._acceleration_m_s2 = 0.0

    @property
    def given(self) -> VelocityCommand:
        """Last command."""
        return self._given

    def follow(self, driven: VelocityCommand) -> None:
        """Continue from a command that was reduced after the ramp."""
        self._given, self._acceleration_m_s2 = driven, 0.0

    def step(self, forward_m_s: float, turn_rad_s: float, period_s: float) -> VelocityCommand:
        """Return the command one period after the last one.

        Args:
            forward_m_s: requested speed; a value that is not finite requests a stop of both.
            turn_rad_s: requested turn rate.
            period_s: time since the last command, above 0.

        Raises:
            ArgumentError: the period is not a positive number.
        """
        if not (math.isfinite(period_s) and period_s > 0):
            raise ArgumentError(f"a period of {period_s} s", fix="give seconds since the last command, above 0")
        if not (math.isfinite(forward_m_s) and math.isfinite(turn_rad_s)):
            forward_m_s, turn_rad_s = 0.0, 0.0
        most = self._limits
        wanted = min(max(forward_m_s, -most.backward_m_s), most.forward_m_s)
        forward = self._forward(wanted, period_s)
        turn = min(max(turn_rad_s, -most.turn_rad_s), most.turn_rad_s)
        change = most.turn_acceleration_rad_s2 * period_s
        before = self._given.turn_rad_s
        self._given = VelocityCommand(forward, before + min(max(turn - before, -change), change))
        return self._given

    def _forward(self, wanted: float, period_s: float) -> float:
        """Return the next forward speed within acceleration, braking and jerk."""
        speed, limits = self._given.forward_m_s, self._limits
        slows = speed * (wanted - speed) < 0
        if slows:
            # Stop at zero: the other direction begins with its own acceleration.
            wanted = wanted if wanted * speed > 0 else 0.0
            change = limits.braking_m_s2 * period_s
            self._acceleration_m_s2 = 0.0
            return speed + min(max(wanted - speed, -change), change)
        sign = math.copysign(1.0, wanted - speed)
        # Speed gained while acceleration falls to zero with limited jerk: a² / 2j + a period / 2, in discrete steps.
        # Only the step that reaches the speed may exceed the jerk, by an eighth.
        half = limits.jerk_m_s3 * period_s / 2
        most = math.sqrt(half * half + 2 * limits.jerk_m_s3 * abs(wanted - speed)) - half
        most = min(limits.acceleration_m_s2, most)
        grown = max(self._acceleration_m_s2 * sign, 0.0) + limits.jerk_m_s3 * period_s
        change = min(min(most, grown) * period_s, abs(wanted - speed))
        self._acceleration_m_s2 = sign * change / period_s
        return wanted if change == abs(wanted - speed) else speed + sign * change
