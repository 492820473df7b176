"""Workers: do what takes longer than a control period, beside the control of a robot or in step with it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from wheelsight.core.threads import yield_to_others

_Answer = TypeVar("_Answer")
# How long the end of a program waits for work that does not end; the thread is a daemon.
_ENDING_S = 5.0


class Worker(Protocol[_Answer]):
    """Does one thing at a time; who asks again wants the newer answer alone."""

    @property
    def is_asked(self) -> bool:
        """Whether there is an answer to come."""

    @property
    def is_busy(self) -> bool:
        """Whether something is being done, be it wanted still or not."""

    def ask(self, work: Callable[[], _Answer], now_s: float) -> None:
        """Have something done that uses nothing which anybody else changes until then."""

    def answer(self, now_s: float) -> _Answer | None:
        """What came of it, once; None while that is not known. Raises what it raised, once."""

    def drop(self) -> None:
        """Want no answer any more."""

    def close(self) -> None:
        """End the thread that works; may be called twice."""


class WorkerInStep(Generic[_Answer]):
    """Does it at once, and tells it when a time has gone by: equal events, equal answers. For simulators.

    Args:
        takes_s: that time, by the clock of the stamps, in which simulated time would stand still else.
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
        # Stamps are sums of periods.
        if self._waiting is None or now_s < self._waiting[0] - 1e-6:
            return None
        answer, self._waiting = self._waiting[1], None
        return answer

    def drop(self) -> None:
        """See `Worker`."""
        self._waiting = None

    def close(self) -> None:
        """See `Worker`: it has none."""


class WorkerBeside(Generic[_Answer]):
    """Does it in a thread of its own, which yields to who controls the robot: that one never waits.

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
