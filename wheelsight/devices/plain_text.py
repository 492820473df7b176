"""The plain line that anybody's sketch prints: `left,right` or `time,left,right`, one line a reading, in whole numbers.

Fields are separated by commas, semicolons, spaces or tabs; lines end with CR, LF or both. Counts are cumulative and
signed or not; time is in milliseconds or microseconds, which the host's clock tells. There is no checksum, so that a
line is recognised by many like it, and readings are doubted by `PlainTracker`.
"""

from __future__ import annotations

import re
from collections import deque
from typing import NamedTuple

from wheelsight.devices.protocol import LineStatistics
from wheelsight.settings import CHOSEN, Settings, setting

US_PER_MS = 1000
_LONGEST_LINE = 64
_LONGEST_QUOTE = 40
_SEPARATOR = rb"(?:[ \t]*[,;][ \t]*|[ \t]+)"
_COUNT = rb"([+-]?[0-9]{1,10})"
_LINE = re.compile(rb"[ \t]*(?:(\+?[0-9]{1,19})" + _SEPARATOR + rb")?" + _COUNT + _SEPARATOR + _COUNT + rb"[ \t]*")
_ENDS = re.compile(rb"[\r\n]+")
_TEXT = re.compile(rb"[\t\x20-\x7e]*")
_SMALLEST, _LARGEST = -(1 << 31), (1 << 32) - 1


class PlainTextSettings(Settings):
    """When lines of text are taken for counts, and which of them are doubted."""

    evidence_s: float = setting(0.5, "for which lines must have come before they are counts, seconds", CHOSEN, gt=0)
    longest_evidence_s: float = setting(5.0, "within which they must have come, seconds", CHOSEN, gt=0)
    fewest_lines: int = setting(5, "lines of counts that are enough; two a second are the slowest", CHOSEN, ge=3)
    fewest_share: float = setting(
        0.5, "of all lines, so that a sketch may print a line of other text for each of counts", CHOSEN, gt=0, le=1
    )
    largest_drift: float = setting(
        0.1,
        "by which a time may run otherwise than the host's, over the evidence; a resonator errs by 0.5 %, and a line "
        "that is read 50 ms late makes 10 % of half a second. Milliseconds and microseconds differ by 1000",
        CHOSEN,
        gt=0,
        lt=0.5,
    )
    given_up_s: float = setting(
        3.0, "without a line of counts among others, until they are looked for anew", CHOSEN, gt=0
    )
    slack_counts: int = setting(
        8,
        "by which a count may be off what it was expected to be and is believed at once: a digit that is lost changes "
        "a number of two digits or more by 9 at least",
        "reckoned from the digits",
        ge=0,
    )
    slack_share: float = setting(
        0.5, "of the motion from line to line, by which it may be off besides: wheels gain speed", CHOSEN, ge=0, le=1
    )
    gain_counts: int = setting(
        64, "by which a count may be off, and is believed with the next line that moves on from it", CHOSEN, ge=0
    )
    gain_counts_per_s2: float = setting(
        20_000,
        "that much besides for each second squared between lines: 1 m/s² at 16 000 counts a metre, and some more",
        "reckoned from an encoder of 5000 lines on a wheel of 0.2 m radius",
        ge=0,
    )
    gain_share: float = setting(2.0, "of the motion from line to line besides", CHOSEN, ge=0)
    longest_gap_s: float = setting(
        0.5, "between lines, over which speed is believed to be gained; a board boots for longer", CHOSEN, gt=0
    )
    confirming_lines: int = setting(
        4,
        "that must follow from each other before a jump is a restart, or motion after all; two torn alike are chance",
        "found on damaged lines alone",
        ge=2,
    )


class PlainReading(NamedTuple):
    """A line of counts, as printed.

    Attributes:
        arrival_s: when its end was read, seconds.
        clock: as printed, or None where the line has no time.
        us_per_tick: what one of `clock` is, microseconds; 0 until that is known.
        following: how many lines of counts came behind it in the same read.
    """

    arrival_s: float
    clock: int | None
    left: int
    right: int
    us_per_tick: int = 0
    following: int = 0


def parse_line(line: bytes, arrival_s: float) -> PlainReading | None:
    """The counts of a line without its end, or None where it is none."""
    match = _LINE.fullmatch(line) if len(line) <= _LONGEST_LINE else None
    if match is None:
        return None
    clock, left, right = (None if field is None else int(field) for field in match.groups())
    if left is None or right is None or min(left, right) < _SMALLEST or max(left, right) > _LARGEST:
        return None
    return PlainReading(arrival_s, clock, left, right)


def is_plain_line(run: bytes) -> bool:
    """Whether bytes between two silences are whole lines of counts, and hence no pairs."""
    lines = [line for line in _ENDS.split(run) if line]
    return run.endswith((b"\r", b"\n")) and bool(lines) and all(parse_line(line, 0.0) for line in lines)


class PlainText:
    """Recognises lines of counts in a stream of bytes, and reads them; what is before the first line's end is torn.

    In `statistics`, `frames` are lines of counts and `malformed` are all others.

    Attributes:
        statistics: what came, from the first line of the evidence on.
        is_recognised: whether lines are taken for counts.
        other: the last line that was none, to be shown.
    """

    def __init__(self, settings: PlainTextSettings | None = None) -> None:
        self.statistics = LineStatistics()
        self.is_recognised = False
        self.other = ""
        self._settings = settings or PlainTextSettings()
        self._rest = b""
        self._is_torn = True
        self._evidence: deque[tuple[float, PlainReading | None]] = deque(maxlen=4096)
        self._has_time = False
        self._us_per_tick = 0
        self._good_s = 0.0
        self._others = self._texts = 0  # lines since the last of counts; printable ones in a row

    @property
    def is_text(self) -> bool:
        """Whether what came lately is text, though no counts."""
        return not self.is_recognised and self._texts >= self._settings.fewest_lines

    def feed(self, data: bytes, arrival_s: float) -> list[PlainReading]:
        """The readings that `data` completes: none before they are recognised, then those of the evidence too."""
        self.statistics.bytes += len(data)
        readings: list[PlainReading] = []
        for line in self._lines(data):
            readings += self._read(line, arrival_s)
        settings = self._settings
        if self._others >= settings.fewest_lines and arrival_s - self._good_s > settings.given_up_s:
            self.is_recognised = False
        return [
            reading._replace(us_per_tick=self._us_per_tick, following=_behind(readings, n))
            for n, reading in enumerate(readings)
        ]

    def restart(self) -> None:
        """Forget what is half-read and what was recognised: the port was opened anew, or speaks otherwise."""
        self._rest, self._is_torn, self.is_recognised, self.other = b"", True, False, ""
        self._others = self._texts = 0
        self._evidence.clear()

    def _lines(self, data: bytes) -> list[bytes]:
        """The whole lines, without those that are empty."""
        *lines, rest = _ENDS.split(self._rest + data)
        if lines and self._is_torn:
            lines[0], self._is_torn = b"", False
        self._is_torn |= len(rest) > _LONGEST_LINE
        self._rest = b"" if self._is_torn else rest
        return [line for line in lines if line]

    def _read(self, line: bytes, arrival_s: float) -> list[PlainReading]:
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
        return [] if self.is_recognised else self._weigh(reading, arrival_s)

    def _weigh(self, reading: PlainReading | None, arrival_s: float) -> list[PlainReading]:
        """The readings so far, if with this line they are enough to be taken for counts."""
        settings = self._settings
        self._evidence.append((arrival_s, reading))
        while self._evidence[0][0] < arrival_s - settings.longest_evidence_s:
            self._evidence.popleft()
        if reading is None:
            return []
        has_time = reading.clock is not None
        alike = [told for _, told in self._evidence if told is not None and (told.clock is not None) is has_time]
        if len(alike) < max(settings.fewest_lines, settings.fewest_share * len(self._evidence)):
            return []
        if alike[-1].arrival_s - alike[0].arrival_s < settings.evidence_s:
            return []
        self._us_per_tick = self._unit_of(alike) if has_time else 0
        if has_time and not self._us_per_tick:
            return []
        self.is_recognised, self._has_time, self._good_s = True, has_time, arrival_s
        self._others = self._texts = 0
        self.statistics = LineStatistics(0, len(alike), malformed=len(self._evidence) - len(alike))
        self._evidence.clear()
        return alike

    def _unit_of(self, readings: list[PlainReading]) -> int:
        """Microseconds of a tick of the lines' time: 1000 or 1; 0 where neither fits the host's clock."""
        first, last = readings[0], readings[-1]
        assert first.clock is not None
        assert last.clock is not None
        passed_us = 1e6 * (last.arrival_s - first.arrival_s)
        for us_per_tick in (US_PER_MS, 1):
            if abs((last.clock - first.clock) * us_per_tick - passed_us) <= self._settings.largest_drift * passed_us:
                return us_per_tick
        return 0


def _behind(readings: list[PlainReading], at: int) -> int:
    """How many of the readings behind one came with it."""
    return sum(reading.arrival_s == readings[at].arrival_s for reading in readings[at + 1 :])
