"""What the host tells the controller: numbered, repeated until confirmed, and motors kept running only on purpose."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from wheelsight.devices.protocol import ACK_PROBLEMS, Ack, Command, Version, drive_body, encode_command
from wheelsight.errors import DeviceError

KEEP_ALIVE_S = 0.05
_ANSWER_S = 0.25
_ATTEMPTS = 4


class Commands:
    """Sends commands through `write`, and matches the controller's answers to them.

    Any thread may command; `keep_alive`, `answered` and `told_version` are called by the link's thread.

    Attributes:
        version: what the controller last said it is, or None.
    """

    def __init__(self, port: str, write: Callable[[bytes], None]) -> None:
        self.version: Version | None = None
        self._port, self._write = port, write
        self._sending = threading.RLock()
        self._sequence = 0
        self._drive: bytes | None = None
        self._has_driven = False
        self._next_s = self._until_s = math.inf
        self._answer = threading.Condition()
        self._answers: dict[tuple[int, int], int] = {}

    def drive(self, left: float, right: float, hold_s: float | None) -> None:
        """Send DRIVE now and with each `keep_alive`, for `hold_s` seconds or until told otherwise."""
        for side, duty in (("left", left), ("right", right)):
            if not -1 <= duty <= 1:
                raise DeviceError(f"the {side} duty is {duty}, not -1 to 1", path=self._port)
        body = drive_body(left, right)
        with self._sending:
            self._drive, self._has_driven = None, True
            self._send(Command.DRIVE, body)  # where the port is gone, nothing is left to be kept up when it comes back
            now_s = time.monotonic()
            self._drive, self._next_s = body, now_s + KEEP_ALIVE_S
            self._until_s = math.inf if hold_s is None else now_s + hold_s

    def keep_alive(self, now_s: float) -> None:
        """Repeat DRIVE when it is due; the controller stops the motors without it."""
        with self._sending, suppress(DeviceError):  # a port that vanished is found out by reading
            if self._drive is None or now_s < min(self._next_s, self._until_s):
                return
            if now_s >= self._until_s:
                self.forget_drive()
                self._send(Command.STOP)
            else:
                self._next_s = now_s + KEEP_ALIVE_S
                self._send(Command.DRIVE, self._drive)

    def forget_drive(self) -> None:
        """Do not keep up what the motors were told."""
        with self._sending:
            self._drive = None

    def stop(self, is_answered: bool) -> None:
        """Stop the motors; confirmed where the controller answers."""
        self.forget_drive()
        self._ask(Command.STOP, is_answered=is_answered)

    def end(self) -> None:
        """Stop the motors if they were ever driven, and wait for nothing."""
        self.forget_drive()
        if self._has_driven:
            with suppress(DeviceError):
                self._send(Command.STOP)

    def ask_version(self) -> Version:
        """What the controller's program calls itself."""
        self._forget_version()
        self._ask(Command.GET_VERSION)
        if self.version is None:
            raise DeviceError("the controller tells no version", path=self._port, fix="ask again; the line is noisy")
        return self.version

    def reset_counts(self, is_answered: bool) -> None:
        """Set the controller's counters to zero."""
        self._ask(Command.RESET_COUNTS, is_answered=is_answered)

    def set_format(self, is_paper: bool, is_answered: bool) -> None:
        """Choose the wire format; a change is answered either way, since one side of it is framed."""
        self._ask(Command.SET_FORMAT, bytes([is_paper]), is_answered)

    def answered(self, ack: Ack) -> bool:
        """Take an answer; whether it says that the counters are zero now."""
        with self._answer:
            self._answers[ack.command, ack.command_sequence] = ack.status
            self._answer.notify_all()
        return ack.command == Command.RESET_COUNTS and ack.status == 0

    def told_version(self, version: Version) -> None:
        """Take what the controller says it is."""
        self.version = version

    def _forget_version(self) -> None:
        self.version = None

    def _ask(self, command: Command, body: bytes = b"", is_answered: bool = True) -> None:
        """Send a command until it is confirmed. Raises DeviceError where it is refused, or never answered."""
        if not is_answered:
            self._send(command, body)
            return
        for _ in range(_ATTEMPTS):
            status = self._answer_to(command, body)
            if status == 0:
                return
            if status is not None:
                problem = ACK_PROBLEMS.get(status, f"answers with status {status}")
                raise DeviceError(f"the controller {problem} {command.name}", path=self._port)
        raise DeviceError(f"the controller does not answer {command.name}", path=self._port, fix="check the wire to it")

    def _answer_to(self, command: Command, body: bytes) -> int | None:
        with self._answer:
            self._answers.clear()
            key = (int(command), self._send(command, body))
            self._answer.wait_for(lambda: key in self._answers, _ANSWER_S)
            return self._answers.get(key)

    def _send(self, command: Command, body: bytes = b"") -> int:
        """Write a frame; its sequence."""
        with self._sending:
            sequence = self._sequence
            self._sequence = (sequence + 1) & 0xFF
            self._write(encode_command(command, sequence, body))
        return sequence
