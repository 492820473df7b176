"""Requests that the live page must refuse, sent as hostile clients send them; and what came of each."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

_WAIT_S = 10.0
_MOST_MESSAGES = 200


@dataclass(frozen=True, slots=True)
class BadRequest:
    """One.

    Attributes:
        name: what is bad of it.
        send: sends it to a port; what came of it.
        is_refused: whether that is a refusal.
    """

    name: str
    send: Callable[[int], str]
    is_refused: Callable[[str], bool]


def refusals(port: int, requests: tuple[BadRequest, ...]) -> list[tuple[str, str, bool]]:
    """Name, what came of it, and whether it was refused, of each."""
    found = []
    for request in requests:
        came = request.send(port)
        found.append((request.name, came, request.is_refused(came)))
    return found


def at_home() -> tuple[BadRequest, ...]:
    """Of a page for this computer alone."""
    return (
        _http("a name that was led here", "GET", "/", 403, Host="evil.example:8765"),
        _http("STOP by such a name", "POST", "/stop", 403, Host="evil.example"),
        _http("STOP of another page", "POST", "/stop", 403, Origin="http://evil.example"),
        _http("STOP of a page without an origin", "POST", "/stop", 403, Origin="null"),
        BadRequest("a websocket by such a name", _by_name, lambda came: came == "403"),
        _opened("a websocket of another page", 403, Origin="http://evil.example"),
        _http("a path that leads out", "GET", "/../../pyproject.toml", 404),
        _http("a page written to", "PUT", "/", 405),
        _http("STOP by a link", "GET", "/stop", 405),
        _http("headers of 1 MB", "GET", "/", 400, Filler=1_000_000 * "x"),
        BadRequest("no HTTP", _no_http, lambda came: came in ("400", "closed")),
        _message("garbage", "garbage"),
        _message("no object", "[]"),
        _message("an unknown type", '{"type": "fly"}'),
        _message("texts for numbers", '{"type": "goal", "x_m": "1", "y_m": "2"}'),
        _message("no number", '{"type": "goal", "x_m": NaN, "y_m": 2}'),
        _message("a goal beyond all maps", '{"type": "goal", "x_m": 1e9, "y_m": 2}'),
        _message("a field too many", '{"type": "alive", "admin": true}'),
        _message("a name of 61 letters", json.dumps({"type": "name", "name": 61 * "n"})),
        _message("nested a thousand times", 1000 * "["),
        _closed("bytes", 1003, [b"\x00\xff"]),
        _closed("a message of 3 kB", 1009, [3000 * "x"]),
        _closed("a message of 1 MB", 1009, [1_000_000 * "x"]),
        _closed("a flood", 1008, 200 * ['{"type": "alive"}']),
        _closed("senseless again and again", 1008, 12 * ["?"]),
    )


def abroad(path: str = "/") -> tuple[BadRequest, ...]:
    """Of a page that needs a token."""
    return (
        _http("no token", "GET", path, 401),
        _http("a wrong token", "GET", f"{path}?token=0123456789abcdef", 401),
        _http("a wrong cookie", "GET", path, 401, Cookie="wheelsight=0123456789abcdef"),
        _http("a wrong bearer", "GET", path, 401, Authorization="Bearer 0123456789abcdef"),
        _http("STOP without a token", "POST", "/stop", 401),
        _http("the script without a token", "GET", "/page.js", 401),
        _http("the camera without a token", "GET", "/camera.jpg", 401),
        _opened("a websocket without a token", 403),
    )


def _http(name: str, method: str, path: str, status: int, **headers: str) -> BadRequest:
    def send(port: int) -> str:
        connection = HTTPConnection("127.0.0.1", port, timeout=_WAIT_S)
        try:
            connection.putrequest(method, path, skip_host="Host" in headers)
            for key, value in headers.items():
                connection.putheader(key, value)
            connection.endheaders()
            answer = connection.getresponse()
            return f"{answer.status} {answer.read(200).decode(errors='replace').strip()}"
        except (HTTPException, OSError) as error:
            return type(error).__name__
        finally:
            connection.close()

    # Whose headers are far too long is cut off while he still sends.
    return BadRequest(name, send, lambda came: came.startswith(str(status)) or (status == 400 and "Error" in came))


def _opened(name: str, status: int, **headers: str) -> BadRequest:
    def send(port: int) -> str:
        try:
            with connect(f"ws://127.0.0.1:{port}/live", additional_headers=headers or None, open_timeout=_WAIT_S):
                return "opened"
        except InvalidStatus as error:
            return f"{error.response.status_code}"

    return BadRequest(name, send, lambda came: came == str(status))


def _message(name: str, text: str) -> BadRequest:
    def send(port: int) -> str:
        with _socket(port) as opened:
            opened.send(text)
            for _ in range(_MOST_MESSAGES):
                reported = json.loads(opened.recv(timeout=_WAIT_S))
                if "refused" in reported:
                    return str(reported["refused"])
            return "no answer"

    return BadRequest(name, send, lambda came: came.startswith("a message of no sense") and "\n" not in came)


def _closed(name: str, code: int, messages: list[str] | list[bytes]) -> BadRequest:
    def send(port: int) -> str:
        try:
            with _socket(port) as opened:
                for message in messages:
                    opened.send(message)
                for _ in range(_MOST_MESSAGES):
                    opened.recv(timeout=_WAIT_S)
                return "went on"
        except ConnectionClosed as closed:
            return "closed" if closed.rcvd is None else f"{closed.rcvd.code} {closed.rcvd.reason}"

    return BadRequest(name, send, lambda came: came.startswith(str(code)))


def _socket(port: int) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{port}/live", open_timeout=_WAIT_S, max_size=None, compression=None)


def _no_http(port: int) -> str:
    return _answer(port, bytes(range(256)) + b"\r\n\r\n")


def _by_name(port: int) -> str:
    lines = ["GET /live HTTP/1.1", "Host: evil.example", "Upgrade: websocket", "Connection: Upgrade"]
    lines += ["Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Version: 13", ""]
    return _answer(port, "".join(f"{line}\r\n" for line in lines).encode())


def _answer(port: int, sent: bytes) -> str:
    """The status that bytes are answered with, or that the connection is closed."""
    with socket.create_connection(("127.0.0.1", port), _WAIT_S) as opened:
        opened.sendall(sent)
        try:
            came = opened.recv(200)
        except ConnectionResetError:
            return "closed"
    return came.partition(b" ")[2][:3].decode() if came else "closed"
