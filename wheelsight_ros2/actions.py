"""NavigateServer: the action NavigateToPose of Nav2, as a state machine of goals beside a session.

Services and topics of an action follow https://design.ros2.org/articles/actions.html, its types the definitions of Nav2
in ROS 2 Jazzy (nav2_msgs/action/NavigateToPose.action). The transport is `dds.DdsPeer`.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from wheelsight.app.page.session import CancelDrive, DriveTo
from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import se3
from wheelsight.core.runtime import needed
from wheelsight.navigation import Feedback, NavigationReason, NavigationResult, NavigationState, Navigator, Transition
from wheelsight_export.bag_writing import Messages, nanoseconds
from wheelsight_export.topics import MAP, NAVIGATE_ACTION, Flow, Topic
from wheelsight_ros2.inputs import Inputs

_NAME, _CANCEL = "nav2_msgs/action/NavigateToPose", "action_msgs/srv/CancelGoal"
_ID = "unique_identifier_msgs/UUID goal_id\n"
# As `rosidl` makes them of an action: each service has a request and a response.
_DEFINITIONS = {
    f"{_NAME}_Goal": "geometry_msgs/PoseStamped pose\nstring behavior_tree",
    f"{_NAME}_Result": "uint16 error_code\nstring error_msg",
    f"{_NAME}_Feedback": "geometry_msgs/PoseStamped current_pose\nbuiltin_interfaces/Duration navigation_time\n"
    "builtin_interfaces/Duration estimated_time_remaining\nint16 number_of_recoveries\nfloat32 distance_remaining",
    f"{_NAME}_SendGoal_Request": f"{_ID}{_NAME}_Goal goal",
    f"{_NAME}_SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp",
    f"{_NAME}_GetResult_Request": _ID,
    f"{_NAME}_GetResult_Response": f"int8 status\n{_NAME}_Result result",
    f"{_NAME}_FeedbackMessage": f"{_ID}{_NAME}_Feedback feedback",
    f"{_CANCEL}_Request": "action_msgs/GoalInfo goal_info",
    f"{_CANCEL}_Response": "int8 return_code\naction_msgs/GoalInfo[] goals_canceling",
}


class ActionService(NamedTuple):
    """A service of an action: its name and its type, without _Request and _Response."""

    name: str
    type: str


_PATH = f"{NAVIGATE_ACTION}/_action"
SEND = ActionService(f"{_PATH}/send_goal", f"{_NAME}_SendGoal")
CANCEL = ActionService(f"{_PATH}/cancel_goal", _CANCEL)
RESULT = ActionService(f"{_PATH}/get_result", f"{_NAME}_GetResult")
SERVICES = (SEND, CANCEL, RESULT)
FEEDBACK = Topic(f"{_PATH}/feedback", f"{_NAME}_FeedbackMessage", Flow.RELIABLE)
STATUS = Topic(f"{_PATH}/status", "action_msgs/msg/GoalStatusArray", Flow.LATCHED)

# action_msgs/msg/GoalStatus
_ACCEPTED, _EXECUTING, _CANCELING, _SUCCEEDED, _CANCELED, _ABORTED = 1, 2, 3, 4, 5, 6
# action_msgs/srv/CancelGoal
_CANCELS, _REFUSED, _UNKNOWN, _TERMINATED = 0, 1, 2, 3
_NO_ID = bytes(16)
# Nav2's codes of a result.
_NONE, _OTHER = 0, 9000
_FEEDBACK_S = 0.1
# Goals whose results are kept, goals that have not ended, and requests that wait for one result. The oldest go first.
_MOST_ENDED, _MOST_OPEN, _MOST_WAITING = 16, 8, 8


class ActionPeer(Protocol):
    """The transport of an action. Neither call waits for those that take the message."""

    def send(self, topic: Topic, data: bytes, stamp_ns: int) -> None:
        """Send feedback or status, in CDR."""

    def reply(self, service: ActionService, request: bytes, data: bytes) -> None:
        """Answer a request with a response in CDR; `request` are the numbers that came with it."""


@dataclass(eq=False)
class _Goal:
    """A goal of a client.

    Attributes:
        stamp_s: of its acceptance.
        begun_s: of its first period; None before it.
        waiting: requests for its result.
    """

    id: bytes
    stamp_s: float
    drive: DriveTo
    status: int = _ACCEPTED
    begun_s: float | None = None
    begun_to_go_m: float | None = None
    recoveries: int = 0
    message: str = ""
    waiting: list[bytes] = field(default_factory=list)

    @property
    def is_open(self) -> bool:
        return self.status in (_ACCEPTED, _EXECUTING, _CANCELING)


class NavigateServer:
    """Goals of clients, which a session drives to. A later goal replaces an earlier one, which is then aborted.

    Requests come in a thread of the transport, periods in that of the session.

    Args:
        make: makes messages.
        inputs: checks poses and passes them to the session.
        robot_s: the time of stamps now.
    """

    def __init__(self, make: Messages, inputs: Inputs, robot_s: Callable[[], float]) -> None:
        self._make, self._inputs, self._robot_s = make, inputs, robot_s
        self.types = make.types
        for name, definition in _DEFINITIONS.items():
            if name not in self.types.fielddefs:
                # It would take the name of a service's type for that of a message.
                (fields,) = needed("rosbags.typesys").get_types_from_msg(definition, f"{_NAME}_Any").values()
                self.types.register({name: fields})
        self._peer: ActionPeer | None = None
        self._goals: dict[bytes, _Goal] = {}
        self._lock = threading.RLock()
        self._fed_s = -math.inf

    def open(self, peer: ActionPeer) -> None:
        """Answer the requests of a peer from now on."""
        self._peer = peer
        self._send_status()

    def request(self, service: ActionService, request: bytes, message: Any) -> None:
        """Take a request: a message of the service's request type, and the numbers that its response needs."""
        with self._lock:
            if service is SEND:
                response = self._accept(message)
            elif service is CANCEL:
                response = self._cancel(message.goal_info)
            else:
                goal = self._goals.get(bytes(message.goal_id.uuid))
                if goal is not None and goal.is_open:
                    goal.waiting = [*goal.waiting, request][-_MOST_WAITING:]
                    return
                response = self._result(goal)
            self._reply(service, request, response)

    def refuse(self, why: str) -> None:
        """Count and report a refused request."""
        self._inputs.refuse(NAVIGATE_ACTION, why)

    def note(self, transition: Transition) -> None:
        """A change of the navigator's state."""
        if transition.after is not NavigationState.RECOVERING:
            return
        with self._lock:
            for goal in self._open():
                goal.recoveries += goal.begun_s is not None

    def step(self, feedback: Feedback, navigator: Navigator) -> None:
        """The end of a period: goals begin and end, and feedback is sent."""
        led = self._inputs.led
        if led is None or not self._goals:
            return
        with self._lock:
            for goal in tuple(self._open()):
                if led.begun is not goal.drive:
                    if goal.begun_s is not None:
                        self._end(goal, _ABORTED, "another task of the robot replaced it")
                    continue
                if goal.begun_s is None:
                    goal.begun_s = feedback.stamp_s
                    self._set(goal, _EXECUTING)
                if navigator.result is not None:
                    self._end_by(goal, navigator.result)
                elif abs(feedback.stamp_s - self._fed_s) >= _FEEDBACK_S:
                    self._feed(goal, feedback)

    def close(self) -> None:
        """Abort all goals that have not ended."""
        with self._lock:
            for goal in tuple(self._open()):
                self._end(goal, _ABORTED, "the program that drives has ended")

    def _open(self) -> Iterator[_Goal]:
        return (goal for goal in self._goals.values() if goal.is_open)

    def _accept(self, message: Any) -> Any:
        """Ask the session for a goal. Nothing is accepted that it refuses."""
        id_, stamp_s, is_accepted = bytes(message.goal_id.uuid), self._robot_s(), False
        try:
            if id_ in self._goals:
                raise ArgumentError("its goal_id was used before")
            if len(tuple(self._open())) >= _MOST_OPEN:
                raise ArgumentError(f"{_MOST_OPEN} goals wait already")
            drive = DriveTo(self._inputs.goal_of(message.goal.pose), lambda why: self._left_out(id_, why))
            self._goals[id_] = _Goal(id_, stamp_s, drive)  # before the session may leave it out
            if why := self._inputs.pass_on(drive):
                del self._goals[id_]
                raise ArgumentError(why)
            is_accepted = True
            self._send_status()
        except ArgumentError as error:
            self.refuse(str(error))
        return self._make_of(f"{SEND.type}_Response", is_accepted, self._make.time(stamp_s))

    def _cancel(self, info: Any) -> Any:
        """Cancel by id, by time, both, or everything, as action_msgs/srv/CancelGoal describes it."""
        id_, stamp_s = bytes(info.goal_id.uuid), info.stamp.sec + 1e-9 * info.stamp.nanosec
        known = self._goals.get(id_)
        chosen = [goal for goal in self._open() if goal is known]
        if stamp_s or id_ == _NO_ID:
            until_s = stamp_s or math.inf
            chosen += [goal for goal in self._open() if goal.stamp_s <= until_s and goal not in chosen]
        cancelled = [goal for goal in chosen if not self._inputs.pass_on(CancelDrive(goal.drive))]
        for goal in cancelled:
            self._set(goal, _CANCELING)
        code = _CANCELS if cancelled else _REFUSED
        if not chosen and id_ != _NO_ID:
            code = _UNKNOWN if known is None else _TERMINATED
        return self._make_of(f"{CANCEL.type}_Response", code, [self._info(goal) for goal in cancelled])

    def _left_out(self, id_: bytes, why: str) -> None:
        with self._lock:
            goal = self._goals.get(id_)
            if goal is not None and goal.is_open:
                self._end(goal, _CANCELED if goal.status == _CANCELING else _ABORTED, why)

    def _end_by(self, goal: _Goal, result: NavigationResult) -> None:
        if result.has_arrived:
            self._end(goal, _SUCCEEDED, "")
            return
        is_cancelled = goal.status == _CANCELING and result.reason is NavigationReason.CANCELED
        self._end(goal, _CANCELED if is_cancelled else _ABORTED, f"{result.reason} ({result.detail})")

    def _end(self, goal: _Goal, status: int, message: str) -> None:
        """End a goal, and answer those that wait for its result."""
        goal.message = message
        self._set(goal, status)
        for request in goal.waiting:
            self._reply(RESULT, request, self._result(goal))
        goal.waiting = []
        ended = [id_ for id_, one in self._goals.items() if not one.is_open]
        for id_ in ended[:-_MOST_ENDED]:
            del self._goals[id_]

    def _set(self, goal: _Goal, status: int) -> None:
        # A goal that is to be cancelled may begin meanwhile, and stays to be cancelled.
        if not (status == _EXECUTING and goal.status == _CANCELING):
            goal.status = status
        self._send_status()

    def _result(self, goal: _Goal | None) -> Any:
        """The response of get_result; of status 0, unknown, without such a goal."""
        status, message = (0, "no such goal") if goal is None else (goal.status, goal.message)
        result = self._make_of(f"{_NAME}_Result", _NONE if status == _SUCCEEDED else _OTHER, message)
        return self._make_of(f"{RESULT.type}_Response", status, result)

    def _feed(self, goal: _Goal, feedback: Feedback) -> None:
        if feedback.pose is None or goal.begun_s is None:
            return
        self._fed_s = feedback.stamp_s
        to_go_m, passed_s = feedback.to_go_m, feedback.stamp_s - goal.begun_s
        if goal.begun_to_go_m is None:
            goal.begun_to_go_m = to_go_m
        left_s = 0.0
        if to_go_m is not None and goal.begun_to_go_m is not None and goal.begun_to_go_m > to_go_m:
            left_s = passed_s * to_go_m / (goal.begun_to_go_m - to_go_m)
        if to_go_m is None:
            to_go_m = math.hypot(*(feedback.pose[:2] - (goal.drive.goal.x_m, goal.drive.goal.y_m)))
        pose = self._make.pose(se3.from_plane(*feedback.pose))
        posed = self._make_of("geometry_msgs/msg/PoseStamped", self._make.header(feedback.stamp_s, MAP), pose)
        times = (self._duration(passed_s), self._duration(left_s))
        said = self._make_of(f"{_NAME}_Feedback", posed, *times, goal.recoveries, to_go_m)
        self._send(FEEDBACK, self._make_of(FEEDBACK.type, self._uuid(goal.id), said))

    def _send_status(self) -> None:
        rows = [
            self._make_of("action_msgs/msg/GoalStatus", self._info(goal), goal.status) for goal in self._goals.values()
        ]
        self._send(STATUS, self._make_of(STATUS.type, rows))

    def _send(self, topic: Topic, message: Any) -> None:
        if self._peer is not None:
            self._peer.send(topic, self._make.bytes_of(message), 0)

    def _reply(self, service: ActionService, request: bytes, response: Any) -> None:
        if self._peer is not None:
            self._peer.reply(service, request, self._make.bytes_of(response))

    def _info(self, goal: _Goal) -> Any:
        return self._make_of("action_msgs/msg/GoalInfo", self._uuid(goal.id), self._make.time(goal.stamp_s))

    def _uuid(self, id_: bytes) -> Any:
        return self._make_of("unique_identifier_msgs/msg/UUID", np.frombuffer(id_, np.uint8))

    def _duration(self, seconds: float) -> Any:
        return self._make_of("builtin_interfaces/msg/Duration", *divmod(nanoseconds(seconds), 10**9))

    def _make_of(self, type_: str, *values: Any) -> Any:
        return self.types.types[type_](*values)
