"""A terminal of so many columns, as far as programs know: what they write on it is kept."""

from __future__ import annotations

import fcntl
import os
import re
import struct
import sys
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from numba.core.errors import termcolor

_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b[()][A-Z0-9]")
_MOVES = re.compile(r"\x1b\[[0-9]*[AHJK]|[\r\n]+")


class Screen:
    """What was written."""

    def __init__(self) -> None:
        self.written = b""

    def lines(self) -> list[str]:
        """Each line as it was drawn, without colours; one that was drawn twice is there twice."""
        text = _MOVES.sub("\n", self.written.decode("utf-8", "replace"))
        return [line for line in _CONTROL.sub("", text).split("\n") if line.strip()]


@contextmanager
def terminal(columns: int, monkeypatch: pytest.MonkeyPatch, rows: int = 24) -> Iterator[Screen]:
    """Errors and progress go to a pseudo-terminal of that size while the block runs."""
    screen = Screen()
    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
    for name in ("COLUMNS", "LINES", "NO_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    reader = threading.Thread(target=_read, args=(ours, screen), daemon=True)
    reader.start()
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(number) for number in (0, 1, 2)]
    with os.fdopen(os.dup(theirs), "w", encoding="utf-8", buffering=1) as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", stream)
        try:
            for number in (0, 1, 2):
                os.dup2(theirs, number)
            yield screen
        finally:
            for number, descriptor in enumerate(kept):
                os.dup2(descriptor, number)
                os.close(descriptor)
    # numba colours its messages by what keeps the standard output of the last one until the program ends.
    termcolor().code("")
    os.close(theirs)
    reader.join()
    os.close(ours)


def _read(ours: int, screen: Screen) -> None:
    while True:
        try:
            read = os.read(ours, 65536)
        except OSError:  # no one has the other end any more
            return
        if not read:
            return
        screen.written += read
