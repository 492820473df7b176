"""A wheel controller in Python behind a pseudo-terminal: it counts, obeys, restarts, and can be unplugged."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from wheelsight.devices.protocol import Ack, Command, Counts, Version, encode_frame, encode_message

PERIOD_S = 0.02
WATCHDOG_S = 0.25


class SimulatedController:
    """Sends counts every 20 ms from a thread, as the firmware does; `port` stays the same through replugs.

    Attributes:
        port: a link to the pseudo-terminal.
        left, right: the true counts, never reset.
        speeds: pulses a period of both wheels.
        motors: pulses of both wheels in so many seconds under duties in permille, in place of `speeds`; or None.
        duties: what DRIVE last said, (0, 0) after STOP or the watchdog.
        commands: all received, (type, body).
        is_muted, is_noisy, answers: whether it sends no counts; sends noise; answers commands.
        version: protocol, major, minor and flags that it tells.
    """

    def __init__(self, folder: Path) -> None:
        self.port = folder / "ttyWHEELS"
        self.left = self.right = 0
        self.speeds = (0, 0)
        self.motors: Callable[[tuple[int, int], float], tuple[int, int]] | None = None
        self.duties = (0, 0)
        self.commands: list[tuple[int, bytes]] = []
        self.is_muted, self.is_noisy, self.answers, self.is_paper = False, False, True, False
        self.version = (1, 2, 3, 0)
        self._zero = (0, 0)
        self._sequence = 0
        self._booted_s = time.monotonic()
        self._driven_s = 0.0
        self._turned_s = time.monotonic()
        self._master: int | None = None
        self._slave: int | None = None
        self._received = b""
        self._lock = threading.RLock()
        self._is_over = threading.Event()
        self.plug()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def plug(self) -> None:
        """A new pseudo-terminal, under the old name."""
        with self._lock:
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            self.port.unlink(missing_ok=True)
            self.port.symlink_to(os.ttyname(self._slave))

    def vanish(self) -> None:
        """Both ends are closed, as when the plug is pulled; the controller counts on."""
        with self._lock:
            self.port.unlink(missing_ok=True)
            for end in (self._master, self._slave):
                if end is not None:
                    os.close(end)
            self._master = self._slave = None

    def restart(self) -> None:
        """Clock, sequence and counts begin at zero; what was counted before is only in `left` and `right`."""
        with self._lock:
            self._booted_s = time.monotonic()
            self._sequence = 0
            self._zero = (self.left, self.right)

    def send(self, data: bytes) -> None:
        """Put bytes on the line as they are."""
        with self._lock:
            if self._master is not None:
                with suppress(BlockingIOError):
                    os.write(self._master, data)

    def close(self) -> None:
        self._is_over.set()
        self._thread.join()
        self.vanish()

    def __enter__(self) -> SimulatedController:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        next_s = time.monotonic()
        while not self._is_over.is_set():
            self._obey_until(next_s)
            next_s = max(next_s + PERIOD_S, time.monotonic() - PERIOD_S)
            with self._lock:
                self._period()

    def _period(self) -> None:
        now_s = time.monotonic()
        left, right = self.speeds if self.motors is None else self.motors(self.duties, now_s - self._turned_s)
        self._turned_s = now_s
        self.left += left
        self.right += right
        if time.monotonic() - self._driven_s > WATCHDOG_S:
            self.duties = (0, 0)
        if self.is_noisy:
            self.send(os.urandom(7))
        if self.is_muted:
            return
        if self.is_paper:
            self.send(bytes([right & 0xFF, left & 0xFF]))
            return
        clock_us = int(1e6 * (time.monotonic() - self._booted_s)) % (1 << 32)
        counts = (self.left - self._zero[0], self.right - self._zero[1])
        self.send(encode_message(Counts(self._next(), clock_us, *(_signed(count) for count in counts))))

    def _next(self) -> int:
        self._sequence = (self._sequence + 1) & 0xFF
        return (self._sequence - 1) & 0xFF

    def _obey_until(self, end_s: float) -> None:
        while (left_s := end_s - time.monotonic()) > 0:
            with self._lock:
                master = self._master
            if master is None:
                time.sleep(min(left_s, 0.005))
                continue
            with suppress(OSError, ValueError):
                if select.select([master], [], [], min(left_s, 0.005))[0]:
                    self._received += self._read(master)
                    *pieces, self._received = self._received.split(b"\0")
                    for piece in filter(None, pieces):
                        self._obey(piece)

    def _read(self, master: int) -> bytes:
        # Under the lock: once it has vanished, its number may be that of a file that is waited for.
        with self._lock:
            return os.read(master, 4096) if master == self._master else b""

    def _obey(self, piece: bytes) -> None:
        from cobs import cobs

        frame = cobs.decode(piece)
        kind, sequence, body = frame[0], frame[1], frame[2:-2]
        assert piece + b"\0" == encode_frame(kind, sequence, body)
        with self._lock:
            self.commands.append((kind, body))
            was_framed = not self.is_paper
            if kind == Command.DRIVE:
                self.duties = (
                    int.from_bytes(body[:2], "little", signed=True),
                    int.from_bytes(body[2:], "little", signed=True),
                )
                self._driven_s = time.monotonic()
            elif kind == Command.STOP:
                self.duties = (0, 0)
            elif kind == Command.RESET_COUNTS:
                self._zero = (self.left, self.right)
            elif kind == Command.SET_FORMAT:
                self.is_paper = bool(body[0])
            if not self.answers or not (was_framed or not self.is_paper):
                return
            if kind == Command.GET_VERSION:
                self.send(encode_message(Version(self._next(), *self.version)))
            self.send(encode_message(Ack(self._next(), kind, sequence, 0)))


def _signed(count: int) -> int:
    return (count + (1 << 31)) % (1 << 32) - (1 << 31)
