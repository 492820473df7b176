"""WheelLink: a thread that keeps a serial port, and turns what comes into ticks and what is asked into commands."""

from __future__ import annotations

import atexit
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from types import TracebackType

from serial import Serial, SerialException, SerialTimeoutException

from wheelsight.devices import host_clock
from wheelsight.devices._commands import Commands
from wheelsight.devices._port import open_port
from wheelsight.devices.continuity import TickTracker
from wheelsight.devices.paper import Pulses
from wheelsight.devices.plain_text import PlainReading
from wheelsight.devices.protocol import Ack, Counts, LineStatistics, Version
from wheelsight.devices.recognition import Format, LineDecoder
from wheelsight.errors import DeviceError
from wheelsight.events import WheelTicks

BAUDRATE = 115200
_QUIET_S = 1.0
_RETRY_S = 0.2
_MOST_QUEUED = 1 << 16


class LinkStatus(StrEnum):
    """How the line to the controller is doing."""

    LISTENING = "listening"
    CONNECTED = "connected"
    NO_DATA = "no data: is the controller powered and wired?"
    NOISE = "noise: wrong baud rate?"
    TEXT = "text without counts: print left,right or time,left,right, one line a reading"
    VANISHED = "the port vanished: waiting for it"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class LinkReport:
    """How the link is doing at one moment, for a person to look at.

    Attributes:
        status, format: of the line; the format is None until it was recognised.
        line: bytes, frames, errors and losses since the format was recognised.
        restarts, refused: as `TickTracker` counts them.
        reconnects: how often the port vanished and came again.
        overrun: ticks dropped since nobody fetched them.
        drift_ppm: how much faster than the host's the controller's clock runs.
        last: the newest ticks, or None.
        version: what the controller said it is, or None.
        other_line: the last line of text that was no counts; empty where there was none.
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


class WheelLink:
    """The serial line to a wheel controller; use it in a `with` block.

    It only listens until it is told something: it sends nothing by itself, so that an unknown device does nothing.
    Stamps are host time in seconds since 1970 at which the controller took the counts, later by the shortest delay of
    the transport; they follow the system's clock as it was when the first device was opened, and never run backwards.

    Args:
        port: such as /dev/ttyUSB0; better /dev/serial/by-id/…, which is the same after it was plugged in again.
        baudrate: of the line.
        on_status: called with each new status, from the link's thread.

    Raises:
        DeviceError: the port is missing, denied, in use by another program, or no serial port.
    """

    def __init__(
        self, port: str, baudrate: int = BAUDRATE, on_status: Callable[[LinkStatus], None] | None = None
    ) -> None:
        self.port, self.baudrate = str(port), baudrate
        self._on_status = on_status
        self._status = LinkStatus.LISTENING
        self._decoder, self._tracker = LineDecoder(), TickTracker()
        self._ticks: queue.Queue[WheelTicks | None] = queue.Queue(_MOST_QUEUED)
        self._last: WheelTicks | None = None
        self._reconnects = self._overrun = 0
        self._serial: Serial | None = open_port(self.port, baudrate)
        self._commands = Commands(self.port, self._write)
        self._unix_s = host_clock.unix_offset_s()
        self._opened_s = self._heard_s = self._understood_s = time.monotonic()
        self._is_closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"wheel link {self.port}", daemon=True)
        atexit.register(self.close)
        self._thread.start()

    def ticks(self) -> Iterator[WheelTicks]:
        """Ticks as they come, until the link is closed; waits for them, and through a port that vanished."""
        while (ticks := self._ticks.get()) is not None:
            yield ticks
        self._ticks.put(None)  # for whoever else, or again, asks

    def read(self, timeout_s: float) -> WheelTicks | None:
        """The next ticks, or None if none come within `timeout_s` seconds or the link is closed."""
        try:
            ticks = self._ticks.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if ticks is None:
            self._ticks.put(None)
        return ticks

    def drive(self, left: float, right: float, hold_s: float | None = None) -> None:
        """Set both motors' duty, -1 (full speed back) to 1, and keep it up at 20 Hz until something else is said.

        The motors stop when the link is closed, the program ends, or the port vanishes; when the program dies, the
        controller stops them a quarter of a second later.

        Args:
            left, right: duty of each motor.
            hold_s: stop after so many seconds unless driven again, for programs that may hang; None for never.

        Raises:
            DeviceError: a duty beyond -1 to 1, the port is gone, or the controller prints text and takes no commands.
        """
        self._need_commands()
        self._commands.drive(left, right, hold_s)

    def stop(self) -> None:
        """Stop both motors at once; confirmed by the controller, save in the paper's format, which has no answers.

        Raises:
            DeviceError: the port is gone, or the controller does not confirm, or takes no commands.
        """
        self._need_commands()
        self._commands.stop(self._is_answering)

    def ask_version(self) -> Version:
        """What the controller's program calls itself. Raises DeviceError where it does not answer."""
        self._need_commands()
        if not self._is_answering:
            raise DeviceError(
                "the controller speaks the paper's format, which has no answers",
                path=self.port,
                fix="set_format(Format.FRAMED) first",
            )
        return self._commands.ask_version()

    def reset_counts(self) -> None:
        """Set the controller's counters to zero; the ticks go on as they were. Raises DeviceError as `stop`."""
        self._need_commands()
        self._tracker.expect_reset(True)
        try:
            self._commands.reset_counts(self._is_answering)
        except DeviceError:
            self._tracker.expect_reset(False)
            raise

    def set_format(self, wanted: Format) -> None:
        """Ask the controller for a wire format; pulses are neither lost nor made up in the change.

        Raises DeviceError as `stop`.
        """
        self._need_commands()
        if wanted is Format.PLAIN:
            raise DeviceError(
                "no controller changes to plain text", path=self.port, fix="write a sketch that prints it"
            )
        is_paper = wanted is Format.PAPER
        self._decoder.expect_frames(not is_paper)
        try:
            self._commands.set_format(is_paper, is_answered=self._is_answering or not is_paper)
        except DeviceError:
            self._decoder.expect_frames(False)
            if not (is_paper and self._decoder.format is wanted and self._status is LinkStatus.CONNECTED):
                raise  # else it spoke so already, found out meanwhile, and had nothing to answer

    def _need_commands(self) -> None:
        if self._decoder.format is Format.PLAIN:
            raise DeviceError(
                "the controller prints plain text, and takes no commands",
                path=self.port,
                fix="give it a program with frames: docs/firmware.md",
            )

    @property
    def _is_answering(self) -> bool:
        return self._decoder.format is not Format.PAPER

    @property
    def status(self) -> LinkStatus:
        """How the line is doing now."""
        return self._status

    def report(self) -> LinkReport:
        """Everything a person may want to see."""
        tracker = self._tracker
        return LinkReport(
            status=self._status,
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
        """Stop the motors if they were driven, and give the port back; may be called twice."""
        self._is_closing.set()
        if self._thread is not threading.current_thread():
            self._thread.join()
        atexit.unregister(self.close)

    def __enter__(self) -> WheelLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        """The thread: read, and keep the motors' command alive, until closed."""
        try:
            while not self._is_closing.is_set():
                try:
                    self._step()
                except (SerialException, OSError):
                    self._wait_for_port()
        finally:
            self._commands.end()
            if self._serial is not None:
                self._serial.close()
            self._tell(LinkStatus.CLOSED)
            self._put(None)

    def _step(self) -> None:
        assert self._serial is not None
        waiting = self._serial.in_waiting
        data = self._serial.read(waiting or 1)
        now_s = time.monotonic()
        if data:
            self._heard_s = now_s
        self._receive(data, now_s, waiting > 0)
        self._commands.keep_alive(now_s)
        self._judge(now_s)

    def _receive(self, data: bytes, now_s: float, lay_waiting: bool) -> None:
        for message in self._decoder.feed(data, self._unix_s + now_s, lay_waiting):
            self._understood_s = now_s
            if isinstance(message, Counts):
                restarts = self._tracker.restarts
                for ticks in self._tracker.follow(message, self._unix_s + now_s):
                    self._put(ticks)
                if self._tracker.restarts > restarts:
                    self._commands.forget_drive()
                    self._decoder.forgive_gap(message.sequence)
            elif isinstance(message, Pulses):
                self._put(self._tracker.add(message))
            elif isinstance(message, PlainReading):
                for ticks in self._tracker.read(message):
                    self._put(ticks)
            elif isinstance(message, Ack) and self._commands.answered(message):
                self._tracker.reset_done()
            elif isinstance(message, Version):
                self._commands.told_version(message)

    def _judge(self, now_s: float) -> None:
        """Tell the status, at most a second late."""
        if now_s - self._heard_s > _QUIET_S:
            self._tell(LinkStatus.NO_DATA)
        elif now_s - self._understood_s > _QUIET_S:
            self._tell(LinkStatus.TEXT if self._decoder.is_text else LinkStatus.NOISE)
        elif self._understood_s > self._opened_s:
            self._tell(LinkStatus.CONNECTED)

    def _wait_for_port(self) -> None:
        """After the port vanished: forget what the motors were told, and open it again as soon as it is there."""
        if self._serial is not None:
            self._serial.close()
            self._serial = None
        self._commands.forget_drive()
        self._tell(LinkStatus.VANISHED)
        while not self._is_closing.wait(_RETRY_S):
            try:
                self._serial = open_port(self.port, self.baudrate)
            except DeviceError:
                continue
            self._reconnects += 1
            self._decoder.restart()
            self._tracker.replugged()
            self._opened_s = self._heard_s = self._understood_s = time.monotonic()
            self._tell(LinkStatus.LISTENING)
            return

    def _write(self, frame: bytes) -> None:
        """Send a frame. Raises DeviceError where the port is gone."""
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
        self._last = ticks or self._last
        while True:
            try:
                return self._ticks.put_nowait(ticks)
            except queue.Full:
                self._ticks.get_nowait()
                self._overrun += 1

    def _tell(self, status: LinkStatus) -> None:
        if status is not self._status:
            self._status = status
            if self._on_status is not None:
                self._on_status(status)
