"""Rows: the threads that share the work on an image, one pool for odometry and map."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

# Images lower than this are done sooner by one thread than handed to several.
_FEWEST_ROWS = 100
# A thread that is done early takes another part: rows are not all the same work, nor are threads there at once.
_PARTS_A_THREAD = 2
# Of `nice`, of work that frames must not wait for: a third of an ordinary thread's share. With less, such a thread
# holds Python's lock while the system runs other programs, and frames wait for its turn (docs/decisions/0112).
_YIELDED = 5


def yield_to_others() -> None:
    """Let the calling thread run where others leave time, as far as the system lets threads differ (Linux does)."""
    thread = threading.get_native_id()
    with suppress(AttributeError, OSError):
        os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + _YIELDED)


class Rows:
    """Shares the rows of an image among threads; the outcome does not depend on how many."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads, "wheelsight-dense") if threads > 1 else None

    def share(self, height: int, work: Callable[[int, int], None]) -> None:
        """Call `work(begin, end)` until all rows below `height` are done."""
        if self._pool is None or height < _FEWEST_ROWS:
            work(0, height)
            return
        todo, parts = itertools.count(), _PARTS_A_THREAD * self._threads

        def take() -> None:
            while (part := next(todo)) < parts:
                work(height * part // parts, height * (part + 1) // parts)

        others = [self._pool.submit(take) for _ in range(1, self._threads)]
        take()
        for other in others:
            if not other.cancel():
                other.result()
