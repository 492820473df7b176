"""Strangers at the door: half requests, floods and silence take neither STOP nor the page from anybody."""

from __future__ import annotations

import errno
import os
import resource
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from live_page.room_session import GOAL, replaced, room_session
from live_page.test_server import TOKEN, asked, opened, server

from wheelsight.app.page import Access, door
from wheelsight.app.page.door import PULSE, REFUSED, STOP, Budget, Door, Stranger, Strangers
from wheelsight.app.page.server import PageServer, page_app
from wheelsight.app.page.session import GoToPose

HALF_SOCKET = (
    "GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
)
# What a stranger sends over each of many connections.
KINDS = {
    "nothing": b"",
    "half a line": b"GE",
    "half a head": b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: ",
    "half a body": b"POST /stop?x HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\nhalf",
    "half a body of no request": b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\nhalf",
    "no token": b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    "garbage": bytes(range(256)) * 4,
    "half a websocket": HALF_SOCKET.encode(),
    "a huge head": b"GET / HTTP/1.1\r\nX: " + 200_000 * b"x",
}
COUNT = 150


@contextmanager
def strangers(port: int, sent: bytes, count: int = COUNT) -> Iterator[list[socket.socket]]:
    """Connections that have sent something, and stay."""
    with ExitStack() as held:
        found = []
        for _ in range(count):
            made = held.enter_context(socket.create_connection(("127.0.0.1", port), 10))
            with suppress(OSError):
                made.sendall(sent)
            found.append(made)
        yield found


@pytest.fixture(scope="module")
def behind_a_token() -> Iterator[tuple[Any, int, list[str]]]:
    refused: list[str] = []
    with server(refused, Access(False, TOKEN)) as (served, port):
        yield served, port, refused


@pytest.mark.parametrize("kind", KINDS)
def test_stop_and_the_page_are_answered_beside_strangers(behind_a_token: tuple[Any, int, list[str]], kind: str) -> None:
    served, port, refused = behind_a_token
    served.robot.stops_s.clear()
    refused.clear()
    with strangers(port, KINDS[kind]):
        assert asked(port, "POST", "/stop", Authorization=f"Bearer {TOKEN}")[0] == 200
        served.until_stopped()
        assert asked(port, "GET", f"/?token={TOKEN}")[0] == 200
    assert len(refused) < 40, "what comes again and again is counted"


def test_stop_is_answered_beside_strangers_where_no_token_is_asked() -> None:
    with server(most_viewers=2) as (served, port):
        for sent in (KINDS["half a head"], KINDS["no token"], HALF_SOCKET.encode() + b"\r\n"):
            served.robot.stops_s.clear()
            with strangers(port, sent):
                assert asked(port, "POST", "/stop")[0] == 200
                served.until_stopped()


@pytest.mark.parametrize("sign", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.slow)])
def test_a_door_that_dies_or_hangs_stops_the_robot_and_another_is_made(sign: signal.Signals) -> None:
    with room_session(paces=False, driver_silent_s=60.0) as served:
        served.session.silent_s = 0.4
        app = page_app(served.session, replaced({}), Access(True))
        with PageServer(app, "127.0.0.1", 0, replaced({})) as running, opened(running.port) as page:
            page.send(str(GOAL).replace("'", '"'))
            served.until(lambda reported: reported["speed_m_s"] > 0.2)
            first = running.door_id
            os.kill(first, sign)
            reported = served.until(lambda reported: "door" in reported["stopped"])
            assert any("give it its task again" in one["text"] for one in reported["said"])
            served.until_stopped()
            ends_s = time.monotonic() + 30
            while running.door_id in (0, first):
                assert time.monotonic() < ends_s
                time.sleep(0.02)
            assert asked(running.port, "POST", "/stop")[0] == 200
            assert page.recv(timeout=10), "a page that was open stays so"


def test_a_page_that_hangs_stops_the_robot() -> None:
    with room_session(paces=False, driver_silent_s=60.0) as served:
        served.session.silent_s = 0.4
        app = page_app(served.session, replaced({}), Access(True))
        with PageServer(app, "127.0.0.1", 0, replaced({})) as running, opened(running.port) as page:
            page.send(str(GOAL).replace("'", '"'))
            served.until(lambda reported: reported["speed_m_s"] > 0.2)
            goes_on = threading.Event()
            assert running.loop is not None
            running.loop.call_soon_threadsafe(goes_on.wait, 30)
            served.until(lambda reported: reported["stopped"] == "the page does not answer")
            assert asked(running.port, "POST", "/stop")[0] == 200, "STOP takes another way"
            goes_on.set()


def test_a_page_that_ends_by_an_error_stops_the_robot() -> None:
    with room_session(paces=False, driver_silent_s=60.0) as served:
        app = page_app(served.session, replaced({}), Access(True))
        with PageServer(app, "127.0.0.1", 0, replaced({})) as running:
            served.session.ask(GoToPose(type="goal", x_m=5.0, y_m=3.0))
            served.until(lambda reported: reported["speed_m_s"] > 0.2)
            assert running.loop is not None
            running.loop.call_soon_threadsafe(running.loop.stop)
            served.until(lambda reported: reported["stopped"].startswith("the page has ended (RuntimeError: "))


# ---- the door itself, in this process


class Ends:
    """A door in a thread, and what the robot's program has of it."""

    def __init__(self, access: Access, requests_a_s: float, listening: Any) -> None:
        self.control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.handed, to_hand = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.sockets = [self.control, theirs, self.handed, to_hand]
        self.control.settimeout(20)
        self.handed.settimeout(20)
        self._made = Door(listening, theirs, to_hand, access, requests_a_s)
        self.thread = threading.Thread(target=self._made.run, daemon=True)
        self.thread.start()


@contextmanager
def door_here(
    requests_a_s: float = 100.0, access: Access | None = None, wrap: Callable[[socket.socket], Any] = lambda one: one
) -> Iterator[tuple[Ends, int]]:
    with socket.create_server(("127.0.0.1", 0), backlog=256) as listening:
        ends = Ends(access or Access(True), requests_a_s, wrap(listening))
        try:
            yield ends, listening.getsockname()[1]
        finally:
            ends.control.close()
            ends.thread.join(10)
            for one in ends.sockets:
                one.close()
            assert not ends.thread.is_alive()


def call(port: int, sent: bytes) -> socket.socket:
    made = socket.create_connection(("127.0.0.1", port), 20)
    made.sendall(sent)
    return made


def test_a_whole_head_is_handed_on_with_its_connection() -> None:
    with door_here() as (ends, port), call(port, KINDS["no token"]) as client:
        head, numbers, _, _ = socket.recv_fds(ends.handed, 65_536, 1)
        assert head == KINDS["no token"]
        with socket.socket(fileno=numbers[0]) as connection:
            connection.sendall(b"here")
            assert client.recv(4) == b"here"


@pytest.mark.parametrize("drips", [False, True])
def test_a_head_has_a_deadline_however_slowly_it_comes(monkeypatch: pytest.MonkeyPatch, drips: bool) -> None:
    monkeypatch.setattr(door, "HEAD_S", 0.3)
    with door_here() as (ends, port), call(port, b"GET /") as client:
        ends_s, is_cut_off = time.monotonic() + 20, False
        client.settimeout(0.02)
        while not is_cut_off:
            assert time.monotonic() < ends_s
            try:
                client.sendall(b"x" if drips else b"")
                client.recv(10)
            except ConnectionError:
                is_cut_off = True
            except TimeoutError:
                continue
        assert ends.control.recv(1000).startswith(REFUSED)


STOPPING = b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


def test_each_press_is_confirmed_by_the_robots_program() -> None:
    with door_here() as (ends, port), call(port, STOPPING) as client:
        assert ends.control.recv(10) == STOP
        with call(port, STOPPING) as other:
            assert ends.control.recv(10) == STOP, "a press after that is passed on, too"
            ends.control.send(STOP)
            assert client.recv(1000).endswith(b"stopped\n")
            ends.control.send(STOP)
            assert b"200 OK" in other.recv(1000)


def test_stop_that_the_robots_program_never_takes_is_in_vain_after_a_second() -> None:
    with door_here() as (ends, port), call(port, STOPPING) as client:
        assert ends.control.recv(10) == STOP
        answer = client.recv(1000)
        assert b"503" in answer
        assert answer.endswith(b"use the stop button on the robot\n")


def test_stop_is_answered_before_a_program_that_lives_confirms_it() -> None:
    with door_here() as (ends, port):
        ends.control.send(PULSE)
        assert ends.control.recv(10) == PULSE
        with call(port, STOPPING) as client:
            assert ends.control.recv(10) == STOP
            answer = client.recv(1000)
            assert b"200 OK" in answer
            assert answer.endswith(b"not confirmed yet\n")


def test_presses_beyond_what_can_wait_are_answered_while_the_program_lives(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (64, 64))
    monkeypatch.setattr(door, "_CONFIRMED_S", 60.0)
    monkeypatch.setattr(door, "_LIVELY_S", 60.0)
    with ExitStack() as held:
        ends, port = held.enter_context(door_here())
        ends.control.send(PULSE)
        assert ends.control.recv(10) == PULSE
        pressed = []
        for _ in range(12):
            pressed.append(held.enter_context(call(port, STOPPING)))
            assert ends.control.recv(10) == STOP, "passed on before the next press, which has room then"
        first, *others = pressed
        assert first.recv(1000).endswith(b"not confirmed yet\n")
        for _ in range(12):
            ends.control.send(STOP)
        assert all(b"200 OK" in other.recv(1000) for other in others)


def test_it_answers_the_pulse() -> None:
    with door_here() as (ends, _):
        ends.control.send(PULSE)
        assert ends.control.recv(10) == PULSE


def test_too_many_requests_are_refused_but_stop() -> None:
    with door_here(requests_a_s=1.0) as (ends, port):
        with call(port, KINDS["no token"]):
            socket.recv_fds(ends.handed, 1000, 0)
        with call(port, KINDS["no token"]) as second:
            assert b"503" in second.recv(1000)
        with call(port, STOPPING) as client:
            while ends.control.recv(1000) != STOP:
                pass  # the line about who was refused
            ends.control.send(STOP)
            assert b"200 OK" in client.recv(1000)


class Exhausted:
    """A listening socket of a computer whose file descriptors run out now and then."""

    def __init__(self, listening: socket.socket) -> None:
        self._listening, self.failures = listening, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._listening, name)

    def accept(self) -> Any:
        if self.failures < 5:
            self.failures += 1
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return self._listening.accept()


def test_where_descriptors_run_out_newcomers_are_accepted_later() -> None:
    made: list[Exhausted] = []

    def wrap(listening: socket.socket) -> Exhausted:
        made.append(Exhausted(listening))
        return made[0]

    with door_here(wrap=wrap) as (ends, port), call(port, KINDS["no token"]):
        head, numbers, _, _ = socket.recv_fds(ends.handed, 65_536, 1)
        os.close(numbers[0])
        assert head.startswith(b"GET /")
        assert made[0].failures == 5


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_a_door_of_few_descriptors_holds_few_strangers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (64, 64))
    before = descriptors()
    with door_here() as (ends, port), strangers(port, b"GET /", 100) as held:
        with call(port, KINDS["no token"]):
            os.close(socket.recv_fds(ends.handed, 65_536, 1)[1][0])
        assert descriptors() - before - len(held) < 64


def test_the_oldest_of_the_address_with_most_goes_first() -> None:
    with ExitStack() as held:

        def one(address: str, since_s: float) -> Stranger:
            return Stranger(held.enter_context(socket.socket()), address, since_s)

        kept = Strangers(40)
        known = one("10.0.0.1", 0.0)
        kept.add(known)
        many = [one("10.0.0.2", 1.0 + number / 100) for number in range(33)]
        for stranger in many:
            kept.add(stranger)
        assert kept.too_many("10.0.0.1", 2.0) is None
        assert kept.too_many("10.0.0.2", 1.0) is None, "their heads are on the way"
        assert kept.too_many("10.0.0.2", 2.0) is many[0]
        for number in range(7):
            kept.add(one(f"10.0.1.{number}", 2.0))
        assert kept.too_many("10.0.1.6", 2.0) is many[0], "too many in all"
        assert kept.late(5.5) == [known]


def test_a_budget_fills_with_time() -> None:
    budget = Budget(10.0)
    now_s = time.monotonic()
    assert [budget.takes(now_s) for _ in range(11)] == 10 * [True] + [False]
    assert budget.takes(now_s + 0.15)
    assert not budget.takes(now_s + 0.15)
