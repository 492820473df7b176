"""A clock that moves on only when all who live by it wait, so that what happens does not depend on the machine."""

from __future__ import annotations

import math
import threading

from wheelsight.app.run import realtime as live_wheels
from wheelsight.app.run import realtime as playing

THREADS = (playing.THREAD, live_wheels.WHEELS_THREAD)
_LOOK_S = 0.002
_PATIENCE = 5000


class VirtualClock:
    """Lived by the test's own thread and those of playing and live wheels; `sleep` stands for work that takes time."""

    def __init__(self, begin_s: float = 1000.0) -> None:
        self._now_s = begin_s
        self.is_over = False
        self._lock = threading.Lock()
        self._waiting: dict[threading.Event, tuple[threading.Condition, float]] = {}

    def now_s(self) -> float:
        return self._now_s

    def wait(self, condition: threading.Condition, until_s: float) -> None:
        woken = threading.Event()
        with self._lock:
            self._waiting[woken] = (condition, until_s)
        condition.release()
        try:
            if self.is_over:
                return
            for _ in range(_PATIENCE):
                self._move()
                if woken.wait(_LOOK_S):
                    return
            raise AssertionError("nobody wakes anyone who waits here")
        finally:
            condition.acquire()

    def wake(self, condition: threading.Condition) -> None:
        with self._lock:
            self._wake(lambda its, _: its is condition)

    def sleep(self, seconds: float) -> None:
        condition, until_s = threading.Condition(), self._now_s + seconds
        with condition:
            while self._now_s < until_s and not self.is_over:
                self.wait(condition, until_s)

    def end(self) -> None:
        """Let no one wait any more."""
        with self._lock:
            self.is_over = True
            self._wake(lambda its, until_s: True)

    def _move(self) -> None:
        with self._lock:
            others = sum(thread.name in THREADS for thread in threading.enumerate())
            next_s = min((until_s for _, until_s in self._waiting.values()), default=math.inf)
            if len(self._waiting) > others and next_s < math.inf:
                self._now_s = max(self._now_s, next_s)
                self._wake(lambda _, until_s: until_s <= self._now_s)

    def _wake(self, is_meant: object) -> None:
        for woken, (condition, until_s) in list(self._waiting.items()):
            if is_meant(condition, until_s):  # type: ignore[operator]
                del self._waiting[woken]
                woken.set()
