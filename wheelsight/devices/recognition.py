"""Which of the two wire formats a controller speaks, found out by listening."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from enum import StrEnum

from wheelsight.devices.paper import PaperDecoder, Pulses
from wheelsight.devices.protocol import FrameDecoder, LineStatistics, Message

EVIDENCE_S = 0.5
_PAIRS_A_SECOND = 30
_MOST_PULSES = 110
_SHARE_ALONE = 0.7
_SHARE_BELIEVABLE = 0.9
_SHARE_OF_ORPHANS = 0.1
_MOST_HELD = 400


class Format(StrEnum):
    """How counts come over the line."""

    FRAMED = "framed"
    PAPER = "paper"


class LineDecoder:
    """Decodes either format, and changes over when the controller does.

    One frame with a right checksum means framed. Half a second of bytes in pairs, each after a silence and
    with no more pulses than make a controller send early, means paper; the pulses of that half second are handed on
    with it, so none is lost. Everything else is noise, and framed stays framed.
    """

    def __init__(self) -> None:
        self.format: Format | None = None
        self._frames = FrameDecoder()
        self._paper = PaperDecoder()
        self._evidence: deque[Pulses] = deque(maxlen=_MOST_HELD)
        self._orphans: deque[float] = deque(maxlen=_MOST_HELD)

    @property
    def statistics(self) -> LineStatistics:
        """Of the format that was recognised; of frames as long as none was."""
        return self._paper.statistics if self.format is Format.PAPER else self._frames.statistics

    def feed(self, data: bytes, arrival_s: float) -> Sequence[Message | Pulses]:
        """What `data`, read at `arrival_s` seconds, completes: messages or pulses. Raises nothing, whatever comes."""
        messages = self._frames.feed(data)
        if messages:
            if self.format is Format.PAPER:
                self._frames.statistics = LineStatistics(len(data), len(messages))
            self.format = Format.FRAMED
            self._forget_pairs()
            return messages
        pairs = self._gather(data, arrival_s)
        if self._evidence and arrival_s - self._evidence[0].arrival_s >= EVIDENCE_S:
            return self._judge(pairs, arrival_s)
        return pairs if self.format is Format.PAPER else ()

    def restart(self) -> None:
        """Forget what is half-read: the port was opened anew."""
        self._frames.forget_sequence()
        self._forget_pairs()

    def forgive_gap(self) -> None:
        """Take back a loss just counted: the controller had begun anew."""
        self._frames.forgive_gap()

    def _gather(self, data: bytes, arrival_s: float) -> list[Pulses]:
        orphans = self._paper.statistics.malformed
        pairs = self._paper.feed(data, arrival_s)
        self._evidence += pairs
        if self._paper.statistics.malformed > orphans:
            self._orphans.append(arrival_s)
        return pairs

    def _judge(self, pairs: list[Pulses], arrival_s: float) -> Sequence[Pulses]:
        """Decide by half a second of evidence, and drop what is older."""
        if self._is_paired():
            if self.format is not Format.PAPER:
                self.format = Format.PAPER
                pairs = list(self._evidence)
                self._paper.statistics = LineStatistics(2 * len(pairs), len(pairs))
            self._drop_before(arrival_s - EVIDENCE_S / 2)
            return pairs
        if self.format is Format.PAPER:
            self.format = None
        self._drop_before(arrival_s - EVIDENCE_S)
        return ()

    def _is_paired(self) -> bool:
        span_s = self._evidence[-1].arrival_s - self._evidence[0].arrival_s
        pairs = len(self._evidence)
        alone = sum(pair.follows_silence for pair in self._evidence)
        believable = sum(max(abs(pair.left), abs(pair.right)) <= _MOST_PULSES for pair in self._evidence)
        regular = pairs >= _PAIRS_A_SECOND * span_s and alone >= _SHARE_ALONE * pairs
        return believable >= _SHARE_BELIEVABLE * pairs and regular and len(self._orphans) <= _SHARE_OF_ORPHANS * pairs

    def _drop_before(self, stamp_s: float) -> None:
        while self._evidence and self._evidence[0].arrival_s < stamp_s:
            self._evidence.popleft()
        while self._orphans and self._orphans[0] < stamp_s:
            self._orphans.popleft()

    def _forget_pairs(self) -> None:
        self._evidence.clear()
        self._orphans.clear()
        self._paper.forget()
