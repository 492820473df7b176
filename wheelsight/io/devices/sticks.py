"""`Joystick` reads a gamepad or joystick of Linux, and `StickLog` a file of positions, as positions of a stick."""

from __future__ import annotations

import math
import os
import struct
from bisect import bisect_right
from pathlib import Path
from typing import Protocol

from wheelsight.core.errors import DeviceError, RecordingError
from wheelsight.core.files import StrPath
from wheelsight.core.messages import StickPosition
from wheelsight.core.threads import Closing

# An event of Linux' joystick interface: time in ms, value, type and number (kernel documentation, joystick-api).
_EVENT = struct.Struct("<IhBB")
_BUTTON, _AXIS, _IS_STATE = 0x01, 0x02, 0x80
_FULL = 32767
# Axes of the left stick, which is negative forward and to the left, and the first button.
_LEFT_AXIS, _FORWARD_AXIS, _OVERRIDE_BUTTON = 0, 1, 0


class StickSource(Protocol):
    """Gives the newest position of a stick."""

    def read(self, now_s: float) -> StickPosition | None:
        """The position at a time by the robot's clock; None if the stick is gone."""

    def close(self) -> None:
        """Release the device."""


class Joystick(Closing):
    """A gamepad or joystick, such as /dev/input/js0: its left stick, and its first button for full control.

    The device sends changes only, so a position stays until it changes. An unplugged one gives None, also after it is
    plugged in again.

    Raises DeviceError if the device cannot be opened.
    """

    def __init__(self, path: StrPath) -> None:
        try:
            self._file: int | None = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            fix = "plug it in, and allow reading: sudo usermod -aG input $USER"
            raise DeviceError(f"the joystick {path} cannot be opened: {error.strerror}", fix=fix) from error
        self._axes, self._is_held, self._rest = {_LEFT_AXIS: 0.0, _FORWARD_AXIS: 0.0}, False, b""

    def read(self, now_s: float) -> StickPosition | None:
        """See `StickSource`."""
        if self._file is None:
            return None
        try:
            while True:
                data = os.read(self._file, 64 * _EVENT.size)
                if not data:
                    self.close()
                    return None
                self._rest += data
        except BlockingIOError:
            pass
        except OSError:
            self.close()
            return None
        whole = len(self._rest) - len(self._rest) % _EVENT.size
        for _, value, kind, number in _EVENT.iter_unpack(self._rest[:whole]):
            kind &= ~_IS_STATE
            if kind == _AXIS and number in self._axes:
                self._axes[number] = max(-value / _FULL, -1.0)
            elif kind == _BUTTON and number == _OVERRIDE_BUTTON:
                self._is_held = value != 0
        self._rest = self._rest[whole:]
        return StickPosition(
            now_s, min(self._axes[_FORWARD_AXIS], 1.0), min(self._axes[_LEFT_AXIS], 1.0), self._is_held
        )

    def close(self) -> None:
        """Release the device; may be called twice."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


class StickLog(Closing):
    """Positions of a stick from a text file: seconds since the begin, forward, left and optionally 1 for the override.

    A position stays until the next one; after the last one the stick is released, and then it is gone.

    Raises RecordingError for a file that cannot be read, or for a line with other content.
    """

    def __init__(self, path: StrPath) -> None:
        self._times_s: list[float] = []
        self._positions: list[tuple[float, float, bool]] = []
        try:
            lines = Path(path).read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise RecordingError(
                f"the stick's positions cannot be read: {error}", path=path, fix="a text file"
            ) from error
        for number, line in enumerate(lines, 1):
            text = line.split("#")[0].strip()
            if not text:
                continue
            try:
                seconds, forward, left, *more = map(float, text.replace(",", " ").split())
                is_sound = all(map(math.isfinite, (seconds, forward, left))) and max(abs(forward), abs(left)) <= 1
            except ValueError:
                is_sound = False
            if not is_sound or len(more) > 1 or (self._times_s and seconds <= self._times_s[-1]):
                fix = "SECONDS FORWARD LEFT [1], seconds that grow, shares from -1 to 1"
                raise RecordingError(f"line {number} is no position of a stick: {text!r}", path=path, fix=fix)
            self._times_s.append(seconds)
            self._positions.append((forward, left, bool(more and more[0])))
        if not self._times_s:
            raise RecordingError("there is no position of a stick", path=path, fix="SECONDS FORWARD LEFT in each line")
        self._begun_s: float | None = None

    def read(self, now_s: float) -> StickPosition | None:
        """See `StickSource`."""
        self._begun_s = now_s if self._begun_s is None else self._begun_s
        at = bisect_right(self._times_s, now_s - self._begun_s) - 1
        if at == len(self._times_s) - 1:
            return None
        return StickPosition(now_s) if at < 0 else StickPosition(now_s, *self._positions[at])
