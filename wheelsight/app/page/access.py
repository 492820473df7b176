"""Decides which requests may reach the page, by host, origin and token, as a layer around the application."""

from __future__ import annotations

import ipaddress
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from secrets import compare_digest, token_hex
from typing import Any
from urllib.parse import parse_qs

from wheelsight.core.errors import ConfigError

_Scope = MutableMapping[str, Any]
_Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
_Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[_Scope, _Receive, _Send], Awaitable[None]]

_COOKIE, _MOST_FIELDS = "wheelsight", 10
_TOKEN_BYTES, _SHORTEST_TOKEN = 24, 16
# Nothing of the page comes from elsewhere, goes elsewhere, or is shown within another page.
HEADERS = (
    (b"cache-control", b"no-store"),
    (b"content-security-policy", b"default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
)


def is_loopback(host: str) -> bool:
    """Whether only this computer can reach the address."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def token_of(option: str, token: str | None) -> str:
    """The token that an option gives, or a new one. Raises ConfigError for one that can be guessed."""
    if token is None:
        return token_hex(_TOKEN_BYTES)
    if len(token) < _SHORTEST_TOKEN or not token.isascii() or not token.isalnum():
        fix = f"{_SHORTEST_TOKEN} letters and digits, or more"
        raise ConfigError(f"{option} can be guessed, or is no word", fix=fix)
    return token


@dataclass(frozen=True, slots=True)
class Access:
    """The rules for requests.

    Attributes:
        is_loopback: whether only this computer can connect. Then a foreign page may still reach the address through its
            own host name (DNS rebinding); the host name gives it away.
        token: required token, or "" for none.
    """

    is_loopback: bool
    token: str = ""

    def refusal(self, scope: _Scope) -> tuple[int, str] | None:
        """Status and reason of a refusal; None if the request may pass."""
        headers = dict(scope["headers"])
        host = headers.get(b"host", b"").decode("latin-1")
        name, _, port = host.rpartition(":")
        without_port = (name if name and port.isdigit() else host).strip("[]")
        if self.is_loopback and not is_loopback(without_port):
            return 403, f"the host {host[:80]!r} is not this computer"
        origin = headers.get(b"origin")
        if origin is not None and origin.decode("latin-1") not in (f"http://{host}", f"https://{host}"):
            return 403, f"the origin {origin.decode('latin-1')[:80]!r} is not this page"
        kind, _, given = headers.get(b"authorization", b"").decode("latin-1").partition(" ")
        offered = [_asked(scope), given if kind.lower() == "bearer" else "", _kept(headers)]
        if self.token and not any(_is_same(one, self.token) for one in offered):
            return 401, "no token, or a wrong one: open the address that wheelsight serve printed"
        return None

    def cookie(self, scope: _Scope) -> str:
        """The cookie that holds the token for later requests; "" if the request had none in its address."""
        if not self.token or not _is_same(_asked(scope), self.token):
            return ""
        return f"{_COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"


class Guarded:
    """Passes to an application only the requests that `access` allows.

    Args:
        app: the application.
        access: the rules.
        on_refusal: called with one line about each refused client and the reason.
    """

    def __init__(self, app: App, access: Access, on_refusal: Callable[[str], None]) -> None:
        self._app, self._access, self._on_refusal = app, access, on_refusal

    async def __call__(self, scope: _Scope, receive: _Receive, send: _Send) -> None:
        """As ASGI has it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refused = self._access.refusal(scope)
        if refused is None:
            await self._app(scope, receive, _with_headers(send, self._access.cookie(scope)))
            return
        status, why = refused
        who = (scope.get("client") or ("somebody",))[0]
        self._on_refusal(f"refused {who}: {why}")
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": why})
            return
        headers = [(b"content-type", b"text/plain; charset=utf-8"), *HEADERS]
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": f"{why}\n".encode()})


def _with_headers(send: _Send, cookie: str) -> _Send:
    # Each request comes by the door, which counts them; a connection that stayed would pass it once.
    more = [*HEADERS, (b"connection", b"close"), *([(b"set-cookie", cookie.encode())] if cookie else [])]

    async def sent(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", ()), *more]
        await send(message)

    return sent


def _asked(scope: _Scope) -> str:
    try:
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"), max_num_fields=_MOST_FIELDS)
    except ValueError:
        return ""
    return str(query.get("token", [""])[0])


def _kept(headers: dict[bytes, bytes]) -> str:
    try:
        found = SimpleCookie(headers.get(b"cookie", b"").decode("latin-1")).get(_COOKIE)
    except CookieError:
        return ""
    value: str = "" if found is None else found.value
    return value


def _is_same(given: str, token: str) -> bool:
    """Compare in constant time: the duration does not reveal a common prefix."""
    return compare_digest(given.encode("utf-8", "replace"), token.encode())
