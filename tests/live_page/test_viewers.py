"""Pages see what goes on, one of them drives, and each is listened to as far as it behaves."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from live_page.room_session import BEGIN, GOAL, Served, is_near, replaced, room_session
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from wheelsight.app.page import Access
from wheelsight.app.page.server import GONE, page_app

Open = Callable[[], WebSocketTestSession]
ALIVE = '{"type": "alive"}'


@contextmanager
def page(refusals: list[str] | None = None, **settings: Any) -> Iterator[tuple[Served, Open]]:
    """A session, and what opens one more page of it."""
    kept = [] if refusals is None else refusals
    with room_session(**settings) as served:
        app = page_app(served.session, replaced(settings), Access(True), kept.append)
        with TestClient(app, "http://localhost:1") as client:
            yield served, lambda: client.websocket_connect("ws://localhost:1/live")


def heard(socket: WebSocketTestSession, what: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
    """The first of what is sent for which something is so; a page that lives on says so meanwhile."""
    for _ in range(400):
        reported = socket.receive_json()
        if what(reported):
            return dict(reported)
        socket.send_text(ALIVE)
    raise AssertionError(f"it did not come: {reported}")


def refused(words: str) -> Callable[[dict[str, Any]], bool]:
    return lambda reported: words in reported.get("refused", "")


def robot(what: Callable[[dict[str, Any]], Any]) -> Callable[[dict[str, Any]], Any]:
    return lambda reported: "robot" in reported and what(reported["robot"])


def test_a_goal_clicked_on_a_page_is_driven_to() -> None:
    with page() as (_, open_page), open_page() as socket:
        welcome = socket.receive_json()["welcome"]
        assert welcome == {"you": 1, "old_s": 1.0}
        reported = heard(socket, lambda reported: "robot" in reported)
        assert reported["driver"] is None
        assert reported["viewers"] == 1
        assert reported["age_s"] < 1
        socket.send_json(GOAL)
        reported = heard(socket, robot(lambda reported: reported["state"] == "driving"))
        assert reported["driver"] == 1
        assert is_near(heard(socket, robot(lambda reported: reported["state"] == "arrived"))["robot"], 5.0, 3.0)


def test_one_drives_and_everybody_stops() -> None:
    with page() as (served, open_page), open_page() as first, open_page() as second:
        assert second.receive_json()["welcome"]["you"] == 2
        first.send_json(GOAL)
        heard(first, robot(lambda reported: reported["speed_m_s"] > 0.2))
        second.send_json(GOAL)
        heard(second, refused("another page drives"))
        second.send_json({"type": "take"})
        heard(second, lambda reported: reported.get("driver") == 2)
        assert not served.robot.stops_s, "who takes control changes nothing of the drive"
        first.send_json({"type": "explore"})
        heard(first, refused("another page drives"))
        first.send_json({"type": "stop"})
        reported = heard(second, robot(lambda reported: reported["stopped"]))["robot"]
        assert reported["stopped"] == "somebody pressed STOP"
        assert len(served.robot.stops_s) == 1


@pytest.mark.parametrize("leaves", ["closes", "gives up"])
def test_a_robot_whose_driver_is_gone_stops(leaves: str) -> None:
    with page() as (served, open_page):
        with open_page() as socket:
            socket.send_json(GOAL)
            heard(socket, robot(lambda reported: reported["speed_m_s"] > 0.2))
            if leaves == "gives up":
                socket.send_json({"type": "leave"})
                heard(socket, robot(lambda reported: reported["stopped"]))
        served.until(lambda reported: reported["stopped"] == GONE)
        served.until(lambda reported: reported["speed_m_s"] == 0)


def test_a_driver_who_falls_silent_is_gone() -> None:
    with page(driver_silent_s=0.6) as (served, open_page), open_page() as socket:
        socket.send_json(GOAL)
        heard(socket, robot(lambda reported: reported["speed_m_s"] > 0.1))
        served.until(lambda reported: reported["stopped"] == GONE)


def test_it_may_drive_on_without_a_driver_where_settings_say_so() -> None:
    with page(stops_without_driver=False) as (served, open_page):
        with open_page() as socket:
            socket.send_json(GOAL)
            heard(socket, robot(lambda reported: reported["speed_m_s"] > 0.2))
        assert is_near(served.until(lambda reported: reported["state"] == "arrived"), 5.0, 3.0)
        assert not served.robot.stops_s


def test_a_viewer_who_leaves_stops_nothing() -> None:
    with page() as (served, open_page), open_page() as driver:
        driver.send_json(GOAL)
        heard(driver, robot(lambda reported: reported["speed_m_s"] > 0.2))
        with open_page() as other:
            heard(other, lambda reported: reported.get("viewers") == 2)
        heard(driver, lambda reported: reported.get("viewers") == 1)
        assert not served.robot.stops_s


def steered(socket: WebSocketTestSession, what: Callable[[dict[str, Any]], Any], left: float = 0.0) -> dict[str, Any]:
    """Hold the stick forward until something is so, and return what was sent then."""
    for _ in range(400):
        socket.send_json({"type": "stick", "forward": 0.4, "left": left})
        reported = socket.receive_json()
        if robot(what)(reported):
            return dict(reported["robot"])
    raise AssertionError(f"it did not come: {reported}")


def test_the_stick_of_a_page_drives_and_a_silent_one_stands() -> None:
    with page() as (served, open_page), open_page() as socket:
        steered(socket, lambda reported: reported["speed_m_s"] > 0.25)
        # Nothing more comes from the stick; the page itself is alive.
        reported = heard(socket, robot(lambda reported: reported["speed_m_s"] == 0))
        assert reported["robot"]["stopped"] == ""
        at_m = served.robot.base.pose[0]
        assert BEGIN[0] + 0.1 < at_m < 6.0
        heard(socket, robot(lambda reported: reported["state"] == "idle"))
        assert served.robot.base.pose[0] == pytest.approx(at_m, abs=0.02)


def test_a_page_that_is_gone_while_its_stick_is_held_stops_the_robot() -> None:
    with page() as (served, open_page):
        with open_page() as socket:
            steered(socket, lambda reported: reported["speed_m_s"] > 0.25)
        served.until(lambda reported: reported["stopped"] == GONE)
        served.until(lambda reported: reported["speed_m_s"] == 0)


def test_the_stick_of_a_page_is_helped_along_a_wall_and_says_so() -> None:
    with page() as (served, open_page), open_page() as socket:
        served.robot.base.pose[:] = 4.0, 0.9, -0.35
        reported = steered(socket, lambda reported: reported["doing"].startswith("steers"))
        assert reported["doing"] == "steers to the left"
        assert reported["state"] == "driving"


def test_a_stick_of_another_page_and_one_beyond_its_way_are_refused() -> None:
    with page() as (_, open_page), open_page() as one, open_page() as other:
        steered(one, lambda reported: reported["speed_m_s"] > 0.1)
        other.send_json({"type": "stick", "forward": 0.5, "left": 0.0})
        heard(other, refused("another page drives"))
        for wrong in ("2.0", "NaN", '"1"'):
            one.send_text(f'{{"type": "stick", "forward": {wrong}, "left": 0.0}}')
            heard(one, refused("a message of no sense"))


def test_the_costmap_is_made_while_somebody_looks_at_it() -> None:
    with page(images_hz=20.0) as (served, open_page), open_page() as socket:
        assert "costmap" not in heard(socket, lambda reported: "robot" in reported)["robot"]["pictures"]
        socket.send_json({"type": "costmap", "shown": True})
        reported = heard(socket, robot(lambda reported: "costmap" in reported["pictures"]))
        assert len(reported["robot"]["pictures"]["costmap"]["place"]) == 4
        assert served.session.latest.pictures["costmap"].body.startswith(b"\x89PNG")


def sent_away(socket: WebSocketTestSession) -> WebSocketDisconnect:
    try:
        for _ in range(1000):
            socket.receive_json()
    except WebSocketDisconnect as gone:
        return gone
    raise AssertionError("it was not sent away")


def test_what_makes_no_sense_is_refused_and_at_last_not_listened_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.app.page.server._MOST_BAD", 3)
    refusals: list[str] = []
    with page(refusals) as (served, open_page), open_page() as socket:
        for text in ("garbage", '{"type": "fly"}'):
            socket.send_text(text)
            heard(socket, refused("a message of no sense"))
        socket.send_text("[]")
        gone = sent_away(socket)
        assert (gone.code, gone.reason) == (1008, "too many messages that make no sense")
        assert [line.partition(":")[0] for line in refusals] == 3 * ["refused page 1"] + ["refused testclient"]
        assert all("\n" not in line for line in refusals)
        assert not served.robot.stops_s


@pytest.mark.parametrize(
    ("message", "code", "reason"),
    [
        (b"\x00\x01", 1003, "no text"),
        ("x" * 3000, 1009, "of more than 2048 bytes"),
        ("é" * 1200, 1009, "more than 2048"),
    ],
)
def test_bytes_and_long_texts_are_refused(message: str | bytes, code: int, reason: str) -> None:
    with page() as (_, open_page), open_page() as socket:
        if isinstance(message, bytes):
            socket.send_bytes(message)
        else:
            socket.send_text(message)
        gone = sent_away(socket)
        assert gone.code == code
        assert reason in gone.reason


def test_a_flood_is_refused_and_stop_is_heard_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.app.page.server._MESSAGES_A_S", 5.0)
    with page() as (served, open_page), open_page() as socket:
        for _ in range(11):
            socket.send_text(ALIVE)
        gone = sent_away(socket)
        assert gone.reason == "too many messages"
        with open_page() as other:
            for _ in range(30):
                other.send_json({"type": "stop"})
            assert sent_away(other).reason == "too many messages"
        served.until_stopped()


def test_too_many_pages_are_refused() -> None:
    with page(most_viewers=2) as (_, open_page), open_page(), open_page():
        with open_page() as third:
            gone = sent_away(third)
        assert (gone.code, gone.reason) == (1013, "too many pages are open: 2")


def test_what_is_asked_in_vain_is_reported() -> None:
    with page() as (served, open_page), open_page() as socket:
        served.robot.goes_on.clear()
        for _ in range(30):
            socket.send_json(GOAL)
        heard(socket, refused("too much was asked at once"))


def test_what_is_reported_is_json_for_browsers() -> None:
    with page() as (_, open_page), open_page() as socket:
        socket.receive_text()
        for _ in range(5):
            json.loads(socket.receive_text(), parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
