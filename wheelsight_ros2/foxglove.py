"""FoxgloveServer: a live server in Foxglove's websocket protocol, behind a token.

Messages are CDR with ROS 2 definitions. The SDK's own server checks neither token nor origin: each web page that its
user opens could move the robot. This one refuses a handshake without the token. The protocol is described at
https://github.com/foxglove/ws-protocol (docs/spec.md).
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import secrets
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any
from urllib.parse import parse_qs, urlsplit

from wheelsight.app.page import is_loopback, token_of
from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import STOP
from wheelsight.core.runtime import needed
from wheelsight_export.bag_writing import Messages
from wheelsight_export.topics import TOPICS, VELOCITY_TOPIC, Flow, Topic
from wheelsight_ros2.inputs import INPUTS, Inputs

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
_HOST = "127.0.0.1"
_MOST_CLIENTS, _MOST_BYTES, _MOST_CHANNELS = 8, 65_536, 64
# From one client, after a burst of twice as many: a stick at 100 Hz, and clicks. Invalid ones before it is sent away.
_MESSAGES_A_S, _MOST_BAD = 200.0, 20
# A client that takes nothing, or does not answer a ping, for this time is sent away.
_SEND_S, _PING_S = 2.0, 5.0
_STARTS_S, _ENDS_S = 10.0, 5.0
_MESSAGE, _STATUS_WARNING = 1, 1
_TWIST = "geometry_msgs/msg/TwistStamped"
# Types that are accepted on a topic besides its own, and the field that has it.
_ALSO = {(VELOCITY_TOPIC, _TWIST): "twist"}


def address_of(text: str) -> tuple[str, int]:
    """Host and port of PORT or HOST:PORT. Raises ConfigError."""
    host, _, port = text.rpartition(":")
    host = host.strip("[]") or _HOST
    if not port.isdecimal() or int(port) > 65535:
        raise ConfigError(f"--foxglove is {text!r}", fix="a port, such as 8766, or ADDRESS:PORT; 0 is any free port")
    return host, int(port)


class FoxgloveServer:
    """A server in its own thread; see `Peer`.

    Args:
        address: PORT or HOST:PORT.
        token: that the address of a client holds as `?token=`; None for a new one.
        inputs: takes messages in JSON.
        on_cdr: takes messages in CDR: topic, type and bytes.
        on_refusal: called with one line about each refused client.

    Attributes:
        address: that clients open.
        is_loopback: whether only this computer can reach it.
        port: in use.

    Raises:
        ConfigError: the address cannot be used.
    """

    name = "Foxglove"

    def __init__(
        self,
        address: str,
        token: str | None,
        inputs: Inputs,
        on_cdr: Callable[[str, str, bytes], None],
        on_refusal: Callable[[str], None],
    ) -> None:
        host, port = address_of(address)
        self._token = token_of("--link-token", token)
        self._inputs, self._on_cdr, self._on_refusal = inputs, on_cdr, on_refusal
        self._types = Messages(is_ros1=False).types
        self._channels = {topic.name: number for number, topic in enumerate(TOPICS.values(), 1) if _is_sent(topic)}
        self._clients: list[_Client] = []
        self._driver: _Client | None = None  # of the last velocity command
        self._lock, self._is_woken = threading.Lock(), False
        self._new: dict[str, tuple[int, bytes]] = {}
        self._kept: dict[str, tuple[int, bytes]] = {}
        self._wanted: frozenset[str] = frozenset()
        self._socket = _listening(host, port)
        self.port = int(self._socket.getsockname()[1])
        self.is_loopback = is_loopback(host)
        shown = socket.gethostname() if _is_any(host) else f"[{host}]" if ":" in host else host
        self.address = f"ws://{shown}:{self.port}/?token={self._token}"
        self._loop: asyncio.AbstractEventLoop | None = None
        self._is_over = asyncio.Event()
        self._started = threading.Event()
        self._thread = threading.Thread(target=self._run, name="wheelsight-foxglove", daemon=True)
        self._thread.start()
        if not self._started.wait(_STARTS_S):
            raise ConfigError("Foxglove's server did not start")

    def wants(self, topic: str) -> bool:
        """See `Peer`."""
        return topic in self._wanted

    def send(self, topic: Topic, data: bytes, stamp_ns: int) -> None:
        """See `Peer`. The newest message of a topic replaces one that is not sent yet."""
        with self._lock:
            if topic.flow is Flow.LATCHED:
                self._kept[topic.name] = (stamp_ns, data)
            if topic.name not in self._wanted:
                return
            self._new[topic.name] = (stamp_ns, data)
            is_woken, self._is_woken = self._is_woken, True
        if not is_woken and self._loop is not None:
            with suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._deliver)

    def close(self) -> None:
        """See `Peer`."""
        if self._loop is not None:
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._is_over.set)
        self._thread.join(_ENDS_S)
        self._socket.close()

    def _run(self) -> None:
        with suppress(Exception):
            asyncio.run(self._serve())

    async def _serve(self) -> None:
        server = needed("websockets.asyncio.server")
        self._loop = asyncio.get_running_loop()
        how: dict[str, Any] = {"max_size": _MOST_BYTES, "max_queue": 16, "compression": None, "logger": _silent()}
        how |= {"ping_interval": _PING_S, "ping_timeout": _PING_S, "close_timeout": 1, "server_header": None}
        how |= {"subprotocols": SUBPROTOCOLS, "process_request": self._door, "sock": self._socket}
        async with server.serve(self._attend, **how):
            self._started.set()
            await self._is_over.wait()

    def _door(self, connection: Any, request: Any) -> Any:
        """Refuse a handshake without the token, or one too many."""
        asked = parse_qs(urlsplit(request.path).query, max_num_fields=10).get("token", [""])[0]
        if not secrets.compare_digest(asked.encode(), self._token.encode()):
            self._refuse(connection, "no token, or a wrong one")
            return connection.respond(401, "no token, or a wrong one: open the address that wheelsight printed\n")
        if len(self._clients) >= _MOST_CLIENTS:
            self._refuse(connection, "too many clients")
            return connection.respond(503, f"{_MOST_CLIENTS} clients are connected\n")
        return None

    def _refuse(self, connection: Any, why: str) -> None:
        host = (connection.remote_address or ("another program",))[0]
        self._on_refusal(f"refused {host}: {why}")

    async def _attend(self, connection: Any) -> None:
        """Serve one client to its end."""
        if len(self._clients) >= _MOST_CLIENTS:
            return
        client = _Client(connection, time.monotonic())
        self._clients.append(client)
        try:
            await connection.send(self._about())
            await connection.send(json.dumps({"op": "advertise", "channels": self._advertised()}))
            sending = asyncio.ensure_future(client.send_all())
            try:
                async for message in connection:
                    if client.is_flooding(time.monotonic()):
                        self._refuse(connection, "too many messages")
                        await connection.close(1008, "too many messages")
                        return
                    if problem := self._take(client, message):
                        client.warn(problem)
                        client.bad += 1
                    if client.bad > _MOST_BAD:
                        self._refuse(connection, f"{_MOST_BAD} messages that make no sense, the last: {problem}")
                        await connection.close(1008, "too many messages that make no sense")
                        return
            finally:
                sending.cancel()
                with suppress(asyncio.CancelledError, Exception):
                    await sending
        except Exception as error:
            if not isinstance(error, needed("websockets.exceptions").ConnectionClosed):
                self._refuse(connection, f"{type(error).__name__}: {error}"[:120])
        finally:
            if client.is_stuck:
                self._refuse(connection, "a client that never reads")
            self._clients.remove(client)
            self._update_wanted()
            if self._driver is client:
                self._driver = None
                self._inputs.stick.push(STOP)  # it holds nothing any more

    def _about(self) -> str:
        about = {"op": "serverInfo", "name": "wheelsight", "capabilities": ["clientPublish"]}
        return json.dumps({**about, "supportedEncodings": ["json", "cdr"], "metadata": {"ROS_DISTRO": "jazzy"}})

    def _advertised(self) -> list[dict[str, Any]]:
        channels = []
        for name, number in self._channels.items():
            definition, _ = self._types.generate_msgdef(TOPICS[name].type, ros_version=2)
            channel = {"id": number, "topic": name, "encoding": "cdr", "schemaName": TOPICS[name].type}
            channels.append({**channel, "schema": definition, "schemaEncoding": "ros2msg"})
        return channels

    def _take(self, client: _Client, message: str | bytes) -> str:
        """Execute a client's message; returns why it makes no sense, or ""."""
        if isinstance(message, bytes):
            return self._take_data(client, message)
        try:
            asked = json.loads(message)
            return self._execute(client, asked["op"], asked)
        except (ValueError, TypeError, KeyError, RecursionError, OverflowError) as error:
            return f"a message of no sense: {type(error).__name__}"
        except _NoChannelError as error:
            return str(error)

    def _execute(self, client: _Client, op: Any, asked: dict[str, Any]) -> str:
        if op == "subscribe":
            for one in asked["subscriptions"]:
                self._subscribe(client, int(one["id"]), int(one["channelId"]))
        elif op == "unsubscribe":
            for number in asked["subscriptionIds"]:
                client.subscribed.pop(int(number), None)
            self._update_wanted()
        elif op == "advertise":
            for one in asked["channels"]:
                self._advertise(client, one)
        elif op == "unadvertise":
            for number in asked["channelIds"]:
                client.advertised.pop(int(number), None)
        else:
            return f"op {str(op)[:20]!r} is not known here"
        return ""

    def _subscribe(self, client: _Client, number: int, channel: int) -> None:
        topic = next((name for name, known in self._channels.items() if known == channel), None)
        if topic is None:
            raise _NoChannelError(f"no channel {channel}")
        if len(client.subscribed) >= _MOST_CHANNELS:
            raise _NoChannelError(f"more than {_MOST_CHANNELS} subscriptions")
        if not 0 <= number < 2**32:
            raise _NoChannelError("a subscription's id has 32 bits")
        client.subscribed[number] = topic
        self._update_wanted()
        with self._lock:
            kept = self._kept.get(topic)
        if kept is not None:
            client.put(number, *kept)

    def _advertise(self, client: _Client, one: dict[str, Any]) -> None:
        topic, encoding = str(one["topic"]), str(one["encoding"])
        type_ = str(one.get("schemaName", "")).replace("/msg/", "/").replace("/", "/msg/", 1)
        known = INPUTS.get(topic)
        if known is None:
            raise _NoChannelError(f"{topic[:60]!r} is no input: {', '.join(INPUTS)}")
        if type_ != known.type and (topic, type_) not in _ALSO:
            raise _NoChannelError(f"{topic} is {known.type}, not {type_[:60]!r}")
        if encoding not in ("json", "cdr"):
            raise _NoChannelError(f"{topic}: encoding {encoding[:20]!r}, not json or cdr")
        if len(client.advertised) >= _MOST_CHANNELS:
            raise _NoChannelError(f"more than {_MOST_CHANNELS} channels")
        client.advertised[int(one["id"])] = (topic, type_, encoding)

    def _take_data(self, client: _Client, message: bytes) -> str:
        if len(message) < 5 or message[0] != _MESSAGE:
            return "bytes of no sense"
        known = client.advertised.get(struct.unpack_from("<I", message, 1)[0])
        if known is None:
            return "a message of a channel that was not advertised"
        (topic, type_, encoding), data = known, message[5:]
        refused = sum(self._inputs.counts.values())
        if topic == VELOCITY_TOPIC:
            self._driver = client
        if encoding == "json":
            try:
                found = json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))
            except (ValueError, TypeError, RecursionError):
                self._inputs.refuse(topic, "is no JSON")
                return f"{topic}: is no JSON"
            inner = _ALSO.get((topic, type_))
            self._inputs.receive(topic, found if inner is None else getattr(found, inner, None))
        elif type_ == INPUTS[topic].type:
            self._on_cdr(topic, type_, data)
        else:
            # A header before the twist: its bytes are decoded here, since the type is not the topic's own.
            try:
                found = self._types.deserialize_cdr(data, type_)
            except Exception as error:
                self._inputs.refuse(topic, f"is no {type_} ({type(error).__name__})")
                return self._inputs.refused
            self._inputs.receive(topic, getattr(found, _ALSO[topic, type_]))
        return self._inputs.refused if sum(self._inputs.counts.values()) > refused else ""

    def _update_wanted(self) -> None:
        self._wanted = frozenset(topic for client in self._clients for topic in client.subscribed.values())

    def _deliver(self) -> None:
        """In the loop: pass new messages to the clients that subscribed."""
        with self._lock:
            new, self._new, self._is_woken = self._new, {}, False
        for client in self._clients:
            for number, topic in client.subscribed.items():
                if topic in new:
                    client.put(number, *new[topic])


class _NoChannelError(Exception):
    """A channel that cannot be subscribed or advertised."""


class _Client:
    """A connected client: its subscriptions, and for each at most one message that is not sent yet."""

    def __init__(self, connection: Any, now_s: float) -> None:
        self._connection = connection
        self.subscribed: dict[int, str] = {}
        self.advertised: dict[int, tuple[str, str, str]] = {}
        self.bad, self.is_stuck = 0, False
        self._waiting: dict[int, tuple[int, bytes]] = {}
        self._warning = ""
        self._wake = asyncio.Event()
        self._left, self._filled_s = 2 * _MESSAGES_A_S, now_s

    def put(self, number: int, stamp_ns: int, data: bytes) -> None:
        """Queue a message, which replaces one of the same subscription."""
        self._waiting[number] = (stamp_ns, data)
        self._wake.set()

    def warn(self, problem: str) -> None:
        """Queue a warning, which replaces another one."""
        self._warning = problem
        self._wake.set()

    def is_flooding(self, now_s: float) -> bool:
        """Count a message; whether there are too many."""
        self._left = min(self._left + (now_s - self._filled_s) * _MESSAGES_A_S, 2 * _MESSAGES_A_S) - 1
        self._filled_s = now_s
        return self._left < 0

    async def send_all(self) -> None:
        """Send until the connection ends, or the client takes nothing."""
        try:
            while True:
                await self._wake.wait()
                self._wake.clear()
                if self._warning:
                    status = {"op": "status", "level": _STATUS_WARNING, "message": self._warning[:200]}
                    self._warning = ""
                    async with asyncio.timeout(_SEND_S):
                        await self._connection.send(json.dumps(status))
                while self._waiting:
                    number = next(iter(self._waiting))
                    stamp_ns, data = self._waiting.pop(number)
                    if number in self.subscribed:
                        async with asyncio.timeout(_SEND_S):
                            await self._connection.send(struct.pack("<BIQ", _MESSAGE, number, stamp_ns) + data)
        except TimeoutError:
            self.is_stuck = True
            self._connection.transport.abort()


def _is_sent(topic: Topic) -> bool:
    return topic.is_live and topic.name not in INPUTS


def _is_any(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False


def _listening(host: str, port: int) -> socket.socket:
    made: socket.socket | None = None
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = found[0]
        made = socket.socket(family, kind, protocol)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(address)
        made.listen()
    except OSError as error:
        if made is not None:
            made.close()
        fix = "another --foxglove; port 0 takes any that is free"
        raise ConfigError(f"Foxglove's server cannot use {host}, port {port}: {error}", fix=fix) from error
    return made


def _silent() -> Any:
    """A logger that says nothing: what clients do wrong is reported by `on_refusal`, counted and bounded."""
    import logging

    logger = logging.getLogger("wheelsight.foxglove")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    return logger
