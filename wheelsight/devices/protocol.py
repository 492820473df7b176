"""The wheel controller's framed wire format: messages to bytes and back, with no input or output of its own.

A frame is `type, sequence, body, CRC` in little-endian order, COBS-encoded (Cheshire & Baker, *Consistent overhead
byte stuffing*, 1999) so that it holds no zero, and ended by one zero. Whoever loses the thread therefore finds it
again at the next zero. The CRC is CRC-16/CCITT-FALSE. docs/serial-link.md tells every byte.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections import deque
from dataclasses import dataclass
from enum import IntEnum
from struct import Struct
from typing import NamedTuple

from cobs import cobs

FULL_DUTY = 1000
LONGEST_FRAME = 64
_CRC_START = 0xFFFF
_REPEATS_KNOWN = 8


class Command(IntEnum):
    """What the host asks of the controller: the type byte of its frames."""

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
    """What the controller's program calls itself."""

    sequence: int
    protocol: int
    major: int
    minor: int
    flags: int


class Ack(NamedTuple):
    """The controller's answer to a command: its type, its sequence, and 0 where it was done."""

    sequence: int
    command: int
    command_sequence: int
    status: int


Message = Counts | Version | Ack

ACK_PROBLEMS = {1: "does not know the command", 2: "got the command with a wrong length", 3: "refuses the value"}

_ENDS = Struct("<BB")
_CRC = Struct("<H")
_DRIVE = Struct("<hh")
# Of what follows the type byte; the two bytes of the CRC are skipped.
_LAYOUTS: dict[int, tuple[type[Message], Struct]] = {
    0x01: (Counts, Struct("<xBIiixx")),
    0x02: (Version, Struct("<xBBBBBxx")),
    0x03: (Ack, Struct("<xBBBBxx")),
}
_TYPES: dict[type[Message], int] = {kind: number for number, (kind, _) in _LAYOUTS.items()}


def encode_frame(kind: int, sequence: int, body: bytes = b"") -> bytes:
    """A whole frame with its closing zero. `sequence` counts modulo 256."""
    inside = _ENDS.pack(kind, sequence & 0xFF) + body
    encoded: bytes = cobs.encode(inside + _CRC.pack(crc_hqx(inside, _CRC_START)))
    return encoded + b"\0"


def encode_message(message: Message) -> bytes:
    """The frame a controller sends; for simulated controllers and tests."""
    kind = _TYPES[type(message)]
    unsealed = _LAYOUTS[kind][1].pack(*message)
    return encode_frame(kind, message.sequence, unsealed[2:-2])


def encode_command(command: Command, sequence: int, body: bytes = b"") -> bytes:
    """A command's frame, after a zero that ends whatever noise the controller heard before."""
    return b"\0" + encode_frame(command, sequence, body)


def drive_body(left: float, right: float) -> bytes:
    """The body of DRIVE for duties from -1 (full speed back) to 1, in whole permille."""
    return _DRIVE.pack(round(left * FULL_DUTY), round(right * FULL_DUTY))


@dataclass(slots=True)
class LineStatistics:
    """What came over the line, and what of it was no good.

    Attributes:
        bytes: all that were fed.
        frames: good ones, repeats included.
        crc_errors: pieces between two zeros whose checksum is wrong.
        malformed: pieces that are no COBS, too short, too long, or of the wrong length for their type.
        resyncs: how often a good frame came after bad pieces.
        lost: frames missing by the sequence; a multiple of 256 lost in one go does not show.
        duplicates: frames that came again, and were not handed on.
        unknown: good frames of a type that this version does not know.
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
    """Finds the messages in a stream of bytes, however it is cut, and counts what was lost.

    A damaged frame costs itself, and the next one where the zero between them was hit. What comes before the first zero
    may be the end of a frame that began before anybody listened, so it is no error. Memory stays below
    `LONGEST_FRAME` bytes between two calls, whatever comes.

    Attributes:
        statistics: what came, and what was lost.
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
        """The messages that `data` completes, in their order; damage never raises, it is counted."""
        self.statistics.bytes += len(data)
        *pieces, rest = (self._rest + data).split(b"\0")
        left = len(self._rest) + len(data)
        self._rest = rest[: LONGEST_FRAME + 1]  # one byte too long is enough to know that it is no frame
        messages: list[Message] = []
        for piece in pieces:
            left -= len(piece) + 1
            may_be_cut, self._may_be_cut = self._may_be_cut, False
            if may_be_cut and self._checked(piece, LineStatistics()) is None:
                continue  # the rest of a frame that began before anybody listened
            if piece and (message := self._message(piece)) is not None:
                self.begun = self.begun if messages else left + len(piece) + 1
                self.ended = left
                messages.append(message)
        return messages

    def _message(self, piece: bytes) -> Message | None:
        frame = self._checked(piece, self.statistics)
        if frame is None:
            self._is_in_step = False
            return None
        statistics = self.statistics
        statistics.frames += 1
        if not self._is_in_step:
            self._is_in_step = True
            statistics.resyncs += 1
        if not self._is_new(frame):
            statistics.duplicates += 1
            return None
        layout = _LAYOUTS.get(frame[0])
        if layout is None:
            statistics.unknown += 1
            return None
        kind, struct = layout
        return kind(*struct.unpack(frame))

    @staticmethod
    def _checked(piece: bytes, statistics: LineStatistics) -> bytes | None:
        """The frame inside a piece, or None where it is damaged, which is counted."""
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

    def _is_new(self, frame: bytes) -> bool:
        """Whether the frame is no repeat of a recent one; counts the frames missing before it."""
        sequence, last = frame[1], self._sequence
        if last is not None and (step := (sequence - last) & 0xFF) != 1:
            if frame in self._recent:
                return False
            self._gaps[sequence] = (step - 1) & 0xFF
            self.statistics.lost += self._gaps[sequence]
        else:
            self._gaps.pop(sequence, None)
        self._sequence = sequence
        self._recent.append(frame)
        return True

    def forgive_gap(self, sequence: int) -> None:
        """Take back a loss counted at this frame, or at the one before it: the controller had begun anew.

        By its number, since a host that is late is handed frames that came after it together with it.
        """
        for number in (sequence, (sequence - 1) & 0xFF):
            if gap := self._gaps.pop(number, 0):
                self.statistics.lost -= gap
                return

    def forget_sequence(self) -> None:
        """Count no loss before the next frame: the port was opened anew."""
        self._sequence = None
        self._rest = b""
        self._may_be_cut = True
