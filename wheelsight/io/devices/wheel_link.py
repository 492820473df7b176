"""`WheelLink` connects to a wheel controller: a thread owns the serial port, decodes ticks, and repeats commands until
the controller confirms them.
"""

from __future__ import annotations

import atexit
import errno
import math
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from operator import contains
from pathlib import Path

from serial import Serial, SerialException, SerialTimeoutException
from serial.tools.list_ports import comports

from wheelsight.core.errors import DeviceError
from wheelsight.core.messages import NearbyReading, WheelTicks
from wheelsight.core.threads import Closing
from wheelsight.io.devices import host_clock
from wheelsight.io.devices.tick_tracking import TickTracker
from wheelsight.io.devices.wire_formats import (
    ACK_PROBLEMS,
    Ack,
    Counts,
    Format,
    LineDecoder,
    LineStatistics,
    LinkCommand,
    Nearby,
    PlainReading,
    Pulses,
    Version,
    drive_body,
    encode_command,
)

BAUDRATE = 115200
_QUIET_S = 1.0
_RETRY_S = 0.2
_MOST_QUEUED = 1 << 16
_NOW_S = 1e-9  # rounding of simulated time


class LinkStatus(StrEnum):
    """The state of the line to the controller."""

    LISTENING = "listening"
    CONNECTED = "connected"
    NO_DATA = "no data: is the controller powered and wired?"
    NOISE = "noise: wrong baud rate?"
    TEXT = "text without counts: print left,right or time,left,right, one line a reading"
    VANISHED = "the port vanished: waiting for it"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class LinkReport:
    """The state of a link at one moment.

    Attributes:
        status, format: of the line; the format is None until it was recognised.
        line: bytes, frames, errors and losses since the format was recognised.
        restarts, refused: as `TickTracker` counts them.
        overrun: ticks dropped because they were not fetched.
        drift_ppm: of the controller's clock against the host's; positive where it runs faster.
        last: the newest ticks, or None.
        version: of the controller's firmware, or None before it was read.
        other_line: the last line of text that is not counts, or "".
    """

    status: LinkStatus
    format: Format | None
    line: LineStatistics
    restarts: int
    refused: int
    reconnects: int
    overrun: int
    drift_ppm: float
    last: WheelTicks | None
    version: Version | None
    other_line: str = ""


@dataclass(frozen=True, slots=True)
class LinkHost:
    """Clock and ports of the computer that a link runs on.

    Attributes:
        now_s: returns monotonic seconds.
        unix_offset_s: returns the seconds from 1970 to zero of `now_s`.
        open_port: opens a port by name and baud rate, as `open_port`.
        advance: of simulated time: lets a short time pass, at most until a time. The link then has no thread, and who
            waits for it advances. None for real time.
    """

    now_s: Callable[[], float] = time.monotonic
    unix_offset_s: Callable[[], float] = host_clock.unix_offset_s
    open_port: Callable[[str, int], Serial] = lambda path, baudrate: open_port(path, baudrate)
    advance: Callable[[float], None] | None = None


REAL_HOST = LinkHost()


class WheelLink(Closing):
    """The serial line to a wheel controller. Use it in a `with` block.

    It sends nothing before the first command, so an unknown device receives nothing. Stamps are the times of the counts
    by the host clock, plus the smallest delay of the transport; see `host_clock`.

    Args:
        port: such as /dev/ttyUSB0, or better /dev/serial/by-id/…, which does not change when it is plugged in again.
        on_status: called with each new status, from the link's thread.
        host: the computer, also a simulated one.

    Raises:
        DeviceError: the port is missing, denied, in use by another program, or not a serial port.
    """

    def __init__(
        self,
        port: str,
        baudrate: int = BAUDRATE,
        on_status: Callable[[LinkStatus], None] | None = None,
        *,
        host: LinkHost = REAL_HOST,
    ) -> None:
        self.port, self.baudrate, self.host = str(port), baudrate, host
        self._on_status = on_status
        self.status = LinkStatus.LISTENING
        self._decoder, self._tracker = LineDecoder(), TickTracker()
        self._ticks: queue.Queue[WheelTicks | None] = queue.Queue(_MOST_QUEUED)
        self._last: WheelTicks | None = None
        self.nearby: NearbyReading | None = None  # the newest; stamped when it came
        self._reconnects = self._overrun = 0
        self._serial: Serial | None = host.open_port(self.port, baudrate)
        self._commands = Commands(self.port, self._write, host.now_s)
        self._unix_s = host.unix_offset_s()
        self._opened_s = self._received_s = self._decoded_s = host.now_s()
        self._is_closing = threading.Event()
        if host.advance is not None:
            self._commands.wait = self._advance
            return
        self._thread = threading.Thread(target=self._run, name=f"wheel link {self.port}", daemon=True)
        atexit.register(self.close)
        self._thread.start()

    def ticks(self) -> Iterator[WheelTicks]:
        """Ticks as they come, until the link is closed. Waits for them, also while the port is gone."""
        while (ticks := self._ticks.get()) is not None:
            yield ticks
        self._ticks.put(None)  # ends other and later loops too

    def read(self, timeout_s: float) -> WheelTicks | None:
        """The next ticks, or None if none come within `timeout_s` seconds or the link is closed."""
        if self.host.advance is not None:
            self._advance(lambda: not self._ticks.empty(), timeout_s)
            timeout_s = 0.0
        try:
            ticks = self._ticks.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if ticks is None:
            self._ticks.put(None)
        return ticks

    def drive(self, left: float, right: float, hold_s: float | None = None) -> None:
        """Set both motors' duty cycles and repeat them at 20 Hz until the next command.

        The motors stop when the link is closed, the program ends, or the port vanishes. When the program dies, the
        controller stops them a quarter of a second later.

        Args:
            left, right: duty cycle of each motor, -1 (full speed backwards) to 1.
            hold_s: stop after this time without another call, for programs that may hang; None for no limit.

        Raises:
            DeviceError: a duty cycle is out of range, the port is gone, or the controller takes no commands.
        """
        self._need_commands()
        self._commands.drive(left, right, hold_s)

    def stop(self) -> None:
        """Stop both motors. Waits for the confirmation, except in the paper's format, which has none.

        Raises DeviceError where the port is gone, or the controller does not confirm, or takes no commands.
        """
        self._need_commands()
        self._commands.forget_drive()
        self._commands.ask(LinkCommand.STOP, is_answered=self._is_answering)

    def ask_version(self) -> Version:
        """The version of the controller's firmware. Raises DeviceError where it does not answer."""
        self._need_commands()
        if not self._is_answering:
            raise DeviceError(
                "the controller speaks the paper's format, which has no answers",
                path=self.port,
                fix="set_format(Format.FRAMED) first",
            )
        return self._commands.ask_version()

    def reset_counts(self) -> None:
        """Set the controller's counters to zero; `ticks` stay continuous. Raises DeviceError as `stop`."""
        self._need_commands()
        self._tracker.expect_reset(True)
        try:
            self._commands.ask(LinkCommand.RESET_COUNTS, is_answered=self._is_answering)
        except DeviceError:
            self._tracker.expect_reset(False)
            raise

    def set_format(self, wanted: Format) -> None:
        """Switch the controller to a wire format, without loss of pulses. Raises DeviceError as `stop`."""
        self._need_commands()
        if wanted is Format.PLAIN:
            raise DeviceError(
                "no controller changes to plain text", path=self.port, fix="write a sketch that prints it"
            )
        is_paper = wanted is Format.PAPER
        self._decoder.expect_frames(not is_paper)
        try:
            # A change is always confirmed, since one of the formats has frames.
            self._commands.ask(LinkCommand.SET_FORMAT, bytes([is_paper]), self._is_answering or not is_paper)
        except DeviceError:
            self._decoder.expect_frames(False)
            if not (is_paper and self._decoder.format is wanted and self.status is LinkStatus.CONNECTED):
                raise  # else it used this format already, and had nothing to confirm

    def _need_commands(self) -> None:
        """Raise DeviceError where the controller takes no commands."""
        if self._decoder.format is Format.PLAIN:
            raise DeviceError(
                "the controller prints plain text, and takes no commands",
                path=self.port,
                fix="give it a program with frames: docs/firmware.md",
            )

    @property
    def _is_answering(self) -> bool:
        return self._decoder.format is not Format.PAPER

    def report(self) -> LinkReport:
        """The state of the link, with its counts."""
        tracker = self._tracker
        return LinkReport(
            status=self.status,
            format=self._decoder.format,
            line=replace(self._decoder.statistics),
            restarts=tracker.restarts,
            refused=tracker.refused,
            reconnects=self._reconnects,
            overrun=self._overrun,
            drift_ppm=tracker.drift_ppm,
            last=self._last,
            version=self._commands.version,
            other_line=self._decoder.other_line,
        )

    def close(self) -> None:
        """Stop the motors if they were driven, and release the port; may be called twice."""
        self._is_closing.set()
        if self.host.advance is not None:
            self._end()
            return
        if self._thread is not threading.current_thread():
            self._thread.join()
        atexit.unregister(self.close)

    def _run(self) -> None:
        """The thread: read, and repeat the motors' command, until closed."""
        try:
            while not self._is_closing.is_set():
                try:
                    self._step()
                except (SerialException, OSError):
                    self._wait_for_port()
        finally:
            self._end()

    def _end(self) -> None:
        """Stop the motors if they were driven, close the port, and end the ticks."""
        self._commands.end()
        if self._serial is not None:
            self._serial.close()
        self._set_status(LinkStatus.CLOSED)
        self._put(None)

    def _advance(self, is_done: Callable[[], bool], timeout_s: float) -> None:
        """Let simulated time pass until `is_done`, and handle what arrives meanwhile."""
        assert self.host.advance is not None
        until_s = self.host.now_s() + timeout_s
        while not is_done() and not self._is_closing.is_set() and self.host.now_s() < until_s - _NOW_S:
            self.host.advance(until_s)
            self._step()

    def _step(self) -> None:
        """Read and decode, repeat the motors' command where it is due, and update the status."""
        assert self._serial is not None
        waiting = self._serial.in_waiting
        data = self._serial.read(waiting or 1)
        now_s = self.host.now_s()
        if data:
            self._received_s = now_s
        self._receive(data, now_s, waiting > 0)
        self._commands.keep_alive(now_s)
        if now_s - self._received_s > _QUIET_S:
            self._set_status(LinkStatus.NO_DATA)
        elif now_s - self._decoded_s > _QUIET_S:
            self._set_status(LinkStatus.TEXT if self._decoder.is_text else LinkStatus.NOISE)
        elif self._decoded_s > self._opened_s:
            self._set_status(LinkStatus.CONNECTED)

    def _receive(self, data: bytes, now_s: float, was_waiting: bool) -> None:
        """Decode bytes, and pass on ticks and answers.

        Args:
            data: that was read.
            now_s: monotonic time of reading.
            was_waiting: whether bytes had arrived before reading.
        """
        for message in self._decoder.feed(data, self._unix_s + now_s, was_waiting):
            self._decoded_s = now_s
            self.nearby = message.reading(self._unix_s + now_s) if isinstance(message, Nearby) else self.nearby
            if isinstance(message, Counts):
                restarts = self._tracker.restarts
                for ticks in self._tracker.add_counts(message, self._unix_s + now_s):
                    self._put(ticks)
                if self._tracker.restarts > restarts:
                    self._commands.forget_drive()
                    self._decoder.forgive_gap(message.sequence)
            elif isinstance(message, Pulses):
                self._put(self._tracker.add_pulses(message))
            elif isinstance(message, PlainReading):
                for ticks in self._tracker.add_line(message):
                    self._put(ticks)
            elif isinstance(message, Ack) and self._commands.answered(message):
                self._tracker.reset_done()
            elif isinstance(message, Version):
                self._commands.set_version(message)

    def _wait_for_port(self) -> None:
        """Close a port that vanished, drop the motors' command, and open the port as soon as it is back."""
        if self._serial is not None:
            self._serial.close()
            self._serial = None
        self._commands.forget_drive()
        self._set_status(LinkStatus.VANISHED)
        while not self._is_closing.wait(_RETRY_S):
            try:
                self._serial = self.host.open_port(self.port, self.baudrate)
            except DeviceError:
                continue
            self._reconnects += 1
            self._decoder.restart()
            self._tracker.replugged()
            self._opened_s = self._received_s = self._decoded_s = self.host.now_s()
            self._set_status(LinkStatus.LISTENING)
            return

    def _write(self, frame: bytes) -> None:
        """Write a frame to the port. Raises DeviceError where the port is gone."""
        port = self._serial
        try:
            if port is None:
                raise SerialException("vanished")
            port.write(frame)
        except SerialTimeoutException as error:
            raise DeviceError("the controller takes no more bytes", path=self.port) from error
        except (SerialException, OSError, TypeError) as error:  # TypeError: closed by the link's thread meanwhile
            raise DeviceError("the port vanished", path=self.port, fix="plug the controller in") from error

    def _put(self, ticks: WheelTicks | None) -> None:
        """Queue ticks, or None for the end. Drops the oldest where the queue is full."""
        self._last = ticks or self._last
        while True:
            try:
                return self._ticks.put_nowait(ticks)
            except queue.Full:
                self._ticks.get_nowait()
                self._overrun += 1

    def _set_status(self, status: LinkStatus) -> None:
        """Change the status and call `on_status`, unless the status is the same."""
        if status is not self.status:
            self.status = status
            if self._on_status is not None:
                self._on_status(status)


KEEP_ALIVE_S = 0.05
_ANSWER_S = 0.25
_ATTEMPTS = 4


class Commands:
    """Sends numbered commands through `write`, and repeats them until the controller confirms them.

    Any thread may command. The link's thread calls `keep_alive`, `answered` and `set_version`.

    Attributes:
        version: the last version that the controller sent, or None.
        wait: waits until a condition holds, for some seconds at most.
    """

    def __init__(self, port: str, write: Callable[[bytes], None], now_s: Callable[[], float] = REAL_HOST.now_s) -> None:
        self.version: Version | None = None
        self._port, self._write, self._now_s = port, write, now_s
        self._sending = threading.RLock()
        self._sequence = 0
        self._drive: bytes | None = None
        self._has_driven = False
        self._next_s = self._until_s = math.inf
        self._answer = threading.Condition()
        self._answers: dict[tuple[int, int], int] = {}
        self.wait: Callable[[Callable[[], bool], float], object] = self._answer.wait_for

    def drive(self, left: float, right: float, hold_s: float | None) -> None:
        """Send DRIVE now and with each `keep_alive`, for `hold_s` seconds or until the next command."""
        for side, duty in (("left", left), ("right", right)):
            if not -1 <= duty <= 1:
                raise DeviceError(f"the {side} duty is {duty}, not -1 to 1", path=self._port)
        body = drive_body(left, right)
        with self._sending:
            self._drive, self._has_driven = None, True
            self._send(LinkCommand.DRIVE, body)  # where this raises, nothing is repeated after a reconnection
            now_s = self._now_s()
            self._drive, self._next_s = body, now_s + KEEP_ALIVE_S
            self._until_s = math.inf if hold_s is None else now_s + hold_s

    def keep_alive(self, now_s: float) -> None:
        """Repeat DRIVE when it is due. Without it the controller stops the motors."""
        with self._sending, suppress(DeviceError):  # reading detects a port that vanished
            if self._drive is None or now_s < min(self._next_s, self._until_s):
                return
            if now_s >= self._until_s:
                self.forget_drive()
                self._send(LinkCommand.STOP)
            else:
                self._next_s = now_s + KEEP_ALIVE_S
                self._send(LinkCommand.DRIVE, self._drive)

    def forget_drive(self) -> None:
        """Stop repeating DRIVE."""
        with self._sending:
            self._drive = None

    def end(self) -> None:
        """Stop the motors if they were ever driven, without waiting for the confirmation."""
        self.forget_drive()
        if self._has_driven:
            with suppress(DeviceError):
                self._send(LinkCommand.STOP)

    def ask_version(self) -> Version:
        """The version of the controller's firmware. Raises DeviceError where it does not answer."""
        self.set_version(None)
        self.ask(LinkCommand.GET_VERSION)
        if self.version is None:
            raise DeviceError("the controller sends no version", path=self._port, fix="ask again; the line is noisy")
        return self.version

    def answered(self, ack: Ack) -> bool:
        """Store an answer. Returns whether it confirms that the counters are zero."""
        with self._answer:
            self._answers[ack.command, ack.command_sequence] = ack.status
            self._answer.notify_all()
        return ack.command == LinkCommand.RESET_COUNTS and ack.status == 0

    def set_version(self, version: Version | None) -> None:
        """Store the version that the controller sent; None before it is asked for."""
        self.version = version

    def ask(self, command: LinkCommand, body: bytes = b"", is_answered: bool = True) -> None:
        """Send a command, until it is confirmed where `is_answered`. Raises DeviceError where it is not."""
        if not is_answered:
            self._send(command, body)
            return
        for _ in range(_ATTEMPTS):
            with self._answer:
                self._answers.clear()
                key = (int(command), self._send(command, body))
                self.wait(partial(contains, self._answers, key), _ANSWER_S)
                status = self._answers.get(key)
            if status == 0:
                return
            if status is not None:
                problem = ACK_PROBLEMS.get(status, f"answers with status {status}")
                raise DeviceError(f"the controller {problem} {command.name}", path=self._port)
        raise DeviceError(f"the controller does not answer {command.name}", path=self._port, fix="check the wire to it")

    def _send(self, command: LinkCommand, body: bytes = b"") -> int:
        """Write a command's frame. Returns its sequence number."""
        with self._sending:
            sequence = self._sequence
            self._sequence = (sequence + 1) & 0xFF
            self._write(encode_command(command, sequence, body))
        return sequence


_READ_TIMEOUT_S = 0.006  # longer than the silence that ends a pair of bytes in the paper's format
_WRITE_TIMEOUT_S = 0.2
_REASONS = {
    errno.EACCES: ("no permission to open the port", "join its group, e.g. sudo usermod -aG dialout $USER"),
    errno.EPERM: ("no permission to open the port", "join its group, e.g. sudo usermod -aG dialout $USER"),
    errno.EBUSY: ("the port is in use by another program", "end that one first"),
    errno.EAGAIN: ("the port is in use by another program", "end that one first"),
}


def open_port(path: str, baudrate: int) -> Serial:
    """The opened port, locked against other programs that use locks, with short timeouts.

    Raises DeviceError where it is missing, denied, in use, not a serial port, or does not support the rate.
    """
    try:
        port = Serial(path, baudrate, timeout=_READ_TIMEOUT_S, write_timeout=_WRITE_TIMEOUT_S, exclusive=True)
    except SerialException as error:
        there = sorted(port.device for port in comports())
        ports = f"there are: {', '.join(there)}" if there else "no serial port is there: plug the controller in"
        problem, fix = f"cannot be opened: {error}", None
        if error.errno == errno.ENOENT:
            problem, fix = "there is no such port", ports
        elif error.errno in _REASONS:
            problem, fix = _REASONS[error.errno]
        elif Path(path).exists() and not Path(path).is_char_device():
            problem, fix = "is not a serial port", ports
        raise DeviceError(problem, path=path, fix=fix) from error
    except (ValueError, OverflowError) as error:
        raise DeviceError(f"the port does not know {baudrate} baud", path=path, fix="115200 is usual") from error
    with suppress(ValueError, OSError, AttributeError, NotImplementedError):  # not every driver has this mode
        port.set_low_latency_mode(True)
    return port
