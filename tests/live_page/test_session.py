"""A session drives where it is asked, stops before all else, and goes from map to map."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

import numpy as np
import pytest
from live_page.room_session import BEGIN, ObedientRobot, RoomMaps, RoomPlaces, Served, is_near, room_session
from narrowing import not_none
from navigation.rooms import StandInLocalization

from wheelsight.app.page import StopSwitch
from wheelsight.app.page.session import (
    ClearFault,
    ClearObstacles,
    DriveByHand,
    Explore,
    GoToName,
    GoToPose,
    NamePlace,
    SaveMap,
    SetPose,
    StartMap,
    Task,
)
from wheelsight.app.page.snapshot import SnapshotMaker
from wheelsight.core.errors import DeviceError
from wheelsight.core.messages import STOP, Event, VelocityCommand
from wheelsight.core.robots import CONTROL_PERIOD_S
from wheelsight.navigation import Feedback, Navigator, Transition

THERE = GoToPose(type="goal", x_m=5.0, y_m=3.0, yaw_rad=0.0)
NEAR = GoToPose(type="goal", x_m=2.5, y_m=3.0, yaw_rad=0.0)


def has_said(words: str):
    return lambda reported: any(words in one["text"] for one in reported["said"])


def test_a_goal_is_driven_to_and_reported() -> None:
    with room_session(paces=False) as served:
        reported = served.until(lambda reported: reported["pose"] is not None)
        assert reported["pose"] == list(BEGIN)
        assert reported["status"] == "knows where it is"
        assert served.session.ask(THERE) == ""
        reported = served.until(lambda reported: reported["state"] == "driving" and reported["speed_m_s"] > 0.3)
        assert reported["path"][-1] == pytest.approx([5.0, 3.0], abs=0.1)
        assert reported["goal"] == pytest.approx([5.0, 3.0, 0.0], abs=0.1)
        assert served.session.latest.is_driving
        reported = served.until(lambda reported: reported["state"] == "arrived")
        assert is_near(reported, 5.0, 3.0)
        assert len(reported["way"]) > 20
        assert has_said("arrived: (5.00, 3.00) m")(served.until(has_said("arrived")))


def test_what_is_asked_for_before_a_stop_is_not_done_after_it() -> None:
    with room_session() as served:
        served.robot.goes_on.clear()
        time.sleep(0.1)  # the period that was under way hangs in the next one
        served.session.ask(THERE)
        served.session.stop("somebody pressed STOP")
        served.robot.goes_on.set()
        reported = served.until(has_said("left out"))
        assert reported["stopped"] == "somebody pressed STOP"
        assert served.stands
        served.session.ask(THERE)
        served.until(lambda reported: reported["speed_m_s"] > 0.1)


def test_stop_ends_the_task_and_the_robot_stays() -> None:
    with room_session() as served:
        served.session.ask(THERE)
        served.until(lambda reported: reported["speed_m_s"] > 0.3)
        served.session.stop("somebody pressed STOP")
        reported = served.until(lambda reported: reported["state"] == "failed" and reported["speed_m_s"] == 0)
        assert has_said("not arrived: somebody pressed STOP")(reported)
        stood_at = served.robot.base.pose.copy()
        time.sleep(0.5)
        np.testing.assert_allclose(served.robot.base.pose, stood_at, atol=1e-3)
        assert served.robot.commands[-1] == STOP


def test_a_place_is_named_and_driven_to_by_its_name() -> None:
    with room_session(paces=False) as served:
        served.session.ask(NamePlace(type="name", name="door"))
        reported = served.until(has_said("this place is called door"))
        assert served.until(lambda reported: reported["places"])["places"] == [{"name": "door", "pose": list(BEGIN)}]
        served.session.ask(NEAR)
        reported = served.until(lambda reported: reported["state"] == "arrived")
        assert not is_near(reported, 1.5, 3.0)
        served.session.ask(GoToName(type="go", name="nowhere"))
        served.until(has_said("no place of the map is called 'nowhere'"))
        served.session.ask(GoToName(type="go", name="door"))
        reported = served.until(has_said("arrived: door"))
        assert is_near(reported, 1.5, 3.0)


def test_maps_change_only_while_it_stands() -> None:
    with room_session() as served:
        served.session.ask(THERE)
        served.until(lambda reported: reported["speed_m_s"] > 0.2)
        served.session.ask(StartMap(type="start", map="yesterday"))
        served.until(has_said("stop the robot first"))
        served.session.stop("somebody pressed STOP")
        served.until(lambda reported: reported["speed_m_s"] == 0)
        served.session.ask(StartMap(type="start", map="yesterday"))
        reported = served.until(lambda reported: reported["map"] == "yesterday" and reported["phase"] == "driving")
        assert reported["stopped"], "nothing moves because of another map"
        assert served.maps.opened_with == [("today", None), ("yesterday", None)]


def test_a_new_map_is_saved_and_gone_on_in_from_where_the_robot_stands() -> None:
    with room_session("new") as served:
        assert served.until(lambda reported: reported["phase"] == "driving")["is_new"]
        served.session.ask(SaveMap(type="save"))
        reported = served.until(lambda reported: reported["map"] == "yesterday" and reported["phase"] == "driving")
        assert has_said("the map is saved")(reported)
        assert not reported["is_new"]
        name, pose = served.maps.opened_with[-1]
        assert name == "yesterday"
        np.testing.assert_allclose(not_none(pose), np.array(BEGIN), atol=1e-6)
        served.session.ask(Explore(type="explore"))
        served.until(has_said("this map is finished"))


def test_a_map_that_cannot_be_opened_is_reported_and_another_can_be_chosen() -> None:
    with room_session("broken") as served:
        reported = served.until(lambda reported: reported["phase"] == "choose")
        assert has_said("is damaged")(reported)
        served.session.ask(THERE)
        served.until(has_said("choose a map first"))
        served.session.ask(StartMap(type="start", map="today"))
        served.until(lambda reported: reported["phase"] == "driving")


def test_a_robot_that_is_gone_ends_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    with room_session() as served:

        def unplugged(command):
            raise DeviceError("the port is gone")

        monkeypatch.setattr(served.robot, "step", unplugged)
        reported = served.until(lambda reported: reported["phase"] == "choose")
        assert has_said("the port is gone")(reported)
        served.until_stopped()


def wrong(*_: object, **__: object) -> None:
    raise TypeError("a list where an array was needed\nand more")


LINE = "TypeError: a list where an array was needed"


def goes_on(served: Served) -> None:
    """The robot stands, the error is on the page in one line, and the next goal is driven to."""
    reported = served.until(has_said(LINE))
    assert all("\n" not in one["text"] for one in reported["said"])
    assert reported["stopped"]
    served.until_stopped()
    assert not served.session.is_over
    served.until(lambda reported: reported["phase"] == "driving" and reported["speed_m_s"] == 0)
    served.session.ask(NEAR)
    served.until(lambda reported: reported["state"] == "driving" and reported["speed_m_s"] > 0.1)


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (ObedientRobot, "step"),
        (StandInLocalization, "process"),
        (Navigator, "_decide"),
        (SnapshotMaker, "of"),
        (StopSwitch, "release"),
    ],
)
def test_any_error_while_it_drives_stops_the_robot_and_it_can_drive_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, owner: type, name: str
) -> None:
    with room_session(paces=False) as served:
        served.session.ask(THERE)
        if name != "release":
            served.until(lambda reported: reported["speed_m_s"] > 0.3)
        with monkeypatch.context() as patched:
            patched.setattr(owner, name, wrong)
            if name == "release":
                served.session.ask(THERE)
            served.until_stopped()
            served.until(has_said(LINE)) if name != "of" else time.sleep(0.5)
        goes_on(served)
    assert sum(record.exc_info is not None for record in caplog.records) == 1, "the log has one traceback"


@pytest.mark.parametrize(
    ("owner", "name", "task"),
    [
        (Navigator, "go_to_pose", THERE),
        (Navigator, "explore", Explore(type="explore")),
        (RoomPlaces, "name", NamePlace(type="name", name="door")),
        (RoomMaps, "names", StartMap(type="start", map="yesterday")),
    ],
)
def test_any_error_of_a_task_stops_the_robot_and_the_next_is_done(
    monkeypatch: pytest.MonkeyPatch, owner: type, name: str, task: Task
) -> None:
    with room_session("new", paces=False) as served:
        with monkeypatch.context() as patched:
            patched.setattr(owner, name, wrong)
            served.session.ask(task)
            served.until_stopped()
        goes_on(served)


@pytest.mark.parametrize(
    ("task", "map_"), [(SaveMap(type="save"), "new"), (StartMap(type="start", map="today"), "today")]
)
def test_an_error_while_a_map_is_saved_or_closed_leaves_one_to_drive_in(
    monkeypatch: pytest.MonkeyPatch, task: Task, map_: str
) -> None:
    with room_session("new", paces=False) as served:
        served.maps.closes_wrongly = True
        served.session.ask(task)
        served.until(has_said(LINE))
        assert has_said("the map is not saved")(served.until(has_said(LINE)))
        goes_on(served)
        assert served.until(lambda reported: reported["phase"] == "driving")["map"] == map_


def test_an_error_while_a_map_is_opened_leaves_others_to_choose(monkeypatch: pytest.MonkeyPatch) -> None:
    with room_session() as served:
        with monkeypatch.context() as patched:
            patched.setattr(RoomMaps, "opened", wrong)
            served.session.ask(StartMap(type="start", map="yesterday"))
            assert has_said(f"the map is not opened: {LINE}")(
                served.until(lambda reported: reported["phase"] == "choose")
            )
        served.session.ask(StartMap(type="start", map="today"))
        goes_on(served)


def test_an_error_while_it_is_stopped_is_shown_and_it_is_stopped_again(monkeypatch: pytest.MonkeyPatch) -> None:
    with room_session() as served:
        served.session.ask(THERE)
        served.until(lambda reported: reported["speed_m_s"] > 0.2)
        with monkeypatch.context() as patched:
            patched.setattr(ObedientRobot, "stop", wrong)
            patched.setattr(Navigator, "_decide", wrong)
            reported = served.until(lambda reported: reported["problem"] == LINE)
            assert reported["stopped"]
        served.until_stopped()
        served.until(lambda reported: reported["problem"] == "")
        goes_on(served)


def test_a_thread_that_hangs_is_noticed_and_its_task_is_over() -> None:
    problems: list[str] = []
    with room_session(paces=False, on_problem=problems.append) as served:
        served.session.ask(THERE)
        served.until(lambda reported: reported["speed_m_s"] > 0.3)
        served.robot.goes_on.clear()
        reported = served.until(lambda reported: reported["stopped"])
        assert reported["stopped"] == "the thread that drives does not answer"
        assert has_said("does not answer: the robot is stopped; give it its task again")(reported)
        assert any("does not answer" in line for line in problems)
        served.until_stopped()
        served.robot.goes_on.set()
        reported = served.until(has_said("the thread that drives answers again after"))
        reported = served.until(lambda reported: reported["state"] == "failed" and reported["speed_m_s"] == 0)
        stood_at = served.robot.base.pose.copy()
        time.sleep(0.2)
        np.testing.assert_allclose(served.robot.base.pose, stood_at, atol=1e-3)
        served.session.ask(NEAR)
        served.until(lambda reported: reported["speed_m_s"] > 0.1)


def test_a_robot_that_stands_without_a_task_may_be_kept_waiting() -> None:
    with room_session(paces=False) as served:
        served.robot.goes_on.clear()
        time.sleep(0.8)
        served.robot.goes_on.set()
        assert not served.session.switch.presses


def test_too_much_at_once_is_refused() -> None:
    with room_session() as served:
        served.robot.goes_on.clear()
        refused = [served.session.ask(THERE) for _ in range(40)]
        assert refused[0] == ""
        assert refused[-1] == "too much was asked at once; it is left out"


def test_the_end_stops_the_robot_first() -> None:
    with room_session() as served:
        served.session.ask(THERE)
        served.until(lambda reported: reported["speed_m_s"] > 0.3)
        served.session.close()
        assert served.robot.stops_s
        assert served.session.is_over
        assert "begin wheelsight serve again" in served.session.ask(THERE)


class Seen:
    """What a watch was reported."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.transitions: list[Transition] = []
        self.steps: list[tuple[Feedback, Navigator]] = []

    def on_events(self, events: Sequence[Event]) -> None:
        self.events += events

    def note(self, transition: Transition) -> None:
        self.transitions.append(transition)

    def step(self, feedback: Feedback, navigator: Navigator) -> None:
        self.steps.append((feedback, navigator))


def test_a_watch_sees_all_periods_of_all_maps() -> None:
    seen = Seen()
    with room_session(paces=False, watch=seen) as served:
        served.session.ask(NEAR)
        served.until(lambda reported: reported["state"] == "arrived")
        served.session.ask(StartMap(type="start", map="yesterday"))
        served.until(lambda reported: reported["map"] == "yesterday" and reported["phase"] == "driving")
    stamps_s = np.array([feedback.stamp_s for feedback, _ in seen.steps])
    period_s = CONTROL_PERIOD_S
    np.testing.assert_allclose(np.diff(stamps_s), period_s, atol=1e-6)
    assert [str(one.after) for one in seen.transitions] == ["planning", "driving", "planning", "arrived"]
    assert {event.stamp_s for event in seen.events} >= set(stamps_s[1:].tolist())
    assert len({id(navigator) for _, navigator in seen.steps}) == 2


def test_a_driver_who_says_that_nothing_is_there_clears_it_while_the_robot_drives(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cleared: list[object] = []
    monkeypatch.setattr(Navigator, "clear_obstacles", lambda navigator, xy: cleared.append(xy))
    with room_session() as served:
        served.session.ask(THERE)
        reported = served.until(lambda reported: reported["speed_m_s"] > 0.1)
        assert reported["stays"] is None
        served.session.ask(ClearObstacles(type="clear", x_m=4.0, y_m=3.5))
        served.until(lambda reported: bool(cleared))
        assert cleared == [(4.0, 3.5)]
        served.until(lambda reported: reported["state"] == "driving" and reported["speed_m_s"] > 0.1)


def test_a_driver_who_has_checked_the_wheels_clears_their_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    obey, is_blocked = ObedientRobot.step, threading.Event()
    monkeypatch.setattr(
        ObedientRobot, "step", lambda robot, command: obey(robot, STOP if is_blocked.is_set() else command)
    )
    with room_session(paces=False) as served:
        is_blocked.set()
        served.session.ask(NEAR)
        reported = served.until(lambda reported: reported["state"] == "failed")
        assert reported["wheels_off"]
        assert "the wheels do not follow their commands" in reported["said"][-1]["text"]
        is_blocked.clear()
        served.session.ask(NEAR)
        reported = served.until(lambda reported: len(reported["said"]) > 1)
        assert "the wheels do not follow their commands" in reported["said"][-1]["text"], "one task after another fails"
        served.session.ask(ClearFault(type="wheels"))
        served.until(lambda reported: not reported["wheels_off"])
        served.session.ask(NEAR)
        served.until(lambda reported: reported["state"] == "arrived")


def test_commands_by_hand_are_followed_until_none_come() -> None:
    commands = [*[VelocityCommand(0.3, 0.0)] * 40, *[STOP] * 20]
    with room_session(paces=False) as served:
        served.until(lambda reported: reported["pose"] is not None)
        assert served.session.ask(DriveByHand(lambda: commands.pop(0) if commands else None)) == ""
        reported = served.until(lambda reported: reported["state"] == "idle" and reported["doing"] == "by hand")
        assert reported["said"] == []
        # 40 periods of 0.05 s at 0.3 m/s, less the ramp up, with the ramp down.
        assert served.robot.base.pose[0] - BEGIN[0] == pytest.approx(0.6, abs=0.15)
        assert served.session.ask(NEAR) == ""
        served.until(lambda reported: reported["state"] == "arrived")


def test_commands_by_hand_are_stopped_before_a_wall() -> None:
    with room_session(paces=False) as served:
        served.until(lambda reported: reported["pose"] is not None)
        served.session.ask(DriveByHand(lambda: VelocityCommand(1.0, 0.0)))
        served.until(lambda reported: reported["speed_m_s"] == 0 and reported["pose"][0] > 6)
        assert served.robot.base.pose[0] < 7.2  # of 8 m, less its front


def test_a_pose_is_set_in_a_known_map_alone() -> None:
    pose = np.array([2.0, 3.0, 0.5])
    with room_session("new", paces=False) as served:
        served.until(lambda reported: reported["pose"] is not None)
        served.session.ask(SetPose(pose))
        served.until(has_said("no pose can be set in it"))
        assert served.maps.opened_with == [("new", None)]
        served.session.ask(StartMap(type="start", map="yesterday"))
        served.until(lambda reported: reported["map"] == "yesterday" and reported["phase"] == "driving")
        served.session.ask(SetPose(pose))
        served.until(lambda reported: len(served.maps.opened_with) == 3)
        name, given = served.maps.opened_with[-1]
        assert name == "yesterday"
        np.testing.assert_array_equal(not_none(given), pose)
