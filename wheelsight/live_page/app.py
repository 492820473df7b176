"""The page's application: its files, its images, STOP, and the websocket of what goes on."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from wheelsight.live_page.access import Access, Guarded
from wheelsight.live_page.session import Session
from wheelsight.live_page.viewers import SentAwayError, Viewer, Viewers
from wheelsight.settings import LivePageSettings

_log = logging.getLogger("uvicorn.page")
_TOO_LARGE, _PULSE_S = 1009, 0.05
# To send to a page that has gone by then raises the one or the other.
_GONE = (WebSocketDisconnect, RuntimeError)
_FILES = {"/": "page.html", "/page.css": "page.css", "/page.js": "page.js"}
_KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
_PICTURES = {"plan.png": "image/png", "costmap.png": "image/png", "camera.jpg": "image/jpeg"}


class PageApp(Guarded):
    """The application, with what its server needs to know of it.

    Attributes:
        session: that pages see and ask.
        access: what is asked of each request.
        on_refusal: called with a line, from several threads, for each request that is refused.
    """

    def __init__(self, app: Starlette, session: Session, access: Access, on_refusal: Callable[[str], None]) -> None:
        super().__init__(app, access, on_refusal)
        self.session, self.access, self.on_refusal = session, access, on_refusal


def page_app(
    session: Session,
    settings: LivePageSettings,
    access: Access,
    on_refusal: Callable[[str], None] = lambda line: None,
) -> PageApp:
    """An ASGI application.

    Args:
        session: that pages see and ask.
        settings: of the page.
        access: what is asked of each request.
        on_refusal: called with a line, from several threads, for each request that is refused.
    """
    viewers = Viewers(session, settings, on_refusal)
    routes = [
        *(Route(path, _file(name)) for path, name in _FILES.items()),
        *(Route(f"/{name}", _picture(session, name)) for name in _PICTURES),
        Route("/favicon.ico", _no_icon),
        Route("/stop", _stop(session), methods=["POST"]),
        WebSocketRoute("/live", _Socket(viewers, settings, on_refusal).serve),
    ]

    @asynccontextmanager
    async def telling(app: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(one) for one in (_tell(viewers, settings), _pulse(session))]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)

    return PageApp(Starlette(routes=routes, lifespan=telling), session, access, on_refusal)


async def _tell(viewers: Viewers, settings: LivePageSettings) -> None:
    """Send the newest state to all pages, period by period."""
    loop, period_s = asyncio.get_running_loop(), 1 / settings.updates_hz
    due_s = loop.time()
    while True:
        try:
            viewers.tell_all()
        except Exception:
            _log.exception("no update was sent")
        # By the clock: what sending takes is no delay, and what is missed is not made up for.
        due_s = max(due_s + period_s, loop.time())
        await asyncio.sleep(due_s - loop.time())


async def _pulse(session: Session) -> None:
    """Show the session that this event loop goes on."""
    with session.watched("the page") as beat:
        while True:
            beat()
            await asyncio.sleep(_PULSE_S)


def _file(name: str) -> Callable[[Request], Any]:
    body = files("wheelsight.live_page").joinpath("static", name).read_bytes()

    async def answer(request: Request) -> Response:
        return Response(body, media_type=_KINDS[name.rpartition(".")[2]])

    return answer


def _stop(session: Session) -> Callable[[Request], Any]:
    async def answer(request: Request) -> Response:
        session.stop("somebody pressed STOP")
        return PlainTextResponse("stopped\n")

    return answer


async def _no_icon(request: Request) -> Response:
    return Response(status_code=204)


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
            self._viewers.hear(viewer, event.get("bytes") if text is None else text)

    async def _send(self, websocket: WebSocket, viewer: Viewer) -> None:
        await websocket.send_json({"welcome": {"you": viewer.number, "old_s": self._settings.old_s}})
        while True:
            for text in await viewer.waiting():
                try:
                    # `wait_for` of Python 3.11 may forget that it was cancelled.
                    async with asyncio.timeout(self._settings.send_s):
                        await websocket.send_text(text)
                except TimeoutError:
                    raise SentAwayError(1008, "a page that never reads") from None

    async def _send_away(self, websocket: WebSocket, sent_away: SentAwayError) -> None:
        who = websocket.client.host if websocket.client else "somebody"
        self._on_refusal(f"refused {who}: {sent_away}")
        # One that reads nothing takes no farewell, too.
        if websocket.application_state is WebSocketState.CONNECTED:
            with suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
                async with asyncio.timeout(self._settings.send_s):
                    await websocket.close(sent_away.code, str(sent_away))
