"""`SimulatedController`, a wheel controller behind a pseudo-terminal with the protocols of the firmware, for practice
and tests. Pseudo-terminals exist on Linux and macOS.
"""

from __future__ import annotations

import math
import os
import select
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from cobs import cobs

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import DeviceError
from wheelsight.core.threads import Closing
from wheelsight.io.devices.wire_formats import (
    FULL_DUTY,
    Ack,
    Counts,
    LinkCommand,
    Version,
    encode_frame,
    encode_message,
)

Motors = Callable[[tuple[int, int], float], tuple[int, int]]

PERIOD_S = 0.02
WATCHDOG_S = 0.25
PORT_NAME = "ttyWHEELS"

_BODY_BYTES = {
    LinkCommand.DRIVE: 4,
    LinkCommand.STOP: 0,
    LinkCommand.GET_VERSION: 0,
    LinkCommand.RESET_COUNTS: 0,
    LinkCommand.SET_FORMAT: 1,
}
_DONE, _UNKNOWN, _WRONG_LENGTH, _OUT_OF_RANGE = range(4)
_LONGEST_COMMAND = 64  # bytes before a zero; more are noise
_MOTOR_LAG_S = 0.15  # a wheelchair's motors reach 63 % of a commanded speed within this time


class Leg(NamedTuple):
    """A part of a practice drive: duration, and the distance that each wheel rolls, from rest to rest."""

    seconds: float
    left_m: float
    right_m: float


def lap(wheels: Wheels) -> tuple[Leg, ...]:
    """After 3 s at rest: 2 m forward, half a turn to the left, 2 m back, half a turn; it ends at its start."""
    half_m = math.pi * wheels.track_width_m / 2
    ahead, turn, rest = Leg(5.0, 2.0, 2.0), Leg(5.0, -half_m, half_m), Leg(1.0, 0.0, 0.0)
    return Leg(3.0, 0.0, 0.0), ahead, rest, turn, rest, ahead, rest, turn


def turns(wheels: Wheels) -> tuple[Leg, ...]:
    """One turn of the left wheel forward and back, then of the right wheel, as by hand."""
    left_m, right_m = 2 * math.pi * wheels.left_radius_m, 2 * math.pi * wheels.right_radius_m
    ways = ((left_m, 0.0), (-left_m, 0.0), (0.0, right_m), (0.0, -right_m))
    return tuple(leg for way in ways for leg in (Leg(3.0, 0.0, 0.0), Leg(3.0, *way)))


class Practice:
    """Motors that repeat a practice drive until the first DRIVE, and then follow the commands.

    Args:
        wheels: with the distance of a pulse.
        legs: of the drive; empty to stand.
        full_speed_m_s: of both wheels at full duty.
    """

    def __init__(self, wheels: Wheels, legs: tuple[Leg, ...] = (), full_speed_m_s: float = 1.0) -> None:
        self._m_per_tick = (wheels.left_m_per_tick, wheels.right_m_per_tick)
        self._legs = legs
        self._full_speed_m_s = full_speed_m_s
        self._passed_s = 0.0
        self._is_commanded = False
        self._speeds = (0.0, 0.0)
        self._driven_m = (0.0, 0.0)
        self._sent = (0, 0)

    def __call__(self, duties: tuple[int, int], seconds: float) -> tuple[int, int]:
        """Pulses of both wheels during `seconds` under duties in permille. Fractions are carried over."""
        self._is_commanded |= duties != (0, 0)
        if self._is_commanded:
            share = 1 - math.exp(-seconds / _MOTOR_LAG_S)
            wanted = [self._full_speed_m_s * duty / FULL_DUTY for duty in duties]
            left, right = (speed + share * (aim - speed) for speed, aim in zip(self._speeds, wanted, strict=True))
            self._speeds = left, right
            self._driven_m = (self._driven_m[0] + left * seconds, self._driven_m[1] + right * seconds)
        else:
            self._passed_s += seconds
            length_s = sum(leg.seconds for leg in self._legs)
            rounds, into_s = divmod(self._passed_s, length_s) if length_s else (0.0, 0.0)
            left = rounds * sum(leg.left_m for leg in self._legs)
            right = rounds * sum(leg.right_m for leg in self._legs)
            for leg in self._legs if length_s else ():
                share = min(max(into_s / leg.seconds, 0.0), 1.0)
                done = share * share * (3 - 2 * share)  # the speed is zero at both ends of a leg
                left, right = left + done * leg.left_m, right + done * leg.right_m
                into_s -= leg.seconds
            self._driven_m = left, right
        counts = [round(way / unit) for way, unit in zip(self._driven_m, self._m_per_tick, strict=True)]
        pulses = counts[0] - self._sent[0], counts[1] - self._sent[1]
        self._sent = counts[0], counts[1]
        return pulses


class SimulatedController(Closing):
    """Sends counts every 20 ms from a thread and obeys commands, as the firmware. It can restart and be unplugged.

    Attributes:
        port: a symbolic link to the pseudo-terminal; the same after it was plugged in again.
        left, right: the true counts, never reset.
        speeds: pulses of both wheels in a period.
        motors: replaces `speeds`: gives the pulses of both wheels for duties in permille and a time; or None.
        duties: of the last DRIVE; (0, 0) after STOP or the watchdog.
        commands: all received commands, (type, body).
        is_muted, is_noisy, answers: whether it sends no counts; sends noise; answers commands.
        is_plain: whether it prints `time,left,right` and takes no commands, like the Arduino sketch.
        version: protocol, major, minor and flags of its answer to GET_VERSION.

    Raises:
        DeviceError: the system has no pseudo-terminals, or the link cannot be made.
    """

    def __init__(
        self, folder: Path, name: str = PORT_NAME, *, is_plain: bool = False, motors: Motors | None = None
    ) -> None:
        self.port = folder / name
        self.left = self.right = 0
        self.speeds = (0, 0)
        self.motors = motors
        self.duties = (0, 0)
        self.commands: list[tuple[int, bytes]] = []
        self.is_muted, self.is_noisy, self.answers, self.is_paper = False, False, True, False
        self.is_plain = is_plain
        self.version = (1, 2, 3, 0)
        self._zero = (0, 0)
        self._sequence = 0
        self._booted_s = time.monotonic()
        self._driven_s = 0.0
        self._counted_s = time.monotonic()
        self._master: int | None = None
        self._slave: int | None = None
        self._received = b""
        self._lock = threading.RLock()
        self._is_over = threading.Event()
        self.plug()

        def run() -> None:
            next_s = time.monotonic()
            while not self._is_over.is_set():
                self._obey_until(next_s)
                next_s = max(next_s + PERIOD_S, time.monotonic() - PERIOD_S)
                with self._lock:
                    self._send_counts()

        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()

    def plug(self) -> None:
        """Make a new pseudo-terminal at the same port. Raises DeviceError."""
        try:
            import tty  # not on Windows
        except ImportError as error:
            raise DeviceError("this system has no pseudo-terminals", fix="Linux or macOS") from error
        if self.port.exists():  # the dangling link of a killed program is replaced
            what = "leads to another terminal" if self.port.is_symlink() else "is no link"
            raise DeviceError(f"{self.port} exists, and {what}", fix="another PATH, or remove it")
        with self._lock:
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            try:
                self.port.unlink(missing_ok=True)
                self.port.symlink_to(os.ttyname(self._slave))
            except OSError as error:
                raise DeviceError(f"{self.port} cannot be made: {error.strerror}", fix="another PATH") from error
            if self.is_plain:
                self.send(b"time_us,left,right\r\n")

    def unplug(self) -> None:
        """Close both ends, as when it is unplugged. The controller continues to count."""
        with self._lock:
            self.port.unlink(missing_ok=True)
            for end in (self._master, self._slave):
                if end is not None:
                    os.close(end)
            self._master = self._slave = None

    def restart(self) -> None:
        """Reset clock, sequence and counts; `left` and `right` stay."""
        with self._lock:
            self._booted_s = time.monotonic()
            self._sequence = 0
            self._zero = (self.left, self.right)

    def send(self, data: bytes) -> None:
        """Send raw bytes. Those that do not fit are lost, as where no program reads."""
        with self._lock:
            if self._master is not None:
                with suppress(BlockingIOError):
                    os.write(self._master, data)

    def close(self) -> None:
        """End, and remove the port."""
        self._is_over.set()
        self._thread.join()
        self.unplug()

    def _send_counts(self) -> None:
        """Count the pulses of a period, and send them."""
        now_s = time.monotonic()
        left, right = self.speeds if self.motors is None else self.motors(self.duties, now_s - self._counted_s)
        self._counted_s = now_s
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
        counts = [_signed(self.left - self._zero[0]), _signed(self.right - self._zero[1])]
        if self.is_plain:
            self.send(f"{clock_us},{counts[0]},{counts[1]}\r\n".encode("ascii"))
            return
        self.send(encode_message(Counts(self._next(), clock_us, counts[0], counts[1])))

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
                    with self._lock:  # once it is unplugged, its number may belong to another file
                        data = os.read(master, 4096) if master == self._master else b""
                    *pieces, rest = (self._received + data).split(b"\0")
                    self._received = rest[-_LONGEST_COMMAND:]
                    for piece in filter(None, pieces):
                        self._obey(piece)

    def _obey(self, piece: bytes) -> None:
        """Execute and answer the command of a frame. Ignores a damaged frame, and any frame in plain text."""
        try:
            frame = cobs.decode(piece)
        except cobs.DecodeError:
            return
        if self.is_plain or len(frame) < 4 or piece + b"\0" != encode_frame(frame[0], frame[1], frame[2:-2]):
            return
        kind, sequence, body = frame[0], frame[1], frame[2:-2]
        with self._lock:
            self.commands.append((kind, body))
            was_framed = not self.is_paper
            status = _status(kind, body)
            if status == _DONE and kind == LinkCommand.DRIVE:
                self.duties, self._driven_s = _duties(body), time.monotonic()
            elif status == _DONE and kind == LinkCommand.STOP:
                self.duties = (0, 0)
            elif status == _DONE and kind == LinkCommand.RESET_COUNTS:
                self._zero = (self.left, self.right)
            elif status == _DONE and kind == LinkCommand.SET_FORMAT:
                self.is_paper = bool(body[0])
            if not self.answers or not (was_framed or not self.is_paper):
                return
            if kind == LinkCommand.GET_VERSION and status == _DONE:
                self.send(encode_message(Version(self._next(), *self.version)))
            self.send(encode_message(Ack(self._next(), kind, sequence, status)))


def _duties(body: bytes) -> tuple[int, int]:
    return int.from_bytes(body[:2], "little", signed=True), int.from_bytes(body[2:], "little", signed=True)


def _status(kind: int, body: bytes) -> int:
    """The status that the firmware answers."""
    length = _BODY_BYTES.get(LinkCommand(kind)) if kind in set(LinkCommand) else None
    if length is None:
        return _UNKNOWN
    if len(body) != length:
        return _WRONG_LENGTH
    if kind == LinkCommand.DRIVE and max(map(abs, _duties(body))) > FULL_DUTY:
        return _OUT_OF_RANGE
    return _OUT_OF_RANGE if kind == LinkCommand.SET_FORMAT and body[0] > 1 else _DONE


def _signed(count: int) -> int:
    return (count + (1 << 31)) % (1 << 32) - (1 << 31)
