"""Who is answered: this computer alone, or who has the token; and no page but this one."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest
from live_page.room_session import SETTINGS, room_session
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from wheelsight.app.page import Access, is_loopback
from wheelsight.app.page.server import page_app

HOME = "http://127.0.0.1:8765"
LIVE = "ws://127.0.0.1:8765/live"
TOKEN = "a1b2c3d4e5f6a7b8"
PATHS = ("/", "/page.css", "/page.js", "/plan.png", "/camera.jpg", "/costmap.png", "/favicon.ico", "/stop", "/nowhere")


@contextmanager
def page(access: Access, refusals: list[str] | None = None) -> Iterator[tuple[TestClient, list[float]]]:
    """A client of it, once there are images, and when its robot was stopped."""
    kept = [] if refusals is None else refusals
    with room_session() as served, TestClient(page_app(served.session, SETTINGS, access, kept.append), HOME) as client:
        served.until(lambda reported: "camera" in reported["pictures"])
        yield client, served.robot.stops_s


@dataclass
class Asked:
    """A page that several tests ask: who was refused, and how often its robot was stopped, in the present one."""

    client: TestClient
    stops_s: list[float]
    refusals: list[str]

    def forget(self) -> Asked:
        self.stops_s.clear()
        self.refusals.clear()
        return self

    def until_stopped(self) -> None:
        ends_s = time.monotonic() + 5
        while not self.stops_s:
            assert time.monotonic() < ends_s
            time.sleep(0.002)


@pytest.fixture(scope="module")
def shared_at_home() -> Iterator[Asked]:
    refusals: list[str] = []
    with page(Access(True), refusals) as (client, stops_s):
        yield Asked(client, stops_s, refusals)


@pytest.fixture(scope="module")
def shared_behind_a_token() -> Iterator[Asked]:
    refusals: list[str] = []
    with page(Access(False, TOKEN), refusals) as (client, stops_s):
        yield Asked(client, stops_s, refusals)


@pytest.fixture
def at_home(shared_at_home: Asked) -> Asked:
    return shared_at_home.forget()


@pytest.fixture
def behind_a_token(shared_behind_a_token: Asked) -> Asked:
    return shared_behind_a_token.forget()


@pytest.mark.parametrize(
    ("host", "reported"),
    [
        ("127.0.0.1", True),
        ("127.8.8.8", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("::", False),
        ("192.168.1.2", False),
        ("", False),
        ("localhost.evil.org", False),
        ("robot", False),
    ],
)
def test_this_computer_is_reported_from_others(host: str, reported: bool) -> None:
    assert is_loopback(host) is reported


def test_the_page_and_its_images_come_and_nothing_may_lead_out() -> None:
    with page(Access(True)) as (client, _):
        for path, kind in (("/", "text/html"), ("/page.css", "text/css"), ("/page.js", "text/javascript")):
            answer = client.get(path)
            assert answer.status_code == 200
            assert answer.headers["content-type"].startswith(kind)
            assert answer.headers["content-security-policy"].startswith("default-src 'self'")
            assert answer.headers["cache-control"] == "no-store"
            # A name of another place would begin with a scheme.
            assert "http:" not in answer.text.replace('scheme = location.protocol === "https:"', "")
            assert "https://" not in answer.text
            assert 'src="//' not in answer.text
        for path, begin in (("/plan.png", b"\x89PNG"), ("/camera.jpg", b"\xff\xd8")):
            assert client.get(path).content.startswith(begin)
        assert client.get("/costmap.png").status_code == 404, "nobody asked to see it"
        assert client.get("/../session.py").status_code == 404


@pytest.mark.parametrize("host", ["evil.org", "evil.org:8765", "127.0.0.1.evil.org", "localhost.evil.org:8765", ""])
def test_a_name_that_somebody_led_here_is_refused(at_home: Asked, host: str) -> None:
    client, refusals = at_home.client, at_home.refusals
    for path in PATHS:
        assert client.request("POST" if path == "/stop" else "GET", path, headers={"host": host}).status_code == 403
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE, headers={"host": host}):
        pass
    assert not at_home.stops_s
    assert len(refusals) == len(PATHS) + 1
    assert "is not this computer" in refusals[-1]


@pytest.mark.parametrize("origin", ["http://evil.org", "null", "http://127.0.0.1:8766", "http://localhost:8765"])
def test_another_page_is_refused(at_home: Asked, origin: str) -> None:
    client = at_home.client
    assert client.post("/stop", headers={"origin": origin}).status_code == 403
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE, headers={"origin": origin}):
        pass
    assert not at_home.stops_s
    assert client.post("/stop", headers={"origin": HOME}).status_code == 200
    at_home.until_stopped()


@pytest.mark.parametrize(
    "given", ["", "?token=", "?token=wrong", f"?token={TOKEN[:-1]}", f"?tokens={TOKEN}", "?" + 20 * "a=b&"]
)
def test_without_the_token_nothing_is_answered(behind_a_token: Asked, given: str) -> None:
    client = behind_a_token.client
    for path in PATHS:
        answer = client.request("POST" if path == "/stop" else "GET", path + given)
        assert answer.status_code == 401
        assert answer.text.startswith("no token")
        assert answer.text.count("\n") == 1
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(f"{LIVE}{given}"):
        pass
    assert not behind_a_token.stops_s
    assert len(behind_a_token.refusals) == len(PATHS) + 1
    assert all(TOKEN not in line for line in behind_a_token.refusals)


def test_a_browser_keeps_the_token_and_needs_it_once() -> None:
    with page(Access(False, TOKEN)) as (client, _):
        answer = client.get(f"/?token={TOKEN}")
        assert answer.status_code == 200
        assert "HttpOnly" in answer.headers["set-cookie"]
        assert "SameSite=Strict" in answer.headers["set-cookie"]
        assert client.get("/page.js").status_code == 200
        with client.websocket_connect(LIVE) as socket:
            assert socket.receive_json()["welcome"]["you"] == 1
        client.cookies.clear()
        assert client.get("/page.js").status_code == 401
        assert client.get("/page.js", headers={"authorization": f"Bearer {TOKEN}"}).status_code == 200
        assert client.get("/page.js", headers={"cookie": "wheelsight=nothing"}).status_code == 401
        # Off this computer it has whatever name people call it by.
        assert client.get(f"/?token={TOKEN}", headers={"host": "robot.home:8765"}).status_code == 200


def test_stop_is_of_everybody_who_may_see_the_page(at_home: Asked) -> None:
    assert at_home.client.get("/stop").status_code == 405
    assert not at_home.stops_s
    assert at_home.client.post("/stop").text == "stopped\n"
    at_home.until_stopped()
