"""`OneCaller` refuses concurrent calls of an object with a state, `Worker` runs functions, and `Stopwatch` adds up the
times of stages.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, Self, TypeVar

from wheelsight.core.errors import ArgumentError

# Of `nice` of background work: a third of an ordinary thread's share. With less, such a thread holds Python's lock
# while the system runs other programs, and frames wait.
_YIELDED = 5

Given = ParamSpec("Given")
Answer = TypeVar("Answer")


class Closing:
    """An object that the end of a `with` block closes."""

    def close(self) -> None:
        """Release what it holds."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class OneCaller:
    """An object with a state: one call at a time may change it, in the process that made it, until it is closed.

    Threads may take turns. `one_at_a_time` and `ends` decorate the methods that change it.
    """

    _turn: Any
    _process: int
    _is_over = False

    def __new__(cls, *_: Any, **__: Any) -> Self:
        """Make the lock, so that subclasses need not call an `__init__` of this class."""
        made = super().__new__(cls)
        made._turn, made._process = threading.RLock(), os.getpid()
        return made

    def __getstate__(self) -> Any:
        name = type(self).__name__
        raise ArgumentError(f"a {name} can be neither copied nor pickled", fix="make another of the same settings")

    def _refused(self) -> ArgumentError:
        name = type(self).__name__
        if self._process != os.getpid():
            return ArgumentError(f"this {name} was made in another process", fix="make it after the fork")
        return ArgumentError(f"this {name} is at work in another thread", fix="one call after another, or one a thread")


Object = TypeVar("Object", bound=OneCaller)


def one_at_a_time(
    method: Callable[Concatenate[Object, Given], Answer],
) -> Callable[Concatenate[Object, Given], Answer]:
    """Decorate a method that changes a `OneCaller`: ArgumentError during another call, after a fork, or if closed.

    It may call other methods of the same object.
    """

    @wraps(method)
    def called(self: Object, /, *given: Given.args, **named: Given.kwargs) -> Answer:
        if self._process != os.getpid() or not self._turn.acquire(False):
            raise self._refused()
        try:
            if self._is_over:
                raise ArgumentError(f"this {type(self).__name__} is closed", fix="make another")
            return method(self, *given, **named)
        finally:
            self._turn.release()

    return called


def ends(method: Callable[[Object], Answer]) -> Callable[[Object], Answer]:
    """Decorate the method that closes a `OneCaller`, which may be called twice; else as `one_at_a_time`."""

    @wraps(method)
    def called(self: Object) -> Answer:
        if self._process != os.getpid() or not self._turn.acquire(False):
            raise self._refused()
        try:
            self._is_over = True
            return method(self)
        finally:
            self._turn.release()

    return called


def yield_to_others() -> None:
    """Lower the priority of the calling thread, if the system has one for each thread, as Linux."""
    thread = threading.get_native_id()
    with suppress(AttributeError, OSError):
        os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + _YIELDED)


# Longest wait for unfinished work at the end of a program; the thread is a daemon.
_ENDING_S = 5.0


class Worker(Protocol[Answer]):
    """Runs one function at a time; a new request replaces the one before."""

    @property
    def is_asked(self) -> bool:
        """Whether an answer is to come."""

    @property
    def is_busy(self) -> bool:
        """Whether a function runs, even if its answer was dropped."""

    def ask(self, work: Callable[[], Answer], now_s: float) -> None:
        """Run a function. Nothing that it uses may change until it ends."""

    def has_answer(self, now_s: float) -> bool:
        """Return whether `answer` returns or raises something."""

    def answer(self, now_s: float) -> Answer | None:
        """Return the answer, once; None until it is ready. Raises the function's exception, once."""

    def drop(self) -> None:
        """Drop the request and its answer."""

    def close(self) -> None:
        """End the thread; further calls do nothing."""


class WorkerInStep(Generic[Answer]):
    """Runs a function at once, and gives its answer after a simulated time. Equal events give equal answers.

    Args:
        takes_s: that time, by the clock of the stamps, which does not advance meanwhile.
    """

    is_busy = False

    def __init__(self, takes_s: float = 0.0) -> None:
        self._takes_s = takes_s
        self._waiting: tuple[float, Answer] | None = None

    @property
    def is_asked(self) -> bool:
        """See `Worker`."""
        return self._waiting is not None

    def ask(self, work: Callable[[], Answer], now_s: float) -> None:
        """See `Worker`."""
        self._waiting = now_s + self._takes_s, work()

    def has_answer(self, now_s: float) -> bool:
        """See `Worker`."""
        # A tolerance, as stamps are sums of periods.
        return self._waiting is not None and now_s >= self._waiting[0] - 1e-6

    def answer(self, now_s: float) -> Answer | None:
        """See `Worker`."""
        if self._waiting is None or not self.has_answer(now_s):
            return None
        answer, self._waiting = self._waiting[1], None
        return answer

    def drop(self) -> None:
        """See `Worker`."""
        self._waiting = None

    def close(self) -> None:
        """Do nothing: there is no thread."""


class WorkerBeside(Generic[Answer]):
    """Runs functions in a thread of low priority, so that the control of the robot never waits.

    Args:
        name: of the thread.
    """

    def __init__(self, name: str) -> None:
        self._changed = threading.Condition()
        self._work: Callable[[], Answer] | None = None
        self._answers: list[Answer] = []
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

    def ask(self, work: Callable[[], Answer], now_s: float) -> None:
        """See `Worker`."""
        with self._changed:
            self._work, self._is_asked, self._error = work, True, None
            self._answers.clear()
            self._changed.notify()

    def has_answer(self, now_s: float) -> bool:
        """See `Worker`."""
        with self._changed:
            return bool(self._answers) or self._error is not None

    def answer(self, now_s: float) -> Answer | None:
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
            error, answers = None, list[Answer]()
            try:
                answers.append(work())
            except BaseException as raised:
                error = raised
            with self._changed:
                self._is_busy = False
                if self._is_asked and self._work is None:
                    self._answers, self._error = answers, error


class Stopwatch:
    """Adds up seconds by stage name, from one `restart` to the next."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def restart(self) -> None:
        """Reset all times."""
        self.seconds = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of a block under `name`."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started
