"""Navigator: drives a robot to its goals, one control period after another. Its ControlChain passes each command
through a velocity ramp and the collision monitor.
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

# Navigator: drives a robot to its goals, period by period. The whole of it on one screen: `step`.
#
# A small explicit state machine over planner, controller and behaviours. What it asks for passes a `ControlChain`,
# whose collision monitor alone decides what the robot is told.


_STOPPING_S = 5.0
# So many goals are left out one after another before it is the robot that has to get out of something.
_SKIPS = 2


class Navigator(OneCaller):
    """Leads one robot; `step` once a period, or `run`.

    Args:
        robot: that is led; used in a `with` block by whoever made it.
        localization: says where it is.
        floor: what is known of the building.
        settings: or the defaults.
        planning: what makes its plans: in step, for simulators, or beside; None: in step. Whoever made it closes it.
        planner, controller: of your own, in place of the built-in ones; limits and collision monitor stay.
        trusts_floor: whether the floor that the camera cannot see from where the robot is, next to it, is free at the
            begin, as somebody says who looked. Without it a robot whose camera sees it only farther off stays.
        on_transition: called with each change of state.

    Attributes:
        state: what it is about.
        monitor: the collision monitor, which has the last word.

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
        """Of the robot."""
        return self._footprint

    @property
    def senses(self) -> Senses:
        """What it goes by."""
        return self._senses

    def go_to_pose(self, goal: ArrayLike, name: str = "") -> None:
        """Begin to drive to x, y, yaw (3,) in the map, or to x and y (2,). Raises ArgumentError for what is no pose."""
        self.begin(Poses([goal], name))

    def go_through_poses(self, goals: Sequence[ArrayLike], name: str = "") -> None:
        """Begin to drive to several, with a stop at each. Raises ArgumentError."""
        self.begin(Poses(goals, name))

    def follow_way(self, way: ArrayLike, name: str = "a recorded way") -> None:
        """Begin to drive along a way (N, 3) that was driven before. Raises ArgumentError."""
        self.begin(Way(way, self.settings.navigator.through_m, name))

    def explore(self) -> None:
        """Begin to look at all floor that can be reached, of a map that grows."""
        self.begin(Exploration(self._footprint, self.settings, self._senses.near_m, self._senses.half_view_rad))

    @one_at_a_time
    def why_no_goal(self, goal: ArrayLike) -> str:
        """Why no plan can end at x, y, yaw (3,) in a map of before, or x, y (2,), such as a wall there; empty else.

        It takes as long as a plan's costmap: ask before a drive, not during one. Raises ArgumentError.
        """
        return self._planning.why_no_goal(checked_goal(goal))

    @one_at_a_time
    def begin(self, goals: Goals) -> None:
        """Begin a task; one that goes on is called off."""
        if not self.is_task_complete():
            self.cancel_task()
        self._result = None
        self._planning.drop()
        self._task, self._stepped_s = Task(goals, self._robot.now_s), self._robot.now_s
        self._become(NavigationState.PLANNING, f"to {goals.name}")
        if self._senses.where.is_known(self.settings.navigator.unsure_m):
            # While the next period goes by, and not after it.
            self._planning.ask(goals, self._robot.now_s)

    def cancel_task(self) -> None:
        """Stand; the robot brakes in the steps to come."""
        if not self.is_task_complete():
            self._fail(NavigationReason.CANCELED, "by whoever leads it")

    @one_at_a_time
    def clear_obstacles(self, xy: ArrayLike, radius_m: float = 1.0) -> None:
        """Forget what the camera met about x and y (2,) in the map, metres: a person sees that nothing is there.

        What stands there is met again with the next image that shows it. What the map itself has stays. Where it is
        not known where the robot is, nothing happens. Raises ArgumentError for what is no place.
        """
        at = checked_goal(np.asarray(xy, float).ravel()[:2])
        if not 0 < radius_m < math.inf:
            raise ArgumentError(f"a radius of {radius_m} m", fix="over 0, finite")
        self._senses.clear_near(at[:2], radius_m)
        if self._task is not None:
            self._task.checked_s = -math.inf

    def is_task_complete(self) -> bool:
        """Whether there is nothing to do, or nothing more."""
        return self.state in (NavigationState.IDLE, NavigationState.ARRIVED, NavigationState.FAILED)

    @property
    def result(self) -> NavigationResult | None:
        """Of the last task, once it is complete."""
        return self._result

    def go_to(self, goal: ArrayLike, on_step: Callable[[Feedback], None] = lambda feedback: None) -> NavigationResult:
        """Drive there and stand; called with each period's feedback. Raises as `go_to_pose` and the robot do."""
        self.go_to_pose(goal)
        return self.run(on_step)

    def run(self, on_step: Callable[[Feedback], None] = lambda feedback: None) -> NavigationResult:
        """Go on until the task is complete and the robot stands. Raises what the robot raises; ask for a task first.

        Where nothing tells that it stands, as with encoders that died, that is waited for no longer than a stop takes.
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
        """One period: obey, sense, decide, and let the monitor check. Raises what the robot raises.

        A part that does not answer stops the motors at once. The task goes on where it answers within
        `navigator.held_s`, and fails after that.
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
        self._halt(silent)
        stands_by_itself = bool(self._robot.stop_reason)
        self._chain.ask(asked, now_s, self._senses.where, stands_by_itself=stands_by_itself, silent=silent)
        return self.feedback

    def _silent_part(self, now_s: float) -> MonitorReason | None:
        """The part that has not answered for too long; of planning only while the robot drives, or comes to a stand."""
        if self._senses.where.is_silent:
            return MonitorReason.LOCALIZATION_SILENT
        if self.monitor.is_camera_silent(now_s):
            return MonitorReason.CAMERA_SILENT
        if self._senses.floor.is_silent(now_s):
            return MonitorReason.FLOOR_SILENT
        is_driving = self.state is NavigationState.DRIVING or self._is_moving()
        return MonitorReason.PLANNER_SILENT if is_driving and self._planning.is_silent(now_s) else None

    def _is_moving(self) -> bool:
        """Whether the robot rolls, or is asked to."""
        return not (self._chain.command.is_stop and self._stands())

    def _halt(self, silent: MonitorReason | None) -> None:
        """Keep the motors of a robot without a voltage from when it moved until the part answers again."""
        self._is_halted = silent is not None and (self._is_halted or self._is_moving())
        if self._is_halted and not self._robot.stop_reason:
            with suppress(WheelsightError):  # a controller that does not confirm stops by its own watchdog
                self._robot.stop()

    @property
    def feedback(self) -> Feedback:
        """How the task goes on."""
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
            # A stop by the navigator has the monitor's reason.
            robot_stop="" if self._is_halted and self._robot.stop_reason == STOPPED else self._robot.stop_reason,
            stays_at=None if self.is_task_complete() else self._senses.what_stays(),
        )

    def _decide(self, now_s: float) -> VelocityCommand:
        """What to ask for, by state."""
        self._predicted = np.empty((0, 3))
        task = self._task
        if task is None or self.is_task_complete():
            return STOP
        meets_people = bool(self._senses.people(now_s))
        task.roll(now_s, self._senses.where, self.settings.navigator, meets_people=meets_people)
        why_over = self._why_over(task, now_s)
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

    def _why_over(self, task: Task, now_s: float) -> tuple[NavigationReason, str] | None:
        """Why the task cannot go on, whatever it does now."""
        if self._chain.checked.reason is MonitorReason.WHEELS_OFF:
            return NavigationReason.DISOBEYS, "look at the wheels, then clear the fault"
        if task.stopped_for_s(now_s, bool(self._robot.stop_reason)) > self.settings.navigator.held_s:
            return NavigationReason.ROBOT_STOPPED, self._robot.stop_reason
        return task.why_over(now_s, self.settings)

    def _plan(self, task: Task, now_s: float) -> VelocityCommand:
        """Plan, and drive; or get out of what makes it impossible."""
        if not self._senses.where.is_known(self.settings.navigator.unsure_m):
            return self._look_about(task, self._senses.where.why_unknown(self.settings.navigator.unsure_m))
        if not self._planning.is_asked:
            self._planning.ask(task.goals, now_s)
        planned = self._planning.answer(now_s)
        if self._planning.is_lost(now_s, self.settings.navigator.held_s):
            self._planning.drop()
            return self._fail(NavigationReason.SILENT, MonitorReason.PLANNER_SILENT)
        command = STOP if planned is None else self._take(task, planned, now_s)
        # Not a period later: whoever asked for it waits.
        return self._drive(task, now_s) if self.state is NavigationState.DRIVING else command

    def _take(self, task: Task, planned: Planned, now_s: float) -> VelocityCommand:
        """Go by what came of a plan."""
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
        """There may be one when somebody has gone, or more is seen; of a goal that may be left out there is another."""
        why = f"{failure.reason}: {failure.detail}"
        if not failure.reason.is_for_good and (stays := stays_words(self._senses.what_stays())):
            why = f"{why}; {stays}"
        task.why_first = task.why_first or why
        if failure.reason.is_of_goal and task.goals.left > 1 and task.skips < _SKIPS and task.goals.missed():
            task.skips += 1
            return STOP
        if not failure.reason.is_for_good and task.may_try(self.settings.navigator):
            return self._get_out(task, why)
        # What it did since, such as backing up, may have led to the last reason alone.
        is_same = task.why_first.startswith(failure.reason)
        return self._give_up(task, NavigationReason.NO_PLAN, why if is_same else f"{task.why_first}; at last {why}")

    def _drive(self, task: Task, now_s: float) -> VelocityCommand:
        """Follow the plan while it holds."""
        s, where = self.settings.navigator, self._senses.where
        state, local, plan = where.state, self._senses.local(), task.plan
        if (why := where.why_unknown(s.unsure_m)) or state is None or local is None or plan is None:
            return self._look_about(task, why)
        if now_s - task.checked_s >= s.check_s:
            task.checked_s = now_s
            if task.goals.is_met(state.pose, self._senses.floor.layer):
                return self._reached(task)
            if not self._may_go_on(task, plan, now_s):
                self._become(NavigationState.PLANNING, task.why_anew)
                return STOP
        planned = self._planning.answer(now_s) if self._planning.is_asked else None
        if planned is not None:
            self._become(NavigationState.PLANNING, task.why_anew)
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
        """Whether the plan is free; who drives on asks for another a period after the look: both take too long."""
        if self._planning.is_asked:
            return self._planning.is_free(plan, self.settings.navigator.onward_m)
        if task.wants_anew:
            task.wants_anew = False
            self._planning.ask(task.goals, now_s)
        if self._planning.is_asked or now_s - task.planned_s < self.settings.navigator.anew_s:
            return True
        look = self._planning.look(plan, task.T_map_odom, now_s)
        if not look.is_free:
            self._planning.ask(task.goals, now_s)
        elif look.why:
            task.wants_anew, task.checked_s = True, -math.inf
        task.why_anew = look.why
        return look.is_free

    def _follow(self, task: Task, result: ControlResult, now_s: float) -> VelocityCommand:
        """What comes of a controller's answer."""
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
        """Go on to the next goal; who stands on this one is waited for once."""
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
        """Do what was begun, then plan anew."""
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
        """Do something to get on, or give up."""
        if not task.may_try(self.settings.navigator):
            return self._give_up(task, NavigationReason.BLOCKED, why)
        self._planning.drop()
        task.get_out(self.settings, stopped_by, was_backward=self._chain.was_backward)
        self._become(NavigationState.RECOVERING, f"{why}; {task.doing}")
        return STOP

    def _give_up(self, task: Task, reason: NavigationReason, why: str) -> VelocityCommand:
        """Go on without a goal that nothing leads to; of a task that wants it, this is the end."""
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
        self._planning.drop()
        task.search(self.settings, self._senses.where.status, self._chain.checked, self._senses.open_way())
        self._become(NavigationState.RECOVERING, f"{why}; {task.doing}")
        return STOP

    def _fail(self, reason: NavigationReason, detail: str) -> VelocityCommand:
        """Stand, and say why; the task is over."""
        task = self._task
        if task is not None and not self.is_task_complete():
            self._become(NavigationState.FAILED, f"{reason}: {detail}")
            self._result = task.result(False, reason, detail, self._robot.now_s)
        return STOP

    def _become(self, state: NavigationState, why: str) -> None:
        transition = Transition(self._robot.now_s, self.state, state, why)
        self.state = state
        if self._task is not None:
            self._task.transitions.append(transition)
        self._on_transition(transition)

    def _stands(self) -> bool:
        speed = self._senses.where.speed
        return self.settings.follow.stands(speed.forward_m_s, speed.turn_rad_s) or not math.isfinite(speed.stamp_s)


# ControlChain: what a navigator asks for passes a ramp and the collision monitor, which decides on the command.


class ControlChain:
    """See the module.

    Args:
        settings: of the robot.

    Attributes:
        monitor: has the last word.
        checked: what it made of the last command.
        was_backward: whether the last command that it stopped led backward.
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
        """What the robot is to be told."""
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
        """Take the command of a period; a robot that stands by itself does not obey it.

        `silent` is the part that does not answer: the command is a stop.
        """
        if stands_by_itself:
            # Told less and less while it stands by itself, it would seem not to obey, and would not be told to stand.
            self._ramp.follow(STOP)
        ramped = self._ramp.step(asked.forward_m_s, asked.turn_rad_s, self._period_s)
        self.checked = self.monitor.check(ramped, now_s, _status_to_drive(where), silent)
        if self.checked.state is not MonitorState.FREE:
            self._ramp.follow(self.checked.command)
        if self.checked.state is MonitorState.STOPPED:
            self._stopped = now_s, self.checked.reason
            self.was_backward = asked.forward_m_s < 0

    def stopped_by(self, since_s: float) -> MonitorReason | None:
        """Why the monitor last stopped the robot since then: a controller knows no more than that it does not move."""
        return self._stopped[1] if self._stopped[0] >= since_s else None


def controller_of(footprint: Footprint, settings: NavigationSettings, own: Controller | None = None) -> Controller:
    """A user's own, else the one that settings name."""
    if own is not None:
        return OwnController(own, settings.follow.goal_m, settings.follow.goal_rad)
    if settings.controller == "mppi":
        return MppiController(footprint, settings.limits, settings.mppi, settings.follow)
    return PurePursuitController(footprint, settings.limits, settings.pure_pursuit, settings.follow)


def _status_to_drive(where: WhereNow) -> Status:
    """For the monitor: whoever does not know where in the map it is, but how it moves, may turn and look about."""
    is_searching = where.status is Status.INITIALIZING and where.is_rolling
    return Status.COASTING if is_searching else where.status


# VelocityRamp: commands that a base can follow, whatever is asked.


class VelocityRamp:
    """Keeps `RobotLimits`: speed, acceleration and jerk, from one command to the next.

    Acceleration grows by jerk, and falls by it toward the speed that is asked. Whatever slows down is not delayed by
    jerk: stops, and less speed asked, which takes acceleration away at once. Turns have a limit of acceleration alone.
    """

    def __init__(self, limits: RobotLimits | None = None) -> None:
        self._limits = limits or RobotLimits()
        self._given = STOP
        self._acceleration_m_s2 = 0.0

    @property
    def given(self) -> VelocityCommand:
        """The last command."""
        return self._given

    def follow(self, driven: VelocityCommand) -> None:
        """Go on from a command that somebody made slower after this."""
        self._given, self._acceleration_m_s2 = driven, 0.0

    def step(self, forward_m_s: float, turn_rad_s: float, period_s: float) -> VelocityCommand:
        """The command a period after the last one.

        Args:
            forward_m_s: asked; what is not finite asks for a stop of both.
            turn_rad_s: asked.
            period_s: since the last one, above 0.

        Raises:
            ArgumentError: a period that is none.
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
        speed, limits = self._given.forward_m_s, self._limits
        slows = speed * (wanted - speed) < 0
        if slows:
            # To zero and no farther: beyond it lies the other direction, which begins with its own acceleration.
            wanted = wanted if wanted * speed > 0 else 0.0
            change = limits.braking_m_s2 * period_s
            self._acceleration_m_s2 = 0.0
            return speed + min(max(wanted - speed, -change), change)
        sign = math.copysign(1.0, wanted - speed)
        # While acceleration falls to zero by jerk, so much is gained still: a² / 2j + a period / 2, step by step.
        # Only the step that reaches the speed may fall by an eighth more.
        half = limits.jerk_m_s3 * period_s / 2
        most = math.sqrt(half * half + 2 * limits.jerk_m_s3 * abs(wanted - speed)) - half
        most = min(limits.acceleration_m_s2, most)
        grown = max(self._acceleration_m_s2 * sign, 0.0) + limits.jerk_m_s3 * period_s
        change = min(min(most, grown) * period_s, abs(wanted - speed))
        self._acceleration_m_s2 = sign * change / period_s
        return wanted if change == abs(wanted - speed) else speed + sign * change
