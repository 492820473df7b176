"""What the process of a `LocalizerApart` does: answer one event after another until nobody asks any more."""

from __future__ import annotations

import signal
import sys
import threading
import traceback
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from wheelsight.errors import WheelsightError
from wheelsight.estimates import Estimate
from wheelsight.events import Event, RgbdFrame
from wheelsight.geometry import FloatArray
from wheelsight.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.localizer.in_step import Answering, Make
from wheelsight.threads import yield_to_others


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
