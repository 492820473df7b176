"""The paper's wire format: two bytes every 20 ms, the right and left wheel's signed pulse counts (Trinh et al., II.C).

A byte holds 127 pulses; at 0.3338 mm a pulse and 20 ms that is 2.1 m/s, and at the paper's top speed there are 157.
So the controller sends early, as soon as a count reaches 100, and no pulse is lost. Nothing in the bytes says
which of a pair comes first: only the silence between the pairs does.
"""

from __future__ import annotations

from typing import NamedTuple

from wheelsight.devices.protocol import LineStatistics

SILENCE_S = 0.005
FULL_PULSES = 100  # from here on a pair is sent at once, before its time
_LATEST_PARTNER_S = 1.0


class Pulses(NamedTuple):
    """Pulses of both wheels since the pair before, and when the host had them.

    Attributes:
        follows_silence: whether the line was quiet before the pair.
        following: how many pairs came behind it in the same run of bytes.
    """

    arrival_s: float
    left: int
    right: int
    follows_silence: bool
    following: int = 0


class PaperDecoder:
    """Pairs bytes by the silence between pairs.

    A byte left over waits for the next run of bytes: where that is odd too, it holds the partner, held up on its way;
    else the partner was lost, and the byte is dropped and counted. Where the host was away and several pairs come at
    once, they are taken in twos. In `statistics`, `frames` are pairs and `malformed` are bytes without a partner. A
    lost pair cannot be noticed: the format has no sequence.

    Attributes:
        statistics: what came.
        torn: pairs whose second byte was held up.
    """

    def __init__(self) -> None:
        self.statistics = LineStatistics()
        self.torn = 0
        self._first = b""
        self._arrival_s = -float("inf")

    def feed(self, run: bytes, arrival_s: float) -> list[Pulses]:
        """The pairs that a run of bytes completes, with a silence before and behind it. Raises nothing.

        Args:
            run: at least one byte.
            arrival_s: when the last of them was read, seconds.
        """
        is_torn = bool(self._first) and len(run) % 2 == 1 and arrival_s - self._arrival_s < _LATEST_PARTNER_S
        self.torn += is_torn
        self.statistics.malformed += bool(self._first) and not is_torn
        self.statistics.bytes += len(run)
        self._arrival_s = arrival_s
        if is_torn:
            run = self._first + run
        whole = len(run) // 2 * 2
        self._first = run[whole:]
        self.statistics.frames += whole // 2
        return [
            Pulses(arrival_s, _signed(run[n + 1]), _signed(run[n]), n == 0, (whole - n) // 2 - 1)
            for n in range(0, whole, 2)
        ]

    def forget(self) -> None:
        """Drop a byte that waits for its partner: what follows is another stream."""
        self._first = b""


def _signed(byte: int) -> int:
    return byte - 256 if byte > 127 else byte
