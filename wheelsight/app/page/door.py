"""The door of the live page: a process that accepts connections, turns strangers away, and takes STOP.

A connection is a stranger's until its request's head is whole and `Access` lets it pass. Only then its socket goes on
to the robot's program. A process of its own shares neither Python's lock nor file descriptors with that program:
strangers delay no control period, and STOP waits for none of them.

A newcomer is never refused for want of room: the oldest stranger goes instead. All that wait to be accepted are read
first, and STOP among them is passed on before anything else is done, even before room is made. Of the rest, the newest
is judged first. What cannot be judged in time is cut off unanswered.

It speaks by two Unix sockets of packets: `control` carries STOP, the pulse and what was refused; `handed` carries
connections. It ends where `control` does, and imports no part of wheelsight but `access`.
"""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import selectors
import signal
import socket
import struct
import time
from collections import deque
from contextlib import suppress
from http import HTTPStatus
from typing import Any

from wheelsight.app.page.access import HEADERS, Access

PULSE, STOP = b"P", b"S"
REFUSED = b"R"
# Of a whole head, however slowly its bytes drip. A browser sends it with the connection, or a moment after.
HEAD_S = 5.0
MOST_HEAD_BYTES = 16_384
# A browser opens two or three connections ahead of its requests; several may come from one address behind a router.
_MOST_OF_ADDRESS = 32
# Younger strangers stay beyond that: their heads are on the way, unless all strangers together are too many.
_YOUNG_S = 0.25
_MOST_STRANGERS = 2048
# Connections accepted at a time: one of those that wait may ask for STOP. To accept one takes 20 us, and to make room
# for it as long again, which is done for `_KEPT` of them a turn. Fewer are judged while more wait to be accepted.
_ACCEPTED, _BATCH, _KEPT, _JUDGED, _JUDGED_IN_A_CROWD = 1024, 128, 64, 32, 4
# STOP waits so long for the robot's program to confirm it; then it is answered without, where that program has given a
# sign of life lately, and not before it has confirmed where not. After a second it is answered that it is in vain.
_CONFIRMED_S, _LIVELY_S, _STOP_S = 0.01, 0.2, 1.0
# Presses within so long are passed on together.
_STOP_TICK_S = 0.005
_FLUSH_S, _MOST_LINES, _TICK_S, _IDLE_S = 0.5, 20, 0.02, 0.5
_SPARE_DESCRIPTORS = 24
_EXHAUSTED = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
_END = b"\r\n\r\n"
_REQUEST = re.compile(rb"([A-Z]{1,20}) (\S+) HTTP/1\.[01]")
_BEGINNING = re.compile(rb"[A-Z]{1,20}( |$)")
_STOPPING = re.compile(rb"POST /stop[? ]")
# A head without any of these words holds no token.
_CREDENTIALS = b"token=", b"\nauthorization:", b"\ncookie:"
_SILENT = "the robot's program does not answer: use the stop button on the robot"


class Stranger:
    """A connection whose request is not known yet."""

    __slots__ = ("address", "head", "since_s", "socket")

    def __init__(self, accepted: socket.socket, address: str, since_s: float) -> None:
        self.socket, self.address, self.since_s = accepted, address, since_s
        self.head = b""


class Budget:
    """A rate limit: `rate` a second, after a burst of the same number."""

    def __init__(self, a_second: float) -> None:
        self._a_second = self._left = a_second
        self._filled_s = time.monotonic()

    def takes(self, now_s: float) -> bool:
        """Whether there is one left, and takes it."""
        self._left = min(self._left + (now_s - self._filled_s) * self._a_second, self._a_second)
        self._filled_s = now_s
        if self._left < 1:
            return False
        self._left -= 1
        return True


class Strangers:
    """Those that are there, the oldest first, of all and of each address."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._all: dict[int, Stranger] = {}
        self._of: dict[str, dict[int, Stranger]] = {}

    def __len__(self) -> int:
        return len(self._all)

    def add(self, stranger: Stranger) -> None:
        """One more, the newest."""
        number = stranger.socket.fileno()
        self._all[number] = stranger
        self._of.setdefault(stranger.address, {})[number] = stranger

    def drop(self, stranger: Stranger) -> None:
        """It is none any more."""
        number = stranger.socket.fileno()
        if self._all.pop(number, None) is not None:
            same = self._of[stranger.address]
            del same[number]
            if not same:
                del self._of[stranger.address]

    def late(self, now_s: float) -> list[Stranger]:
        """Those whose time is over."""
        found = []
        for stranger in self._all.values():
            if now_s - stranger.since_s < HEAD_S:
                break
            found.append(stranger)
        return found

    def too_many(self, address: str, now_s: float) -> Stranger | None:
        """Which one has to go, now that another has come from an address; None while there is room."""
        same = self._of.get(address, {})
        oldest = next(iter(same.values()), None)
        if oldest is not None and len(same) > _MOST_OF_ADDRESS and now_s - oldest.since_s > _YOUNG_S:
            return oldest
        return self.oldest() if len(self._all) > self._most else None

    def oldest(self) -> Stranger | None:
        """Of the address that most have come from; None where there is none."""
        if not self._all:
            return None
        return next(iter(max(self._of.values(), key=len).values()))


class Door:
    """See the module.

    Args:
        listening: accepts connections.
        control, handed: to the robot's program.
        access: what is asked of each request.
        requests_a_s: passed on a second, at most.
    """

    def __init__(
        self,
        listening: socket.socket,
        control: socket.socket,
        handed: socket.socket,
        access: Access,
        requests_a_s: float,
    ) -> None:
        self._listening, self._control, self._handed, self._access = listening, control, handed, access
        self._selector = selectors.DefaultSelector()
        for one in (listening, control, handed):
            one.setblocking(False)
        self._selector.register(listening, selectors.EVENT_READ)
        self._selector.register(control, selectors.EVENT_READ)
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        left = max(32, limit - _SPARE_DESCRIPTORS)
        self._accepted, self._batch = min(_ACCEPTED, left // 4), min(_BATCH, left // 8)
        self._strangers = Strangers(min(_MOST_STRANGERS, left - self._accepted - 4 * self._batch))
        # Accepted, and not in the selector yet.
        self._unkept = deque[Stranger]()
        # Whose heads are whole, and not judged yet: those that ask for STOP, and others.
        self._urgent, self._whole = list[Stranger](), list[Stranger]()
        self._budget = Budget(requests_a_s)
        # Presses of STOP: not passed on yet, and passed on together, the packet's number and time with them.
        self._pressing = list[Stranger]()
        self._asked = deque[tuple[int, float, list[Stranger]]]()
        self._stops_sent = self._stops_confirmed = 0
        self._sent_s = self._flushed_s = self._lively_s = 0.0
        self._refused: dict[str, int] = {}
        self._reserve: int | None = os.open(os.devnull, os.O_RDONLY)
        self._is_over = False

    def run(self) -> None:
        """Until the robot's program ends."""
        while not self._is_over:
            self._turn()

    def _turn(self) -> None:
        waits = self._unkept or self._whole
        is_busy = self._refused or len(self._strangers)
        tick_s = _STOP_TICK_S if self._asked or self._pressing else _TICK_S if is_busy else _IDLE_S
        ready = self._selector.select(0 if waits else tick_s)
        now_s = time.monotonic()
        comes, readable = False, []
        for key, _ in ready:
            if key.fileobj is self._control:
                self._obey(now_s)
            elif key.fileobj is self._listening:
                comes = True
            else:
                readable.append(key.data)
        is_crowded, newcomers = self._accept(now_s) if comes else (False, [])
        self._unkept.extend(stranger for stranger in newcomers if self._read(stranger))
        for stranger in readable:
            self._read(stranger)
        while self._urgent:
            self._judge(self._urgent.pop(), now_s)
        self._pass_stop_on(now_s)
        for _ in range(min(_KEPT, len(self._unkept))):
            self._keep(self._unkept.popleft(), now_s)
        while len(self._whole) > 2 * self._batch:
            self._crowd_out(self._whole.pop(0))
        for _ in range(min(_JUDGED_IN_A_CROWD if is_crowded else _JUDGED, len(self._whole))):
            self._judge(self._whole.pop(), now_s)
        self._pass_stop_on(now_s)
        self._look_after(now_s)

    def _pass_stop_on(self, now_s: float) -> None:
        """Send one STOP for all connections that press it now."""
        if not self._pressing or now_s - self._sent_s < _STOP_TICK_S:
            return
        pressing, self._pressing, self._sent_s = self._pressing, [], now_s
        try:
            self._control.send(STOP)
        except OSError:
            # Its buffer is full: the program has not read for a long time.
            self._answer_all(pressing, 503, _SILENT)
        else:
            self._stops_sent += 1
            self._asked.append((self._stops_sent, now_s, pressing))

    def _look_after(self, now_s: float) -> None:
        for stranger in self._strangers.late(now_s):
            self._count(f"refused {stranger.address}: no whole request after {HEAD_S:.0f} s")
            self._leave(stranger)
        while self._asked:
            _, asked_s, those = self._asked[0]
            are_many = sum(len(those) for *_, those in self._asked) > 2 * self._batch
            if (are_many or now_s - asked_s > _CONFIRMED_S) and asked_s - self._lively_s < _LIVELY_S:
                self._answer_all(those, 200, "STOP is on its way to the robot, and not confirmed yet")
            elif are_many or now_s - asked_s > _STOP_S:
                self._answer_all(those, 503, _SILENT)
            else:
                break
            self._asked.popleft()
        if self._refused and now_s - self._flushed_s > _FLUSH_S:
            self._flushed_s = now_s
            with suppress(OSError):
                self._control.send(REFUSED + json.dumps(list(self._refused.items())).encode())
                self._refused.clear()

    def _obey(self, now_s: float) -> None:
        """What the robot's program says."""
        while True:
            try:
                message = self._control.recv(64)
            except BlockingIOError:
                return
            except OSError:
                message = b""
            if not message:
                self._is_over = True
                return
            self._lively_s = now_s
            if message == PULSE:
                with suppress(OSError):
                    self._control.send(PULSE)
            elif message == STOP:
                self._stops_confirmed += 1
                while self._asked and self._asked[0][0] <= self._stops_confirmed:
                    self._answer_all(self._asked.popleft()[2], 200, "stopped")

    def _accept(self, now_s: float) -> tuple[bool, list[Stranger]]:
        """Accept newcomers; returns whether more may wait, and the newcomers."""
        newcomers = list[Stranger]()
        for _ in range(self._accepted - len(self._unkept)):
            try:
                accepted, address = self._listening.accept()
            except BlockingIOError:
                return False, newcomers
            except OSError as error:
                if error.errno in _EXHAUSTED:
                    return False, [*newcomers, *self._make_room(now_s)]
                continue
            accepted.setblocking(False)
            newcomers.append(Stranger(accepted, _host(address), now_s))
        return True, newcomers

    def _make_room(self, now_s: float) -> list[Stranger]:
        """Close the oldest strangers when file descriptors run out, and accept one newcomer by the spare descriptor."""
        self._count("file descriptors ran out: the oldest strangers are cut off")
        for _ in range(self._batch):
            oldest = self._strangers.oldest() or (self._whole.pop(0) if self._whole else None)
            if oldest is None:
                break
            self._leave(oldest)
        newcomers = list[Stranger]()
        if self._reserve is not None:
            os.close(self._reserve)
            self._reserve = None
            with suppress(OSError):
                accepted, address = self._listening.accept()
                accepted.setblocking(False)
                newcomers.append(Stranger(accepted, _host(address), now_s))
        with suppress(OSError):
            self._reserve = os.open(os.devnull, os.O_RDONLY)
        # Where other programs hold them, waiting is all there is.
        time.sleep(_TICK_S if self._reserve is None else 0)
        return newcomers

    def _crowd_out(self, stranger: Stranger) -> None:
        self._count(f"refused {stranger.address}: too many connections at once")
        self._leave(stranger)

    def _read(self, stranger: Stranger) -> bool:
        """Read what a stranger has sent; returns whether more must come before it can be judged."""
        # One that was closed meanwhile, to make room, has no number any more.
        if stranger.socket.fileno() < 0:
            return False
        try:
            came = stranger.socket.recv(MOST_HEAD_BYTES + 1)
        except BlockingIOError:
            return True
        except OSError:
            came = b""
        if not came:
            self._leave(stranger)
            return False
        stranger.head = (stranger.head + came).lstrip(b"\r\n")
        if _END in stranger.head or len(stranger.head) > MOST_HEAD_BYTES:
            self._forget(stranger)
            # The head of STOP is judged at once, unless it holds no token where one is asked for.
            is_urgent = _STOPPING.match(stranger.head) and self._may_hold_token(stranger)
            (self._urgent if is_urgent else self._whole).append(stranger)
            return False
        if stranger.head and not _BEGINNING.match(stranger.head[:21]):
            self._refuse(stranger, 400, "no HTTP")
            return False
        return True

    def _keep(self, stranger: Stranger, now_s: float) -> None:
        """Wait for more of it; where there are too many, another goes."""
        number = stranger.socket.fileno()
        if number < 0 or number in self._selector.get_map():
            return
        try:
            self._selector.register(stranger.socket, selectors.EVENT_READ, stranger)
        except OSError:
            stranger.socket.close()
            return
        self._strangers.add(stranger)
        while (gone := self._strangers.too_many(stranger.address, now_s)) is not None:
            self._crowd_out(gone)

    def _judge(self, stranger: Stranger, now_s: float) -> None:
        """Take STOP, pass a request on, or refuse it."""
        # Where many wait, those that certainly get no answer but a refusal are cut off, which costs less.
        if len(self._whole) > self._batch and not self._may_hold_token(stranger):
            self._crowd_out(stranger)
            return
        end = stranger.head.find(_END)
        if not 0 <= end <= MOST_HEAD_BYTES - len(_END):
            self._refuse(stranger, 400, f"a request's head of more than {MOST_HEAD_BYTES} bytes")
            return
        scope = _scope_of(stranger.head[:end])
        if scope is None:
            self._refuse(stranger, 400, "no HTTP")
            return
        refusal = self._access.refusal(scope)
        if refusal is not None:
            status, why = refusal
            self._refuse(stranger, 403 if scope["is_socket"] else status, why)
        elif scope["method"] == b"POST" and scope["path"] == b"/stop":
            self._pressing.append(stranger)
        elif not self._budget.takes(now_s):
            self._refuse(stranger, 503, "too many requests: try again")
        else:
            try:
                socket.send_fds(self._handed, [stranger.head], [stranger.socket.fileno()])
            except OSError:
                self._answer(stranger, 503, "the robot's program does not answer")
            else:
                stranger.socket.close()

    def _may_hold_token(self, stranger: Stranger) -> bool:
        """Whether a head may hold the token, as far as a quick look shows; true where none is asked for."""
        head = stranger.head.lower()
        return not self._access.token or any(word in head for word in _CREDENTIALS)

    def _answer_all(self, those: list[Stranger], status: int, text: str) -> None:
        for stranger in those:
            self._answer(stranger, status, text)

    def _refuse(self, stranger: Stranger, status: int, why: str) -> None:
        self._count(f"refused {stranger.address}: {why}")
        self._answer(stranger, status, why)

    def _answer(self, stranger: Stranger, status: int, text: str) -> None:
        """Answer, and close."""
        body = f"{text}\n".encode()
        lines = [f"HTTP/1.1 {status} {HTTPStatus(status).phrase}".encode()]
        lines += [name + b": " + value for name, value in (*_PLAIN, *HEADERS)]
        lines += [b"content-length: %d" % len(body), b"", body]
        self._forget(stranger)
        with suppress(OSError):
            stranger.socket.send(b"\r\n".join(lines))
            stranger.socket.shutdown(socket.SHUT_WR)
            # What is not read makes the system cut the connection off, and the answer with it.
            stranger.socket.recv(65_536)
        stranger.socket.close()

    def _leave(self, stranger: Stranger) -> None:
        """Close it without an answer, and without a remainder in the system."""
        self._forget(stranger)
        with suppress(OSError):
            stranger.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        stranger.socket.close()

    def _forget(self, stranger: Stranger) -> None:
        if stranger.socket.fileno() in self._selector.get_map():
            self._selector.unregister(stranger.socket)
        self._strangers.drop(stranger)

    def _count(self, line: str) -> None:
        if line not in self._refused and len(self._refused) >= _MOST_LINES:
            line = "refused others"
        self._refused[line] = self._refused.get(line, 0) + 1


_PLAIN = ((b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close"))


def _scope_of(head: bytes) -> dict[str, Any] | None:
    """What `Access` asks for, of a head without its end; None where that is none."""
    request, *lines = head.split(b"\r\n")
    found = _REQUEST.fullmatch(request)
    if found is None:
        return None
    path, _, query = found[2].partition(b"?")
    headers = []
    for line in lines:
        name, colon, value = line.partition(b":")
        if not colon:
            return None
        headers.append((name.strip().lower(), value.strip()))
    is_socket = any(name == b"upgrade" and value.lower() == b"websocket" for name, value in headers)
    return {"method": found[1], "path": path, "query_string": query, "headers": headers, "is_socket": is_socket}


def _host(address: Any) -> str:
    """The key under which a peer is counted. For IPv6 it is the /64 network, which one client may own."""
    host = str(address[0])
    if ":" not in host or host.startswith("::ffff:"):
        return host.removeprefix("::ffff:")
    packed = socket.inet_pton(socket.AF_INET6, host.partition("%")[0])
    return socket.inet_ntop(socket.AF_INET6, packed[:8] + bytes(8)) if any(packed[:8]) else host


def serve(listening: int, control: int, handed: int) -> None:
    """Be the door, by file descriptors; what else it needs is the first packet."""
    # The robot's program ends it: it is there until that has stopped the robot.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 2 * _MOST_STRANGERS if hard == resource.RLIM_INFINITY else min(hard, 2 * _MOST_STRANGERS)
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, wanted), hard))
    sockets = [socket.socket(fileno=number) for number in (listening, control, handed)]
    sockets[1].setblocking(True)
    settings = json.loads(sockets[1].recv(4096))
    access = Access(settings["is_loopback"], settings["token"])
    sockets[1].send(PULSE)
    Door(sockets[0], sockets[1], sockets[2], access, settings["requests_a_s"]).run()
