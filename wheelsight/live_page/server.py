"""PageServer: serves the page by uvicorn, in a thread of its own."""

from __future__ import annotations

import socket
import sys
import threading
import time
from types import TracebackType

import uvicorn

from wheelsight.errors import ConfigError
from wheelsight.live_page.access import App
from wheelsight.settings import LivePageSettings

_STARTS_S, _ENDS_S = 10.0, 5.0
_MOST_HEADER_BYTES = 16_384
_BACKLOG = 32


class PageServer:
    """Use it in a `with` block; within, threads of the program take turns more often.

    Args:
        app: the application.
        host, port: where it is served; port 0 is any that is free.
        settings: of the page.

    Attributes:
        port: where it is served.

    Raises:
        ConfigError: nobody can serve there.
    """

    def __init__(self, app: App, host: str, port: int, settings: LivePageSettings) -> None:
        self._socket = _bound(host, port)
        self.port = int(self._socket.getsockname()[1])
        config = uvicorn.Config(
            app,
            loop="asyncio",
            http="h11",
            ws="websockets-sansio",
            # What is somewhat too large is refused in words; what is far too large is not even read.
            ws_max_size=4 * settings.most_bytes,
            # Texts are short; to pack them takes longer than to send them.
            ws_per_message_deflate=False,
            limit_concurrency=settings.most_connections,
            h11_max_incomplete_event_size=_MOST_HEADER_BYTES,
            timeout_graceful_shutdown=1,
            server_header=False,
            access_log=False,
            log_config=None,
        )
        self._server, self._switch_s = uvicorn.Server(config), settings.switch_s
        self._switch_before_s = sys.getswitchinterval()
        self._thread = threading.Thread(target=self._run, name="wheelsight-page", daemon=True)

    def __enter__(self) -> PageServer:
        sys.setswitchinterval(self._switch_s)
        self._thread.start()
        until_s = time.monotonic() + _STARTS_S
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > until_s:
                raise ConfigError("the page's server did not start")
            time.sleep(0.01)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        sys.setswitchinterval(self._switch_before_s)
        self._server.should_exit = True
        self._thread.join(_ENDS_S)
        self._socket.close()

    @property
    def thread_id(self) -> int:
        """Of its thread, as the system counts them."""
        return self._thread.native_id or 0

    def _run(self) -> None:
        self._server.run([self._socket])


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
