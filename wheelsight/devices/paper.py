"""The paper's wire format: two bytes every 20 ms, the right and left wheel's signed pulse counts (Trinh et al., II.C).

A byte holds 127 pulses; at 0.3338 mm a pulse and 20 ms that is 2.1 m/s, and at the paper's top speed there are 157.
So the controller sends early, as soon as a count reaches 100, and no pulse is lost. Nothing in the bytes says
which of a pair comes first: only the silence between the pairs does.
"""

from __future__ import annotations

from typing import NamedTuple

from wheelsight.devices.protocol import LineStatistics

SILENCE_S = 0.005


class Pulses(NamedTuple):
    """Pulses of both wheels since the pair before, and when the host had them.

    Attributes:
        follows_silence: whether the line was quiet before the pair.
    """

    arrival_s: float
    left: int
    right: int
    follows_silence: bool


class PaperDecoder:
    """Pairs bytes by the silence between pairs; a byte whose partner does not come in time is dropped and counted.

    Where the host was away and several pairs come at once, they are taken in twos. In `statistics`, `frames` are
    pairs and `malformed` are bytes without a partner. A lost pair cannot be noticed: the format has no sequence.
    """

    def __init__(self) -> None:
        self.statistics = LineStatistics()
        self._first: int | None = None
        self._first_follows_silence = True
        self._arrival_s = -float("inf")

    def feed(self, data: bytes, arrival_s: float) -> list[Pulses]:
        """The pairs that `data`, read at `arrival_s` seconds, completes. Raises nothing, whatever comes."""
        statistics = self.statistics
        statistics.bytes += len(data)
        after_silence = arrival_s - self._arrival_s > SILENCE_S
        self._arrival_s = arrival_s
        if after_silence and self._first is not None:
            statistics.malformed += 1
            self._first = None
        pairs = []
        for byte in data:
            if self._first is None:
                self._first, self._first_follows_silence = byte, after_silence
            else:
                pairs.append(Pulses(arrival_s, _signed(byte), _signed(self._first), self._first_follows_silence))
                self._first = None
            after_silence = False
        statistics.frames += len(pairs)
        return pairs

    def forget(self) -> None:
        """Drop a byte that waits for its partner: what follows is another stream."""
        self._first = None


def _signed(byte: int) -> int:
    return byte - 256 if byte > 127 else byte
