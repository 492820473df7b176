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

# LocalizerInStep: a localizer as navigation asks for it, in the caller's own thread.


class Answering(Protocol):
    """What answers events one by one: a `Localizer`, or what writes a map beside it."""

    @property
    def keyframes(self) -> KeyframeStore | None:
        """What the camera remembers; None of wheels alone."""

    @property
    def recognised(self) -> int | None:
        """How often something of a map of before was recognised so far; None where nobody looks for that."""

    def process(self, event: Event) -> Estimate | None:
        """The estimate at an event that is answered, None at any other; raises as `Localizer.process`."""

    def close(self) -> None:
        """End the threads that work for it."""


Make = Callable[..., AbstractContextManager[Answering]]
"""Makes what answers, in a `with` block that closes it."""


class LocalizerInStep(OneCaller):
    """Answers all events that it is given before it returns: equal events, equal answers. For simulators.

    Args:
        localizer: that answers; closed with this.
    """

    def __init__(self, localizer: Answering) -> None:
        self.localizer = localizer

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Of the localizer."""
        return self.localizer.keyframes

    @property
    def recognised(self) -> int | None:
        """Of the localizer."""
        return self.localizer.recognised

    @one_at_a_time
    def hear(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        """Each event with its answer. Raises what `Localizer.process` raises."""
        return [(event, self.localizer.process(event)) for event in events]

    @ends
    def close(self) -> None:
        """End the localizer's threads; may be called twice."""
        self.localizer.close()


# LocalizerBeside: a localizer as navigation asks for it, in a thread of its own.


# How long the end waits for an event that is being answered, before the localizer is closed beside it.
_EVENT_ENDING_S = 5.0


class LocalizerBeside(OneCaller):
    """Answers in a thread of its own, which yields to the thread that controls a robot and never waits for a frame.

    Frames that come faster than they are answered are left out but for the newest; wheel readings never are.

    Args:
        localizer: that answers; used by nobody else from now on, and closed with this.

    Attributes:
        dropped: frames that were left out.
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

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Of the localizer."""
        return self.localizer.keyframes

    @property
    def recognised(self) -> int | None:
        """Of the localizer."""
        return self.localizer.recognised

    @one_at_a_time
    def hear(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        """What was answered since the last call. Raises what went wrong in the thread."""
        with self._changed:
            for event in events:
                self._put(event)
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

    def _put(self, event: Event) -> None:
        if isinstance(event, RgbdFrame):
            older = [waiting for waiting in self._waiting if isinstance(waiting, RgbdFrame)]
            for frame in older:
                self._waiting.remove(frame)
            self.dropped += len(older)
        self._waiting.append(event)

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
        except BaseException as error:  # told to whoever asks next
            self._error = error


# LocalizerApart: a localizer in a process of its own, which takes neither time nor Python's lock from control.


# How long the end waits for a process that gives no sign of life, and for one that does while it writes its map.
_ENDING_S, _WRITING_S = 5.0, 300.0


class LocalizerApart:
    """Has another process answer; each call waits for it, so that `LocalizerBeside` is what a robot is led by.

    The process ends where this one does, however that ends; what was made is closed first. A process that hangs
    blocks `process`, as the navigator notices by the age of its answers; `close` kills it.

    Args:
        make: a function of a module, which the process imports: what answers, in a `with` block.
        arguments: of it.
        tells_keyframes: whether `keyframes` are kept here, too, of depth alone, as a floor that grows needs them.

    Raises what went wrong in making it, and DeviceError where the process has died.
    """

    def __init__(self, make: Make, *arguments: Any, tells_keyframes: bool = False) -> None:
        self.keyframes: KeyframeStore | None = KeyframeStore() if tells_keyframes else None
        self.recognised: int | None = None
        context = get_context("spawn")
        self._connection, theirs = context.Pipe()
        what = (theirs, make, arguments, tells_keyframes)
        self._process = context.Process(target=serve, args=what, name="wheelsight-localizer", daemon=True)
        self._is_over, self._calling = False, threading.Lock()
        self._process.start()
        theirs.close()
        self._take(self._heard())  # that it is ready: else the first event would have this for its answer

    def process(self, event: Event) -> Estimate | None:
        """As `Answering.process`. Raises what that raises, and DeviceError where the process has died."""
        with self._calling:
            self._say(event)
            return self._take(self._heard())

    def close(self) -> None:
        """Close what was made, and wait for that; may be called twice.

        A call of `process` that hangs ends by this: the process is killed, and that call raises DeviceError.
        Raises what went wrong in closing, and DeviceError where that hung.
        """
        if self._is_over:
            return
        if not self._calling.acquire(timeout=_ENDING_S):
            self._process.kill()
            self._process.join()
            return
        try:
            self._say(None)
            self._await_end()
            self._end()
        finally:
            self._calling.release()

    def _await_end(self) -> None:
        """Wait for the last answer while the process shows that it lives."""
        until_s = time.monotonic() + _WRITING_S
        while time.monotonic() < until_s and self._connection.poll(_ENDING_S):
            if isinstance(self._heard(), Answer):
                return
        self._process.kill()
        self._end()
        raise DeviceError("the process that localizes hung and was killed", fix="see what it had not yet written")

    def _say(self, event: Event | None) -> None:
        try:
            self._connection.send(event)
        except OSError:
            raise self._died() from None

    def _heard(self) -> Answer | Beat:
        """The next answer; raises the error that came instead."""
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
        self.recognised = answer.recognised
        if self.keyframes is not None and answer.news is not None:
            _take_news(self.keyframes, answer.news)
        return answer.estimate

    def _died(self) -> DeviceError:
        self._end()
        code = self._process.exitcode
        how = f"by signal {-code}" if code is not None and code < 0 else f"with exit code {code}"
        return DeviceError(f"the process that localizes has ended {how}", fix="see whether memory ran out; begin anew")

    def _end(self) -> None:
        self._is_over = True
        self._process.join(_ENDING_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._connection.close()


def _take_news(store: KeyframeStore, news: KeyframeNews) -> None:
    """Keep what is new, and move what has moved."""
    for keyframe, T_map_keyframe in news.added:
        store.add(keyframe, T_map_keyframe)
    if news.T_map_keyframe is not None:
        store.move([KeyframeId(number) for number in range(len(news.T_map_keyframe))], news.T_map_keyframe)


# What the process of a `LocalizerApart` does: answer one event after another until nobody asks any more.


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeNews:
    """What has become of a store.

    Attributes:
        added: keyframes of depth alone that come next, and their poses (4, 4).
        T_map_keyframe: (N, 4, 4) of all, with these; None where none has moved.
    """

    added: tuple[tuple[Keyframe, FloatArray], ...]
    T_map_keyframe: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """To an event; to the making and the closing, with no estimate.

    Attributes:
        estimate: at the event.
        recognised: of the localizer, by now.
        news: of its keyframes, where it is told of them.
    """

    estimate: Estimate | None = None
    recognised: int | None = None
    news: KeyframeNews | None = None


@dataclass(frozen=True, slots=True)
class Beat:
    """A sign of life while what was made is closed, once in `_BEAT_S`."""


_BEAT_S = 1.0


class _Beats:
    """Sends a `Beat` regularly from `begin` to the end of its `with` block, which shows that closing goes on."""

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


def serve(connection: Connection, make: Make, arguments: tuple[Any, ...], tells_keyframes: bool) -> None:
    """Make, answer, close; each is answered by an `Answer`, or by the error that ends it.

    Ctrl-C and the end of a terminal reach all its processes: the robot's program stops the robot first, and closes
    this one. SIGTERM closes what was made.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(getattr(signal, "SIGHUP", signal.SIGINT), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    yield_to_others()  # before there are other threads, which do as this one
    with suppress(OSError):  # nobody may be there to be told
        try:
            with _Beats(connection) as beats, make(*arguments) as localizer:
                _answer(connection, localizer, tells_keyframes)
                beats.begin()
        except SystemExit:
            raise
        except BaseException as error:
            error.add_note("".join(traceback.format_exception(error)))
            _tell(connection, error)
        else:
            connection.send(Answer())


def _answer(connection: Connection, localizer: Answering, tells_keyframes: bool) -> None:
    store = localizer.keyframes if tells_keyframes else None
    watch = None if store is None else _StoreWatch(store)
    connection.send(Answer(None, localizer.recognised))
    while (event := _next(connection)) is not None:
        estimate = localizer.process(event)
        news = watch.news() if watch is not None and isinstance(event, RgbdFrame) else None
        connection.send(Answer(estimate, localizer.recognised, news))


def _next(connection: Connection) -> Event | None:
    """None at the end, and where whoever asks has died."""
    try:
        event: Event | None = connection.recv()
    except (EOFError, ConnectionError):
        return None
    return event


def _tell(connection: Connection, error: BaseException) -> None:
    try:
        connection.send(error)
    except OSError:
        raise
    except Exception:  # not everything that may be raised can be sent
        connection.send(WheelsightError(f"{type(error).__name__}: {error}"))


class _StoreWatch:
    """What is new of a store since it was asked last; of a keyframe one call late, when it has been made."""

    def __init__(self, store: KeyframeStore) -> None:
        self._store, self._told, self._seen, self._revision = store, 0, 0, store.revision

    def news(self) -> KeyframeNews | None:
        """None where there is none."""
        store, T = self._store, self._store.T_map_keyframe
        first, self._told, self._seen = self._told, self._seen, len(store)
        numbers = range(first, self._told)
        has_moved, self._revision = store.revision != self._revision, store.revision
        if not numbers and not has_moved:
            return None
        added = tuple((_depth_of(store[KeyframeId(number)]), np.array(T[number])) for number in numbers)
        return KeyframeNews(added, np.array(T[: self._told]) if has_moved else None)


def _depth_of(keyframe: Keyframe) -> Keyframe:
    return replace(keyframe, grey_png=b"", features=None, code=None)
