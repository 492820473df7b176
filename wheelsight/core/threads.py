"""`OneCaller` refuses concurrent calls of an object with a state, `Worker` runs functions, `Stopwatch` adds up the
times of stages, and a `Tracer` records stages and locks of all threads.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import cache, partial, wraps
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


def one_at_a_time(method: Callable[Concatenate[Object, Given], Answer]) -> Callable[Concatenate[Object, Given], Answer]:
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
        self._changed = new_condition(name)
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
                answers.append(in_span("work", work))
            except BaseException as raised:
                error = raised
            with self._changed:
                self._is_busy = False
                if self._is_asked and self._work is None:
                    self._answers, self._error = answers, error


class Tracer(Protocol):
    """Records when each thread ran which stage, and how long it waited for locks."""

    def add(self, name: str, began: tuple[float, float], ended: tuple[float, float]) -> None:
        """Add a stage of the calling thread, from and to its wall and processor time in seconds."""

    def span(self, name: str, category: str, facts: Mapping[str, object]) -> AbstractContextManager[object]:
        """Return a block that is added when it ends."""

    def lock(self, name: str) -> AbstractContextManager[object]:
        """Return a lock that adds waits for it."""

    def condition(self, name: str) -> threading.Condition:
        """Return a condition that adds waits for it and for its lock."""


_tracer: Tracer | None = None
_UNTRACED = nullcontext()
STAGE, FRAME, LOCK = "stage", "frame", "lock"  # categories of spans


def trace_by(tracer: Tracer | None) -> None:
    """Record all threads by a tracer, with the locks that are made from now on; None ends it."""
    global _tracer
    _tracer = tracer


def span(name: str, category: str = STAGE, **facts: object) -> AbstractContextManager[object]:
    """Return a block that the tracer records, if there is one, with facts about it."""
    return _UNTRACED if (tracer := _tracer) is None else tracer.span(name, category, facts)


def in_span(name: str, work: Callable[[], Answer], category: str = STAGE) -> Answer:
    """Call a function in a `span`."""
    with span(name, category):
        return work()


def in_spans(name: str, items: Iterator[Answer]) -> Iterator[Answer]:
    """Return the items of an iterator; making each is a `span`."""
    if _tracer is None:
        return items
    end: Any = object()
    return iter(partial(in_span, name, partial(next, items, end)), end)


def new_lock(name: str) -> AbstractContextManager[object]:
    """Return a lock. While there is a tracer, waits for it are recorded."""
    return threading.Lock() if _tracer is None else _tracer.lock(name)


def new_condition(name: str) -> threading.Condition:
    """Return a condition. While there is a tracer, waits for it are recorded."""
    return threading.Condition() if _tracer is None else _tracer.condition(name)


class Stopwatch:
    """Adds up wall time and the thread's processor time by stage, from one `restart` to the next.

    Time in a nested stage counts for that one alone, so that the sum is the time of the whole.

    Attributes:
        seconds, processor_seconds: by name of the stage.
        stage: returns the block of a stage: `with watch.stage("align"):`.
        begun: of each stage that has not ended, wall and processor time: its begin, then the sum of its nested stages.
        lap_began: wall and processor time at the end of the last stage or lap.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.processor_seconds: dict[str, float] = {}
        self.stage: Callable[[str], AbstractContextManager[None]] = cache(partial(_Stage, self))
        self.begun: list[tuple[float, float, list[float]]] = []
        self.lap_began = (0.0, 0.0)
        self._is_in_frame = False

    def restart(self) -> None:
        """Reset all times, except in a frame, which counts all that happens until it ends."""
        if not self._is_in_frame:
            self.seconds, self.processor_seconds = {}, {}

    def begin_frame(self) -> None:
        """Reset all times at the begin of a frame."""
        self.seconds, self.processor_seconds, self._is_in_frame = {}, {}, True
        self.lap_began = time.perf_counter(), time.thread_time()

    def lap(self, name: str, *, ends_frame: bool = False) -> None:
        """Count the time since the last stage or lap as a stage; call it outside any stage."""
        began, self.lap_began = self.lap_began, (time.perf_counter(), time.thread_time())
        self.seconds[name] = self.seconds.get(name, 0.0) + self.lap_began[0] - began[0]
        self.processor_seconds[name] = self.processor_seconds.get(name, 0.0) + self.lap_began[1] - began[1]
        self._is_in_frame &= not ends_frame
        if (tracer := _tracer) is not None:
            tracer.add(name, began, self.lap_began)


class _Stage:
    """A block that a stopwatch counts. It is no generator, which would take twice the time."""

    def __init__(self, watch: Stopwatch, name: str) -> None:
        self._watch, self._name = watch, name

    def __enter__(self) -> None:
        self._watch.begun.append((time.perf_counter(), time.thread_time(), [0.0, 0.0]))

    def __exit__(self, *_: object) -> None:
        name, watch = self._name, self._watch
        watch.lap_began = now_s, used_s = time.perf_counter(), time.thread_time()
        began_s, began_used_s, nested = watch.begun.pop()
        wall_s, spent_s = now_s - began_s, used_s - began_used_s
        watch.seconds[name] = watch.seconds.get(name, 0.0) + wall_s - nested[0]
        watch.processor_seconds[name] = watch.processor_seconds.get(name, 0.0) + spent_s - nested[1]
        if watch.begun:
            outer = watch.begun[-1][2]
            outer[0], outer[1] = outer[0] + wall_s, outer[1] + spent_s
        if (tracer := _tracer) is not None:
            tracer.add(name, (began_s, began_used_s), watch.lap_began)
