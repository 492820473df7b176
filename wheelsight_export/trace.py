"""`trace_to` writes what each thread does at what time, in the Trace Event Format that Perfetto and Chrome show."""

from __future__ import annotations

import json
import os
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import IO

from wheelsight.core.files import StrPath, atomic_write
from wheelsight.core.threads import FRAME, LOCK, STAGE, span, trace_by

_US = 1e6
# Remembered waits of a thread for locks; a stage counts those within it, which are fewer.
_WAITS = 1000
# Linux: nanoseconds on a processor, and ready but waiting for one, of the thread that reads it.
_SCHEDULE = Path("/proc/thread-self/schedstat")


@contextmanager
def trace_to(path: StrPath) -> Iterator[None]:
    """Trace all threads in the block, and write the file when it ends, also by an exception.

    Events go to a temporary file beside `path` as they come, some 200 bytes each, so that an hour takes no memory. If
    the disk is full, the block goes on without a trace, and the error follows at its end.

    Locks that were made before the block are not traced.

    Raises:
        OutputError: the folder is missing or not writable, before the block; or the disk is full, after it.
    """
    interruption: BaseException | None = None
    with atomic_write(path) as stream:
        tracer = TraceFile(stream)
        trace_by(tracer)
        try:
            yield
        except BaseException as error:
            interruption = error
        finally:
            trace_by(None)
        tracer.finish()
    if interruption is not None:
        raise interruption


class TraceFile:
    """Writes stages, locks and threads to a stream, as a `Tracer`. Times are microseconds since it was made.

    Each event has `args.unexplained_us`: its wall time without processor time and waits for locks. In it the thread
    waited for the interpreter's lock, for a processor, a file, or the threads of a library. CPython does not report how
    long a thread waits for the interpreter's lock, so that this is an upper bound. Frames subtract the time for which
    Linux says that the thread was ready and had no processor, `args.no_processor_us`.

    Args:
        stream: receives the text.
    """

    def __init__(self, stream: IO[str]) -> None:
        self._stream, self._began_s, self._process = stream, time.perf_counter(), os.getpid()
        self._writing, self._is_over = threading.Lock(), False
        self._error: OSError | None = None
        self._of_thread = _Threads()
        name = {"name": "process_name", "ph": "M", "pid": self._process, "args": {"name": "wheelsight"}}
        self._put('{"traceEvents": [\n' + json.dumps(name))

    def add(self, name: str, began: tuple[float, float], ended: tuple[float, float]) -> None:
        """Add a stage of the calling thread, from and to its wall and processor time in seconds."""
        self.write(name, STAGE, began, ended, {})

    def span(self, name: str, category: str, facts: Mapping[str, object]) -> AbstractContextManager[object]:
        """Return a block that is added when it ends."""
        return _Span(self, name, category, facts)

    def lock(self, name: str) -> AbstractContextManager[object]:
        """Return a lock that adds waits for it."""
        return _Lock(name)

    def condition(self, name: str) -> threading.Condition:
        """Return a condition that adds waits for it and for its lock."""
        return _Condition(name)

    def write(
        self,
        name: str,
        category: str,
        began: tuple[float, float],
        ended: tuple[float, float],
        facts: Mapping[str, object],
        no_processor_s: float | None = None,
    ) -> None:
        """Write an event of the calling thread; `no_processor_s` is None if it is not known."""
        here, wall_s, used_s = self._of_thread, ended[0] - began[0], ended[1] - began[1]
        if not here.is_named:
            here.is_named = True
            self._name_thread(here.number)
        if category == LOCK:
            here.waits.append((began[0], wall_s))
        locks_s = 0.0
        for begin_s, waited_s in reversed(here.waits):
            if begin_s < began[0]:
                break
            locks_s += waited_s
        rest_s = max(wall_s - used_s - locks_s - (no_processor_s or 0.0), 0.0)
        args = {"unexplained_us": round(_US * rest_s), **facts}
        if locks_s:
            args["locks_us"] = round(_US * locks_s)
        if no_processor_s is not None:
            args["no_processor_us"] = round(_US * no_processor_s)
        begin_us = _US * (began[0] - self._began_s)
        self._put(
            f',\n{{"name": {json.dumps(name)}, "cat": "{category}", "ph": "X", "pid": {self._process}, '
            f'"tid": {here.number}, "ts": {begin_us:.1f}, "dur": {_US * wall_s:.1f}, "tts": {_US * began[1]:.1f}, '
            f'"tdur": {_US * used_s:.1f}, "args": {json.dumps(args)}}}'
        )
        if category == FRAME:
            waits_ms = {"locks": locks_s, "a processor": no_processor_s or 0.0, "unexplained": rest_s}
            shown = {waited: round(1e3 * seconds, 3) for waited, seconds in waits_ms.items()}
            counter = {"name": "a frame waits for, ms", "ph": "C", "pid": self._process, "ts": round(begin_us, 1)}
            self._put(",\n" + json.dumps({**counter, "args": shown}))

    def finish(self) -> None:
        """Write the end. Raises the OSError that stopped it."""
        self._put('\n], "displayTimeUnit": "ms"}\n')
        with self._writing:
            self._is_over = True
        if self._error is not None:
            raise self._error

    def _name_thread(self, number: int) -> None:
        thread = threading.current_thread()
        is_main = thread is threading.main_thread()
        of = {"ph": "M", "pid": self._process, "tid": number}
        self._put(
            ",\n" + json.dumps({"name": "thread_name", **of, "args": {"name": "main" if is_main else thread.name}})
        )
        self._put(",\n" + json.dumps({"name": "thread_sort_index", **of, "args": {"sort_index": int(not is_main)}}))

    def _put(self, text: str) -> None:
        """Write a text, unless the file has ended or could not be written."""
        with self._writing:
            if self._is_over or self._error is not None:
                return
            try:
                self._stream.write(text)
            except OSError as error:
                self._error = error


class _Threads(threading.local):
    """What is known of the calling thread."""

    def __init__(self) -> None:
        self.number, self.is_named = threading.get_native_id(), False
        self.waits: deque[tuple[float, float]] = deque(maxlen=_WAITS)  # begin and duration, seconds


class _Span:
    def __init__(self, file: TraceFile, name: str, category: str, facts: Mapping[str, object]) -> None:
        self._file, self._name, self._category, self._facts = file, name, category, facts

    def __enter__(self) -> None:
        self._ready_s = _no_processor_s() if self._category == FRAME else None
        self._began = time.perf_counter(), time.thread_time()

    def __exit__(self, *_: object) -> None:
        ended, waited_s = (time.perf_counter(), time.thread_time()), None
        if self._ready_s is not None and (ready_s := _no_processor_s()) is not None:
            waited_s = ready_s - self._ready_s
        self._file.write(self._name, self._category, self._began, ended, self._facts, waited_s)


def _no_processor_s() -> float | None:
    """How long the calling thread has been ready without a processor; None where the system does not say."""
    with suppress(OSError, ValueError, IndexError):
        return int(_SCHEDULE.read_text(encoding="ascii").split()[1]) / 1e9
    return None


class _Lock:
    """A lock whose waits are spans; one that is free makes none."""

    def __init__(self, name: str) -> None:
        self._name, self._lock = name, threading.Lock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            with span(self._name, LOCK):
                self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


class _Condition(threading.Condition):
    """A condition whose waits are spans, for its lock too."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name

    def __enter__(self) -> bool:
        if self.acquire(blocking=False):
            return True
        with span(self._name, LOCK):
            return self.acquire()

    def wait(self, timeout: float | None = None) -> bool:
        """See `threading.Condition`."""
        with span(f"{self._name}: wait", LOCK):
            return super().wait(timeout)
