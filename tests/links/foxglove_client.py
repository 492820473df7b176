"""A client of Foxglove's websocket protocol, written from its description, with the CDR reader of `mcap`'s tools."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from websockets.sync.client import ClientConnection, connect

LONGEST_S = 60.0
PROTOCOL = "foxglove.sdk.v1"


class FoxgloveClient:
    """Keeps what the server says: `about`, `channels` by topic, `messages` by topic, `statuses`."""

    def __init__(self, address: str, **how: Any) -> None:
        self._opened = ExitStack()
        opened = connect(address, subprotocols=[PROTOCOL], compression=None, **how)  # type: ignore[list-item]
        self.connection: ClientConnection = self._opened.enter_context(opened)
        self.about: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, Any]]] = {}
        self.statuses: list[str] = []
        self._subscribed: dict[int, str] = {}
        self._decoders: dict[str, Callable[[bytes], Any]] = {}

    def __enter__(self) -> FoxgloveClient:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def subscribe(self, *topics: str) -> None:
        self.until(lambda: self.channels.keys() >= set(topics))
        begin = len(self._subscribed) + 100
        asked = [{"id": begin + at, "channelId": self.channels[topic]["id"]} for at, topic in enumerate(topics)]
        self._subscribed |= {one["id"]: topic for one, topic in zip(asked, topics, strict=True)}
        self.say({"op": "subscribe", "subscriptions": asked})

    def advertise(self, number: int, topic: str, type_: str, encoding: str = "json") -> None:
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": type_}
        self.say({"op": "advertise", "channels": [channel]})

    def publish(self, number: int, message: dict[str, Any] | bytes) -> None:
        data = message if isinstance(message, bytes) else json.dumps(message).encode()
        self.connection.send(b"\x01" + struct.pack("<I", number) + data)

    def say(self, message: Any) -> None:
        self.connection.send(json.dumps(message))

    def read(self, seconds: float) -> bool:
        """Take one message of the server; False if none comes."""
        try:
            found = self.connection.recv(timeout=seconds)
        except TimeoutError:
            return False
        if isinstance(found, str):
            said = json.loads(found)
            if said["op"] == "serverInfo":
                self.about = said
            elif said["op"] == "advertise":
                self.channels |= {one["topic"]: one for one in said["channels"]}
            elif said["op"] == "status":
                self.statuses.append(said["message"])
            return True
        kind, number, stamp_ns = struct.unpack_from("<BIQ", found)
        if kind == 1:
            topic = self._subscribed[number]
            self.messages.setdefault(topic, []).append((stamp_ns, self._decoded(topic, found[13:])))
        return True

    def until(self, what: Callable[[], Any], seconds: float = LONGEST_S) -> Any:
        ends_s = time.monotonic() + seconds
        while time.monotonic() < ends_s:
            if found := what():
                return found
            self.read(0.05)
        raise AssertionError(f"it did not come to be: {self.statuses[-3:]}, {[*self.messages]}")

    def until_reported(self) -> None:
        """Until it knows the server and its channels."""
        self.until(lambda: self.about and self.channels)

    def until_warned(self, problem: str) -> None:
        """Until the server has warned of a problem."""
        self.until(lambda: problem in " ".join(self.statuses))

    def last(self, topic: str) -> Any:
        return self.until(lambda: self.messages.get(topic))[-1][1]

    def _decoded(self, topic: str, data: bytes) -> Any:
        if topic not in self._decoders:
            channel = self.channels[topic]
            about = {"name": channel["schemaName"], "data": channel["schema"].encode()}
            schema = Schema(id=channel["id"], encoding=channel["schemaEncoding"], **about)
            made = DecoderFactory().decoder_for(channel["encoding"], schema)
            assert made is not None
            self._decoders[topic] = made
        return self._decoders[topic](data)
