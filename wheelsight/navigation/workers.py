"""Workers: run functions that take longer than a control period, in a thread or in step with the control."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from wheelsight.core.threads import yield_to_others

_Answer = TypeVar("_Answer")
# Longest wait for unfinished work at the end of a program; the thread is a daemon.
_ENDING_S = 5.0


class Worker(Protocol[_Answer]):
    """Runs one function at a time; a new request replaces the one before."""

    @property
    def is_asked(self) -> bool:
        """Whether an answer is to come."""

    @property
    def is_busy(self) -> bool:
        """Whether a function runs, even if its answer was dropped."""

    def ask(self, work: Callable[[], _Answer], now_s: float) -> None:
        """Run a function. Nothing that it uses may change until it ends."""

    def answer(self, now_s: float) -> _Answer | None:
        """Return the answer, once; None until it is ready. Raises the function's exception, once."""

    def drop(self) -> None:
        """Drop the request and its answer."""

    def close(self) -> None:
        """End the thread; further calls do nothing."""


class WorkerInStep(Generic[_Answer]):
    """Runs a function at once, and gives its answer after a simulated time. Equal events give equal answers.

    Args:
        takes_s: that time, by the clock of the stamps, which does not advance meanwhile.
    """

    is_busy = False

    def __init__(self, takes_s: float = 0.0) -> None:
        self._takes_s = takes_s
        self._waiting: tuple[float, _Answer] | None = None

    @property
    def is_asked(self) -> bool:
        """See `Worker`."""
        return self._waiting is not None

    def ask(self, work: Callable[[], _Answer], now_s: float) -> None:
        """See `Worker`."""
        self._waiting = now_s + self._takes_s, work()

    def answer(self, now_s: float) -> _Answer | None:
        """See `Worker`."""
        # A tolerance, as stamps are sums of periods.
        if self._waiting is None or now_s < self._waiting[0] - 1e-6:
            return None
        answer, self._waiting = self._waiting[1], None
        return answer

    def drop(self) -> None:
        """See `Worker`."""
        self._waiting = None

    def close(self) -> None:
        """Do nothing: there is no thread."""


class WorkerBeside(Generic[_Answer]):
    """Runs functions in a thread of low priority, so that the control of the robot never waits.

    Args:
        name: of the thread.
    """

    def __init__(self, name: str) -> None:
        self._changed = threading.Condition()
        self._work: Callable[[], _Answer] | None = None
        self._answers: list[_Answer] = []
        self._error: BaseException | None = None
        self._is_asked = self._is_busy = self._is_closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def is_asked(self) -> bool:
        """See `Worker`."""
        return self._is_asked

    @property
    def is_busy(self) -> bool:
        """See `Worker`."""
        with self._changed:
            return self._is_busy or self._work is not None

    def ask(self, work: Callable[[], _Answer], now_s: float) -> None:
        """See `Worker`."""
        with self._changed:
            self._work, self._is_asked, self._error = work, True, None
            self._answers.clear()
            self._changed.notify()

    def answer(self, now_s: float) -> _Answer | None:
        """See `Worker`."""
        with self._changed:
            if self._error is not None:
                error, self._error, self._is_asked = self._error, None, False
                raise error
            if not self._answers:
                return None
            self._is_asked = False
            return self._answers.pop()

    def drop(self) -> None:
        """See `Worker`."""
        with self._changed:
            self._work, self._is_asked = None, False
            self._answers.clear()

    def close(self) -> None:
        """See `Worker`."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        self._thread.join(_ENDING_S)

    def _run(self) -> None:
        """Run requests until the worker is closed."""
        yield_to_others()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._is_closed or self._work is not None)
                if self._is_closed:
                    return
                assert self._work is not None
                work, self._work, self._is_busy = self._work, None, True
            error, answers = None, list[_Answer]()
            try:
                answers.append(work())
            except BaseException as raised:
                error = raised
            with self._changed:
                self._is_busy = False
                if self._is_asked and self._work is None:
                    self._answers, self._error = answers, error
