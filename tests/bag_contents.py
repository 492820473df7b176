"""Bags read back by what shares nothing with their writer: mcap's reader, and a small one of ROS 1 records."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Schema
from mcap_ros1.decoder import DecoderFactory as DecoderFactory1
from mcap_ros2.decoder import DecoderFactory as DecoderFactory2

_CHUNK, _CONNECTION, _MESSAGE = 5, 7, 2


@dataclass(frozen=True)
class ReadMessage:
    """A message as the other reader has it."""

    topic: str
    type: str
    received_ns: int
    message: Any
    is_latched: bool


def messages_in(path: Path) -> list[ReadMessage]:
    """All messages of an .mcap or a .bag, in the order of the file."""
    return list(_of_mcap(path) if path.suffix == ".mcap" else _of_bag(path))


def on_topic(path: Path, topic: str) -> list[Any]:
    """The messages of one topic."""
    return [one.message for one in messages_in(path) if one.topic == topic]


def whole_messages_in(path: Path) -> int:
    """How many messages mcap finds from the beginning on, without an end."""
    count = 0
    with path.open("rb") as stream:
        try:
            for _ in NonSeekingReader(stream).iter_messages(log_time_order=False):
                count += 1
        except Exception:  # whatever it says of a file that ends in the middle
            return count
    return count


def _of_mcap(path: Path) -> Iterator[ReadMessage]:
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory2()])
        for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            assert schema is not None
            qos = channel.metadata["offered_qos_profiles"]
            yield ReadMessage(channel.topic, schema.name, message.log_time, decoded, "transient_local" in qos)


def _of_bag(path: Path) -> Iterator[ReadMessage]:
    """By the description of the format: records of a header of fields and data, messages in chunks."""
    data = path.read_bytes()
    assert data.startswith(b"#ROSBAG V2.0\n")
    known: dict[int, tuple[str, dict[bytes, bytes], Any]] = {}
    for fields, chunk in _records(data, len(b"#ROSBAG V2.0\n")):
        if fields[b"op"][0] != _CHUNK:
            continue
        assert fields[b"compression"] == b"none"
        assert struct.unpack("<I", fields[b"size"])[0] == len(chunk)
        for inner, content in _records(chunk, 0):
            number = struct.unpack("<I", inner[b"conn"])[0]
            if inner[b"op"][0] == _CONNECTION:
                about = dict(_fields(content))
                type_ = about[b"type"].decode()
                schema = Schema(id=1, name=type_, encoding="ros1msg", data=about[b"message_definition"])
                known[number] = (inner[b"topic"].decode(), about, DecoderFactory1().decoder_for("ros1", schema))
            elif inner[b"op"][0] == _MESSAGE:
                topic, about, decode = known[number]
                seconds, nanoseconds = struct.unpack("<II", inner[b"time"])
                received_ns = seconds * 10**9 + nanoseconds
                is_latched = about.get(b"latching") == b"1"
                yield ReadMessage(topic, about[b"type"].decode(), received_ns, decode(content), is_latched)


def _records(data: bytes, at: int) -> Iterator[tuple[dict[bytes, bytes], bytes]]:
    while at < len(data):
        (length,) = struct.unpack_from("<I", data, at)
        fields = dict(_fields(data[at + 4 : at + 4 + length]))
        at += 4 + length
        (length,) = struct.unpack_from("<I", data, at)
        yield fields, data[at + 4 : at + 4 + length]
        at += 4 + length


def _fields(header: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at < len(header):
        (length,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        yield name, value
        at += 4 + length
