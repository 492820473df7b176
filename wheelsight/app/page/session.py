"""Session: drives a robot in its own thread, by messages of pages. The messages are strict models. Pace holds a
simulated robot to real time.
"""

from __future__ import annotations

import json
import logging
import math
import queue
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import count
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from wheelsight.app.page.snapshot import Driven, Maps, Snapshot, SnapshotMaker, Watch
from wheelsight.app.page.stop_switch import StopSwitch, Watchdog
from wheelsight.core.errors import ArgumentError, ConfigError, WheelsightError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import Event, VelocityCommand
from wheelsight.core.robots import CONTROL_PERIOD_S, Robot, WatchedRobot
from wheelsight.core.settings import LivePageSettings
from wheelsight.core.threads import Closing
from wheelsight.navigation import ByHand, Feedback, NavigationResult, NavigationState, Transition
from wheelsight.navigation.settings import SILENT_S

_FARTHEST_M, _LONGEST_NAME = 1e4, 60
_Name = Annotated[str, Field(min_length=1, max_length=_LONGEST_NAME)]


class _Message(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Alive(_Message):
    """The page is open, and its connection works."""

    type: Literal["alive"]


class Take(_Message):
    """The sender becomes the driver."""

    type: Literal["take"]


class Leave(_Message):
    """The sender stops being the driver."""

    type: Literal["leave"]


class ShowCostmap(_Message):
    """Whether the page shows the costmap."""

    type: Literal["costmap"]
    shown: bool


class Steer(_Message):
    """Position of the page's stick, by shares of its way; one that is not renewed within 0.25 s counts as released."""

    type: Literal["stick"]
    forward: float = Field(ge=-1, le=1)
    left: float = Field(ge=-1, le=1)


class GoToPose(_Message):
    """Drive to a position in `map`; without a yaw, to any heading."""

    type: Literal["goal"]
    x_m: float = Field(ge=-_FARTHEST_M, le=_FARTHEST_M)
    y_m: float = Field(ge=-_FARTHEST_M, le=_FARTHEST_M)
    yaw_rad: float | None = Field(default=None, ge=-7, le=7)


class GoToName(_Message):
    """Drive to a named place."""

    type: Literal["go"]
    name: _Name


class ClearObstacles(_Message):
    """Remove camera obstacles around a position in `map`: the driver sees that it is free."""

    type: Literal["clear"]
    x_m: float = Field(ge=-_FARTHEST_M, le=_FARTHEST_M)
    y_m: float = Field(ge=-_FARTHEST_M, le=_FARTHEST_M)


class ClearFault(_Message):
    """Permit driving again: the driver has checked wheels that did not follow their commands."""

    type: Literal["wheels"]


class Explore(_Message):
    """Drive until all reachable floor is seen."""

    type: Literal["explore"]


class NamePlace(_Message):
    """Name the robot's current pose."""

    type: Literal["name"]
    name: _Name


class SaveMap(_Message):
    """Write the new map, and continue in it."""

    type: Literal["save"]


class StartMap(_Message):
    """Continue in another map."""

    type: Literal["start"]
    map: Annotated[str, Field(min_length=1, max_length=200)]


@dataclass(frozen=True, slots=True, eq=False)
class DriveByHand:
    """Follow velocity commands of another program until `commands` returns None, by ramp and collision monitor.

    With `is_stick` they are shares of a stick's way, from -1 to 1, and help may change them.
    """

    commands: Callable[[], VelocityCommand | None]
    is_stick: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SetPose:
    """The robot stands at a pose (3,) in the known map: x, y, yaw."""

    pose: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DriveTo:
    """Drive to a pose for another program. `left_out` is called with the reason where the drive does not begin."""

    goal: GoToPose
    left_out: Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class CancelDrive:
    """End a drive, unless another task has replaced it."""

    drive: DriveTo


_PageTask = GoToPose | GoToName | ClearObstacles | ClearFault | Explore | NamePlace | SaveMap | StartMap
Task = _PageTask | DriveByHand | SetPose | DriveTo | CancelDrive
"""What the driver alone may ask: from a page, or from other programs."""
Message = Alive | Take | Leave | ShowCostmap | Steer | _PageTask
_ANY: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="type")])


def says_stop(text: str) -> bool:
    """Whether a message is STOP, whatever else it holds. STOP must not fail on a malformed message."""
    if '"stop"' not in text:
        return False
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return False
    return isinstance(found, dict) and found.get("type") == "stop"


def parsed(text: str) -> Message:
    """Parse a message. Raises ArgumentError, with one line, for an invalid one."""
    try:
        return _ANY.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"][1:])
        raise ArgumentError(f"a message of no sense: {f'{where}: ' if where else ''}{first['msg']}") from None


# Session: its thread alone owns the robot. Pages see snapshots and send messages, which the thread takes between two
# periods. STOP waits for neither.


_WAITING, _SAID = 16, 6
_WAIT_S = 0.2
# How long a part may be silent while the robot moves. A robot whose time stands still between steps goes nowhere
# meanwhile, and its steps, which render and localize, take longer on a slow computer.
_SILENT_IN_STEP_S = 2.0
# While it stands with a task: a task goes on by itself after no longer than this (`navigator.held_s`).
_HELD_S = 4.0
# Periods one after another that fail before the map is given up.
_MOST_FAILURES, _STEP_S = 5, 0.05
_MOST_TRACED = 20
_DRIVING, _STOPPED = "the thread that drives", "left out: the robot was stopped after it was asked"
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Asked:
    task: Task
    presses: int


@dataclass(frozen=True, slots=True, eq=False)
class _Next:
    """The next map, and the robot's pose in it, if known."""

    name: str
    pose: FloatArray | None = None


class Session(Closing):
    """Drives a robot in its own thread. Use it in a `with` block, which stops the robot at the end. It begins in the
    first map.

    Args:
        robot: the robot to drive. The caller opens and closes it.
        maps: the maps that it can drive in.
        settings: of the page.
        paces: whether the robot's time stands still between steps, and must follow real time.
        on_problem: called with one line about each problem; pages show it, too.
        watch: is called in the session's thread with all events and periods; or None.

    Attributes:
        switch: stops the robot.
        silent_s: how long a part of the program may be silent while the robot moves.
        wants_costmap: whether any page shows the costmap.
        begun: the task of the navigator; None in a map without any yet.
    """

    def __init__(
        self,
        robot: Robot,
        maps: Maps,
        settings: LivePageSettings,
        *,
        paces: bool,
        on_problem: Callable[[str], None] = lambda line: None,
        watch: Watch | None = None,
    ) -> None:
        self.switch = StopSwitch(robot)
        self._robot, self._watch = WatchedRobot(robot, lambda: self.switch.reason), watch
        self._maps, self._settings, self._paces = maps, settings, paces
        self._asked: queue.Queue[_Asked] = queue.Queue(_WAITING)
        self._over, self._on_problem = threading.Event(), on_problem
        self._said: deque[dict[str, Any]] = deque(maxlen=_SAID)
        self._numbers, self._name, self._share = count(1), "", 1.0
        self._cancelled = self.switch.presses
        self._reported: NavigationResult | None = None
        self.begun: Task | None = None
        self.wants_costmap = False
        self.silent_s = _SILENT_IN_STEP_S if paces else SILENT_S
        self._is_driving = self._has_task = False
        self._traced = set[str]()
        self._snapshots = SnapshotMaker(self._robot, settings, lambda: self.wants_costmap)
        self._latest = self._snapshots.of_words(self._facts("opening"))
        self._watchdog = Watchdog(self._may_be_silent_s, self.part_fails, self.say)
        self._thread = threading.Thread(target=self._run, name="wheelsight-drive", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    @property
    def latest(self) -> Snapshot:
        """The current snapshot."""
        return self._latest

    @property
    def is_over(self) -> bool:
        """Whether the thread has ended."""
        return not self._thread.is_alive()

    def ask(self, task: Task) -> str:
        """Queue a task. Returns the reason if it is refused, else ""."""
        if self.is_over:
            return "nothing is driven any more: begin wheelsight serve again"
        try:
            self._asked.put_nowait(_Asked(task, self.switch.presses))
        except queue.Full:
            return "too much was asked at once; it is left out"
        return ""

    def stop(self, reason: str) -> None:
        """Stop the robot now, whatever else hangs. It stands until its next task."""
        self.switch.press(reason)

    @contextmanager
    def watched(self, part: str) -> Iterator[Callable[[], None]]:
        """Watch a part that the robot needs; returns the function that the part calls each 0.2 s or more often."""
        try:
            yield self._watchdog.watch(part)
        finally:
            self._watchdog.forget(part)

    def part_fails(self, reason: str) -> None:
        """Stop the robot because a part of the program hangs, and report it, if the robot moves or has a task."""
        if self._may_be_silent_s() == math.inf:
            return
        self.stop(reason)
        self.say(f"{reason}: the robot is stopped; give it its task again", is_problem=True)
        # The thread that drives may be what hangs: it shows nothing then.
        shown = json.loads(self._latest.text) | self._words()
        self._latest = replace(self._latest, text=json.dumps(shown))

    def close(self, seconds: float = 60.0) -> None:
        """Stop the robot, close the map and end the thread, with a limited wait. May be called twice."""
        self.switch.press("the program ends")
        self._watchdog.close()
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join(seconds)
        self.switch.close()

    def say(self, text: str, *, is_problem: bool = False) -> None:
        """Send a line to all pages."""
        self._said.append({"number": next(self._numbers), "text": text, "is_problem": is_problem})
        if is_problem:
            self._on_problem(text)

    def _may_be_silent_s(self) -> float:
        """How long a part may be silent now, seconds."""
        if not self._is_driving or self.switch.reason:
            return math.inf
        if self._robot.is_commanded:
            return self.silent_s
        return _HELD_S if self._has_task else math.inf

    def _run(self) -> None:
        following: _Next | None = _Next(self._maps.first)
        try:
            with self.watched(_DRIVING) as beat, self._robot.watched_by(self._on_events):
                while not self._over.is_set():
                    try:
                        following = self._wait_for_choice() if following is None else self._in_map(following, beat)
                    except Exception as error:
                        # Of what a page is shown, or of a stop: nothing else is left to do.
                        self._fail("something went wrong", error)
                        following = None
                        self._over.wait(_WAIT_S)
        finally:
            if not self._over.is_set():
                self.stop("the program that drives has ended")
                self.say("nothing is driven any more: begin wheelsight serve again", is_problem=True)
            self._latest = self._snapshots.of_words(self._facts("ended"))

    def _in_map(self, chosen: _Next, beat: Callable[[], None]) -> _Next | None:
        """Drive in a map until the next map; None if the driver must choose one, and at the end."""
        self._name, self._reported, self.begun = chosen.name, None, None
        self._snapshots.begin()
        self._latest = self._snapshots.of_words(self._facts("opening"))
        following, doing, has_driven = None, "the map is not opened", False
        try:
            with self._maps.opened(chosen.name, self._robot, chosen.pose, self._note) as driven:
                doing = "the map is given up"
                try:
                    following = self._drive(driven, beat)
                finally:
                    has_driven, self._is_driving = self._is_driving, False
                doing = "the map is not saved" if driven.is_new else "the map is not closed"
                self._latest = self._snapshots.of_words(self._facts("saving" if driven.is_new else "closing"))
        except Exception as error:
            self._fail(doing, error)
            if isinstance(error, WheelsightError) or not has_driven:
                return None
            # An error of the program, and not of the robot or of the disk: the robot is led on in the same map.
            return following if following is not None and following.name else _Next(chosen.name)
        if following is not None and not following.name:
            self.say("the map is saved")
            return _Next(self._maps.last_saved(), following.pose)
        return following

    def _wait_for_choice(self) -> _Next | None:
        """Wait until the driver chooses a map."""
        while not self._over.is_set():
            self._latest = self._snapshots.of_words(self._facts("choose"))
            try:
                task = self._asked.get(timeout=_WAIT_S).task
            except queue.Empty:
                continue
            if isinstance(task, StartMap) and task.map in self._maps.names():
                return _Next(task.map)
            self._leave_out(task, "choose a map first")
        return None

    def _drive(self, driven: Driven, beat: Callable[[], None]) -> _Next | None:
        """Run period by period. Raises the error of several failed periods in a row."""
        pace = RealTimePace(lambda: self._robot.now_s) if self._paces else None
        every = max(1, round(1 / (self._settings.updates_hz * CONTROL_PERIOD_S)))
        feedback, failures = driven.navigator.feedback, 0
        for period in count():
            if self._over.is_set():
                return None
            beat()
            try:
                self._cancel_if_stopped(driven)
                # A request after a failure waits for one successful period, which stops the robot.
                following = self._take(driven, feedback) if failures == 0 else None
                if following is not None:
                    return following
                feedback = driven.navigator.step()
                self._has_task = not driven.navigator.is_task_complete()
                if self._watch is not None:
                    self._watch.step(feedback, driven.navigator)
                self._report_result(driven)
                if period % every == 0:
                    self._latest = self._snapshots.of(driven, feedback, self._facts("driving", driven))
            except Exception as error:
                failures += 1
                self._fail("the robot is stopped; give it its task again", error)
                if failures == _MOST_FAILURES:
                    raise
                self._over.wait(_STEP_S)
            else:
                # Only now there is something that can hang.
                failures, self._is_driving = 0, True
            if pace is not None:
                pace.wait()
                self._share = pace.share
        return None

    def _fail(self, doing: str, error: Exception) -> None:
        """Stop the robot and report the error in one line. The log gets the traceback of the first error of a kind."""
        self.stop("something went wrong")
        what = str(error) if isinstance(error, WheelsightError) else f"{type(error).__name__}: {error}"
        line = what.partition("\n")[0]
        if not isinstance(error, WheelsightError):
            line = f"{doing}: {line}"
            kind = f"{type(error)} {traceback.extract_tb(error.__traceback__)[-1:]}"
            if kind not in self._traced and len(self._traced) < _MOST_TRACED:
                self._traced.add(kind)
                _log.error("%s", line, exc_info=error)
        if not self._said or self._said[-1]["text"] != line:
            self.say(line, is_problem=True)

    def _cancel_if_stopped(self, driven: Driven) -> None:
        presses = self.switch.presses
        if presses != self._cancelled:
            driven.navigator.cancel_task()
            self._cancelled = presses

    def _take(self, driven: Driven, feedback: Feedback) -> _Next | None:
        """Start requested tasks. Returns the next map, if one is requested."""
        try:
            asked = self._asked.get_nowait()
        except queue.Empty:
            return None
        if asked.presses != self.switch.presses:
            self._leave_out(asked.task, _STOPPED)
            return None
        try:
            return self._do(asked, driven, feedback)
        except WheelsightError as error:
            self._leave_out(asked.task, str(error))
        except Exception as error:
            self._fail("not done", error)
            self._leave_out(asked.task, "something went wrong")
        return None

    def _leave_out(self, task: Task, why: str) -> None:
        self.say(why, is_problem=True)
        if isinstance(task, DriveTo):
            task.left_out(why)

    def _do(self, asked: _Asked, driven: Driven, feedback: Feedback) -> _Next | None:
        task, navigator = asked.task, driven.navigator
        if isinstance(task, GoToPose | GoToName | Explore | DriveByHand | DriveTo):
            begin = _begin_of(task.goal if isinstance(task, DriveTo) else task, driven)
            if self.switch.release(asked.presses):
                begin()
                self.begun = task
            else:
                self._leave_out(task, _STOPPED)
            return None
        if isinstance(task, CancelDrive):
            if self.begun is task.drive:
                navigator.cancel_task()
            return None
        if isinstance(task, ClearObstacles):
            navigator.clear_obstacles((task.x_m, task.y_m))
            return None
        if not feedback.stands or not navigator.is_task_complete():
            self.say("stop the robot first", is_problem=True)
            return None
        return self._do_while_standing(task, driven, feedback)

    def _do_while_standing(
        self, task: ClearFault | NamePlace | SaveMap | StartMap | SetPose, driven: Driven, feedback: Feedback
    ) -> _Next | None:
        if isinstance(task, ClearFault):
            driven.navigator.clear_fault()
            self.say("the wheels are checked; give the robot its task again")
        elif isinstance(task, NamePlace):
            if feedback.pose is None:
                self.say("it is not known where the robot is", is_problem=True)
            else:
                driven.places.name(task.name, feedback.pose)
                self.say(f"this place is called {task.name}")
        elif isinstance(task, SaveMap):
            if driven.is_new:
                return _Next("", feedback.pose)
            self.say("this map is as it was saved; names are kept at once")
        elif isinstance(task, SetPose):
            if not driven.is_new:
                return _Next(self._name, task.pose)
            self.say("a new map begins where the robot stands: no pose can be set in it", is_problem=True)
        elif task.map not in self._maps.names():
            self.say(f"no map is called {task.map!r}", is_problem=True)
        else:
            return _Next(task.map)
        return None

    def _on_events(self, events: Sequence[Event]) -> None:
        if self._watch is not None:
            self._watch.on_events(events)

    def _note(self, transition: Transition) -> None:
        if self._watch is not None:
            self._watch.note(transition)
        if transition.after is NavigationState.RECOVERING:
            self.say(transition.why)

    def _report_result(self, driven: Driven) -> None:
        result = driven.navigator.result
        if result is None or result is self._reported:
            return
        self._reported = result
        if result.has_arrived:
            self.say(f"arrived: {result.detail}")
        else:
            why = self.switch.reason or f"{result.reason} ({result.detail})"
            self.say(f"not arrived: {why}", is_problem=True)

    def _words(self) -> dict[str, Any]:
        """State of the switch, and recent lines."""
        return {"stopped": self.switch.reason, "problem": self.switch.problem, "said": list(self._said)}

    def _facts(self, phase: str, driven: Driven | None = None) -> dict[str, Any]:
        """Facts of every snapshot."""
        return {
            **self._words(),
            "phase": phase,
            "map": self._name,
            "is_new": driven is not None and driven.is_new,
            "maps": list(self._maps.names()),
            "share": round(self._share, 2),
        }


def _begin_of(task: GoToPose | GoToName | Explore | DriveByHand, driven: Driven) -> Callable[[], None]:
    """The function that starts a task. Raises ConfigError, MapError if it is impossible."""
    navigator = driven.navigator
    if isinstance(task, DriveByHand):
        return lambda: navigator.begin(ByHand(task.commands, task.is_stick))
    if isinstance(task, Explore):
        if not driven.is_new:
            raise ConfigError("this map is finished; to look at all floor, begin a new one")
        return navigator.explore
    if isinstance(task, GoToPose):
        yaw = () if task.yaw_rad is None else (task.yaw_rad,)
        return lambda: navigator.go_to_pose((task.x_m, task.y_m, *yaw))
    where = driven.places.where()
    if task.name not in where:
        raise ConfigError(f"no place of the map is called {task.name!r}")
    pose = where[task.name]
    return lambda: navigator.go_to_pose(pose if pose[2] == pose[2] else pose[:2], task.name)


# A step that renders a frame takes longer than others; what is later than so much is not made up for.
_MOST_LATE_S = 0.5
_SPAN_S = 3.0


class RealTimePace:
    """Holds a simulated robot to real time: call `wait` after each step.

    Args:
        robot_s: the robot's clock, seconds.
        wall_s, sleep: the host's clock.
    """

    def __init__(
        self,
        robot_s: Callable[[], float],
        wall_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._robot_s, self._wall_s, self._sleep = robot_s, wall_s, sleep
        self._ahead_s = robot_s() - wall_s()
        self._seen: deque[tuple[float, float]] = deque()

    @property
    def share(self) -> float:
        """Recent speed relative to real time; 1 if the computer keeps up."""
        if len(self._seen) < 2:
            return 1.0
        (wall_s, robot_s), (wall_now_s, robot_now_s) = self._seen[0], self._seen[-1]
        return (robot_now_s - robot_s) / max(wall_now_s - wall_s, 1e-6)

    def wait(self) -> None:
        """Wait until the host's clock reaches the robot's; returns at once if the robot is late."""
        robot_s, wall_s = self._robot_s(), self._wall_s()
        early_s = robot_s - wall_s - self._ahead_s
        if early_s > 0:
            self._sleep(early_s)
        elif early_s < -_MOST_LATE_S:
            self._ahead_s = robot_s - wall_s + _MOST_LATE_S
        self._seen.append((self._wall_s(), robot_s))
        while self._seen[-1][0] - self._seen[0][0] > _SPAN_S and len(self._seen) > 2:
            self._seen.popleft()
