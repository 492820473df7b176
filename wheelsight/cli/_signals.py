"""Programs that run until they are told to stop: by Ctrl-C, by SIGTERM, or when their time is over."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def until_stopped(seconds: float | None = None) -> Iterator[Callable[[], bool]]:
    """Gives a question, "is it over?", which SIGINT and SIGTERM answer with yes instead of ending the program."""
    told: list[int] = []
    ends_s = None if seconds is None else time.monotonic() + seconds
    before = {number: signal.signal(number, lambda number, _: told.append(number)) for number in _STOPPING}
    try:
        yield lambda: bool(told) or (ends_s is not None and time.monotonic() >= ends_s)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


_STOPPING = (signal.SIGINT, signal.SIGTERM)
