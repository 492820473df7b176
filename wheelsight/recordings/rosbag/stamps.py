"""When a message was measured: as its header says, or as it was received where that is not to be believed."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from wheelsight.recordings.rosbag.storage import Message


@dataclass(frozen=True, slots=True)
class Header:
    """The stamp, 0 where none was given, and the frame that a message begins with."""

    stamp_s: float
    frame: str


def header_of(data: bytes, is_ros1: bool) -> Header:
    """The header of a message of a type that begins with one, without decoding the rest.

    Raises struct.error or UnicodeDecodeError where there is none.
    """
    order = "<" if is_ros1 or data[1:2] == b"\x01" else ">"
    # ROS 1 has a number of the message first; CDR has four bytes of how it is encoded, and ends strings by a zero.
    seconds, nanoseconds, length = struct.unpack_from(f"{order}{'I' if is_ros1 else 'i'}II", data, 4)
    frame = data[16 : 16 + length].rstrip(b"\0").decode()
    return Header(seconds + 1e-9 * nanoseconds, frame.lstrip("/"))


class TopicClock:
    """Stamps of one topic's messages.

    Attributes:
        by_receipt: whether headers are passed over.
        offset_s: by how much receipt is later than the header, by the first message; that is usual, and kept to.
        replaced: how many single headers were not believed.
    """

    def __init__(self, offset_s: float, by_receipt: bool, most_apart_s: float) -> None:
        self.offset_s, self.by_receipt, self.replaced = offset_s, by_receipt, 0
        self._most_apart_s = most_apart_s

    def stamp_s(self, header_s: float, receipt_s: float) -> float:
        """The time of a message by its header and its receipt."""
        if self.by_receipt:
            return receipt_s
        if header_s == 0 or not abs(receipt_s - header_s - self.offset_s) <= self._most_apart_s:
            self.replaced += 1
            return receipt_s - self.offset_s
        return header_s

    def anew(self) -> TopicClock:
        """The same for another pass, nothing counted."""
        return TopicClock(self.offset_s, self.by_receipt, self._most_apart_s)


def clocks_of(
    firsts: Mapping[str, Message], is_ros1: bool, most_apart_s: float
) -> tuple[dict[str, TopicClock], tuple[str, ...]]:
    """A clock for each topic by its first message, and sentences on headers that are not believed.

    Headers that all are off by the same, as in a bag that was recorded from another one's replay, are believed.
    """
    headers = {topic: header_of(message.data, is_ros1).stamp_s for topic, message in firsts.items()}
    offsets = {topic: message.receipt_s - headers[topic] for topic, message in firsts.items()}
    alike = max(offsets.values(), default=0.0) - min(offsets.values(), default=0.0) <= most_apart_s
    clocks, warnings = {}, []
    for topic, offset_s in offsets.items():
        is_apart = abs(offset_s) > most_apart_s
        by_receipt = headers[topic] == 0 or (is_apart and not alike)
        clocks[topic] = TopicClock(0.0 if by_receipt else offset_s, by_receipt, most_apart_s)
        if by_receipt:
            warnings.append(f"{topic}: {_why_not(headers[topic], offset_s)}; the time of receipt stands for it.")
    if alike and not warnings and any(abs(offset_s) > most_apart_s for offset_s in offsets.values()):
        offset_s = next(iter(offsets.values()))
        warnings.append(
            f"All headers are stamped {_apart(offset_s)} receipt: a replay was recorded. They are believed."
        )
    return clocks, tuple(warnings)


def _why_not(header_s: float, offset_s: float) -> str:
    if header_s == 0:
        return "headers have no stamp"
    return f"the first header is stamped {header_s:.3f} s, {_apart(offset_s)} its receipt"


def _apart(offset_s: float) -> str:
    return f"{abs(offset_s):.0f} s {'before' if offset_s > 0 else 'after'}"
