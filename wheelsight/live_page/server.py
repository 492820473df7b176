"""PageServer: serves the page by uvicorn, in a thread of its own, to those whom its door lets in."""

from __future__ import annotations

import asyncio
import json
import logging
import math
import select
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType

import uvicorn

from wheelsight.errors import ConfigError
from wheelsight.live_page.app import PageApp
from wheelsight.live_page.door import MOST_HEAD_BYTES, PULSE, REFUSED, STOP
from wheelsight.settings import LivePageSettings

_STARTS_S, _ENDS_S = 10.0, 5.0
# The kernel keeps so many until the door accepts them; where it cannot, it drops a newcomer's first packet, which comes
# again a second later: too late for STOP.
_BACKLOG = 4096
_PULSE_S = 0.05
# A door that has died at once is not begun again at once.
_AGAIN_S = 1.0
# Of a whole exchange but a websocket's: a body that never comes, an answer that is never taken.
_EXCHANGE_S = 5.0
# A page asks for three images, each as often as is set, and now and then for the page itself.
_IMAGES, _FILES_A_S = 3, 6.0
_LOGGERS = "asyncio", "uvicorn", "websockets"
_MOST_TRACES = 20


class PageServer:
    """Use it in a `with` block; within, threads of the program take turns more often.

    Args:
        app: the application.
        host, port: where it is served; port 0 is any that is free.
        settings: of the page.

    Attributes:
        port: where it is served.
        loop: that answers; None before it is there.

    Raises:
        ConfigError: nothing can be served there.
    """

    def __init__(self, app: PageApp, host: str, port: int, settings: LivePageSettings) -> None:
        self._app, self._socket = app, _bound(host, port)
        self.port = int(self._socket.getsockname()[1])
        self._config = uvicorn.Config(
            app,
            loop="asyncio",
            http="h11",
            ws="websockets-sansio",
            # What is somewhat too large is refused in words; what is far too large is not even read.
            ws_max_size=4 * settings.most_bytes,
            # Texts are short; to pack them takes longer than to send them.
            ws_per_message_deflate=False,
            limit_concurrency=settings.most_connections,
            h11_max_incomplete_event_size=2 * MOST_HEAD_BYTES,
            timeout_graceful_shutdown=1,
            server_header=False,
            access_log=False,
            log_config=None,
        )
        self._requests_a_s = settings.most_viewers * (_IMAGES * settings.images_hz + _FILES_A_S)
        self._server, self._switch_s = uvicorn.Server(self._config), settings.switch_s
        self._switch_before_s = sys.getswitchinterval()
        self.loop: asyncio.AbstractEventLoop | None = None
        self._adopted = set[asyncio.Task[None]]()
        self._is_over = threading.Event()
        self._door: _DoorProcess | None = None
        self._doors = list[_DoorProcess]()
        self._thread = threading.Thread(target=self._run, name="wheelsight-page", daemon=True)
        self._keeper = threading.Thread(target=self._keep_door, name="wheelsight-door", daemon=True)
        self._log = _Counted(app.on_refusal)

    def __enter__(self) -> PageServer:
        sys.setswitchinterval(self._switch_s)
        for name in _LOGGERS:
            logging.getLogger(name).addHandler(self._log)
        self._thread.start()
        self._keeper.start()
        until_s = time.monotonic() + _STARTS_S
        while self.loop is None or self._door is None or not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > until_s:
                self.__exit__(None, None, None)
                raise ConfigError("the page's server did not start")
            time.sleep(0.01)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        sys.setswitchinterval(self._switch_before_s)
        self._is_over.set()
        self._server.should_exit = True
        self._keeper.join(_ENDS_S)
        self._thread.join(_ENDS_S)
        self._socket.close()
        for door in self._doors:
            door.handed.close()
        for name in _LOGGERS:
            logging.getLogger(name).removeHandler(self._log)

    @property
    def thread_id(self) -> int:
        """Of its thread, as the system counts them."""
        return self._thread.native_id or 0

    @property
    def door_id(self) -> int:
        """The process of its door; 0 while there is none."""
        return 0 if self._door is None else self._door.process.pid

    def _run(self) -> None:
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        self.loop = asyncio.get_running_loop()
        # It listens at no port: connections come by the door.
        await self._server.serve([])

    def _adopt(self, handed: socket.socket) -> None:
        """Take a connection from the door."""
        try:
            head, descriptors, _, _ = socket.recv_fds(handed, 4 * MOST_HEAD_BYTES, 1)
        except BlockingIOError:
            return
        except OSError:
            head, descriptors = b"", []
        if not head:
            assert self.loop is not None
            self.loop.remove_reader(handed)
            handed.close()
            return
        # Where this program has no descriptor left there is none: the page asks again.
        for descriptor in descriptors:
            task = asyncio.ensure_future(self._answer(socket.socket(fileno=descriptor), head))
            self._adopted.add(task)
            task.add_done_callback(self._adopted.discard)

    async def _answer(self, connection: socket.socket, head: bytes) -> None:
        """Serve a connection, of which the door has read so much."""
        assert self.loop is not None
        connection.setblocking(False)
        state = self._server.server_state
        inner = self._config.http_protocol_class(  # type: ignore[call-arg]
            config=self._config, server_state=state, app_state=self._server.lifespan.state
        )
        try:
            transport, _ = await self.loop.connect_accepted_socket(lambda: _Begun(inner, head), connection)
        except OSError:
            connection.close()
            return
        try:
            await asyncio.sleep(_EXCHANGE_S)
        finally:
            # A websocket has another protocol by then.
            if transport.get_protocol() is inner:
                transport.abort()

    def _keep_door(self) -> None:
        """Hold a door: begin it, take STOP and what it refused, and begin another where it does not answer."""
        while not self._is_over.is_set():
            try:
                self._door = door = _DoorProcess(self._socket, self._app, self._requests_a_s)
            except OSError as error:
                self._app.session.part_fails(f"the page's door does not begin: {error}")
                self._is_over.wait(_AGAIN_S)
                continue
            self._doors.append(door)
            try:
                problem = self._attend(door)
            finally:
                self._door = None
                door.close()
            if problem:
                self._app.session.part_fails(problem)
                self._is_over.wait(max(0.0, door.began_s + _AGAIN_S - time.monotonic()))

    def _attend(self, door: _DoorProcess) -> str:
        """Until the end, or until the door fails: then how."""
        session, is_adopted = self._app.session, False
        asked_s, silent_s = -math.inf, 0.0
        while not self._is_over.is_set():
            if not is_adopted and self.loop is not None and self._server.started:
                is_adopted = True
                self.loop.call_soon_threadsafe(self.loop.add_reader, door.handed, self._adopt, door.handed)
            if time.monotonic() - asked_s >= _PULSE_S:
                asked_s = time.monotonic()
                door.say(PULSE)
            if not select.select([door.control], [], [], _PULSE_S)[0]:
                # Counted, and not taken from a clock: where the whole program was suspended, the door is not to blame.
                silent_s += _PULSE_S
                # Its first answer takes as long as Python needs to begin.
                if silent_s > (session.silent_s if door.has_answered else _STARTS_S):
                    return "the page's door does not answer"
                continue
            message = door.said()
            if not message:
                return "the page's door has ended"
            silent_s, door.has_answered = 0.0, True
            if message == STOP:
                session.stop("somebody pressed STOP")
                door.say(STOP)
            elif message.startswith(REFUSED):
                for line, times in json.loads(message[len(REFUSED) :]):
                    self._app.on_refusal(line if times == 1 else f"{line} ({times} times)")
        return ""


class _DoorProcess:
    """A door that runs, and what is said to it.

    Attributes:
        control, handed: see `door`; of this end.
        began_s: by `time.monotonic`.
        has_answered: whether it has ever.
    """

    def __init__(self, listening: socket.socket, app: PageApp, requests_a_s: float) -> None:
        self.began_s, self.has_answered = time.monotonic(), False
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2)]
        (self.control, control), (self.handed, handed) = pairs
        numbers = listening.fileno(), control.fileno(), handed.fileno()
        try:
            # Not of this program's group: Ctrl-C and Ctrl-Z are for the robot's program, which ends it.
            self.process = subprocess.Popen(
                _command(numbers), pass_fds=numbers, stdin=subprocess.DEVNULL, start_new_session=True
            )
        except OSError:
            self.control.close()
            self.handed.close()
            raise
        finally:
            control.close()
            handed.close()
        self.control.setblocking(False)
        self.handed.setblocking(False)
        # By the socket: a command line is for all to see.
        access = {"is_loopback": app.access.is_loopback, "token": app.access.token}
        self.control.send(json.dumps({**access, "requests_a_s": requests_a_s}).encode())

    def say(self, message: bytes) -> None:
        """What does not get through is noticed by what it does not answer."""
        with suppress(OSError):
            self.control.send(message)

    def said(self) -> bytes:
        """Its next packet; none at its end."""
        try:
            return self.control.recv(65_536)
        except OSError:
            return b""

    def close(self) -> None:
        """End it."""
        self.process.kill()
        self.process.wait()
        self.control.close()
        # The page's loop may still be reading it: it ends there, and is closed with its last reference.
        with suppress(OSError):
            self.handed.shutdown(socket.SHUT_RDWR)


def _command(numbers: tuple[int, int, int]) -> list[str]:
    """What begins a door; by itself, since `-m` would look into the folder where somebody stands."""
    root = str(Path(__file__).resolve().parents[2])
    code = f"import sys; sys.path.append({root!r}); from wheelsight.live_page.door import serve; serve{numbers}"
    return [sys.executable, "-P", "-c", code]


class _Begun(asyncio.Protocol):
    """A protocol whose first bytes were read by the door."""

    def __init__(self, inner: asyncio.Protocol, head: bytes) -> None:
        self._inner, self._head = inner, head

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """As asyncio has it."""
        assert isinstance(transport, asyncio.Transport)
        self._inner.connection_made(transport)
        transport.set_protocol(self._inner)
        self._inner.data_received(self._head)


class _Counted(logging.Handler):
    """What uvicorn and asyncio log: each line to `tell`, which counts; a traceback with the first of its kind."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self._tell, self._traced = tell, set[str]()

    def emit(self, record: logging.LogRecord) -> None:
        """As `logging.Handler` has it."""
        line = record.getMessage().strip().partition("\n")[0]
        if record.exc_info is not None and record.exc_info[1] is not None:
            error = record.exc_info[1]
            line = f"{line}: {type(error).__name__}: {error}".partition("\n")[0]
            kind = f"{type(error)} {traceback.extract_tb(error.__traceback__)[-1:]}"
            if kind not in self._traced and len(self._traced) < _MOST_TRACES:
                self._traced.add(kind)
                line += "\n" + "".join(traceback.format_exception(error)).rstrip()
        self._tell(f"page: {line}")


def _bound(host: str, port: int) -> socket.socket:
    made: socket.socket | None = None
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = found[0]
        made = socket.socket(family, kind, protocol)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(address)
        made.listen(_BACKLOG)
    except (OSError, OverflowError) as error:
        if made is not None:
            made.close()
        fix = "another --host or --port; --port 0 takes any that is free"
        raise ConfigError(f"nothing can be served at {host}, port {port}: {error}", fix=fix) from error
    return made
