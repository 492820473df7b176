"""Ctrl-C that waits until a step is over, so that what the step builds is never left half-built."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def whole_step() -> Iterator[None]:
    """A first Ctrl-C in the block is raised at its end; a second one at once.

    Only where Ctrl-C raises KeyboardInterrupt anyway: a program's own answer to it stays, and so does another thread's.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler:
        yield
        return
    told = []

    def wait(number: int, _: FrameType | None) -> None:
        told.append(number)
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, wait)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if told:
        raise KeyboardInterrupt
