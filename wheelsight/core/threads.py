"""`Rows` shares the rows of an image among threads. `OneCaller` refuses concurrent calls of an object with a state."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from wheelsight.core.errors import ArgumentError

_FEWEST_ROWS = 100  # a single thread is faster for smaller images
_PARTS_A_THREAD = 2  # rows differ in work, and threads in their start
# Of `nice` of background work: a third of an ordinary thread's share. With less, such a thread holds Python's lock
# while the system runs other programs, and frames wait.
_YIELDED = 5

Given = ParamSpec("Given")
Answer = TypeVar("Answer")


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


class Rows:
    """Shares the rows of an image among threads; the result does not depend on their number."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads, "wheelsight-dense") if threads > 1 else None

    def share(self, height: int, work: Callable[..., None], *given: Any, after: tuple[Any, ...] = ()) -> None:
        """Call `work(*given, begin, end, *after)` until all rows below `height` are done."""
        if self._pool is None or height < _FEWEST_ROWS:
            work(*given, 0, height, *after)
            return
        todo, parts = itertools.count(), _PARTS_A_THREAD * self._threads

        def take() -> None:
            while (part := next(todo)) < parts:
                work(*given, height * part // parts, height * (part + 1) // parts, *after)

        others = []
        for _ in range(1, self._threads):
            others.append(self._pool.submit(take))
        take()
        for other in others:
            if not other.cancel():
                other.result()
