"""Ways to run a Localizer for navigation: in the caller's thread, in a thread, or in a process of its own."""

from __future__ import annotations

import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np

from wheelsight.core.errors import DeviceError, WheelsightError
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.threads import OneCaller, ends, one_at_a_time, yield_to_others


class Answering(Protocol):
    """Anything that answers events one by one: a `Localizer`, or one that also writes a map."""

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Keyframes of the camera; None for wheels alone."""

    @property
    def recognised(self) -> int | None:
        """Number of recognitions of an existing map so far; None without one."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each fault of a sensor or of the calibration."""

    def process(self, event: Event) -> Estimate | None:
        """Return the estimate at an event, or None; raises as `Localizer.process`."""

    def close(self) -> None:
        """End its threads."""


Make = Callable[..., AbstractContextManager[Answering]]
"""Returns a context manager of an `Answering`, which it closes at the end."""


class _Worker(OneCaller):
    localizer: Answering

    @property
    def keyframes(self) -> KeyframeStore | None:
        """As `Localizer.keyframes`."""
        return self.localizer.keyframes

    @property
    def recognised(self) -> int | None:
        """As `Localizer.recognised`."""
        return self.localizer.recognised

    @property
    def warnings(self) -> tuple[str, ...]:
        """As `Localizer.warnings`."""
        return self.localizer.warnings


class LocalizerInStep(_Worker):
    """Answers all events in the caller's thread, so that equal events give equal estimates. For simulators.

    Args:
        localizer: closed with this.
    """

    def __init__(self, localizer: Answering) -> None:
        self.localizer = localizer

    @one_at_a_time
    def process(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        """Return each event with its estimate. Raises what `Localizer.process` raises."""
        return [(event, self.localizer.process(event)) for event in events]

    @ends
    def close(self) -> None:
        """End the localizer's threads; may be called twice."""
        self.localizer.close()


# How long `LocalizerBeside.close` waits for the current event, seconds.
_EVENT_ENDING_S = 5.0


class LocalizerBeside(_Worker):
    """Answers events in a thread of its own, with a lower priority than the caller's, which controls a robot.

    Of frames that arrive faster than they are processed, only the newest is kept. All wheel readings are processed.

    Args:
        localizer: not to be used elsewhere; closed with this.

    Attributes:
        dropped: number of frames that were skipped.
    """

    def __init__(self, localizer: Answering) -> None:
        self.localizer, self.dropped = localizer, 0
        self._waiting: deque[Event] = deque()
        self._answered: deque[tuple[Event, Estimate | None]] = deque()
        self._error: BaseException | None = None
        self._is_closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="localizer", daemon=True)
        self._thread.start()

    @one_at_a_time
    def process(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        """Add events; return the estimates since the last call. Raises an error of the thread."""
        with self._changed:
            for event in events:
                if isinstance(event, RgbdFrame):
                    older = [waiting for waiting in self._waiting if isinstance(waiting, RgbdFrame)]
                    for frame in older:
                        self._waiting.remove(frame)
                    self.dropped += len(older)
                self._waiting.append(event)
            self._changed.notify()
            if self._error is not None:
                raise self._error
            answered = list(self._answered)
            self._answered.clear()
        return answered

    def close(self) -> None:
        """End the thread, then the localizer's; may be called twice."""
        self._is_over = True
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        self._thread.join(_EVENT_ENDING_S)
        self.localizer.close()

    def _run(self) -> None:
        yield_to_others()
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._is_closed or bool(self._waiting))
                    if self._is_closed:
                        return
                    event = self._waiting.popleft()
                estimate = self.localizer.process(event)
                with self._changed:
                    self._answered.append((event, estimate))
        except BaseException as error:  # raised by the next call
            self._error = error


# How long `LocalizerApart.close` waits for a process without a sign of life, and for one that writes its map, seconds.
_ENDING_S, _WRITING_S = 5.0, 300.0


class LocalizerApart:
    """Answers events in another process, which takes no time from control. Each call waits for its estimate.

    A robot uses it within a `LocalizerBeside`. The process ends with this one, in whatever way that ends, and closes
    its localizer first. A process that hangs blocks `process`; the navigator notices it by the age of estimates, and
    `close` kills it.

    Args:
        make: a function of a module, which the process imports; see `Make`.
        arguments: of `make`.
        keeps_keyframes: whether to keep `keyframes` here as well, with depth alone, for a map that grows.

    Raises an error of `make`, and DeviceError if the process has died.
    """

    def __init__(self, make: Make, *arguments: Any, keeps_keyframes: bool = False) -> None:
        self.keyframes: KeyframeStore | None = KeyframeStore() if keeps_keyframes else None
        self.recognised: int | None = None
        self.warnings: tuple[str, ...] = ()
        context = get_context("spawn")
        self._connection, theirs = context.Pipe()
        what = (theirs, make, arguments, keeps_keyframes)
        self._process = context.Process(target=serve, args=what, name="wheelsight-localizer", daemon=True)
        self._is_over, self._calling = False, threading.Lock()
        self._process.start()
        theirs.close()
        self._take(self._receive())  # the process is ready

    def process(self, event: Event) -> Estimate | None:
        """As `Answering.process`. Raises what that raises, and DeviceError if the process has died."""
        with self._calling:
            self._send(event)
            return self._take(self._receive())

    def close(self) -> None:
        """Close the localizer and wait for it. May be called twice.

        If a call of `process` hangs, this kills the process, and that call raises DeviceError. Raises an error of
        closing, and DeviceError if closing hangs.
        """
        if self._is_over:
            return
        if not self._calling.acquire(timeout=_ENDING_S):
            self._process.kill()
            with self._calling:  # that call takes the exit code: of two threads that wait, one would not see the end
                self._end()
            return
        try:
            self._send(None)
            until_s = time.monotonic() + _WRITING_S
            while time.monotonic() < until_s and self._connection.poll(_ENDING_S):
                if isinstance(self._receive(), Answer):
                    self._end()
                    return
            self._process.kill()
            self._end()
            raise DeviceError("the localization process hung and was killed", fix="check which results are missing")
        finally:
            self._calling.release()

    def _send(self, event: Event | None) -> None:
        try:
            self._connection.send(event)
        except OSError:
            raise self._died() from None

    def _receive(self) -> Answer | Beat:
        """Return the next message of the process; raises an error that it sends."""
        try:
            answer = self._connection.recv()
        except (EOFError, OSError):
            raise self._died() from None
        if isinstance(answer, BaseException):
            self._end()
            raise answer
        assert isinstance(answer, Answer | Beat)
        return answer

    def _take(self, answer: Answer | Beat) -> Estimate | None:
        assert isinstance(answer, Answer)
        self.recognised, self.warnings = answer.recognised, answer.warnings
        store, news = self.keyframes, answer.news
        if store is not None and news is not None:
            for keyframe, T_map_keyframe in news.added:
                store.add(keyframe, T_map_keyframe)
            if news.T_map_keyframe is not None:
                store.move([KeyframeId(number) for number in range(len(news.T_map_keyframe))], news.T_map_keyframe)
        return answer.estimate

    def _died(self) -> DeviceError:
        self._end()
        code = self._process.exitcode
        how = f"by signal {-code}" if code is not None and code < 0 else f"with exit code {code}"
        return DeviceError(f"the localization process has ended {how}", fix="check whether memory ran out; start again")

    def _end(self) -> None:
        self._is_over = True
        self._process.join(_ENDING_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._connection.close()


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeNews:
    """Changes of a store.

    Attributes:
        added: new keyframes, with depth alone, and their poses (4, 4).
        T_map_keyframe: (N, 4, 4) of all keyframes, with these; None if none has moved.
    """

    added: tuple[tuple[Keyframe, FloatArray], ...]
    T_map_keyframe: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Message of the process after an event; also after making and closing, without an estimate.

    Attributes:
        estimate: at the event.
        recognised: as `Localizer.recognised`.
        news: changes of its keyframes, if these were requested.
        warnings: as `Localizer.warnings`.
    """

    estimate: Estimate | None = None
    recognised: int | None = None
    news: KeyframeNews | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Beat:
    """Sign of life, once in `_BEAT_S`, while the process closes its localizer."""


_BEAT_S = 1.0


class _Beats:
    """Sends a `Beat` regularly from `begin` to the end of its `with` block."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._is_over = connection, threading.Event()
        self._thread = threading.Thread(target=self._run, name="beats", daemon=True)

    def begin(self) -> None:
        self._thread.start()

    def __enter__(self) -> _Beats:
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        with suppress(OSError):  # the robot's program may have died
            while not self._is_over.wait(_BEAT_S):
                self._connection.send(Beat())


def serve(connection: Connection, make: Make, arguments: tuple[Any, ...], keeps_keyframes: bool) -> None:
    """Make a localizer, answer events, close it. Sends an `Answer` after each, or the error that ends the process.

    It ignores Ctrl-C and the end of the terminal, which reach all processes: the robot's program stops the robot first,
    and then closes this process. SIGTERM closes the localizer.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(getattr(signal, "SIGHUP", signal.SIGINT), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    yield_to_others()  # before other threads start, which inherit the priority
    with suppress(OSError):  # the other process may have died
        try:
            with _Beats(connection) as beats, make(*arguments) as localizer:
                _answer(connection, localizer, keeps_keyframes)
                beats.begin()
        except SystemExit:
            raise
        except BaseException as error:
            error.add_note("".join(traceback.format_exception(error)))
            try:
                connection.send(error)
            except OSError:
                raise
            except Exception:  # not every exception can be pickled
                connection.send(WheelsightError(f"{type(error).__name__}: {error}"))
        else:
            connection.send(Answer())


def _answer(connection: Connection, localizer: Answering, keeps_keyframes: bool) -> None:
    store = localizer.keyframes if keeps_keyframes else None
    watch = None if store is None else _StoreWatch(store)
    connection.send(Answer(None, localizer.recognised))
    while True:
        try:
            event: Event | None = connection.recv()
        except (EOFError, ConnectionError):  # the other process has died
            return
        if event is None:
            return
        estimate = localizer.process(event)
        news = watch.news() if watch is not None and isinstance(event, RgbdFrame) else None
        connection.send(Answer(estimate, localizer.recognised, news, localizer.warnings))


class _StoreWatch:
    """Changes of a store between two calls. A keyframe counts one call late, when it is complete."""

    def __init__(self, store: KeyframeStore) -> None:
        self._store, self._sent, self._seen, self._revision = store, 0, 0, store.revision

    def news(self) -> KeyframeNews | None:
        """Return the changes, or None."""
        store, T = self._store, self._store.T_map_keyframe
        first, self._sent, self._seen = self._sent, self._seen, len(store)
        numbers = range(first, self._sent)
        has_moved, self._revision = store.revision != self._revision, store.revision
        if not numbers and not has_moved:
            return None
        added = tuple(
            (replace(store[KeyframeId(number)], grey_png=b"", features=None, code=None), np.array(T[number]))
            for number in numbers
        )
        return KeyframeNews(added, np.array(T[: self._sent]) if has_moved else None)
