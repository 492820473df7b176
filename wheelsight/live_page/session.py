"""Session: drives a robot in a thread of its own, by what pages ask; it alone owns what is driven.

Pages see snapshots, and ask by messages that the thread takes between two periods. To stop waits for neither.
"""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

from wheelsight.errors import ConfigError, WheelsightError
from wheelsight.events import Event
from wheelsight.geometry import FloatArray
from wheelsight.live_page.driven import Driven, Maps, Watch
from wheelsight.live_page.messages import Explore, GoToName, GoToPose, NamePlace, SaveMap, StartMap, Task
from wheelsight.live_page.pace import Pace
from wheelsight.live_page.snapshot import Snapshot, Telling
from wheelsight.live_page.stop_switch import StoppableRobot, StopSwitch
from wheelsight.navigation import Feedback, NavigationResult, NavigationState, Transition
from wheelsight.robots import Robot
from wheelsight.settings import LivePageSettings

_WAITING, _SAID = 16, 6
_WAIT_S = 0.2
_STANDING_M_S, _STANDING_RAD_S = 0.02, 0.05


@dataclass(frozen=True, slots=True)
class _Asked:
    task: Task
    presses: int


@dataclass(frozen=True, slots=True, eq=False)
class _Next:
    """The map to go on in, and where the robot stands there, if that is known."""

    name: str
    pose: FloatArray | None = None


class Session:
    """Begins with the first of its maps; use it in a `with` block, which stops the robot at the end.

    Args:
        robot: that is driven; whoever opened it closes it.
        maps: that it can drive in.
        settings: of the page.
        paces: whether the robot's time stands still between steps, and is to go as the wall's.
        on_problem: told in a line what went wrong, as pages are.
        watch: sees all of the drives, in the session's thread; nobody, where it is None.

    Attributes:
        switch: stops the robot.
        wants_costmap: whether any page shows the costmap.
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
        self._robot, self._watch = StoppableRobot(robot, self.switch, self._hear), watch
        self._maps, self._settings, self._paces = maps, settings, paces
        self._asked: queue.Queue[_Asked] = queue.Queue(_WAITING)
        self._over, self._on_problem = threading.Event(), on_problem
        self._said: deque[dict[str, Any]] = deque(maxlen=_SAID)
        self._numbers, self._name, self._share = count(1), "", 1.0
        self._cancelled = self.switch.presses
        self._told: NavigationResult | None = None
        self.wants_costmap = False
        self._telling = Telling(self._robot, settings, lambda: self.wants_costmap)
        self._latest = self._telling.of_words(self._facts("opening"))
        self._thread = threading.Thread(target=self._run, name="wheelsight-drive", daemon=True)

    def __enter__(self) -> Session:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def latest(self) -> Snapshot:
        """What there is to show."""
        return self._latest

    @property
    def is_over(self) -> bool:
        """Whether its thread has ended."""
        return not self._thread.is_alive()

    def ask(self, task: Task) -> str:
        """Ask for a task; why that cannot be, or nothing where it will be taken."""
        if self.is_over:
            return "nothing is driven any more: begin wheelsight serve again"
        try:
            self._asked.put_nowait(_Asked(task, self.switch.presses))
        except queue.Full:
            return "too much was asked at once; it is left out"
        return ""

    def stop(self, reason: str) -> None:
        """Stop the robot now, whatever hangs; it stands until somebody gives it another task."""
        self.switch.press(reason)

    def close(self, seconds: float = 60.0) -> None:
        """Stop the robot, let go of the map, and end; waits so long for what hangs. May be called twice."""
        self.switch.press("the program ends")
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join(seconds)
        self.switch.close()

    def say(self, text: str, *, is_problem: bool = False) -> None:
        """A line for all pages."""
        self._said.append({"number": next(self._numbers), "text": text, "is_problem": is_problem})
        if is_problem:
            self._on_problem(text)

    def _run(self) -> None:
        following: _Next | None = _Next(self._maps.first)
        try:
            while following is not None and not self._over.is_set():
                following = self._in_map(following)
        finally:
            if not self._over.is_set():
                self.stop("the program that drives has ended")
                self.say("nothing is driven any more: begin wheelsight serve again", is_problem=True)
            self._latest = self._telling.of_words(self._facts("ended"))

    def _in_map(self, chosen: _Next) -> _Next | None:
        """Drive in a map, until another is to be driven in; None at the end of all."""
        self._name, self._told = chosen.name, None
        self._telling.begin()
        self._latest = self._telling.of_words(self._facts("opening"))
        following: _Next | None = None
        try:
            with self._maps.opened(chosen.name, self._robot, chosen.pose, self._note) as driven:
                following = self._drive(driven)
                self._latest = self._telling.of_words(self._facts("saving" if driven.is_new else "closing"))
        except WheelsightError as error:
            self.stop("something went wrong")
            self.say(str(error), is_problem=True)
            return self._wait_for_choice()
        if following is not None and not following.name:
            self.say("the map is saved")
            return _Next(self._maps.last_saved(), following.pose)
        return following

    def _wait_for_choice(self) -> _Next | None:
        """Nothing can be driven in: until another map is chosen."""
        while not self._over.is_set():
            self._latest = self._telling.of_words(self._facts("choose"))
            try:
                task = self._asked.get(timeout=_WAIT_S).task
            except queue.Empty:
                continue
            if isinstance(task, StartMap) and task.map in self._maps.names():
                return _Next(task.map)
            self.say("choose a map first", is_problem=True)
        return None

    def _drive(self, driven: Driven) -> _Next | None:
        """Period by period."""
        pace = Pace(lambda: self._robot.now_s) if self._paces else None
        every = max(1, round(1 / (self._settings.updates_hz * driven.navigator.settings.follow.period_s)))
        feedback = driven.navigator.feedback
        for period in count():
            if self._over.is_set():
                return None
            self._cancel_if_stopped(driven)
            following = self._take(driven, feedback)
            if following is not None:
                return following
            feedback = driven.navigator.step()
            if self._watch is not None:
                self._watch.step(feedback, driven.navigator)
            self._tell_result(driven)
            if period % every == 0:
                self._latest = self._telling.of(driven, feedback, self._facts("driving", driven))
            if pace is not None:
                pace.wait()
                self._share = pace.share
        return None

    def _cancel_if_stopped(self, driven: Driven) -> None:
        presses = self.switch.presses
        if presses != self._cancelled:
            self._cancelled = presses
            driven.navigator.cancel_task()

    def _take(self, driven: Driven, feedback: Feedback) -> _Next | None:
        """Do what was asked; the map to go on in, where that is another."""
        try:
            asked = self._asked.get_nowait()
        except queue.Empty:
            return None
        if asked.presses != self.switch.presses:
            self.say("left out: the robot was stopped after it was asked", is_problem=True)
            return None
        try:
            return self._do(asked, driven, feedback)
        except WheelsightError as error:
            self.say(str(error), is_problem=True)
            return None

    def _do(self, asked: _Asked, driven: Driven, feedback: Feedback) -> _Next | None:
        task, navigator = asked.task, driven.navigator
        if isinstance(task, GoToPose | GoToName | Explore):
            begin = _begin_of(task, driven)
            if self.switch.release(asked.presses):
                begin()
            return None
        speed = abs(feedback.forward_m_s) > _STANDING_M_S or abs(feedback.turn_rad_s) > _STANDING_RAD_S
        if speed or not navigator.is_task_complete():
            self.say("stop the robot first", is_problem=True)
        elif isinstance(task, NamePlace):
            self._name_place(task.name, driven, feedback)
        elif isinstance(task, SaveMap):
            if driven.is_new:
                return _Next("", feedback.pose)
            self.say("this map is as it was saved; names are kept at once")
        elif task.map not in self._maps.names():
            self.say(f"no map is called {task.map!r}", is_problem=True)
        else:
            return _Next(task.map)
        return None

    def _name_place(self, name: str, driven: Driven, feedback: Feedback) -> None:
        if feedback.pose is None:
            self.say("it is not known where the robot is", is_problem=True)
            return
        driven.places.name(name, feedback.pose)
        self.say(f"this place is called {name}")

    def _hear(self, events: Sequence[Event]) -> None:
        if self._watch is not None:
            self._watch.hear(events)

    def _note(self, transition: Transition) -> None:
        if self._watch is not None:
            self._watch.note(transition)
        if transition.after is NavigationState.RECOVERING:
            self.say(transition.why)

    def _tell_result(self, driven: Driven) -> None:
        result = driven.navigator.result
        if result is None or result is self._told:
            return
        self._told = result
        if result.has_arrived:
            self.say(f"arrived: {result.detail}")
        else:
            why = self.switch.reason or f"{result.reason} ({result.detail})"
            self.say(f"not arrived: {why}", is_problem=True)

    def _facts(self, phase: str, driven: Driven | None = None) -> dict[str, Any]:
        """What is told of any moment."""
        return {
            "phase": phase,
            "map": self._name,
            "is_new": driven is not None and driven.is_new,
            "maps": list(self._maps.names()),
            "stopped": self.switch.reason,
            "problem": self.switch.problem,
            "said": list(self._said),
            "share": round(self._share, 2),
        }


def _begin_of(task: GoToPose | GoToName | Explore, driven: Driven) -> Callable[[], None]:
    """What begins a task. Raises ConfigError, MapError: it cannot be."""
    navigator = driven.navigator
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
