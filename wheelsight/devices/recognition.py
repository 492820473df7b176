"""Which of the three wire formats a controller speaks, found out by listening."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from enum import StrEnum

from wheelsight.devices.paper import SILENCE_S, PaperDecoder, Pulses
from wheelsight.devices.plain_text import PlainReading, PlainText, PlainTextSettings, is_plain_line
from wheelsight.devices.protocol import FrameDecoder, LineStatistics, Message

EVIDENCE_S = 0.5
_LONGEST_EVIDENCE_S = 3.0
_FEWEST_PAIRS = 15
_MOST_A_SECOND = 300
_MOST_AT_ONCE = 2048  # a system's buffer holds so many, for a host that was away
_MOST_PULSES = 110
_SHARE_ALONE = 0.6
_SHARE_BELIEVABLE = 0.9
_SHARE_TORN = 0.2
_FEWEST_DOUBTED = 10
_MOST_KEPT = 400
_MOST_HELD_BYTES = 1024


class Format(StrEnum):
    """How counts come over the line."""

    FRAMED = "framed"
    PAPER = "paper"
    PLAIN = "plain text"


Told = Message | Pulses | PlainReading


class LineDecoder:
    """Decodes any of the formats, and changes over when the controller does.

    One frame with a right checksum means framed. Half a second of bytes in pairs (three, where there are few), each
    after a silence and with no more pulses than make a controller send early, means paper; those pulses are handed on
    with it, so none is lost. Lines of text with two or three whole numbers, for as long, mean plain text (`PlainText`).
    Everything else is noise, and framed stays framed.

    Bytes are read as pairs only after the silence behind them, since they might be the beginning of a frame: of what
    came without a silence, pairs are what lies before the first frame. Once recognised, the paper's format is given up
    for a frame, or for what delays cannot make of pairs (pulses beyond belief, or too many pairs): after a busy host or
    a slow line they only come later, and together. Plain text is given up for a frame, or where lines are no counts for
    seconds.

    Args:
        plain: when lines of text are counts.
    """

    def __init__(self, plain: PlainTextSettings | None = None) -> None:
        self.format: Format | None = None
        self._frames = FrameDecoder()
        self._paper = PaperDecoder()
        self._text = PlainText(plain)
        self._held: list[tuple[bytes, float]] = []  # runs of bytes between silences, and when the last of each came
        self._heard_s = -float("inf")
        self._expects_frames = False
        self._evidence: deque[Pulses] = deque(maxlen=_MOST_KEPT)
        self._torn: deque[float] = deque(maxlen=_MOST_KEPT)
        self._credit, self._judged_s = 0.0, 0.0

    @property
    def statistics(self) -> LineStatistics:
        """Of the format that was recognised; of frames as long as none was."""
        if self.format is Format.PLAIN:
            return self._text.statistics
        return self._paper.statistics if self.format is Format.PAPER else self._frames.statistics

    @property
    def is_text(self) -> bool:
        """Whether nothing was recognised, and what comes is lines of text that are no counts."""
        return self._text.is_text

    @property
    def other_line(self) -> str:
        """The last line of text that was no counts; empty where there was none."""
        return self._text.other if self.format in (None, Format.PLAIN) else ""

    def feed(self, data: bytes, arrival_s: float, lay_waiting: bool = False) -> Sequence[Told]:
        """What `data` completes: messages, pulses or readings. Raises nothing, whatever comes.

        Args:
            data: empty where nothing came for `SILENCE_S`, so that a pair need not wait for the next.
            arrival_s: when it was read, seconds.
            lay_waiting: the host was late and found the data there, so that nothing is known of a silence before.
        """
        pulses: Sequence[Pulses] = ()
        if self._held and not lay_waiting and self._is_whole(arrival_s):
            pulses = self._judged(self._take_pairs(0))
        if not data:
            return pulses
        self._hold(data, arrival_s, lay_waiting)
        messages = self._frames.feed(data)
        if messages:
            return [*pulses, *self._before_frames(data), *messages]
        readings = self._text.feed(data, arrival_s)
        if self._text.is_recognised:
            self.format = Format.PLAIN
            self._held.clear()
            self._forget_pairs()
        elif self.format is Format.PLAIN:
            self.format = None
        return [*pulses, *readings] if readings else pulses

    def expect_frames(self, is_so: bool) -> None:
        """Whether the controller was told to change to frames: then nothing is read as pairs until they come."""
        self._expects_frames = is_so

    def restart(self) -> None:
        """Forget what is half-read, and the format if it was another than frames: the port was opened anew."""
        self._frames.forget_sequence()
        self._text.restart()
        self._held.clear()
        self._forget_pairs()
        self.format = Format.FRAMED if self.format is Format.FRAMED else None

    def forgive_gap(self, sequence: int) -> None:
        """Take back a loss counted at this frame, or at the one before it: the controller had begun anew."""
        self._frames.forgive_gap(sequence)

    def _is_whole(self, now_s: float) -> bool:
        """Whether what is held can be no frame's beginning any more."""
        if self._expects_frames:
            return False
        return now_s - self._heard_s > SILENCE_S or sum(len(run) for run, _ in self._held) > _MOST_HELD_BYTES

    def _before_frames(self, data: bytes) -> list[Pulses]:
        """Change to frames, or stay with them; the pairs that came before the first of them, if they were pairs."""
        pairs: list[Pulses] = []
        if self.format is Format.PAPER:
            pairs = self._take_pairs(self._frames.begun + 1)  # and the zero that parts frames from pairs
        if self.format in (Format.PAPER, Format.PLAIN):
            self._frames.statistics = LineStatistics(self._frames.begun, 1)
        self._text.restart()
        self.format, self._expects_frames = Format.FRAMED, False
        self._held.clear()
        if self._frames.ended:
            self._held.append((data[-self._frames.ended :], self._heard_s))  # pairs, where the format changed
        self._forget_pairs()
        return pairs

    def _hold(self, data: bytes, arrival_s: float, lay_waiting: bool) -> None:
        if self._held and (lay_waiting or arrival_s - self._heard_s <= SILENCE_S):
            data = self._held.pop()[0] + data
        self._held.append((data, arrival_s))
        self._heard_s = arrival_s

    def _take_pairs(self, but_last: int) -> list[Pulses]:
        """Read the held bytes, but the last so many, as pairs."""
        held, self._held = self._held, []
        pairs: list[Pulses] = []
        count = sum(len(run) for run, _ in held) - but_last
        for run, arrival_s in held:
            if count > 0 and not is_plain_line(run):
                torn = self._paper.torn + self._paper.statistics.malformed
                pairs += self._paper.feed(run[:count], arrival_s)
                if self._paper.torn + self._paper.statistics.malformed > torn:
                    self._torn.append(arrival_s)
            count -= len(run)
        return pairs

    def _judged(self, pairs: list[Pulses]) -> Sequence[Pulses]:
        """What to hand on of pairs just read, by what has come in the last half second."""
        self._evidence += pairs
        if self.format is Format.PAPER:
            if self._may_be_pairs(len(pairs)):
                return pairs
            self.format = None
            self._evidence.clear()
            return ()
        if not self._evidence or self._heard_s - self._evidence[0].arrival_s < EVIDENCE_S:
            return ()
        found = list(self._evidence) if self._is_paired() else []
        if found:
            self.format = Format.PAPER
            self._paper.statistics = LineStatistics(2 * len(found), len(found))
            self._credit, self._judged_s = _MOST_AT_ONCE, self._heard_s
        self._drop_before(self._heard_s - EVIDENCE_S, keep=_FEWEST_PAIRS)
        self._drop_before(self._heard_s - _LONGEST_EVIDENCE_S)
        return found

    def _is_paired(self) -> bool:
        """Whether the evidence is pairs as a controller sends them."""
        pairs = len(self._evidence)
        alone = sum(pair.follows_silence for pair in self._evidence)
        regular = pairs >= _FEWEST_PAIRS and alone >= _SHARE_ALONE * pairs
        return self._is_believable() and regular and len(self._torn) <= _SHARE_TORN * pairs

    def _may_be_pairs(self, count: int) -> bool:
        """Whether `count` more may be pairs too, held up on their way perhaps, or by a busy host."""
        passed_s, self._judged_s = self._heard_s - self._judged_s, self._heard_s
        self._credit = min(self._credit + _MOST_A_SECOND * passed_s, _MOST_AT_ONCE) - count
        self._drop_before(self._heard_s - EVIDENCE_S)
        return self._credit >= 0 and (len(self._evidence) < _FEWEST_DOUBTED or self._is_believable())

    def _is_believable(self) -> bool:
        believable = sum(max(abs(pair.left), abs(pair.right)) <= _MOST_PULSES for pair in self._evidence)
        return believable >= _SHARE_BELIEVABLE * len(self._evidence)

    def _drop_before(self, stamp_s: float, keep: int = 0) -> None:
        while len(self._evidence) > keep and self._evidence[0].arrival_s < stamp_s:
            self._evidence.popleft()
        while self._torn and self._torn[0] < min(stamp_s, self._evidence[0].arrival_s if self._evidence else stamp_s):
            self._torn.popleft()

    def _forget_pairs(self) -> None:
        self._evidence.clear()
        self._torn.clear()
        self._paper.forget()
