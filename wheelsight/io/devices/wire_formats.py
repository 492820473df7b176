"""Wire formats of the wheel controller: framed messages, pulse pairs of the paper (Trinh et al., II.C), and plain
text. `LineDecoder` recognises the format.
"""

from __future__ import annotations

import math
import re
from binascii import crc_hqx
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from struct import Struct
from typing import NamedTuple

from cobs import cobs

from wheelsight.core.messages import NearbyReading

# Framed format
#
# A frame is `type, sequence, body, CRC` in little-endian order. COBS encoding (Cheshire & Baker, *Consistent overhead
# byte stuffing*, 1999) removes all zeros from it, and one zero ends it, so that a reader resynchronizes at the next
# zero. The CRC is CRC-16/CCITT-FALSE. See docs/serial-link.md.

FULL_DUTY = 1000
LONGEST_FRAME = 64
_CRC_START = 0xFFFF
_REPEATS_KNOWN = 8


class LinkCommand(IntEnum):
    """Commands of the host: the type byte of its frames."""

    DRIVE = 0x81
    STOP = 0x82
    GET_VERSION = 0x83
    RESET_COUNTS = 0x84
    SET_FORMAT = 0x85


class Counts(NamedTuple):
    """Cumulative pulses of both wheels: raw 32-bit counters at the controller's 32-bit clock, both rolling over."""

    sequence: int
    clock_us: int
    left: int
    right: int


class Version(NamedTuple):
    """The version of the controller's firmware."""

    sequence: int
    protocol: int
    major: int
    minor: int
    flags: int


class Ack(NamedTuple):
    """The controller's answer to a command: its type, its sequence, and a status, 0 for success."""

    sequence: int
    command: int
    command_sequence: int
    status: int


_SOUND_M_S = 343.0  # at 20 °C; 3 % less at 0 °C


class Nearby(NamedTuple):
    """Bumpers, a bit each whose switch is open, and µs of the echoes of four rangers: 0 for none, 65535 for a fault."""

    sequence: int
    bumpers: int
    echo_0_us: int
    echo_1_us: int
    echo_2_us: int
    echo_3_us: int

    def reading(self, stamp_s: float) -> NearbyReading:
        """Return what it says, in metres."""
        ranges = {0: math.inf, 0xFFFF: math.nan}
        echoes = (ranges.get(us, us * 1e-6 * _SOUND_M_S / 2) for us in self[2:])
        return NearbyReading(stamp_s, (bool(self.bumpers & 1), bool(self.bumpers & 2)), tuple(echoes))


Message = Counts | Version | Ack | Nearby

ACK_PROBLEMS = {1: "does not know the command", 2: "got the command with a wrong length", 3: "refuses the value"}

_ENDS = Struct("<BB")
_CRC = Struct("<H")
_DRIVE = Struct("<hh")
# Layouts of the frame after the type byte, without the two bytes of the CRC.
_LAYOUTS: dict[int, tuple[type[Message], Struct]] = {
    0x01: (Counts, Struct("<xBIiixx")),
    0x02: (Version, Struct("<xBBBBBxx")),
    0x03: (Ack, Struct("<xBBBBxx")),
    0x04: (Nearby, Struct("<xBBHHHHxx")),
}
_TYPES: dict[type[Message], int] = {kind: number for number, (kind, _) in _LAYOUTS.items()}


def encode_frame(kind: int, sequence: int, body: bytes = b"") -> bytes:
    """A frame with its closing zero. `sequence` counts modulo 256."""
    inside = _ENDS.pack(kind, sequence & 0xFF) + body
    encoded: bytes = cobs.encode(inside + _CRC.pack(crc_hqx(inside, _CRC_START)))
    return encoded + b"\0"


def encode_message(message: Message) -> bytes:
    """The frame of a controller's message, for simulated controllers and tests."""
    kind = _TYPES[type(message)]
    unsealed = _LAYOUTS[kind][1].pack(*message)
    return encode_frame(kind, message.sequence, unsealed[2:-2])


def encode_command(command: LinkCommand, sequence: int, body: bytes = b"") -> bytes:
    """A command's frame, after a zero that ends any noise before it."""
    return b"\0" + encode_frame(command, sequence, body)


def drive_body(left: float, right: float) -> bytes:
    """The body of DRIVE for duty cycles from -1 (full speed backwards) to 1, in permille."""
    return _DRIVE.pack(round(left * FULL_DUTY), round(right * FULL_DUTY))


@dataclass(slots=True)
class LineStatistics:
    """Counts of bytes, frames and errors of a line.

    Attributes:
        frames: valid frames, repeats included.
        crc_errors: pieces between two zeros with a wrong checksum.
        malformed: pieces that are not valid COBS, or have a wrong length.
        resyncs: valid frames after invalid pieces.
        lost: frames missing by their sequence; a loss of a multiple of 256 is not detected.
        duplicates: repeated frames, which are dropped.
        unknown: valid frames of an unknown type.
    """

    bytes: int = 0
    frames: int = 0
    crc_errors: int = 0
    malformed: int = 0
    resyncs: int = 0
    lost: int = 0
    duplicates: int = 0
    unknown: int = 0


class FrameDecoder:
    """Decodes the messages in a stream of bytes, and counts errors and losses.

    A damaged frame is lost, and the next one too where the zero between them is damaged. Bytes before the first zero
    may be the end of a frame, so they are not errors. At most `LONGEST_FRAME` + 1 bytes are kept between calls.

    Attributes:
        begun, ended: bytes from the first byte of the last call's first message, and from the end of its last message,
            to the end of what was fed.
    """

    def __init__(self) -> None:
        self.statistics = LineStatistics()
        self.begun = self.ended = 0
        self._rest = b""
        self._sequence: int | None = None
        self._recent: deque[bytes] = deque(maxlen=_REPEATS_KNOWN)
        self._is_in_step = True
        self._may_be_cut = True
        self._gaps: dict[int, int] = {}  # frames missing before the last frame of each sequence number

    def feed(self, data: bytes) -> list[Message]:
        """The messages that `data` completes, in order. Damage is counted and does not raise."""
        self.statistics.bytes += len(data)
        *pieces, rest = (self._rest + data).split(b"\0")
        left = len(self._rest) + len(data)
        self._rest = rest[: LONGEST_FRAME + 1]  # one byte too many shows that it is not a frame
        messages: list[Message] = []
        for piece in pieces:
            left -= len(piece) + 1
            may_be_cut, self._may_be_cut = self._may_be_cut, False
            if may_be_cut and self._checked(piece, LineStatistics()) is None:
                continue  # the rest of a frame that began before the first call
            if piece and (message := self._message(piece)) is not None:
                self.begun = self.begun if messages else left + len(piece) + 1
                self.ended = left
                messages.append(message)
        return messages

    def _message(self, piece: bytes) -> Message | None:
        """The message of a piece, or None where it is damaged, repeated or unknown."""
        frame = self._checked(piece, self.statistics)
        if frame is None:
            self._is_in_step = False
            return None
        statistics = self.statistics
        statistics.frames += 1
        if not self._is_in_step:
            self._is_in_step = True
            statistics.resyncs += 1
        sequence, last = frame[1], self._sequence
        if last is not None and (step := (sequence - last) & 0xFF) != 1:
            if frame in self._recent:
                statistics.duplicates += 1
                return None
            self._gaps[sequence] = (step - 1) & 0xFF
            statistics.lost += self._gaps[sequence]
        else:
            self._gaps.pop(sequence, None)
        self._sequence = sequence
        self._recent.append(frame)
        layout = _LAYOUTS.get(frame[0])
        if layout is None:
            statistics.unknown += 1
            return None
        kind, struct = layout
        return kind(*struct.unpack(frame))

    @staticmethod
    def _checked(piece: bytes, statistics: LineStatistics) -> bytes | None:
        """The frame in a piece, or None where it is damaged, which is counted."""
        if len(piece) > LONGEST_FRAME:
            statistics.malformed += 1
            return None
        try:
            frame = cobs.decode(piece)
        except cobs.DecodeError:
            statistics.malformed += 1
            return None
        if len(frame) < 4:
            statistics.malformed += 1
            return None
        if crc_hqx(frame[:-2], _CRC_START) != frame[-2] | frame[-1] << 8:
            statistics.crc_errors += 1
            return None
        layout = _LAYOUTS.get(frame[0])
        if layout is not None and layout[1].size != len(frame):
            statistics.malformed += 1
            return None
        return bytes(frame)

    def forgive_gap(self, sequence: int) -> None:
        """Remove a loss that was counted at this frame, or at the one before it: the controller restarted.

        The frame is given by its number, since a late host gets later frames together with it.
        """
        for number in (sequence, (sequence - 1) & 0xFF):
            if gap := self._gaps.pop(number, 0):
                self.statistics.lost -= gap
                return

    def forget_sequence(self) -> None:
        """Do not count a loss before the next frame, after the port was reopened."""
        self._sequence = None
        self._rest = b""
        self._may_be_cut = True


# The paper's format: two bytes every 20 ms, the right and left wheel's signed pulse counts (Trinh et al., II.C)
#
# A byte holds 127 pulses, which at 0.3338 mm per pulse and 20 ms is 2.1 m/s; at the paper's top speed there are 157.
# The controller therefore sends early once a count reaches 100, and no pulse is lost. The bytes do not show which one
# of a pair comes first; only the silence between pairs does.

SILENCE_S = 0.005
FULL_PULSES = 100  # at this count a pair is sent early
_LATEST_PARTNER_S = 1.0


class Pulses(NamedTuple):
    """Pulses of both wheels since the last pair, and their arrival.

    Attributes:
        follows_silence: whether the line was silent before the pair.
        following: the number of pairs after it in the same run of bytes.
    """

    arrival_s: float
    left: int
    right: int
    follows_silence: bool
    following: int = 0


class PaperDecoder:
    """Pairs bytes by the silence between pairs.

    A single byte at the end of a run waits for the next run. Where that is odd too, it begins with the delayed partner;
    else the partner was lost, and the byte is dropped and counted. Several pairs in one run, after a delay of the host,
    are split in order. In `statistics`, `frames` are pairs and `malformed` are bytes without a partner. The format has
    no sequence, so lost pairs are not detected.

    Attributes:
        torn: the number of pairs with a delayed second byte.
    """

    def __init__(self) -> None:
        self.statistics = LineStatistics()
        self.torn = 0
        self._first = b""
        self._arrival_s = -float("inf")

    def feed(self, run: bytes, arrival_s: float) -> list[Pulses]:
        """The pairs that a run of bytes completes, with a silence before and after it. Does not raise.

        Args:
            run: at least one byte.
            arrival_s: when the last byte was read, seconds.
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
        """Drop a byte that waits for its partner, before another stream."""
        self._first = b""


def _signed(byte: int) -> int:
    return byte - 256 if byte > 127 else byte


# Plain text: lines `left,right` or `time,left,right` of integers
#
# Fields are separated by commas, semicolons, spaces or tabs; lines end with CR, LF or both. Counts are cumulative,
# signed or not. Time is in milliseconds or microseconds; the host's clock shows which. There is no checksum: the format
# is recognised from several lines, and `PlainTracker` validates readings.

US_PER_MS = 1000
_LONGEST_LINE = 64
_LONGEST_QUOTE = 40
_SEPARATOR = rb"(?:[ \t]*[,;][ \t]*|[ \t]+)"
_COUNT = rb"([+-]?[0-9]{1,10})"
_LINE = re.compile(rb"[ \t]*(?:(\+?[0-9]{1,19})" + _SEPARATOR + rb")?" + _COUNT + _SEPARATOR + _COUNT + rb"[ \t]*")
_PLAIN_TEXT_ENDS = re.compile(rb"[\r\n]+")
_TEXT = re.compile(rb"[\t\x20-\x7e]*")
_SMALLEST, _LARGEST = -(1 << 31), (1 << 32) - 1


# When lines of text count as readings: this many lines of counts over this time, and at least this share of all lines.
# A sketch may print one other line for each line of counts; two lines a second are the slowest.
_FEWEST_LINES, _FEWEST_SHARE = 5, 0.5
_TEXT_EVIDENCE_S, _LONGEST_TEXT_EVIDENCE_S = 0.5, 5.0
# Largest drift of a printed time against the host's, over the evidence. A resonator errs by 0.5 %; a line that is read
# 50 ms late is 10 % of half a second. Milliseconds and microseconds differ by 1000.
_LARGEST_DRIFT = 0.1
_LOST_AFTER_S = 3.0  # without a line of counts among other lines, recognition starts again


class PlainReading(NamedTuple):
    """A line of counts, as printed.

    Attributes:
        arrival_s: when its end was read, seconds.
        clock: as printed, or None where the line has no time.
        us_per_tick: the unit of `clock` in microseconds; 0 where it is unknown.
        following: the number of lines of counts after it in the same read.
    """

    arrival_s: float
    clock: int | None
    left: int
    right: int
    us_per_tick: int = 0
    following: int = 0


def parse_line(line: bytes, arrival_s: float) -> PlainReading | None:
    """The counts of a line, given without its end, or None where it has none."""
    match = _LINE.fullmatch(line) if len(line) <= _LONGEST_LINE else None
    if match is None:
        return None
    clock, left, right = (None if field is None else int(field) for field in match.groups())
    if left is None or right is None or min(left, right) < _SMALLEST or max(left, right) > _LARGEST:
        return None
    return PlainReading(arrival_s, clock, left, right)


def is_plain_line(run: bytes) -> bool:
    """Whether bytes between two silences are whole lines of counts, and therefore not pairs."""
    lines = [line for line in _PLAIN_TEXT_ENDS.split(run) if line]
    return run.endswith((b"\r", b"\n")) and bool(lines) and all(parse_line(line, 0.0) for line in lines)


class PlainText:
    """Recognises and parses lines of counts in a stream of bytes. The first line is incomplete and ignored.

    In `statistics`, `frames` are lines of counts and `malformed` are all others.

    Attributes:
        statistics: of the line, since the first recognised reading.
        other: the last line without counts, for display.
    """

    def __init__(self) -> None:
        self.statistics = LineStatistics()
        self.is_recognised = False
        self.other = ""
        self._rest = b""
        self._is_torn = True
        self._evidence: deque[tuple[float, PlainReading | None]] = deque(maxlen=4096)
        self._has_time = False
        self._us_per_tick = 0
        self._good_s = 0.0
        self._others = self._texts = 0  # lines since the last of counts; printable ones in a row

    @property
    def is_text(self) -> bool:
        """Whether recent lines are text without counts."""
        return not self.is_recognised and self._texts >= _FEWEST_LINES

    def feed(self, data: bytes, arrival_s: float) -> list[PlainReading]:
        """The readings that `data` completes; none before recognition, which then returns earlier ones too."""
        self.statistics.bytes += len(data)
        readings: list[PlainReading] = []
        *lines, rest = _PLAIN_TEXT_ENDS.split(self._rest + data)
        if lines and self._is_torn:
            lines[0], self._is_torn = b"", False
        self._is_torn |= len(rest) > _LONGEST_LINE
        self._rest = b"" if self._is_torn else rest
        for line in filter(None, lines):
            readings += self._read(line, arrival_s)
        if self._others >= _FEWEST_LINES and arrival_s - self._good_s > _LOST_AFTER_S:
            self.is_recognised = False
        return [
            reading._replace(
                us_per_tick=self._us_per_tick, following=sum(r.arrival_s == reading.arrival_s for r in later)
            )
            for n, reading in enumerate(readings)
            for later in [readings[n + 1 :]]
        ]

    def restart(self) -> None:
        """Reset all state, after the port was reopened or the format changed."""
        self._rest, self._is_torn, self.is_recognised, self.other = b"", True, False, ""
        self._others = self._texts = 0
        self._evidence.clear()

    def _read(self, line: bytes, arrival_s: float) -> list[PlainReading]:
        """The readings that a line completes. Counts other lines."""
        reading = parse_line(line, arrival_s)
        if self.is_recognised and reading is not None and (reading.clock is not None) is self._has_time:
            self.statistics.frames += 1
            self._good_s, self._others = arrival_s, 0
            return [reading]
        self.statistics.malformed += 1
        self._others += 1
        is_text = _TEXT.fullmatch(line) is not None
        self._texts = self._texts + 1 if is_text else 0
        if is_text and (reading is None or self.is_recognised):
            self.other = line[:_LONGEST_QUOTE].decode("ascii")
        return [] if self.is_recognised else self._recognise(reading, arrival_s)

    def _recognise(self, reading: PlainReading | None, arrival_s: float) -> list[PlainReading]:
        """The readings so far, once they suffice to recognise the format; else an empty list."""
        self._evidence.append((arrival_s, reading))
        while self._evidence[0][0] < arrival_s - _LONGEST_TEXT_EVIDENCE_S:
            self._evidence.popleft()
        if reading is None:
            return []
        has_time = reading.clock is not None
        alike = [one for _, one in self._evidence if one is not None and (one.clock is not None) is has_time]
        if len(alike) < max(_FEWEST_LINES, _FEWEST_SHARE * len(self._evidence)):
            return []
        if alike[-1].arrival_s - alike[0].arrival_s < _TEXT_EVIDENCE_S:
            return []
        self._us_per_tick = _unit_us(alike) if has_time else 0
        if has_time and not self._us_per_tick:
            return []
        self.is_recognised, self._has_time, self._good_s = True, has_time, arrival_s
        self._others = self._texts = 0
        self.statistics = LineStatistics(0, len(alike), malformed=len(self._evidence) - len(alike))
        self._evidence.clear()
        return alike


def _unit_us(readings: list[PlainReading]) -> int:
    """The unit of the lines' time in microseconds, 1000 or 1; 0 where neither agrees with the host's clock."""
    first, last = readings[0], readings[-1]
    assert first.clock is not None
    assert last.clock is not None
    passed_us = 1e6 * (last.arrival_s - first.arrival_s)
    for us_per_tick in (US_PER_MS, 1):
        if abs((last.clock - first.clock) * us_per_tick - passed_us) <= _LARGEST_DRIFT * passed_us:
            return us_per_tick
    return 0


# Recognition of the format

EVIDENCE_S = 0.5
_LONGEST_EVIDENCE_S = 3.0
_FEWEST_PAIRS = 15
_MOST_A_SECOND = 300
_MOST_AT_ONCE = 2048  # the size of a system's buffer, for a host that was delayed
_MOST_PULSES = 110
_SHARE_ALONE = 0.6
_SHARE_PLAUSIBLE = 0.9
_SHARE_TORN = 0.2
_FEWEST_DOUBTED = 10
_MOST_KEPT = 400
_MOST_HELD_BYTES = 1024


class Format(StrEnum):
    """The wire formats."""

    FRAMED = "framed"
    PAPER = "paper"
    PLAIN = "plain text"


Decoded = Message | Pulses | PlainReading


class LineDecoder:
    """Recognises the format, decodes it, and follows a change of it.

    - Framed: one frame with a valid checksum. It stays framed.
    - Paper: half a second of pairs (three seconds for few pairs), each after a silence, with no more pulses than make a
      controller send early. The pulses of this time are returned, so that none is lost.
    - Plain text: lines with two or three integers for half a second or more (`PlainText`).

    Everything else is noise. Bytes are read as pairs only after the silence that follows them, since they might begin
    a frame. Without a silence, the bytes before the first frame are pairs. The paper's format ends with a frame, or
    with data that delayed pairs cannot explain: too many pulses or pairs. Plain text ends with a frame, or after a few
    seconds without lines of counts.
    """

    def __init__(self) -> None:
        self.format: Format | None = None
        self._frames = FrameDecoder()
        self._paper = PaperDecoder()
        self._text = PlainText()
        self._held: list[tuple[bytes, float]] = []  # runs of bytes between silences, and when the last of each came
        self._received_s = -float("inf")
        self._expects_frames = False
        self._evidence: deque[Pulses] = deque(maxlen=_MOST_KEPT)
        self._torn: deque[float] = deque(maxlen=_MOST_KEPT)
        self._credit, self._judged_s = 0.0, 0.0

    @property
    def statistics(self) -> LineStatistics:
        """The statistics of the recognised format; of frames before that."""
        if self.format is Format.PLAIN:
            return self._text.statistics
        return self._paper.statistics if self.format is Format.PAPER else self._frames.statistics

    @property
    def is_text(self) -> bool:
        """Whether no format is recognised, and the line has text without counts."""
        return self._text.is_text

    @property
    def other_line(self) -> str:
        """The last line of text without counts; may be empty."""
        return self._text.other if self.format in (None, Format.PLAIN) else ""

    def feed(self, data: bytes, arrival_s: float, was_waiting: bool = False) -> Sequence[Decoded]:
        """The messages, pulses or readings that `data` completes. Does not raise.

        Args:
            data: empty after a silence of `SILENCE_S`, which completes a pair.
            arrival_s: when it was read, seconds.
            was_waiting: whether the data had arrived before the host read, so that a silence before it is unknown.
        """
        pulses: Sequence[Pulses] = ()
        if self._held and not was_waiting and not self._expects_frames:
            # Later bytes do not complete a frame with the held ones.
            is_silent = arrival_s - self._received_s > SILENCE_S
            if is_silent or sum(len(run) for run, _ in self._held) > _MOST_HELD_BYTES:
                pulses = self._filtered(self._take_pairs(0))
        if not data:
            return pulses
        # Keep bytes that may be pairs, as a run of their own after a silence.
        run = data
        if self._held and (was_waiting or arrival_s - self._received_s <= SILENCE_S):
            run = self._held.pop()[0] + data
        self._held.append((run, arrival_s))
        self._received_s = arrival_s
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
        """Set whether a change to frames was commanded. Then no pairs are read before a frame comes."""
        self._expects_frames = is_so

    def restart(self) -> None:
        """Reset after the port was reopened. The format stays if it is framed."""
        self._frames.forget_sequence()
        self._text.restart()
        self._held.clear()
        self._forget_pairs()
        self.format = Format.FRAMED if self.format is Format.FRAMED else None

    def forgive_gap(self, sequence: int) -> None:
        """As `FrameDecoder.forgive_gap`."""
        self._frames.forgive_gap(sequence)

    def _before_frames(self, data: bytes) -> list[Pulses]:
        """Set the format to framed. Returns the pairs before the first frame, after the paper's format."""
        pairs: list[Pulses] = []
        if self.format is Format.PAPER:
            pairs = self._take_pairs(self._frames.begun + 1)  # and the zero between pairs and frames
        if self.format in (Format.PAPER, Format.PLAIN):
            self._frames.statistics = LineStatistics(self._frames.begun, 1)
        self._text.restart()
        self.format, self._expects_frames = Format.FRAMED, False
        self._held.clear()
        if self._frames.ended:
            self._held.append((data[-self._frames.ended :], self._received_s))  # pairs, where the format changed
        self._forget_pairs()
        return pairs

    def _take_pairs(self, but_last: int) -> list[Pulses]:
        """The held bytes without the last `but_last`, as pairs."""
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

    def _filtered(self, pairs: list[Pulses]) -> Sequence[Pulses]:
        """The pairs to return, given new ones: those of the paper's format, or of its evidence at recognition."""
        self._evidence += pairs
        if self.format is Format.PAPER:
            # The credit allows for delays of the transport and the host.
            passed_s, self._judged_s = self._received_s - self._judged_s, self._received_s
            self._credit = min(self._credit + _MOST_A_SECOND * passed_s, _MOST_AT_ONCE) - len(pairs)
            self._drop_before(self._received_s - EVIDENCE_S)
            if self._credit >= 0 and (len(self._evidence) < _FEWEST_DOUBTED or self._is_plausible()):
                return pairs
            self.format = None
            self._evidence.clear()
            return ()
        if not self._evidence or self._received_s - self._evidence[0].arrival_s < EVIDENCE_S:
            return ()
        found = list(self._evidence)
        alone = sum(pair.follows_silence for pair in found)
        regular = len(found) >= _FEWEST_PAIRS and alone >= _SHARE_ALONE * len(found)
        if not (self._is_plausible() and regular and len(self._torn) <= _SHARE_TORN * len(found)):
            found = []
        if found:
            self.format = Format.PAPER
            self._paper.statistics = LineStatistics(2 * len(found), len(found))
            self._credit, self._judged_s = _MOST_AT_ONCE, self._received_s
        self._drop_before(self._received_s - EVIDENCE_S, keep=_FEWEST_PAIRS)
        self._drop_before(self._received_s - _LONGEST_EVIDENCE_S)
        return found

    def _is_plausible(self) -> bool:
        """Whether nearly all pairs of the evidence have plausible pulses."""
        plausible = sum(max(abs(pair.left), abs(pair.right)) <= _MOST_PULSES for pair in self._evidence)
        return plausible >= _SHARE_PLAUSIBLE * len(self._evidence)

    def _drop_before(self, stamp_s: float, keep: int = 0) -> None:
        while len(self._evidence) > keep and self._evidence[0].arrival_s < stamp_s:
            self._evidence.popleft()
        while self._torn and self._torn[0] < min(stamp_s, self._evidence[0].arrival_s if self._evidence else stamp_s):
            self._torn.popleft()

    def _forget_pairs(self) -> None:
        self._evidence.clear()
        self._torn.clear()
        self._paper.forget()
