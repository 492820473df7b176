"""When a message was measured: as its header says, or as it was received where that is not to be believed."""

from __future__ import annotations

from collections.abc import Mapping


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
    firsts: Mapping[str, tuple[float, float]], most_apart_s: float
) -> tuple[dict[str, TopicClock], tuple[str, ...]]:
    """A clock for each topic by its first message's header and receipt, and sentences on headers that are not believed.

    Headers that all are off by the same, as in a bag that was recorded from another one's replay, are believed.
    """
    headers = {topic: header_s for topic, (header_s, _) in firsts.items()}
    offsets = {topic: receipt_s - header_s for topic, (header_s, receipt_s) in firsts.items()}
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
