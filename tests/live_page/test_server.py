"""The page as it is served: over real connections, to clients that do not behave, with a robot's program that hangs."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from http.client import HTTPConnection
from typing import Any

import pytest
from live_page.room_session import GOAL, Served, replaced, room_session
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from benchmarks.page_requests import abroad, at_home, refusals
from wheelsight.app.page import Access
from wheelsight.app.page.server import PageServer, page_app
from wheelsight.core.errors import ConfigError

TOKEN = "a1b2c3d4e5f6a7b8"


@contextmanager
def server(
    refused: list[str] | None = None, access: Access | None = None, **settings: Any
) -> Iterator[tuple[Served, int]]:
    """A session, and the port of its page."""
    kept = [] if refused is None else refused
    with room_session(**settings) as served:
        app = page_app(served.session, replaced(settings), access or Access(True), kept.append)
        with PageServer(app, "127.0.0.1", 0, replaced(settings)) as running:
            yield served, running.port


def asked(port: int, method: str, path: str, **headers: str) -> tuple[int, str]:
    """Status and text of an answer."""
    connection = HTTPConnection("127.0.0.1", port, timeout=10)
    try:
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()
    finally:
        connection.close()


def opened(port: int) -> ClientConnection:
    # No pings: a test that reads little would miss the answers on a busy computer.
    return connect(f"ws://127.0.0.1:{port}/live", compression=None, open_timeout=10, ping_interval=None)


def test_each_bad_request_is_refused_and_the_page_goes_on() -> None:
    with server() as (served, port):
        found = refusals(port, at_home())
        assert len(found) >= 24
        assert [one for one in found if not one[2]] == []
        assert not served.robot.stops_s
        with opened(port) as socket_:
            socket_.send(json.dumps(GOAL))
            served.until(lambda reported: reported["state"] == "driving")


def test_nothing_is_answered_without_the_token() -> None:
    with server(access=Access(False, TOKEN)) as (served, port):
        found = refusals(port, abroad())
        assert [one for one in found if not one[2]] == []
        assert not served.robot.stops_s
        with connect(f"ws://127.0.0.1:{port}/live?token={TOKEN}") as socket_:
            assert "welcome" in socket_.recv(timeout=10)


@pytest.mark.parametrize("way", ["websocket", "post"])
def test_stop_works_while_the_robots_program_hangs(way: str) -> None:
    with server() as (served, port), opened(port) as socket_:
        socket_.send(json.dumps(GOAL))
        served.until(lambda reported: reported["speed_m_s"] > 0.2)
        served.robot.goes_on.clear()
        time.sleep(0.1)
        asked_s = time.monotonic()
        if way == "websocket":
            socket_.send('{"type": "stop"}')
        else:
            connection = HTTPConnection("127.0.0.1", port, timeout=10)
            connection.request("POST", "/stop")
            assert connection.getresponse().status == 200
            connection.close()
        while not served.robot.stops_s:
            assert time.monotonic() < asked_s + 5
            time.sleep(0.001)
        # Many times what it takes, as others may keep the computer busy; benchmarks.live_page measures.
        assert served.robot.stops_s[0] - asked_s < 1.0
        reported = (json.loads(socket_.recv(timeout=10)) for _ in range(200))
        assert any(one.get("age_s", 0) > 1.0 for one in reported), "pages are reported that it does not answer"


def test_a_page_that_never_reads_is_sent_away_and_others_are_not_kept_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.app.page.server._SEND_S", 0.3)
    refused: list[str] = []
    # As if each update were larger, so that a system's buffers are full within the test.
    with server(refused, updates_hz=50.0) as (served, port), opened(port) as reader:
        raw = idle_client(port)
        served.session.say("x" * 100_000)
        ends_s, slowest_s = time.monotonic() + 60, 0.0
        while not any("never reads" in line for line in refused):
            assert time.monotonic() < ends_s
            before_s = time.monotonic()
            reader.recv(timeout=10)
            slowest_s = max(slowest_s, time.monotonic() - before_s)
        assert slowest_s < 2.0
        raw.close()


def idle_client(port: int) -> socket.socket:
    """A websocket that is opened and then never read, with buffers as small as the system lets them be."""
    made = socket.socket()
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    made.connect(("127.0.0.1", port))
    made.sendall(
        f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    assert made.recv(12) == b"HTTP/1.1 101"
    return made


def test_connections_without_a_request_take_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.app.page.server._MOST_CONNECTIONS", 8)
    with server() as (_, port), ExitStack() as held:
        for _ in range(8):
            held.enter_context(socket.create_connection(("127.0.0.1", port), 5))
        assert asked(port, "GET", "/")[0] == 200


def test_a_page_that_vanishes_without_a_word_is_no_driver_for_long() -> None:
    with server(driver_silent_s=1.5) as (served, port):
        raw = idle_client(port)
        text = json.dumps(GOAL).encode()
        mask = b"\x00\x00\x00\x00"
        raw.sendall(bytes([0x81, 0x80 | len(text)]) + mask + text)
        served.until(lambda reported: reported["state"] == "driving")
        served.until(lambda reported: reported["stopped"] == "the page of the driver is gone")
        raw.close()


def test_a_port_that_is_taken_is_reported_in_a_line() -> None:
    with server() as (served, port):
        app = page_app(served.session, replaced({}), Access(True))
        with pytest.raises(ConfigError, match=f"port {port}") as refused:
            PageServer(app, "127.0.0.1", port, replaced({}))
        assert "\n" not in str(refused.value)


def test_anyone_who_was_connected_learns_that_it_ends() -> None:
    with ExitStack() as held:
        with server() as (_, port):
            socket_ = held.enter_context(opened(port))
            assert "welcome" in socket_.recv(timeout=10)
        ends_s = time.monotonic() + 10
        with suppress(ConnectionClosed):
            while time.monotonic() < ends_s:
                socket_.recv(timeout=10)
        assert time.monotonic() < ends_s
