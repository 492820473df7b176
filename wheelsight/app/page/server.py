"""PageServer: serves the page by uvicorn, in its own thread, to connections that its door accepts. PageApp answers
requests; Viewers knows who drives.
"""

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
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from wheelsight.app.page.access import Access, Guarded
from wheelsight.app.page.door import MOST_HEAD_BYTES, PULSE, REFUSED, STOP
from wheelsight.app.page.session import (
    Alive,
    DriveByHand,
    Leave,
    Message,
    Session,
    ShowCostmap,
    Steer,
    Take,
    parsed,
    says_stop,
)
from wheelsight.core.errors import ArgumentError, ConfigError
from wheelsight.core.messages import VelocityCommand
from wheelsight.core.settings import LivePageSettings
from wheelsight_ros2.inputs import Stick

# A thread keeps Python for this long while others wait; Python's 5 ms delay STOP by 50 ms, as it passes from thread to
# thread: python -m benchmarks.live_page.
_SWITCH_S = 0.001
_MOST_CONNECTIONS = 64  # with those that fetch images: a browser opens six
_MOST_BYTES = 2048  # of a message from a page; the longest that it sends has 200
_MESSAGES_A_S = 20.0  # from one page, after a burst of twice as many; it sends one twice a second, and clicks
_MOST_BAD = 10  # messages that make no sense before a page is sent away
_SEND_S = 2.0  # a page that takes nothing for so long, with its buffer full, is sent away
_STARTS_S, _ENDS_S = 10.0, 5.0
# The kernel queues this number until the door accepts them; a full queue drops a newcomer's first packet, which comes
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
    """Serves the page from a thread. Use it in a `with` block; within, the program's threads switch more often.

    Args:
        app: the application.
        host, port: address; port 0 is any free one.
        settings: of the page.

    Attributes:
        port: the port in use.
        loop: its event loop; None before the start.

    Raises:
        ConfigError: the address cannot be used.
    """

    def __init__(self, app: PageApp, host: str, port: int, settings: LivePageSettings) -> None:
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
        self._app, self._socket = app, made
        self.port = int(self._socket.getsockname()[1])
        self._config = uvicorn.Config(
            app,
            loop="asyncio",
            http="h11",
            ws="websockets-sansio",
            # What is somewhat too large is refused in words; what is far too large is not even read.
            ws_max_size=4 * _MOST_BYTES,
            # Texts are short; to pack them takes longer than to send them.
            ws_per_message_deflate=False,
            limit_concurrency=_MOST_CONNECTIONS,
            h11_max_incomplete_event_size=2 * MOST_HEAD_BYTES,
            timeout_graceful_shutdown=1,
            server_header=False,
            access_log=False,
            log_config=None,
        )
        self._requests_a_s = settings.most_viewers * (_IMAGES * settings.images_hz + _FILES_A_S)
        self._server = uvicorn.Server(self._config)
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
        sys.setswitchinterval(_SWITCH_S)
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
        """The system's number of its thread."""
        return self._thread.native_id or 0

    @property
    def door_id(self) -> int:
        """Process number of its door; 0 without one."""
        return 0 if self._door is None else self._door.process.pid

    def _run(self) -> None:
        problem = ""
        try:
            asyncio.run(self._serve())
        except (Exception, SystemExit) as error:
            logging.getLogger("uvicorn.page").error("the page has ended", exc_info=error)
            problem = f" ({type(error).__name__}: {error})".partition("\n")[0]
        if not self._is_over.is_set():
            self._app.session.part_fails(f"the page has ended{problem}, and comes with another wheelsight serve")

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
        """Serve a connection from which the door has read `head`."""
        assert self.loop is not None
        connection.setblocking(False)
        state = self._server.server_state
        inner = self._config.http_protocol_class(  # type: ignore[call-arg]
            config=self._config, server_state=state, app_state=self._server.lifespan.state
        )
        try:
            transport, _ = await self.loop.connect_accepted_socket(lambda: _HandedOver(inner, head), connection)
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
        """Keep a door running: start it, take STOP and its reports, and replace it if it does not answer."""
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
        """Attend the door until the end or its failure; returns the failure."""
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
    """A running door and its sockets.

    Attributes:
        control, handed: this end of the sockets; see `door`.
        began_s: by `time.monotonic`.
        has_answered: whether it ever has.
    """

    def __init__(self, listening: socket.socket, app: PageApp, requests_a_s: float) -> None:
        self.began_s, self.has_answered = time.monotonic(), False
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2)]
        (self.control, control), (self.handed, handed) = pairs
        numbers = listening.fileno(), control.fileno(), handed.fileno()
        try:
            # Not of this program's group: Ctrl-C and Ctrl-Z are for the robot's program, which ends it.
            # The door's command. `-m` would import from the working folder, so it is not used.
            root = str(Path(__file__).resolve().parents[3])
            code = f"import sys; sys.path.append({root!r}); from wheelsight.app.page.door import serve; serve{numbers}"
            command = [sys.executable, "-P", "-c", code]
            self.process = subprocess.Popen(command, pass_fds=numbers, stdin=subprocess.DEVNULL, start_new_session=True)
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
        """Send a packet. A lost packet shows by its missing answer."""
        with suppress(OSError):
            self.control.send(message)

    def said(self) -> bytes:
        """The door's next packet; b"" at its end."""
        try:
            return self.control.recv(65_536)
        except OSError:
            return b""

    def close(self) -> None:
        """End the door."""
        self.process.kill()
        self.process.wait()
        self.control.close()
        # The page's loop may still be reading it: it ends there, and is closed with its last reference.
        with suppress(OSError):
            self.handed.shutdown(socket.SHUT_RDWR)


class _HandedOver(asyncio.Protocol):
    """A protocol for connections whose first bytes the door has read."""

    def __init__(self, inner: asyncio.Protocol, head: bytes) -> None:
        self._inner, self._head = inner, head

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """As asyncio has it."""
        assert isinstance(transport, asyncio.Transport)
        self._inner.connection_made(transport)
        transport.set_protocol(self._inner)
        self._inner.data_received(self._head)


class _Counted(logging.Handler):
    """Passes the log of uvicorn and asyncio line by line to `on_line`; a traceback with the first of its kind."""

    def __init__(self, on_line: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self._on_line, self._traced = on_line, set[str]()

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
        self._on_line(f"page: {line}")


_log = logging.getLogger("uvicorn.page")
_TOO_LARGE, _APP_PULSE_S = 1009, 0.05
# To send to a page that has gone by then raises the one or the other.
_GONE = (WebSocketDisconnect, RuntimeError)
_FILES = {"/": "page.html", "/page.css": "page.css", "/page.js": "page.js"}
_KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
_PICTURES = {"plan.png": "image/png", "costmap.png": "image/png", "camera.jpg": "image/jpeg"}


class PageApp(Guarded):
    """The application, with what its server needs of it.

    Attributes:
        session: of the robot.
        access: rules for requests.
        on_refusal: called from several threads with one line about each refused request.
    """

    def __init__(self, app: Starlette, session: Session, access: Access, on_refusal: Callable[[str], None]) -> None:
        super().__init__(app, access, on_refusal)
        self.session, self.access, self.on_refusal = session, access, on_refusal


def page_app(
    session: Session, settings: LivePageSettings, access: Access, on_refusal: Callable[[str], None] = lambda line: None
) -> PageApp:
    """An ASGI application.

    Args:
        session: of the robot.
        settings: of the page.
        access: rules for requests.
        on_refusal: called from several threads with one line about each refused request.
    """
    viewers = Viewers(session, settings, on_refusal)

    async def no_icon(request: Request) -> Response:
        return Response(status_code=204)

    async def stop(request: Request) -> Response:
        session.stop("somebody pressed STOP")
        return PlainTextResponse("stopped\n")

    routes = [
        *(Route(path, _file(name)) for path, name in _FILES.items()),
        *(Route(f"/{name}", _picture(session, name)) for name in _PICTURES),
        Route("/favicon.ico", no_icon),
        Route("/stop", stop, methods=["POST"]),
        WebSocketRoute("/live", _Socket(viewers, settings, on_refusal).serve),
    ]

    @asynccontextmanager
    async def updating(app: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(one) for one in (_send_updates(viewers, settings), _pulse(session))]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)

    return PageApp(Starlette(routes=routes, lifespan=updating), session, access, on_refusal)


async def _send_updates(viewers: Viewers, settings: LivePageSettings) -> None:
    """Send the newest state to all pages, period by period."""
    loop, period_s = asyncio.get_running_loop(), 1 / settings.updates_hz
    due_s = loop.time()
    while True:
        try:
            viewers.send_all()
        except Exception:
            _log.exception("no update was sent")
        # By the clock: what sending takes is no delay, and what is missed is not made up for.
        due_s = max(due_s + period_s, loop.time())
        await asyncio.sleep(due_s - loop.time())


async def _pulse(session: Session) -> None:
    """Report to the session that this event loop runs."""
    with session.watched("the page") as beat:
        while True:
            beat()
            await asyncio.sleep(_APP_PULSE_S)


def _file(name: str) -> Callable[[Request], Any]:
    body = files("wheelsight.app.page").joinpath("static", name).read_bytes()

    async def answer(request: Request) -> Response:
        return Response(body, media_type=_KINDS[name.rpartition(".")[2]])

    return answer


def _picture(session: Session, name: str) -> Callable[[Request], Any]:
    async def answer(request: Request) -> Response:
        picture = session.latest.pictures.get(name.partition(".")[0])
        if picture is None:
            return PlainTextResponse("there is none yet\n", 404)
        return Response(picture.body, media_type=_PICTURES[name])

    return answer


class _Socket:
    """The websocket of a page."""

    def __init__(self, viewers: Viewers, settings: LivePageSettings, on_refusal: Callable[[str], None]) -> None:
        self._viewers, self._settings, self._on_refusal = viewers, settings, on_refusal

    async def serve(self, websocket: WebSocket) -> None:
        await websocket.accept()
        try:
            viewer = self._viewers.join()
        except SentAwayError as sent_away:
            await self._send_away(websocket, sent_away)
            return
        tasks = [asyncio.create_task(way(websocket, viewer)) for way in (self._send, self._receive)]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._viewers.leave(viewer)
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
        raised = [error for task in tasks if not task.cancelled() and (error := task.exception()) is not None]
        for error in raised:
            if isinstance(error, SentAwayError):
                await self._send_away(websocket, error)
            elif not isinstance(error, _GONE):
                raise error

    async def _receive(self, websocket: WebSocket, viewer: Viewer) -> None:
        while True:
            event = await websocket.receive()
            if event["type"] == "websocket.disconnect":
                if event.get("code") == _TOO_LARGE:
                    self._on_refusal(f"refused page {viewer.number}: a message that is far too large")
                return
            text = event.get("text")
            self._viewers.receive(viewer, event.get("bytes") if text is None else text)

    async def _send(self, websocket: WebSocket, viewer: Viewer) -> None:
        await websocket.send_json({"welcome": {"you": viewer.number, "old_s": self._settings.old_s}})
        while True:
            for text in await viewer.waiting():
                try:
                    # `wait_for` of Python 3.11 may forget that it was cancelled.
                    async with asyncio.timeout(_SEND_S):
                        await websocket.send_text(text)
                except TimeoutError:
                    raise SentAwayError(1008, "a page that never reads") from None

    async def _send_away(self, websocket: WebSocket, sent_away: SentAwayError) -> None:
        who = websocket.client.host if websocket.client else "somebody"
        self._on_refusal(f"refused {who}: {sent_away}")
        # One that reads nothing takes no farewell, too.
        if websocket.application_state is WebSocketState.CONNECTED:
            with suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
                async with asyncio.timeout(_SEND_S):
                    await websocket.close(sent_away.code, str(sent_away))


# How many refusals wait for a page that reads slowly.
_REFUSALS = 4
GONE = "the page of the driver is gone"


class SentAwayError(Exception):
    """A page that must disconnect."""

    def __init__(self, code: int, why: str) -> None:
        super().__init__(why)
        self.code = code


class Viewer:
    """One connected page: what to send, where the newest state replaces older ones, and what it sent.

    Args:
        number: its identifier.
        now_s: the clock.
    """

    def __init__(self, number: int, now_s: Callable[[], float]) -> None:
        self.number, self._now_s = number, now_s
        self.heard_s = self._filled_s = now_s()
        self.shows_costmap = False
        self._left, self._bad = 2 * _MESSAGES_A_S, 0
        self._newest: str | None = None
        self._refusals: deque[str] = deque(maxlen=_REFUSALS)
        self._wake = asyncio.Event()

    def send(self, text: str) -> None:
        """Queue a state, which replaces one that is not sent yet."""
        self._newest = text
        self._wake.set()

    def refuse(self, text: str) -> None:
        """Queue a line with the reason of a refusal."""
        self._refusals.append(text)
        self._wake.set()

    async def waiting(self) -> list[str]:
        """Wait for the next JSON text to send."""
        await self._wake.wait()
        self._wake.clear()
        found = [json.dumps({"refused": text}) for text in self._refusals]
        self._refusals.clear()
        newest, self._newest = self._newest, None
        return found if newest is None else [*found, newest]

    def count_message(self) -> None:
        """Count a message. Raises SentAwayError above the rate limit."""
        now_s = self._now_s()
        self._left = min(self._left + (now_s - self._filled_s) * _MESSAGES_A_S, 2 * _MESSAGES_A_S) - 1
        self._filled_s = self.heard_s = now_s
        if self._left < 0:
            raise SentAwayError(1008, "too many messages")

    def count_bad(self) -> None:
        """Count an invalid message. Raises SentAwayError above the rate limit."""
        self._bad += 1
        if self._bad >= _MOST_BAD:
            raise SentAwayError(1008, "too many messages that make no sense")


class Viewers:
    """All connected pages, in one event loop.

    Args:
        session: of the robot.
        settings: of the page.
        on_refusal: called with one line about each refused client and the reason.
        now_s: the clock.
    """

    def __init__(
        self,
        session: Session,
        settings: LivePageSettings,
        on_refusal: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._session, self._settings, self._on_refusal, self._now_s = session, settings, on_refusal, now_s
        self._viewers: dict[int, Viewer] = {}
        self._numbers = count(1)
        self._driver: Viewer | None = None
        self._stick = Stick(now_s)

    def __len__(self) -> int:
        return len(self._viewers)

    @property
    def driver(self) -> int | None:
        """Number of the page that drives."""
        return None if self._driver is None else self._driver.number

    def join(self) -> Viewer:
        """Add a page. Raises SentAwayError if there are too many."""
        if len(self._viewers) >= self._settings.most_viewers:
            raise SentAwayError(1013, f"too many pages are open: {self._settings.most_viewers}")
        viewer = Viewer(next(self._numbers), self._now_s)
        self._viewers[viewer.number] = viewer
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """Remove a page; a robot that it drives stops."""
        self._viewers.pop(viewer.number, None)
        self._look_for_costmap()
        if viewer is self._driver:
            self._lose_driver()

    def receive(self, viewer: Viewer, message: str | bytes | None) -> None:
        """Execute a page's message. Raises SentAwayError if the page must disconnect."""
        if isinstance(message, str) and len(message) <= _MOST_BYTES and says_stop(message):
            # Before all else, and counted after: a person in need presses often.
            self._session.stop("somebody pressed STOP")
            viewer.count_message()
            return
        viewer.count_message()
        if not isinstance(message, str):
            raise SentAwayError(1003, "a message that is no text")
        if len(message.encode("utf-8", "replace")) > _MOST_BYTES:
            raise SentAwayError(1009, f"a message of more than {_MOST_BYTES} bytes")
        try:
            asked = parsed(message)
        except ArgumentError as error:
            viewer.refuse(str(error))
            self._on_refusal(f"refused page {viewer.number}: {error}")
            viewer.count_bad()
            return
        self._do(viewer, asked)

    def send_all(self) -> None:
        """Send the newest state to every page, and check that the driver is connected."""
        driver = self._driver
        if driver is not None and self._now_s() - driver.heard_s > self._settings.driver_silent_s:
            self._lose_driver()
        if not self._viewers:
            return
        snapshot = self._session.latest
        age_s = time.monotonic() - snapshot.made_s
        about = f'"age_s":{age_s:.2f},"driver":{self.driver or "null"},"viewers":{len(self)}'
        text = f'{{{about},"robot":{snapshot.text}}}'
        for viewer in self._viewers.values():
            viewer.send(text)

    def _do(self, viewer: Viewer, asked: Message) -> None:
        if isinstance(asked, Alive):
            return
        if isinstance(asked, ShowCostmap):
            viewer.shows_costmap = asked.shown
            self._look_for_costmap()
        elif isinstance(asked, Take):
            self._driver = viewer
        elif isinstance(asked, Leave):
            if viewer is self._driver:
                self._lose_driver()
        elif self._driver not in (None, viewer):
            viewer.refuse("another page drives: take control first")
        else:
            # The first page with a task drives.
            self._driver = viewer
            refused = self._steer(asked) if isinstance(asked, Steer) else self._session.ask(asked)
            if refused:
                viewer.refuse(refused)

    def _steer(self, asked: Steer) -> str:
        """Take a position of the stick. Returns why it is refused, else ""."""
        if self._stick.push(VelocityCommand(asked.forward, asked.left)):
            return self._session.ask(DriveByHand(self._stick.commands, is_stick=True))
        return ""

    def _lose_driver(self) -> None:
        self._driver = None
        if self._settings.stops_without_driver and self._session.latest.is_driving:
            self._session.stop(GONE)

    def _look_for_costmap(self) -> None:
        self._session.wants_costmap = any(viewer.shows_costmap for viewer in self._viewers.values())
